//! Time of one 640 x 480 x 3 frame from a process to the next, woken by the event: from before the frame is
//! copied into shared memory to the consumer reading its last byte.
//!
//! `cargo run --release -p pseudoflow-runtime --example hop_bench [frames]`

use pseudoflow_msgs::{CameraFrame, CameraFrameHeader, FrameKey};
use pseudoflow_runtime::supervisor::Options;
use pseudoflow_runtime::{
    Context, Graph, Inputs, Node, NodeError, Outputs, PortSpec, Produced, Registry, Role, read, supervisor,
};
use schemars::JsonSchema;
use serde::Deserialize;
use std::error::Error;
use std::io::Write;
use std::path::Path;
use std::time::Duration;

const WIDTH: u32 = 640;
const HEIGHT: u32 = 480;

fn now_ns() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
struct Config {
    frames: u64,
}

/// Sends a frame every 5 ms, as a camera does; the consumer sleeps in between.
struct Sender(Config, Vec<u8>);

impl Node for Sender {
    const KIND: &'static str = "sender";
    const ROLE: Role = Role::ReplaySource;
    type Config = Config;
    fn inputs() -> Vec<PortSpec> {
        vec![]
    }
    fn outputs() -> Vec<PortSpec> {
        vec![PortSpec::required::<CameraFrame<'static>>("frame")]
    }
    fn check(_: &Config) -> Result<(), NodeError> {
        Ok(())
    }
    fn create(config: Config, _: &Context) -> Result<Self, NodeError> {
        Ok(Self(config, vec![7; (WIDTH * HEIGHT * 3) as usize]))
    }
    fn process(&mut self, _: &dyn Inputs, _: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
        Ok(())
    }
    fn produce(&mut self, index: u64, outputs: &mut dyn Outputs, _: &Context) -> Result<Produced, NodeError> {
        if index == self.0.frames {
            return Ok(Produced::End);
        }
        std::thread::sleep(Duration::from_millis(5));
        let key = FrameKey { index, stamp_ns: now_ns() as i64 };
        let header = CameraFrameHeader {
            width: WIDTH,
            height: HEIGHT,
            scene_id: 0,
            image_id: 0,
            intrinsics: [600.0, 600.0, 320.0, 240.0],
            frame_id: [0; 64],
        };
        outputs.send("frame", key, CameraFrame::byte_len(WIDTH, HEIGHT), &mut |bytes| {
            CameraFrame::write(bytes, header).rgb.copy_from_slice(&self.1);
        })?;
        Ok(Produced::Frame(key))
    }
}

/// Reads the frame in place and notes its age.
struct Receiver(Vec<u64>);

impl Node for Receiver {
    const KIND: &'static str = "receiver";
    const ROLE: Role = Role::Sink;
    type Config = Config;
    fn inputs() -> Vec<PortSpec> {
        vec![PortSpec::required::<CameraFrame<'static>>("frame")]
    }
    fn outputs() -> Vec<PortSpec> {
        vec![]
    }
    fn check(_: &Config) -> Result<(), NodeError> {
        Ok(())
    }
    fn create(_: Config, _: &Context) -> Result<Self, NodeError> {
        Ok(Self(Vec::new()))
    }
    fn process(&mut self, inputs: &dyn Inputs, _: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
        let frame = read::<CameraFrame>(inputs, "frame")?;
        let whole = frame.rgb.first() == Some(&7) && frame.rgb.last() == Some(&7);
        let age_ns = now_ns() - inputs.key().stamp_ns as u64;
        if !whole {
            return Err("a frame came broken".into());
        }
        self.0.push(age_ns);
        Ok(())
    }
    fn finish(&mut self, context: &Context) -> Result<(), NodeError> {
        Ok(std::fs::write(context.out_dir.join("ages.json"), serde_json::to_vec(&self.0)?)?)
    }
}

const GRAPH: &str = "
mode: replay
nodes:
  sender:   {kind: sender, config: {frames: 1000}}
  receiver: {kind: receiver, inputs: {frame: sender/frame}}
";

fn main() -> Result<(), Box<dyn Error>> {
    let registry = Registry::new().with::<Sender>().with::<Receiver>();
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [word, name, _, graph, _, run_dir] = arguments.as_slice()
        && word == "node"
    {
        return Ok(registry.run_node(name, Path::new(graph), Path::new(run_dir))?);
    }
    let mut graph = Graph::parse(GRAPH, Path::new("hop_bench"))?;
    if let Some(frames) = arguments.first() {
        graph.set("sender.frames", frames)?;
    }
    let dir = std::env::temp_dir().join(format!("hop_bench_{}", std::process::id()));
    let summary = supervisor::run(&graph, &registry, &Options { print: false, ..Options::new(&dir) });
    let ages = std::fs::read(dir.join("ages.json"));
    std::fs::remove_dir_all(&dir)?;
    summary?;
    let mut ages: Vec<u64> = serde_json::from_slice(&ages?)?;
    ages.sort_unstable();
    let us = |share: f64| ages[((ages.len() - 1) as f64 * share) as usize] as f64 / 1000.0;
    let mut out = std::io::stdout().lock();
    writeln!(out, "{} frames of {WIDTH} x {HEIGHT} x 3: p50 {:.0} us, p99 {:.0} us", ages.len(), us(0.5), us(0.99))?;
    Ok(())
}
