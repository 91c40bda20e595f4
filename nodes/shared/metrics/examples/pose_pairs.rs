//! Errors of many pose pairs on one mesh, timed: the counterpart of `tests/compare/metrics_vs_numpy.py`, which writes
//! the input and checks the output.
//!
//! `pose_pairs DIR` reads little-endian `f64` files of DIR: `points.bin` (n x 3, metres), `pairs.bin` (m x 24: R and t
//! of estimate, then of truth), `symmetries.bin` (k x 12), `k.bin` (fx, fy, cx, cy). It writes `errors.bin` (m x 4:
//! ADD, ADI, MSSD, MSPD) and prints the seconds that each took, as one JSON object.
#![allow(clippy::print_stdout)] // its purpose

use pseudoflow_geometry::{Intrinsics, Pose, pose_from_row_major};
use pseudoflow_metrics::{MatrixPose, ModelPoints, add_m, adi_m, mspd_px, mssd_m};
use rayon::prelude::*;
use std::error::Error;
use std::path::Path;
use std::time::Instant;

fn read(path: &Path) -> std::io::Result<Vec<f64>> {
    let bytes = std::fs::read(path)?;
    Ok(bytes.chunks_exact(8).map(|c| f64::from_le_bytes(std::array::from_fn(|i| c[i]))).collect())
}

fn pose(numbers: &[f64]) -> Result<Pose, Box<dyn Error>> {
    Ok(pose_from_row_major(&numbers[..9].try_into()?, &numbers[9..12].try_into()?)?)
}

fn main() -> Result<(), Box<dyn Error>> {
    let dir = std::env::args().nth(1).ok_or("usage: pose_pairs DIR")?;
    let dir = Path::new(&dir);
    let points: Vec<_> = read(&dir.join("points.bin"))?.chunks_exact(3).map(nalgebra::Point3::from_slice).collect();
    let pairs = read(&dir.join("pairs.bin"))?;
    let pairs = pairs
        .chunks_exact(24)
        .map(|n| Ok((pose(n)?.into(), pose(&n[12..])?.into())))
        .collect::<Result<Vec<_>, Box<dyn Error>>>()?;
    let symmetries = read(&dir.join("symmetries.bin"))?;
    let symmetries = symmetries.chunks_exact(12).map(pose).collect::<Result<Vec<_>, _>>()?;
    let k = read(&dir.join("k.bin"))?;
    let intrinsics = Intrinsics { fx: k[0], fy: k[1], cx: k[2], cy: k[3] };

    let start = Instant::now();
    let model = ModelPoints::new(&points)?;
    let build_s = start.elapsed().as_secs_f64();
    let timed = |f: &(dyn Fn(&MatrixPose, &MatrixPose) -> f64 + Sync)| {
        let start = Instant::now();
        let errors: Vec<f64> = pairs.par_iter().map(|(est, gt)| f(est, gt)).collect();
        (errors, start.elapsed().as_secs_f64())
    };
    let (add, add_s) = timed(&|e, g| add_m(&model, e, g));
    let (adi, adi_s) = timed(&|e, g| adi_m(&model, e, g));
    let (mssd, mssd_s) = timed(&|e, g| mssd_m(&model, e, g, &symmetries));
    let (mspd, mspd_s) = timed(&|e, g| mspd_px(&model, e, g, &intrinsics, &symmetries));
    let rows = (0..pairs.len()).flat_map(|i| [add[i], adi[i], mssd[i], mspd[i]]).flat_map(f64::to_le_bytes);
    std::fs::write(dir.join("errors.bin"), rows.collect::<Vec<u8>>())?;
    println!(r#"{{"build": {build_s}, "add": {add_s}, "adi": {adi_s}, "mssd": {mssd_s}, "mspd": {mspd_s}}}"#);
    Ok(())
}
