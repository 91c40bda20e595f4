use crate::{DdsEnvironment, Participant, PosePublisher, PublishConfig};
use pseudoflow_msgs::{CameraFrame, ObjectPoses};
use pseudoflow_runtime::{Context, Inputs, Node, NodeError, Outputs, PortSpec, Role, read};
use std::time::Duration;

/// How long the participant stays after the last message, for subscribers that ask for a repeat.
const LINGER: Duration = Duration::from_millis(200);

/// The node `bridge`: publishes each frame's poses.
pub struct BridgeSink {
    publisher: PosePublisher,
    participant: Participant,
}

impl Node for BridgeSink {
    const KIND: &'static str = "bridge";
    const ROLE: Role = Role::Sink;
    type Config = PublishConfig;

    fn inputs() -> Vec<PortSpec> {
        vec![PortSpec::required::<ObjectPoses>("poses"), PortSpec::required::<CameraFrame>("frame")]
    }

    fn outputs() -> Vec<PortSpec> {
        Vec::new()
    }

    fn check(config: &PublishConfig) -> Result<(), NodeError> {
        DdsEnvironment::of_process()?;
        Ok(config.check()?)
    }

    fn create(config: PublishConfig, _: &Context) -> Result<Self, NodeError> {
        let mut participant = Participant::open(DdsEnvironment::of_process()?, &config.node_name)?;
        let publisher = PosePublisher::new(&mut participant, &config)?;
        Ok(Self { publisher, participant })
    }

    fn process(&mut self, inputs: &dyn Inputs, _: &mut dyn Outputs, _: &Context) -> Result<(), NodeError> {
        let poses = read::<ObjectPoses>(inputs, "poses")?;
        let frame = read::<CameraFrame>(inputs, "frame")?;
        Ok(self.publisher.publish(inputs.key(), frame.header.frame_id(), poses.poses)?)
    }

    fn finish(&mut self, _: &Context) -> Result<(), NodeError> {
        std::thread::sleep(LINGER);
        log::info!("published {:?}", self.publisher.published());
        Ok(())
    }
}

impl BridgeSink {
    /// The participant: who has been found so far.
    #[must_use]
    pub fn participant(&self) -> &Participant {
        &self.participant
    }
}
