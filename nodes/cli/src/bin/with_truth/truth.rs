//! True poses of the images and the flow that they mean.

use anyhow::{Context as _, Result, bail};
use nalgebra::{Matrix3, Point2, Rotation3, UnitQuaternion, Vector3};
use pseudoflow_geometry::{Intrinsics, Pose, pose_from_quaternion};
use pseudoflow_imaging::ObjectSet;
use pseudoflow_imaging::raster::{Rasteriser, SoftwareRasteriser, View};
use pseudoflow_msgs::ReferenceViews;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// A surface point is seen when the true scene is this near to it, share of its distance: 2 mm at a metre.
const DEPTH_TOLERANCE: f64 = 0.002;

/// Where the truth is: what the nodes that need it are told.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct TruthFiles {
    /// Folder of `SCENE/scene_gt.json`.
    pub(crate) poses: PathBuf,
    /// The object set: a BOP `models/` folder.
    pub(crate) objects: PathBuf,
}

impl TruthFiles {
    /// What `check` can say before anything starts.
    pub(crate) fn check(&self) -> Result<()> {
        match [&self.poses, &self.objects].into_iter().find(|folder| !folder.is_dir()) {
            Some(folder) => bail!("`{}`: no such folder", folder.display()),
            None => Ok(()),
        }
    }
}

/// True poses by scene and image, and the meshes that hide one another.
pub(crate) struct Truth {
    poses: BTreeMap<(u32, u32), Vec<(u32, Pose)>>,
    rasteriser: SoftwareRasteriser,
}

/// Where the pixels of a view lie in the real crop, and whether they are seen there.
pub(crate) struct TrueFlow {
    /// True flow of the reference's foreground, pixels, x and y interleaved.
    pub(crate) flow_px: Vec<f32>,
    /// Not 0 where the surface point is seen in the real image: neither hidden by itself nor by another object.
    pub(crate) seen: Vec<u8>,
}

fn pose(entry: &Value) -> Option<(u32, Pose)> {
    let numbers = |key: &str| -> Option<Vec<f64>> { entry[key].as_array()?.iter().map(Value::as_f64).collect() };
    let (r, t) = (numbers("cam_R_m2c")?, numbers("cam_t_m2c")?);
    if r.len() != 9 || t.len() != 3 {
        return None;
    }
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_row_slice(&r));
    let metres = Vector3::new(t[0], t[1], t[2]) / 1000.0;
    let object_id = u32::try_from(entry["obj_id"].as_u64()?).ok()?;
    Some((object_id, Pose::from_parts(metres.into(), UnitQuaternion::from_rotation_matrix(&rotation))))
}

impl Truth {
    /// Reads the true poses of every scene.
    pub(crate) fn read(files: &TruthFiles) -> Result<Self> {
        let folder = &files.poses;
        let mut rasteriser = SoftwareRasteriser::new();
        for object in ObjectSet::load(&files.objects)?.iter() {
            rasteriser.add_object(object.id, &object.mesh)?;
        }
        let mut poses = BTreeMap::new();
        for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
            let path = entry?.path();
            let Some(scene_id) = path.file_name().and_then(|name| name.to_str()?.parse().ok()) else { continue };
            let file = path.join("scene_gt.json");
            let text = std::fs::read(&file).with_context(|| file.display().to_string())?;
            let images: BTreeMap<u32, Vec<Value>> =
                serde_json::from_slice(&text).with_context(|| file.display().to_string())?;
            for (image_id, entries) in images {
                let all = entries.iter().map(pose).collect::<Option<_>>();
                let all = all.with_context(|| format!("{}: not a BOP file", file.display()))?;
                poses.insert((scene_id, image_id), all);
            }
        }
        if poses.is_empty() {
            bail!("{}: no SCENE/scene_gt.json there", folder.display());
        }
        Ok(Self { poses, rasteriser })
    }

    /// The true flow of one view (`number` of the message); none when the object is not in the image.
    pub(crate) fn flow(&self, views: &ReferenceViews<'_>, number: usize) -> Result<Option<TrueFlow>> {
        let (header, view, size_px) = (views.header, &views.views[number], views.header.size_px as usize);
        let none = Vec::new();
        let objects = self.poses.get(&(header.scene_id, header.image_id)).unwrap_or(&none);
        let Some((_, real)) = objects.iter().find(|(id, _)| *id == view.pose.object_id) else { return Ok(None) };
        let [fx, fy, cx, cy] = view.crop_intrinsics;
        let k = Intrinsics { fx, fy, cx, cy };
        let scene_depth_m = self.depth(objects, &k, header.size_px)?;
        let assumed = pose_from_quaternion(&view.pose.rotation_xyzw, &view.pose.translation_m)?;
        let real_from_assumed = real * assumed.inverse();
        let area = size_px * size_px;
        let mut out = TrueFlow { flow_px: vec![0.0; 2 * area], seen: vec![0; area] };
        for pixel in (0..area).filter(|pixel| views.mask[number * area + pixel] != 0) {
            let p = Point2::new((pixel % size_px) as f64, (pixel / size_px) as f64);
            let point = real_from_assumed * k.unproject(&p, f64::from(views.depth_m[number * area + pixel]));
            let Some(there) = k.project(&point) else { continue };
            out.flow_px[2 * pixel] = (there.x - p.x) as f32;
            out.flow_px[2 * pixel + 1] = (there.y - p.y) as f32;
            let (x, y) = (there.x.round(), there.y.round());
            if x >= 0.0 && y >= 0.0 && x < size_px as f64 && y < size_px as f64 {
                let depth_m = f64::from(scene_depth_m[y as usize * size_px + x as usize]);
                // Grazing surfaces change by more than this from pixel to pixel: they are left out, as they should be.
                out.seen[pixel] = u8::from((depth_m - point.z).abs() < DEPTH_TOLERANCE * point.z);
            }
        }
        Ok(Some(out))
    }

    /// Depth of the nearest object of the true scene; infinite where none is.
    fn depth(&self, objects: &[(u32, Pose)], k: &Intrinsics, size_px: u32) -> Result<Vec<f32>> {
        let view = |(object_id, pose): &(u32, Pose)| View {
            object_id: *object_id,
            camera_from_object: *pose,
            intrinsics: *k,
            width: size_px,
            height: size_px,
        };
        let renderings = self.rasteriser.render(&objects.iter().map(view).collect::<Vec<_>>())?;
        let mut nearest = vec![f32::INFINITY; (size_px * size_px) as usize];
        for rendering in &renderings {
            let seen = nearest.iter_mut().zip(&rendering.depth_m).filter(|(_, depth_m)| **depth_m > 0.0);
            seen.for_each(|(nearest, depth_m)| *nearest = nearest.min(*depth_m));
        }
        Ok(nearest)
    }
}
