//! Closed surfaces of random form.

use super::fit;
use crate::random::Draw;
use nalgebra::{UnitQuaternion, Vector3};
use rand::Rng;
use std::f32::consts::{FRAC_PI_2, PI, TAU};

/// A closed surface: vertices, where each lies on a texture, which part it belongs to; triangles counter-clockwise seen from
/// outside. Parts of a union reach into each other.
#[derive(Debug, Clone, Default)]
pub(super) struct Solid {
    pub(super) vertices: Vec<[f32; 3]>,
    pub(super) texcoords: Vec<[f32; 2]>,
    pub(super) part: Vec<u8>,
    pub(super) triangles: Vec<[u32; 3]>,
}

impl Solid {
    /// Any form, about one unit large.
    pub(super) fn draw(rng: &mut impl Rng) -> Self {
        if rng.chance(0.45) { Self::draw_part(rng) } else { Self::draw_union(rng) }
    }

    /// Scaled to a length, metres, and centred.
    pub(super) fn fitted(mut self, size_m: f32) -> Self {
        fit(&mut self.vertices, size_m);
        self
    }

    fn draw_part(rng: &mut impl Rng) -> Self {
        let mut solid = match rng.below(4) {
            0 => superquadric(rng),
            1 => turned(rng),
            2 => extruded(rng),
            _ => ring(rng),
        };
        if rng.chance(0.35) {
            solid.bend(rng);
        }
        if rng.chance(0.3) {
            solid.bulge(rng);
        }
        solid
    }

    /// Two to five parts that touch: each is moved towards a vertex of what is there.
    fn draw_union(rng: &mut impl Rng) -> Self {
        let mut whole = Self::draw_part(rng);
        fit(&mut whole.vertices, 1.0);
        let mirrored = rng.chance(0.4);
        for _ in 0..1 + rng.below(4) {
            let mut part = Self::draw_part(rng);
            let size = rng.log_uniform32(0.2, 0.9);
            fit(&mut part.vertices, size);
            let at = whole.vertices[rng.below(whole.vertices.len())];
            let rotation = rng.rotation().cast::<f32>();
            let inward = rng.uniform32(0.7, 1.0);
            part.place(&rotation, Vector3::from(at) * inward);
            let twin = mirrored.then(|| part.mirrored());
            whole.join(part);
            twin.into_iter().for_each(|twin| whole.join(twin));
        }
        whole
    }

    fn place(&mut self, rotation: &UnitQuaternion<f32>, offset: Vector3<f32>) {
        self.vertices.iter_mut().for_each(|v| *v = (rotation * Vector3::from(*v) + offset).into());
    }

    /// Mirrored at x = 0, as the limbs of an animal are.
    fn mirrored(&self) -> Self {
        let mut twin = self.clone();
        twin.vertices.iter_mut().for_each(|v| v[0] = -v[0]);
        twin.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        twin
    }

    fn join(&mut self, other: Self) {
        let (first, part) = (self.vertices.len() as u32, self.part.iter().max().map_or(0, |p| p + 1));
        self.vertices.extend(other.vertices);
        self.texcoords.extend(other.texcoords);
        self.part.extend(other.part.iter().map(|_| part));
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|i| i + first)));
    }

    /// Bends the long axis into an arc.
    fn bend(&mut self, rng: &mut impl Rng) {
        fit(&mut self.vertices, 1.0);
        let angle = rng.uniform32(0.3, 1.4);
        for v in &mut self.vertices {
            let (t, radius) = (angle * v[2], 1.0 / angle);
            *v = [(radius - v[0]) * -t.cos() + radius, v[1], (radius - v[0]) * t.sin()];
        }
    }

    /// Smooth bumps: the surface moves along the direction from the middle.
    fn bulge(&mut self, rng: &mut impl Rng) {
        fit(&mut self.vertices, 1.0);
        let waves: Vec<(Vector3<f32>, f32, f32)> = (0..5)
            .map(|_| {
                let direction = rng.direction();
                (direction * rng.uniform32(2.0, 9.0), rng.uniform32(0.0, TAU), rng.uniform32(0.02, 0.07))
            })
            .collect();
        for v in &mut self.vertices {
            let p = Vector3::from(*v);
            let sum: f32 = waves.iter().map(|(k, phase, size)| size * (k.dot(&p) + phase).sin()).sum();
            *v = (p * (1.0 + sum)).into();
        }
    }
}

/// Rings of points from bottom to top, each `around` long; joined, and closed by a point at each end.
fn rings(rings: &[Vec<[f32; 3]>]) -> Solid {
    let (rows, around) = (rings.len(), rings[0].len());
    let mut solid = Solid::default();
    for (row, ring) in rings.iter().enumerate() {
        for i in 0..=around {
            solid.vertices.push(ring[i % around]);
            solid.texcoords.push([i as f32 / around as f32, 0.05 + 0.9 * row as f32 / (rows - 1).max(1) as f32]);
        }
    }
    let at = |row: usize, i: usize| (row * (around + 1) + i) as u32;
    for row in 0..rows - 1 {
        for i in 0..around {
            let (a, b, c, d) = (at(row, i), at(row, i + 1), at(row + 1, i + 1), at(row + 1, i));
            solid.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    for (row, top) in [(0, false), (rows - 1, true)] {
        let middle = |k: usize| rings[row].iter().map(|p| p[k]).sum::<f32>() / around as f32;
        let centre = solid.vertices.len() as u32;
        solid.vertices.push([0, 1, 2].map(middle));
        solid.texcoords.push([0.5, if top { 1.0 } else { 0.0 }]);
        for i in 0..around {
            let (a, b) = (at(row, i), at(row, i + 1));
            solid.triangles.push(if top { [a, b, centre] } else { [b, a, centre] });
        }
    }
    solid.part = vec![0; solid.vertices.len()];
    solid
}

fn signed_power(v: f32, exponent: f32) -> f32 {
    v.abs().powf(exponent).copysign(v)
}

/// From boxes over ellipsoids to pinched stars: x = cos^e cos^f ... with axes of their own.
fn superquadric(rng: &mut impl Rng) -> Solid {
    let (vertical, flat) = (rng.log_uniform32(0.15, 1.6), rng.log_uniform32(0.15, 1.6));
    let axes: [f32; 3] = std::array::from_fn(|_| rng.log_uniform32(0.3, 1.0));
    let ring = |row: usize| -> Vec<[f32; 3]> {
        let v = -FRAC_PI_2 + PI * (row as f32 + 0.5) / 20.0;
        let (radius, z) = (signed_power(v.cos(), vertical), signed_power(v.sin(), vertical));
        let point = |i: usize| {
            let u = TAU * i as f32 / 28.0;
            [
                axes[0] * radius * signed_power(u.cos(), flat),
                axes[1] * radius * signed_power(u.sin(), flat),
                axes[2] * z,
            ]
        };
        (0..28).map(point).collect()
    };
    rings(&(0..20).map(ring).collect::<Vec<_>>())
}

/// A turned or cornered body: bottles, pawns, knobs, vases, prisms.
fn turned(rng: &mut impl Rng) -> Solid {
    let sides = if rng.chance(0.7) { 28 } else { 3 + rng.below(7) };
    let count = 3 + rng.below(6);
    let mut profile: Vec<[f32; 2]> = Vec::new();
    let (mut z, mut radius) = (0.0, rng.uniform32(0.15, 0.6));
    profile.push([radius, z]);
    for _ in 0..count {
        match rng.below(3) {
            // A step outwards or inwards.
            0 => radius = (radius * rng.log_uniform32(0.5, 1.8)).clamp(0.06, 0.8),
            // A straight or slanted piece.
            1 => {
                z += rng.uniform32(0.08, 0.6);
                radius = (radius * rng.log_uniform32(0.8, 1.25)).clamp(0.06, 0.8);
            }
            // A round piece.
            _ => {
                let (height, swell) = (rng.uniform32(0.2, 0.6), rng.uniform32(-0.5, 0.9) * radius);
                let (from, start) = (radius, z);
                radius = (radius * rng.log_uniform32(0.6, 1.4)).clamp(0.06, 0.8);
                for i in 1..6 {
                    let t = i as f32 / 6.0;
                    let r = from + t * (radius - from) + swell * (PI * t).sin();
                    profile.push([r.max(0.04), start + t * height]);
                }
                z += height;
            }
        }
        if profile.last().is_none_or(|p| (p[0] - radius).abs() + (p[1] - z).abs() > 1e-3) {
            profile.push([radius, z]);
        }
    }
    if z < 0.05 {
        profile.push([radius, z + 0.4]);
    }
    let (squash, twist) = (if rng.chance(0.3) { rng.uniform32(0.4, 1.0) } else { 1.0 }, rng.uniform32(-0.6, 0.6));
    let twist = if sides < 12 && rng.chance(0.3) { twist } else { 0.0 };
    let ring = |[radius, z]: &[f32; 2]| -> Vec<[f32; 3]> {
        let point = |i: usize| {
            let (sin, cos) = (TAU * i as f32 / sides as f32 + twist * z).sin_cos();
            [radius * cos, squash * radius * sin, *z]
        };
        (0..sides).map(point).collect()
    };
    rings(&profile.iter().map(ring).collect::<Vec<_>>())
}

/// An outline of random corners or waves, pulled along z with taper and a bevel.
fn extruded(rng: &mut impl Rng) -> Solid {
    let outline = outline(rng);
    let (depth, taper) = (rng.log_uniform32(0.08, 1.2), rng.uniform32(0.6, 1.1));
    let bevel = if rng.chance(0.5) { rng.uniform32(0.02, 0.12).min(0.4 * depth) } else { 0.0 };
    let level = |scale: f32, z: f32| outline.iter().map(|[x, y]| [scale * x, scale * y, z]).collect::<Vec<_>>();
    if bevel > 0.0 {
        let inset = 1.0 - bevel;
        rings(&[level(inset, 0.0), level(1.0, bevel), level(taper, depth - bevel), level(taper * inset, depth)])
    } else {
        rings(&[level(1.0, 0.0), level(taper, depth)])
    }
}

/// Star-shaped about the origin, counter-clockwise.
fn outline(rng: &mut impl Rng) -> Vec<[f32; 2]> {
    let squash = rng.uniform32(0.35, 1.0);
    let at = |angle: f32, radius: f32| [radius * angle.cos(), squash * radius * angle.sin()];
    if rng.chance(0.5) {
        let corners = 3 + rng.below(7);
        let turn = |i: usize, rng: &mut _| TAU * (i as f32 + 0.6 * Draw::uniform32(rng, -0.5, 0.5)) / corners as f32;
        return (0..corners).map(|i| at(turn(i, rng), rng.uniform32(0.35, 0.7))).collect();
    }
    let waves: Vec<[f32; 3]> =
        (1..5).map(|n| [n as f32, rng.uniform32(0.0, TAU), rng.uniform32(0.0, 0.3) / n as f32]).collect();
    let radius = |angle: f32| 0.5 * (1.0 + waves.iter().map(|[n, p, a]| a * (n * angle + p).sin()).sum::<f32>());
    (0..30).map(|i| TAU * i as f32 / 30.0).map(|angle| at(angle, radius(angle))).collect()
}

/// A handle: a tube along a part of a circle or an ellipse.
fn ring(rng: &mut impl Rng) -> Solid {
    let (tube, wide, arc) = (rng.uniform32(0.06, 0.2), rng.log_uniform32(0.5, 2.0), rng.uniform32(0.4, 0.92) * TAU);
    let flat = rng.log_uniform32(0.5, 2.0);
    let row = |i: usize| -> Vec<[f32; 3]> {
        let (sin, cos) = (arc * i as f32 / 20.0).sin_cos();
        let point = |j: usize| {
            let (s, c) = (TAU * j as f32 / 10.0).sin_cos();
            let radius = 0.5 + tube * c;
            [radius * cos, flat * tube * s, wide * radius * sin]
        };
        (0..10).map(point).collect()
    };
    rings(&(0..=20).map(row).collect::<Vec<_>>())
}
