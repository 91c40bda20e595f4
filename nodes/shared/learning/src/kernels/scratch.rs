//! Buffers that a thread lends again and again: fresh memory costs more than the arithmetic done in it.

use super::simd::{LANES, Lanes};
use std::cell::RefCell;
use std::ops::{Deref, DerefMut};

thread_local! {
    static FREE: RefCell<Vec<Vec<Lanes>>> = const { RefCell::new(Vec::new()) };
}

/// A lent buffer of packs; it goes back to the thread that drops it. What it holds at first is arbitrary.
#[derive(Debug)]
pub(super) struct Scratch {
    values: Vec<Lanes>,
    len: usize,
}

impl Scratch {
    /// Lends `len` packs: the smallest free buffer that is large enough, else the largest, grown.
    pub(super) fn lend(len: usize) -> Self {
        let mut values = FREE.with_borrow_mut(|free| {
            let large = |v: &Vec<Lanes>| (v.len() < len, v.len().abs_diff(len));
            let best = (0..free.len()).min_by_key(|&i| large(&free[i]));
            best.map(|i| free.swap_remove(i)).unwrap_or_default()
        });
        if values.len() < len {
            // Not `resize`: that would move what nobody needs.
            values = vec![[0.0; LANES]; len];
        }
        Self { values, len }
    }
}

impl Deref for Scratch {
    type Target = [Lanes];
    fn deref(&self) -> &[Lanes] {
        &self.values[..self.len]
    }
}

impl DerefMut for Scratch {
    fn deref_mut(&mut self) -> &mut [Lanes] {
        &mut self.values[..self.len]
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let values = std::mem::take(&mut self.values);
        // A thread that ends has no list any more: the buffer is freed.
        let _ = FREE.try_with(|free| free.borrow_mut().push(values));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_are_lent_again() {
        let (small, large) = (Scratch::lend(10), Scratch::lend(1000));
        let addresses = [small.as_ptr(), large.as_ptr()];
        drop((large, small));
        let (large, small) = (Scratch::lend(900), Scratch::lend(9));
        assert_eq!([small.as_ptr(), large.as_ptr()], addresses);
        assert_eq!((small.len(), large.len()), (9, 900));
        let other = Scratch::lend(5);
        assert!(!addresses.contains(&other.as_ptr()));
    }
}
