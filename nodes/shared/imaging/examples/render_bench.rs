//! Prints the time of a rendering, single-threaded, for every object of a set at several sizes.
//!
//! `cargo run --release -p pseudoflow-imaging --example render_bench -- ../shared/data/tabletop/models`
#![allow(clippy::print_stdout)] // a bench talks to people

use pseudoflow_geometry::{Crop, Intrinsics, Pose};
use pseudoflow_imaging::raster::{
    Background, Headlight, Item, Rendering, Scene, Scratch, Shader, Studio, render_scene,
};
use pseudoflow_imaging::{Object, ObjectSet};
use rand::{SeedableRng, rngs::StdRng};
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = std::env::args().nth(1).unwrap_or_else(|| "../shared/data/tabletop/models".to_owned());
    let start = Instant::now();
    let set = ObjectSet::load(folder.as_ref())?;
    println!("{} objects loaded in {:.0} ms", set.len(), start.elapsed().as_secs_f64() * 1e3);
    let studio = Studio::random(1, 1.0, &mut StdRng::seed_from_u64(1));
    for object in set.iter() {
        let triangles = object.mesh.triangles.len();
        print!("{:16} {triangles:6} triangles, closed {}:", object.name, object.mesh.closed);
        for size_px in [128, 256] {
            print!("  {size_px} px {:.2} ms", time_ms(object, size_px, &Headlight::default()));
            print!(" (studio {:.2})", time_ms(object, size_px, &studio));
        }
        println!();
    }
    Ok(())
}

/// Median of 31 renderings at as many orientations.
fn time_ms<S: Shader>(object: &Object, size_px: u32, shader: &S) -> f64 {
    let intrinsics = Intrinsics { fx: 600.0, fy: 600.0, cx: 320.0, cy: 240.0 };
    let (mut scratch, mut out) = (Scratch::default(), Rendering::new(size_px, size_px));
    let mut times: Vec<f64> = (0..31)
        .filter_map(|i| {
            let angle = f64::from(i) * 0.7;
            let pose = Pose::translation(0.0, 0.0, 0.9) * Pose::rotation([angle, 0.4, 0.2].into());
            let crop = Crop::around(&object.hull_m, &pose, &intrinsics, 1.1, size_px)?;
            let items = [Item { mesh: &object.mesh, camera_from_object: pose }];
            let intrinsics = crop.intrinsics(&intrinsics);
            let background = Background::Colour([128; 3]);
            let scene = Scene { items: &items, intrinsics, width: size_px, height: size_px, background };
            let start = Instant::now();
            render_scene(&scene, shader, &mut scratch, &mut out);
            Some(start.elapsed().as_secs_f64() * 1e3)
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}
