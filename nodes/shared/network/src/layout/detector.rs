//! Names and shapes of the initializer's weights.

use super::raft::List;
use crate::config::Architecture;
use crate::detector::{CORNERS, DetectorConfig};
use crate::model::{Init, TensorSpec};

/// Names of the tensors, in order. The trunk's are those of RAFT's feature encoder behind another prefix.
pub const TRUNK: &str = "trunk";
/// Convolutions before the outputs.
pub const TOWER: usize = 2;

pub(crate) fn layout(config: &DetectorConfig) -> Vec<TensorSpec> {
    let mut list = List::default();
    list.trunk(TRUNK, Architecture::Small, false);
    let widths = config.stage_widths();
    for (level, pair) in widths.windows(2).enumerate() {
        for block in 0..2 {
            let from = if block == 0 { pair[0] } else { pair[1] };
            let shrinks = level > 0 && block == 0;
            list.block(&format!("stage{level}.{block}"), Architecture::Basic, [from, pair[1]], shrinks, false);
        }
        list.conv(&format!("lateral{level}"), config.pyramid, pair[1], [1, 1], None);
    }
    let kaiming = Some(Init::KaimingNormal);
    for i in 0..TOWER {
        list.conv(&format!("tower.{i}"), config.pyramid, config.pyramid, [3, 3], kaiming);
    }
    list.conv("class", config.objects, config.pyramid, [3, 3], None);
    list.conv("corners", 2 * CORNERS * config.objects, config.pyramid, [3, 3], None);
    list.conv("surface", 3 * config.objects, config.pyramid, [3, 3], None);
    list.conv("rectangle", 4, config.pyramid, [3, 3], None);
    for spec in list.0.iter_mut().filter(|spec| spec.name == "class.bias") {
        // At first everything is background (Lin et al., "Focal Loss for Dense Object Detection", section 3.3).
        spec.init = Init::Constant(-4.6);
    }
    list.0
}
