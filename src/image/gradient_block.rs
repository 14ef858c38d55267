//! Gradient energies of many cells at once, for processors with vector instructions; the values are those of
//! [`CellPixels`].
//!
//! Pixels come as words of two neighbours, of which a cell has two in each row: {left of the cell, first} and {second,
//! right of the cell}. One value of every cell lies side by side, so that the loops below become vector instructions.

use super::Image;
use super::gradient::{CELL, CellPixels, CellRow, ORIENTATIONS, THIRDS};
use crate::math::slices;

/// Cells of a row that are taken at a time.
const BLOCK: usize = 64;

/// Planes of a block: energies by orientation, magnitude, mean grey level.
pub const PLANES: usize = ORIENTATIONS + 2;

/// Words of the cells of a block in one row of pixels.
type Words<'a, const N: usize> = [&'a [u16; N]; 2];

/// Gradients at one of the four pixels of each cell.
struct Gradients<const N: usize> {
    magnitude: [u16; N],
    /// Bins of 256 from the first orientation, at most 6 of them.
    position: [u16; N],
}

impl<const N: usize> Gradients<N> {
    /// From the pixels to the right, to the left, below and above.
    #[inline(always)]
    fn new<const ORIENTED: bool>(
        right: impl Fn(usize) -> u16,
        left: impl Fn(usize) -> u16,
        below: impl Fn(usize) -> u16,
        above: impl Fn(usize) -> u16,
    ) -> Self {
        let mut gradients = Self { magnitude: [0; N], position: [0; N] };
        let (mut down, mut both, mut turned) = ([0u16; N], [0u16; N], [0u16; N]);
        for i in 0..N {
            let (ax, ay) = (right(i).abs_diff(left(i)), below(i).abs_diff(above(i)));
            let (long, short) = (ax.max(ay), ax.min(ay));
            gradients.magnitude[i] = long.max((long * 29 + short * 16) >> 5);
            down[i] = ay;
            both[i] = ax + ay;
            let signs = right(i).wrapping_sub(left(i)) ^ below(i).wrapping_sub(above(i));
            turned[i] = if signs.cast_signed() < 0 { u16::MAX } else { 0 };
        }
        if ORIENTED {
            for i in 0..N {
                let third = THIRDS[usize::from(both[i]) & 511];
                gradients.position[i] = ((u32::from(down[i]) * third) >> 8) as u16;
            }
            for (position, turned) in gradients.position.iter_mut().zip(&turned) {
                // 6 * 256 - angle where the signs differ.
                *position = (*position ^ turned).wrapping_add((6 * 256 + 1) & turned);
            }
        }
        gradients
    }
}

/// Half of a sum, rounded, at most 255.
#[inline(always)]
fn half(sum: u16) -> u8 {
    ((sum + 1) >> 1).min(255) as u8
}

/// The pixel left of each cell.
#[inline(always)]
fn left<'a, const N: usize>([words, _]: Words<'a, N>) -> impl Fn(usize) -> u16 + 'a {
    move |i| words[i] & 255
}

/// The first pixel of each cell.
#[inline(always)]
fn first<'a, const N: usize>([words, _]: Words<'a, N>) -> impl Fn(usize) -> u16 + 'a {
    move |i| words[i] >> 8
}

/// The second pixel of each cell.
#[inline(always)]
fn second<'a, const N: usize>([_, words]: Words<'a, N>) -> impl Fn(usize) -> u16 + 'a {
    move |i| words[i] & 255
}

/// The pixel right of each cell.
#[inline(always)]
fn right<'a, const N: usize>([_, words]: Words<'a, N>) -> impl Fn(usize) -> u16 + 'a {
    move |i| words[i] >> 8
}

/// Energies of cells from the words of the rows of pixels above them, of their own and below; planes of orientations stay
/// as they are unless `ORIENTED`.
#[inline(always)]
pub fn energies<const N: usize, const ORIENTED: bool>(
    [above, upper, lower, below]: [Words<'_, N>; 4],
    out: &mut [[u8; N]; PLANES],
) {
    let gradients: [Gradients<N>; CELL * CELL] = [
        Gradients::new::<ORIENTED>(second(upper), left(upper), first(lower), first(above)),
        Gradients::new::<ORIENTED>(right(upper), first(upper), second(lower), second(above)),
        Gradients::new::<ORIENTED>(second(lower), left(lower), first(below), first(upper)),
        Gradients::new::<ORIENTED>(right(lower), first(lower), second(below), second(upper)),
    ];
    let [a, b, c, d, e, f, magnitude, grey] = out;
    for i in 0..N {
        magnitude[i] = half(gradients.iter().map(|g| g.magnitude[i]).sum());
        let sum = first(upper)(i) + second(upper)(i) + first(lower)(i) + second(lower)(i);
        grey[i] = ((sum + 2) >> 2) as u8;
    }
    if !ORIENTED {
        return;
    }
    for i in 0..N {
        let mut bins = [0u16; ORIENTATIONS];
        for Gradients { magnitude, position } in &gradients {
            let (magnitude, position) = (magnitude[i], position[i]);
            let bin = position >> 8;
            // The magnitude is below 2^9, so that both factors and what counts of the product have 16 bits.
            let second = (u32::from(magnitude << 4) * u32::from((position & 255) << 4)) >> 16;
            let second = second as u16;
            let first = magnitude - second;
            let of = |is: bool, value: u16| if is { value } else { 0 };
            // Behind the last bin is the first one again.
            bins[0] += of(bin == 0, first) + of(bin == 6, first) + of(bin == 5, second);
            for (k, sum) in (1..).zip(&mut bins[1..]) {
                *sum += of(bin == k, first) + of(bin + 1 == k, second);
            }
        }
        let [b0, b1, b2, b3, b4, b5] = bins;
        (a[i], b[i], c[i]) = (half(b0), half(b1), half(b2));
        (d[i], e[i], f[i]) = (half(b3), half(b4), half(b5));
    }
}

/// Words of the first `cells` cells from cell `first` on in a row of pixels: word i + 1 is the second one of cell i and the
/// first one of the next. Beyond the row its edge pixels repeat.
#[inline(always)]
fn words(row: &[u8], first: usize, cells: usize) -> [u16; BLOCK + 1] {
    let mut words = [0; BLOCK + 1];
    let (left, right) = (CELL * first, CELL * (first + cells));
    let word = |before: usize, behind: usize| {
        u16::from_le_bytes([row[before], row[behind.min(row.len() - 1)]])
    };
    words[0] = word(left.saturating_sub(1), left);
    words[cells] = word(right - 1, right);
    let (between, _) = row[left + 1..right - 1].as_chunks::<2>();
    for (word, pair) in words[1..cells].iter_mut().zip(between) {
        *word = u16::from_le_bytes(*pair);
    }
    words
}

impl CellRow<'_> {
    /// Planes of the first `columns` cells, one after the other: the energies as
    /// [`CellPixels::energies`] gives them, the orientations as they were unless
    /// `oriented`, then the mean grey level. Panics if there are fewer cells, or fewer bytes than [`PLANES`] times `columns`.
    pub fn fill(&self, columns: usize, oriented: bool, planes: &mut [u8]) {
        if !cfg!(feature = "simd") {
            self.fill_by_cells(columns, oriented, planes);
        } else if oriented {
            fill_oriented(self, columns, planes);
        } else {
            fill_plain(self, columns, planes);
        }
    }

    /// As [`CellRow::fill`], cell by cell: for processors without vector instructions.
    fn fill_by_cells(&self, columns: usize, oriented: bool, planes: &mut [u8]) {
        let (orientations, rest) = slices::split_mut(planes, ORIENTATIONS * columns);
        let (magnitudes, greys) = slices::split_mut(rest, columns);
        if !oriented {
            return self.fill_plain_by_cells(magnitudes, slices::part_mut(greys, 0, columns));
        }
        for (x, (magnitude, grey)) in
            magnitudes.iter_mut().zip(slices::part_mut(greys, 0, columns)).enumerate()
        {
            let cell = self.cell(x);
            *grey = cell.grey();
            let [energies @ .., all] = cell.energies();
            *magnitude = all;
            for (plane, energy) in slices::rows_mut(orientations, columns).zip(energies) {
                plane[x] = energy;
            }
        }
    }

    /// Magnitudes and mean grey levels alone. Each pixel is loaded once.
    fn fill_plain_by_cells(&self, magnitudes: &mut [u8], greys: &mut [u8]) {
        fn pairs(row: &[u8]) -> &[[u8; CELL]] {
            row.as_chunks().0
        }
        let [upper, lower] = self.rows.map(pairs);
        let (above, below) = (pairs(self.above), pairs(self.below));
        let Some((&[first, _], &[second, _])) = upper.first().zip(lower.first()) else { return };
        // Left of the picture its first pixels repeat.
        let mut left = [i32::from(first), i32::from(second)];
        let behind = upper.iter().skip(1).zip(lower.iter().skip(1));
        let rows = upper.iter().zip(lower).zip(behind).zip(above).zip(below);
        for ((magnitude, grey), ((((a, b), (c, d)), above), below)) in
            magnitudes.iter_mut().zip(greys.iter_mut()).zip(rows)
        {
            let rows = [(left[0], *a, c[0]), (left[1], *b, d[0])];
            let rows = rows.map(|(left, [a, b], right)| [left, a.into(), b.into(), right.into()]);
            let cell =
                CellPixels { above: above.map(i32::from), rows, below: below.map(i32::from) };
            (*magnitude, *grey) = (cell.magnitude(), cell.grey());
            left = rows.map(|[_, _, second, _]| second);
        }
        // The last one, right of which there may be no pixel.
        let last = magnitudes.len() - 1;
        let cell = self.cell(last);
        (magnitudes[last], greys[last]) = (cell.magnitude(), cell.grey());
    }

    #[inline(always)]
    fn fill_blocks<const ORIENTED: bool>(&self, columns: usize, planes: &mut [u8]) {
        for first in (0..columns).step_by(BLOCK) {
            let cells = BLOCK.min(columns - first);
            // Written out: a closure of `map` would not be compiled for the instructions of this function.
            let (above, below) = (words(self.above, first, cells), words(self.below, first, cells));
            let [upper, lower] = self.rows;
            let (upper, lower) = (words(upper, first, cells), words(lower, first, cells));
            let rows =
                [cell_words(&above), cell_words(&upper), cell_words(&lower), cell_words(&below)];
            let mut out = [[0; BLOCK]; PLANES];
            energies::<BLOCK, ORIENTED>(rows, &mut out);
            let left_out = if ORIENTED { 0 } else { ORIENTATIONS };
            for (plane, out) in slices::rows_mut(planes, columns).zip(&out).skip(left_out) {
                let plane = &mut plane[first..first + cells];
                match plane.first_chunk_mut() {
                    Some(plane) => *plane = *out,
                    None => plane.copy_from_slice(&out[..cells]),
                }
            }
        }
    }
}

/// The words of each cell.
#[inline(always)]
fn cell_words(words: &[u16; BLOCK + 1]) -> Words<'_, BLOCK> {
    const NONE: &[u16; BLOCK] = &[0; BLOCK];
    [words.first_chunk().unwrap_or(NONE), words.last_chunk().unwrap_or(NONE)]
}

#[cfg_attr(feature = "simd", multiversion::multiversion(targets("x86_64+avx2", "x86_64+sse4.1")))]
fn fill_oriented(row: &CellRow<'_>, columns: usize, planes: &mut [u8]) {
    row.fill_blocks::<true>(columns, planes);
}

#[cfg_attr(feature = "simd", multiversion::multiversion(targets("x86_64+avx2", "x86_64+sse4.1")))]
fn fill_plain(row: &CellRow<'_>, columns: usize, planes: &mut [u8]) {
    row.fill_blocks::<false>(columns, planes);
}

/// Cells along a side of a [`square`].
pub const SIDE: usize = 11;

/// Room for the cells of a square.
const ROOM: usize = 128;

/// Words of a row of pixels of a square.
type SquareRow = [u16; SIDE + 1];

/// Planes of the cells of a square, row by row.
pub type SquarePlanes = [[u8; ROOM]; PLANES];

/// Pixels `left` to `left + 2 * N` of row `y`; beyond the picture its edge pixels repeat. The picture must not be empty.
#[inline(always)]
pub fn pairs<const N: usize>(image: &Image<'_>, left: i32, y: i32) -> [u16; N] {
    let last = |length: usize| length as i32 - 1;
    let row = image.row(y.clamp(0, last(image.height())) as usize);
    let whole = usize::try_from(left).ok().and_then(|left| row.get(left..));
    match whole.and_then(|row| row.as_chunks::<2>().0.first_chunk::<N>()) {
        Some(pairs) => {
            let mut words = [0; N];
            for (word, pair) in words.iter_mut().zip(pairs) {
                *word = u16::from_le_bytes(*pair);
            }
            words
        }
        None => core::array::from_fn(|i| {
            let at = |x: i32| row[x.clamp(0, last(row.len())) as usize];
            let x = left.saturating_add(2 * i as i32);
            u16::from_le_bytes([at(x), at(x.saturating_add(1))])
        }),
    }
}

/// Energies of the cells of a square whose upper left one is at (x, y), those outside the picture as if its edge went on.
/// The picture must not be empty, and x and y not farther than 2^28 from it.
#[inline(always)]
pub fn square(image: &Image<'_>, x: i32, y: i32) -> SquarePlanes {
    const ROWS: usize = SIDE * CELL + 2;
    let (left, top) = (CELL as i32 * x - 1, CELL as i32 * y - 1);
    let mut rows: [SquareRow; ROWS] = [[0; SIDE + 1]; ROWS];
    for (row, y) in rows.iter_mut().zip(top..) {
        *row = pairs(image, left, y);
    }
    let mut words = [[[0u16; ROOM]; 2]; 4];
    for j in 0..SIDE {
        for (words, row) in words.iter_mut().zip(&rows[CELL * j..CELL * j + 4]) {
            let [first, second] = words;
            first[j * SIDE..(j + 1) * SIDE].copy_from_slice(&row[..SIDE]);
            second[j * SIDE..(j + 1) * SIDE].copy_from_slice(&row[1..]);
        }
    }
    let mut out = [[0; ROOM]; PLANES];
    let [[a, b], [c, d], [e, f], [g, h]] = &words;
    energies::<ROOM, true>([[a, b], [c, d], [e, f], [g, h]], &mut out);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    proptest! {
        #[test]
        fn rows_are_their_cells(
            width in 2..300usize, height in 2..7usize, few: bool, oriented: bool, seed in prop::collection::vec(any::<u8>(), 997),
        ) {
            let pixel = |i: usize| if few { seed[i / 3 % 997] / 120 } else { seed[i % 997] };
            let pixels: Vec<u8> = (0..width * height).map(pixel).collect();
            let image = Image::packed(&pixels, width, height).unwrap();
            let columns = width / CELL;
            for y in 0..height / CELL {
                let row = CellRow::new(&image, y);
                let mut planes = vec![9; PLANES * columns];
                row.fill(columns, oriented, &mut planes);
                let mut by_cells = vec![9; PLANES * columns];
                row.fill_by_cells(columns, oriented, &mut by_cells);
                prop_assert_eq!(&planes, &by_cells);
                let mut quarters = vec![9; columns];
                row.fill_quarters(&mut quarters);
                for x in 0..columns {
                    let cell = row.cell(x);
                    let mut energies = cell.energies();
                    if !oriented {
                        energies[..ORIENTATIONS].fill(9);
                    }
                    prop_assert_eq!(energies[ORIENTATIONS], cell.magnitude());
                    for (channel, energy) in energies.into_iter().chain([cell.grey()]).enumerate() {
                        prop_assert_eq!(planes[channel * columns + x], energy, "{} {} {}", channel, x, y);
                    }
                    prop_assert_eq!(u32::from(quarters[x]), row.sum(x).min(255));
                }
            }
        }
    }
}
