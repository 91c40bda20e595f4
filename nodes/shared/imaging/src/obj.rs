use crate::{ImagingError, Mesh, MeshParts, files::load_rgb};
use std::cell::Cell;
use std::io::Cursor;
use std::path::{Component, Path};

/// Material files of one OBJ: each is read again wherever the OBJ names it.
const MOST_LIBRARIES: usize = 64;

/// Reads a Wavefront OBJ with its MTL (`map_Kd` texture, else the materials' diffuse colours, else vertex colours).
/// `metres_per_unit` is 1.0 for OBJ files in metres. All shapes of the file become one mesh.
///
/// # Errors
/// When a file cannot be read, a texture is missing, the materials use more than one texture, or the mesh is not
/// usable ([`Mesh::new`]).
pub fn load_obj(path: &Path, metres_per_unit: f64) -> Result<Mesh, ImagingError> {
    let bad = |field: &str, what: String, remedy| ImagingError::field(path, field, what, remedy);
    let bytes = std::fs::read(path).map_err(ImagingError::io(path))?;
    let options = tobj::LoadOptions { triangulate: true, single_index: true, ..Default::default() };
    let libraries = Cell::new(0);
    let (models, materials) = tobj::load_obj_buf(&mut Cursor::new(bytes), &options, |library| {
        libraries.set(libraries.get() + 1);
        if libraries.get() > MOST_LIBRARIES { Err(tobj::LoadError::GenericFailure) } else { load_mtl(path, library) }
    })
    .map_err(|e| bad("obj", e.to_string(), "the file is damaged or no OBJ: export it again"))?;
    let materials = materials
        .map_err(|e| bad("mtllib", e.to_string(), "put an intact MTL file beside the OBJ, at most 64 of them"))?;
    let mut textures: Vec<&str> = materials.iter().filter_map(|m| m.diffuse_texture.as_deref()).collect();
    textures.sort_unstable();
    textures.dedup();
    if textures.len() > 1 {
        let what = format!("{} textures: {textures:?}", textures.len());
        return Err(bad("map_Kd", what, "bake them into one texture atlas"));
    }
    let mut parts = MeshParts::default();
    let has_uv = models.iter().all(|m| !m.mesh.texcoords.is_empty());
    let has_normals = models.iter().all(|m| !m.mesh.normals.is_empty());
    for model in &models {
        append(&mut parts, &model.mesh, metres_per_unit, has_uv, has_normals);
        let material = model.mesh.material_id.and_then(|id| materials.get(id));
        let diffuse = material.and_then(|m| m.diffuse).map(|c| c.map(to_byte));
        append_colours(&mut parts, &model.mesh, diffuse);
    }
    if let Some(name) = textures.first() {
        let texture = path.with_file_name(name.replace('\\', "/"));
        if !texture.is_file() {
            return Err(ImagingError::MissingTexture { path: path.to_owned(), field: "map_Kd".into(), texture });
        }
        if !has_uv {
            return Err(bad("vt", "a texture but no texture coordinates".into(), "export the mesh with its UV map"));
        }
        parts.texture = Some(load_rgb(&texture)?);
    }
    Mesh::new(parts, path)
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

fn append_colours(parts: &mut MeshParts, mesh: &tobj::Mesh, diffuse: Option<[u8; 3]>) {
    let white = diffuse.unwrap_or([200; 3]);
    let given = mesh.vertex_color.as_chunks::<3>().0;
    parts.colours.extend(given.iter().map(|c| c.map(to_byte)));
    parts.colours.resize(parts.vertices_m.len(), white);
}
