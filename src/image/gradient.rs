//! Gradient energy of cells by orientation.
//!
//! Central differences; the magnitude of each pixel is shared between the two nearest of [`ORIENTATIONS`] bins over
//! 0..π and summed over cells of [`CELL`] x [`CELL`] pixels. Integers only. Orientation is measured by the diamond
//! angle |gy| / (|gx| + |gy|), which is monotone in the true angle and within 4.1 degrees of it.

use crate::image::Image;

/// Orientation bins over 0..π.
pub const ORIENTATIONS: usize = 6;

/// Pixels of a level along one side of a cell.
pub const CELL: usize = 2;

/// Energies of a cell: [`ORIENTATIONS`] orientations, then their magnitude in all.
pub type Energies = [u8; ORIENTATIONS + 1];

/// Q8 thirds of a right angle to one of |gx| + |gy|, rounded down; the entry of 0 is 0.
pub(super) static THIRDS: [u32; 512] = {
    let mut table = [0; 512];
    let mut i = 1;
    while i < 512 {
        table[i] = 3 * (65536 / i as u32);
        i += 1;
    }
    table
};

/// Energies of the bins while a cell is summed up. Energy added to the bin behind the last one belongs to the first, where
/// the turn begins anew; the last is room that saves a check.
type Bins = [u32; 8];

/// A gradient to the right and downwards, in grey levels over two pixels.
type Gradient = (i32, i32);

/// Within 3 % of the Euclidean norm ("alpha max plus beta min").
#[inline(always)]
fn magnitude((gx, gy): Gradient) -> u32 {
    let (ax, ay) = (gx.unsigned_abs(), gy.unsigned_abs());
    let (long, short) = if ax > ay { (ax, ay) } else { (ay, ax) };
    long.max((long * 29 + short * 16) >> 5)
}

/// Half of a sum, rounded, at most 255. Signed, so that a microcontroller has an instruction for it.
#[inline(always)]
fn half(sum: u32) -> u8 {
    ((sum + 1).cast_signed() >> 1).clamp(0, 255) as u8
}

/// Adds one pixel's gradient to the bins of its cell and gives its magnitude.
#[inline(always)]
fn add((gx, gy): Gradient, bins: &mut Bins) -> u32 {
    let (ax, ay) = (gx.unsigned_abs(), gy.unsigned_abs());
    if ax + ay == 0 {
        return 0;
    }
    let magnitude = magnitude((gx, gy));
    // Angle over 0..90 degrees as 0..768: three bins of 256.
    let angle = (ay * THIRDS[(ax + ay) as usize & 511]) >> 8;
    let position = if (gx ^ gy) < 0 { 6 * 256 - angle } else { angle };
    let second = (magnitude * (position & 255)) >> 8;
    let bin = (position >> 8) as usize & 7;
    bins[bin] += magnitude - second;
    bins[(bin + 1) & 7] += second;
    magnitude
}

/// The rows of pixels that one row of cells needs.
#[derive(Debug, Clone, Copy)]
pub struct CellRow<'a> {
    pub(super) above: &'a [u8],
    pub(super) rows: [&'a [u8]; CELL],
    pub(super) below: &'a [u8],
}

impl<'a> CellRow<'a> {
    /// Cell row `row` of `image`: pixel rows `row * CELL` and the next. Beyond the picture its edge pixels repeat.
    /// Panics if the row of cells is not within the picture.
    pub fn new(image: &Image<'a>, row: usize) -> Self {
        let y = row * CELL;
        Self {
            above: image.row(y.saturating_sub(1)),
            rows: [image.row(y), image.row(y + 1)],
            below: image.row((y + 2).min(image.height() - 1)),
        }
    }

    /// Cell `cell`, counted from the left. Panics if it is not within the row.
    #[inline(always)]
    pub fn cell(&self, cell: usize) -> CellPixels {
        let left = CELL * cell;
        let pair = |row: &[u8]| -> [i32; CELL] {
            let pair = &row[left..left + CELL];
            [pair[0].into(), pair[1].into()]
        };
        // The cell's pixels and one on either side, in one piece but at the edges.
        let wide = |row: &[u8]| -> [i32; CELL + 2] {
            let inner = left.checked_sub(1).and_then(|left| row.get(left..)?.first_chunk());
            match inner {
                Some(&[a, b, c, d]) => [a.into(), b.into(), c.into(), d.into()],
                None => {
                    let [first, second] = pair(row);
                    let at = |x: usize| row.get(x).map(|&pixel| i32::from(pixel));
                    let before = left.checked_sub(1).and_then(at).unwrap_or(first);
                    [before, first, second, at(left + CELL).unwrap_or(second)]
                }
            }
        };
        CellPixels { above: pair(self.above), rows: self.rows.map(wide), below: pair(self.below) }
    }

    /// The pixels of the row itself from cell `first` on, without those around it.
    #[inline(always)]
    pub fn from(&self, first: usize) -> Self {
        let rows = self.rows.map(|row| row.get(CELL * first..).unwrap_or(&[]));
        Self { rows, ..*self }
    }

    /// [`CellRow::sum`] of the first cells, at most 255. Panics if the row has fewer cells than `out`.
    #[inline(always)]
    pub fn fill_quarters(&self, out: &mut [u8]) {
        let pairs = |row: &'a [u8]| &row.as_chunks::<CELL>().0[..out.len()];
        let (upper, lower) = (pairs(self.rows[0]), pairs(self.rows[1]));
        for ((out, upper), lower) in out.iter_mut().zip(upper).zip(lower) {
            let (upper, lower) = (u16::from_le_bytes(*upper), u16::from_le_bytes(*lower));
            let sum = (upper & 255) + (upper >> 8) + (lower & 255) + (lower >> 8);
            *out = sum.min(255) as u8;
        }
    }

    /// Sum of the cell's four pixels. Panics if the cell is not within the row.
    #[inline(always)]
    pub fn sum(&self, cell: usize) -> u32 {
        let pair = |row: &[u8]| u32::from(row[2 * cell]) + u32::from(row[2 * cell + 1]);
        pair(self.rows[0]) + pair(self.rows[1])
    }
}

/// The pixels of a cell and those beside them.
#[derive(Debug, Clone, Copy)]
pub struct CellPixels {
    pub(super) above: [i32; CELL],
    /// One more on either side.
    pub(super) rows: [[i32; CELL + 2]; CELL],
    pub(super) below: [i32; CELL],
}

impl CellPixels {
    /// Half the sum of the pixels' magnitudes in grey levels (differences over two pixels), at most 255, in all and by
    /// orientation.
    #[inline(always)]
    pub fn energies(&self) -> Energies {
        let mut bins = Bins::default();
        let [a, b, c, d] = self.gradients();
        // Written out, here and where cells are taken further: on a microcontroller loops over channels cost more than
        // what they do.
        let magnitude =
            add(a, &mut bins) + add(b, &mut bins) + add(c, &mut bins) + add(d, &mut bins);
        let [a, b, c, d, e, f, turned, _] = bins;
        [half(a + turned), half(b), half(c), half(d), half(e), half(f), half(magnitude)]
    }

    /// The last of [`CellPixels::energies`] alone.
    #[inline(always)]
    pub fn magnitude(&self) -> u8 {
        let [a, b, c, d] = self.gradients();
        half(magnitude(a) + magnitude(b) + magnitude(c) + magnitude(d))
    }

    /// The mean of the pixels, rounded.
    #[inline(always)]
    pub fn grey(&self) -> u8 {
        let [[_, a, b, _], [_, c, d, _]] = self.rows;
        ((a + b + c + d + 2) >> 2) as u8
    }

    /// The gradients of the pixels, row by row.
    #[inline(always)]
    fn gradients(&self) -> [Gradient; CELL * CELL] {
        let Self { above, rows: [first, second], below } = self;
        [
            (first[2] - first[0], second[1] - above[0]),
            (first[3] - first[1], second[2] - above[1]),
            (second[2] - second[0], below[0] - first[1]),
            (second[3] - second[1], below[1] - first[2]),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// The same in f64, pixel by pixel, with the diamond angle.
    fn naive(image: &Image<'_>, row: usize, cell: usize) -> [f64; 7] {
        let at = |x: i64, y: i64| {
            let x = x.clamp(0, image.width() as i64 - 1) as usize;
            let y = y.clamp(0, image.height() as i64 - 1) as usize;
            f64::from(image.row(y)[x])
        };
        let mut sums = [0.0; 7];
        for y in (2 * row as i64)..(2 * row as i64 + 2) {
            for x in (2 * cell as i64)..(2 * cell as i64 + 2) {
                let (gx, gy) = (at(x + 1, y) - at(x - 1, y), at(x, y + 1) - at(x, y - 1));
                let norm = gx.hypot(gy);
                if norm == 0.0 {
                    continue;
                }
                let quarter = 3.0 * gy.abs() / (gx.abs() + gy.abs());
                let position = if gx * gy < 0.0 { 6.0 - quarter } else { quarter };
                let bin = position.floor();
                sums[bin as usize % 6] += norm * (1.0 - (position - bin));
                sums[(bin as usize + 1) % 6] += norm * (position - bin);
                sums[6] += norm;
            }
        }
        sums.map(|s| (s / 2.0).min(255.0))
    }

    #[test]
    fn agrees_with_f64() {
        let (width, height) = (17, 9);
        let mut seed = 7u32;
        let pixels: Vec<u8> = (0..width * height)
            .map(|i| {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                if i % 40 < 20 { (seed >> 24) as u8 } else { 100 + (seed >> 30) as u8 }
            })
            .collect();
        let image = Image::packed(&pixels, width, height).unwrap();
        for row in 0..height / CELL {
            for cell in 0..width / CELL {
                let out = CellRow::new(&image, row).cell(cell).energies();
                for (got, want) in out.into_iter().zip(naive(&image, row, cell)) {
                    assert!((f64::from(got) - want).abs() <= 2.0 + 0.04 * want, "{got} {want}");
                }
            }
        }
    }

    #[test]
    fn a_vertical_edge_is_all_in_the_first_bin() {
        let pixels = [0, 0, 100, 100].repeat(4);
        let image = Image::packed(&pixels, 4, 4).unwrap();
        for cell in 0..2 {
            assert_eq!(CellRow::new(&image, 0).cell(cell).energies(), [100, 0, 0, 0, 0, 0, 100]);
        }
        assert_eq!(CellRow::new(&image, 1).sum(1), 400);
    }
}
