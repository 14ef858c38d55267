//! Channels of one pyramid level: integral gradient images and the scan's map (level 2).
//!
//! Of every frame a table of eight channels is kept: [`ORIENTATIONS`] gradient energies, their magnitude and the
//! temporal difference. Of the newest frame alone there are a second table (intensity and the other differences) and a
//! map of [`MAP_CHANNELS`] normalised bytes a cell, in which the scan looks up single values.

use crate::gradient::{CELL, CellRow, ORIENTATIONS};
use crate::image::Image;
use crate::integral::{self, Builder, Entry, Integral};

/// Difference images beside the grey one: tolerant to a frame far back, tolerant and plain to that of the oldest slice.
pub const DIFFERENCES: usize = 3;

/// Channel of the gradient magnitude in the first table.
pub const MAGNITUDE: usize = ORIENTATIONS;

/// Channel of the temporal difference in the first table.
pub const TEMPORAL: usize = ORIENTATIONS + 1;

/// Bytes of the scan's map for one cell.
pub const MAP_CHANNELS: usize = 16;

/// Cells of the map around the picture, so that windows may hang over its edge.
pub const PADDING: usize = 3;

/// Half the side of the square over which the map is normalised, in cells.
const REACH: i32 = 5;

/// Cells in that square.
const AREA: u32 = (2 * REACH as u32 + 1) * (2 * REACH as u32 + 1);

/// Map values of a cell outside the picture: nothing there, intensity that of its surroundings.
const OUTSIDE: [u8; MAP_CHANNELS] = [0, 0, 0, 0, 0, 0, 0, 0, 128, 128, 0, 0, 0, 0, 0, 0];

/// `8 * sqrt(i)`: compresses ratios so that small ones keep their resolution.
static ROOT: [u8; 1024] = {
    let mut table = [0; 1024];
    let mut root = 0u32;
    let mut i = 0;
    while i < 1024 {
        while (root + 1) * (root + 1) <= 64 * i {
            root += 1;
        }
        table[i as usize] = if root > 255 { 255 } else { root as u8 };
        i += 1;
    }
    table
};

/// Words of a level's table over `width` x `height` pixels of the level.
pub const fn table_words(width: usize, height: usize) -> usize {
    integral::words(width / CELL, height / CELL)
}

/// Bytes of a level's map over `width` x `height` pixels of the level.
pub const fn map_bytes(width: usize, height: usize) -> usize {
    (width / CELL + 2 * PADDING) * (height / CELL + 2 * PADDING) * MAP_CHANNELS
}

/// Writes the tables of a level: `grey` and its `differences` give `table` (energies, magnitude, tolerant difference to
/// the oldest frame) and `newest` (intensity, then the differences in quarters of a grey level, at most 255). All
/// pictures of one size; slices of [`table_words`]. Panics if one is smaller.
pub fn tables(
    grey: &Image<'_>,
    differences: &[Image<'_>; DIFFERENCES],
    table: &mut [u16],
    newest: &mut [u16],
) {
    let (columns, rows) = (grey.width() / CELL, grey.height() / CELL);
    let mut table = Builder::new(table, columns);
    let mut newest = Builder::new(newest, columns);
    for row in 0..rows {
        let pixels = CellRow::new(grey, row);
        let differences = differences.map(|d| CellRow::new(&d, row));
        // The mean of four pixels in quarters of a grey level is their sum.
        let quarters = |i: usize, x| differences[i].sum(x).min(255) as u8;
        table.push_row(|x| {
            let [a, b, c, d, e, f, magnitude] = pixels.energies(x);
            [a, b, c, d, e, f, magnitude, quarters(1, x)]
        });
        newest.push_row(|x| {
            let grey = ((pixels.sum(x) + 2) >> 2) as u8;
            [grey, quarters(0, x), quarters(1, x), quarters(2, x), 0, 0, 0, 0]
        });
    }
}

/// Noise of the differences of a whole frame: the mean of each over its calmer cells, Q4. Scales the map's temporal
/// channels, so that wind in the trees or a badly measured camera motion do not look like targets everywhere.
pub fn noise(newest: &Integral<'_>) -> [u32; DIFFERENCES] {
    // Means of 8x8-cell blocks; the mean of those below twice the mean of all is robust against targets.
    const BLOCK: i32 = 8;
    let (columns, rows) = (newest.width() as i32 / BLOCK, newest.height() as i32 / BLOCK);
    let blocks = || (0..rows).flat_map(move |y| (0..columns).map(move |x| (x, y)));
    let sum_at =
        |i: usize, x, y| u32::from(newest.box_sum(x * BLOCK, y * BLOCK, BLOCK, BLOCK)[i + 1]);
    core::array::from_fn(|i| {
        let count = (columns * rows).max(1) as u64;
        let all: u64 = blocks().map(|(x, y)| u64::from(sum_at(i, x, y))).sum();
        let (mut calm, mut number) = (0u64, 0u64);
        for (x, y) in blocks() {
            let sum = u64::from(sum_at(i, x, y));
            if sum * count <= 2 * all {
                calm += sum;
                number += 1;
            }
        }
        (calm / (4 * number.max(1))) as u32
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

/// Corners of the squares of one row of cells in a table: above and below the square, above and below the row itself.
struct Rows<'a> {
    table: Integral<'a>,
    square: (i32, i32),
    row: i32,
}

impl Rows<'_> {
    /// Sums over the square around column `x` and over its middle cell.
    #[inline(always)]
    fn sums(&self, x: i32) -> (Entry, Entry) {
        let (top, bottom) = self.square;
        let square = self.table.box_sum(x - REACH, top, 2 * REACH + 1, bottom - top);
        (square, self.table.box_sum(x, self.row, 1, 1))
    }
}

/// Mean over the square in quarters of a unit, from its sum.
#[inline(always)]
fn quarter_mean(sum: u16) -> usize {
    // 4 / 121 in Q16; at most 1020 since a value is at most 255.
    ((u32::from(sum) * (4 * 65536 / AREA)) >> 16) as usize
}

/// 64 times `value` over the mean with reciprocal `reciprocal`, through [`ROOT`].
#[inline(always)]
fn ratio(value: u16, reciprocal: u16) -> u8 {
    let ratio = (u32::from(value) * u32::from(reciprocal)) >> 8;
    ROOT[ratio.min(1023) as usize]
}

/// Writes the scan's map of a level from its tables; `noise` as [`noise`] gives it, the same for all levels.
///
/// Channels: 0..6 orientations and 6 magnitude against the mean magnitude around; 7 magnitude; 8 intensity against the
/// mean around, relative to the magnitude around (128: equal); 9 the same in half grey levels; 10..13 the differences
/// against the frame's noise; 13 and 15 two of them against their mean around; 14 the plain one against the magnitude.
pub fn map(
    table: &Integral<'_>,
    newest: &Integral<'_>,
    noise: &[u32; DIFFERENCES],
    map: &mut [u8],
) {
    let (columns, rows) = (table.width(), table.height());
    let stride = columns + 2 * PADDING;
    let (cells, _) = map.as_chunks_mut::<MAP_CHANNELS>();
    let cells = &mut cells[..stride * (rows + 2 * PADDING)];
    cells[..PADDING * stride].fill(OUTSIDE);
    cells[(PADDING + rows) * stride..].fill(OUTSIDE);
    // Q16 reciprocals of the noise (Q4 quarters) with a floor of half a grey level.
    let calm = noise.map(|n| 65536 / (n + 32));
    for y in 0..rows {
        let row = &mut cells[(PADDING + y) * stride..(PADDING + y + 1) * stride];
        row[..PADDING].fill(OUTSIDE);
        row[PADDING + columns..].fill(OUTSIDE);
        let cy = y as i32;
        let square = ((cy - REACH).max(0), (cy + REACH + 1).min(rows as i32));
        let energies = Rows { table: *table, square, row: cy };
        let fresh = Rows { table: *newest, square, row: cy };
        let mut inside = (0, 0);
        for (x, out) in row[PADDING..PADDING + columns].iter_mut().enumerate() {
            let cx = x as i32;
            let (around, cell) = energies.sums(cx);
            let (fresh_around, fresh) = fresh.sums(cx);
            // Cells of the square that lie in the picture, and their Q18 reciprocal: they change near edges only.
            let across = (cx + REACH + 1).min(columns as i32) - (cx - REACH).max(0);
            let count = (across * (square.1 - square.0)) as u32;
            if inside.0 != count {
                inside = (count, (1u32 << 18).div_ceil(count));
            }
            let energy = RECIPROCAL[quarter_mean(around[MAGNITUDE])];
            for (out, value) in out[..=MAGNITUDE].iter_mut().zip(cell) {
                *out = ratio(value, energy);
            }
            out[7] = ROOT[(usize::from(cell[MAGNITUDE]) * 4).min(1023)];
            let mean = (u32::from(fresh_around[0]) * inside.1) >> 16;
            let above = i32::from(fresh[0]) * 4 - mean as i32;
            out[8] = (128 + ((above * i32::from(energy)) >> 10)).clamp(0, 255) as u8;
            out[9] = (128 + (above >> 1)).clamp(0, 255) as u8;
            for i in 0..DIFFERENCES {
                let loud = (u32::from(fresh[i + 1]) * calm[i]) >> 7;
                out[10 + i] = ROOT[loud.min(1023) as usize];
            }
            let local =
                |i: usize| ratio(fresh[i + 1], RECIPROCAL[quarter_mean(fresh_around[i + 1])]);
            out[13] = local(1);
            out[15] = local(0);
            // The plain difference against the magnitude of the cell alone.
            out[14] = ratio(fresh[3], RECIPROCAL[usize::from(cell[MAGNITUDE]) * 4]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    #[test]
    fn a_dot_stands_out_and_padding_is_neutral() {
        let (width, height) = (64usize, 48usize);
        let mut pixels = vec![100u8; width * height];
        let still = vec![0u8; width * height];
        let mut moved = still.clone();
        for y in 20..24 {
            for x in 30..34 {
                pixels[y * width + x] = 40;
                moved[y * width + x] = 80;
            }
        }
        let view = |p| Image::packed(p, width, height).unwrap();
        let mut table = vec![0; table_words(width, height)];
        let mut newest = table.clone();
        tables(
            &view(&pixels),
            &[view(&still), view(&moved), view(&moved)],
            &mut table,
            &mut newest,
        );
        let (table, newest) = (
            Integral::new(&table, width / 2, height / 2),
            Integral::new(&newest, width / 2, height / 2),
        );
        let mut out = vec![0; map_bytes(width, height)];
        map(&table, &newest, &noise(&newest), &mut out);
        let (cells, rest) = out.as_chunks::<MAP_CHANNELS>();
        assert!(rest.is_empty());
        let stride = width / 2 + 2 * PADDING;
        let at = |x: usize, y: usize| cells[(y + PADDING) * stride + x + PADDING];
        assert_eq!(cells[0], OUTSIDE);
        assert_eq!(at(3, 3), OUTSIDE);
        let dot = at(15, 10);
        assert!(dot[6] > 100 && dot[8] < 100 && dot[9] < 30 && dot[11] > 200, "{dot:?}");
        assert_eq!(dot[10], 0);
    }

    fn table(cells: &[[u8; 8]], columns: usize) -> Vec<u16> {
        let mut storage = vec![0; integral::words(columns, cells.len() / columns)];
        let mut builder = Builder::new(&mut storage, columns);
        cells.chunks(columns).for_each(|row| builder.push_row(|x| row[x]));
        storage
    }

    /// Cells of `columns` x `rows`, noisy or with few values.
    fn cells(columns: usize, rows: usize) -> impl Strategy<Value = Vec<[u8; 8]>> {
        let cell = prop_oneof![4 => any::<[u8; 8]>(), 1 => any::<[u8; 8]>().prop_map(|c| c.map(|v| v / 32))];
        prop_oneof![
            3 => prop::collection::vec(cell, columns * rows),
            1 => any::<[u8; 8]>().prop_map(move |cell| vec![cell; columns * rows]),
        ]
    }

    prop_compose! {
        fn level()(columns in 1..24usize, rows in 1..20usize)(
            columns in Just(columns), table in cells(columns, rows), newest in cells(columns, rows),
        ) -> (usize, Vec<[u8; 8]>, Vec<[u8; 8]>) {
            (columns, table, newest)
        }
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
        fn map_agrees_with_f64((columns, old, new) in level(), noise in prop::array::uniform3(prop_oneof![0..80u32, 0..4100u32])) {
            let rows = old.len() / columns;
            let (table_words, newest_words) = (table(&old, columns), table(&new, columns));
            let mut out = vec![1; (columns + 2 * PADDING) * (rows + 2 * PADDING) * MAP_CHANNELS];
            map(
                &Integral::new(&table_words, columns, rows), &Integral::new(&newest_words, columns, rows),
                &noise, &mut out,
            );
            let (out, _) = out.as_chunks::<MAP_CHANNELS>();
            for (place, got) in out.iter().enumerate() {
                let stride = columns + 2 * PADDING;
                let (x, y) = ((place % stride).wrapping_sub(PADDING), (place / stride).wrapping_sub(PADDING));
                if x >= columns || y >= rows {
                    prop_assert_eq!(got, &OUTSIDE);
                    continue;
                }
                // Sum over the part of the square of 11 x 11 cells that lies in the picture, and its cells.
                let around = |cells: &[[u8; 8]], channel: usize| {
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
                let mean = |cells, channel| {
                    let mean = 4.0 * around(cells, channel).0 / 121.0;
                    Between((mean * (1.0 - 3e-4) - 1.0).max(0.0), mean)
                };
                let value = |cells: &[[u8; 8]], channel: usize| f64::from(cells[y * columns + x][channel]);
                let ratio = |value: f64, mean: Between| exactly(value).times(mean.reciprocal()).over(256.0).root();
                let energy = mean(&old, MAGNITUDE);
                let mut want = [exactly(0.0); MAP_CHANNELS];
                for (channel, want) in want[..=MAGNITUDE].iter_mut().enumerate() {
                    *want = ratio(value(&old, channel), energy);
                }
                want[7] = exactly(4.0 * value(&old, MAGNITUDE)).root();
                let (sum, count) = around(&new, 0);
                let above = 4.0 * (value(&new, 0) - sum / count);
                // The mean is rounded down after a division that may be half a quarter too much.
                let above = Between(above - 0.5, above + 1.0);
                want[8] = above.times(energy.reciprocal()).over(1024.0).above_middle();
                want[9] = above.over(2.0).above_middle();
                for i in 0..DIFFERENCES {
                    let calm = 65536.0 / (f64::from(noise[i]) + 32.0);
                    want[10 + i] = exactly(value(&new, i + 1)).times(Between(calm - 1.0, calm)).over(128.0).root();
                }
                want[13] = ratio(value(&new, 2), mean(&new, 2));
                want[14] = ratio(value(&new, 3), exactly(4.0 * value(&old, MAGNITUDE)));
                want[15] = ratio(value(&new, 1), mean(&new, 1));
                for (channel, (got, want)) in got.iter().zip(want).enumerate() {
                    prop_assert!(want.holds(*got), "{x} {y} channel {channel}: {got}, not {want:?}");
                }
            }
        }

        #[test]
        fn noise_agrees_with_f64((columns, _, new) in level()) {
            let rows = new.len() / columns;
            let words = table(&new, columns);
            let got = noise(&Integral::new(&words, columns, rows));
            for (i, got) in got.into_iter().enumerate() {
                let mut means = vec![];
                for by in 0..rows / 8 {
                    for bx in 0..columns / 8 {
                        let cell = |n: usize| f64::from(new[(8 * by + n / 8) * columns + 8 * bx + n % 8][i + 1]);
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
