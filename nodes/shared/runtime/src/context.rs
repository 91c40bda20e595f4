use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::path::PathBuf;

/// What a node may know of the world around it.
#[derive(Debug, Clone)]
pub struct Context {
    /// Name of the node in its graph (two nodes of a kind have two names).
    pub name: String,
    /// Seed of the run; [`Context::rng`] derives from it.
    pub seed: u64,
    /// Folder for what the run leaves behind (recordings, overlays, status).
    pub out_dir: PathBuf,
    /// Count of this process's restarts: 0 in the first life.
    pub restarts: u32,
    /// Whether the graph replays (nothing is lost) or is live (newest wins).
    pub replay: bool,
}

impl Context {
    /// The random source for one frame and purpose: the same numbers whenever and wherever it is asked for, so
    /// that a restarted node repeats what its predecessor did.
    #[must_use]
    pub fn rng(&self, frame_index: u64, purpose: &str) -> ChaCha8Rng {
        let mut hash = Fnv(0xcbf2_9ce4_8422_2325);
        hash.add(&self.seed.to_le_bytes());
        hash.add(self.name.as_bytes());
        hash.add(&frame_index.to_le_bytes());
        hash.add(purpose.as_bytes());
        ChaCha8Rng::seed_from_u64(hash.0)
    }
}

/// FNV-1a, 64 bit: small, stable across platforms and versions.
struct Fnv(u64);

impl Fnv {
    fn add(&mut self, bytes: &[u8]) {
        for byte in bytes.iter().chain(&[0xff]) {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng;

    #[test]
    fn random_numbers_depend_on_seed_name_frame_and_purpose_alone() {
        let context =
            |seed, name: &str| Context { name: name.into(), seed, out_dir: PathBuf::new(), restarts: 0, replay: true };
        let draw = |c: &Context, frame, purpose| c.rng(frame, purpose).random::<u64>();
        let mut again = context(1, "a");
        again.restarts = 3;
        let first = draw(&context(1, "a"), 5, "jitter");
        assert_eq!(first, draw(&again, 5, "jitter"));
        for other in [
            draw(&context(2, "a"), 5, "jitter"),
            draw(&context(1, "b"), 5, "jitter"),
            draw(&context(1, "a"), 6, "jitter"),
            draw(&context(1, "a"), 5, "ransac"),
        ] {
            assert_ne!(first, other);
        }
    }
}
