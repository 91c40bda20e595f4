//! Solves the problems of tests/compare/pnp_vs_opencv.py, one after another as it asks for them.
//!
//! Reads paths of problem files from stdin, a line each, and answers each with a line of JSON: the pose (row-major 3 x 4),
//! the milliseconds of the solver alone and of building the correspondences, and the result's status.
//!
//! A problem file, little-endian: S (u32), K' as fx fy cx cy (f64), the pose of the reference and the initial pose of the
//! solver (12 f64 each, row-major 3 x 4), depth (S * S f32, metres), mask (S * S u8), flow (S * S * 2 f32, pixels).

use pseudoflow_geometry::{Intrinsics, Pose, pose_from_row_major, rotation_row_major};
use pseudoflow_solver::{FlowField, MinimalSolver, PixelBuffer, PnpConfig, Solver};
use std::error::Error;
use std::io::{BufRead, Write};
use std::time::Instant;

struct Problem {
    size_px: usize,
    intrinsics: Intrinsics,
    reference: Pose,
    initial: Pose,
    depth_m: Vec<f32>,
    mask: Vec<u8>,
    flow_px: Vec<f32>,
}

/// Takes numbers off the front of a file.
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], Box<dyn Error>> {
        let (head, tail) = self.0.split_at_checked(count).ok_or("the problem file is too short")?;
        self.0 = tail;
        Ok(head)
    }

    fn doubles<const N: usize>(&mut self) -> Result<[f64; N], Box<dyn Error>> {
        let bytes = self.take(8 * N)?.as_chunks::<8>().0;
        Ok(std::array::from_fn(|i| f64::from_le_bytes(bytes[i])))
    }

    fn floats(&mut self, count: usize) -> Result<Vec<f32>, Box<dyn Error>> {
        Ok(self.take(4 * count)?.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect())
    }

    fn pose(&mut self) -> Result<Pose, Box<dyn Error>> {
        let m: [f64; 12] = self.doubles()?;
        let rotation = [m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]];
        Ok(pose_from_row_major(&rotation, &[m[3], m[7], m[11]])?)
    }
}

fn read(path: &str) -> Result<Problem, Box<dyn Error>> {
    let file = std::fs::read(path)?;
    let mut bytes = Bytes(&file);
    let size_px = u32::from_le_bytes(bytes.take(4)?.try_into()?) as usize;
    let [fx, fy, cx, cy] = bytes.doubles()?;
    Ok(Problem {
        size_px,
        intrinsics: Intrinsics { fx, fy, cx, cy },
        reference: bytes.pose()?,
        initial: bytes.pose()?,
        depth_m: bytes.floats(size_px * size_px)?,
        mask: bytes.take(size_px * size_px)?.to_vec(),
        flow_px: bytes.floats(2 * size_px * size_px)?,
    })
}

fn answer(problem: &Problem, solver: &mut Solver, buffer: &mut PixelBuffer) -> Result<String, Box<dyn Error>> {
    let field = FlowField {
        certainty: None,
        size_px: problem.size_px,
        depth_m: &problem.depth_m,
        mask: &problem.mask,
        flow_px: &problem.flow_px,
        intrinsics: problem.intrinsics,
        camera_from_object: problem.reference,
    };
    let start = Instant::now();
    let correspondences = buffer.fill(&field, usize::MAX)?;
    let built = Instant::now();
    let result = solver.solve(&correspondences, &problem.intrinsics, &problem.initial, 1);
    let (build_ms, solve_ms) = ((built - start).as_secs_f64() * 1e3, built.elapsed().as_secs_f64() * 1e3);
    let (r, t) = (rotation_row_major(&result.camera_from_object), result.camera_from_object.translation);
    let pose = [r[0], r[1], r[2], t.x, r[3], r[4], r[5], t.y, r[6], r[7], r[8], t.z];
    Ok(format!(
        "{{\"pose\": {pose:?}, \"solve_ms\": {solve_ms}, \"build_ms\": {build_ms}, \"points\": {}, \"status\": \"{}\"}}",
        correspondences.len(),
        result.status
    ))
}

/// Arguments: `epnp` for EPnP samples in place of P3P, `refine=N` to refine on at most N points.
fn config() -> Result<PnpConfig, Box<dyn Error>> {
    let mut config = PnpConfig::default();
    for argument in std::env::args().skip(1) {
        match argument.split_once('=') {
            None if argument == "epnp" => config.minimal = MinimalSolver::Epnp,
            Some(("refine", n)) => config.max_refine_points = n.parse()?,
            Some(("width", w)) => config.tukey_width = w.parse()?,
            _ => return Err(format!("unknown argument {argument}").into()),
        }
    }
    Ok(config)
}

fn main() -> Result<(), Box<dyn Error>> {
    let (mut solver, mut buffer) = (Solver::new(config()?)?, PixelBuffer::new());
    let mut out = std::io::stdout().lock();
    for path in std::io::stdin().lock().lines() {
        writeln!(out, "{}", answer(&read(&path?)?, &mut solver, &mut buffer)?)?;
        out.flush()?;
    }
    Ok(())
}
