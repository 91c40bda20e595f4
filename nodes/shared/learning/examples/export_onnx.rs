//! Writes an ONNX file and a test vector: `export_onnx CONFIG.yaml WEIGHTS.safetensors SIZE ITERATIONS BATCH OUT_DIR`.
//!
//! BATCH 0 leaves the batch open (the vector then has 2 pairs). OUT_DIR gets `flow.onnx` and, as raw little-endian f32,
//! `reference.bin`, `real.bin` and burn's `flow.bin`. `tests/compare/onnx_check.py` runs it and compares.

use pseudoflow_learning::{Device, Raft};
use pseudoflow_network::{ExportOptions, NetworkConfig, Weights, export_onnx};
use std::path::Path;

/// A smooth texture in [-1, 1], shifted by `shift` px.
fn texture(n: usize, size: usize, shift: f32) -> Vec<f32> {
    let wave = |i: usize, c: usize, x: f32, y: f32| {
        let (a, b) = (0.11 + 0.03 * c as f32 + 0.01 * i as f32, 0.07 + 0.02 * c as f32);
        0.5 * (a * x + 0.3 * y).sin() * (b * y - 0.2 * x).cos() + 0.3 * (0.9 * x).sin() * (0.8 * y).sin()
    };
    let pixel = |k: usize| {
        let (p, plane) = (k % (size * size), k / (size * size));
        wave(plane / 3, plane % 3, (p % size) as f32 - shift, (p / size) as f32 - 0.5 * shift)
    };
    (0..n * 3 * size * size).map(pixel).collect()
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [config, weights, size, iterations, batch, out] = args.as_slice() else {
        return Err("arguments: CONFIG.yaml WEIGHTS.safetensors SIZE ITERATIONS BATCH OUT_DIR".into());
    };
    let config = NetworkConfig::from_yaml_file(Path::new(config))?;
    let weights = Weights::load(Path::new(weights), &config)?;
    let (size_px, iterations): (usize, usize) = (size.parse()?, iterations.parse()?);
    let batch = Some(batch.parse()?).filter(|&n: &usize| n > 0);
    let model = export_onnx(&weights, &config, ExportOptions { size_px, iterations, batch })?;
    let n = batch.unwrap_or(2);
    let (reference, real) = (texture(n, size_px, 0.0), texture(n, size_px, 3.0));
    let device = Device::flex();
    let flow =
        Raft::new(&weights, &config, &device)?.infer_slices(&reference, &real, n, size_px, iterations, &device)?;
    let bytes = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let out = Path::new(out);
    std::fs::create_dir_all(out)?;
    for (name, data) in [
        ("flow.onnx", model),
        ("reference.bin", bytes(&reference)),
        ("real.bin", bytes(&real)),
        ("flow.bin", bytes(&flow)),
    ] {
        std::fs::write(out.join(name), data)?;
    }
    Ok(())
}
