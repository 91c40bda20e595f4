//! What the demo saw, as pictures and as an animation.

use anyhow::{Context as _, Result};
use image::imageops::{FilterType, resize};
use pseudoflow_evaluator::live::{Arrival, ArrivedPose};
use pseudoflow_geometry::{Intrinsics, pose_from_quaternion};
use pseudoflow_imaging::raster::{Rasteriser, SoftwareRasteriser, View};
use pseudoflow_imaging::{ObjectSet, RgbImage, draw_contour, encode_gif, encode_jpeg};
use pseudoflow_player::{FrameSource, PlayerConfig, open_recording};
use std::collections::BTreeMap;
use std::path::Path;

/// A pose that its frame shows: green.
const MEASURED: [u8; 3] = [30, 230, 60];
/// A pose that is only believed: orange.
const PREDICTED: [u8; 3] = [255, 150, 20];
/// Width of the contours: they must be seen in the animation, which is less than half as large.
const LINE_PX: u32 = 2;
/// Every n-th frame becomes a picture.
const EVERY: u64 = 3;
/// The animation: width, quality of the pictures, pace.
const ANIMATION_WIDTH: u32 = 288;
const QUALITY: u8 = 90;
const MS_PER_FRAME: u32 = 100;
/// Pictures of the animation, the last ones: it stays below 3 MB.
const ANIMATED: usize = 50;

/// Draws the contours of the poses that came on every third frame: pictures in a folder, and an animation of the last ones.
pub(super) fn draw(player: &PlayerConfig, arrivals: &[Arrival], objects: &ObjectSet, out: &Path) -> Result<()> {
    let mut source = open_recording(player)?;
    let by_frame: BTreeMap<u64, &Arrival> = arrivals.iter().map(|arrival| (arrival.index, arrival)).collect();
    let painter = Painter::new(objects)?;
    let folder = out.join("overlays");
    std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
    let count = source.count() as u64;
    let frames = (0..).step_by(EVERY as usize).map_while(|i| Some((i, player.number_at(i, count)?)));
    let mut small = Vec::new();
    for (index, number) in frames {
        let picture = painter.paint(source.as_mut(), number as usize, by_frame.get(&index).copied())?;
        let path = folder.join(format!("{index:06}.jpg"));
        std::fs::write(&path, encode_jpeg(&picture, QUALITY)?).with_context(|| path.display().to_string())?;
        let height = picture.height() * ANIMATION_WIDTH / picture.width();
        small.push(resize(&picture, ANIMATION_WIDTH, height, FilterType::Triangle));
    }
    let path = out.join("demo.gif");
    let animation = encode_gif(&small[small.len().saturating_sub(ANIMATED)..], MS_PER_FRAME)?;
    std::fs::write(&path, animation).with_context(|| path.display().to_string())
}

struct Painter(SoftwareRasteriser);

impl Painter {
    fn new(objects: &ObjectSet) -> Result<Self> {
        let mut rasteriser = SoftwareRasteriser::new();
        for object in objects.iter() {
            rasteriser.add_object(object.id, &object.mesh)?;
        }
        Ok(Self(rasteriser))
    }

    fn paint(&self, source: &mut dyn FrameSource, number: usize, arrival: Option<&Arrival>) -> Result<RgbImage> {
        let frame = source.load(number)?;
        let (width, height) = (frame.header.width, frame.header.height);
        let mut image =
            RgbImage::from_raw(width, height, frame.rgb).context("a frame that is not as large as it says")?;
        let [fx, fy, cx, cy] = frame.header.intrinsics;
        let camera = Intrinsics { fx, fy, cx, cy };
        for pose in arrival.iter().flat_map(|arrival| &arrival.poses).filter(|pose| pose.published) {
            self.outline(&mut image, pose, &camera)?;
        }
        Ok(image)
    }

    fn outline(&self, image: &mut RgbImage, pose: &ArrivedPose, camera: &Intrinsics) -> Result<()> {
        let camera_from_object = pose_from_quaternion(&pose.rotation_xyzw, &pose.translation_m)?;
        let colour = if pose.predicted { PREDICTED } else { MEASURED };
        let (object_id, intrinsics) = (pose.object_id, *camera);
        let view = View { object_id, camera_from_object, intrinsics, width: image.width(), height: image.height() };
        for rendering in self.0.render(&[view])? {
            draw_contour(image, &rendering.mask, colour, LINE_PX);
        }
        Ok(())
    }
}
