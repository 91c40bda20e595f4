//! How an object lies on a table.

use super::random::Draw;
use nalgebra::{Point3, Vector3};
use pseudoflow_imaging::Object;
use rand::Rng;

/// Steps of the descent to a resting pose.
const STEPS: usize = 60;

/// The direction, in the object's frame, that points down when the object has come to rest after being let go in a random
/// pose.
///
/// An object rests where the height of its middle above the table, `h(d) = max_p d . (p - c)` over its hull points p for the
/// downward direction d, has a local minimum; steps of shrinking length follow the negative subgradient `-(p - c)` on the
/// sphere. The middle of the bounding box stands for the centre of mass.
pub(super) fn draw_down(rng: &mut impl Rng, object: &Object) -> Vector3<f64> {
    let centre = object.box_centre_m();
    let arms: Vec<Vector3<f32>> = object.hull_m.iter().map(|p: &Point3<f64>| (p - centre).cast::<f32>()).collect();
    let mut down = rng.direction();
    let mut step = 0.35_f32;
    for _ in 0..STEPS {
        let Some(lowest) = lowest(&arms, &down) else { break };
        let along = lowest - down * lowest.dot(&down);
        let Some(along) = along.try_normalize(1e-9) else { break };
        // Rolling over the lowest point lowers the middle: down turns away from it.
        down = (down - along * step).normalize();
        step *= 0.93;
    }
    down.cast::<f64>()
}

fn lowest(arms: &[Vector3<f32>], down: &Vector3<f32>) -> Option<Vector3<f32>> {
    arms.iter().max_by(|a, b| a.dot(down).total_cmp(&b.dot(down))).copied()
}

#[cfg(test)]
mod tests {
    use super::super::ObjectPool;
    use super::super::random::stream;
    use super::*;
    use crate::write_sample_objects;

    #[test]
    fn a_box_comes_to_rest_on_a_face() {
        let folder = tempfile::tempdir().unwrap();
        let pool = ObjectPool::load(&[write_sample_objects(folder.path()).unwrap()]).unwrap();
        let mut flat = 0;
        for index in 0..60 {
            let down = draw_down(&mut stream(3, index), pool.at(0));
            assert!(down.amax() > 0.97, "{down}");
            flat += usize::from(down.z.abs() > 0.97);
        }
        // It is 100 x 100 x 50: most falls end on the large faces.
        assert!(flat > 30, "{flat}");
    }
}
