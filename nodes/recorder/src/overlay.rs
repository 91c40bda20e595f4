use pseudoflow_geometry::{Intrinsics, pose_from_quaternion};
use pseudoflow_imaging::raster::{Rasteriser, SoftwareRasteriser};
use pseudoflow_imaging::{INITIAL_COLOUR, ObjectSet, REFINED_COLOUR, RgbImage, draw_pose_contour};
use pseudoflow_msgs::ObjectPose;
use pseudoflow_runtime::NodeError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// How overlays are drawn.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OverlayConfig {
    /// Folder of the object set.
    pub objects: PathBuf,
    /// Folder for one picture a frame; none without.
    #[serde(default)]
    pub pictures: Option<PathBuf>,
}

/// Draws the contours of objects on frames.
pub struct Painter {
    rasteriser: SoftwareRasteriser,
}

impl Painter {
    /// Loads the meshes.
    ///
    /// # Errors
    /// When the object set cannot be read.
    pub fn open(config: &OverlayConfig) -> Result<Self, NodeError> {
        let mut rasteriser = SoftwareRasteriser::new();
        for object in ObjectSet::load(&config.objects)?.iter() {
            rasteriser.add_object(object.id, &object.mesh)?;
        }
        Ok(Self { rasteriser })
    }

    /// Draws the initial poses in red, then the refined ones in green.
    ///
    /// # Errors
    /// When a pose names an object that the set does not have.
    pub fn paint(
        &self,
        image: &mut RgbImage,
        intrinsics: &Intrinsics,
        initial: &[ObjectPose],
        refined: &[ObjectPose],
    ) -> Result<(), NodeError> {
        for (poses, colour) in [(initial, INITIAL_COLOUR), (refined, REFINED_COLOUR)] {
            for pose in poses {
                // A pose that is none has no contour; its status says so in /object_poses.
                if let Ok(at) = pose_from_quaternion(&pose.rotation_xyzw, &pose.translation_m) {
                    draw_pose_contour(image, &self.rasteriser, pose.object_id, &at, intrinsics, colour)?;
                }
            }
        }
        Ok(())
    }
}
