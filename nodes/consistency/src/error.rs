/// Why no labels could be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ConsistencyError {
    /// A plane of a view has another size than the view.
    #[error("{plane} of view {view} has {found} values; {size_px} x {size_px} pixels need {needed}")]
    Plane {
        /// The view.
        view: usize,
        /// The plane.
        plane: &'static str,
        /// Its values.
        found: usize,
        /// Width and height of the view.
        size_px: usize,
        /// What it should have.
        needed: usize,
    },
    /// Views and flow of different frames or nodes.
    #[error(
        "views and flow do not belong together ({fields} fields for {views} views): connect `flow` to the node that took the same \
         `views`"
    )]
    Fields {
        /// Fields of the flow message.
        fields: usize,
        /// Fields that the views ask for.
        views: usize,
    },
    /// The votes are no input for the solver.
    #[error(transparent)]
    Solver(#[from] pseudoflow_solver::PnpError),
    /// A setting out of range.
    #[error("`{name}: {got}`: give {must}")]
    Setting {
        /// The setting.
        name: &'static str,
        /// Its value.
        got: String,
        /// What is allowed.
        must: &'static str,
    },
}
