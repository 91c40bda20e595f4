//! Object folders: OBJ beside PLY, units, and what is measured where nobody states it.

use nalgebra::Vector3;
use pseudoflow_geometry::{Intrinsics, Pose};
use pseudoflow_imaging::raster::{Rasteriser, Rendering, SoftwareRasteriser, View};
use pseudoflow_imaging::{Mesh, ObjectSet, load_obj};
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A block of 60 x 40 x 80 mm with a red and a blue half, in metres.
const BLOCK: &str = "mtllib block.mtl
v -0.03 -0.02 -0.04\nv 0.03 -0.02 -0.04\nv 0.03 0.02 -0.04\nv -0.03 0.02 -0.04
v -0.03 -0.02 0.04\nv 0.03 -0.02 0.04\nv 0.03 0.02 0.04\nv -0.03 0.02 0.04
usemtl red\nf 1 4 3 2\nf 1 2 6 5\nf 2 3 7 6
usemtl blue\nf 5 6 7 8\nf 3 4 8 7\nf 4 1 5 8
";
const PAINT: &str = "newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n";

fn folder(files: &[(&str, &str)]) -> TempDir {
    let folder = TempDir::new().unwrap();
    files.iter().for_each(|(name, text)| fs::write(folder.path().join(name), text).unwrap());
    folder
}

fn refused(files: &[(&str, &str)], parts: &[&str]) {
    let folder = folder(files);
    let message = ObjectSet::load(folder.path()).unwrap_err().to_string();
    parts.iter().for_each(|part| assert!(message.contains(part), "`{message}` does not say `{part}`"));
}

#[test]
fn an_obj_in_metres_is_measured_where_nothing_is_stated() {
    let metres = ("models_info.json", r#"{"1": {"mesh_unit": "m"}}"#);
    let folder = folder(&[("obj_000001.obj", BLOCK), ("block.mtl", PAINT), metres]);
    ObjectSet::check(folder.path()).unwrap();
    let set = ObjectSet::load(folder.path()).unwrap();
    let object = set.get(1).unwrap();
    let near = |a: f64, b: f64| (a - b).abs() < 1e-6;
    assert!(near(object.diameter_m, Vector3::new(0.06, 0.04, 0.08).norm()), "{}", object.diameter_m);
    assert!(near(object.low_m.z, -0.04) && near(object.extents_m.y, 0.04));
    assert!(object.mesh.closed && object.symmetries.discrete.is_empty());
    assert!(object.mesh.colours.contains(&[255, 0, 0]) && object.mesh.colours.contains(&[0, 0, 255]));
    assert_eq!(object.mesh_file.as_ref().unwrap().metres_per_unit, 1.0);
}

#[test]
fn a_folder_of_meshes_alone_is_a_set_in_millimetres() {
    let millimetres = BLOCK.replace("0.02", "20").replace("0.03", "30").replace("0.04", "40");
    let folder = folder(&[("obj_000012.obj", &millimetres), ("block.mtl", PAINT), ("mug.ply", "of no matter")]);
    let set = ObjectSet::load(folder.path()).unwrap();
    assert_eq!(set.ids(), [12]);
    assert!((set.get(12).unwrap().diameter_m - 0.107_7).abs() < 1e-4, "{}", set.get(12).unwrap().diameter_m);
}

#[test]
fn what_cannot_be_meant_is_refused_with_a_remedy() {
    refused(&[("mug.obj", BLOCK)], &["no objects", "obj_000001.obj", "mug.obj", "models_info.json"]);
    refused(&[("models_info.json", r#"{"7": {}}"#)], &["object 7", "obj_000007.ply nor obj_000007.obj"]);
    refused(&[("obj_000001.obj", BLOCK), ("block.mtl", PAINT)], &["wrong unit?", r#"{"1": {"mesh_unit": "m"}}"#]);
    let parsec = ("models_info.json", r#"{"1": {"mesh_unit": "parsec"}}"#);
    refused(&[("obj_000001.obj", BLOCK), parsec], &["models_info.json", "parsec", "`mm`"]);
    let wrong = ("models_info.json", r#"{"1": {"mesh_unit": "m", "diameter": 200}}"#);
    refused(&[("obj_000001.obj", BLOCK), ("block.mtl", PAINT), wrong], &["1.diameter", "0.2 m", "agree"]);
    refused(&[("obj_000001.obj", BLOCK)], &["mtllib", "beside the OBJ"]);
}

#[test]
fn a_surface_has_one_texture_or_none() {
    let metres = ("models_info.json", r#"{"1": {"mesh_unit": "m"}}"#);
    let said = |paint: &str, parts: &[&str]| {
        refused(&[("obj_000001.obj", BLOCK), ("block.mtl", paint), metres], parts);
    };
    let both = PAINT.replace("Kd 1 0 0", "map_Kd a.png").replace("Kd 0 0 1", "map_Kd b.png");
    said(&both, &["map_Kd", "2 texture(s)", "a.png", "b.png", "bake"]);
    said(&PAINT.replace("Kd 1 0 0", "map_Kd a.png"), &["1 texture(s) and faces without", "bake"]);
    said(&both.replace("b.png", "a.png"), &["`vt`", "UV map"]);
    // A material that no face uses may name what it likes.
    let unused = format!("{PAINT}newmtl other\nmap_Kd c.png\n");
    let folder = folder(&[("obj_000001.obj", BLOCK), ("block.mtl", &unused), metres]);
    assert!(load_obj(&folder.path().join("obj_000001.obj"), 1.0).unwrap().texture.is_none());
}

/// A mesh as an OBJ in metres, with a material that names a texture.
fn as_obj(mesh: &Mesh) -> String {
    let mut text = "mtllib a.mtl\nusemtl a\n".to_owned();
    mesh.vertices_m.iter().for_each(|[x, y, z]| writeln!(text, "v {x} {y} {z}").unwrap());
    mesh.texcoords.iter().for_each(|[u, v]| writeln!(text, "vt {u} {v}").unwrap());
    mesh.normals.iter().for_each(|[x, y, z]| writeln!(text, "vn {x} {y} {z}").unwrap());
    for corners in &mesh.triangles {
        let [a, b, c] = corners.map(|i| format!("{0}/{0}/{0}", i + 1));
        writeln!(text, "f {a} {b} {c}").unwrap();
    }
    text
}

fn picture(folder: &Path, id: u32) -> Rendering {
    let object = ObjectSet::load(folder).unwrap().get(id).unwrap().clone();
    let mut rasteriser = SoftwareRasteriser::new();
    rasteriser.add_object(id, &object.mesh).unwrap();
    let camera_from_object = Pose::new(Vector3::new(0.0, 0.0, 0.6), Vector3::new(1.2, 0.4, -0.3));
    let intrinsics = Intrinsics { fx: 300.0, fy: 300.0, cx: 79.5, cy: 79.5 };
    let view = View { object_id: id, camera_from_object, intrinsics, width: 160, height: 160 };
    rasteriser.render(&[view]).unwrap().remove(0)
}

#[test]
fn the_same_object_as_ply_and_as_obj_renders_the_same_picture() {
    let tabletop = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../config/objects/tabletop"));
    let object = ObjectSet::load(&tabletop).unwrap().get(5).unwrap().clone();
    let paint = "newmtl a\nmap_Kd obj_000005.png\n";
    let metres = ("models_info.json", r#"{"5": {"mesh_unit": "m"}}"#);
    let folder = folder(&[("obj_000005.obj", &as_obj(&object.mesh)), ("a.mtl", paint), metres]);
    fs::copy(tabletop.join("obj_000005.png"), folder.path().join("obj_000005.png")).unwrap();
    let (ply, obj) = (picture(&tabletop, 5), picture(folder.path(), 5));
    assert!(ply.foreground_px() > 1000 && ply.mask == obj.mask);
    let differences = ply.rgb.iter().zip(obj.rgb.iter()).map(|(a, b)| a.abs_diff(*b));
    assert!(differences.max() <= Some(1), "colours differ by more than rounding");
}
