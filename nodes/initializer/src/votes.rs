//! From the network's answer to groups of cells that mean the same instance.

use crate::detect::Rectangle;
use crate::network::Answer;
use nalgebra::{Point2, Vector2};
use pseudoflow_network::{CORNERS, SURFACE_UNIT};

/// What one cell says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vote {
    /// Place of the object among the network's outputs.
    pub class: usize,
    /// How sure the network is, 0..1.
    pub score: f32,
    /// Where the corners of the box are seen, pixels of the input, in the order of `Object::box_corners_m`.
    pub corners_px: [[f32; 2]; CORNERS],
    /// The centre of the cell, pixels of the input.
    pub centre_px: [f32; 2],
    /// The point of the surface that is seen there, diameters from the middle of the object's box.
    pub surface: [f32; 3],
    /// Left, top, right and bottom of the object's projection, pixels of the input.
    pub rectangle_px: [f32; 4],
}

impl Vote {
    /// The rectangle, at least a pixel wide and high.
    #[must_use]
    pub fn rectangle(&self) -> Rectangle {
        let [left, top, right, bottom] = self.rectangle_px.map(f64::from);
        Rectangle {
            middle_px: Point2::new((left + right) / 2.0, (top + bottom) / 2.0),
            size_px: Vector2::new((right - left).max(1.0), (bottom - top).max(1.0)),
        }
    }
}

/// The votes of all cells that are surer than `min_score`, the surest first.
#[must_use]
pub fn votes(answer: &Answer<'_>, min_score: f32) -> Vec<Vote> {
    let cells = answer.grid.cells.len();
    let mut votes: Vec<Vote> = Vec::new();
    for (class, logits) in answer.logits.chunks_exact(cells).enumerate() {
        for (i, logit) in logits.iter().enumerate() {
            let score = 1.0 / (1.0 + (-logit).exp());
            if score < min_score {
                continue;
            }
            let cell = &answer.grid.cells[i];
            let offset = |corner: usize, k: usize| answer.offsets[(class * 2 * CORNERS + 2 * corner + k) * cells + i];
            let corner = |c: usize| [0, 1].map(|k| cell.centre_px[k] + cell.unit_px * offset(c, k));
            let surface = |k: usize| SURFACE_UNIT * answer.surface[(class * 3 + k) * cells + i];
            votes.push(Vote {
                class,
                score,
                corners_px: std::array::from_fn(corner),
                centre_px: cell.centre_px,
                surface: std::array::from_fn(surface),
                rectangle_px: std::array::from_fn(|e| {
                    cell.centre_px[e % 2] + cell.unit_px * answer.rectangles[e * cells + i]
                }),
            });
        }
    }
    votes.sort_by(|a, b| b.score.total_cmp(&a.score));
    votes
}

/// The rectangle that a group of votes means, pixels of the input: the mean of the surest.
#[must_use]
pub fn place(votes: &[Vote]) -> Rectangle {
    let surest = || votes.iter().take(SUREST).map(Vote::rectangle);
    let n = surest().count().max(1) as f64;
    let middle = surest().map(|r| r.middle_px.coords).sum::<Vector2<f64>>() / n;
    Rectangle { middle_px: middle.into(), size_px: surest().map(|r| r.size_px).sum::<Vector2<f64>>() / n }
}

/// How sure the surest votes of a group are, 0..1.
#[must_use]
pub fn sureness(votes: &[Vote]) -> f64 {
    let surest = &votes[..votes.len().min(SUREST)];
    surest.iter().map(|v| f64::from(v.score)).sum::<f64>() / surest.len().max(1) as f64
}

/// So many votes decide where a group is and how sure it is.
const SUREST: usize = 8;

/// Votes belong together up to this distance of their middles, in sides.
const SAME_PLACE: f64 = 0.3;
/// And up to this ratio of their sides.
const SAME_SIZE: f64 = 1.7;

/// Groups of votes for one instance each; the surest vote of a group comes first, and the groups are ordered by it.
#[must_use]
pub fn group(votes: &[Vote]) -> Vec<Vec<Vote>> {
    let mut groups: Vec<Vec<Vote>> = Vec::new();
    for vote in votes {
        let seen = vote.rectangle();
        let same = |group: &&mut Vec<Vote>| {
            let seed = &group[0];
            let (class, seed) = (seed.class, seed.rectangle());
            class == vote.class
                && (seen.middle_px - seed.middle_px).norm() < SAME_PLACE * seed.side_px()
                && seen.side_px() < SAME_SIZE * seed.side_px()
                && seed.side_px() < SAME_SIZE * seen.side_px()
        };
        match groups.iter_mut().find(same) {
            Some(group) => group.push(*vote),
            None => groups.push(vec![*vote]),
        }
    }
    groups
}
