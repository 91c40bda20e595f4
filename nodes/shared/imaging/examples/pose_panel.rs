//! Writes panels for looking at: real crop, rendering at the initial pose, and the crop with the pose's contour.
//!
//! `cargo run --release -p pseudoflow-imaging --example pose_panel -- DATASET/models DATASET/test/000001 OUT.png [IMAGE_ID]`
#![allow(clippy::print_stdout)] // an example talks to people

use pseudoflow_geometry::Crop;
use pseudoflow_imaging::raster::{Rasteriser, SoftwareRasteriser, View};
use pseudoflow_imaging::{BopScene, INITIAL_COLOUR, ObjectSet, draw_contour, resample, save_png, side_by_side};

const SIZE_PX: u32 = 256;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [models, scene, out, rest @ ..] = arguments.as_slice() else {
        return Err("usage: pose_panel MODELS SCENE OUT.png [IMAGE_ID]".into());
    };
    let set = ObjectSet::load(models.as_ref())?;
    let mut rasteriser = SoftwareRasteriser::new();
    for object in set.iter() {
        rasteriser.add_object(object.id, &object.mesh)?;
    }
    let scene = BopScene::open(scene.as_ref())?;
    let frame = match rest.first() {
        Some(id) => scene.frame(id.parse()?)?,
        None => scene.frames.first().ok_or("the scene has no image")?,
    };
    let image = frame.load_image()?;
    let mut rows = Vec::new();
    for initial in &frame.initial_poses {
        let object = set.get(initial.object_id)?;
        let pose = initial.camera_from_object;
        let Some(crop) = Crop::around(&object.hull_m, &pose, &frame.intrinsics, 1.1, SIZE_PX) else { continue };
        let real = resample(&image, &crop);
        let intrinsics = crop.intrinsics(&frame.intrinsics);
        let view = View { object_id: object.id, camera_from_object: pose, intrinsics, width: SIZE_PX, height: SIZE_PX };
        let rendering = rasteriser.render(&[view])?.remove(0);
        let mut contour = real.clone();
        draw_contour(&mut contour, &rendering.mask, INITIAL_COLOUR, 1);
        rows.push(side_by_side(&side_by_side(&real, &rendering.rgb), &contour));
        println!("{}: {} px of foreground", object.name, rendering.foreground_px());
    }
    let (width, height) = (3 * SIZE_PX + 8, SIZE_PX);
    let mut panel = pseudoflow_imaging::RgbImage::new(width, height * rows.len() as u32);
    for (i, row) in rows.iter().enumerate() {
        image::imageops::replace(&mut panel, row, 0, i64::from(height) * i as i64);
    }
    save_png(&panel, out.as_ref())?;
    Ok(())
}
