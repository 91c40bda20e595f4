//! Prints the processor time of a rendering by one thread for every object of a set at several sizes.
//!
//! `cargo run --release -p pseudoflow-imaging --example render_bench -- ../shared/data/tabletop/models`
#![allow(clippy::print_stdout)] // a bench talks to people

use pseudoflow_geometry::{Crop, Intrinsics, Pose};
use pseudoflow_imaging::raster::{Background, Headlight, Item, Rendering, Scene, Scratch, Shader, render_scene};
use pseudoflow_imaging::{Object, ObjectSet};
use std::sync::OnceLock;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = std::env::args().nth(1).unwrap_or_else(|| "../shared/data/tabletop/models".to_owned());
    let start = Instant::now();
    let set = ObjectSet::load(folder.as_ref())?;
    println!("{} objects loaded in {:.0} ms", set.len(), start.elapsed().as_secs_f64() * 1e3);
    for object in set.iter() {
        let triangles = object.mesh.triangles.len();
        print!("{:16} {triangles:6} triangles, closed {}:", object.name, object.mesh.closed);
        for size_px in [128, 256] {
            print!("  {size_px} px {:.2} ms", time_ms(object, size_px, &Headlight::default()));
        }
        println!();
    }
    Ok(())
}

/// Mean over 93 renderings at as many orientations.
fn time_ms<S: Shader>(object: &Object, size_px: u32, shader: &S) -> f64 {
    let intrinsics = Intrinsics { fx: 600.0, fy: 600.0, cx: 320.0, cy: 240.0 };
    let (mut scratch, mut out) = (Scratch::default(), Rendering::new(size_px, size_px));
    let (start, rounds) = (now_ms(), 93);
    for i in 0..rounds {
        let pose = Pose::translation(0.0, 0.0, 0.9) * Pose::rotation([0.7 * f64::from(i), 0.4, 0.2].into());
        let Some(crop) = Crop::around(&object.hull_m, &pose, &intrinsics, 1.1, size_px) else { continue };
        let items = [Item { mesh: &object.mesh, camera_from_object: pose }];
        let intrinsics = crop.intrinsics(&intrinsics);
        let background = Background::Colour([128; 3]);
        let scene = Scene { items: &items, intrinsics, width: size_px, height: size_px, background };
        render_scene(&scene, shader, &mut scratch, &mut out);
    }
    (now_ms() - start) / f64::from(rounds)
}

/// The processor time of this thread (Linux), so that other processes do not count; elsewhere the time of day.
fn now_ms() -> f64 {
    static START: OnceLock<Instant> = OnceLock::new();
    let stat = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let cpu_ns: Option<f64> = stat.and_then(|s| s.split_whitespace().next()?.parse().ok());
    cpu_ns.map_or_else(|| START.get_or_init(Instant::now).elapsed().as_secs_f64() * 1e3, |ns| ns * 1e-6)
}
