//! Summed-area tables of eight interleaved byte channels (level 1).
//!
//! Entry (x, y) holds, for each channel, the sum of all values left of x and above y, modulo 2^16. Differences of
//! entries are exact while the true sum is below 2^16: a box of up to 257 values of 255. Half the memory of `u32`, and
//! one entry of eight channels is one 128-bit register. Source: Viola & Jones 2001, sec. 2.1.

/// Channels of a table.
pub const CHANNELS: usize = 8;

/// One entry of a table.
pub type Entry = [u16; CHANNELS];

/// Words of a table over `width` x `height` cells.
pub const fn words(width: usize, height: usize) -> usize {
    (width + 1) * (height + 1) * CHANNELS
}

/// A view of a table over `width` x `height` cells.
#[derive(Debug, Clone, Copy)]
pub struct Integral<'a> {
    entries: &'a [Entry],
    width: usize,
    height: usize,
}

impl<'a> Integral<'a> {
    /// Views the first [`words`] of `words` as a table. Panics if there are fewer.
    pub fn new(words: &'a [u16], width: usize, height: usize) -> Self {
        let (entries, _) = words.as_chunks();
        Self { entries: &entries[..(width + 1) * (height + 1)], width, height }
    }

    /// Cells in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows of cells.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The entry at corner (x, y). Outside the table nothing is added, so coordinates are clamped to 0..=width and
    /// 0..=height.
    #[inline]
    pub fn corner(&self, x: i32, y: i32) -> &'a Entry {
        let x = x.clamp(0, self.width as i32) as usize;
        let y = y.clamp(0, self.height as i32) as usize;
        &self.entries[y * (self.width + 1) + x]
    }

    /// Sums of each channel over the cells `x..x + width`, `y..y + height`; what lies outside the table counts as 0.
    /// Exact for boxes of at most 257 cells.
    #[inline]
    pub fn box_sum(&self, x: i32, y: i32, width: i32, height: i32) -> Entry {
        let (a, b) = (self.corner(x, y), self.corner(x + width, y));
        let (c, d) = (self.corner(x, y + height), self.corner(x + width, y + height));
        core::array::from_fn(|i| d[i].wrapping_sub(b[i]).wrapping_sub(c[i]).wrapping_add(a[i]))
    }
}

/// Writes a table row by row.
#[derive(Debug)]
pub struct Builder<'a> {
    entries: &'a mut [Entry],
    width: usize,
    rows: usize,
}

impl<'a> Builder<'a> {
    /// Starts a table over rows of `width` cells in `words`. Panics if not even the first row fits.
    pub fn new(words: &'a mut [u16], width: usize) -> Self {
        let (entries, _) = words.as_chunks_mut();
        entries[..=width].fill([0; CHANNELS]);
        Self { entries, width, rows: 0 }
    }

    /// Appends a row of cells, `cell(x)` giving the values of cell x. Panics if the row does not fit the words.
    #[inline(always)]
    pub fn push_row(&mut self, mut cell: impl FnMut(usize) -> [u8; CHANNELS]) {
        let columns = self.width + 1;
        let (done, rest) = self.entries[self.rows * columns..].split_at_mut(columns);
        let mut sum: Entry = [0; CHANNELS];
        rest[0] = sum;
        for (x, (out, above)) in rest[1..columns].iter_mut().zip(&done[1..]).enumerate() {
            let cell = cell(x);
            for i in 0..CHANNELS {
                sum[i] = sum[i].wrapping_add(u16::from(cell[i]));
                out[i] = above[i].wrapping_add(sum[i]);
            }
        }
        self.rows += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    proptest! {
        #[test]
        fn box_sums_are_exact(
            cells in prop::collection::vec(any::<[u8; 8]>(), 23 * 11),
            x in -20..30i32, y in -20..30i32, w in 0..16i32, h in 0..16i32,
        ) {
            let (width, height) = (23, 11);
            let mut storage = vec![7; words(width, height)];
            let mut builder = Builder::new(&mut storage, width);
            for row in cells.chunks(width) {
                builder.push_row(|x| row[x]);
            }
            let sums = Integral::new(&storage, width, height).box_sum(x, y, w, h);
            let mut naive = [0u32; 8];
            for j in y.max(0)..(y + h).min(height as i32) {
                for i in x.max(0)..(x + w).min(width as i32) {
                    for (sum, v) in naive.iter_mut().zip(cells[j as usize * width + i as usize]) {
                        *sum += u32::from(v);
                    }
                }
            }
            prop_assert_eq!(sums.map(u32::from).to_vec(), naive.to_vec());
        }
    }

    #[test]
    fn the_whole_of_a_small_table() {
        let mut storage: Vec<u16> = vec![0; words(2, 1)];
        Builder::new(&mut storage, 2).push_row(|x| [x as u8 + 1; 8]);
        assert_eq!(Integral::new(&storage, 2, 1).box_sum(0, 0, 2, 1), [3; 8]);
    }
}
