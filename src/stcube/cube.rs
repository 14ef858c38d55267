//! St-cubes: windows on the gradient energies of several frames.
//!
//! A [`Patch`] is one slice: the summed-area table (Viola & Jones 2001, sec. 2.1) of a window of [`WINDOW`] x [`WINDOW`]
//! cells, cut out at a quarter of a cell. Since box sums are linear in the table's corners, interpolated corners give the
//! box sums of the interpolated channels. In the paper's terms a window is 40x40 px with targets about 20 px long: the
//! finest level takes its gradients at every second of those pixels, which is the frame's own resolution for targets of 10
//! px.

use crate::channels::window::{SLICES, SUBCELL, WINDOW};
use crate::channels::{CHANNELS, NewestChannels, Slice, Square};

/// Corners along one side of a window.
const CORNERS: usize = WINDOW + 1;

/// Room for the corners of a window: a power of two, so that looking one up needs no check.
const ROOM: usize = (CORNERS * CORNERS).next_power_of_two();

/// Sums in a patch are this many times those of the cells.
pub const PATCH_SCALE: u32 = (SUBCELL * SUBCELL) as u32;

/// One slice of a cube: a summed-area table of its cells.
#[derive(Debug, Clone)]
pub struct Patch {
    /// Row by row; what is behind the last one stays 0.
    pub(super) corners: Corners,
    /// Whether something was cut: a patch of nothing is all zeros, so that it takes no place in a program's constants.
    written: bool,
}

impl Patch {
    /// A patch whose sums are all 0.
    pub const EMPTY: Self = Self { corners: NOTHING, written: false };

    /// Sets all sums to 0.
    pub fn clear(&mut self) {
        if self.written {
            *self = Self::EMPTY;
        }
    }

    /// Cuts the window whose upper left corner is at (x, y), in quarters of a cell, out of a frame. Cells outside of it are
    /// 0.
    pub fn cut(&mut self, slice: &Slice<'_>, x: i32, y: i32) {
        let (cell, part) = corner(x, y);
        self.sum_up(&slice.square(cell.0, cell.1), part);
    }

    /// As [`Patch::cut`], of the channels that the newest frame alone has.
    pub fn cut_newest(&mut self, newest: &NewestChannels<'_>, x: i32, y: i32) {
        let (cell, part) = corner(x, y);
        self.sum_up(&newest.square(cell.0, cell.1), part);
    }

    /// Fills it with the cells of a window; those of the last row and column are beyond it.
    pub fn fill(&mut self, cells: &Square<CORNERS>) {
        self.sum_up(cells, (0, 0));
    }

    /// Sums up the window that begins `part` (quarters of a cell) right of and below the first corner of `cells`.
    fn sum_up(&mut self, cells: &Square<CORNERS>, part: (u32, u32)) {
        self.written = true;
        sum_up(&mut self.corners, cells, part);
    }

    /// Sum of `channel` over cells of the window, [`PATCH_SCALE`] times. At most 2^19. A number without meaning if there
    /// is no such channel.
    #[inline(always)]
    pub fn sum(&self, channel: usize, region: &Region) -> u32 {
        region.sum(&self.corners, channel)
    }
}

/// A summed-area table with one corner more than cells: see [`Patch`].
pub(super) type Corners = [[u32; CHANNELS]; ROOM];

/// A table of zeros.
pub(super) const NOTHING: Corners = [[0; CHANNELS]; ROOM];

/// Sums up the window that begins (fx, fy) quarters of a cell right of and below the first corner of `cells`.
#[cfg_attr(feature = "simd", multiversion::multiversion(targets("x86_64+avx2", "x86_64+sse4.1")))]
fn sum_up(corners: &mut Corners, cells: &Square<CORNERS>, (fx, fy): (u32, u32)) {
    let unit = SUBCELL as u32;
    // Of each corner of a row of cells: sums over all cells above and to the left, those of the row before it, and
    // the interpolation between it and the one to its right, of the row before.
    let mut sums = [[0u32; CHANNELS]; CORNERS + 1];
    for j in 0..=CORNERS {
        if let Some(row) = j.checked_sub(1) {
            let mut left = [0; CHANNELS];
            for (sums, cell) in sums[1..].iter_mut().zip(&cells[row]) {
                for ((sum, left), value) in sums.iter_mut().zip(&mut left).zip(cell) {
                    *left += u32::from(*value);
                    *sum += *left;
                }
            }
        }
        for i in 0..CORNERS {
            let (left, right) = (&sums[i], &sums[i + 1]);
            for c in 0..CHANNELS {
                let mixed = left[c] * (unit - fx) + right[c] * fx;
                // Each corner is a mixture of this row's and the next one's.
                if j < CORNERS {
                    corners[(j * CORNERS + i) % ROOM][c] = mixed * (unit - fy);
                }
                if let Some(row) = j.checked_sub(1) {
                    corners[(row * CORNERS + i) % ROOM][c] += mixed * fy;
                }
            }
        }
    }
}

/// Cells of a window, as the places of its corners in a table: upper left, upper right, lower left, lower right.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Region {
    corners: [usize; 4],
}

impl Region {
    /// All cells of the window.
    pub const WHOLE: Self = Self::new((0, WINDOW as u8), (0, WINDOW as u8));

    /// [`Patch::sum`] of a summed-area table.
    #[inline(always)]
    pub(super) fn sum(&self, table: &Corners, channel: usize) -> u32 {
        let values = table.as_flattened();
        let at = |corner: usize| values[(corner + channel) % (ROOM * CHANNELS)];
        let [a, b, c, d] = self.corners;
        at(a).wrapping_sub(at(b)).wrapping_sub(at(c)).wrapping_add(at(d))
    }

    /// Columns `x.0..x.1` and rows `y.0..y.1`, at most [`WINDOW`].
    #[inline(always)]
    pub const fn new(x: (u8, u8), y: (u8, u8)) -> Self {
        const ROW: usize = CORNERS * CHANNELS;
        let (upper, lower) = (y.0 as usize * ROW, y.1 as usize * ROW);
        let (left, right) = (x.0 as usize * CHANNELS, x.1 as usize * CHANNELS);
        Self { corners: [upper + left, upper + right, lower + left, lower + right] }
    }
}

/// The cell that holds a point in quarters of a cell, and how far in it is.
fn corner(x: i32, y: i32) -> ((i32, i32), (u32, u32)) {
    let part = |v: i32| v.rem_euclid(SUBCELL) as u32;
    ((x.div_euclid(SUBCELL), y.div_euclid(SUBCELL)), (part(x), part(y)))
}

/// A st-cube: a patch of each of the last [`SLICES`] frames, newest first, and the additional channels of the newest.
#[derive(Debug, Clone)]
pub struct Cube {
    /// Slice k is cut from the frame k frames ago.
    pub slices: [Patch; SLICES],
    /// Intensity and differences of the newest frame, where slice 0 is.
    pub newest: Patch,
    /// Values beside the channels; see [`Scalar`].
    pub scalars: [u16; SCALARS],
}

/// Number of scalars of a cube.
pub const SCALARS: usize = 16;

/// A value of a cube beside its channels, by its place in [`Cube::scalars`]. Features of a model name these places:
/// they never change.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Scalar(usize);

impl Scalar {
    /// Score of the scan, Q8 log-odds and 32768, clamped to 16 bits.
    pub const SCAN_SCORE: Self = Self(0);
    /// Of a window that is stretched to a box, which has no scan score: the box's shorter side in quarters of a pixel.
    pub const SHORTER_SIDE: Self = Self(0);
    /// Length of the level's nominal target, pixels of the frame.
    pub const TARGET_LENGTH: Self = Self(1);
    /// 1 if the newest frame was registered to the one before, else 0.
    pub const REGISTERED: Self = Self(2);
    /// First of the values of a trajectory: [`crate::stcube::compensation::Trajectory::scalars`].
    pub const TRAJECTORY: Self = Self(4);

    /// Place in [`Cube::scalars`].
    pub const fn place(self) -> usize {
        self.0
    }
}

impl Cube {
    /// Writes `value` to the place of `scalar`.
    pub fn set(&mut self, scalar: Scalar, value: u16) {
        self.scalars[scalar.place()] = value;
    }

    /// A cube whose sums and scalars are all 0.
    pub const EMPTY: Self = Self {
        slices: [const { Patch::EMPTY }; SLICES],
        newest: Patch::EMPTY,
        scalars: [0; SCALARS],
    };
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::channels::tests::{cells, level};
    use proptest::prelude::*;

    /// Cuts a patch out of a level of `columns` cells in a row.
    pub(crate) fn cut(cells: &[[u8; CHANNELS]], columns: usize, x: i32, y: i32) -> Patch {
        let ((left, top), part) = corner(x, y);
        let cell = |i: usize, j: usize| {
            let (x, y) = (left + i as i32, top + j as i32);
            let inside = (0..columns as i32).contains(&x) && y >= 0;
            let place = || y as usize * columns + x as usize;
            inside.then(|| cells.get(place())).flatten().copied().unwrap_or_default()
        };
        let mut patch = Patch::EMPTY;
        patch.sum_up(&core::array::from_fn(|j| core::array::from_fn(|i| cell(i, j))), part);
        patch
    }

    proptest! {
        #[test]
        fn sums_are_those_of_interpolated_cells(
            cells in prop::collection::vec(any::<[u8; 8]>(), 19 * 13),
            x in -60..80i32, y in -60..60i32, bx in 0..10usize, by in 0..10usize, w in 0..10usize, h in 0..10usize,
        ) {
            let (width, height) = (19usize, 13usize);
            let patch = cut(&cells, width, x, y);
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
            prop_assert_eq!(i64::from(patch.sum(3, &Region::new((bx as u8, x1 as u8), (by as u8, y1 as u8)))), naive);
        }

        #[test]
        fn patches_of_pictures_are_those_of_their_cells(level in level(), x in -60..100i32, y in -60..80i32) {
            let newest = level.newest();
            let columns = newest.slice.cells().0;
            let all = |second: bool| -> std::vec::Vec<[u8; CHANNELS]> {
                cells(&newest).into_iter().map(|[a, b, c, d, e, f, magnitude, grey, far, near, plain]| {
                    if second { [grey, far, near, plain, 0, 0, 0, 0] } else { [a, b, c, d, e, f, magnitude, near] }
                }).collect()
            };
            let (mut first, mut second) = (Patch::EMPTY, Patch::EMPTY);
            first.cut(&newest.slice, x, y);
            second.cut_newest(&newest, x, y);
            prop_assert_eq!(first.corners, cut(&all(false), columns, x, y).corners);
            prop_assert_eq!(second.corners, cut(&all(true), columns, x, y).corners);
        }
    }
}
