use crate::onnxruntime::copy;
use crate::{Engine, InferenceError, Input, Output};
use rten::{Model, NodeId, RunOptions, ThreadPool, ValueOrView};
use rten_tensor::TensorView;
use rten_tensor::prelude::*;
use std::sync::Arc;

const ENGINE: &str = "rten";

/// The engine inside the binary.
pub(crate) struct Rten {
    model: Model,
    pool: Option<Arc<ThreadPool>>,
}

impl Rten {
    pub(crate) fn open(onnx: &[u8], threads: usize) -> Result<Self, InferenceError> {
        let failed = |cause: String| InferenceError::Load { engine: ENGINE, cause };
        let model = Model::load(onnx.to_vec()).map_err(|error| failed(error.to_string()))?;
        let pool = (threads > 0).then(|| Arc::new(ThreadPool::with_num_threads(threads)));
        Ok(Self { model, pool })
    }

    fn node(&self, name: &str) -> Result<NodeId, String> {
        self.model.node_id(name).map_err(|error| format!("`{name}`: {error}"))
    }

    fn compute(&self, inputs: &[Input<'_>], outputs: &mut [Output<'_>]) -> Result<(), String> {
        let mut values: Vec<(NodeId, ValueOrView<'_>)> = Vec::with_capacity(inputs.len());
        for input in inputs {
            values.push((self.node(input.name)?, TensorView::from_data(input.shape, input.data).into()));
        }
        let wanted = outputs.iter().map(|output| self.node(output.name)).collect::<Result<Vec<_>, _>>()?;
        let options = RunOptions::default().with_thread_pool(self.pool.clone());
        let found = self.model.run(values, &wanted, Some(options)).map_err(|error| error.to_string())?;
        for (value, output) in found.into_iter().zip(outputs) {
            let tensor: rten_tensor::Tensor<f32> =
                value.try_into().map_err(|_| format!("`{}` is not an f32 tensor", output.name))?;
            copy(&tensor.to_vec(), output)?;
        }
        Ok(())
    }
}

impl Engine for Rten {
    fn describe(&self) -> String {
        format!("{ENGINE} (embedded, CPU)")
    }

    fn run(&mut self, inputs: &[Input<'_>], outputs: &mut [Output<'_>]) -> Result<(), InferenceError> {
        self.compute(inputs, outputs).map_err(|cause| {
            let (input, shape) =
                inputs.first().map_or_else(Default::default, |i| (i.name.to_owned(), i.shape.to_vec()));
            InferenceError::Run { engine: ENGINE, input, shape, cause }
        })
    }
}
