//! The map of one pyramid level, in which the scan looks up single values.
//!
//! [`MAP_CHANNELS`] bytes a cell: the channels of the newest frame, normalised by what is around them. The map is
//! computed from above, a strip of a few rows at a time, with running sums over the square around each cell.

mod noise;
mod row;

use crate::channels::window::PADDING;
use crate::channels::{CELL_CHANNELS, DIFFERENCES, NewestChannels};
use crate::math::slices;
use row::{AVERAGED, CellRows, Loud, NEAR, NOTHING, REACH, loud, map_row, sum_across, sums_len};

pub use noise::{noise, noise_words};

/// Bytes of the scan's map for one cell.
pub const MAP_CHANNELS: usize = 16;

/// Bytes of a cell outside the picture: nothing there, intensity that of its surroundings.
const OUTSIDE: [u8; MAP_CHANNELS] = {
    let mut outside = [NOTHING; MAP_CHANNELS];
    (outside[8], outside[9]) = (128 ^ NOTHING, 128 ^ NOTHING);
    outside
};

/// Words beside the sums of columns: sums over the square, then those of pairs and fours of columns, in whose place are
/// later four reciprocals of each cell.
const fn temporaries_len(columns: usize) -> usize {
    let (pairs, reciprocals) = (2 * sums_len(columns), 4 * columns);
    AVERAGED.len() * columns + if pairs > reciprocals { pairs } else { reciprocals }
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
pub struct MapStrip<'a> {
    /// Number of the first row.
    pub top: usize,
    /// The rows, values less 128, each [`PADDING`] cells wider than the level on either side.
    pub bytes: &'a [u8],
}

/// Computes the scan's map of a level, `rows` rows at a time of which the first `shared` are the last ones of the strip
/// before; `noise` as [`noise`] gives it, the same for all levels.
///
/// Channels: 0..6 orientations (0 where there are none) and 6 magnitude against the mean magnitude around; 7 magnitude; 8
/// intensity against the mean around, relative to the magnitude around (128: equal); 9 the same in half grey levels; 10..13
/// the differences against the frame's noise; 13 and 15 two of them against their mean around; 14 the plain one against the
/// magnitude.
///
/// Panics if there are fewer than [`strip_bytes`] bytes or [`strip_words`] words, or not more rows than shared ones.
pub fn strips(
    newest: &NewestChannels<'_>,
    noise: &[u32; DIFFERENCES],
    (rows, shared): (usize, usize),
    bytes: &mut [u8],
    words: &mut [u16],
    mut each: impl FnMut(MapStrip<'_>),
) {
    let columns = newest.slice.cells().0;
    let width = columns + 2 * PADDING;
    let stride = width * MAP_CHANNELS;
    let (strip, ring) = slices::split_mut(bytes, stride * rows);
    let mut around = LocalSums::new(newest, ring, words);
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
            each(MapStrip { top: number + 1 - filled, bytes: &strip[..filled * stride] });
            strip.copy_within((filled - shared.min(filled)) * stride..filled * stride, 0);
            filled = shared;
        }
    }
}

/// The cells around a row of cells.
struct LocalSums<'a> {
    newest: &'a NewestChannels<'a>,
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

impl<'a> LocalSums<'a> {
    fn new(newest: &'a NewestChannels<'a>, ring: &'a mut [u8], words: &'a mut [u16]) -> Self {
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
            CellRows {
                cells,
                around,
                columns: *columns,
                down,
                oriented: self.newest.oriented,
                loud,
            },
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

#[cfg(test)]
mod tests;
