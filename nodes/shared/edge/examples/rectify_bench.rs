//! How long a 640 x 480 image takes to rectify, CPU time of one thread: `rectify_bench [IMAGES]`.

#![allow(clippy::print_stdout, reason = "a measurement for people and scripts")]

use pseudoflow_edge::camera::Lens;
use pseudoflow_msgs::ros::{CameraInfo, Header};

/// CPU time of this process, seconds (`/proc/self/schedstat`, nanoseconds).
fn cpu_s() -> f64 {
    let text = std::fs::read_to_string("/proc/self/schedstat").unwrap_or_default();
    text.split_whitespace().next().and_then(|ns| ns.parse::<f64>().ok()).unwrap_or(f64::NAN) * 1e-9
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let images: u32 = std::env::args().nth(1).map_or(Ok(300), |text| text.parse())?;
    let pinhole = CameraInfo::pinhole(Header::default(), (640, 480), [520.0, 518.0, 322.3, 236.1]);
    for (model, d) in [
        ("plumb_bob", vec![-0.28, 0.09, 0.0012, -0.0007, -0.013]),
        ("rational_polynomial", vec![0.42, -2.1, 0.0006, -0.0003, 1.4, 0.31, -1.95, 1.33]),
        ("equidistant", vec![-0.013, 0.021, -0.017, 0.004]),
    ] {
        let info = CameraInfo { distortion_model: model.into(), d, ..pinhole.clone() };
        let begun = cpu_s();
        let lens = Lens::new(&info, (640, 480), false)?;
        let made = cpu_s();
        let mut rgb: Vec<u8> = (0..640 * 480 * 3).map(|i| (i * 7 % 251) as u8).collect();
        let mut scratch = Vec::new();
        (0..images).for_each(|_| lens.rectify(&mut rgb, &mut scratch));
        let each_ms = (cpu_s() - made) / f64::from(images) * 1e3;
        println!("{model}: {:.1} ms once, {each_ms:.2} CPU-ms an image", (made - begun) * 1e3);
    }
    Ok(())
}
