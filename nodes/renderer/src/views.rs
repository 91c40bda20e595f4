//! Which views of a frame to render, and the renderings and crops in the layout of the message.

use pseudoflow_geometry::{Crop, Intrinsics, Jitter, Pose, pose_from_quaternion, quaternion_xyzw};
use pseudoflow_imaging::raster::View;
use pseudoflow_imaging::{ImagingError, ObjectSet};
use pseudoflow_msgs::{ObjectPose, PoseStatus};
use rand::Rng;

/// How views are made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewSettings {
    /// Width and height of crops and renderings, pixels.
    pub size_px: u32,
    /// Renderings of each instance: the initial pose itself and `views - 1` jittered ones.
    pub views: u32,
    /// Side of the crop over the larger side of the projection's bounding box.
    pub margin: f64,
}

/// One instance whose views are to be rendered.
#[derive(Debug, Clone)]
pub struct PlannedInstance {
    /// Its place among the poses that came in.
    pub place: usize,
    /// The pose that came in.
    pub initial: ObjectPose,
    /// `camera_from_object` of each view; the first is the initial pose, the others lie around it or a better one.
    pub poses: Vec<Pose>,
    /// The crop, the same for all views.
    pub crop: Crop,
    /// The crop's K'.
    pub crop_intrinsics: Intrinsics,
    /// Diameter of the object, metres.
    pub diameter_m: f64,
}

/// The views of a frame.
#[derive(Debug, Clone, Default)]
pub struct Plan {
    /// What is rendered.
    pub instances: Vec<PlannedInstance>,
    /// Initial poses that cannot be: not finite, behind the camera, or with a crop outside the image.
    pub skipped: Vec<ObjectPose>,
}

impl Plan {
    /// What the rasteriser has to draw: instance by instance, view by view.
    #[must_use]
    pub fn rasteriser_views(&self, size_px: u32) -> Vec<View> {
        let of = |instance: &PlannedInstance, pose: &Pose| View {
            object_id: instance.initial.object_id,
            camera_from_object: *pose,
            intrinsics: instance.crop_intrinsics,
            width: size_px,
            height: size_px,
        };
        self.instances.iter().flat_map(|i| i.poses.iter().map(move |pose| of(i, pose))).collect()
    }
}

/// Decides crops and view poses for the initial poses of a frame of `width` x `height` pixels. `around` may hold better
/// poses of the same objects (those of a first look), which the further views are laid around; the crop and the first
/// view stay with the initial pose, as the network meets it in use.
///
/// # Errors
/// When a pose names an object that the set does not have.
pub fn plan(
    initial: &[ObjectPose],
    around: &[ObjectPose],
    objects: &ObjectSet,
    intrinsics: &Intrinsics,
    (width, height): (u32, u32),
    settings: &ViewSettings,
    rng: &mut impl Rng,
) -> Result<Plan, ImagingError> {
    let mut plan = Plan::default();
    for (place, pose) in initial.iter().enumerate() {
        let object = objects.get(pose.object_id)?;
        let jitter = Jitter::views(object.diameter_m);
        let better = around.iter().find(|p| p.identity() == pose.identity());
        let better = better.and_then(|p| pose_from_quaternion(&p.rotation_xyzw, &p.translation_m).ok());
        match crop_around(pose, objects, intrinsics, (width, height), settings)? {
            None => plan.skipped.push(ObjectPose { status: PoseStatus::NotVisible as u32, ..*pose }),
            Some((at, crop)) => plan.instances.push(PlannedInstance {
                place,
                initial: *pose,
                poses: view_poses(&at, &better.unwrap_or(at), &jitter, settings.views, rng),
                crop,
                crop_intrinsics: crop.intrinsics(intrinsics),
                diameter_m: object.diameter_m,
            }),
        }
    }
    Ok(plan)
}

/// The crop around an object at a rough pose; `None` when the pose is not one or shows nothing of the image.
pub(crate) fn crop_around(
    pose: &ObjectPose,
    objects: &ObjectSet,
    intrinsics: &Intrinsics,
    (width, height): (u32, u32),
    settings: &ViewSettings,
) -> Result<Option<(Pose, Crop)>, ImagingError> {
    let object = objects.get(pose.object_id)?;
    Ok(pose_from_quaternion(&pose.rotation_xyzw, &pose.translation_m).ok().and_then(|at| {
        let crop = Crop::around(&object.hull_m, &at, intrinsics, settings.margin, settings.size_px)?;
        overlaps(&crop, width, height).then_some((at, crop))
    }))
}

/// The initial pose and `views - 1` around `centre`, all in front of the camera.
fn view_poses(initial: &Pose, centre: &Pose, jitter: &Jitter, views: u32, rng: &mut impl Rng) -> Vec<Pose> {
    // From such a centre at least half of the samples are good ones; chance may be against us, but not for ever.
    const MOST_TRIES: u32 = 64;
    let in_front = |pose: &Pose| pose.translation.z > 0.5 * initial.translation.z;
    // A better pose that is so much nearer to the camera is none.
    let centre = if in_front(centre) { centre } else { initial };
    let mut jittered = || (0..MOST_TRIES).map(|_| jitter.sample(centre, rng)).find(in_front).unwrap_or(*initial);
    std::iter::once(*initial).chain((1..views).map(|_| jittered())).collect()
}

/// The pose of a view as the message carries it.
pub(crate) fn with_pose(initial: &ObjectPose, view: usize, pose: &Pose) -> ObjectPose {
    if view == 0 {
        return *initial;
    }
    let translation_m = pose.translation.vector.into();
    ObjectPose { rotation_xyzw: quaternion_xyzw(pose), translation_m, ..*initial }
}

/// Whether a crop shows any part of the image.
fn overlaps(crop: &Crop, width: u32, height: u32) -> bool {
    let within = |low: f64, length: u32| low < f64::from(length) - 0.5 && low + crop.side > -0.5;
    within(crop.x0, width) && within(crop.y0, height)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn views_are_found_whatever_the_better_pose_is() {
        let at = |z| Pose::translation(0.0, 0.0, z);
        let jitter = Jitter::views(0.2);
        let mut rng = rand::rngs::StdRng::seed_from_u64(1);
        for (initial, around) in [(1.0, 1.1), (1.0, 0.4), (1.0, -3.0), (0.01, 0.01), (-0.1, -0.1), (0.0, 0.0)] {
            let poses = view_poses(&at(initial), &at(around), &jitter, 4, &mut rng);
            assert_eq!((poses.len(), poses[0]), (4, at(initial)));
            assert!(poses[1..].iter().all(|pose| *pose == at(initial) || pose.translation.z > 0.5 * initial));
        }
        let around = view_poses(&at(1.0), &at(1.1), &jitter, 16, &mut rng);
        assert!(around[1..].iter().all(|pose| (pose.translation.z - 1.1).abs() < 0.2), "around the better pose");
    }
}
