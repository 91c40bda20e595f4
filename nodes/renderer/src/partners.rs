//! Crops of the frames that the photometric loss compares with (docs/method.md, "L_photo").

use crate::views::{Plan, ViewSettings, crop_around};
use pseudoflow_geometry::Intrinsics;
use pseudoflow_imaging::{ImagingError, ObjectSet, RgbImage, resample};
use pseudoflow_msgs::{Partner, PartnerFrame, PartnerFrames};

/// Partners of the planned instances, as the message carries them.
#[derive(Debug, Clone, Default)]
pub(crate) struct PartnerCrops {
    pub(crate) per_instance: u32,
    /// `instances x m`.
    pub(crate) partners: Vec<Partner>,
    /// `instances x m x S x S x 3`; 0 where there is none.
    pub(crate) rgb: Vec<u8>,
}

/// Crops every partner of every planned instance around the object's initial pose in the partner's own frame.
pub(crate) fn crop_partners(
    frames: &PartnerFrames<'_>,
    plan: &Plan,
    objects: &ObjectSet,
    settings: &ViewSettings,
) -> Result<PartnerCrops, ImagingError> {
    let per_instance = frames.header.partners_per_instance;
    let mut out = PartnerCrops { per_instance, ..PartnerCrops::default() };
    let values = 3 * (settings.size_px as usize).pow(2);
    for instance in &plan.instances {
        let first = instance.place * per_instance as usize;
        for at in first..first + per_instance as usize {
            // An instance beyond those that partners were chosen for has none.
            let found = frames.partners.get(at).filter(|partner| partner.width > 0);
            let crop = found.map(|partner| crop(partner, frames.image(at), objects, settings)).transpose()?.flatten();
            let id = found.map_or((0, 0), |partner| (partner.scene_id, partner.image_id));
            let (present, begin) = (u32::from(crop.is_some()), out.rgb.len());
            out.partners.push(Partner { scene_id: id.0, image_id: id.1, present, reserved: 0 });
            out.rgb.resize(begin + values, 0);
            if let Some(crop) = crop {
                out.rgb[begin..].copy_from_slice(crop.as_raw());
            }
        }
    }
    Ok(out)
}

fn crop(
    partner: &PartnerFrame,
    rgb: &[u8],
    objects: &ObjectSet,
    settings: &ViewSettings,
) -> Result<Option<RgbImage>, ImagingError> {
    let [fx, fy, cx, cy] = partner.intrinsics;
    let size = (partner.width, partner.height);
    let found = crop_around(&partner.pose, objects, &Intrinsics { fx, fy, cx, cy }, size, settings)?;
    let image = RgbImage::from_raw(size.0, size.1, rgb.to_vec());
    Ok(found.zip(image).map(|((_, crop), image)| resample(&image, &crop)))
}
