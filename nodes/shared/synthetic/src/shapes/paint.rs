//! What procedural shapes are painted with.

use super::MeshParts;
use super::crease::Creased;
use crate::pattern::Pattern;
use crate::random::Draw;
use image::Rgb;
use pseudoflow_imaging::RgbImage;
use rand::Rng;

/// How a shape is coloured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Paint {
    /// One colour, by vertex.
    Plain,
    /// A colour for each part.
    Parts,
    /// Soft or hard blotches, or a change along an axis, by vertex.
    Blotches,
    /// A texture.
    Texture,
}

/// Side of a painted texture, pixels.
const TEXTURE_PX: u32 = 128;

impl Paint {
    /// Plain ones are as frequent as textured ones: on them flow alone is weak.
    pub(super) fn draw(rng: &mut impl Rng) -> Self {
        match rng.below(10) {
            0..3 => Self::Plain,
            3..5 => Self::Parts,
            5..7 => Self::Blotches,
            _ => Self::Texture,
        }
    }

    pub(super) fn apply(self, rng: &mut impl Rng, creased: Creased) -> MeshParts {
        let Creased { vertices, normals, texcoords, part, triangles } = creased;
        let mut parts = MeshParts { vertices_m: vertices, normals, triangles, ..MeshParts::default() };
        let vertices = &parts.vertices_m;
        match self {
            Self::Plain => parts.colours = vec![byte(any_colour(rng)); vertices.len()],
            Self::Parts => {
                let most = part.iter().max().map_or(1, |p| usize::from(*p) + 1);
                let palette: Vec<[u8; 3]> = (0..most).map(|_| byte(any_colour(rng))).collect();
                parts.colours = part.iter().map(|p| palette[usize::from(*p)]).collect();
            }
            Self::Blotches => {
                let busy = rng.chance(0.3);
                let pattern = Pattern::draw(rng, busy);
                let size = vertices.iter().flatten().fold(1e-6_f32, |most, c| most.max(c.abs()));
                let scale = rng.log_uniform32(0.15, 0.6) / size;
                let colour = |v: &[f32; 3]| {
                    let [x, y, z] = v.map(|c| c * scale);
                    byte(pattern.colour(x + 0.35 * z, y + 0.8 * z))
                };
                parts.colours = vertices.iter().map(colour).collect();
            }
            Self::Texture => {
                let pattern = Pattern::draw(rng, true);
                let overlay = rng.chance(0.5).then(|| (Pattern::draw(rng, true), rng.uniform32(0.2, 0.6)));
                let label = [rng.uniform32(0.0, 0.5), rng.uniform32(0.5, 1.0)];
                let unit = rng.log_uniform32(0.6, 2.0) / TEXTURE_PX as f32;
                parts.texture = Some(RgbImage::from_fn(TEXTURE_PX, TEXTURE_PX, |x, y| {
                    let (u, v) = (x as f32 * unit, y as f32 * unit);
                    // A label around the middle of the surface, as on tins and bottles.
                    let height = y as f32 / TEXTURE_PX as f32;
                    let labelled = overlay.as_ref().filter(|_| label[0] < height && height < label[1]);
                    Rgb(byte(match labelled {
                        Some((over, strength)) if *strength > 0.3 => over.colour(u, v),
                        _ => pattern.colour(u, v),
                    }))
                }));
                parts.texcoords = texcoords;
            }
        }
        parts
    }
}

/// Grey, dull or strong, dark or light.
fn any_colour(rng: &mut impl Rng) -> [f32; 3] {
    let saturation = rng.uniform32(0.0, 1.0);
    rng.colour(saturation, (0.08, 1.0))
}

fn byte(colour: [f32; 3]) -> [u8; 3] {
    colour.map(|c| (c.clamp(0.0, 1.0) * 255.0 + 0.5) as u8)
}
