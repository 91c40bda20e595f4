//! Wavefront OBJ, as Blender, scanners and CAD programs export it.

use crate::{ImagingError, Mesh, MeshParts, RgbImage, files::load_rgb};
use std::cell::Cell;
use std::collections::BTreeSet;
use std::io::Cursor;
use std::path::{Component, Path};
use tobj::{Material, Model};

/// Material files of one OBJ: each is read again wherever the OBJ names it.
const MOST_LIBRARIES: usize = 64;

/// Reads a Wavefront OBJ with its MTL: the texture (`map_Kd`) that all its materials share, else vertex colours, else the
/// materials' colours (`Kd`), else grey. `metres_per_unit` is 1e-3 for millimetres. All shapes of the file become one mesh; its axes
/// are the object's.
///
/// # Errors
/// When a file cannot be read, a texture is missing, the surface has more than one texture or is textured in parts, or the mesh is
/// not usable ([`Mesh::new`]).
pub fn load_obj(path: &Path, metres_per_unit: f64) -> Result<Mesh, ImagingError> {
    let (models, materials) = read(path)?;
    let has_uv = models.iter().all(|m| !m.mesh.texcoords.is_empty());
    let has_normals = models.iter().all(|m| !m.mesh.normals.is_empty());
    let mut parts = MeshParts::default();
    for model in &models {
        append(&mut parts, &model.mesh, metres_per_unit, has_uv, has_normals);
        let colour = material(model, &materials).and_then(|m| m.diffuse).map(|c| c.map(to_byte));
        append_colours(&mut parts, &model.mesh, colour);
    }
    if let Some(name) = the_texture(&models, &materials, path)? {
        if !has_uv {
            let what = "a texture but no texture coordinates";
            return Err(ImagingError::field(path, "vt", what, "export the mesh with its UV map"));
        }
        parts.texture = Some(load_texture(path, name)?);
    }
    Mesh::new(parts, path)
}

fn read(path: &Path) -> Result<(Vec<Model>, Vec<Material>), ImagingError> {
    let bad = |field: &str, what: tobj::LoadError, remedy| ImagingError::field(path, field, what.to_string(), remedy);
    let bytes = std::fs::read(path).map_err(ImagingError::io(path))?;
    let options = tobj::LoadOptions { triangulate: true, single_index: true, ..Default::default() };
    let libraries = Cell::new(0);
    let (models, materials) = tobj::load_obj_buf(&mut Cursor::new(bytes), &options, |library| {
        libraries.set(libraries.get() + 1);
        if libraries.get() > MOST_LIBRARIES { Err(tobj::LoadError::GenericFailure) } else { load_mtl(path, library) }
    })
    .map_err(|e| bad("obj", e, "the file is damaged or no OBJ: export it again"))?;
    let materials =
        materials.map_err(|e| bad("mtllib", e, "put an intact MTL file beside the OBJ, at most 64 of them"))?;
    Ok((models, materials))
}

fn material<'a>(model: &Model, materials: &'a [Material]) -> Option<&'a Material> {
    materials.get(model.mesh.material_id?)
}

/// The texture of all faces; `None` where no face has one. Materials that no face uses do not count.
fn the_texture<'a>(models: &[Model], materials: &'a [Material], path: &Path) -> Result<Option<&'a str>, ImagingError> {
    let texture = |model: &Model| material(model, materials).and_then(|m| m.diffuse_texture.as_deref());
    let used: BTreeSet<Option<&str>> = models.iter().map(texture).collect();
    let names: Vec<&str> = used.iter().flatten().copied().collect();
    if used.len() <= 1 {
        return Ok(names.first().copied());
    }
    let plain = if used.contains(&None) { " and faces without" } else { "" };
    let what = format!("{} texture(s){plain}: {names:?}", names.len());
    Err(ImagingError::field(path, "map_Kd", what, "bake all materials into one texture (Blender: Bake, Diffuse)"))
}

fn load_texture(path: &Path, name: &str) -> Result<RgbImage, ImagingError> {
    let texture = path.with_file_name(name.replace('\\', "/"));
    match texture.is_file() {
        true => load_rgb(&texture),
        false => Err(ImagingError::MissingTexture { path: path.to_owned(), field: "map_Kd".into(), texture }),
    }
}

/// Reads a material file that lies in the OBJ's folder or below it.
fn load_mtl(obj: &Path, library: &Path) -> tobj::MTLLoadResult {
    let below = library.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    let path = obj.with_file_name(library);
    if !below || !path.is_file() {
        return Err(tobj::LoadError::OpenFileFailed);
    }
    let text = std::fs::read(path).map_err(|_| tobj::LoadError::ReadError)?;
    if !colours_are_whole(&text) {
        return Err(tobj::LoadError::MaterialParseError);
    }
    tobj::load_mtl_buf(&mut Cursor::new(text))
}

/// Whether each colour of a material file has its three numbers: tobj panics where one has fewer.
fn colours_are_whole(mtl: &[u8]) -> bool {
    String::from_utf8_lossy(mtl).lines().all(|line| {
        let mut words = line.split_whitespace();
        !matches!(words.next(), Some("Ka" | "Kd" | "Ks" | "Ke")) || words.count() >= 3
    })
}

fn to_byte(value: f32) -> u8 {
    (value * 255.0).round().clamp(0.0, 255.0) as u8
}

fn append(parts: &mut MeshParts, mesh: &tobj::Mesh, metres_per_unit: f64, has_uv: bool, has_normals: bool) {
    let offset = parts.vertices_m.len() as u32;
    let triples = |values: &[f32]| -> Vec<[f32; 3]> { values.as_chunks::<3>().0.to_vec() };
    let metres = |v: [f32; 3]| v.map(|c| (f64::from(c) * metres_per_unit) as f32);
    parts.vertices_m.extend(triples(&mesh.positions).into_iter().map(metres));
    if has_normals {
        parts.normals.extend(triples(&mesh.normals));
    }
    if has_uv {
        parts.texcoords.extend(mesh.texcoords.as_chunks::<2>().0);
    }
    let triangles = mesh.indices.as_chunks::<3>().0.iter();
    parts.triangles.extend(triangles.map(|t| t.map(|i| i + offset)));
}

/// Colours of the vertices stand before the material's: scanners write them beside a material that says nothing.
fn append_colours(parts: &mut MeshParts, mesh: &tobj::Mesh, diffuse: Option<[u8; 3]>) {
    let stated = mesh.vertex_color.as_chunks::<3>().0;
    parts.colours.extend(stated.iter().map(|c| c.map(to_byte)));
    parts.colours.resize(parts.vertices_m.len(), diffuse.unwrap_or([200; 3]));
}
