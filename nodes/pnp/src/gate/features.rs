use super::Evidence;
use pseudoflow_geometry::{Pose, rotation_angle_rad};
use pseudoflow_msgs::GateDecision;
use pseudoflow_solver::PnpResult;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What the gate's models may look at. The names are those of the model file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Feature {
    /// Share of the correspondences within the threshold, 0..1.
    InlierRatio,
    /// Root mean square error of the inliers over the threshold, 0..1.
    InlierRms,
    /// Correlation of rendering and crop at the initial pose, -1..1; 0 where the rendering has no texture.
    PhotometricInitial,
    /// The same at the refined pose.
    PhotometricRefined,
    /// Refined minus initial, -0.5..0.5.
    PhotometricGain,
    /// How much of the rendering has a texture to compare: textured blocks over 64, at most 1.
    Textured,
    /// Contrast across the contour at the initial pose, 0..1.
    SilhouetteInitial,
    /// The same at the refined pose.
    SilhouetteRefined,
    /// Refined minus initial, -0.5..0.5.
    SilhouetteGain,
    /// Mean displacement of the surface, crop sides, at most 0.5.
    Displacement,
    /// What of it is over a tenth.
    DisplacementOverTenth,
    /// Angle between the poses, radians, at most 1.5.
    Rotation,
    /// What of it is over 0.35 rad (20 degrees).
    RotationOver20Deg,
    /// Size of the change of depth, diameters, at most 1: rough poses are seldom off by more than a quarter.
    DepthChange,
    /// What of it is over a quarter.
    DepthChangeOverQuarter,
    /// Share of the surface inside the crop at the refined pose, 0..1.
    ShareInView,
    /// Natural logarithm of the solver's standard deviation of the translation (root of the mean variance) over the diameter.
    LnTranslationSigma,
    /// Natural logarithm of the solver's standard deviation of the rotation, radians.
    LnRotationSigma,
    /// Natural logarithm of crop pixels over image pixels: how much a small object was magnified.
    LnMagnification,
    /// Contour stage: overlap of the colour histograms of both sides of the contour, 0..1.
    ContourOverlap,
    /// Contour stage: share of the contour's lines that agree with the refined pose, 0..1.
    ContourAgreement,
    /// Contour stage: distance between the pose and what flow found alone, diameters, at most 0.5; that where it found none.
    FlowContourDistance,
    /// Contour stage: share of the contour's points that could be read, 0..1.
    ContourSeen,
    /// Contour stage: negative log posterior by the lines read, at most 3 either way.
    CostPerLine,
    /// Contour stage: natural logarithm of the object's diameter in the image, pixels.
    LnObjectPx,
    /// Contour stage: shift of the object's middle across the view, diameters, at most 0.5.
    Shift,
    /// Mean probability over the rendered surface that its flow is right, 0..1, by a network that says so (the refiner).
    Certainty,
}

impl Feature {
    /// All, in the order of their numbers.
    pub const ALL: [Self; 27] = [
        Self::InlierRatio,
        Self::InlierRms,
        Self::PhotometricInitial,
        Self::PhotometricRefined,
        Self::PhotometricGain,
        Self::Textured,
        Self::SilhouetteInitial,
        Self::SilhouetteRefined,
        Self::SilhouetteGain,
        Self::Displacement,
        Self::DisplacementOverTenth,
        Self::Rotation,
        Self::RotationOver20Deg,
        Self::DepthChange,
        Self::DepthChangeOverQuarter,
        Self::ShareInView,
        Self::LnTranslationSigma,
        Self::LnRotationSigma,
        Self::LnMagnification,
        Self::ContourOverlap,
        Self::ContourAgreement,
        Self::FlowContourDistance,
        Self::ContourSeen,
        Self::CostPerLine,
        Self::LnObjectPx,
        Self::Shift,
        Self::Certainty,
    ];

    /// The feature of a name of [`GateDecision::EVIDENCE`].
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        let place = GateDecision::EVIDENCE.iter().position(|known| *known == name)?;
        Self::ALL.get(place).copied()
    }
}

/// The features of one refinement; NaN where one is not known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Features([f64; Feature::ALL.len()]);

impl Default for Features {
    fn default() -> Self {
        Self([f64::NAN; Feature::ALL.len()])
    }
}

/// Sizes that evidence and solution are measured by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scale {
    /// Side of the crop, crop pixels.
    pub size_px: usize,
    /// Side of the crop, image pixels.
    pub crop_side_px: f64,
    /// The solver's inlier threshold, crop pixels.
    pub threshold_px: f64,
    /// Diameter of the object, metres.
    pub diameter_m: f64,
    /// Depth of the object at the initial pose, metres.
    pub initial_depth_m: f64,
}

/// What the network's mean certainty counts for among hypotheses, beside inlier ratio, correlation and contrast (each at most 1).
/// Chosen with searches of tabletop's train split: 0, 1, 2 and 3 find 0.78, 0.80, 0.83 and 0.83 of 110 objects in two looks
/// (docs/measuring.md).
const CERTAINTY_WEIGHT: f64 = 2.0;

/// By what the hypotheses of an instance are ranked: how well flow and picture agree with a pose (`seen`: inlier ratio, correlation and
/// contrast together), and how certain the network is where it says so.
pub(crate) fn merit(seen: f64, certainty: Option<f64>) -> f64 {
    seen + CERTAINTY_WEIGHT * certainty.unwrap_or(0.0)
}

/// Fewer textured blocks do not count as a comparison.
const MIN_BLOCKS: usize = 4;
/// Textured blocks that count as a fully textured rendering.
const ALL_BLOCKS: f64 = 64.0;

impl Features {
    /// A feature; NaN where it is not known.
    #[must_use]
    pub fn get(&self, feature: Feature) -> f64 {
        self.0[feature as usize]
    }

    /// Those that are known.
    #[must_use]
    pub fn known(&self) -> BTreeMap<Feature, f64> {
        Feature::ALL.into_iter().map(|f| (f, self.get(f))).filter(|(_, v)| v.is_finite()).collect()
    }

    /// Sets one.
    #[must_use]
    pub fn with(mut self, feature: Feature, value: f64) -> Self {
        self.0[feature as usize] = value;
        self
    }

    /// By what the hypotheses of an instance are ranked: how well flow and picture agree with the refined or the initial pose, and how certain
    /// the network is. What is not known counts nothing.
    #[must_use]
    pub fn merit(&self, refined: bool) -> f64 {
        let of_pictures = match refined {
            true => [Feature::PhotometricRefined, Feature::SilhouetteRefined],
            false => [Feature::PhotometricInitial, Feature::SilhouetteInitial],
        };
        let known = |feature| Some(self.get(feature)).filter(|v| !v.is_nan());
        let [photometric, silhouette] = of_pictures.map(|feature| known(feature).unwrap_or(0.0));
        merit(known(Feature::InlierRatio).unwrap_or(0.0) + photometric + silhouette, known(Feature::Certainty))
    }

    /// Of a solution and what the pictures say about it. The contour stage adds its own.
    #[must_use]
    pub fn of(found: &PnpResult, evidence: &Evidence, scale: &Scale) -> Self {
        let textured = evidence.blocks >= MIN_BLOCKS;
        let photometric = |value: f64| if textured { value } else { 0.0 };
        let (before, after) = (photometric(evidence.photometric_initial), photometric(evidence.photometric_refined));
        let displacement = (evidence.displacement_px / scale.size_px as f64).min(0.5);
        let depth_m = found.camera_from_object.translation.z;
        Self::default()
            .with(Feature::InlierRatio, found.inlier_ratio)
            .with(Feature::InlierRms, found.rms_px / scale.threshold_px)
            .with(Feature::PhotometricInitial, before)
            .with(Feature::PhotometricRefined, after)
            .with(Feature::PhotometricGain, (after - before).clamp(-0.5, 0.5))
            .with(Feature::Textured, (evidence.blocks as f64 / ALL_BLOCKS).min(1.0))
            .with(Feature::SilhouetteInitial, evidence.silhouette_initial)
            .with(Feature::SilhouetteRefined, evidence.silhouette_refined)
            .with(Feature::SilhouetteGain, (evidence.silhouette_refined - evidence.silhouette_initial).clamp(-0.5, 0.5))
            .with(Feature::Displacement, displacement)
            .with(Feature::DisplacementOverTenth, (displacement - 0.1).max(0.0))
            .with(Feature::ShareInView, evidence.share_in_view)
            .with_angle(evidence.rotation_rad)
            .with_depth_change((depth_m - scale.initial_depth_m).abs() / scale.diameter_m)
            .with_sigmas(&found.covariance, scale.diameter_m)
            .with(Feature::LnMagnification, ln_of(scale.size_px as f64 / scale.crop_side_px))
    }

    /// With the angle between two poses and their change of depth, diameters.
    pub(super) fn with_change(self, before: &Pose, after: &Pose, depth: f64) -> Self {
        self.with_angle(rotation_angle_rad(before, after)).with_depth_change(depth)
    }

    fn with_angle(self, angle_rad: f64) -> Self {
        let rotation = angle_rad.min(1.5);
        self.with(Feature::Rotation, rotation)
            .with(Feature::RotationOver20Deg, (rotation - 20_f64.to_radians()).max(0.0))
    }

    fn with_depth_change(self, diameters: f64) -> Self {
        let depth = diameters.min(1.0);
        self.with(Feature::DepthChange, depth).with(Feature::DepthChangeOverQuarter, (depth - 0.25).max(0.0))
    }

    /// With the size of a covariance (row-major 6 x 6, translation first).
    pub(super) fn with_sigmas(self, covariance: &[f64; 36], diameter_m: f64) -> Self {
        let sigma = |start: usize| ((start..start + 3).map(|i| covariance[7 * i]).sum::<f64>() / 3.0).sqrt();
        self.with(Feature::LnTranslationSigma, ln_of(sigma(0) / diameter_m))
            .with(Feature::LnRotationSigma, ln_of(sigma(3)))
    }
}

/// The logarithm, between those of a millionth and of a thousand. Nothing is known of what is 0: a covariance of zeros.
pub(super) fn ln_of(value: f64) -> f64 {
    if value > 0.0 { value.clamp(1e-6, 1e3).ln() } else { f64::NAN }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_follow_the_order() {
        for (i, feature) in Feature::ALL.into_iter().enumerate() {
            assert_eq!(feature as usize, i);
            assert_eq!(Features::default().with(feature, 2.0).get(feature), 2.0);
        }
    }
}
