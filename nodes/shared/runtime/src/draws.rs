use crate::{Context, Stride};
use rand_chacha::ChaCha8Rng;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What decides, beside the run's seed, which numbers a node draws at random for a frame.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Draws {
    /// What names a frame.
    pub by: DrawsBy,
    /// The name of a node to draw as; without, the node's own. Two nodes of one name draw the same.
    pub name: Option<String>,
    /// `by: frame` where the player leaves frames out, its `frames`: a frame is named by its number in the recording, hence
    /// draws the same whichever others are played.
    pub frames: Stride,
}

/// What names a frame for [`Draws`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum DrawsBy {
    /// Its number in the run, or in the recording with [`Draws::frames`].
    #[default]
    Frame,
    /// BOP scene and image: an image gets the same numbers whichever others are played with it.
    Image,
}

impl Draws {
    /// The random source for a frame with its BOP scene and image.
    #[must_use]
    pub fn rng(&self, context: &Context, frame: u64, (scene_id, image_id): (u32, u32), purpose: &str) -> ChaCha8Rng {
        let number = match self.by {
            DrawsBy::Frame => self.frames.number(frame),
            DrawsBy::Image => u64::from(scene_id) << 32 | u64::from(image_id),
        };
        match &self.name {
            None => context.rng(number, purpose),
            Some(name) => Context { name: name.clone(), ..context.clone() }.rng(number, purpose),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng;

    #[test]
    fn an_image_gets_the_same_numbers_at_any_place() {
        let context = |name: &str| Context {
            name: name.into(),
            seed: 1,
            out_dir: std::path::PathBuf::new(),
            restarts: 0,
            replay: true,
        };
        let draws = Draws { by: DrawsBy::Image, name: Some("eval".into()), ..Draws::default() };
        let draw = |draws: &Draws, name, frame, image| draws.rng(&context(name), frame, image, "a").random::<u64>();
        assert_eq!(draw(&draws, "pnp", 0, (1, 2)), draw(&draws, "pnp_2", 9, (1, 2)));
        assert_ne!(draw(&draws, "pnp", 0, (1, 2)), draw(&draws, "pnp", 0, (2, 2)));
        let by_frame = Draws::default();
        assert_eq!(draw(&by_frame, "pnp", 3, (1, 2)), context("pnp").rng(3, "a").random::<u64>());
        assert_ne!(draw(&by_frame, "pnp", 0, (1, 2)), draw(&by_frame, "pnp_2", 0, (1, 2)));
        let every_fifth = Draws { frames: serde_yaml::from_str("{start: 4, step: 5}").unwrap(), ..by_frame.clone() };
        assert_eq!(draw(&every_fifth, "pnp", 2, (1, 2)), draw(&by_frame, "pnp", 14, (1, 2)));
    }
}
