//! St-cubes: windows on the integral gradient images of several frames (level 3).
//!
//! A [`Patch`] is one slice: the summed-area table of a window of [`WINDOW`] x [`WINDOW`] cells, cut out at a quarter
//! of a cell. Since box sums are linear in the table's corners, interpolated corners give the box sums of the
//! interpolated channels. In the paper's terms a window is 40x40 px with targets about 20 px long: the finest level
//! takes its gradients at every second of those pixels, which is the frame's own resolution for targets of 10 px.

use crate::integral::{CHANNELS, Integral};

/// Cells along one side of a window.
pub const WINDOW: usize = 10;

/// Slices of a cube, s_t of the paper.
pub const SLICES: usize = 4;

/// Positions of a patch for each cell (Q2).
pub const SUBCELL: i32 = 4;

/// Corners along one side of a window.
const CORNERS: usize = WINDOW + 1;

/// Sums in a patch are this many times those of the cells.
pub const PATCH_SCALE: u32 = (SUBCELL * SUBCELL) as u32;

/// One slice of a cube: a summed-area table of its cells.
#[derive(Debug, Clone)]
pub struct Patch {
    corners: [[[u32; CHANNELS]; CORNERS]; CORNERS],
}

impl Patch {
    /// A patch of nothing.
    pub const EMPTY: Self = Self { corners: [[[0; CHANNELS]; CORNERS]; CORNERS] };

    /// Cuts the window whose upper left corner is at (x, y), in quarters of a cell, out of `table`. What lies outside
    /// the table counts as 0.
    pub fn cut(&mut self, table: &Integral<'_>, x: i32, y: i32) {
        let (cx, cy) = (x.div_euclid(SUBCELL), y.div_euclid(SUBCELL));
        let (fx, fy) = (x.rem_euclid(SUBCELL) as u32, y.rem_euclid(SUBCELL) as u32);
        let unit = SUBCELL as u32;
        let origin = table.corner(cx, cy);
        // Corner (i, j) relative to the window's own corner: the sum of the box between them, exact in 16 bits.
        let mut last = [[0u32; CHANNELS]; CORNERS];
        for j in 0..=CORNERS {
            let row = cy + j as i32;
            let edge = table.corner(cx, row);
            let relative = |i: i32| -> [u32; CHANNELS] {
                let (corner, top) = (table.corner(cx + i, row), table.corner(cx + i, cy));
                core::array::from_fn(|c| {
                    u32::from(
                        corner[c]
                            .wrapping_sub(edge[c])
                            .wrapping_sub(top[c])
                            .wrapping_add(origin[c]),
                    )
                })
            };
            let mut left = relative(0);
            for (i, above) in last.iter_mut().enumerate() {
                let right = relative(i as i32 + 1);
                let mixed: [u32; CHANNELS] =
                    core::array::from_fn(|c| left[c] * (unit - fx) + right[c] * fx);
                if let Some(row) = j.checked_sub(1) {
                    self.corners[row][i] =
                        core::array::from_fn(|c| above[c] * (unit - fy) + mixed[c] * fy);
                }
                *above = mixed;
                left = right;
            }
        }
    }

    /// Sum of `channel` over cells `x0..x1`, `y0..y1` of the window, [`PATCH_SCALE`] times. At most 2^19.
    /// Panics if the box leaves the window.
    #[inline]
    pub fn sum(&self, channel: usize, x0: usize, y0: usize, x1: usize, y1: usize) -> u32 {
        let at = |x: usize, y: usize| self.corners[y][x][channel];
        at(x1, y1).wrapping_sub(at(x0, y1)).wrapping_sub(at(x1, y0)).wrapping_add(at(x0, y0))
    }
}

/// A st-cube: a patch of each of the last [`SLICES`] frames, newest first, and the newest frame's second table.
#[derive(Debug, Clone)]
pub struct Cube {
    /// Slice k is cut from the frame k frames ago.
    pub slices: [Patch; SLICES],
    /// Intensity and differences of the newest frame, where slice 0 is.
    pub newest: Patch,
    /// What is known of the cube beside its channels, by number.
    pub scalars: [u16; SCALARS],
}

/// Number of scalars of a cube: see [`crate::motion`].
pub const SCALARS: usize = 16;

impl Cube {
    /// A cube of nothing.
    pub const EMPTY: Self = Self {
        slices: [const { Patch::EMPTY }; SLICES],
        newest: Patch::EMPTY,
        scalars: [0; SCALARS],
    };
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integral::{Builder, words};
    use proptest::prelude::*;
    use std::vec;

    proptest! {
        #[test]
        fn sums_are_those_of_interpolated_cells(
            cells in prop::collection::vec(any::<[u8; 8]>(), 19 * 13),
            x in -60..80i32, y in -60..60i32, bx in 0..10usize, by in 0..10usize, w in 0..10usize, h in 0..10usize,
        ) {
            let (width, height) = (19usize, 13usize);
            let mut storage = vec![0; words(width, height)];
            let mut builder = Builder::new(&mut storage, width);
            for row in cells.chunks(width) {
                builder.push_row(|x| row[x]);
            }
            let table = Integral::new(&storage, width, height);
            let mut patch = Patch::EMPTY;
            patch.cut(&table, x, y);
            let (x1, y1) = ((bx + w).min(WINDOW), (by + h).min(WINDOW));
            // Brute force: every cell of the window is a mixture of four.
            let value = |i: i32, j: i32| {
                let inside = (0..width as i32).contains(&i) && (0..height as i32).contains(&j);
                if inside { i64::from(cells[j as usize * width + i as usize][3]) } else { 0 }
            };
            let mut naive = 0;
            for j in by..y1 {
                for i in bx..x1 {
                    for dy in 0..4 {
                        for dx in 0..4 {
                            let px = x + 4 * i as i32 + dx;
                            let py = y + 4 * j as i32 + dy;
                            naive += value(px.div_euclid(4), py.div_euclid(4));
                        }
                    }
                }
            }
            prop_assert_eq!(i64::from(patch.sum(3, bx, by, x1, y1)), naive);
        }
    }
}
