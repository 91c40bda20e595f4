//! Where the network's cells lie in its input.

/// Pixels between the cells of each level.
pub const STRIDES: [usize; 3] = [8, 16, 32];

/// Objects from 2 to 8 cells across belong to a level, so that most belong to two; the finest takes smaller ones too, the
/// coarsest larger ones.
const ACROSS: [f32; 2] = [2.0, 8.0];

/// One location of one level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cell {
    /// Place in [`STRIDES`].
    pub level: usize,
    /// Its centre, pixels of the input (centres at integers).
    pub centre_px: [f32; 2],
    /// Unit of its corner offsets, pixels.
    pub unit_px: f32,
}

/// All cells of an input: level by level, row by row.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    /// Width and height of the input, pixels.
    pub input_px: [usize; 2],
    /// The cells.
    pub cells: Vec<Cell>,
}

impl Grid {
    /// The cells of an input of this size.
    #[must_use]
    pub fn new(width: usize, height: usize) -> Self {
        let level = |(level, stride): (usize, usize)| {
            let centre = move |i: usize| (i * stride) as f32 + (stride as f32 - 1.0) / 2.0;
            let at = move |x: usize, y: usize| Cell {
                level,
                centre_px: [centre(x), centre(y)],
                unit_px: 4.0 * stride as f32,
            };
            (0..height / stride).flat_map(move |y| (0..width / stride).map(move |x| at(x, y)))
        };
        Self { input_px: [width, height], cells: STRIDES.into_iter().enumerate().flat_map(level).collect() }
    }

    /// Whether objects whose projection has this larger side are learned at a level.
    #[must_use]
    pub fn takes(level: usize, side_px: f32) -> bool {
        let across = side_px / STRIDES[level] as f32;
        (across >= ACROSS[0] || level == 0) && (across <= ACROSS[1] || level + 1 == STRIDES.len())
    }
}
