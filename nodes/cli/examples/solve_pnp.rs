//! A pose from points of an object and the pixels that see them (PnP), although a third of them is wrong.
//!
//!     cargo run --release --example solve_pnp

#![allow(clippy::print_stdout, reason = "an example talks to people")]

use nalgebra::{Point3, Vector3};
use pseudoflow_geometry::{Intrinsics, Pose, rotation_angle_rad};
use pseudoflow_solver::{Correspondences, PnpConfig, PnpResult, Solver};

/// A pinhole camera of 640 x 480 pixels: focal lengths and principal point, pixels.
pub(crate) const CAMERA: Intrinsics = Intrinsics { fx: 600.0, fy: 600.0, cx: 319.5, cy: 239.5 };

/// Points on a screw of 6 cm radius and 20 cm height, metres in the object's frame.
pub(crate) fn points_in_object() -> Vec<[f32; 3]> {
    (0..300).map(|i| 0.1 * i as f32).map(|turn| [0.06 * turn.cos(), 0.06 * turn.sin(), turn / 150.0 - 0.1]).collect()
}

/// Where a camera at this pose sees the points; every third pixel is a wrong one.
pub(crate) fn pixels(camera_from_object: &Pose) -> Vec<[f32; 2]> {
    let see = |point: &[f32; 3]| CAMERA.project(&(camera_from_object * Point3::from(*point).cast::<f64>()));
    let wrong = |i: usize| [(37 * i % 640) as f32, (91 * i % 480) as f32];
    let pixel = |(i, point)| match see(point) {
        Some(pixel) if i % 3 > 0 => [pixel.x as f32, pixel.y as f32],
        _ => wrong(i),
    };
    points_in_object().iter().enumerate().map(pixel).collect()
}

/// The pose that explains most pixels. `rough` is tried first; RANSAC needs no better one.
pub(crate) fn solve(pixels: &[[f32; 2]], rough: &Pose) -> Result<PnpResult, Box<dyn std::error::Error>> {
    let points = points_in_object();
    let mut solver = Solver::new(PnpConfig { threshold_px: 2.0, ..PnpConfig::default() })?;
    let seed = 1; // the same seed, the same bits
    Ok(solver.solve(&Correspondences::new(&points, pixels)?, &CAMERA, rough, seed))
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // `camera_from_object` takes points of the object to the camera's frame: x right, y down, z forward.
    let truth = Pose::new(Vector3::new(0.05, -0.02, 0.7), Vector3::new(0.4, -0.9, 0.2));
    let rough = Pose::new(Vector3::new(0.0, 0.0, 0.8), Vector3::new(0.0, -0.5, 0.0));
    let found = solve(&pixels(&truth), &rough)?;
    // The status says whether a pose was found, and if not, why; then the rough pose is given back.
    println!("status: {}; {} inliers, {:.2} px", found.status, found.inliers, found.rms_px);
    let turn_deg = rotation_angle_rad(&found.camera_from_object, &truth).to_degrees();
    let shift_m = (found.camera_from_object.translation.vector - truth.translation.vector).norm();
    println!("off by {turn_deg:.4} degrees and {:.4} mm", 1e3 * shift_m);
    // Row-major 6 x 6: x, y, z, then rotations about x, y, z; camera axes.
    println!("standard deviation of the distance: {:.3} mm", 1e3 * found.covariance[2 * 6 + 2].sqrt());
    Ok(())
}
