//! Procedural objects to train on: superquadrics, turned profiles, extrusions and unions of them, painted plain, by part, by
//! vertex or with a texture. A shape depends on the seed and its number only.

mod crease;
mod paint;
mod solid;

use super::pool::with_openness;
use super::random::{Draw, stream};
use paint::Paint;
use pseudoflow_geometry::Symmetries;
use pseudoflow_imaging::{ImagingError, Mesh, MeshParts, Object};
use rand::Rng;
use solid::Solid;
use std::path::Path;
use std::sync::{Arc, OnceLock};

/// Shapes by number, made when first asked for.
#[derive(Debug)]
pub(super) struct ShapeBank {
    seed: u64,
    shapes: Vec<OnceLock<Arc<Object>>>,
}

impl ShapeBank {
    /// `count` shapes of a seed.
    pub(super) fn new(seed: u64, count: usize) -> Self {
        Self { seed, shapes: (0..count).map(|_| OnceLock::new()).collect() }
    }

    pub(super) fn len(&self) -> usize {
        self.shapes.len()
    }

    /// The shape of a number below [`ShapeBank::len`].
    pub(super) fn at(&self, number: usize) -> Result<&Arc<Object>, ImagingError> {
        let place = &self.shapes[number];
        if let Some(made) = place.get() {
            return Ok(made);
        }
        let made = Arc::new(draw_object(&mut stream(self.seed ^ 0x5a9e_5eed, number as u64), number as u32)?);
        Ok(place.get_or_init(|| made))
    }
}

/// Edges sharper than this stay edges, degrees.
const CREASE_DEG: f32 = 35.0;

/// A random object, 60 to 300 mm long, centred on its bounding box.
pub(super) fn draw_object(rng: &mut impl Rng, id: u32) -> Result<Object, ImagingError> {
    let solid = Solid::draw(rng).fitted(rng.log_uniform32(0.06, 0.3));
    let paint = Paint::draw(rng);
    let parts = paint.apply(rng, crease::split(&solid, CREASE_DEG));
    let mesh = Mesh::new(parts, Path::new("(procedural shape)"))?;
    let (low_m, high_m) = mesh.bounds_m();
    Ok(with_openness(Object {
        id,
        name: format!("shape_{id:06}"),
        mesh_file: None,
        diameter_m: mesh.diameter_m(),
        low_m,
        extents_m: high_m - low_m,
        symmetries: Symmetries::default(),
        hull_m: mesh.hull_points(),
        mesh: Arc::new(mesh),
    }))
}

/// Moves the middle of the bounding box to the origin and makes its longest side `size` long.
fn fit(vertices: &mut [[f32; 3]], size: f32) {
    let start = ([f32::MAX; 3], [f32::MIN; 3]);
    let (low, high) = vertices.iter().fold(start, |(low, high), v| {
        let pick = |f: fn(f32, f32) -> f32, a: [f32; 3]| std::array::from_fn(|k| f(a[k], v[k]));
        (pick(f32::min, low), pick(f32::max, high))
    });
    let longest = (0..3).map(|k| high[k] - low[k]).fold(1e-9, f32::max);
    let scale = size / longest;
    vertices.iter_mut().for_each(|v| *v = std::array::from_fn(|k| scale * (v[k] - 0.5 * (low[k] + high[k]))));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_are_closed_varied_and_as_large_as_said() {
        let bank = ShapeBank::new(3, 60);
        let (mut textured, mut coloured) = (0, 0);
        for number in 0..bank.len() {
            let object = bank.at(number).unwrap();
            assert!(object.mesh.closed, "shape {number} is open");
            assert!((0.05..0.6).contains(&object.diameter_m), "shape {number}: {} m", object.diameter_m);
            assert!((8..9000).contains(&object.mesh.triangles.len()), "{}", object.mesh.triangles.len());
            assert!(object.box_centre_m().coords.norm() < 1e-3 * object.diameter_m);
            textured += usize::from(object.mesh.texture.is_some());
            coloured += usize::from(!object.mesh.colours.is_empty());
        }
        assert!(textured > 8 && coloured > 20, "{textured} textured, {coloured} coloured");
    }

    #[test]
    fn a_shape_depends_on_seed_and_number() {
        let mesh = |seed, number| ShapeBank::new(seed, 8).at(number).unwrap().mesh.vertices_m.clone();
        assert_eq!(mesh(1, 5), mesh(1, 5));
        assert_ne!(mesh(1, 5), mesh(1, 6));
        assert_ne!(mesh(1, 5), mesh(2, 5));
    }
}
