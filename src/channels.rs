//! Channels of one pyramid level: gradient energies and differences of cells, and the scan's map (level 2).
//!
//! A frame has eight channels a cell: [`ORIENTATIONS`] gradient energies, their magnitude and the temporal difference.
//! Of the newest frame alone there are four more (intensity and all differences), and a map of [`MAP_CHANNELS`]
//! normalised bytes a cell, in which the scan looks up single values. Cells are computed from pictures where they are
//! asked for, the map in strips of a few rows: pictures are all that is kept.

use crate::gradient::{CELL, CellRow, ORIENTATIONS};
use crate::image::Image;
use core::array::from_fn;

/// Difference images beside the grey one: tolerant to a frame far back, tolerant and plain to that of the oldest slice.
pub const DIFFERENCES: usize = 3;

/// Channels of every frame, and as many of the newest alone.
pub const CHANNELS: usize = 8;

/// Channel of the gradient magnitude.
pub const MAGNITUDE: usize = ORIENTATIONS;

/// Channel of the temporal difference.
pub const TEMPORAL: usize = ORIENTATIONS + 1;

/// Bytes of the scan's map for one cell.
pub const MAP_CHANNELS: usize = 16;

/// Cells of the map around the picture, so that windows may hang over its edge.
pub const PADDING: usize = 3;

/// Half the side of the square over which the map is normalised, in cells.
const REACH: usize = 5;

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

/// Eight channels of the cells of a square, row by row.
pub type Square<const N: usize> = [[[u8; CHANNELS]; N]; N];

/// A difference image of a level.
#[derive(Debug, Clone, Copy)]
pub struct Difference<'a> {
    /// Grey levels.
    pub picture: Image<'a>,
    /// Whether a pixel is a whole cell of the level, not a pixel of it.
    pub halved: bool,
}

/// The pixels of a difference image for one row of cells.
#[derive(Debug, Clone, Copy)]
enum DifferenceRow<'a> {
    Pixels(CellRow<'a>),
    Cells(&'a [u8]),
}

impl<'a> Difference<'a> {
    #[inline]
    fn row(&self, row: usize) -> DifferenceRow<'a> {
        if !self.halved {
            DifferenceRow::Pixels(CellRow::new(&self.picture, row))
        } else if row < self.picture.height() {
            DifferenceRow::Cells(self.picture.row(row))
        } else {
            DifferenceRow::Cells(&[])
        }
    }
}

impl DifferenceRow<'_> {
    /// The mean over cell `x` in quarters of a grey level, at most 255: the sum of its four pixels. 0 beyond a halved
    /// picture, which may lack the last column and row.
    #[inline(always)]
    fn quarters(&self, x: usize) -> u8 {
        let sum = match self {
            Self::Pixels(row) => row.sum(x),
            Self::Cells(row) => row.get(x).map_or(0, |&mean| 4 * u32::from(mean)),
        };
        sum.min(255) as u8
    }
}

/// What is kept of a frame on a level.
#[derive(Debug, Clone, Copy)]
pub struct Slice<'a> {
    /// Grey levels.
    pub grey: Image<'a>,
    /// Tolerant difference to the frame a few before.
    pub near: Difference<'a>,
}

/// What there is of the newest frame on a level.
#[derive(Debug, Clone, Copy)]
pub struct Newest<'a> {
    /// What is kept of it.
    pub slice: Slice<'a>,
    /// Tolerant difference to a frame far back.
    pub far: Difference<'a>,
    /// Plain difference to the frame a few before.
    pub plain: Difference<'a>,
}

/// Cells of `N` columns from column `left` on, of row `y` of a level of such a size; those outside of it are 0.
fn square<const N: usize, R>(
    size: (usize, usize),
    (left, top): (i32, i32),
    row: impl Fn(usize) -> R,
    cell: impl Fn(&R, usize) -> [u8; CHANNELS],
) -> Square<N> {
    let mut cells = [[[0; CHANNELS]; N]; N];
    for (j, cells) in cells.iter_mut().enumerate() {
        let Some(y) = place(top, j).filter(|&y| y < size.1) else { continue };
        let row = row(y);
        for (i, out) in cells.iter_mut().enumerate() {
            if let Some(x) = place(left, i).filter(|&x| x < size.0) {
                *out = cell(&row, x);
            }
        }
    }
    cells
}

/// `first + i`, unless it is negative.
fn place(first: i32, i: usize) -> Option<usize> {
    usize::try_from(i64::from(first) + i as i64).ok()
}

impl<'a> Slice<'a> {
    /// Cells in a row and in a column.
    pub fn cells(&self) -> (usize, usize) {
        (self.grey.width() / CELL, self.grey.height() / CELL)
    }

    /// Energies, magnitude and temporal difference of the cells of a square whose upper left one is at (x, y). Cells
    /// outside the picture are 0.
    pub fn square<const N: usize>(&self, x: i32, y: i32) -> Square<N> {
        let row = |y| (CellRow::new(&self.grey, y), self.near.row(y));
        square(self.cells(), (x, y), row, |(grey, near), x| {
            let [a, b, c, d, e, f, magnitude] = grey.energies(x);
            [a, b, c, d, e, f, magnitude, near.quarters(x)]
        })
    }
}

impl Newest<'_> {
    /// Intensity, the differences in quarters of a grey level (at most 255) and zeros: of the cells of a square, as
    /// [`Slice::square`].
    pub fn square<const N: usize>(&self, x: i32, y: i32) -> Square<N> {
        square(self.slice.cells(), (x, y), |y| self.row(y), |row, x| row.second(x))
    }

    fn row(&self, y: usize) -> NewestRow<'_> {
        NewestRow {
            grey: CellRow::new(&self.slice.grey, y),
            differences: [self.far.row(y), self.slice.near.row(y), self.plain.row(y)],
        }
    }
}

/// A row of cells of the newest frame.
struct NewestRow<'a> {
    grey: CellRow<'a>,
    differences: [DifferenceRow<'a>; DIFFERENCES],
}

impl NewestRow<'_> {
    #[inline(always)]
    fn second(&self, x: usize) -> [u8; CHANNELS] {
        let [far, near, plain] = self.differences.each_ref().map(|d| d.quarters(x));
        [((self.grey.sum(x) + 2) >> 2) as u8, far, near, plain, 0, 0, 0, 0]
    }

    #[inline(always)]
    fn cell(&self, x: usize) -> Cell {
        let [a, b, c, d, e, f, magnitude] = self.grey.energies(x);
        let [grey, far, near, plain, ..] = self.second(x);
        [a, b, c, d, e, f, magnitude, grey, far, near, plain]
    }
}

/// Side of the blocks of [`noise`], in cells.
const BLOCK: usize = 8;

/// Words that [`noise`] needs for a level of `columns` x `rows` cells.
pub const fn noise_words(columns: usize, rows: usize) -> usize {
    (columns / BLOCK) * (rows / BLOCK) * DIFFERENCES
}

/// Noise of the differences of a whole frame: the mean of each over its calmer cells, Q4. Scales the map's temporal
/// channels, so that wind in the trees or a badly measured camera motion do not look like targets everywhere.
/// Panics if there are fewer than [`noise_words`] words.
pub fn noise(newest: &Newest<'_>, words: &mut [u16]) -> [u32; DIFFERENCES] {
    // Means of blocks; the mean of those below twice the mean of all is robust against targets.
    let (columns, rows) = newest.slice.cells();
    let (across, down) = (columns / BLOCK, rows / BLOCK);
    let (blocks, _) = words[..noise_words(columns, rows)].as_chunks_mut::<DIFFERENCES>();
    blocks.fill([0; DIFFERENCES]);
    for y in 0..down * BLOCK {
        let row = newest.row(y).differences;
        let blocks = &mut blocks[y / BLOCK * across..][..across];
        for (x, sums) in blocks.iter_mut().enumerate() {
            for (sum, row) in sums.iter_mut().zip(&row) {
                *sum +=
                    (x * BLOCK..(x + 1) * BLOCK).map(|x| u16::from(row.quarters(x))).sum::<u16>();
            }
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
    ROOT[ratio.min(1023) as usize]
}

/// All that the map asks of a cell: energies, magnitude, grey, differences.
type Cell = [u8; ORIENTATIONS + 2 + DIFFERENCES];

/// Where the grey level of a [`Cell`] is, and behind it the differences.
const GREY: usize = MAGNITUDE + 1;

/// Rows of cells over which the map is normalised.
const NEAR: usize = 2 * REACH + 1;

/// Sums of a column of a square, or of all of it: magnitude, grey, far and near difference.
type Sums = [u16; 4];

fn sums(cell: &Cell) -> Sums {
    [MAGNITUDE, GREY, GREY + 1, GREY + 2].map(|channel| u16::from(cell[channel]))
}

fn add(sums: &mut Sums, other: &Sums) {
    sums.iter_mut().zip(other).for_each(|(sum, other)| *sum += other);
}

fn take(sums: &mut Sums, other: &Sums) {
    sums.iter_mut().zip(other).for_each(|(sum, other)| *sum -= other);
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
/// Channels: 0..6 orientations and 6 magnitude against the mean magnitude around; 7 magnitude; 8 intensity against the
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
    // Q16 reciprocals of the noise (Q4 quarters) with a floor of half a grey level.
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
    fn advance(&mut self, y: usize) {
        if let Some(above) = y.checked_sub(REACH + 1) {
            let gone = &self.ring[above % NEAR * self.columns..][..self.columns];
            self.sums.iter_mut().zip(gone).for_each(|(all, cell)| take(all, &sums(cell)));
        }
        while self.taken < self.rows.min(y + REACH + 1) {
            let newest = self.newest;
            let row = newest.row(self.taken);
            let cells = &mut self.ring[self.taken % NEAR * self.columns..][..self.columns];
            for (x, (cell, all)) in cells.iter_mut().zip(self.sums.iter_mut()).enumerate() {
                *cell = row.cell(x);
                add(all, &sums(cell));
            }
            self.taken += 1;
        }
    }

    /// The map of row `y`, around which the square is.
    fn map_row(&self, y: usize, calm: &[u32; DIFFERENCES], out: &mut [[u8; MAP_CHANNELS]]) {
        let cells = &self.ring[y % NEAR * self.columns..][..self.columns];
        let down = (y + REACH + 1).min(self.rows) - y.saturating_sub(REACH);
        let mut around = [0; 4];
        self.sums.iter().take(REACH).for_each(|column| add(&mut around, column));
        let mut inside = (0, 0);
        for (x, (out, cell)) in out.iter_mut().zip(cells).enumerate() {
            if let Some(column) = self.sums.get(x + REACH) {
                add(&mut around, column);
            }
            if let Some(left) = x.checked_sub(REACH + 1) {
                take(&mut around, &self.sums[left]);
            }
            // Cells of the square that lie in the picture, and their Q18 reciprocal: they change near edges only.
            let across = (x + REACH + 1).min(self.columns) - x.saturating_sub(REACH);
            let count = (across * down) as u32;
            if inside.0 != count {
                inside = (count, (1u32 << 18).div_ceil(count));
            }
            *out = map_cell(cell, &around, inside.1, calm);
        }
    }
}

/// The map of a cell with the sums over the square around it; `inside` is the Q18 reciprocal of its cells.
#[inline(always)]
fn map_cell(
    cell: &Cell,
    around: &Sums,
    inside: u32,
    calm: &[u32; DIFFERENCES],
) -> [u8; MAP_CHANNELS] {
    let [magnitude_around, grey_around, far_around, near_around] = *around;
    let energy = RECIPROCAL[quarter_mean(magnitude_around)];
    let mut out = [0; MAP_CHANNELS];
    for (out, value) in out[..=MAGNITUDE].iter_mut().zip(cell) {
        *out = ratio(*value, energy);
    }
    let magnitude = usize::from(cell[MAGNITUDE]);
    let [grey, far, near, plain] = from_fn(|i| cell[GREY + i]);
    out[7] = ROOT[(magnitude * 4).min(1023)];
    let mean = (u32::from(grey_around) * inside) >> 16;
    let above = i32::from(grey) * 4 - mean as i32;
    out[8] = (128 + ((above * i32::from(energy)) >> 10)).clamp(0, 255) as u8;
    out[9] = (128 + (above >> 1)).clamp(0, 255) as u8;
    for (out, (difference, calm)) in out[10..13].iter_mut().zip([far, near, plain].iter().zip(calm))
    {
        let loud = (u32::from(*difference) * calm) >> 7;
        *out = ROOT[loud.min(1023) as usize];
    }
    out[13] = ratio(near, RECIPROCAL[quarter_mean(near_around)]);
    out[15] = ratio(far, RECIPROCAL[quarter_mean(far_around)]);
    // The plain difference against the magnitude of the cell alone.
    out[14] = ratio(plain, RECIPROCAL[magnitude * 4]);
    out
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
