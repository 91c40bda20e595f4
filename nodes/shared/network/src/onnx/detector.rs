//! The initializer's network as standard ONNX, for one image.

use super::Export;
use super::builder::{Attr, Builder};
use crate::config::Architecture;
use crate::detector::{CORNERS, DetectorConfig, Grid, STRIDES};
use crate::error::Result;
use crate::layout::detector::{TOWER, TRUNK};
use crate::model::Model;
use crate::weights::Weights;

/// The bytes of an ONNX file with input `image` (1, 3, H, W), f32 in [-1, 1], and outputs `classes` (1, objects, cells),
/// logits, `corners` (1, 16 objects, cells) and `surface` (1, 3 objects, cells) and `rectangles` (1, 4, cells) as the network in burn gives them. The same weights give
/// the same bytes.
///
/// # Errors
/// The weights belong to another architecture.
pub fn export_detector(weights: &Weights, config: &DetectorConfig) -> Result<Vec<u8>> {
    // Names the first tensor that does not fit.
    config.check_weights(weights)?;
    let mut export = Export { graph: Builder::default(), weights, arch: Architecture::Small, batch: Some(1), side: 0 };
    let [width, height] = config.input_px;
    let image = export.graph.input("image", Some(1), &[3, height, width]);
    let levels = export.pyramid(&image);
    let towers: Vec<String> = levels
        .into_iter()
        .map(|level| (0..TOWER).fold(level, |x, i| export.conv_relu(&x, &format!("tower.{i}"))))
        .collect();
    let cells = Grid::new(width, height).cells.len();
    let n = config.objects;
    let heads = [
        ("classes", "class", n),
        ("corners", "corners", 2 * CORNERS * n),
        ("surface", "surface", 3 * n),
        ("rectangles", "rectangle", 4),
    ];
    for (name, conv, channels) in heads {
        let parts: Vec<String> = towers.iter().map(|tower| export.head(tower, conv, channels)).collect();
        let parts: Vec<&str> = parts.iter().map(String::as_str).collect();
        let all = export.graph.concat(&parts, 2);
        export.graph.output(name, &all, Some(1), &[channels, cells]);
    }
    let info = serde_json::to_string(&weights.info).expect("plain struct");
    let metadata = [("pseudoflow", info), ("network", config.name.clone())];
    Ok(export.graph.finish("initializer", &metadata))
}

impl Export<'_> {
    /// The levels of the feature pyramid, finest first.
    fn pyramid(&mut self, image: &str) -> Vec<String> {
        let mut x = self.trunk(image, TRUNK, true);
        let mut levels = Vec::new();
        for level in 0..STRIDES.len() {
            for block in 0..2 {
                let shrinks = level > 0 && block == 0;
                x = self.block(&x, &format!("stage{level}.{block}"), Architecture::Basic, shrinks, true);
            }
            let lateral = self.conv_weights(&format!("lateral{level}"));
            levels.push(self.conv(&x, &lateral, 1));
        }
        for level in (1..levels.len()).rev() {
            let above = self.double(&levels[level]);
            levels[level - 1] = self.graph.op("Add", &[&levels[level - 1], &above], &[]);
        }
        levels
    }

    /// Every pixel becomes four.
    pub(super) fn double(&mut self, x: &str) -> String {
        let scales = self.graph.floats(&[4], &[1.0, 1.0, 2.0, 2.0]);
        let attrs = [
            ("mode", Attr::Text("nearest")),
            ("coordinate_transformation_mode", Attr::Text("asymmetric")),
            ("nearest_mode", Attr::Text("floor")),
        ];
        self.graph.op("Resize", &[x, "", &scales], &attrs)
    }

    fn head(&mut self, x: &str, name: &str, channels: usize) -> String {
        let weights = self.conv_weights(name);
        let y = self.conv(x, &weights, 1);
        self.graph.reshape(&y, &[1, channels as i64, -1])
    }
}
