//! The map of one pyramid level, in which the scan looks up single values (level 3).
//!
//! [`MAP_CHANNELS`] bytes a cell: the channels of the newest frame, normalised by what is around them. The map is
//! computed from above, a strip of a few rows at a time, with running sums over the square around each cell.

use crate::channels::window::PADDING;
use crate::channels::{CELL_CHANNELS, DIFFERENCES, GREY, MAGNITUDE, Newest, RUN};
use crate::image::gradient::ORIENTATIONS;
use crate::math::slices;
use core::array::from_fn;

/// Bytes of the scan's map for one cell.
pub const MAP_CHANNELS: usize = 16;

/// Half the side of the square over which the map is normalised, in cells.
const REACH: usize = 5;

/// Cells in that square.
const AREA: u32 = (2 * REACH as u32 + 1) * (2 * REACH as u32 + 1);

/// The byte of a map for a value of 0: they are kept less 128, see [`lanes::signed`](super::lanes::signed).
const NOTHING: u8 = 128;

/// Bytes of a cell outside the picture: nothing there, intensity that of its surroundings.
const OUTSIDE: [u8; MAP_CHANNELS] = {
    let mut outside = [NOTHING; MAP_CHANNELS];
    (outside[8], outside[9]) = (128 ^ NOTHING, 128 ^ NOTHING);
    outside
};

/// Ratios in [`ROOT`]: the largest is 255 times the largest of [`RECIPROCAL`], Q8. Where there is room for a table of all numbers
/// of 16 bits, looking one up needs no check.
const RATIOS: usize = if cfg!(feature = "simd") { 1 << 16 } else { 4096 };

/// `8 * sqrt(i)`, at most 255, as a byte of a map: compresses ratios so that small ones keep their resolution.
static ROOT: [u8; RATIOS] = {
    let mut table = [0; RATIOS];
    let mut root = 0u32;
    let mut i = 0;
    while i < RATIOS as u32 {
        while root < 255 && (root + 1) * (root + 1) <= 64 * i {
            root += 1;
        }
        table[i as usize] = root as u8 ^ NOTHING;
        i += 1;
    }
    table
};

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
pub fn noise(newest: &Newest<'_>, words: &mut [u16]) -> [u32; DIFFERENCES] {
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

/// Rows and columns of cells over which the map is normalised.
const NEAR: usize = 2 * REACH + 1;

/// Channels of which the mean around a cell is needed: magnitude, grey, far and near difference.
const AVERAGED: [usize; 4] = [MAGNITUDE, GREY, GREY + 1, GREY + 2];

/// Words beside the sums of columns: sums over the square, then those of pairs and fours of columns, in whose place are
/// later four reciprocals of each cell.
const fn temporaries_len(columns: usize) -> usize {
    let (pairs, reciprocals) = (2 * sums_len(columns), 4 * columns);
    AVERAGED.len() * columns + if pairs > reciprocals { pairs } else { reciprocals }
}

/// Sums of one channel over the columns of a level, and as many zeros as the square reaches on either side.
const fn sums_len(columns: usize) -> usize {
    columns + 2 * REACH
}

/// Bytes that [`strips`] needs, with strips of up to `rows` rows, for a level of `columns` cells in a row.
pub const fn strip_bytes(columns: usize, rows: usize) -> usize {
    (columns + 2 * PADDING) * rows * MAP_CHANNELS + columns * NEAR * CELL_CHANNELS
}

/// Words that [`strips`] needs for a level of `columns` cells in a row.
pub const fn strip_words(columns: usize) -> usize {
    AVERAGED.len() * sums_len(columns) + temporaries_len(columns)
}

/// Rows of a map from row `top` on, counted from the first row of padding. A row is [`MAP_CHANNELS`] planes, a byte for
/// each cell.
#[derive(Debug, Clone, Copy)]
pub struct Strip<'a> {
    /// Number of the first row.
    pub top: usize,
    /// The rows, values less 128, each [`PADDING`] cells wider than the level on either side.
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
    let width = columns + 2 * PADDING;
    let stride = width * MAP_CHANNELS;
    let (strip, ring) = slices::split_mut(bytes, stride * rows);
    let mut around = Around::new(newest, ring, words);
    // Q16 reciprocals of the noise (Q4 quarters) with a floor of half a grey level: at most 2048.
    let loud = noise.map(|n| loud(65536 / n.saturating_add(32)));
    let height = around.rows + 2 * PADDING;
    let mut filled = 0;
    for number in 0..height {
        let planes = slices::part_mut(strip, filled * stride, stride);
        match number.checked_sub(PADDING).filter(|&y| y < around.rows) {
            Some(y) => {
                for (plane, value) in slices::rows_mut(planes, width).zip(OUTSIDE) {
                    plane[..PADDING].fill(value);
                    plane[PADDING + columns..].fill(value);
                }
                around.advance(y);
                around.map_row(y, &loud, planes);
            }
            None => {
                for (plane, value) in slices::rows_mut(planes, width).zip(OUTSIDE) {
                    plane.fill(value);
                }
            }
        }
        filled += 1;
        if filled == rows || number + 1 == height {
            each(Strip { top: number + 1 - filled, bytes: &strip[..filled * stride] });
            strip.copy_within((filled - shared.min(filled)) * stride..filled * stride, 0);
            filled = shared;
        }
    }
}

/// Map values of a difference against the noise, by the difference.
type Loud = [u8; 256];

/// For a Q16 reciprocal of the noise, at most 2048.
fn loud(calm: u32) -> Loud {
    from_fn(|value| ROOT[((value as u32 * calm) >> 7) as usize % RATIOS])
}

/// The cells around a row of cells.
struct Around<'a> {
    newest: &'a Newest<'a>,
    columns: usize,
    rows: usize,
    /// The last [`NEAR`] rows of cells, row y in place y modulo their number: [`CELL_CHANNELS`] planes each.
    ring: &'a mut [u8],
    /// Of each of [`AVERAGED`] the sums of each column over the rows of the square around the row.
    sums: &'a mut [u16],
    temporaries: &'a mut [u16],
    /// Rows of cells that were taken in.
    taken: usize,
}

impl<'a> Around<'a> {
    fn new(newest: &'a Newest<'a>, ring: &'a mut [u8], words: &'a mut [u16]) -> Self {
        let (columns, rows) = newest.slice.cells();
        let ring = slices::part_mut(ring, 0, columns * NEAR * CELL_CHANNELS);
        let (sums, rest) = slices::split_mut(words, AVERAGED.len() * sums_len(columns));
        sums.fill(0);
        let temporaries = slices::part_mut(rest, 0, temporaries_len(columns));
        Self { newest, columns, rows, ring, sums, temporaries, taken: 0 }
    }

    /// Moves the square down to be around row `y`, the one after that of the last call; the first is 0.
    #[inline(never)]
    fn advance(&mut self, y: usize) {
        let length = self.columns * CELL_CHANNELS;
        if let Some(above) = y.checked_sub(REACH + 1) {
            let gone = slices::part(self.ring, above % NEAR * length, length);
            change_sums::<false>(self.columns, gone, self.sums);
        }
        while self.taken < self.rows.min(y + REACH + 1) {
            let cells = slices::part_mut(self.ring, self.taken % NEAR * length, length);
            self.newest.row(self.taken).fill(self.columns, cells);
            change_sums::<true>(self.columns, cells, self.sums);
            self.taken += 1;
        }
    }

    /// The map of row `y`, around which the square is; `out` is the row of the map.
    #[inline(never)]
    fn map_row(&mut self, y: usize, loud: &[Loud; DIFFERENCES], out: &mut [u8]) {
        let length = self.columns * CELL_CHANNELS;
        let cells = slices::part(self.ring, y % NEAR * length, length);
        let down = (y + REACH + 1).min(self.rows) - y.saturating_sub(REACH);
        let Self { columns, sums, temporaries, .. } = self;
        let (around, rest) = slices::split_mut(temporaries, AVERAGED.len() * *columns);
        let (pairs, fours) = slices::split_mut(
            slices::part_mut(rest, 0, 2 * sums_len(*columns)),
            sums_len(*columns),
        );
        sum_across(*columns, sums, around, [pairs, fours]);
        map_row(
            Row { cells, around, columns: *columns, down, oriented: self.newest.oriented, loud },
            rest,
            out,
        );
    }
}

/// Adds a row of cells to the sums of columns, or takes it away.
fn change_sums<const ADD: bool>(columns: usize, cells: &[u8], sums: &mut [u16]) {
    for (sums, channel) in slices::rows_mut(sums, sums_len(columns)).zip(AVERAGED) {
        let plane = slices::part(cells, channel * columns, columns);
        for (sum, &value) in sums[REACH..].iter_mut().zip(plane) {
            let value = u16::from(value);
            *sum = if ADD { *sum + value } else { *sum - value };
        }
    }
}

/// Sums over the square around each cell, from sums of columns; `pairs` and `fours` have room for those of one channel.
#[cfg_attr(feature = "simd", multiversion::multiversion(targets("x86_64+avx2", "x86_64+sse4.1")))]
fn sum_across(columns: usize, sums: &[u16], around: &mut [u16], [pairs, fours]: [&mut [u16]; 2]) {
    let planes = slices::rows_mut(around, columns);
    for (out, sums) in planes.zip(slices::rows(sums, sums_len(columns))) {
        if !cfg!(feature = "simd") {
            sum_along(sums, out);
            continue;
        }
        // 11 columns are 4 and 4 and 2 and 1.
        for ((pair, a), b) in pairs.iter_mut().zip(sums).zip(&sums[1..]) {
            *pair = a + b;
        }
        for ((four, a), b) in fours.iter_mut().zip(&*pairs).zip(&pairs[2..]) {
            *four = a + b;
        }
        let ends = fours.iter().zip(&fours[4..]).zip(&pairs[8..]).zip(&sums[10..]);
        for (out, (((a, b), c), d)) in out.iter_mut().zip(ends) {
            *out = a + b + c + d;
        }
    }
}

/// [`sum_across`] of one channel, cell by cell: for processors without vector instructions.
fn sum_along(sums: &[u16], out: &mut [u16]) {
    let (first, rest) = slices::split(sums, NEAR - 1);
    let mut sum: u16 = first.iter().sum();
    for ((out, new), gone) in out.iter_mut().zip(rest).zip(sums) {
        sum += new;
        *out = sum;
        sum -= gone;
    }
}

/// What a row of the map is computed from.
#[derive(Debug, Clone, Copy)]
struct Row<'a> {
    /// Planes of cells.
    cells: &'a [u8],
    /// Planes of sums over the square around each cell.
    around: &'a [u16],
    columns: usize,
    /// Rows of the square that lie in the picture.
    down: usize,
    oriented: bool,
    loud: &'a [Loud; DIFFERENCES],
}

impl<'a> Row<'a> {
    fn cells(&self, channel: usize) -> &'a [u8] {
        slices::part(self.cells, channel * self.columns, self.columns)
    }

    fn around(&self, number: usize) -> &'a [u16] {
        slices::part(self.around, number * self.columns, self.columns)
    }
}

/// The high half of a product.
#[inline(always)]
fn high(a: u16, b: u16) -> u16 {
    ((u32::from(a) * u32::from(b)) >> 16) as u16
}

#[cfg_attr(feature = "simd", multiversion::multiversion(targets("x86_64+avx2", "x86_64+sse4.1")))]
fn map_row(row: Row<'_>, temporaries: &mut [u16], out: &mut [u8]) {
    let columns = row.columns;
    let mut planes = slices::rows_mut(out, columns + 2 * PADDING)
        .map(|plane| slices::part_mut(plane, PADDING, columns));
    let mut plane = || planes.next().unwrap_or_default();
    let (energy, rest) = slices::split_mut(temporaries, columns);
    let (far, rest) = slices::split_mut(rest, columns);
    let (near, rest) = slices::split_mut(rest, columns);
    let indices = slices::part_mut(rest, 0, columns);
    reciprocals(row.around(0), energy);
    reciprocals(row.around(2), far);
    reciprocals(row.around(3), near);
    for channel in 0..ORIENTATIONS {
        let out = plane();
        match row.oriented {
            true => ratios(row.cells(channel), energy, indices, out),
            false => out.fill(NOTHING),
        }
    }
    let magnitude = row.cells(MAGNITUDE);
    ratios(magnitude, energy, indices, plane());
    look_up(magnitude, |value| QUARTER_ROOT[usize::from(value)], plane());
    intensity(&row, energy, indices, [plane(), plane()]);
    let [far_cells, near_cells, plain] = [1, 2, 3].map(|i| row.cells(GREY + i));
    for (cells, loud) in [far_cells, near_cells, plain].into_iter().zip(row.loud) {
        look_up(cells, |value| loud[usize::from(value)], plane());
    }
    ratios(near_cells, near, indices, plane());
    // The plain difference against the magnitude of the cell alone.
    look_up(magnitude, |magnitude| RECIPROCAL[usize::from(magnitude) * 4], energy);
    ratios(plain, energy, indices, plane());
    ratios(far_cells, far, indices, plane());
}

/// [`ROOT`] of four times a magnitude.
static QUARTER_ROOT: [u8; 256] = {
    let mut table = [0; 256];
    let mut i = 0;
    while i < 256 {
        table[i] = ROOT[4 * i];
        i += 1;
    }
    table
};

/// Reciprocals of the means over squares of such sums.
#[inline(always)]
fn reciprocals(sums: &[u16], out: &mut [u16]) {
    look_up(sums, |sum| RECIPROCAL[quarter_mean(sum) & 1023], out);
}

/// 64 times each value over the mean of this reciprocal, through [`ROOT`].
#[inline(always)]
fn ratios(values: &[u8], reciprocals: &[u16], indices: &mut [u16], out: &mut [u8]) {
    for ((index, &value), &reciprocal) in indices.iter_mut().zip(values).zip(reciprocals) {
        // A shift by 8 in all.
        *index = high(u16::from(value) << 8, reciprocal);
    }
    look_up(indices, |index| ROOT[usize::from(index) % RATIOS], out);
}

/// Looks each value up, eight at a time so that there is less to do beside.
#[inline(always)]
fn look_up<T: Copy, U>(values: &[T], table: impl Fn(T) -> U, out: &mut [U]) {
    let ((eights, rest), (out, last)) = (values.as_chunks::<8>(), out.as_chunks_mut::<8>());
    for (out, values) in out.iter_mut().zip(eights) {
        for (out, &value) in out.iter_mut().zip(values) {
            *out = table(value);
        }
    }
    for (out, &value) in last.iter_mut().zip(rest) {
        *out = table(value);
    }
}

/// Intensity against the mean around: relative to the magnitude around, and in half grey levels.
#[inline(always)]
fn intensity(row: &Row<'_>, energy: &[u16], means: &mut [u16], [relative, half]: [&mut [u8]; 2]) {
    let columns = row.columns;
    let (grey, around) = (row.cells(GREY), row.around(1));
    // Q18 reciprocal of the cells of the square that lie in the picture: they change near edges only.
    let reciprocal = |across: usize| (1u32 << 18).div_ceil((across * row.down).max(1) as u32);
    let whole = reciprocal(NEAR) as u16;
    for (mean, &sum) in means.iter_mut().zip(around) {
        *mean = high(sum, whole);
    }
    let edges = (0..REACH.min(columns)).chain(columns.saturating_sub(REACH)..columns);
    for x in edges {
        let across = (x + REACH + 1).min(columns) - x.saturating_sub(REACH);
        means[x] = ((u32::from(around[x]) * reciprocal(across)) >> 16) as u16;
    }
    let above = |grey: u8, mean: u16| i16::from(grey) * 4 - mean.cast_signed();
    for ((out, &grey), &mean) in half.iter_mut().zip(grey).zip(&*means) {
        *out = (above(grey, mean) >> 1).clamp(-128, 127) as u8;
    }
    for (((out, &grey), &mean), &energy) in relative.iter_mut().zip(grey).zip(&*means).zip(energy) {
        // Both factors have 15 bits: six more than what counts of the product.
        let product = i32::from(above(grey, mean) << 4) * i32::from((energy << 2).cast_signed());
        *out = ((product >> 16) as i16).clamp(-128, 127) as u8;
    }
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
            let width = columns + 2 * PADDING;
            let rows = strip.bytes.chunks_exact(width * MAP_CHANNELS);
            assert!(rows.remainder().is_empty());
            let cells: Vec<[u8; MAP_CHANNELS]> = rows
                .flat_map(|row| {
                    (0..width).map(move |x| from_fn(|channel| row[channel * width + x] ^ 128))
                })
                .collect();
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
        let outside = OUTSIDE.map(|byte| byte ^ 128);
        let at = |x: usize, y: usize| cells[(y + PADDING) * stride + x + PADDING];
        assert_eq!(cells.len(), stride * (height / 2 + 2 * PADDING));
        assert_eq!((cells[0], cells[cells.len() - 1]), (outside, outside));
        assert_eq!(at(3, 3), outside);
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
                    prop_assert_eq!(got, &OUTSIDE.map(|byte| byte ^ 128));
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
        fn sums_along_are_sums_across(columns in 1..90usize, seed in prop::collection::vec(0..2806u16, 100)) {
            let sums = &seed[..sums_len(columns)];
            let (mut across, mut along) = (vec![0; columns], vec![0; columns]);
            let mut rest = [vec![0xa5a5; sums.len()], vec![0xa5a5; sums.len()]];
            sum_across(columns, sums, &mut across, rest.each_mut().map(Vec::as_mut_slice));
            sum_along(sums, &mut along);
            let naive: Vec<u16> = sums.windows(NEAR).map(|sums| sums.iter().sum()).collect();
            prop_assert_eq!(&across, &naive);
            prop_assert_eq!(&along, &naive);
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
