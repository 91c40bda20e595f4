//! Names, shapes and widths of the refiner's weights.

use super::raft::List;
use crate::model::{Init, TensorSpec};
use crate::refiner::REFERENCE_CHANNELS;

/// Channels of the parts.
#[derive(Debug, Clone, Copy)]
pub struct Widths {
    /// Of the trunk at 1/2, 1/4, 1/8 and 1/16.
    pub trunk: [usize; 4],
    /// Features that are correlated, at 1/8 and at 1/16.
    pub matching: usize,
    /// The look at 1/16.
    pub global: usize,
    /// Hidden state of the recurrent part.
    pub hidden: usize,
    /// Context given to it.
    pub context: usize,
    /// Looked-up correlation, encoded.
    pub correlation: usize,
    /// The flow so far, encoded.
    pub flow: usize,
    /// What both become, the flow's two channels included.
    pub motion: usize,
    /// Head of the recurrent part.
    pub head: usize,
}

/// The widths.
pub const WIDTHS: Widths = Widths {
    trunk: [24, 32, 64, 96],
    matching: 64,
    global: 96,
    hidden: 64,
    context: 64,
    correlation: 64,
    flow: 16,
    motion: 48,
    head: 64,
};

/// Levels of the correlation pyramid, the finest at 1/8.
pub const LEVELS: usize = 3;
/// Lookup radius, px of the level.
pub const RADIUS: usize = 3;
/// What the network says of each coarse pixel beside its flow: confidence, scale, visibility.
pub const CERTAINTY: usize = 3;

/// All tensors in a fixed order.
pub(crate) fn layout() -> Vec<TensorSpec> {
    let w = WIDTHS;
    let mut list = List::default();
    let kaiming = Some(Init::KaimingNormal);
    // One stem for the colours of both pictures, so that what looks alike has like features from the first step on; what the
    // rendering's geometry adds begins at nothing.
    list.conv("stem", w.trunk[0], 3, [3, 3], kaiming);
    let nothing = Some(Init::Constant(0.0));
    list.conv("stem.geometry", w.trunk[0], REFERENCE_CHANNELS - 3, [3, 3], nothing);
    for stage in 1..4 {
        let (from, to) = (w.trunk[stage - 1], w.trunk[stage]);
        list.conv(&format!("trunk.{stage}.down"), to, from, [3, 3], kaiming);
        list.conv(&format!("trunk.{stage}.first"), to, to, [3, 3], kaiming);
        // At 1/4 the second would cost as much as all that follows in the trunk.
        if stage > 1 {
            list.conv(&format!("trunk.{stage}.second"), to, to, [3, 3], kaiming);
        }
    }
    list.conv("match.fine", w.matching, w.trunk[2], [1, 1], kaiming);
    list.conv("match.coarse", w.matching, w.trunk[3], [1, 1], kaiming);
    list.conv("global.0", w.global, 2 * w.trunk[3] + 2, [3, 3], None);
    list.conv("global.1", w.global, w.global, [3, 3], None);
    list.conv("global.pool", w.global, w.global, [1, 1], None);
    list.conv("global.2", w.global, w.global, [3, 3], None);
    // A first flow of nothing: else the lookups begin at places where nothing matches.
    list.conv("global.flow", 2, w.global, [3, 3], nothing);
    list.conv("context", w.hidden + w.context, w.trunk[2] + w.global, [1, 1], None);
    let window = LEVELS * (2 * RADIUS + 1).pow(2);
    list.conv("update.correlation", w.correlation, window, [1, 1], None);
    list.conv("update.flow", w.flow, 2, [7, 7], None);
    list.conv("update.motion", w.motion - 2, w.correlation + w.flow, [3, 3], None);
    list.conv("update.context", 2 * w.hidden, w.context, [3, 3], None);
    list.conv("update.recurrent", 2 * w.hidden, w.hidden + w.motion, [3, 3], None);
    list.conv("head.0", w.head, w.hidden, [3, 3], None);
    list.conv("head.flow", 2, w.head, [3, 3], None);
    list.conv("head.certainty", CERTAINTY, w.head, [3, 3], None);
    list.conv("head.mask", 9 * 64, w.hidden, [1, 1], None);
    list.0
}
