use pseudoflow_runtime::NodeError;
use pseudoflow_solver::{FlowField, PixelBuffer, PnpConfig, PnpResult, Solver};

/// The PnP solver with its thresholds scaled to the crops.
pub(crate) struct CropSolver {
    /// For crops of 256 px.
    config: PnpConfig,
    /// With the size that it was made for.
    solver: Option<(usize, Solver)>,
    buffer: PixelBuffer,
}

impl CropSolver {
    pub(crate) fn new(config: PnpConfig) -> Self {
        Self { config, solver: None, buffer: PixelBuffer::default() }
    }

    /// The solver for crops of a size, pixels; made anew only when the size changes.
    pub(crate) fn of(&mut self, size_px: usize) -> Result<&mut Solver, NodeError> {
        if self.solver.as_ref().is_none_or(|(size, _)| *size != size_px) {
            self.solver = Some((size_px, Solver::new(self.config.clone().scaled_to(size_px))?));
        }
        Ok(&mut self.solver.as_mut().ok_or("no solver")?.1)
    }

    /// The pose that explains most of a field; `seed` is that of RANSAC.
    pub(crate) fn solve(&mut self, field: &FlowField<'_>, seed: u64) -> Result<PnpResult, NodeError> {
        let mut buffer = std::mem::take(&mut self.buffer);
        let correspondences = buffer.fill(field, usize::MAX)?;
        let found = self.of(field.size_px)?.solve(&correspondences, &field.intrinsics, &field.camera_from_object, seed);
        self.buffer = buffer;
        Ok(found)
    }
}
