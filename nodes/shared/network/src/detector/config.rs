use crate::error::{NetworkError, Result, io_error};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Corners of a box.
pub const CORNERS: usize = 8;

/// Unit of the surface coordinates that the network gives, diameters.
pub const SURFACE_UNIT: f32 = 0.25;

/// The initializer's network and the size it works at. Unknown keys are rejected.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DetectorConfig {
    /// Name, written into the weights.
    pub name: String,
    /// Width and height of its input, pixels; multiples of 32. Camera images are scaled to fit, and padded with grey.
    pub input_px: [usize; 2],
    /// Channels at 1/16 and 1/32.
    pub widths: [usize; 2],
    /// Channels of the feature pyramid and the head.
    pub pyramid: usize,
    /// How many objects it tells apart.
    #[serde(default = "one")]
    pub objects: usize,
}

fn one() -> usize {
    1
}

impl DetectorConfig {
    /// 320 x 240 images: what two CPU cores can train.
    pub fn nano(objects: usize) -> Self {
        Self { name: "initializer_nano".into(), input_px: [320, 256], widths: [128, 160], pyramid: 96, objects }
    }

    /// 640 x 480 images, for a GPU.
    pub fn full(objects: usize) -> Self {
        Self { name: "initializer_full".into(), input_px: [640, 480], widths: [256, 384], pyramid: 160, objects }
    }

    /// `nano`, `full`, or the path of a YAML file.
    ///
    /// # Errors
    /// The file is unreadable, has unknown keys, or a value is out of range.
    pub fn named(name: &str, objects: usize) -> Result<Self> {
        let config = match name {
            "nano" => Self::nano(objects),
            "full" => Self::full(objects),
            path => {
                let path = Path::new(path);
                let text = std::fs::read_to_string(path).map_err(io_error(path))?;
                let config: Self = serde_yaml::from_str(&text)
                    .map_err(|e| NetworkError::ConfigSyntax { path: path.into(), message: e.to_string() })?;
                Self { objects, ..config }
            }
        };
        config.check()?;
        Ok(config)
    }

    /// Channels before the first level, and of each level.
    pub(crate) fn stage_widths(&self) -> [usize; 4] {
        let trunk = crate::config::Architecture::Small.widths().stages[3];
        [trunk, trunk, self.widths[0], self.widths[1]]
    }

    /// Checks the ranges.
    ///
    /// # Errors
    /// Names the first field out of range.
    pub fn check(&self) -> Result<()> {
        let bad = |field, problem: String| Err(NetworkError::ConfigValue { field, problem });
        if self.name.is_empty() {
            return bad("name", "is empty; give the network a name".into());
        }
        if !self.input_px.iter().all(|v| v.is_multiple_of(32) && (64..=2048).contains(v)) {
            return bad("input_px", format!("is {:?}; use multiples of 32 from 64 to 2048", self.input_px));
        }
        if !self.widths.iter().chain([&self.pyramid]).all(|v| v.is_multiple_of(8) && (16..=1024).contains(v)) {
            let found = format!("are {:?} and {}", self.widths, self.pyramid);
            return bad("widths, pyramid", format!("{found}; use multiples of 8 from 16 to 1024"));
        }
        if !(1..=255).contains(&self.objects) {
            return bad("objects", format!("is {}; use 1 to 255", self.objects));
        }
        Ok(())
    }
}
