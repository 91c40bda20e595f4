//! Small nodes with every role, which can be told to die at a certain frame and place.

use pseudoflow_msgs::layout::ALIGNMENT;
use pseudoflow_msgs::{FrameKey, MalformedMessage, Message};
use pseudoflow_runtime::{
    BadFrames, Context, Inputs, Node, NodeError, Outputs, PortSpec, Produced, Refused, Registry, Role, bad_input, read,
};
use rand::Rng;
use schemars::JsonSchema;
use serde::Deserialize;
use std::fs;
use std::io::Write;
use std::path::PathBuf;
use std::time::{Duration, Instant};

pub(crate) fn registry() -> Registry {
    Registry::new().with::<Counter>().with::<Ticker>().with::<Mixer>().with::<Learner>().with::<Keeper>()
}

/// Numbers in place.
#[derive(Debug)]
pub(crate) struct Numbers;

impl Message for Numbers {
    const TYPE_NAME: &'static str = "Numbers@1";
    type View<'a> = &'a [u64];
    fn view(bytes: &[u8]) -> Result<&[u64], MalformedMessage> {
        if !(bytes.as_ptr() as usize).is_multiple_of(ALIGNMENT) {
            return Err(MalformedMessage::Unaligned(Self::TYPE_NAME));
        }
        bytemuck::try_cast_slice(bytes).map_err(|_| MalformedMessage::Unaligned(Self::TYPE_NAME))
    }
}

fn send(outputs: &mut dyn Outputs, port: &str, key: FrameKey, numbers: &[u64]) -> Result<(), NodeError> {
    let bytes: &[u8] = bytemuck::cast_slice(numbers);
    outputs.send(port, key, bytes.len(), &mut |block| block.copy_from_slice(bytes))
}

/// How to die: in which life, at which frame, before or after the work of that frame.
#[derive(Debug, Clone, Copy, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Death {
    life: u32,
    frame: u64,
    place: Place,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
enum Place {
    Before,
    After,
    Panic,
    Finish,
    /// Stops itself (SIGSTOP), which is no death.
    Stop,
    /// Loops for ever.
    Spin,
}

/// What every toy can be told.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct Config {
    /// Sources: frames to make.
    frames: u64,
    /// Numbers in a message; it varies with the frame when `vary` is set.
    numbers: usize,
    vary: bool,
    delay_ms: u64,
    period_ms: u64,
    deaths: Vec<Death>,
    /// Fails (an error, no death) at this frame.
    fail_at: Option<u64>,
    /// Fails in its start.
    fail_at_start: bool,
    /// Fails at every frame.
    fail_always: bool,
    /// Fails at the first frame of its first life.
    fail_once: bool,
    /// Cannot use every so manieth frame.
    bad_every: Option<u64>,
    /// Live sources: refuses a message beside every so manieth frame, and goes on until it has heard of so many nodes' inputs
    /// that had bad frames.
    refuse_every: Option<u64>,
    until_heard: Option<usize>,
    /// Takes so long to start.
    start_ms: u64,
    /// Sources: file whose lines count acknowledged frames; more than `window` ahead of it is an error.
    watch: Option<PathBuf>,
    window: u64,
    /// Sinks: frames that are held back before they are safe.
    keep_back: u64,
}

impl Config {
    fn meet_fate(&self, context: &Context, frame: u64, place: Place) {
        let here = |d: &Death| d.life == context.restarts && d.frame == frame && d.place == place;
        if self.deaths.iter().any(here) {
            match place {
                Place::Panic => panic!("a toy that was told to panic"),
                Place::Stop => stop_self(),
                Place::Spin => loop {
                    std::hint::spin_loop();
                },
                _ => kill_self(),
            }
        }
    }

    fn work(&self, context: &Context, frame: u64) -> Result<(), NodeError> {
        self.meet_fate(context, frame, Place::Before);
        [Place::Panic, Place::Stop, Place::Spin].into_iter().for_each(|place| self.meet_fate(context, frame, place));
        if self.delay_ms > 1000 {
            fs::write(context.out_dir.join(format!("{}.busy", context.name)), "")?;
        }
        std::thread::sleep(Duration::from_millis(self.delay_ms));
        if self.bad_every.is_some_and(|every| frame.is_multiple_of(every)) {
            return Err(bad_input("a", format!("told that frame {frame} is bad")));
        }
        match self.fail_always || self.fail_at == Some(frame) || (self.fail_once && context.restarts == 0) {
            true => Err(format!("told to fail at frame {frame}").into()),
            false => Ok(()),
        }
    }
}

fn stop_self() {
    let _ = rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::STOP);
}

fn kill_self() {
    let _ = rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::KILL);
    std::thread::sleep(Duration::from_secs(10));
}

/// Leaves what tests need to find a process and its run.
fn sign_in(context: &Context) -> Result<(), NodeError> {
    fs::write(context.out_dir.join(format!("{}.pid", context.name)), std::process::id().to_string())?;
    let (run, seen) = (context.out_dir.join(".run/ipc.json"), context.out_dir.join("ipc_seen.json"));
    // Nodes of one process have no such file.
    if run.exists() && !seen.exists() {
        fs::copy(run, seen)?;
    }
    Ok(())
}

/// Makes frames on demand.
pub(crate) struct Counter(Config, u64);

impl Node for Counter {
    const KIND: &'static str = "counter";
    const ROLE: Role = Role::ReplaySource;
    type Config = Config;
    fn inputs() -> Vec<PortSpec> {
        vec![]
    }
    fn outputs() -> Vec<PortSpec> {
        vec![PortSpec::required::<Numbers>("numbers"), PortSpec::required::<Numbers>("extra")]
    }
    fn check(config: &Config) -> Result<(), NodeError> {
        if config.window > 64 { Err("window: at most 64".into()) } else { Ok(()) }
    }
    fn create(config: Config, context: &Context) -> Result<Self, NodeError> {
        sign_in(context)?;
        Ok(Self(config, 0))
    }
    fn process(&mut self, _: &dyn Inputs, _: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
        Ok(())
    }
    fn produce(&mut self, index: u64, outputs: &mut dyn Outputs, context: &Context) -> Result<Produced, NodeError> {
        if index >= self.0.frames {
            return Ok(Produced::End);
        }
        self.watch_window(index, context)?;
        self.0.work(context, index)?;
        let key = FrameKey { index, stamp_ns: 1000 + index as i64 * self.0.period_ms.max(1) as i64 * 1_000_000 };
        let count = self.0.numbers.max(1) * if self.0.vary { (index as usize * 7) % 13 + 1 } else { 1 };
        let mut random = context.rng(index, "numbers");
        let numbers: Vec<u64> = (0..count).map(|_| random.random()).collect();
        send(outputs, "numbers", key, &numbers)?;
        self.0.meet_fate(context, index, Place::After);
        send(outputs, "extra", key, &[index])?;
        Ok(Produced::Frame(key))
    }
    fn finish(&mut self, context: &Context) -> Result<(), NodeError> {
        self.0.meet_fate(context, 0, Place::Finish);
        Ok(fs::write(context.out_dir.join("most_in_flight"), self.1.to_string())?)
    }
}

impl Counter {
    fn watch_window(&mut self, index: u64, context: &Context) -> Result<(), NodeError> {
        let Some(file) = &self.0.watch else { return Ok(()) };
        let kept = fs::read_to_string(context.out_dir.join(file)).unwrap_or_default().lines().count() as u64;
        let in_flight = index.saturating_sub(kept);
        self.1 = self.1.max(in_flight);
        if in_flight >= self.0.window {
            return Err(format!("frame {index} asked for with {kept} kept").into());
        }
        Ok(())
    }
}

/// Makes frames when the clock does.
pub(crate) struct Ticker {
    config: Config,
    begin: Instant,
    next: u64,
    /// Lines about what all nodes have dropped.
    heard: Vec<String>,
    refused: u64,
}

impl Node for Ticker {
    const KIND: &'static str = "ticker";
    const ROLE: Role = Role::LiveSource;
    type Config = Config;
    fn inputs() -> Vec<PortSpec> {
        vec![PortSpec::optional::<Numbers>("results")]
    }
    fn outputs() -> Vec<PortSpec> {
        vec![PortSpec::required::<Numbers>("numbers")]
    }
    fn check(_: &Config) -> Result<(), NodeError> {
        Ok(())
    }
    fn create(config: Config, context: &Context) -> Result<Self, NodeError> {
        sign_in(context)?;
        Ok(Self { config, begin: Instant::now(), next: 0, heard: Vec::new(), refused: 0 })
    }
    fn process(&mut self, inputs: &dyn Inputs, _: &mut dyn Outputs, context: &Context) -> Result<(), NodeError> {
        let text = format!("{}\n", inputs.key().index);
        append(&context.out_dir.join("results.txt"), &text)
    }
    fn poll(&mut self, outputs: &mut dyn Outputs, context: &Context) -> Result<Produced, NodeError> {
        if self.next >= self.config.frames {
            let deaf = self.config.until_heard.is_some_and(|lines| self.heard.len() < lines);
            return Ok(if deaf { Produced::Nothing } else { Produced::End });
        }
        let due = self.begin + Duration::from_millis(self.config.period_ms * self.next);
        if Instant::now() < due {
            return Ok(Produced::Nothing);
        }
        let key = FrameKey { index: self.next, stamp_ns: self.next as i64 };
        self.next += 1;
        self.refused += u64::from(self.config.refuse_every.is_some_and(|every| key.index.is_multiple_of(every)));
        self.config.work(context, key.index)?;
        send(outputs, "numbers", key, &vec![key.index; self.config.numbers.max(1)])?;
        Ok(Produced::Frame(key))
    }
    fn take_refused(&mut self) -> Option<Refused> {
        let messages = std::mem::take(&mut self.refused);
        (messages > 0).then(|| Refused { messages, last: "told to refuse".to_owned() })
    }
    fn hear_of_bad(&mut self, bad: &[BadFrames], context: &Context) -> Result<(), NodeError> {
        let of = |bad: &BadFrames| format!("{} {:?} {:?} {}\n", bad.node, bad.input, bad.producer, bad.frames > 0);
        self.heard = bad.iter().map(of).collect();
        Ok(fs::write(context.out_dir.join("heard.txt"), self.heard.concat())?)
    }
}

/// Joins one to three inputs into one output.
pub(crate) struct Mixer(Config);

impl Node for Mixer {
    const KIND: &'static str = "mixer";
    const ROLE: Role = Role::Transform;
    type Config = Config;
    fn inputs() -> Vec<PortSpec> {
        vec![
            PortSpec::required::<Numbers>("a"),
            PortSpec::optional::<Numbers>("b"),
            PortSpec::latest::<Numbers>("weights"),
        ]
    }
    fn outputs() -> Vec<PortSpec> {
        vec![PortSpec::required::<Numbers>("mixed")]
    }
    fn check(_: &Config) -> Result<(), NodeError> {
        Ok(())
    }
    fn create(config: Config, context: &Context) -> Result<Self, NodeError> {
        sign_in(context)?;
        std::thread::sleep(Duration::from_millis(config.start_ms));
        if config.fail_at_start {
            return Err("told to fail in its start".into());
        }
        Ok(Self(config))
    }
    fn process(&mut self, inputs: &dyn Inputs, outputs: &mut dyn Outputs, context: &Context) -> Result<(), NodeError> {
        let key = inputs.key();
        self.0.work(context, key.index)?;
        let b: &[u64] = if inputs.bytes("b").is_some() { read::<Numbers>(inputs, "b")? } else { &[] };
        let mut mixed: Vec<u64> = read::<Numbers>(inputs, "a")?.iter().map(|n| n.rotate_left(7) ^ key.index).collect();
        mixed.extend(b);
        if inputs.bytes("weights").is_some() {
            let version = read::<Numbers>(inputs, "weights")?[0];
            append(&context.out_dir.join("weights.txt"), &format!("{version}\n"))?;
        }
        send(outputs, "mixed", key, &mixed)?;
        self.0.meet_fate(context, key.index, Place::After);
        Ok(())
    }
}

/// Ends a line and sends weights back now and then.
pub(crate) struct Learner(Config);

impl Node for Learner {
    const KIND: &'static str = "learner";
    const ROLE: Role = Role::Transform;
    type Config = Config;
    fn inputs() -> Vec<PortSpec> {
        vec![PortSpec::required::<Numbers>("numbers")]
    }
    fn outputs() -> Vec<PortSpec> {
        vec![PortSpec::required::<Numbers>("weights")]
    }
    fn check(_: &Config) -> Result<(), NodeError> {
        Ok(())
    }
    fn create(config: Config, context: &Context) -> Result<Self, NodeError> {
        sign_in(context)?;
        Ok(Self(config))
    }
    fn process(&mut self, inputs: &dyn Inputs, outputs: &mut dyn Outputs, context: &Context) -> Result<(), NodeError> {
        let key = inputs.key();
        self.0.work(context, key.index)?;
        if key.index.is_multiple_of(5) {
            send(outputs, "weights", key, &[key.index])?;
        }
        Ok(())
    }
}

/// Keeps a line per frame in a file; knows after a death which ones it has.
pub(crate) struct Keeper {
    config: Config,
    file: PathBuf,
    kept: Vec<String>,
}

impl Node for Keeper {
    const KIND: &'static str = "keeper";
    const ROLE: Role = Role::Sink;
    type Config = Config;
    fn inputs() -> Vec<PortSpec> {
        vec![PortSpec::required::<Numbers>("numbers"), PortSpec::optional::<Numbers>("more")]
    }
    fn outputs() -> Vec<PortSpec> {
        vec![]
    }
    fn check(_: &Config) -> Result<(), NodeError> {
        Ok(())
    }
    fn create(config: Config, context: &Context) -> Result<Self, NodeError> {
        sign_in(context)?;
        let file = context.out_dir.join(format!("{}.txt", context.name));
        let old = if context.restarts > 0 { fs::read_to_string(&file).unwrap_or_default() } else { String::new() };
        // A line that was cut off is written again.
        let whole = old.rfind('\n').map_or("", |end| &old[..=end]);
        fs::write(&file, whole)?;
        Ok(Self { config, file, kept: whole.lines().map(str::to_owned).collect() })
    }
    fn process(&mut self, inputs: &dyn Inputs, _: &mut dyn Outputs, context: &Context) -> Result<(), NodeError> {
        let index = inputs.key().index;
        self.config.work(context, index)?;
        let mut sum = inputs.key().stamp_ns as u64;
        for port in ["numbers", "more"].into_iter().filter(|port| inputs.bytes(port).is_some()) {
            for number in read::<Numbers>(inputs, port)? {
                sum = (sum ^ number).wrapping_mul(0x100_0000_01b3);
            }
        }
        let line = format!("{index} {sum:016x}");
        if !self.kept.contains(&line) {
            append(&self.file, &format!("{line}\n"))?;
            self.kept.push(line);
        }
        self.config.meet_fate(context, index, Place::After);
        Ok(())
    }
    fn safe_until(&self, handled: u64) -> u64 {
        handled.saturating_sub(self.config.keep_back)
    }
    fn finish(&mut self, context: &Context) -> Result<(), NodeError> {
        self.config.meet_fate(context, 0, Place::Finish);
        Ok(fs::write(self.file.with_extension("finished"), self.kept.len().to_string())?)
    }
}

fn append(path: &PathBuf, text: &str) -> Result<(), NodeError> {
    Ok(fs::OpenOptions::new().create(true).append(true).open(path)?.write_all(text.as_bytes())?)
}
