use pseudoflow_contour::ContourError;

/// What is wrong with the settings of a tracker.
#[derive(Debug, thiserror::Error)]
pub enum TrackingError {
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
    /// Settings of the contour.
    #[error(transparent)]
    Contour(#[from] ContourError),
    /// No object to follow.
    #[error("there is no object to follow: give an object set")]
    NoObject,
}
