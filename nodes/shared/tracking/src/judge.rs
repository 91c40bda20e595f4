//! How sure a pose is, from what the picture says of it and without any truth.

/// What a frame's picture says of a pose.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Evidence {
    /// How well the lines of the contour agree with it, 0..1.
    pub agreement: f64,
    /// Share of the contour's points that could be read, 0..1.
    pub lines: f64,
    /// Overlap of the colours of both sides, 0..1.
    pub overlap: f64,
    /// Share of the texture's points that agree with it, 0..1; of those that should be in view.
    pub texture: f64,
    /// How many texture points should be in view, as `n / (n + 10)`.
    pub textured: f64,
}

impl Evidence {
    /// Probability that the pose is right to a tenth of the diameter. Weights are learnt on rendered sequences.
    #[must_use]
    pub fn confidence(&self) -> f64 {
        let sum = WEIGHTS[0]
            + WEIGHTS[1] * self.agreement
            + WEIGHTS[2] * self.lines.min(0.5)
            + WEIGHTS[3] * self.overlap
            + WEIGHTS[4] * self.textured * (self.texture - 0.5);
        1.0 / (1.0 + (-sum).exp())
    }

    /// The same by the contour alone.
    #[must_use]
    pub fn of_contour(&self) -> f64 {
        Self { textured: 0.0, ..*self }.confidence()
    }
}

const WEIGHTS: [f64; 5] = [-5.0, 16.0, 4.0, 0.0, 6.0];
