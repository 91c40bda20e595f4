//! Objects for tests and examples that need some, whatever they are.

use std::io::Result;
use std::path::{Path, PathBuf};

/// A `models` folder with one cuboid and one coloured pyramid, written to `folder`, which is returned.
///
/// # Errors
/// The folder cannot be written.
pub fn write_sample_objects(folder: &Path) -> Result<PathBuf> {
    let info = r#"{"1": {"diameter": 150.0, "min_x": -50, "min_y": -50, "min_z": -25, "size_x": 100, "size_y": 100, "size_z": 50},
        "4": {"diameter": 100.0, "min_x": -40, "min_y": -30, "min_z": 0, "size_x": 80, "size_y": 60, "size_z": 60}}"#;
    std::fs::write(folder.join("models_info.json"), info)?;
    let corner = |i: i32| format!("{} {} {}", 50 * (2 * (i & 1) - 1), 50 * ((i & 2) - 1), 25 * ((i & 4) / 2 - 1));
    let cube: Vec<String> =
        (0..8).map(|i| format!("{} {} {} {}", corner(i), 30 * i + 20, 200 - 20 * i, 90 + 11 * i)).collect();
    let cube_faces = ["0 2 3 1", "4 5 7 6", "0 1 5 4", "2 6 7 3", "0 4 6 2", "1 3 7 5"];
    write_ply(&folder.join("obj_000001.ply"), &cube, &cube_faces.map(|f| format!("4 {f}")))?;
    let pyramid =
        ["-40 -30 0 250 30 30", "40 -30 0 30 250 30", "40 30 0 30 30 250", "-40 30 0 250 250 30", "0 0 60 240 240 240"];
    let faces = ["4 0 3 2 1", "3 0 1 4", "3 1 2 4", "3 2 3 4", "3 3 0 4"];
    write_ply(&folder.join("obj_000004.ply"), &pyramid.map(String::from), &faces.map(String::from))?;
    Ok(folder.to_owned())
}

fn write_ply(path: &Path, vertices: &[String], faces: &[String]) -> Result<()> {
    let header = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\n\
         property uchar green\nproperty uchar blue\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n",
        vertices.len(),
        faces.len()
    );
    std::fs::write(path, header + &vertices.join("\n") + "\n" + &faces.join("\n") + "\n")
}
