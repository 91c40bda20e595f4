//! Names and shapes of the weights, as in the authors' code (princeton-vl/RAFT), so that their files load.

use crate::config::Architecture;
use crate::model::{Init, TensorSpec};

/// Widths that differ between the two architectures.
#[derive(Debug, Clone, Copy)]
pub struct Widths {
    /// Stem and three stages of the encoders.
    pub stages: [usize; 4],
    /// Output of the feature encoder.
    pub features: usize,
    /// Hidden state of the GRU.
    pub hidden: usize,
    /// Context given to the GRU.
    pub context: usize,
    /// Output of the motion encoder, flow included.
    pub motion: usize,
    /// Lookup radius, px of the level.
    pub radius: usize,
}

/// Levels of the correlation pyramid.
pub const LEVELS: usize = 4;

impl Architecture {
    /// Its widths.
    #[must_use]
    pub fn widths(self) -> Widths {
        match self {
            Self::Basic => {
                Widths { stages: [64, 64, 96, 128], features: 256, hidden: 128, context: 128, motion: 128, radius: 4 }
            }
            Self::Small => {
                Widths { stages: [32, 32, 64, 96], features: 128, hidden: 96, context: 64, motion: 82, radius: 3 }
            }
        }
    }

    /// All tensors in a fixed order.
    pub(crate) fn layout(self) -> Vec<TensorSpec> {
        let widths = self.widths();
        let mut list = List::default();
        list.encoder("fnet", self, widths.features, false);
        list.encoder("cnet", self, widths.hidden + widths.context, self == Self::Basic);
        match self {
            Self::Basic => list.basic_update(widths),
            Self::Small => list.small_update(widths),
        }
        list.0
    }
}

/// A layout in the making.
#[derive(Default)]
pub(crate) struct List(pub(crate) Vec<TensorSpec>);

impl List {
    pub(crate) fn push(&mut self, name: String, shape: &[usize], init: Init) {
        self.0.push(TensorSpec { name, shape: shape.to_vec(), init });
    }

    /// Convolution of `o` filters on `c` channels; without `weight` it starts as PyTorch's do.
    pub(crate) fn conv(&mut self, name: &str, o: usize, c: usize, [kh, kw]: [usize; 2], weight: Option<Init>) {
        let fan_in = Init::Uniform(c * kh * kw);
        self.push(format!("{name}.weight"), &[o, c, kh, kw], weight.unwrap_or(fan_in));
        self.push(format!("{name}.bias"), &[o], fan_in);
    }

    fn norm(&mut self, name: &str, channels: usize) {
        let parts = [("weight", 1.0), ("bias", 0.0), ("running_mean", 0.0), ("running_var", 1.0)];
        for (part, value) in parts {
            self.push(format!("{name}.{part}"), &[channels], Init::Constant(value));
        }
    }

    fn encoder(&mut self, name: &str, arch: Architecture, out: usize, batch_norm: bool) {
        self.trunk(name, arch, batch_norm);
        self.conv(&format!("{name}.conv2"), out, arch.widths().stages[3], [1, 1], Some(Init::KaimingNormal));
    }

    /// An encoder without its last convolution: image to 1/8.
    pub(crate) fn trunk(&mut self, name: &str, arch: Architecture, batch_norm: bool) {
        let stages = arch.widths().stages;
        let init = Some(Init::KaimingNormal);
        self.conv(&format!("{name}.conv1"), stages[0], 3, [7, 7], init);
        if batch_norm {
            self.norm(&format!("{name}.norm1"), stages[0]);
        }
        for stage in 1..4 {
            for block in 0..2 {
                let c = if block == 0 { stages[stage - 1] } else { stages[stage] };
                let shrinks = stage > 1 && block == 0;
                self.block(&format!("{name}.layer{stage}.{block}"), arch, [c, stages[stage]], shrinks, batch_norm);
            }
        }
    }

    /// A residual block.
    pub(crate) fn block(
        &mut self,
        name: &str,
        arch: Architecture,
        [c, o]: [usize; 2],
        shrinks: bool,
        batch_norm: bool,
    ) {
        let init = Some(Init::KaimingNormal);
        let convs = match arch {
            Architecture::Basic => vec![(o, c, 3), (o, o, 3)],
            Architecture::Small => vec![(o / 4, c, 1), (o / 4, o / 4, 3), (o, o / 4, 1)],
        };
        for (i, (o, c, k)) in convs.into_iter().enumerate() {
            self.conv(&format!("{name}.conv{}", i + 1), o, c, [k, k], init);
            if batch_norm {
                self.norm(&format!("{name}.norm{}", i + 1), o);
            }
        }
        if shrinks {
            self.conv(&format!("{name}.downsample.0"), o, c, [1, 1], init);
            if batch_norm {
                self.norm(&format!("{name}.downsample.1"), o);
            }
        }
    }

    fn update(&mut self, convs: &[(&str, usize, usize, [usize; 2])]) {
        for &(name, o, c, kernel) in convs {
            self.conv(&format!("update_block.{name}"), o, c, kernel, None);
        }
    }

    fn basic_update(&mut self, w: Widths) {
        let corr = LEVELS * (2 * w.radius + 1).pow(2);
        let gru = w.hidden + w.context + w.motion;
        self.update(&[
            ("encoder.convc1", 256, corr, [1, 1]),
            ("encoder.convc2", 192, 256, [3, 3]),
            ("encoder.convf1", 128, 2, [7, 7]),
            ("encoder.convf2", 64, 128, [3, 3]),
            ("encoder.conv", w.motion - 2, 256, [3, 3]),
            ("gru.convz1", w.hidden, gru, [1, 5]),
            ("gru.convr1", w.hidden, gru, [1, 5]),
            ("gru.convq1", w.hidden, gru, [1, 5]),
            ("gru.convz2", w.hidden, gru, [5, 1]),
            ("gru.convr2", w.hidden, gru, [5, 1]),
            ("gru.convq2", w.hidden, gru, [5, 1]),
            ("flow_head.conv1", 256, w.hidden, [3, 3]),
            ("flow_head.conv2", 2, 256, [3, 3]),
            ("mask.0", 256, w.hidden, [3, 3]),
            ("mask.2", 64 * 9, 256, [1, 1]),
        ]);
    }

    fn small_update(&mut self, w: Widths) {
        let corr = LEVELS * (2 * w.radius + 1).pow(2);
        let gru = w.hidden + w.context + w.motion;
        self.update(&[
            ("encoder.convc1", 96, corr, [1, 1]),
            ("encoder.convf1", 64, 2, [7, 7]),
            ("encoder.convf2", 32, 64, [3, 3]),
            ("encoder.conv", w.motion - 2, 128, [3, 3]),
            ("gru.convz", w.hidden, gru, [3, 3]),
            ("gru.convr", w.hidden, gru, [3, 3]),
            ("gru.convq", w.hidden, gru, [3, 3]),
            ("flow_head.conv1", 128, w.hidden, [3, 3]),
            ("flow_head.conv2", 2, 128, [3, 3]),
        ]);
    }
}
