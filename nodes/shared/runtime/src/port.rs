use crate::{Inputs, NodeError, Outputs, PortSpec, read};
use pseudoflow_msgs::{FrameKey, Message};
use std::marker::PhantomData;

/// A port of a node kind and the message that it carries: one constant to declare it, to read by it and to send by it, so that its
/// name and its message stand once.
///
/// ```
/// use pseudoflow_msgs::ObjectPoses;
/// use pseudoflow_runtime::{Inputs, NodeError, Port, PortSpec};
///
/// const POSES: Port<ObjectPoses<'static>> = Port::required("poses");
///
/// fn inputs() -> Vec<PortSpec> {
///     vec![POSES.spec()]
/// }
///
/// fn count(inputs: &dyn Inputs) -> Result<usize, NodeError> {
///     Ok(POSES.read(inputs)?.poses.len())
/// }
/// ```
#[derive(Debug)]
pub struct Port<M> {
    spec: PortSpec,
    message: PhantomData<fn() -> M>,
}

impl<M: Message> Port<M> {
    /// As [`PortSpec::required`].
    #[must_use]
    pub const fn required(name: &'static str) -> Self {
        Self { spec: PortSpec::required::<M>(name), message: PhantomData }
    }

    /// As [`PortSpec::optional`].
    #[must_use]
    pub const fn optional(name: &'static str) -> Self {
        Self { spec: PortSpec::optional::<M>(name), message: PhantomData }
    }

    /// As [`PortSpec::latest`].
    #[must_use]
    pub const fn latest(name: &'static str) -> Self {
        Self { spec: PortSpec::latest::<M>(name), message: PhantomData }
    }

    /// As [`PortSpec::late`].
    #[must_use]
    pub const fn late(name: &'static str) -> Self {
        Self { spec: PortSpec::late::<M>(name), message: PhantomData }
    }

    /// The declaration.
    #[must_use]
    pub const fn spec(&self) -> PortSpec {
        self.spec
    }

    /// The name that graphs use.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        self.spec.name
    }

    /// Whether a message has come by it.
    #[must_use]
    pub fn has_come(&self, inputs: &dyn Inputs) -> bool {
        inputs.bytes(self.name()).is_some()
    }

    /// Reads the message in place.
    ///
    /// # Errors
    /// When the port is open; [`BadInput`](crate::BadInput) when the message is malformed.
    pub fn read<'a>(&self, inputs: &'a dyn Inputs) -> Result<M::View<'a>, NodeError> {
        read::<M>(inputs, self.name())
    }

    /// Reads the message of a port that may be open.
    ///
    /// # Errors
    /// [`BadInput`](crate::BadInput) when the message is malformed.
    pub fn given<'a>(&self, inputs: &'a dyn Inputs) -> Result<Option<M::View<'a>>, NodeError> {
        inputs.bytes(self.name()).map(|_| self.read(inputs)).transpose()
    }

    /// Sends a message of `len` bytes: [`Outputs::send`].
    ///
    /// # Errors
    /// When no memory could be had or the node has no such output.
    pub fn send(
        &self,
        outputs: &mut dyn Outputs,
        key: FrameKey,
        len: usize,
        fill: &mut dyn FnMut(&mut [u8]),
    ) -> Result<(), NodeError> {
        outputs.send(self.name(), key, len, fill)
    }
}
