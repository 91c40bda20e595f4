use crate::{FlowEngine, FlowError};
use rten::{Model, NodeId, RunOptions, ThreadPool};
use rten_tensor::NdTensorView;
use rten_tensor::prelude::*;
use std::sync::Arc;

const ENGINE: &str = "rten";

/// The engine inside the binary.
pub(crate) struct Rten {
    model: Model,
    reference: NodeId,
    real: NodeId,
    flow: NodeId,
    pool: Option<Arc<ThreadPool>>,
}

impl Rten {
    pub(crate) fn open(onnx: &[u8], threads: usize) -> Result<Self, FlowError> {
        let failed = |cause: String| FlowError::Load { engine: ENGINE, cause };
        let model = Model::load(onnx.to_vec()).map_err(|error| failed(error.to_string()))?;
        let node = |name: &str| model.node_id(name).map_err(|error| failed(format!("`{name}`: {error}")));
        let (reference, real, flow) = (node("reference")?, node("real")?, node("flow")?);
        let pool = (threads > 0).then(|| Arc::new(ThreadPool::with_num_threads(threads)));
        Ok(Self { model, reference, real, flow, pool })
    }
}

impl FlowEngine for Rten {
    fn describe(&self) -> String {
        format!("{ENGINE} (embedded, CPU)")
    }

    fn run(
        &mut self,
        reference: &[f32],
        real: &[f32],
        n: usize,
        size_px: usize,
        flow_px: &mut [f32],
    ) -> Result<(), FlowError> {
        let failed = |cause: String| FlowError::Run { engine: ENGINE, fields: n, size_px, cause };
        let shape = [n, 3, size_px, size_px];
        let inputs = vec![
            (self.reference, NdTensorView::from_data(shape, reference).into()),
            (self.real, NdTensorView::from_data(shape, real).into()),
        ];
        let options = RunOptions::default().with_thread_pool(self.pool.clone());
        let [flow] = self.model.run_n(inputs, [self.flow], Some(options)).map_err(|error| failed(error.to_string()))?;
        let flow: rten_tensor::NdTensor<f32, 4> =
            flow.try_into().map_err(|_| failed("`flow` is not a 4-dimensional f32 tensor".into()))?;
        flow_px.copy_from_slice(&flow.to_vec());
        Ok(())
    }
}
