//! Runs the camera of the node `bridge`, for the interop tests and for measuring a frame's hop over DDS:
//! `receive_images raw|compressed FRAMES`.
//!
//! Expects 640 x 480 images on `/camera/image` with `/camera/camera_info` (fx 600, fy 601, cx 319.5, cy 239.5) and
//! `/camera/detections` (object 5). Image i, from 0 on, is plain: R = i mod 256, G = 100, B = 200, and its stamp is
//! the wall clock's time of sending. Prints the hops' times; ends with an error when one is missing or wrong.

#![allow(clippy::print_stdout, reason = "a measurement for people and scripts")]

use pseudoflow_bridge::{Bridge, BridgeConfig, CameraConfig, Transport};
use pseudoflow_msgs::{CameraFrame, Message, ObjectPoses};
use pseudoflow_runtime::{Context, InMemory, Inputs, Node, NodeError, Produced};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

fn main() -> Result<(), NodeError> {
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("info,rustdds=off,ros2_client=error"))
        .init();
    let mut arguments = std::env::args().skip(1);
    let transport = match arguments.next().as_deref() {
        Some("raw") => Transport::Raw,
        Some("compressed") => Transport::Compressed,
        _ => return Err("usage: receive_images raw|compressed FRAMES".into()),
    };
    let frames: u64 = arguments.next().ok_or("usage: receive_images raw|compressed FRAMES")?.parse()?;
    let context = Context { name: "camera".into(), seed: 0, out_dir: ".".into(), restarts: 0, replay: false };
    let mut camera = Bridge::create(config(transport), &context)?;
    let mut hops_us = receive(&mut camera, frames, &context)?;
    hops_us.sort_unstable();
    let at = |quantile: f64| hops_us[((hops_us.len() - 1) as f64 * quantile) as usize];
    println!("frames {frames} of {frames}, hop over DDS: p50 {} us, p99 {} us", at(0.5), at(0.99));
    Ok(())
}

fn config(transport: Transport) -> BridgeConfig {
    let detections = Some("/camera/detections".into());
    let camera = CameraConfig { transport, detections, queue_depth: 30, ..CameraConfig::of_topic("/camera/image") };
    BridgeConfig { camera: Some(camera), ..BridgeConfig::default() }
}

/// Fewer frames than these are more than chance losses.
const LEAST_PERCENT: u64 = 95;

fn receive(camera: &mut Bridge, frames: u64, context: &Context) -> Result<Vec<i64>, NodeError> {
    let tolerance = if config_is_lossless() { 0 } else { 4 };
    let mut hops_us = Vec::new();
    let mut outputs = InMemory::default();
    let mut last = Instant::now();
    while (hops_us.len() as u64) < frames {
        match camera.poll(&mut outputs, context)? {
            Produced::Frame(key) => {
                let now_ns = SystemTime::now().duration_since(UNIX_EPOCH)?.as_nanos() as i64;
                check(&outputs, key.index, tolerance)?;
                hops_us.push((now_ns - key.stamp_ns) / 1000);
                last = Instant::now();
            }
            // Cameras are heard best effort, as ROS 2 does it: a datagram may be lost on a busy machine.
            _ if last.elapsed() > Duration::from_secs(20) => break,
            _ => std::thread::sleep(Duration::from_micros(50)),
        }
    }
    match hops_us.len() as u64 {
        came if came * 100 >= frames * LEAST_PERCENT => Ok(hops_us),
        came => Err(format!("{came} of {frames} frames, then none for 20 s").into()),
    }
}

/// JPEG may change a plain colour a little.
fn config_is_lossless() -> bool {
    std::env::args().nth(1).as_deref() == Some("raw")
}

fn check(outputs: &InMemory, index: u64, tolerance: u8) -> Result<(), NodeError> {
    let frame = CameraFrame::view(outputs.bytes("frame").ok_or("no frame was sent")?)?;
    // The red of a picture is its number among those sent: that of the frame, and as many more as were lost before it.
    let first = frame.rgb[0];
    let lost = first.wrapping_sub(index as u8).min(index.wrapping_sub(u64::from(first)) as u8);
    let expected = [first, 100, 200];
    if u64::from(lost) > 5 + u64::from(tolerance) {
        return Err(format!("frame {index} is that of number {first}").into());
    }
    let wrong = frame.rgb.chunks_exact(3).find(|p| p.iter().zip(&expected).any(|(a, b)| a.abs_diff(*b) > tolerance));
    if let Some(pixel) = wrong {
        return Err(format!("frame {index}: pixel {pixel:?} is not {expected:?}: a frame was lost or damaged").into());
    }
    let header = frame.header;
    if (header.width, header.height, header.frame_id()) != (640, 480, "camera_optical")
        || header.intrinsics != [600.0, 601.0, 319.5, 239.5]
    {
        return Err(format!("frame {index}: wrong header {header:?}").into());
    }
    let initial = ObjectPoses::view(outputs.bytes("initial_poses").ok_or("no initial poses were sent")?)?;
    let [pose] = initial.poses else { return Err(format!("frame {index}: {} poses", initial.poses.len()).into()) };
    if (pose.object_id, pose.translation_m, pose.rotation_xyzw) != (5, [0.1, 0.2, 0.3], [0.0, 0.0, 0.0, 1.0]) {
        return Err(format!("frame {index}: wrong initial pose {pose:?}").into());
    }
    Ok(())
}
