/// What is wrong with the arguments of a call. What is wrong with the *data* is a [`crate::PnpStatus`] instead.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PnpError {
    /// Two slices that belong together differ in length.
    #[error("{points} object points but {pixels} pixels: each point needs exactly one pixel")]
    Length {
        /// Count of object points.
        points: usize,
        /// Count of pixels.
        pixels: usize,
    },
    /// An image plane has the wrong number of elements.
    #[error("plane `{plane}` has {got} elements, a field of {size_px} x {size_px} pixels needs {need}")]
    Plane {
        /// Name of the plane.
        plane: &'static str,
        /// Side of the field, pixels.
        size_px: usize,
        /// Elements found.
        got: usize,
        /// Elements needed.
        need: usize,
    },
    /// A setting is out of its range.
    #[error("setting `{name}` is {got}: it must be {must}")]
    Setting {
        /// Name of the setting.
        name: &'static str,
        /// The value given.
        got: f64,
        /// What would be right.
        must: &'static str,
    },
}

/// What is wrong with the settings of the joint solver.
#[derive(Debug, thiserror::Error)]
pub enum JointError {
    /// Of the flow's part.
    #[error(transparent)]
    Pnp(#[from] PnpError),
    /// Of the contour's part.
    #[error(transparent)]
    Contour(#[from] pseudoflow_contour::ContourError),
}
