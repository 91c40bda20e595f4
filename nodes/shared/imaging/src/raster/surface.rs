/// What a pixel sees, for a [`Shader`].
#[derive(Debug, Clone, Copy)]
pub struct Surface {
    /// Which item of the scene, from 0.
    pub item: usize,
    /// Texture or vertex colour, 0 to 1, sRGB-encoded.
    pub albedo: [f32; 3],
    /// Share of the surroundings that is not hidden by the item itself ([`crate::Mesh::openness`]); 1 where not known.
    pub openness: f32,
    /// The point, metres.
    pub point_in_camera: [f32; 3],
    /// The point, metres.
    pub point_in_object: [f32; 3],
    /// Unit normal, turned to the side that the camera sees.
    pub normal_in_camera: [f32; 3],
    /// Unit vector from the point to the camera.
    pub to_camera: [f32; 3],
}

/// Gives a surface its colour.
pub trait Shader: Sync {
    /// The colour of a pixel, 0 to 1, sRGB-encoded; what lies outside is clamped.
    fn shade(&self, surface: &Surface) -> [f32; 3];
}

/// Ambient light and one light at the camera: the shading of reference views (docs/method.md, step 3).
///
/// `colour = albedo * (ambient + headlight * max(0, normal . to_camera))`. By default 0.6 and 0.4, so that a
/// surface seen frontally shows its texture as it is and one seen edge-on keeps 60 %.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Headlight {
    /// Strength of the light from everywhere.
    pub ambient: f32,
    /// Strength of the light at the camera.
    pub headlight: f32,
}

impl Default for Headlight {
    fn default() -> Self {
        Self { ambient: 0.6, headlight: 0.4 }
    }
}

impl Shader for Headlight {
    fn shade(&self, surface: &Surface) -> [f32; 3] {
        let facing = dot(surface.normal_in_camera, surface.to_camera).max(0.0);
        surface.albedo.map(|c| c * (self.ambient + self.headlight * facing))
    }
}

pub(crate) fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The vector at length one; `z` when it has no length.
pub(crate) fn unit(v: [f32; 3]) -> [f32; 3] {
    let length = dot(v, v).sqrt();
    if length > 1e-12 { v.map(|c| c / length) } else { [0.0, 0.0, 1.0] }
}
