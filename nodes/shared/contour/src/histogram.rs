//! Colour histograms of both sides of the contour (16 bins a channel) and what they say about a pixel.

use pseudoflow_geometry::Pose;

/// Bins of a channel, as a power of two.
const BITS: usize = 4;
/// Bins in all.
const BINS: usize = 1 << (3 * BITS);
/// The bin of pixels outside the image: they say nothing.
pub(crate) const NOWHERE: u16 = BINS as u16;

/// The bin of a colour.
pub(crate) fn bin_of([r, g, b]: [u8; 3]) -> u16 {
    let part = |c: u8| u16::from(c) >> (8 - BITS);
    (part(r) << (2 * BITS)) | (part(g) << BITS) | part(b)
}

/// How often each colour was seen inside and outside of the contour; each sums to one. Empty, it takes no memory: trackers put empty
/// ones in the place of those that they work with.
#[derive(Debug, Clone)]
pub(crate) struct Histograms {
    inside: Vec<f32>,
    outside: Vec<f32>,
    fresh_inside: Vec<f32>,
    fresh_outside: Vec<f32>,
    /// ln (inside / outside) of each bin, and 0 for [`NOWHERE`].
    log_odds: Vec<f32>,
    empty: bool,
    /// The pose at which the fresh colours were counted, until they are taken over or counted anew.
    pub(crate) counted_at: Option<Pose>,
}

/// Colours of an object and of what is around it, kept from frame to frame.
#[derive(Debug, Clone)]
pub struct Colours(pub(crate) Histograms);

impl Default for Colours {
    fn default() -> Self {
        Self(Histograms::new())
    }
}

impl Colours {
    /// Whether nothing was counted yet.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.empty
    }
}

/// Share of both histograms that is spread over all colours: what was never seen says nothing.
const SPREAD: f32 = 0.02;

impl Histograms {
    pub(crate) fn new() -> Self {
        Self {
            inside: Vec::new(),
            outside: Vec::new(),
            fresh_inside: Vec::new(),
            fresh_outside: Vec::new(),
            log_odds: Vec::new(),
            empty: true,
            counted_at: None,
        }
    }

    pub(crate) fn clear(&mut self) {
        self.empty = true;
    }

    /// Begins to count.
    pub(crate) fn begin(&mut self) {
        for fresh in [&mut self.fresh_inside, &mut self.fresh_outside] {
            fresh.clear();
            fresh.resize(BINS, 0.0);
        }
        self.counted_at = None;
    }

    pub(crate) fn count_inside(&mut self, bin: u16) {
        if bin != NOWHERE {
            self.fresh_inside[bin as usize] += 1.0;
        }
    }

    pub(crate) fn count_outside(&mut self, bin: u16) {
        if bin != NOWHERE {
            self.fresh_outside[bin as usize] += 1.0;
        }
    }

    /// Takes over what was counted: `renewal` of the new and the rest of the old. False when one side has no pixel.
    pub(crate) fn renew(&mut self, renewal: f32) -> bool {
        let renewal = if self.empty { 1.0 } else { renewal };
        self.counted_at = None;
        let blend = |old: &mut Vec<f32>, fresh: &[f32]| {
            let total: f32 = fresh.iter().sum();
            if total < 16.0 {
                return false;
            }
            old.resize(BINS, 0.0);
            let scale = renewal / total;
            old.iter_mut().zip(fresh).for_each(|(o, f)| *o = (1.0 - renewal) * *o + scale * f);
            true
        };
        if !(blend(&mut self.inside, &self.fresh_inside) && blend(&mut self.outside, &self.fresh_outside)) {
            return false;
        }
        self.empty = false;
        let spread = SPREAD / BINS as f32;
        self.log_odds.resize(BINS + 1, 0.0);
        for ((odds, inside), outside) in self.log_odds.iter_mut().zip(&self.inside).zip(&self.outside) {
            *odds = ((inside + spread) / (outside + spread)).ln();
        }
        true
    }

    /// What the colours of a picture say: ln (inside / outside) of each pixel.
    pub(crate) fn log_odds(&self, bins: &[u16], out: &mut Vec<f32>) {
        out.clear();
        match self.log_odds.is_empty() {
            true => out.resize(bins.len(), 0.0),
            false => out.extend(bins.iter().map(|b| self.log_odds[*b as usize])),
        }
    }

    /// How much of both histograms is the same, 0..1 (Bhattacharyya).
    pub(crate) fn overlap(&self) -> f32 {
        self.inside.iter().zip(&self.outside).map(|(a, b)| (a * b).sqrt()).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_of_one_side_speak_for_it() {
        let mut h = Histograms::new();
        let mut out = Vec::new();
        h.log_odds(&[3, NOWHERE], &mut out);
        assert_eq!(out, [0.0, 0.0], "nothing was counted yet");
        h.begin();
        let (red, blue, grey) = (bin_of([200, 10, 10]), bin_of([10, 10, 200]), bin_of([90, 90, 90]));
        (0..100).for_each(|_| h.count_inside(red));
        (0..100).for_each(|_| h.count_outside(blue));
        assert!(h.renew(1.0));
        h.log_odds(&[red, blue, grey, NOWHERE], &mut out);
        assert!(out[0] > 3.0 && out[1] < -3.0 && out[2] == 0.0 && out[3] == 0.0, "{out:?}");
        assert!(h.overlap() < 1e-6);
        h.begin();
        assert!(!h.renew(1.0), "no pixel at all");
    }
}
