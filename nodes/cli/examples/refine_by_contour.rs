//! One image and a rough pose in, a better pose out, by the object's contour alone: no network, no training.
//!
//!     cargo run --release --example refine_by_contour -- 2 out/refined.png
//!
//! The picture shows the rough pose in red and the refined one in green.

#![allow(clippy::print_stdout, reason = "an example talks to people")]

use pseudoflow_bag::{BagError, BagReader};
use pseudoflow_contour::{ContourModel, Image, ModelSettings, Refiner, Region, RegionConfig, Task};
use pseudoflow_geometry::{Intrinsics, Pose, pose_from_quaternion};
use pseudoflow_imaging::raster::{Rasteriser, SoftwareRasteriser};
use pseudoflow_imaging::{
    INITIAL_COLOUR, ObjectSet, REFINED_COLOUR, RgbImage, decode_rgb, draw_pose_contour, save_png,
};
use pseudoflow_msgs::ros::{CameraInfo, CompressedImage, Naming, RosMessage, object_poses};
use std::error::Error;
use std::path::Path;

const TABLETOP: &str = "config/objects/tabletop";
const BAG: &str = "bags/tabletop_demo";

/// The first message on a topic.
fn first<M: RosMessage>(bag: &mut BagReader, topic: &str) -> Result<M, BagError> {
    let topic = bag.topic(topic, &[M::type_name()])?;
    bag.read(topic, 0)
}

/// The first image of the demo's recording, its camera, and where an object roughly is.
fn rough_pose(root: &Path, id: u32) -> Result<(RgbImage, Intrinsics, Pose), Box<dyn Error>> {
    let bag = &mut BagReader::open(&root.join(BAG))?;
    let image: CompressedImage = first(bag, "/camera/image/compressed")?;
    let camera: CameraInfo = first(bag, "/camera/camera_info")?;
    // Ids serve as names where nobody gave names.
    let (poses, _) = object_poses(&first(bag, "/initial_poses")?, &Naming::default());
    let rough = poses.iter().find(|pose| pose.object_id == id).ok_or("no such object in the first frame")?;
    let rough = pose_from_quaternion(&rough.rotation_xyzw, &rough.translation_m)?;
    Ok((decode_rgb(&image.data, "the first image")?, Intrinsics::from_row_major(&camera.k)?, rough))
}

/// Refines an object of the demo's first image; `root` is where `config/` and `bags/` are.
pub(crate) fn refine(root: &Path, id: u32, picture: &Path) -> Result<(Pose, Region), Box<dyn Error>> {
    let (mut image, intrinsics, rough) = rough_pose(root, id)?;
    let objects = ObjectSet::load(&root.join(TABLETOP))?;
    let object = objects.get(id)?;

    // Where the contour is, seen from each of 642 sides. `load_or_make` keeps it on disk.
    let model = ContourModel::new(&object.mesh, &ModelSettings::default())?;
    let mut refiner = Refiner::new(RegionConfig::default())?;
    // The rough pose is where the steps begin, and what is known before: its expected errors weigh against the picture.
    let prior = refiner.prior(&rough, &model, object.diameter_m);
    let task = Task { image: Image { rgb: &image, intrinsics }, model: &model, prior: &prior, hiders: &[] };
    let region = refiner.refine(&task, &[rough], None);

    let mut rasteriser = SoftwareRasteriser::new();
    rasteriser.add_object(object.id, &object.mesh)?;
    for (pose, colour) in [(&rough, INITIAL_COLOUR), (&region.camera_from_object, REFINED_COLOUR)] {
        draw_pose_contour(&mut image, &rasteriser, object.id, pose, &intrinsics, colour)?;
    }
    save_png(&image, picture)?;
    Ok((rough, region))
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [id, picture] = arguments.as_slice() else { return Err("usage: refine_by_contour ID OUT.png".into()) };
    let (rough, region) = refine(Path::new("."), id.parse()?, Path::new(picture))?;
    let moved_m = (region.camera_from_object.translation.vector - rough.translation.vector).norm();
    println!(
        "{}: moved by {:.1} mm; {} lines agree to {:.2}",
        region.status,
        1e3 * moved_m,
        region.lines,
        region.agreement
    );
    Ok(())
}
