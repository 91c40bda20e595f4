use super::{Judged, JudgedFrame, JudgedInstance};
use rand::Rng;
use serde::{Deserialize, Serialize};

/// Fewer frames say nothing.
const LEAST_FRAMES: usize = 5;
/// The lower end of the gain's interval must be above this.
const LEAST_GAIN: f64 = 0.002;
/// Of the bootstrap.
const RESAMPLINGS: usize = 2000;

/// What the frames say of two networks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Verdict {
    /// Frames with an instance.
    pub frames: usize,
    /// Instances in them.
    pub instances: usize,
    /// Mean agreement of the pictures with the first network's poses.
    pub before: f64,
    /// With those of the second.
    pub after: f64,
    /// 95 % interval of the mean gain, drawn by frames.
    pub interval: [f64; 2],
    /// Mean inlier ratio of both.
    pub inlier_ratio: [f64; 2],
    /// Mean correlation with the picture of both.
    pub photometric: [f64; 2],
    /// Mean contrast across the contour of both.
    pub silhouette: [f64; 2],
}

/// An instance with both poses.
struct Pair<'a> {
    before: &'a Judged,
    after: &'a Judged,
    gain: f64,
}

impl Verdict {
    /// Weighs the instances that both networks refined; `rng` draws the bootstrap. `None` when there are none.
    #[must_use]
    pub fn of(frames: &[JudgedFrame], rng: &mut impl Rng) -> Option<Self> {
        let frames: Vec<Vec<Pair<'_>>> = frames.iter().map(pairs).filter(|pairs| !pairs.is_empty()).collect();
        if frames.is_empty() {
            return None;
        }
        let interval = interval(&frames, rng);
        let (count, pairs) = (frames.len(), frames.into_iter().flatten().collect::<Vec<_>>());
        let mean = |value: &dyn Fn(&Pair<'_>) -> f64| pairs.iter().map(value).sum::<f64>() / pairs.len() as f64;
        let both = |part: fn(&Judged) -> f64| [mean(&|p| part(p.before)), mean(&|p| part(p.after))];
        let [before, after] = both(Judged::seen);
        Some(Self {
            frames: count,
            instances: pairs.len(),
            before,
            after,
            interval,
            inlier_ratio: both(|judged| judged.inlier_ratio),
            photometric: both(|judged| judged.photometric),
            silhouette: both(|judged| judged.silhouette),
        })
    }

    /// A gain that chance does not explain and that somebody could notice.
    #[must_use]
    pub fn better(&self) -> bool {
        self.enough() && self.interval[0] > LEAST_GAIN
    }

    /// Whether there are enough frames to say anything.
    #[must_use]
    pub fn enough(&self) -> bool {
        self.frames >= LEAST_FRAMES
    }
}

fn pairs(frame: &JudgedFrame) -> Vec<Pair<'_>> {
    frame.instances.iter().filter_map(pair).collect()
}

fn pair(instance: &JudgedInstance) -> Option<Pair<'_>> {
    let after = instance.after.as_ref()?;
    Some(Pair { before: &instance.before, after, gain: instance.gain() })
}

/// Bootstrap over frames: instances of a frame share light, blur and occluders.
fn interval(frames: &[Vec<Pair<'_>>], rng: &mut impl Rng) -> [f64; 2] {
    let sums: Vec<(f64, f64)> =
        frames.iter().map(|pairs| (pairs.iter().map(|p| p.gain).sum(), pairs.len() as f64)).collect();
    let mut means: Vec<f64> = (0..RESAMPLINGS)
        .map(|_| {
            let drawn = (0..sums.len()).map(|_| sums[rng.random_range(0..sums.len())]);
            let (gain, count) = drawn.fold((0.0, 0.0), |all, one| (all.0 + one.0, all.1 + one.1));
            gain / count
        })
        .collect();
    means.sort_by(f64::total_cmp);
    [means[RESAMPLINGS / 40], means[RESAMPLINGS - 1 - RESAMPLINGS / 40]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn instance(before: f64, after: f64) -> JudgedInstance {
        let judged = |photometric| Judged {
            solved: true,
            pose: ([0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0]),
            inlier_ratio: 0.0,
            photometric,
            silhouette: 0.0,
        };
        JudgedInstance {
            object_id: 1,
            instance: 0,
            score: 1.0,
            initial: ([0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0]),
            crop: [0.0; 3],
            before: judged(before),
            after: Some(judged(after)),
        }
    }

    fn frame(instances: Vec<JudgedInstance>) -> JudgedFrame {
        JudgedFrame { frame: 0, scene_id: 0, image_id: 0, instances, skipped: Vec::new() }
    }

    fn of(frames: Vec<Vec<JudgedInstance>>) -> Verdict {
        let frames: Vec<JudgedFrame> = frames.into_iter().map(frame).collect();
        Verdict::of(&frames, &mut ChaCha8Rng::seed_from_u64(1)).unwrap()
    }

    fn gains(gains: impl Iterator<Item = f64>) -> Verdict {
        of(gains.map(|gain| vec![instance(1.0, 1.0 + gain)]).collect())
    }

    #[test]
    fn a_gain_counts_only_when_its_interval_is_above_zero() {
        let better = gains((0..40).map(|i| 0.1 + 0.02 * f64::from(i % 5)));
        assert!(better.better() && better.interval[0] > 0.09, "{:?}", better.interval);
        let noise = gains((0..40).map(|i| if i % 2 == 0 { 0.3 } else { -0.29 }));
        assert!(!noise.better(), "{:?}", noise.interval);
        assert!(!gains((0..40).map(|_| -0.1)).better());
        assert!(!gains((0..40).map(|_| 0.001)).better(), "nobody would notice");
        let few = gains((0..4).map(|_| 0.5));
        assert!(!few.better() && !few.enough(), "too few frames");
    }

    #[test]
    fn frames_are_drawn_whole() {
        // One frame with many instances is one observation.
        let many = (0..50).map(|_| instance(0.0, 0.2)).collect();
        assert!(!of(vec![many, vec![instance(0.0, -0.2)], vec![instance(0.0, -0.2)]]).better());
    }

    #[test]
    fn frames_without_pairs_say_nothing() {
        let rng = &mut ChaCha8Rng::seed_from_u64(1);
        let alone = JudgedInstance { after: None, ..instance(0.5, 0.0) };
        assert_eq!(Verdict::of(&[frame(vec![]), frame(vec![alone])], rng), None);
        assert_eq!(of(vec![vec![], vec![instance(0.0, 0.1)]]).frames, 1);
    }
}
