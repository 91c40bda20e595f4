use super::grain::value_noise;
use super::surface::{Shader, Surface, dot, unit};
use rand::Rng;

/// Domain-randomised light and materials for synthetic training.
///
/// `colour = albedo * gain * grain * (ambient + sum of lights * max(0, n . l) * shadow) + highlights`, with Blinn-Phong
/// highlights `specular * light * (n . h)^shininess * shadow`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Studio {
    /// Light from everywhere, by channel.
    pub ambient: [f32; 3],
    /// Lights far away.
    pub lights: Vec<Light>,
    /// Shadows; they take the lights, not the ambient light.
    pub shadows: Vec<SoftShadow>,
    /// The material of each item; items beyond the list have [`Material::default`].
    pub materials: Vec<Material>,
}

/// A light far away.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    /// Unit vector from the scene to the light, camera axes.
    pub direction_in_camera: [f32; 3],
    /// Strength by channel; 1 shows a frontally lit texture as it is.
    pub colour: [f32; 3],
}

/// The soft edge of a shadow: what lies on the far side of a plane is darker.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SoftShadow {
    /// Unit normal of the plane, camera axes; the shadow is on this side.
    pub normal_in_camera: [f32; 3],
    /// `normal . point` on the plane, metres.
    pub offset_m: f32,
    /// Half the width of the transition, metres.
    pub softness_m: f32,
    /// What part of the light is taken, 0 to 1.
    pub strength: f32,
}

/// How an item's surface differs from its texture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Material {
    /// Factor on the texture by channel.
    pub gain: [f32; 3],
    /// Strength of highlights.
    pub specular: f32,
    /// Sharpness of highlights (Blinn-Phong exponent).
    pub shininess: f32,
    /// Amplitude of the smooth noise on the texture, as a part of it.
    pub grain: f32,
    /// Size of the noise's blobs, metres.
    pub grain_size_m: f32,
    /// Seed of the noise.
    pub grain_seed: u32,
}

impl Default for Material {
    fn default() -> Self {
        Self { gain: [1.0; 3], specular: 0.0, shininess: 20.0, grain: 0.0, grain_size_m: 0.02, grain_seed: 0 }
    }
}

impl Shader for Studio {
    fn shade(&self, surface: &Surface) -> [f32; 3] {
        let material = self.materials.get(surface.item).copied().unwrap_or_default();
        let shadow = self.shadows.iter().fold(1.0, |light, s| light * s.passes(surface.point_in_camera));
        let (mut diffuse, mut highlight) = (self.ambient, [0.0; 3]);
        for light in &self.lights {
            let facing = dot(surface.normal_in_camera, light.direction_in_camera).max(0.0) * shadow;
            let shine = material.highlight(surface, light) * shadow;
            for k in 0..3 {
                diffuse[k] += light.colour[k] * facing;
                highlight[k] += light.colour[k] * shine;
            }
        }
        let grain = material.grain_at(surface.point_in_object);
        std::array::from_fn(|k| surface.albedo[k] * material.gain[k] * grain * diffuse[k] + highlight[k])
    }
}

impl SoftShadow {
    fn passes(&self, point_in_camera: [f32; 3]) -> f32 {
        let beyond_m = dot(self.normal_in_camera, point_in_camera) - self.offset_m;
        let t = (0.5 + 0.5 * beyond_m / self.softness_m.max(1e-6)).clamp(0.0, 1.0);
        1.0 - self.strength * t * t * (3.0 - 2.0 * t)
    }
}

impl Material {
    fn highlight(&self, surface: &Surface, light: &Light) -> f32 {
        if self.specular <= 0.0 {
            return 0.0;
        }
        let half = std::array::from_fn(|k| surface.to_camera[k] + light.direction_in_camera[k]);
        self.specular * dot(surface.normal_in_camera, unit(half)).max(0.0).powf(self.shininess)
    }

    fn grain_at(&self, point_in_object: [f32; 3]) -> f32 {
        if self.grain <= 0.0 {
            return 1.0;
        }
        1.0 + self.grain * value_noise(point_in_object.map(|c| c / self.grain_size_m), self.grain_seed)
    }
}

impl Studio {
    /// Random light and materials for `items` objects about `distance_m` from the camera: ambient 0.25 to 0.8, one
    /// to three lights from the camera's half space with a slight tint, up to two soft shadows, gains 0.7 to 1.3,
    /// highlights on half of the objects, grain on a third.
    pub fn random(items: usize, distance_m: f32, rng: &mut impl Rng) -> Self {
        let ambient = rng.random_range(0.25..0.8);
        let ambient = tint(rng, 0.06).map(|c| c * ambient);
        let count = rng.random_range(1..=3);
        let lights = (0..count).map(|_| Light::random(0.9 / count as f32, rng)).collect();
        let shadows = (0..rng.random_range(0..=2)).map(|_| SoftShadow::random(distance_m, rng)).collect();
        let materials = (0..items).map(|_| Material::random(rng)).collect();
        Self { ambient, lights, shadows, materials }
    }
}

impl Light {
    fn random(strength: f32, rng: &mut impl Rng) -> Self {
        let direction = random_direction(rng);
        let direction_in_camera = [direction[0], direction[1], -direction[2].abs()];
        let strength = strength * rng.random_range(0.3..1.5);
        Self { direction_in_camera, colour: tint(rng, 0.12).map(|c| c * strength) }
    }
}

impl SoftShadow {
    fn random(distance_m: f32, rng: &mut impl Rng) -> Self {
        let normal_in_camera = random_direction(rng);
        let through = [rng.random_range(-0.08..0.08), rng.random_range(-0.08..0.08), distance_m];
        Self {
            normal_in_camera,
            offset_m: dot(normal_in_camera, through),
            softness_m: rng.random_range(0.003..0.05),
            strength: rng.random_range(0.2..0.9),
        }
    }
}

impl Material {
    fn random(rng: &mut impl Rng) -> Self {
        let gain = rng.random_range(0.7..1.3);
        let (shiny, grainy): (f32, f32) = (rng.random(), rng.random());
        let (specular, grain) = (rng.random_range(0.05..0.7), rng.random_range(0.05..0.3));
        Self {
            gain: tint(rng, 0.1).map(|c| c * gain),
            specular: if shiny < 0.5 { specular } else { 0.0 },
            shininess: 2.0_f32.powf(rng.random_range(2.0..7.0)),
            grain: if grainy < 0.33 { grain } else { 0.0 },
            grain_size_m: rng.random_range(0.003..0.04),
            grain_seed: rng.random(),
        }
    }
}

fn tint(rng: &mut impl Rng, spread: f32) -> [f32; 3] {
    std::array::from_fn(|_| 1.0 + rng.random_range(-spread..spread))
}

fn random_direction(rng: &mut impl Rng) -> [f32; 3] {
    let z: f32 = rng.random_range(-1.0..1.0);
    let angle = rng.random_range(0.0..std::f32::consts::TAU);
    let radius = (1.0 - z * z).sqrt();
    [radius * angle.cos(), radius * angle.sin(), z]
}
