//! Once a solver has grown to the size of its input, solving allocates nothing.

use pseudoflow_geometry::{Intrinsics, Pose};
use pseudoflow_solver::{Correspondences, MinimalSolver, PnpConfig, Solver};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

thread_local! {
    static COUNT: Cell<usize> = const { Cell::new(0) };
}

/// The system's allocator, counting by thread.
struct Counting;

// SAFETY: every call goes to the system's allocator unchanged; the counter is a plain thread-local without a destructor.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.set(COUNT.get() + 1);
        // SAFETY: the caller's promise on `layout` is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: `pointer` came from `System` with this `layout`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// A grid of points on a curved surface, every third one seen somewhere else.
fn grid(camera: &Intrinsics, pose: &Pose) -> (Vec<[f32; 3]>, Vec<[f32; 2]>) {
    let (mut points, mut pixels) = (vec![], vec![]);
    for i in 0..6000 {
        let (x, y) = (f64::from(i % 80) * 1e-3 - 0.04, f64::from(i / 80) * 1e-3 - 0.04);
        let p = nalgebra::Point3::new(x, y, 8.0 * (x * x - y * y) + 0.1 * x);
        let seen = camera.project(&(pose * p)).unwrap();
        let lost = if i % 3 == 0 { f64::from(i * 37 % 101) } else { 0.0 };
        points.push([p.x as f32, p.y as f32, p.z as f32]);
        pixels.push([(seen.x + lost) as f32, (seen.y - 0.7 * lost) as f32]);
    }
    (points, pixels)
}

#[test]
fn solving_again_allocates_nothing() {
    let camera = Intrinsics { fx: 1200.0, fy: 1200.0, cx: 128.0, cy: 128.0 };
    let pose = Pose::new(nalgebra::Vector3::new(0.0, 0.0, 0.7), nalgebra::Vector3::new(0.3, 0.5, -0.2));
    // So far off that RANSAC has to find the pose.
    let initial = Pose::new(nalgebra::Vector3::new(0.0, 0.0, 0.7), nalgebra::Vector3::new(0.0, 0.0, 2.5));
    let (points, pixels) = grid(&camera, &pose);
    let correspondences = Correspondences::new(&points, &pixels).unwrap();
    for minimal in [MinimalSolver::P3p, MinimalSolver::Epnp] {
        let mut solver = Solver::new(PnpConfig { minimal, ..PnpConfig::default() }).unwrap();
        let first = solver.solve(&correspondences, &camera, &initial, 1);
        assert!(first.status.is_ok(), "{}", first.status);
        let before = COUNT.get();
        let second = solver.solve(&correspondences, &camera, &initial, 1);
        assert_eq!(COUNT.get(), before);
        assert_eq!(first, second);
    }
}
