//! Crops of the teacher's size made as small as the student's: means over blocks of `by x by` pixels, so that the centres
//! of blocks are the centres of the student's pixels.

/// The pixels of each block of an image `size_px` wide, block by block.
fn blocks(size_px: usize, by: usize) -> impl Iterator<Item = impl Iterator<Item = usize>> {
    let small = size_px / by;
    (0..small * small).map(move |block| {
        let first = block / small * by * size_px + block % small * by;
        (0..by * by).map(move |p| first + p / by * size_px + p % by)
    })
}

/// An RGB image.
pub(super) fn rgb(image: &[u8], size_px: usize, by: usize) -> Vec<u8> {
    let area = (by * by) as u32;
    let mut out = Vec::with_capacity(image.len() / (by * by));
    for block in blocks(size_px, by) {
        let sum = block.fold([0; 3], |sum, p| std::array::from_fn(|c| sum[c] + u32::from(image[3 * p + c])));
        out.extend(sum.map(|channel| ((channel + area / 2) / area) as u8));
    }
    out
}

/// A mask: not 0 where at least half of the block is.
pub(super) fn mask(image: &[u8], size_px: usize, by: usize) -> Vec<u8> {
    let most = |block: &mut dyn Iterator<Item = usize>| 2 * block.filter(|p| image[*p] != 0).count() >= by * by;
    blocks(size_px, by).map(|mut block| 255 * u8::from(most(&mut block))).collect()
}

/// Depth in metres, 0 off the object: the mean of what a block sees of the object, where that is at least half of the block.
pub(super) fn depth(image: &[f32], size_px: usize, by: usize) -> Vec<f32> {
    let mean = |block: &mut dyn Iterator<Item = usize>| {
        let seen = block.map(|p| image[p]).filter(|d| *d > 0.0);
        let (sum, n) = seen.fold((0.0, 0), |(sum, n), d| (sum + d, n + 1));
        if 2 * n >= by * by { sum / n as f32 } else { 0.0 }
    };
    blocks(size_px, by).map(|mut block| mean(&mut block)).collect()
}

/// A flow (x, y interleaved), in pixels of the small image: the mean over what `counts` of a block, 0 where nothing does.
pub(super) fn flow(field: &[f32], size_px: usize, by: usize, counts: impl Fn(usize) -> bool) -> Vec<f32> {
    let mut out = Vec::with_capacity(field.len() / (by * by));
    for block in blocks(size_px, by) {
        let (mut sum, mut n) = ([0.0; 2], 0);
        for p in block.filter(|p| counts(*p)) {
            sum = [sum[0] + field[2 * p], sum[1] + field[2 * p + 1]];
            n += 1;
        }
        out.extend(sum.map(|v| v / (n.max(1) * by) as f32));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn by_one_nothing_changes() {
        let image: Vec<u8> = (0..48).collect();
        assert_eq!(rgb(&image, 4, 1), image);
        let field: Vec<f32> = (0..32).map(|v| v as f32).collect();
        assert_eq!(flow(&field, 4, 1, |_| true), field);
    }

    #[test]
    fn blocks_are_means_and_flow_shrinks_with_its_image() {
        // Two blocks beside each other of a 4 x 4 image; the left one 10, the right one 0 and 20.
        let image: Vec<u8> = (0..16).flat_map(|p| [[10, 10, 0, 20][p % 4]; 3]).collect();
        assert_eq!(rgb(&image, 4, 2), [10; 12]);
        // A flow of 4 px is one of 2 px where everything is half as large; what does not count does not enter.
        let field: Vec<f32> = (0..16).flat_map(|p| if p % 4 == 3 { [99.0, 99.0] } else { [4.0, -4.0] }).collect();
        assert_eq!(flow(&field, 4, 2, |p| p % 4 != 3), [2.0, -2.0].repeat(4));
        assert_eq!(flow(&field, 4, 2, |p| p % 4 < 2)[4..8], [2.0, -2.0, 0.0, 0.0]);
    }

    #[test]
    fn depth_is_the_mean_of_what_a_block_sees() {
        let image: Vec<f32> = [1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 4.0].repeat(2);
        assert_eq!(depth(&image, 4, 2), [1.5, 0.0, 1.5, 0.0]);
        assert_eq!(depth(&image, 4, 1), image);
    }

    #[test]
    fn half_a_block_is_enough_for_a_mask() {
        let image: Vec<u8> = [1, 0, 1, 0, 1, 0, 0, 0].repeat(2);
        assert_eq!(mask(&image, 4, 2), [255, 0, 255, 0]);
    }
}
