//! Features of a st-cube: energies of boxes in it (level 4).
//!
//! E(b, R, o), the paper's eq. 2, is the energy of orientation o over a box R of the cube (x, y and t) divided by the
//! energy of all orientations over R (Levi & Weiss 2004). The same box sums against other denominators give the HoG of
//! a patch (a cell against its whole window) and how far a box stands out from its window. Nothing is divided: a ratio
//! is compared with a threshold by cross-multiplication.

use crate::channels::{MAGNITUDE, TEMPORAL};
use crate::cube::{Cube, PATCH_SCALE, Patch, SCALARS, SLICES, WINDOW};

/// Fraction bits of a ratio.
pub const RATIO_BITS: u32 = 10;

/// Added to each denominator, for each slice: keeps noise on plain sky from having an orientation.
const FLOOR: u32 = 24 * PATCH_SCALE;

/// Bytes of an encoded feature.
pub const ENCODED: usize = 8;

/// What a box's sum is divided by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Denominator {
    /// Gradient magnitude over the same box: E(b, R, o) of eq. 2.
    SameBox = 0,
    /// Gradient magnitude over the whole window of the same slices: a HoG with one block.
    Window = 1,
    /// The same channel over the whole window of the same slices.
    SameChannel = 2,
    /// The number of cells: the mean itself, its ratio in Q8 of the channel's unit.
    Cells = 3,
    /// Nothing: a scalar of the cube.
    Scalar = 4,
}

/// A box of a cube, its channel and what to divide by. Boxes are half-open, in cells of the window and slices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Feature {
    /// What the sum is divided by.
    pub denominator: Denominator,
    /// Channel of the first table (0..8), of the second one (8..16), or number of the scalar.
    pub channel: u8,
    /// Columns `x.0..x.1`.
    pub x: (u8, u8),
    /// Rows `y.0..y.1`.
    pub y: (u8, u8),
    /// Slices `t.0..t.1`, 0 the newest.
    pub t: (u8, u8),
}

impl Feature {
    /// The scalar of that number.
    pub const fn scalar(number: u8) -> Self {
        Self { denominator: Denominator::Scalar, channel: number, x: (0, 1), y: (0, 1), t: (0, 1) }
    }

    /// Reads [`ENCODED`] bytes: denominator, channel, x, y, t. `None` when a box is empty or leaves the cube, or a
    /// channel does not exist (the second table is there for slice 0 only).
    pub fn decode(bytes: &[u8; ENCODED]) -> Option<Self> {
        let [denominator, channel, x0, x1, y0, y1, t0, t1] = *bytes;
        let denominator = match denominator {
            0 => Denominator::SameBox,
            1 => Denominator::Window,
            2 => Denominator::SameChannel,
            3 => Denominator::Cells,
            4 => Denominator::Scalar,
            _ => return None,
        };
        let range = |a: u8, b: u8, end: usize| a < b && usize::from(b) <= end;
        let newest = channel >= 8;
        let valid = range(x0, x1, WINDOW)
            && range(y0, y1, WINDOW)
            && range(t0, t1, SLICES)
            && usize::from(channel) < if denominator == Denominator::Scalar { SCALARS } else { 16 }
            && !(newest && denominator != Denominator::Scalar && t1 > 1);
        valid.then_some(Self { denominator, channel, x: (x0, x1), y: (y0, y1), t: (t0, t1) })
    }

    /// The bytes that [`Feature::decode`] reads.
    pub const fn encode(&self) -> [u8; ENCODED] {
        let Self { denominator, channel, x, y, t } = *self;
        [denominator as u8, channel, x.0, x.1, y.0, y.1, t.0, t.1]
    }

    /// Sum of `channel` over this box (or the whole window) of `slices`.
    #[inline]
    fn sum(&self, slices: &[Patch], channel: usize, whole: bool) -> u32 {
        let ((x0, x1), (y0, y1)) = if whole {
            ((0, WINDOW), (0, WINDOW))
        } else {
            let wide = |r: (u8, u8)| (usize::from(r.0), usize::from(r.1));
            (wide(self.x), wide(self.y))
        };
        slices.iter().map(|patch| patch.sum(channel, x0, y0, x1, y1)).sum()
    }

    /// Numerator and denominator: at most 2^21 each, the denominator at least 1.
    #[inline]
    fn ratio(&self, slices: &[Patch], newest: &Patch, scalars: &[u16; SCALARS]) -> (u32, u32) {
        let channel = usize::from(self.channel);
        if self.denominator == Denominator::Scalar {
            return (u32::from(scalars[channel]), 1 << RATIO_BITS);
        }
        let own = &slices[usize::from(self.t.0)..usize::from(self.t.1)];
        let (from, own_channel) = match channel.checked_sub(8) {
            Some(second) => (core::slice::from_ref(newest), second),
            None => (own, channel),
        };
        let count = own.len() as u32;
        let numerator = self.sum(from, own_channel, false);
        let denominator = match self.denominator {
            Denominator::SameBox => self.sum(own, MAGNITUDE, false) + FLOOR * count,
            Denominator::Window => self.sum(own, MAGNITUDE, true) + FLOOR * count,
            Denominator::SameChannel => self.sum(from, own_channel, true) + FLOOR * count,
            Denominator::Cells | Denominator::Scalar => {
                let cells = u32::from(self.x.1 - self.x.0) * u32::from(self.y.1 - self.y.0);
                cells * PATCH_SCALE * count * 4
            }
        };
        (numerator, denominator)
    }

    /// The ratio in Q10, rounded down, at most 65535; a scalar as it is.
    pub fn value(&self, slices: &[Patch], newest: &Patch, scalars: &[u16; SCALARS]) -> u16 {
        let (numerator, denominator) = self.ratio(slices, newest, scalars);
        ((numerator << RATIO_BITS) / denominator).min(u32::from(u16::MAX)) as u16
    }

    /// Whether [`Feature::value`] exceeds `threshold`, without a division.
    #[inline]
    pub fn exceeds(
        &self,
        slices: &[Patch],
        newest: &Patch,
        scalars: &[u16; SCALARS],
        threshold: u16,
    ) -> bool {
        let (numerator, denominator) = self.ratio(slices, newest, scalars);
        threshold != u16::MAX
            && u64::from(numerator) << RATIO_BITS
                >= (u64::from(threshold) + 1) * u64::from(denominator)
    }
}

/// The features that the trees of a model ask for, by number: a checked view of bytes.
#[derive(Debug, Clone, Copy)]
pub struct Features<'m> {
    encoded: &'m [[u8; ENCODED]],
}

impl<'m> Features<'m> {
    /// Views `bytes` as features; `None` when one of them is not valid or bytes are left over.
    pub fn parse(bytes: &'m [u8]) -> Option<Self> {
        let (encoded, rest) = bytes.as_chunks();
        (rest.is_empty() && encoded.iter().all(|bytes| Feature::decode(bytes).is_some()))
            .then_some(Self { encoded })
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.encoded.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.encoded.is_empty()
    }

    /// Feature `number`. Panics if there are not so many.
    #[inline]
    pub fn get(&self, number: u16) -> Feature {
        let [denominator, channel, x0, x1, y0, y1, t0, t1] = self.encoded[usize::from(number)];
        let denominator = match denominator {
            0 => Denominator::SameBox,
            1 => Denominator::Window,
            2 => Denominator::SameChannel,
            3 => Denominator::Cells,
            _ => Denominator::Scalar,
        };
        Feature { denominator, channel, x: (x0, x1), y: (y0, y1), t: (t0, t1) }
    }

    /// Whether feature `number` of `cube` exceeds `threshold`.
    #[inline]
    pub fn exceeds(&self, number: u16, threshold: u16, cube: &Cube) -> bool {
        self.get(number).exceeds(&cube.slices, &cube.newest, &cube.scalars, threshold)
    }

    /// Whether feature `number` of a single patch exceeds `threshold`: for features of slice 0, channels 0..8.
    #[inline]
    pub fn patch_exceeds(&self, number: u16, threshold: u16, patch: &Patch) -> bool {
        self.get(number).exceeds(
            core::slice::from_ref(patch),
            &Patch::EMPTY,
            &[0; SCALARS],
            threshold,
        )
    }

    /// Whether all are features of a single patch: slice 0, channels 0..8, no scalars.
    pub fn of_patch_only(&self) -> bool {
        self.encoded
            .iter()
            .filter_map(Feature::decode)
            .all(|f| f.t == (0, 1) && f.channel < 8 && f.denominator != Denominator::Scalar)
    }
}

/// Channel of the temporal difference, for those who leave it out.
pub const TEMPORAL_CHANNEL: u8 = TEMPORAL as u8;
