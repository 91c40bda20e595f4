use crate::PnpError;
use crate::points::is_kept;
use nalgebra::{Matrix3, Vector3};
use pseudoflow_geometry::{Intrinsics, Pose};

/// Object points and where they are seen. Entries with a number that is not finite are allowed and skipped.
#[derive(Debug, Clone, Copy)]
pub struct Correspondences<'a> {
    /// Points in the object's frame, metres.
    pub(crate) points_in_object: &'a [[f32; 3]],
    /// Pixels (x, y), centres at integers.
    pub(crate) pixels: &'a [[f32; 2]],
}

impl<'a> Correspondences<'a> {
    /// Pairs point i with pixel i.
    ///
    /// # Errors
    /// [`PnpError::Length`] when the counts differ.
    pub fn new(points_in_object: &'a [[f32; 3]], pixels: &'a [[f32; 2]]) -> Result<Self, PnpError> {
        if points_in_object.len() != pixels.len() {
            return Err(PnpError::Length { points: points_in_object.len(), pixels: pixels.len() });
        }
        Ok(Self { points_in_object, pixels })
    }

    /// Count of pairs.
    #[must_use]
    pub fn len(&self) -> usize {
        self.pixels.len()
    }

    /// Whether there is no pair.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.pixels.is_empty()
    }
}

/// A flow field on its reference view. All planes are row-major, S x S.
#[derive(Debug, Clone, Copy)]
pub struct FlowField<'a> {
    /// S, pixels.
    pub size_px: usize,
    /// Depth of the reference along z, metres; S * S values, 0 = background.
    pub depth_m: &'a [f32],
    /// Nonzero where the object is; S * S values.
    pub mask: &'a [u8],
    /// Flow from the reference to the real crop: dx, dy by pixel, crop pixels; S * S * 2 values.
    pub flow_px: &'a [f32],
    /// How sure the network is that a pixel's surface point is seen, and that its flow is right; S * S values each, 255 =
    /// certain. `None` where the network does not say.
    pub certainty: Option<[&'a [u8]; 2]>,
    /// Intrinsics K' of the crop.
    pub intrinsics: Intrinsics,
    /// The pose at which the reference was rendered.
    pub camera_from_object: Pose,
}

/// Flow that is seen and right with a smaller probability is left out: it is hidden, or as good as guessed.
const LEAST_CERTAINTY: f32 = 0.25;
/// But the surest part of the surface, this large, always takes part: a network that doubts everything in a strange picture
/// still doubts the right things most, and RANSAC decides.
const LEAST_SHARE: f64 = 0.3;

impl FlowField<'_> {
    /// # Errors
    /// [`PnpError::Plane`] names the plane that has the wrong size.
    fn check(&self) -> Result<(), PnpError> {
        let n = self.size_px * self.size_px;
        let planes = [
            ("depth_m", self.depth_m.len(), n),
            ("mask", self.mask.len(), n),
            ("flow_px", self.flow_px.len(), 2 * n),
            ("certainty", self.certainty.map_or(2 * n, |[seen, right]| seen.len() + right.len()), 2 * n),
        ];
        match planes.into_iter().find(|(_, got, need)| got != need) {
            Some((plane, got, need)) => Err(PnpError::Plane { plane, size_px: self.size_px, got, need }),
            None => Ok(()),
        }
    }

    /// Whether pixel `i` is a foreground pixel with depth and a finite flow.
    fn is_surface(&self, i: usize) -> bool {
        let depth = self.depth_m[i];
        let [dx, dy] = [self.flow_px[2 * i], self.flow_px[2 * i + 1]];
        self.mask[i] != 0 && depth > 0.0 && depth.is_finite() && dx.is_finite() && dy.is_finite()
    }

    /// 255 times the probability that the surface point is seen and its flow right; 255 where the network does not say.
    fn sureness(&self, i: usize) -> usize {
        self.certainty.map_or(255, |[seen, right]| usize::from(seen[i]) * usize::from(right[i]) / 255)
    }

    /// Whether pixel `i` gives a correspondence, if [`Self::sureness`] must reach `least`.
    fn is_usable(&self, i: usize, least: usize) -> bool {
        self.is_surface(i) && self.sureness(i) >= least
    }

    /// What [`Self::sureness`] must reach: [`LEAST_CERTAINTY`], or less where less than [`LEAST_SHARE`] of the surface does.
    fn least_sureness(&self) -> usize {
        let mut counts = [0_usize; 256];
        (0..self.mask.len()).filter(|&i| self.is_surface(i)).for_each(|i| counts[self.sureness(i)] += 1);
        let enough = (LEAST_SHARE * counts.iter().sum::<usize>() as f64).ceil() as usize;
        let wanted = (LEAST_CERTAINTY * 255.0) as usize;
        let mut reached: usize = counts[wanted..].iter().sum();
        let lower = (0..wanted).rev().take_while(|&least| {
            let short = reached < enough;
            reached += counts[least];
            short
        });
        lower.last().unwrap_or(wanted)
    }
}

/// Room for correspondences that is used again for every field.
#[derive(Debug, Clone, Default)]
pub struct PixelBuffer {
    points_in_object: Vec<[f32; 3]>,
    pixels: Vec<[f32; 2]>,
}

impl PixelBuffer {
    /// An empty buffer.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// The correspondences of a flow field: each foreground pixel of the reference with depth and a finite flow that is sure
    /// enough (or among the surest) gives its surface point and `pixel + flow` (docs/method.md, step 5). When there are more than `max_points`, that many are
    /// taken evenly in row order.
    ///
    /// # Errors
    /// [`PnpError::Plane`] when a plane has the wrong size.
    pub fn fill(&mut self, field: &FlowField<'_>, max_points: usize) -> Result<Correspondences<'_>, PnpError> {
        field.check()?;
        self.points_in_object.clear();
        self.pixels.clear();
        let least = field.least_sureness();
        let all = (0..field.mask.len()).filter(|&i| field.is_usable(i, least)).count();
        let kept = all.min(max_points);
        let rays = Rays::new(&field.intrinsics, &field.camera_from_object);
        let mut seen = 0;
        for (row, y) in (0..field.size_px).map(|y| (y * field.size_px, y)) {
            for x in 0..field.size_px {
                if !field.is_usable(row + x, least) {
                    continue;
                }
                if is_kept(seen, all, kept) {
                    self.push(field, &rays, row + x, [x as f32, y as f32]);
                }
                seen += 1;
            }
        }
        Ok(self.correspondences())
    }

    fn push(&mut self, field: &FlowField<'_>, rays: &Rays, i: usize, [x, y]: [f32; 2]) {
        self.points_in_object.push(rays.point_in_object(x, y, field.depth_m[i]));
        self.pixels.push([x + field.flow_px[2 * i], y + field.flow_px[2 * i + 1]]);
    }

    /// What was filled in last.
    #[must_use]
    pub fn correspondences(&self) -> Correspondences<'_> {
        Correspondences { points_in_object: &self.points_in_object, pixels: &self.pixels }
    }
}

/// Pixel and depth to object point: `R^T (depth K^-1 (x, y, 1) - t)` with the products done once.
struct Rays {
    object_from_pixel: Matrix3<f64>,
    camera_in_object: Vector3<f64>,
}

impl Rays {
    fn new(k: &Intrinsics, camera_from_object: &Pose) -> Self {
        let inverse_k = Matrix3::new(1.0 / k.fx, 0.0, -k.cx / k.fx, 0.0, 1.0 / k.fy, -k.cy / k.fy, 0.0, 0.0, 1.0);
        let object_from_camera = camera_from_object.inverse();
        Self {
            object_from_pixel: object_from_camera.rotation.to_rotation_matrix() * inverse_k,
            camera_in_object: object_from_camera.translation.vector,
        }
    }

    fn point_in_object(&self, x: f32, y: f32, depth_m: f32) -> [f32; 3] {
        let ray = self.object_from_pixel * Vector3::new(f64::from(x), f64::from(y), 1.0);
        let point = ray * f64::from(depth_m) + self.camera_in_object;
        [point.x as f32, point.y as f32, point.z as f32]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point2, Point3};

    const K: Intrinsics = Intrinsics { fx: 40.0, fy: 42.0, cx: 3.2, cy: 4.1 };

    fn field<'a>(depth_m: &'a [f32], mask: &'a [u8], flow_px: &'a [f32]) -> FlowField<'a> {
        let pose = Pose::new(Vector3::new(0.01, -0.02, 0.7), Vector3::new(0.3, -1.0, 0.2));
        FlowField { size_px: 8, depth_m, mask, flow_px, certainty: None, intrinsics: K, camera_from_object: pose }
    }

    #[test]
    fn a_pixel_gives_its_surface_point_and_its_target() {
        let (mut depth, mut mask, mut flow) = (vec![0.0; 64], vec![0; 64], vec![0.0; 128]);
        for (i, m) in [(10, 255), (11, 1), (12, 1), (13, 1), (14, 0)] {
            (depth[i], mask[i], flow[2 * i], flow[2 * i + 1]) = (0.7, m, 1.5, -0.25);
        }
        flow[2 * 11] = f32::NAN;
        flow[2 * 12 + 1] = f32::INFINITY;
        depth[13] = 0.0;
        let mut buffer = PixelBuffer::new();
        let field = field(&depth, &mask, &flow);
        let found = buffer.fill(&field, 1000).unwrap();
        assert_eq!(found.pixels, [[3.5, 0.75]]);
        let expected = field.camera_from_object.inverse() * K.unproject(&Point2::new(2.0, 1.0), f64::from(0.7_f32));
        assert!((Point3::from(found.points_in_object[0]).cast::<f64>() - expected).norm() < 1e-7);
    }

    #[test]
    fn flow_that_the_network_is_not_sure_of_is_left_out() {
        let (depth, mask, flow) = (vec![0.7; 64], vec![1; 64], vec![0.0; 128]);
        let (mut seen, mut right) = (vec![0; 64], vec![255; 64]);
        seen[..30].fill(255);
        (seen[31], seen[32], right[32]) = (100, 255, 20);
        let sure = FlowField { certainty: Some([&seen, &right]), ..field(&depth, &mask, &flow) };
        let pixels = PixelBuffer::new().fill(&sure, 1000).unwrap().pixels.len();
        assert_eq!(pixels, 31, "thirty sure ones and one that is sure enough");
        // Sure of nothing: the surest third.
        let doubts: Vec<u8> = (0..64).map(|i| if i % 3 == 0 { 40 } else { 10 }).collect();
        let unsure = FlowField { certainty: Some([&doubts, &right]), ..sure };
        let used = PixelBuffer::new().fill(&unsure, 1000).unwrap().pixels.len();
        assert!(used == 21 || used == 22, "{used}");
        let field = sure;
        let short = FlowField { certainty: Some([&seen[1..], &right]), ..field };
        assert!(matches!(PixelBuffer::new().fill(&short, 9), Err(PnpError::Plane { plane: "certainty", .. })));
    }

    #[test]
    fn a_limit_thins_evenly() {
        let (depth, mask, flow) = (vec![0.7; 64], vec![1; 64], vec![0.0; 128]);
        let mut buffer = PixelBuffer::new();
        let pixels = buffer.fill(&field(&depth, &mask, &flow), 16).unwrap().pixels.to_vec();
        let expected: Vec<[f32; 2]> = (0..16).map(|i| [((4 * i + 3) % 8) as f32, ((4 * i + 3) / 8) as f32]).collect();
        assert_eq!(pixels, expected);
    }

    #[test]
    fn a_plane_of_the_wrong_size_is_named() {
        let (depth, mask, flow) = (vec![0.7; 64], vec![1; 64], vec![0.0; 64]);
        let error = PixelBuffer::new().fill(&field(&depth, &mask, &flow), 16).unwrap_err();
        assert_eq!(error, PnpError::Plane { plane: "flow_px", size_px: 8, got: 64, need: 128 });
        assert!(matches!(Correspondences::new(&[[0.0; 3]], &[]), Err(PnpError::Length { points: 1, pixels: 0 })));
    }
}
