//! Light and material: what colour a surface sends to the camera, in linear light.
//!
//! Diffuse: albedo x (hemispheric ambient + directional lights, the first with a soft shadow). Specular: each light
//! and a few windows of the surroundings are lobes `exp(k (r . l - 1))` around the mirrored view direction,
//! weighted by Schlick's Fresnel term. None of it is calibrated; it only has to vary as much as reality does.

use super::config::LookConfig;
use super::random::Draw;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use pseudoflow_geometry::{Intrinsics, Pose};
use pseudoflow_imaging::raster::{Background, Item, Scene, Scratch, Surface};
use rand::Rng;

/// A distant light or a bright part of the surroundings.
#[derive(Debug, Clone, Copy)]
struct Lamp {
    /// Unit vector to the light, in the camera's frame.
    direction: Vector3<f32>,
    /// Linear RGB.
    colour: [f32; 3],
    /// Sharpness factor of its reflection (small for windows, large for lamps).
    sharpness: f32,
}

/// All light of a scene, in the camera's frame.
#[derive(Debug, Clone)]
pub(super) struct Lighting {
    up: Vector3<f32>,
    sky: [f32; 3],
    ground: [f32; 3],
    lamps: Vec<Lamp>,
    windows: Vec<Lamp>,
    /// Soft edges of shadows of things outside the picture: plane normal, offset (m), width (m), what is left.
    edges: Vec<([f32; 3], f32, f32, f32)>,
    /// Radius of each light's shadow blur, in texels of the shadow map; none for lights that cast none.
    softness_px: Vec<f32>,
    /// Strength of ambient occlusion, 0 to 1.
    occlusion: f32,
}

/// Shadows of a scene.
pub(super) struct Shadows {
    /// Of the first lights.
    lamps: Vec<ShadowMap>,
    /// Of the sky: what stands above a place darkens it.
    sky: Option<ShadowMap>,
}

/// How a mesh answers to light.
#[derive(Debug, Clone)]
pub(super) struct Material {
    /// Factor on each linear channel.
    tint: [f32; 3],
    /// 1 keeps the texture's saturation, 0 makes it grey.
    saturation: f32,
    /// `v^contrast` for linear albedos v, even in the square root of v; empty when the exponent is 1.
    contrast: Vec<f32>,
    /// Which channel of the texture feeds red, green and blue.
    channels: [usize; 3],
    /// Reflectance at normal incidence.
    gloss: f32,
    /// Exponent k of the reflection lobes.
    sharpness: f32,
}

impl Material {
    /// A material for the object to be found: its texture, slightly off in colour, dull to glossy.
    pub(super) fn of_target(rng: &mut impl Rng, config: &LookConfig) -> Self {
        let gain = rng.uniform32(0.75, 1.15);
        Self {
            tint: std::array::from_fn(|_| gain * rng.uniform32(0.9, 1.08)),
            saturation: rng.uniform32(0.8, 1.2),
            contrast: contrast_table(rng.log_uniform32(0.75, 1.3)),
            channels: [0, 1, 2],
            gloss: if rng.chance(config.gloss) { rng.log_uniform32(0.01, 0.12) } else { 0.0 },
            sharpness: rng.log_uniform32(6.0, 250.0),
        }
    }

    /// A material for other things: also with its colours exchanged.
    pub(super) fn of_distractor(rng: &mut impl Rng, config: &LookConfig) -> Self {
        const ORDERS: [[usize; 3]; 4] = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
        Self { channels: ORDERS[rng.below(ORDERS.len())], ..Self::of_target(rng, config) }
    }

    fn albedo(&self, srgb: [f32; 3]) -> [f32; 3] {
        let linear = self.channels.map(|k| linear_from_srgb(srgb[k]));
        let grey = luminance(linear);
        std::array::from_fn(|k| {
            let value = (grey + self.saturation * (linear[k] - grey)).max(0.0);
            self.tint[k] * contrasted(&self.contrast, value)
        })
    }
}

/// Entries of a contrast table, which ends at albedo [`LAST_ALBEDO`].
const CONTRAST: usize = 96;
const LAST_ALBEDO: f32 = 1.2;

fn contrast_table(exponent: f32) -> Vec<f32> {
    if (exponent - 1.0).abs() < 0.02 {
        return Vec::new();
    }
    let value = |i: usize| LAST_ALBEDO * (i as f32 / (CONTRAST - 1) as f32).powi(2);
    (0..CONTRAST).map(|i| value(i).powf(exponent)).collect()
}

fn contrasted(table: &[f32], value: f32) -> f32 {
    if table.is_empty() {
        return value;
    }
    let at = (value.min(LAST_ALBEDO) * (1.0 / LAST_ALBEDO)).sqrt() * (CONTRAST - 1) as f32;
    let low = (at as usize).min(CONTRAST - 2);
    table[low] + (at - low as f32) * (table[low + 1] - table[low])
}

impl Lighting {
    /// Draws the light; `up` points away from the table, `centre_m` and `diameter_m` are the object's.
    pub(super) fn draw(
        rng: &mut impl Rng,
        config: &LookConfig,
        up: Vector3<f32>,
        centre_m: Vector3<f32>,
        diameter_m: f32,
    ) -> Self {
        let hard = rng.chance(config.hard_light);
        let ambient = if hard { rng.uniform32(0.06, 0.35) } else { rng.uniform32(0.3, 0.95) };
        let sky = warm_or_cool(rng).map(|c| c * ambient);
        let bounce = rng.uniform32(0.2, 0.9);
        let ground = warm_or_cool(rng).map(|c| c * ambient * bounce);
        let count = if hard { 1 + rng.below(2) } else { 1 + rng.below(3) };
        let lamp = |rng: &mut _, strength: f32, sharpness: f32| Lamp {
            direction: above(rng, up),
            colour: warm_or_cool(rng).map(|c| c * strength),
            sharpness,
        };
        let strength = (1.3 - ambient) / (count as f32).sqrt();
        let lamps = (0..count).map(|i| lamp(rng, strength / (1 + i) as f32, 1.0)).collect();
        let windows = (0..rng.below(4))
            .map(|_| {
                let (strength, sharpness) = (rng.log_uniform32(0.3, 3.0), rng.log_uniform32(0.03, 0.5));
                lamp(rng, strength, sharpness)
            })
            .collect();
        let edges = (0..rng.below(3)).map(|_| shadow_edge(rng, centre_m, diameter_m)).collect();
        let casting = if rng.chance(config.shadows) { count.min(2) } else { 0 };
        let softness_px = (0..casting).map(|_| rng.log_uniform32(0.7, 14.0)).collect();
        let occlusion = config.ambient_occlusion as f32 * rng.uniform32(0.5, 1.0);
        Self { up, sky, ground, lamps, windows, edges, softness_px, occlusion }
    }

    /// The depth of the scene as the first lights and the sky see it.
    pub(super) fn shadows(&self, items: &[Item<'_>], centre_m: Vector3<f32>, diameter_m: f32) -> Shadows {
        let map =
            |direction: Vector3<f32>, softness: f32| ShadowMap::new(items, centre_m, diameter_m, direction, softness);
        let lamps = self.lamps.iter().zip(&self.softness_px).map(|(lamp, softness)| map(lamp.direction, *softness));
        let sky = (self.occlusion > 0.0).then(|| map(self.up, SKY_SOFTNESS_PX));
        Shadows { lamps: lamps.collect(), sky }
    }

    /// Linear RGB that leaves a surface towards the camera.
    pub(super) fn shade(&self, surface: &Surface, material: &Material, shadows: &Shadows) -> [f32; 3] {
        let (normal, view) = (Vector3::from(surface.normal_in_camera), Vector3::from(surface.to_camera));
        let lit = self.irradiance(surface, normal, shadows);
        let albedo = material.albedo(surface.albedo);
        let mut out: [f32; 3] = std::array::from_fn(|k| albedo[k] * lit[k]);
        if material.gloss > 0.0 {
            let mirrored = normal * (2.0 * normal.dot(&view)) - view;
            let fresnel =
                material.gloss + (1.0 - material.gloss) * 0.5 * (1.0 - normal.dot(&view).clamp(0.0, 1.0)).powi(5);
            for lamp in self.lamps.iter().chain(&self.windows) {
                let k = material.sharpness * lamp.sharpness;
                let exponent = k * (mirrored.dot(&lamp.direction) - 1.0);
                if exponent > -10.0 {
                    let lobe = fresnel * (1.0 + 0.15 * k) * exponent.exp();
                    (0..3).for_each(|c| out[c] += lobe * lamp.colour[c]);
                }
            }
        }
        out
    }

    /// Light that falls on a surface, linear RGB.
    fn irradiance(&self, surface: &Surface, normal: Vector3<f32>, shadows: &Shadows) -> [f32; 3] {
        let point_m = Vector3::from(surface.point_in_camera);
        let upward = 0.5 + 0.5 * normal.dot(&self.up);
        let lit = |map: &ShadowMap| map.lit(&(point_m + normal * map.bias_m));
        let open = 1.0 + self.occlusion * (surface.openness - 1.0);
        let above = shadows.sky.as_ref().map_or(1.0, |map| 1.0 + 0.75 * self.occlusion * (lit(map) - 1.0));
        let (sky, ground) = (open * above * upward, open * (1.0 - upward));
        let mut sum: [f32; 3] = std::array::from_fn(|k| sky * self.sky[k] + ground * self.ground[k]);
        for (index, lamp) in self.lamps.iter().enumerate() {
            let facing = normal.dot(&lamp.direction);
            if facing > 0.0 {
                let light = facing * shadows.lamps.get(index).map_or(1.0, lit);
                (0..3).for_each(|k| sum[k] += light * lamp.colour[k]);
            }
        }
        let left = self.edges.iter().fold(1.0, |left, (n, offset_m, width_m, rest)| {
            let side = ((Vector3::from(*n).dot(&point_m) - offset_m) / width_m).clamp(-1.0, 1.0);
            left * (rest + (1.0 - rest) * (0.5 + 0.25 * side * (3.0 - side * side)))
        });
        sum.map(|c| c * left)
    }
}

fn warm_or_cool(rng: &mut impl Rng) -> [f32; 3] {
    let t = rng.uniform32(-1.0, 1.0);
    if t > 0.0 { [1.0, 1.0 - 0.2 * t, 1.0 - 0.5 * t] } else { [1.0 + 0.3 * t, 1.0 + 0.12 * t, 1.0] }
}

/// A direction of the upper half, rather steep than grazing.
fn above(rng: &mut impl Rng, up: Vector3<f32>) -> Vector3<f32> {
    let v = rng.direction() + up * 0.6;
    let v = if v.dot(&up) < 0.0 { v - up * (2.0 * v.dot(&up)) } else { v };
    v.try_normalize(1e-4).unwrap_or(up)
}

fn shadow_edge(rng: &mut impl Rng, centre_m: Vector3<f32>, diameter_m: f32) -> ([f32; 3], f32, f32, f32) {
    let normal = rng.direction();
    let offset_m = normal.dot(&centre_m) + diameter_m * rng.uniform32(-0.5, 0.5);
    (normal.into(), offset_m, diameter_m * rng.log_uniform32(0.02, 0.6), rng.uniform32(0.35, 0.95))
}

/// The nearest depth along one light.
#[derive(Debug)]
pub(super) struct ShadowMap {
    /// 1 / depth from the light, 1/m; 0 where nothing is.
    inverse_depth: Vec<f32>,
    light_from_camera: Isometry3<f32>,
    intrinsics: Intrinsics,
    softness_px: f32,
    bias_m: f32,
}

/// Sample places of the blur, in units of its radius.
const TAPS: [[f32; 2]; 8] =
    [[0.1, -0.2], [-0.45, 0.25], [0.5, 0.4], [-0.2, -0.65], [0.75, -0.35], [-0.85, -0.25], [0.1, 0.8], [-0.4, 0.9]];
const SHADOW_SIZE: usize = 128;
/// Blur of the sky's shadow: 0.2 diameters.
const SKY_SOFTNESS_PX: f32 = 11.0;

impl ShadowMap {
    /// The light stands 20 diameters away and sees a circle of 2.4 diameters around the object.
    fn new(
        items: &[Item<'_>],
        centre_m: Vector3<f32>,
        diameter_m: f32,
        to_light: Vector3<f32>,
        softness_px: f32,
    ) -> Self {
        let (distance_m, half) = (20.0 * diameter_m, SHADOW_SIZE as f64 / 2.0);
        let eye = centre_m + to_light * distance_m;
        let helper = if to_light.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() };
        let rotation = UnitQuaternion::face_towards(&-to_light, &helper).inverse();
        let light_from_camera = Isometry3::from_parts(Translation3::from(-(rotation * eye)), rotation);
        let focal = half * 20.0 / 1.2;
        let intrinsics = Intrinsics { fx: focal, fy: focal, cx: half - 0.5, cy: half - 0.5 };
        let pose: Pose = light_from_camera.cast();
        let mut items = items.to_vec();
        items.iter_mut().for_each(|item| item.camera_from_object = pose * item.camera_from_object);
        let (size, background) = (SHADOW_SIZE as u32, Background::Colour([0; 3]));
        let scene = Scene { items: &items, intrinsics, width: size, height: size, background };
        let mut seen = Scratch::default();
        seen.cover(&scene);
        let inverse_depth = seen.inverse_depths().to_vec();
        Self { inverse_depth, light_from_camera, intrinsics, softness_px, bias_m: 0.02 * diameter_m }
    }

    /// The share of the light that reaches a point of the camera's frame.
    fn lit(&self, point_m: &Vector3<f32>) -> f32 {
        let p = self.light_from_camera * Point3::from(*point_m);
        let k = &self.intrinsics;
        let (x, y) = (k.fx as f32 * p.x / p.z + k.cx as f32, k.fy as f32 * p.y / p.z + k.cy as f32);
        // Nearer to the light than the point, bias taken off, is what hides it.
        let limit = 1.0 / (p.z - self.bias_m).max(1e-6);
        let free = |tap: &[f32; 2]| {
            let (x, y) = (x + tap[0] * self.softness_px + 0.5, y + tap[1] * self.softness_px + 0.5);
            let inside = x >= 0.0 && y >= 0.0 && x < SHADOW_SIZE as f32 && y < SHADOW_SIZE as f32;
            !inside || self.inverse_depth[y as usize * SHADOW_SIZE + x as usize] < limit
        };
        TAPS.iter().filter(|tap| free(tap)).count() as f32 / TAPS.len() as f32
    }
}

/// sRGB (0 to 1) to linear light: a cubic within 0.002 of IEC 61966-2-1.
pub(super) fn linear_from_srgb(v: f32) -> f32 {
    v * (v * (v * 0.305_306 + 0.682_171_1) + 0.012_522_878)
}

/// Luminance of linear RGB (Rec. 709).
pub(super) fn luminance([r, g, b]: [f32; 3]) -> f32 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

#[cfg(test)]
mod tests {
    use super::super::random::stream;
    use super::*;

    #[test]
    fn the_srgb_cubic_is_near_the_standard() {
        for i in 0..=255 {
            let v = i as f32 / 255.0;
            let exact = if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) };
            assert!((linear_from_srgb(v) - exact).abs() < 0.002, "{v}");
        }
    }

    #[test]
    fn light_is_finite_positive_and_comes_from_above() {
        let up = Vector3::new(0.0, -1.0, 0.0);
        for index in 0..100 {
            let mut rng = stream(2, index);
            let look = LookConfig::default();
            let lighting = Lighting::draw(&mut rng, &look, up, Vector3::new(0.0, 0.0, 1.0), 0.2);
            assert!(lighting.lamps.iter().all(|lamp| lamp.direction.dot(&up) >= -1e-5));
            let surface = Surface {
                item: 0,
                albedo: [0.5; 3],
                openness: 1.0,
                point_in_camera: [0.0, 0.0, 0.9],
                point_in_object: [0.0; 3],
                normal_in_camera: [0.0, 0.0, -1.0],
                to_camera: [0.0, 0.0, -1.0],
            };
            let out =
                lighting.shade(&surface, &Material::of_target(&mut rng, &look), &Shadows { lamps: vec![], sky: None });
            assert!(out.iter().all(|c| c.is_finite() && *c > 0.0), "{out:?}");
        }
    }
}
