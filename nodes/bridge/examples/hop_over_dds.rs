//! How long a 640 x 480 frame takes from one process to another over DDS (RustDDS, loopback, best effort), to be held
//! beside the same hop over iceoryx2: `hop_over_dds [FRAMES]`. Starts itself a second time as the sender; the receiver
//! sleeps until a message comes.

#![allow(clippy::print_stdout, reason = "a measurement for people and scripts")]

use pseudoflow_bridge::{DdsEnvironment, Participant, publisher_qos, sensor_qos};
use pseudoflow_msgs::ros::{Header, Image, Time};
use ros2_client::Name;
use std::process::Command;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

type Error = Box<dyn std::error::Error + Send + Sync>;

const TOPIC: &str = "/hop";
const WARM_UP: usize = 20;

fn main() -> Result<(), Error> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.as_slice() {
        [role, frames] if role == "send" => send(frames.parse()?),
        [] => receive(300),
        [frames] => receive(frames.parse()?),
        _ => Err("usage: hop_over_dds [FRAMES]".into()),
    }
}

fn now_ns() -> Result<i64, Error> {
    Ok(SystemTime::now().duration_since(UNIX_EPOCH)?.as_nanos() as i64)
}

fn send(frames: usize) -> Result<(), Error> {
    let mut participant = Participant::open(DdsEnvironment::of_process()?, "/", "hop_sender")?;
    let publisher = participant.publisher::<Image>(&Name::parse(TOPIC)?, &publisher_qos(10))?;
    while participant.subscribers(TOPIC) == 0 {
        std::thread::sleep(Duration::from_millis(10));
    }
    std::thread::sleep(Duration::from_millis(500));
    let pixels = vec![7; 640 * 480 * 3];
    for _ in 0..frames + WARM_UP {
        // The clock starts before the driver's buffer is copied into the message, as it does in `hop_bench`.
        let stamp = Time::from_ns(now_ns()?).ok_or("no stamp")?;
        let image = Image {
            header: Header { stamp, frame_id: "camera".into() },
            height: 480,
            width: 640,
            encoding: "rgb8".into(),
            is_bigendian: 0,
            step: 640 * 3,
            data: pixels.clone(),
        };
        publisher.publish(image)?;
        std::thread::sleep(Duration::from_millis(20));
    }
    std::thread::sleep(Duration::from_millis(500));
    Ok(())
}

fn receive(frames: usize) -> Result<(), Error> {
    let mut participant = Participant::open(DdsEnvironment::of_process()?, "/", "hop_receiver")?;
    let subscription = participant.subscription::<Image>(&Name::parse(TOPIC)?, &sensor_qos(10))?;
    let mut sender = Command::new(std::env::current_exe()?).args(["send", &frames.to_string()]).spawn()?;
    let (hops, received) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        loop {
            let Ok((image, _)) = pollster::block_on(subscription.async_take()) else { return };
            let hop = now_ns().map(|now| now - image.header.stamp.as_ns());
            if hop.is_err() || hops.send(hop.unwrap_or(0)).is_err() {
                return;
            }
        }
    });
    let status = sender.wait()?;
    let mut hops_ns: Vec<i64> = received.try_iter().skip(WARM_UP).collect();
    if !status.success() || hops_ns.is_empty() {
        return Err(format!("sender: {status}, {} frames received", hops_ns.len()).into());
    }
    hops_ns.sort_unstable();
    let at_us = |quantile: f64| hops_ns[((hops_ns.len() - 1) as f64 * quantile) as usize] as f64 / 1000.0;
    println!(
        "640x480 over DDS: {} of {frames} frames, p50 {:.0} us, p99 {:.0} us",
        hops_ns.len(),
        at_us(0.5),
        at_us(0.99)
    );
    Ok(())
}
