//! Loading meshes, object sets and scenes from files written here, good ones and bad ones.

use pseudoflow_imaging::{BopScene, ImagingError, ObjectSet, RgbImage, list_scenes, load_obj, load_ply, save_png};
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A tetrahedron with legs of 60 mm, in millimetres.
const VERTICES: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [60.0, 0.0, 0.0], [0.0, 60.0, 0.0], [0.0, 0.0, 60.0]];
const FACES: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
const INFO: &str =
    r#"{"diameter": 84.8528, "min_x": 0, "min_y": 0, "min_z": 0, "size_x": 60, "size_y": 60, "size_z": 60}"#;

fn header(format: &str, comment: &str, vertex: &str, faces: usize, face: &str) -> String {
    format!(
        "ply\nformat {format} 1.0\n{comment}element vertex 4\nproperty float x\nproperty float y\nproperty float z\n{vertex}\
         element face {faces}\nproperty list uchar int vertex_indices\n{face}end_header\n"
    )
}

fn ascii() -> String {
    let mut text = header("ascii", "", "", 4, "");
    VERTICES.iter().for_each(|v| text += &format!("{} {} {}\n", v[0], v[1], v[2]));
    FACES.iter().for_each(|f| text += &format!("3 {} {} {}\n", f[0], f[1], f[2]));
    text
}

fn write(folder: &TempDir, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
    let path = folder.path().join(name);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(&path, bytes).unwrap();
    path
}

fn set_error(ply: impl AsRef<[u8]>, info: &str) -> String {
    let folder = TempDir::new().unwrap();
    write(&folder, "obj_000004.ply", ply);
    write(&folder, "models_info.json", format!("{{\"4\": {info}}}"));
    ObjectSet::load(folder.path()).unwrap_err().to_string()
}

fn assert_holds(message: &str, parts: &[&str]) {
    parts.iter().for_each(|part| assert!(message.contains(part), "`{message}` does not say `{part}`"));
}

#[test]
fn ascii_ply_in_millimetres_becomes_metres() {
    let folder = TempDir::new().unwrap();
    let mesh = load_ply(&write(&folder, "a.ply", ascii()), 1e-3).unwrap();
    assert_eq!(mesh.vertices_m[3], [0.0, 0.0, 0.06]);
    assert_eq!(mesh.triangles, FACES);
    assert!(mesh.closed);
    assert!(mesh.normals.iter().all(|n| (n.iter().map(|c| c * c).sum::<f32>() - 1.0).abs() < 1e-5));
}

#[test]
fn binary_ply_has_colours_and_normals() {
    let folder = TempDir::new().unwrap();
    let vertex = "property float nx\nproperty float ny\nproperty float nz\n\
                  property uchar red\nproperty uchar green\nproperty uchar blue\n";
    let mut bytes = header("binary_little_endian", "", vertex, 4, "").into_bytes();
    for (i, v) in VERTICES.iter().enumerate() {
        v.iter().chain(&[0.0, 2.0, 0.0]).for_each(|c| bytes.extend(c.to_le_bytes()));
        bytes.extend([10 * i as u8, 20, 30]);
    }
    for face in FACES {
        bytes.push(3);
        face.iter().for_each(|i| bytes.extend(i.to_le_bytes()));
    }
    let mesh = load_ply(&write(&folder, "b.ply", &bytes), 1e-3).unwrap();
    assert_eq!(mesh.colours[2], [20, 20, 30]);
    assert_eq!(mesh.normals[1], [0.0, 1.0, 0.0]);
    let cut = &bytes[..bytes.len() - 3];
    let message = load_ply(&write(&folder, "cut.ply", cut), 1e-3).unwrap_err().to_string();
    assert_holds(&message, &["cut.ply", "element face", "entry 3 of 4", "copy it again"]);
}

#[test]
fn texture_coordinates_by_face_double_the_vertices_at_seams() {
    let folder = TempDir::new().unwrap();
    save_png(&RgbImage::new(4, 4), &folder.path().join("t.png")).unwrap();
    let mut text = header("ascii", "comment TextureFile t.png\n", "", 2, "property list uchar float texcoord\n");
    VERTICES.iter().for_each(|v| text += &format!("{} {} {}\n", v[0], v[1], v[2]));
    text += "3 0 2 1 6 0 0 1 0 0 1\n3 0 1 3 6 0.5 0 0 1 1 1\n";
    let mesh = load_ply(&write(&folder, "f.ply", text), 1e-3).unwrap();
    assert_eq!(mesh.vertices_m.len(), 5, "vertex 0 has two coordinates, vertex 1 one");
    assert_eq!(mesh.texcoords[mesh.triangles[1][0] as usize], [0.5, 0.0]);
    assert_eq!(mesh.texture.as_ref().unwrap().levels().len(), 3);
}

#[test]
fn a_quad_becomes_two_triangles() {
    let folder = TempDir::new().unwrap();
    let text = header("ascii", "", "", 1, "") + "0 0 0\n60 0 0\n60 60 0\n0 60 0\n4 0 1 2 3\n";
    assert_eq!(load_ply(&write(&folder, "q.ply", text), 1e-3).unwrap().triangles, [[0, 1, 2], [0, 2, 3]]);
}

#[test]
fn a_bad_mesh_is_named_with_field_and_remedy() {
    let no_faces = header("ascii", "", "", 0, "") + "0 0 0\n60 0 0\n60 60 0\n0 60 0\n";
    assert_holds(&set_error(no_faces, INFO), &["obj_000004.ply", "no faces", "triangles"]);
    let nan = ascii().replacen("60 0 0\n", "nan 0 0\n", 1);
    assert_holds(&set_error(nan, INFO), &["obj_000004.ply", "`x, y, z` of vertex 1", "not finite"]);
    let range = ascii().replacen("3 1 2 3", "3 1 2 9", 1);
    assert_holds(&set_error(range, INFO), &["obj_000004.ply", "face 3", "index 9", "4 vertices"]);
    let texture = ascii().replacen("element vertex", "comment TextureFile gone.png\nelement vertex", 1);
    assert_holds(&set_error(texture, INFO), &["obj_000004.ply", "TextureFile", "gone.png", "does not exist"]);
    assert_holds(&set_error("solid cube", INFO), &["obj_000004.ply", "PLY"]);
    assert_holds(&set_error(ascii().replace("ascii", "binary_big_endian"), INFO), &["binary_big_endian", "ascii"]);
    let huge = ascii().replace("element face 4", "element face 4000000000");
    assert_holds(&set_error(huge, INFO), &["element face", "4000000000 entries do not fit"]);
    let cut = ascii().replacen("3 1 2 3\n", "3 1 2", 1);
    assert_holds(&set_error(cut, INFO), &["element face", "entry 3 of 4"]);
    let twice = ascii().replacen("element face", "element vertex 1\nproperty float w\nelement face", 1);
    assert_holds(&set_error(twice, INFO), &["element vertex", "the element is there twice"]);
    let column_twice = ascii().replacen("property float y", "property float x", 1);
    assert_holds(&set_error(column_twice, INFO), &["element vertex", "property x is there twice"]);
    let empty_rows = ascii().replacen("element face", "element nothing 99999999999\nelement face", 1);
    assert_holds(&set_error(empty_rows, INFO), &["element nothing", "do not fit"]);
}

#[test]
fn a_wrong_unit_is_suspected_by_the_diameter() {
    let metres = INFO.replace("84.8528", "0.0848528");
    assert_holds(&set_error(ascii(), &metres), &["models_info.json", "4.diameter", "wrong unit?", "millimetres"]);
    let mesh_in_metres = ascii().replace("60", "0.06");
    assert_holds(&set_error(mesh_in_metres, INFO), &["obj_000004.ply", "wrong unit?", "0.005 m .. 5 m"]);
    let twice = INFO.replace("84.8528", "170");
    assert_holds(&set_error(ascii(), &twice), &["models_info.json", "4.diameter", "0.17 m", "agree"]);
}

#[test]
fn an_object_set_knows_its_objects() {
    let folder = TempDir::new().unwrap();
    write(&folder, "obj_000004.ply", ascii());
    let symmetric = INFO.replace(
        '}',
        r#", "symmetries_discrete": [[-1,0,0,30, 0,-1,0,-4, 0,0,1,0, 0,0,0,1]],
            "symmetries_continuous": [{"axis": [0,0,2], "offset": [5,0,0]}]}"#,
    );
    write(&folder, "models_info.json", format!("{{\"4\": {symmetric}}}"));
    write(&folder, "names.json", r#"{"4": "wedge", "9": "not here"}"#);
    let set = ObjectSet::load(folder.path()).unwrap();
    let object = set.get(4).unwrap();
    assert_eq!((object.name.as_str(), object.id, set.len()), ("wedge", 4, 1));
    assert!((object.diameter_m - 0.084_852_8).abs() < 1e-9 && (object.extents_m.x - 0.06).abs() < 1e-12);
    assert!((object.symmetries.discrete[0].translation.x - 0.03).abs() < 1e-12);
    assert!((object.symmetries.continuous[0].offset_m.x - 0.005).abs() < 1e-12);
    assert!((object.symmetries.continuous[0].axis.z - 1.0).abs() < 1e-12);
    let message = set.get(5).unwrap_err().to_string();
    assert_holds(&message, &["unknown object id 5", "[4]"]);
}

#[test]
fn obj_reads_its_material_and_texture() {
    let folder = TempDir::new().unwrap();
    let text = "mtllib a.mtl\nv 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n";
    let path = write(&folder, "a.obj", text);
    let mtl = "newmtl m\nKd 1 0.5 0\nmap_Kd t.png\n";
    write(&folder, "a.mtl", mtl);
    assert!(matches!(load_obj(&path, 1.0), Err(ImagingError::MissingTexture { .. })));
    save_png(&RgbImage::new(8, 8), &folder.path().join("t.png")).unwrap();
    let mesh = load_obj(&path, 1.0).unwrap();
    assert!(mesh.texture.is_some() && mesh.texcoords[1] == [1.0, 0.0] && mesh.vertices_m[1] == [0.1, 0.0, 0.0]);
    write(&folder, "a.mtl", "newmtl m\nKd 1 0.5 0\n");
    let mesh = load_obj(&path, 1.0).unwrap();
    assert!(mesh.texture.is_none());
    assert_eq!(mesh.colours[0], [255, 128, 0]);
    let missing = load_obj(&folder.path().join("gone.obj"), 1.0).unwrap_err().to_string();
    assert_holds(&missing, &["gone.obj", "exists"]);
}

fn scene(folder: &TempDir, camera_matrix: &str, rotation: &str) -> PathBuf {
    let name = "test/000007";
    write(folder, &format!("{name}/scene_camera.json"), format!("{{\"12\": {{\"cam_K\": {camera_matrix}}}}}"));
    let poses = format!("{{\"12\": [{{\"obj_id\": 4, \"cam_R_m2c\": {rotation}, \"cam_t_m2c\": [10, -20, 800]}}]}}");
    write(folder, &format!("{name}/init_poses.json"), poses);
    folder.path().join(name)
}

const K: &str = "[600, 0, 320, 0, 610, 240, 0, 0, 1]";
const IDENTITY: &str = "[1,0,0, 0,1,0, 0,0,1]";

#[test]
fn a_scene_is_read_without_its_truth() {
    let folder = TempDir::new().unwrap();
    let path = scene(&folder, K, IDENTITY);
    assert!(matches!(BopScene::open(&path), Err(ImagingError::MissingImage { image_id: 12, .. })));
    fs::create_dir(path.join("gray")).unwrap();
    image::GrayImage::from_pixel(6, 4, image::Luma([77])).save(path.join("gray/000012.png")).unwrap();
    // A truth that cannot even be parsed changes nothing: nobody opens it.
    fs::write(path.join("scene_gt.json"), "not json").unwrap();
    let scene = BopScene::open(&path).unwrap();
    assert_eq!((scene.scene_id, scene.frames.len()), (7, 1));
    let frame = scene.frame(12).unwrap();
    assert_eq!(frame.load_image().unwrap().get_pixel(5, 3).0, [77; 3]);
    assert!(frame.load_depth().unwrap().is_none());
    let pose = frame.initial_poses[0].camera_from_object;
    assert!((pose.translation.vector - nalgebra::Vector3::new(0.01, -0.02, 0.8)).norm() < 1e-12);
    assert_eq!(list_scenes(&folder.path().join("test")).unwrap(), [path]);
    assert!(list_scenes(folder.path()).is_err());
}

#[test]
fn bad_cameras_and_poses_are_named() {
    let folder = TempDir::new().unwrap();
    let error = |k: &str, r: &str| {
        let path = scene(&folder, k, r);
        fs::create_dir_all(path.join("rgb")).unwrap();
        fs::write(path.join("rgb/000012.jpg"), "").unwrap();
        BopScene::open(&path).unwrap_err().to_string()
    };
    assert_holds(&error("[0,0,0,0,0,0,0,0,0]", IDENTITY), &["scene_camera.json", "12.cam_K", "calibrated"]);
    assert_holds(&error(K, "[1,0,0, 0,1,0, 0,0,-1]"), &["init_poses.json", "12[0]", "not a rotation"]);
    assert_holds(&error("[1, 2]", IDENTITY), &["scene_camera.json", "line 1"]);
}

#[test]
fn the_data_of_this_project_loads() {
    let shared = std::env::var_os("PSEUDOFLOW_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../../shared"), PathBuf::from);
    for (name, ids) in [("tabletop", vec![1, 2, 3, 5, 7]), ("cube", vec![1]), ("mustard", vec![5])] {
        let folder = shared.join("data").join(name);
        if !folder.is_dir() {
            eprintln!("SKIPPED: {} is not there (set PSEUDOFLOW_SHARED)", folder.display());
            continue;
        }
        let set = ObjectSet::load(&folder.join("models")).unwrap();
        assert_eq!(set.ids(), ids);
        assert!(set.iter().all(|o| o.mesh.texture.is_some() && o.mesh.closed), "{name}");
        for scene in list_scenes(&folder.join("test")).unwrap() {
            let scene = BopScene::open(&scene).unwrap();
            let frame = scene.frames.iter().find(|f| !f.initial_poses.is_empty()).unwrap();
            assert!(frame.load_image().unwrap().width() >= 640);
        }
    }
}
