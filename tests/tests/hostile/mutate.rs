//! Mutation as fuzzers do it, from a seed: the same inputs in every run.

use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};

/// Makes inputs out of good files.
pub(crate) struct Mutator {
    random: StdRng,
    seeds: Vec<Vec<u8>>,
}

/// Numbers at which readers break.
const EDGES: [u64; 12] =
    [0, 1, 0x7f, 0x80, 0xff, 0x7fff, 0xffff, 0x7fff_ffff, 0xffff_ffff, 1 << 32, i64::MAX as u64, u64::MAX];

impl Mutator {
    pub(crate) fn new(seed: u64, seeds: Vec<Vec<u8>>) -> Self {
        Self { random: StdRng::seed_from_u64(seed), seeds }
    }

    /// The next input: a seed with one to eight changes.
    pub(crate) fn next(&mut self) -> Vec<u8> {
        let mut bytes = self.seed();
        for _ in 0..self.random.random_range(1..=8) {
            self.change(&mut bytes);
        }
        bytes
    }

    fn seed(&mut self) -> Vec<u8> {
        let at = self.random.random_range(0..self.seeds.len());
        self.seeds[at].clone()
    }

    fn place(&mut self, bytes: &[u8]) -> usize {
        self.random.random_range(0..=bytes.len())
    }

    fn change(&mut self, bytes: &mut Vec<u8>) {
        let at = self.place(bytes);
        let len = self.random.random_range(1..=16_usize);
        let end = (at + len).min(bytes.len());
        match self.random.random_range(0..9) {
            0 if at < bytes.len() => bytes[at] ^= 1 << self.random.random_range(0..8),
            1 if at < bytes.len() => bytes[at] = self.random.random(),
            2 => drop(bytes.drain(at..end)),
            3 => drop(bytes.splice(at..at, std::iter::repeat_n(self.random.random::<u8>(), len))),
            4 => self.set_number(bytes, at),
            5 => {
                let block = bytes[at..end].to_vec();
                let times = self.random.random_range(1..50);
                bytes.splice(at..at, block.repeat(times));
            }
            6 => bytes.truncate(at),
            7 => {
                let other = self.seed();
                let from = self.place(&other);
                bytes.splice(at.., other[from..].iter().copied());
            }
            _ => self.set_digits(bytes, at),
        }
    }

    /// An edge in one, two, four or eight bytes, of either order.
    fn set_number(&mut self, bytes: &mut [u8], at: usize) {
        let edge = EDGES[self.random.random_range(0..EDGES.len())];
        let width = 1 << self.random.random_range(0..4);
        let mut number = edge.to_le_bytes()[..width].to_vec();
        if self.random.random() {
            number.reverse();
        }
        bytes[at..].iter_mut().zip(number).for_each(|(byte, new)| *byte = new);
    }

    /// The same in text: the next run of digits becomes an edge.
    fn set_digits(&mut self, bytes: &mut Vec<u8>, at: usize) {
        let Some(begin) = bytes[at..].iter().position(u8::is_ascii_digit).map(|offset| at + offset) else { return };
        let end = bytes[begin..].iter().position(|byte| !byte.is_ascii_digit()).map_or(bytes.len(), |len| begin + len);
        let edge = EDGES[self.random.random_range(0..EDGES.len())];
        let sign = if self.random.random_ratio(1, 4) { "-" } else { "" };
        bytes.splice(begin..end, format!("{sign}{edge}").into_bytes());
    }
}
