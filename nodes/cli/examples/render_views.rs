//! Views of a mesh, rendered to PNG files: colour, and depth as a heat map.
//!
//!     cargo run --release --example render_views -- config/objects/tabletop out/views

#![allow(clippy::print_stdout, reason = "an example talks to people")]

use nalgebra::Vector3;
use pseudoflow_geometry::{Intrinsics, Pose};
use pseudoflow_imaging::raster::{Rasteriser, Rendering, SoftwareRasteriser, View};
use pseudoflow_imaging::{Object, ObjectSet, RgbImage, heat_map, save_png, side_by_side};
use std::error::Error;
use std::path::{Path, PathBuf};

const SIZE_PX: u32 = 256;

/// Four looks at an object from around it, three diameters away.
fn views(object: &Object) -> Vec<View> {
    let focal_px = 2.5 * f64::from(SIZE_PX);
    let centre = f64::from(SIZE_PX - 1) / 2.0; // pixel centres lie at integers
    let intrinsics = Intrinsics { fx: focal_px, fy: focal_px, cx: centre, cy: centre };
    let away = Pose::translation(0.0, 0.0, 3.0 * object.diameter_m);
    let tilt = Pose::rotation(Vector3::x() * -2.0);
    let to_middle = Pose::from(-object.box_centre_m().coords);
    let turned = |i: u32| away * tilt * Pose::rotation(Vector3::z() * f64::from(i) * 1.57) * to_middle;
    let (object_id, width, height) = (object.id, SIZE_PX, SIZE_PX);
    let view = |i| View { object_id, camera_from_object: turned(i), intrinsics, width, height };
    (0..4).map(view).collect()
}

/// The nearest point white, the farthest black, the background blue.
fn depth_picture(rendering: &Rendering) -> RgbImage {
    let depths = || rendering.depth_m.iter().copied().filter(|depth_m| *depth_m > 0.0);
    let (near_m, far_m) = (depths().fold(f32::MAX, f32::min), depths().fold(0.0, f32::max));
    let or_nan = |depth_m: &f32| if *depth_m > 0.0 { *depth_m } else { f32::NAN };
    let values: Vec<f32> = rendering.depth_m.iter().map(or_nan).collect();
    heat_map(&values, rendering.width(), rendering.height(), far_m, near_m)
}

/// Writes the views of every object of a folder and returns the files.
pub(crate) fn render(objects: &Path, out: &Path) -> Result<Vec<PathBuf>, Box<dyn Error>> {
    std::fs::create_dir_all(out)?;
    let mut rasteriser = SoftwareRasteriser::new();
    let mut files = Vec::new();
    for object in ObjectSet::load(objects)?.iter() {
        rasteriser.add_object(object.id, &object.mesh)?;
        for (i, rendering) in rasteriser.render(&views(object))?.iter().enumerate() {
            let file = out.join(format!("{}_{i}.png", object.name));
            save_png(&side_by_side(&rendering.rgb, &depth_picture(rendering)), &file)?;
            files.push(file);
        }
    }
    Ok(files)
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [objects, out] = arguments.as_slice() else { return Err("usage: render_views OBJECTS OUT".into()) };
    for file in render(Path::new(objects), Path::new(out))? {
        println!("{}", file.display());
    }
    Ok(())
}
