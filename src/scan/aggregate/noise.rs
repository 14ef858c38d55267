//! Noise of a frame's differences.

use crate::channels::{DIFFERENCES, NewestChannels, RUN};
use crate::math::slices;
use core::array::from_fn;

/// Side of the blocks of [`noise`], in cells.
const BLOCK: usize = RUN;

/// Words that [`noise`] needs for a level of `columns` x `rows` cells.
pub const fn noise_words(columns: usize, rows: usize) -> usize {
    (columns / BLOCK) * (rows / BLOCK) * DIFFERENCES
}

/// Noise of the differences of a whole frame: the mean of each over its calmer cells, Q4. Scales the map's temporal
/// channels, so that wind in the trees or a badly measured camera motion do not look like targets everywhere.
/// Panics if there are fewer than [`noise_words`] words.
#[inline(never)]
pub fn noise(newest: &NewestChannels<'_>, words: &mut [u16]) -> [u32; DIFFERENCES] {
    // Means of blocks; the mean of those below twice the mean of all is robust against targets.
    let (columns, rows) = newest.slice.cells();
    let (across, down) = (columns / BLOCK, rows / BLOCK);
    let count = across * down;
    let blocks = slices::part_mut(words, 0, noise_words(columns, rows));
    blocks.fill(0);
    for y in 0..down * BLOCK {
        let row = newest.row(y);
        let place = y / BLOCK * across;
        for (i, difference) in row.differences.iter().enumerate() {
            difference.sum_runs(slices::part_mut(blocks, i * count + place, across));
        }
    }
    from_fn(|i| {
        let blocks = slices::part(blocks, i * count, count);
        let count = count.max(1) as u64;
        let all: u64 = blocks.iter().map(|&sum| u64::from(sum)).sum();
        let calm = || blocks.iter().map(|&sum| u64::from(sum)).filter(|sum| sum * count <= 2 * all);
        let number = (calm().count() as u64).max(1);
        (calm().sum::<u64>() / (4 * number)) as u32
    })
}
