use crate::registry::read_config;
use crate::{Context, Inputs, Node, NodeError, Outputs, Produced};
use serde_yaml::Value;

/// A node without its type.
pub(crate) trait HeldNode {
    fn begin(&mut self, outputs: &mut dyn Outputs, context: &Context) -> Result<(), NodeError>;
    fn ready(&self, inputs: &dyn Inputs) -> Result<bool, NodeError>;
    fn process(&mut self, inputs: &dyn Inputs, outputs: &mut dyn Outputs, context: &Context) -> Result<(), NodeError>;
    fn produce(&mut self, index: u64, outputs: &mut dyn Outputs, context: &Context) -> Result<Produced, NodeError>;
    fn safe_until(&self, handled: u64) -> u64;
    fn finish(&mut self, context: &Context) -> Result<(), NodeError>;
}

struct Held<N>(N);

impl<N: Node> HeldNode for Held<N> {
    fn begin(&mut self, outputs: &mut dyn Outputs, context: &Context) -> Result<(), NodeError> {
        self.0.begin(outputs, context)
    }

    fn ready(&self, inputs: &dyn Inputs) -> Result<bool, NodeError> {
        self.0.ready(inputs)
    }

    fn process(&mut self, inputs: &dyn Inputs, outputs: &mut dyn Outputs, context: &Context) -> Result<(), NodeError> {
        self.0.process(inputs, outputs, context)
    }

    fn produce(&mut self, index: u64, outputs: &mut dyn Outputs, context: &Context) -> Result<Produced, NodeError> {
        self.0.produce(index, outputs, context)
    }

    fn safe_until(&self, handled: u64) -> u64 {
        self.0.safe_until(handled)
    }

    fn finish(&mut self, context: &Context) -> Result<(), NodeError> {
        self.0.finish(context)
    }
}

/// Makes a node from its configuration; errors with what it was doing, and their cause.
pub(crate) fn hold<N: Node + 'static>(
    config: &Value,
    context: &Context,
) -> Result<Box<dyn HeldNode>, (String, String)> {
    let config = read_config::<N>(config).map_err(|error| (error.field, error.what))?;
    let node = N::create(config, context).map_err(|error| ("start".to_owned(), crate::error::chain(&*error)))?;
    Ok(Box::new(Held(node)))
}
