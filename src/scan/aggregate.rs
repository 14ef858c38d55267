//! The map of one pyramid level, in which the scan looks up single values (level 3).
//!
//! [`MAP_CHANNELS`] bytes a cell: the channels of the newest frame, normalised by what is around them. The map is
//! computed from above, a strip of a few rows at a time, with running sums over the square around each cell.

use crate::channels::window::PADDING;
use crate::channels::{Cell, DIFFERENCES, Newest};
use crate::image::gradient::ORIENTATIONS;
use core::array::from_fn;

/// Bytes of the scan's map for one cell.
pub const MAP_CHANNELS: usize = 16;

/// Half the side of the square over which the map is normalised, in cells.
const REACH: usize = 5;

/// Cells in that square.
const AREA: u32 = (2 * REACH as u32 + 1) * (2 * REACH as u32 + 1);

/// Map values of a cell outside the picture: nothing there, intensity that of its surroundings.
const OUTSIDE: [u8; MAP_CHANNELS] = [0, 0, 0, 0, 0, 0, 0, 0, 128, 128, 0, 0, 0, 0, 0, 0];

/// Ratios in [`ROOT`]: the largest is 255 times the largest of [`RECIPROCAL`], Q8.
const RATIOS: usize = 4096;

/// `8 * sqrt(i)`, at most 255: compresses ratios so that small ones keep their resolution.
static ROOT: [u8; RATIOS] = {
    let mut table = [0; RATIOS];
    let mut root = 0u32;
    let mut i = 0;
    while i < RATIOS as u32 {
        while root < 255 && (root + 1) * (root + 1) <= 64 * i {
            root += 1;
        }
        table[i as usize] = root as u8;
        i += 1;
    }
    table
};

/// Side of the blocks of [`noise`], in cells.
const BLOCK: usize = 8;

/// Words that [`noise`] needs for a level of `columns` x `rows` cells.
pub const fn noise_words(columns: usize, rows: usize) -> usize {
    (columns / BLOCK) * (rows / BLOCK) * DIFFERENCES
}

/// Noise of the differences of a whole frame: the mean of each over its calmer cells, Q4. Scales the map's temporal
/// channels, so that wind in the trees or a badly measured camera motion do not look like targets everywhere.
/// Panics if there are fewer than [`noise_words`] words.
#[inline(never)]
pub fn noise(newest: &Newest<'_>, words: &mut [u16]) -> [u32; DIFFERENCES] {
    // Means of blocks; the mean of those below twice the mean of all is robust against targets.
    let (columns, rows) = newest.slice.cells();
    let (across, down) = (columns / BLOCK, rows / BLOCK);
    let (blocks, _) = words[..noise_words(columns, rows)].as_chunks_mut::<DIFFERENCES>();
    blocks.fill([0; DIFFERENCES]);
    for y in 0..down * BLOCK {
        let row = newest.row(y);
        let blocks = &mut blocks[y / BLOCK * across..][..across];
        for (i, difference) in row.differences.iter().enumerate() {
            difference.sum_runs(BLOCK, blocks.iter_mut().map(|sums| &mut sums[i]));
        }
    }
    from_fn(|i| {
        let count = blocks.len().max(1) as u64;
        let all: u64 = blocks.iter().map(|sums| u64::from(sums[i])).sum();
        let calm =
            || blocks.iter().map(|sums| u64::from(sums[i])).filter(|sum| sum * count <= 2 * all);
        let number = (calm().count() as u64).max(1);
        (calm().sum::<u64>() / (4 * number)) as u32
    })
}

/// `65536 / (i + 16)`: reciprocals of means in quarters of a unit, with a floor of 4 units.
static RECIPROCAL: [u16; 1024] = {
    let mut table = [0; 1024];
    let mut i = 0;
    while i < 1024 {
        table[i] = (65536 / (i + 16)) as u16;
        i += 1;
    }
    table
};

/// Mean over the square in quarters of a unit, from its sum.
#[inline(always)]
fn quarter_mean(sum: u16) -> usize {
    // 4 / 121 in Q16; at most 1020 since a value is at most 255.
    ((u32::from(sum) * (4 * 65536 / AREA)) >> 16) as usize
}

/// 64 times `value` over the mean with reciprocal `reciprocal`, through [`ROOT`].
#[inline(always)]
fn ratio(value: u8, reciprocal: u16) -> u8 {
    let ratio = (u32::from(value) * u32::from(reciprocal)) >> 8;
    ROOT[ratio as usize % RATIOS]
}

/// Rows of cells over which the map is normalised.
const NEAR: usize = 2 * REACH + 1;

/// Sums of a column of a square, or of all of it: magnitude, grey, far and near difference.
type Sums = [u16; 4];

#[inline(always)]
fn sums(cell: &Cell) -> Sums {
    let [.., magnitude, grey, far, near, _] = *cell;
    [magnitude.into(), grey.into(), far.into(), near.into()]
}

#[inline(always)]
fn add(sums: &mut Sums, &[a, b, c, d]: &Sums) {
    *sums = [sums[0] + a, sums[1] + b, sums[2] + c, sums[3] + d];
}

#[inline(always)]
fn take(sums: &mut Sums, &[a, b, c, d]: &Sums) {
    *sums = [sums[0] - a, sums[1] - b, sums[2] - c, sums[3] - d];
}

/// Bytes that [`strips`] needs, with strips of up to `rows` rows, for a level of `columns` cells in a row.
pub const fn strip_bytes(columns: usize, rows: usize) -> usize {
    (columns + 2 * PADDING) * rows * MAP_CHANNELS + columns * NEAR * size_of::<Cell>()
}

/// Words that [`strips`] needs for a level of `columns` cells in a row.
pub const fn strip_words(columns: usize) -> usize {
    columns * size_of::<Sums>() / 2
}

/// Rows of a map from row `top` on, counted from the first row of padding: [`MAP_CHANNELS`] bytes a cell.
#[derive(Debug, Clone, Copy)]
pub struct Strip<'a> {
    /// Number of the first row.
    pub top: usize,
    /// The rows, each [`PADDING`] cells wider than the level on either side.
    pub bytes: &'a [u8],
}

/// Computes the scan's map of a level, `rows` rows at a time of which the first `shared` are the last ones of the strip
/// before; `noise` as [`noise`] gives it, the same for all levels.
///
/// Channels: 0..6 orientations (0 where there are none) and 6 magnitude against the mean magnitude around; 7 magnitude; 8 intensity against the
/// mean around, relative to the magnitude around (128: equal); 9 the same in half grey levels; 10..13 the differences
/// against the frame's noise; 13 and 15 two of them against their mean around; 14 the plain one against the magnitude.
///
/// Panics if there are fewer than [`strip_bytes`] bytes or [`strip_words`] words, or not more rows than shared ones.
pub fn strips(
    newest: &Newest<'_>,
    noise: &[u32; DIFFERENCES],
    (rows, shared): (usize, usize),
    bytes: &mut [u8],
    words: &mut [u16],
    mut each: impl FnMut(Strip<'_>),
) {
    let columns = newest.slice.cells().0;
    let stride = (columns + 2 * PADDING) * MAP_CHANNELS;
    let (strip, ring) = bytes.split_at_mut(stride * rows);
    let mut around = Around::new(newest, ring, words);
    // Q16 reciprocals of the noise (Q4 quarters) with a floor of half a grey level: at most 2048.
    let calm = noise.map(|n| 65536 / (n + 32));
    let height = around.rows + 2 * PADDING;
    let mut filled = 0;
    for number in 0..height {
        let (out, _) = strip[filled * stride..(filled + 1) * stride].as_chunks_mut();
        match number.checked_sub(PADDING).filter(|&y| y < around.rows) {
            Some(y) => {
                out[..PADDING].fill(OUTSIDE);
                out[PADDING + columns..].fill(OUTSIDE);
                around.advance(y);
                around.map_row(y, &calm, &mut out[PADDING..PADDING + columns]);
            }
            None => out.fill(OUTSIDE),
        }
        filled += 1;
        if filled == rows || number + 1 == height {
            each(Strip { top: number + 1 - filled, bytes: &strip[..filled * stride] });
            strip.copy_within((filled - shared.min(filled)) * stride..filled * stride, 0);
            filled = shared;
        }
    }
}

/// The cells around a row of cells.
struct Around<'a> {
    newest: &'a Newest<'a>,
    columns: usize,
    rows: usize,
    /// The last [`NEAR`] rows of cells, row y in place y modulo their number.
    ring: &'a mut [Cell],
    /// Of each column the sums over the rows of the square around the row.
    sums: &'a mut [Sums],
    /// Rows of cells that were taken in.
    taken: usize,
}

impl<'a> Around<'a> {
    fn new(newest: &'a Newest<'a>, ring: &'a mut [u8], words: &'a mut [u16]) -> Self {
        let (columns, rows) = newest.slice.cells();
        let (ring, sums) = (ring.as_chunks_mut().0, words.as_chunks_mut().0);
        let (ring, sums) = (&mut ring[..columns * NEAR], &mut sums[..columns]);
        sums.fill([0; 4]);
        Self { newest, columns, rows, ring, sums, taken: 0 }
    }

    /// Moves the square down to be around row `y`, the one after that of the last call; the first is 0.
    #[inline(never)]
    fn advance(&mut self, y: usize) {
        if let Some(above) = y.checked_sub(REACH + 1) {
            let gone = &self.ring[above % NEAR * self.columns..][..self.columns];
            self.sums.iter_mut().zip(gone).for_each(|(all, cell)| take(all, &sums(cell)));
        }
        while self.taken < self.rows.min(y + REACH + 1) {
            let newest = self.newest;
            let row = newest.row(self.taken);
            let cells = &mut self.ring[self.taken % NEAR * self.columns..][..self.columns];
            row.fill(cells);
            self.sums.iter_mut().zip(&*cells).for_each(|(all, cell)| add(all, &sums(cell)));
            self.taken += 1;
        }
    }

    /// The map of row `y`, around which the square is.
    #[inline(never)]
    fn map_row(&self, y: usize, calm: &[u32; DIFFERENCES], out: &mut [[u8; MAP_CHANNELS]]) {
        let mut around = [0; 4];
        self.sums.iter().take(REACH).for_each(|column| add(&mut around, column));
        // The sums over the square first, which wait where the map is going to be: all at once does not fit into the
        // registers of a microcontroller.
        for (x, out) in out.iter_mut().enumerate() {
            if let Some(column) = self.sums.get(x + REACH) {
                add(&mut around, column);
            }
            if let Some(column) = x.checked_sub(REACH + 1).and_then(|left| self.sums.get(left)) {
                take(&mut around, column);
            }
            let (sums, _) = out.as_chunks_mut();
            sums.iter_mut().zip(around).for_each(|(out, sum)| *out = sum.to_le_bytes());
        }
        match self.newest.oriented {
            true => self.map_cells::<true>(y, calm, out),
            false => self.map_cells::<false>(y, calm, out),
        }
    }

    /// The map of row `y`, in whose place the sums over the square around each cell are, with orientations or without.
    #[inline(always)]
    fn map_cells<const ORIENTED: bool>(
        &self,
        y: usize,
        calm: &[u32; DIFFERENCES],
        out: &mut [[u8; MAP_CHANNELS]],
    ) {
        let cells = &self.ring[y % NEAR * self.columns..][..self.columns];
        let down = (y + REACH + 1).min(self.rows) - y.saturating_sub(REACH);
        let mut inside = (0, 0);
        for (x, (out, cell)) in out.iter_mut().zip(cells).enumerate() {
            // Cells of the square that lie in the picture, and their Q18 reciprocal: they change near edges only.
            let across = (x + REACH + 1).min(self.columns) - x.saturating_sub(REACH);
            let count = (across * down) as u32;
            if inside.0 != count {
                inside = (count, (1u32 << 18).div_ceil(count));
            }
            let [a, b, c, d, e, f, g, h, ..] = *out;
            let around = [[a, b], [c, d], [e, f], [g, h]].map(u16::from_le_bytes);
            *out = map_cell::<ORIENTED>(cell, &around, inside.1, calm);
        }
    }
}

/// The map of a cell with the sums over the square around it; `inside` is the Q18 reciprocal of its cells.
#[inline(always)]
fn map_cell<const ORIENTED: bool>(
    cell: &Cell,
    around: &Sums,
    inside: u32,
    calm: &[u32; DIFFERENCES],
) -> [u8; MAP_CHANNELS] {
    let [magnitude_around, grey_around, far_around, near_around] = *around;
    let energy = RECIPROCAL[quarter_mean(magnitude_around) & 1023];
    let [a, b, c, d, e, f, magnitude, grey, far, near, plain] = *cell;
    let against_energy = |value: u8| ratio(value, energy);
    let mean = (u32::from(grey_around) * inside) >> 16;
    let above = i32::from(grey) * 4 - mean as i32;
    let byte = |value: i32| (128 + value).clamp(0, 255) as u8;
    let loud = |value: u8, calm: u32| ROOT[((u32::from(value) * calm) >> 7) as usize % RATIOS];
    let local = |value: u8, sum: u16| ratio(value, RECIPROCAL[quarter_mean(sum) & 1023]);
    let quarters = usize::from(magnitude) * 4;
    let [a, b, c, d, e, f] = match ORIENTED {
        true => [a, b, c, d, e, f].map(against_energy),
        false => [0; ORIENTATIONS],
    };
    [
        a,
        b,
        c,
        d,
        e,
        f,
        against_energy(magnitude),
        ROOT[quarters],
        byte((above * i32::from(energy)) >> 10),
        byte(above >> 1),
        loud(far, calm[0]),
        loud(near, calm[1]),
        loud(plain, calm[2]),
        local(near, near_around),
        // The plain difference against the magnitude of the cell alone.
        ratio(plain, RECIPROCAL[quarters]),
        local(far, far_around),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::channels::tests::{Level, cells, level};
    use crate::channels::{GREY, MAGNITUDE};
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    /// The whole map of a level, computed in strips of so many rows.
    fn whole(
        newest: &Newest<'_>,
        noise: [u32; 3],
        rows: (usize, usize),
    ) -> Vec<[u8; MAP_CHANNELS]> {
        let columns = newest.slice.cells().0;
        let mut bytes = vec![0xa5; strip_bytes(columns, rows.0)];
        let mut words = vec![0xa5a5; strip_words(columns)];
        let mut map: Vec<[u8; MAP_CHANNELS]> = vec![];
        strips(newest, &noise, rows, &mut bytes, &mut words, |strip| {
            let (cells, rest) = strip.bytes.as_chunks();
            assert!(rest.is_empty());
            let known = map.len() - strip.top * (columns + 2 * PADDING);
            assert_eq!(
                map[map.len() - known..],
                cells[..known],
                "rows shared with the strip before"
            );
            map.extend(&cells[known..]);
        });
        map
    }

    #[test]
    fn a_dot_stands_out_and_padding_is_neutral() {
        let (width, height) = (64usize, 48usize);
        let mut level = Level::new(width, height, false, |_, _| [100, 0, 0, 0]);
        for (x, y) in (20..24).flat_map(|y| (30..34).map(move |x| (x, y))) {
            level.set(x, y, [40, 0, 80, 80]);
        }
        let newest = level.newest();
        let mut words = vec![0; noise_words(width / 2, height / 2)];
        let cells = whole(&newest, noise(&newest, &mut words), (13, 9));
        let stride = width / 2 + 2 * PADDING;
        let at = |x: usize, y: usize| cells[(y + PADDING) * stride + x + PADDING];
        assert_eq!(cells.len(), stride * (height / 2 + 2 * PADDING));
        assert_eq!((cells[0], cells[cells.len() - 1]), (OUTSIDE, OUTSIDE));
        assert_eq!(at(3, 3), OUTSIDE);
        let dot = at(15, 10);
        assert!(dot[6] > 100 && dot[8] < 100 && dot[9] < 30 && dot[11] > 200, "{dot:?}");
        assert_eq!(dot[10], 0);
    }

    /// Numbers between which a result lies whatever its steps round to.
    #[derive(Debug, Clone, Copy)]
    struct Between(f64, f64);

    impl Between {
        /// Q16 reciprocal of a number of quarters with the floor of 4 units, rounded down.
        fn reciprocal(self) -> Self {
            Self(65536.0 / (self.1 + 16.0) - 1.0, 65536.0 / (self.0 + 16.0))
        }

        fn times(self, other: Self) -> Self {
            let products = [self.0 * other.0, self.0 * other.1, self.1 * other.0, self.1 * other.1];
            Self(
                products.into_iter().fold(f64::MAX, f64::min),
                products.into_iter().fold(f64::MIN, f64::max),
            )
        }

        /// Divided, then rounded down.
        fn over(self, divisor: f64) -> Self {
            Self(self.0 / divisor - 1.0, self.1 / divisor)
        }

        /// A byte of the map, 8 times the root of this, rounded down.
        fn root(self) -> Self {
            let root = |v: f64| (8.0 * v.clamp(0.0, 1023.0).sqrt()).floor();
            Self(root(self.0), root(self.1))
        }

        /// A byte of the map, this above the middle.
        fn above_middle(self) -> Self {
            Self((128.0 + self.0).clamp(0.0, 255.0), (128.0 + self.1).clamp(0.0, 255.0))
        }

        fn holds(self, byte: u8) -> bool {
            (self.0..=self.1).contains(&f64::from(byte))
        }
    }

    fn exactly(v: f64) -> Between {
        Between(v, v)
    }

    proptest! {
        #[test]
        fn map_agrees_with_f64(
            level in level(), noise in prop::array::uniform3(prop_oneof![0..80u32, 0..4100u32]),
            extra in 0..9usize, oriented: bool,
        ) {
            let newest = Newest { oriented, ..level.newest() };
            let (columns, rows) = newest.slice.cells();
            // Strips of any height give the same map.
            let out = whole(&newest, noise, (10 + extra, 9));
            prop_assert_eq!(&out, &whole(&newest, noise, (rows + 2 * PADDING, 0)));
            let cells = cells(&newest);
            for (place, got) in out.iter().enumerate() {
                let stride = columns + 2 * PADDING;
                let (x, y) = ((place % stride).wrapping_sub(PADDING), (place / stride).wrapping_sub(PADDING));
                if x >= columns || y >= rows {
                    prop_assert_eq!(got, &OUTSIDE);
                    continue;
                }
                // Sum over the part of the square of 11 x 11 cells that lies in the picture, and its cells.
                let around = |channel: usize| {
                    let (mut sum, mut count) = (0.0, 0.0);
                    for j in y.saturating_sub(5)..(y + 6).min(rows) {
                        for i in x.saturating_sub(5)..(x + 6).min(columns) {
                            sum += f64::from(cells[j * columns + i][channel]);
                            count += 1.0;
                        }
                    }
                    (sum, count)
                };
                // Quarters of the mean over the whole square: 4/121 in Q16, rounded down, is short of it by 3e-4.
                let mean = |channel| {
                    let mean = 4.0 * around(channel).0 / 121.0;
                    Between((mean * (1.0 - 3e-4) - 1.0).max(0.0), mean)
                };
                let value = |channel: usize| f64::from(cells[y * columns + x][channel]);
                let ratio = |value: f64, mean: Between| exactly(value).times(mean.reciprocal()).over(256.0).root();
                let energy = mean(MAGNITUDE);
                let mut want = [exactly(0.0); MAP_CHANNELS];
                for (channel, want) in want[..=MAGNITUDE].iter_mut().enumerate() {
                    *want = ratio(value(channel), energy);
                }
                want[7] = exactly(4.0 * value(MAGNITUDE)).root();
                let [grey, far, near, plain] = [7, 8, 9, 10];
                let (sum, count) = around(grey);
                let above = 4.0 * (value(grey) - sum / count);
                // The mean is rounded down after a division that may be half a quarter too much.
                let above = Between(above - 0.5, above + 1.0);
                want[8] = above.times(energy.reciprocal()).over(1024.0).above_middle();
                want[9] = above.over(2.0).above_middle();
                for (i, channel) in [far, near, plain].into_iter().enumerate() {
                    let calm = 65536.0 / (f64::from(noise[i]) + 32.0);
                    want[10 + i] = exactly(value(channel)).times(Between(calm - 1.0, calm)).over(128.0).root();
                }
                want[13] = ratio(value(near), mean(near));
                want[14] = ratio(value(plain), exactly(4.0 * value(MAGNITUDE)));
                want[15] = ratio(value(far), mean(far));
                for (channel, (got, want)) in got.iter().zip(want).enumerate() {
                    prop_assert!(want.holds(*got), "{x} {y} channel {channel}: {got}, not {want:?}");
                }
            }
        }

        #[test]
        fn noise_agrees_with_f64(level in level()) {
            let newest = level.newest();
            let (columns, rows) = newest.slice.cells();
            let cells = cells(&newest);
            let mut words = vec![9; noise_words(columns, rows)];
            for (i, got) in noise(&newest, &mut words).into_iter().enumerate() {
                let mut means = vec![];
                for by in 0..rows / 8 {
                    for bx in 0..columns / 8 {
                        let cell = |n: usize| f64::from(cells[(8 * by + n / 8) * columns + 8 * bx + n % 8][GREY + 1 + i]);
                        means.push((0..64).map(cell).sum::<f64>() / 64.0);
                    }
                }
                let mean = |of: &[f64]| of.iter().sum::<f64>() / (of.len() as f64).max(1.0);
                let all = mean(&means);
                means.retain(|m| *m <= 2.0 * all);
                prop_assert!((f64::from(got) - 16.0 * mean(&means)).abs() < 1.0, "{i}: {got}");
            }
        }
    }
}
