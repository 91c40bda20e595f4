use crate::ledger::Ledger;
use crate::live::{Ears, LiveCamera};
use crate::names::Names;
use crate::publish::PosePublisher;
use crate::{BridgeConfig, BridgeError, DdsEnvironment, Participant};
use pseudoflow_msgs::{CameraFrame, DetectedFrame, ObjectPoses, ObjectStatuses};
use pseudoflow_runtime::supervisor::{Severity, Warnings};
use pseudoflow_runtime::{
    BadFrames, Context, Inputs, MissingInput, Node, NodeError, Outputs, Port, PortSpec, Produced, Refused, Role,
};
use std::time::{Duration, Instant};

pub(crate) const POSES: Port<ObjectPoses<'static>> = Port::optional("poses");
pub(crate) const FRAME: Port<CameraFrame<'static>> = Port::optional("frame");
pub(crate) const STATUS: Port<ObjectStatuses<'static>> = Port::optional("status");
pub(crate) const INITIAL_POSES: Port<ObjectPoses<'static>> = Port::optional("initial_poses");
pub(crate) const FOUND: Port<ObjectPoses<'static>> = Port::optional("found");
pub(crate) const DETECTED: Port<DetectedFrame<'static>> = Port::optional("detected");

/// How long the participant stays after the last message, for subscribers that ask for a repeat.
const LINGER: Duration = Duration::from_millis(200);
/// How often `diagnostics` may be published.
const REPORT: Duration = Duration::from_secs(1);

/// The node `bridge`.
pub struct Bridge {
    publisher: PosePublisher,
    camera: Option<LiveCamera>,
    names: Names,
    ledger: Ledger,
    reported: Instant,
    participant: Participant,
    /// What the other nodes of the graph warn of.
    others: Warnings,
    /// Name of this node in the graph.
    name: String,
}

impl Node for Bridge {
    const KIND: &'static str = "bridge";
    const ROLE: Role = Role::LiveSource;
    type Config = BridgeConfig;

    fn inputs() -> Vec<PortSpec> {
        vec![POSES.spec(), FRAME.spec(), STATUS.spec()]
    }

    fn outputs() -> Vec<PortSpec> {
        vec![FRAME.spec(), INITIAL_POSES.spec(), FOUND.spec(), DETECTED.spec()]
    }

    fn check(config: &BridgeConfig) -> Result<(), NodeError> {
        DdsEnvironment::of_process()?.check_middleware(config.allow_rmw_mismatch)?;
        Ok(config.check()?)
    }

    fn create(config: BridgeConfig, context: &Context) -> Result<Self, NodeError> {
        let catalogue = config.checked()?;
        let environment = DdsEnvironment::of_process()?;
        let unheard = environment.check_middleware(config.allow_rmw_mismatch)?;
        let names = Names::new(&config);
        let mut participant = Participant::open(environment, &config.namespace, &config.node_name)?;
        let publisher = PosePublisher::new(&mut participant, &names, &config, catalogue)?;
        let camera = LiveCamera::open(&mut participant, &names, &config, context)?;
        let (mut ledger, reported) = (Ledger::default(), Instant::now());
        names.unused().into_iter().for_each(|line| ledger.say(line));
        let variable = |name: &str| std::env::var_os(name).map(|value| value.to_string_lossy().into_owned());
        DdsEnvironment::not_honoured(variable).into_iter().for_each(|line| ledger.say(line));
        let other = DdsEnvironment::other_release(variable("ROS_DISTRO").as_deref());
        other.into_iter().chain(unheard).for_each(|line| ledger.say(line));
        let others = Warnings::of_run(&context.out_dir, context.restarts > 0);
        let name = context.name.clone();
        Ok(Self { publisher, camera, names, ledger, reported, participant, others, name })
    }

    /// Publishes a frame's poses. Where the graph gives no `frame`, they are poses of the bridge's own camera.
    fn process(&mut self, inputs: &dyn Inputs, _: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
        self.report()?;
        let poses = POSES.read(inputs)?;
        let key = inputs.key();
        let frame_id = match (FRAME.given(inputs)?, self.camera.as_ref().map(LiveCamera::frame_id)) {
            (Some(frame), _) => frame.header.frame_id(),
            (None, Some(Some(frame_id))) => frame_id,
            (None, Some(None)) => {
                log::info!("frame {}: its image came in an earlier life of this node; not published", key.index);
                return Ok(());
            }
            (None, None) => return Err(MissingInput(FRAME.name()).into()),
        };
        let statuses = STATUS.given(inputs)?.map(|message| message.statuses);
        Ok(self.publisher.publish(&mut self.participant, &self.names, key, frame_id, poses.poses, statuses)?)
    }

    fn poll(&mut self, outputs: &mut dyn Outputs, _: &Context) -> Result<Produced, NodeError> {
        let camera = self.camera.as_mut().ok_or(BridgeError::NoCamera)?;
        let mut ears = Ears {
            participant: &mut self.participant,
            names: &self.names,
            naming: self.publisher.naming(),
            ledger: &mut self.ledger,
        };
        let produced = camera.poll(&mut ears, outputs)?;
        self.report()?;
        Ok(produced)
    }

    fn take_refused(&mut self) -> Option<Refused> {
        self.ledger.take_refused()
    }

    /// On `diagnostics` they stand beside what did not even get in.
    fn hear_of_bad(&mut self, bad: &[BadFrames], context: &Context) -> Result<(), NodeError> {
        bad.iter().filter(|of| of.node != context.name).for_each(|of| self.ledger.other_node(of));
        Ok(self.report()?)
    }

    fn finish(&mut self, _: &Context) -> Result<(), NodeError> {
        self.pass_on();
        std::thread::sleep(LINGER);
        log::info!("published {:?}", self.publisher.published());
        Ok(())
    }
}

impl Bridge {
    /// The participant: who has been found so far.
    #[must_use]
    pub fn participant(&self) -> &Participant {
        &self.participant
    }

    /// Passes on what was dropped: the lines of the log at once, the account, and what other nodes warn of, once a second.
    fn report(&mut self) -> Result<(), BridgeError> {
        self.ledger.take_said().iter().for_each(|line| self.participant.say(Severity::Warning, None, line));
        if self.reported.elapsed() >= REPORT {
            self.reported = Instant::now();
            self.publisher.report(&mut self.ledger)?;
            self.pass_on();
        }
        Ok(())
    }

    /// What other nodes warn of goes out on /rosout; this one's own lines do already.
    fn pass_on(&mut self) {
        for warning in self.others.take().iter().filter(|warning| warning.node != self.name) {
            self.participant.say(warning.severity, Some(&warning.node), &warning.text);
        }
    }
}
