//! `config/networks/*.yaml`: which network, at which size, with how many iterations.

use crate::error::{NetworkError, Result, io_error};
use crate::model::{Model, TensorSpec};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The two published RAFT architectures (Teed and Deng, ECCV 2020).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Architecture {
    /// "RAFT": residual encoders 64/96/128 to 256 channels, lookup radius 4, separable GRU of 128, convex upsampling.
    /// The context encoder's batch norms use stored statistics, as the authors do after their first training stage.
    Basic,
    /// "RAFT-S": bottleneck encoders 32/64/96 to 128 channels, lookup radius 3, GRU of 96, bilinear upsampling.
    Small,
}

/// A network and the size it works at. Unknown keys are rejected.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// Name, written into the weights: `paper`, `small`, `nano` or your own.
    pub name: String,
    /// Architecture; it alone decides the names and shapes of the weights.
    pub arch: Architecture,
    /// Side S of the square crops, in px; a multiple of 8, from 64 to 1024.
    pub size_px: usize,
    /// Recurrent iterations of the student in training.
    pub iterations_train: usize,
    /// Recurrent iterations of the teacher and at run time.
    pub iterations_infer: usize,
}

impl NetworkConfig {
    /// The configuration of the paper: RAFT Basic at 256 px, 12 and 24 iterations (docs/method.md, Flow).
    pub fn paper() -> Self {
        Self::preset("paper", Architecture::Basic, 256, 12, 24)
    }

    /// RAFT-small at 256 px with 12 iterations.
    pub fn small() -> Self {
        Self::preset("small", Architecture::Small, 256, 12, 12)
    }

    /// RAFT-small at 128 px with 6 iterations in training: what two CPU cores can train.
    pub fn nano() -> Self {
        Self::preset("nano", Architecture::Small, 128, 6, 12)
    }

    fn preset(
        name: &str,
        arch: Architecture,
        size_px: usize,
        iterations_train: usize,
        iterations_infer: usize,
    ) -> Self {
        Self { name: name.into(), arch, size_px, iterations_train, iterations_infer }
    }

    /// Channels of the feature encoder.
    pub fn feature_channels(&self) -> usize {
        self.arch.widths().features
    }

    /// Reads and checks a YAML file.
    ///
    /// # Errors
    /// The file is unreadable, has unknown keys, or a value is out of range.
    pub fn from_yaml_file(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(io_error(path))?;
        let config: Self = serde_yaml::from_str(&text)
            .map_err(|e| NetworkError::ConfigSyntax { path: path.into(), message: e.to_string() })?;
        config.check()?;
        Ok(config)
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
        Self::check_size(self.size_px)?;
        for (field, n) in [("iterations_train", self.iterations_train), ("iterations_infer", self.iterations_infer)] {
            if !(1..=64).contains(&n) {
                return bad(field, format!("is {n}; use 1 to 64"));
            }
        }
        Ok(())
    }

    /// Checks a crop side in px: a multiple of 8 from 64 to 1024.
    ///
    /// # Errors
    /// It is another number.
    pub fn check_size(size_px: usize) -> Result<()> {
        if size_px.is_multiple_of(8) && (64..=1024).contains(&size_px) {
            return Ok(());
        }
        let problem = format!("is {size_px}; use a multiple of 8 from 64 to 1024");
        Err(NetworkError::ConfigValue { field: "size_px", problem })
    }

    /// Fingerprint (FNV-1a, 64 bit, hex) of what decides the weights' meaning; written into weight files.
    pub fn hash(&self) -> String {
        let text = format!("{:?} {} {}", self.arch, self.size_px, self.iterations_train);
        crate::model::fingerprint(&text)
    }
}

impl Model for NetworkConfig {
    fn name(&self) -> &str {
        &self.name
    }

    fn hash(&self) -> String {
        self.hash()
    }

    fn layout(&self) -> Vec<TensorSpec> {
        self.arch.layout()
    }

    fn check(&self) -> Result<()> {
        self.check()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shipped(name: &str) -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/networks").join(format!("{name}.yaml"))
    }

    #[test]
    fn shipped_files_equal_the_presets() {
        for preset in [NetworkConfig::paper(), NetworkConfig::small(), NetworkConfig::nano()] {
            assert_eq!(NetworkConfig::from_yaml_file(&shipped(&preset.name)).unwrap(), preset);
        }
    }

    #[test]
    fn unknown_keys_and_bad_sizes_are_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("n.yaml");
        let text = std::fs::read_to_string(shipped("nano")).unwrap();
        std::fs::write(&path, format!("{text}\nradius: 3\n")).unwrap();
        let message = NetworkConfig::from_yaml_file(&path).unwrap_err().to_string();
        assert!(message.contains("radius") && message.contains("n.yaml"), "{message}");
        std::fs::write(&path, text.replace("size_px: 128", "size_px: 100")).unwrap();
        let message = NetworkConfig::from_yaml_file(&path).unwrap_err().to_string();
        assert!(message.contains("size_px") && message.contains("100"), "{message}");
    }
}
