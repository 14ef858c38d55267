//! Features of a st-cube: energies of boxes in it.
//!
//! E(b, R, o), the paper's eq. 2, is the energy of orientation o over a box R of the cube (x, y and t) divided by the
//! energy of all orientations over R (Levi & Weiss 2004). The same box sums against other denominators give the HoG of
//! a patch (a cell against its whole window) and how far a box stands out from its window. Nothing is divided: a ratio
//! is compared with a threshold by cross-multiplication.

use crate::channels::MAGNITUDE;
use crate::channels::window::{SLICES, WINDOW};
use crate::stcube::cube::{PATCH_SCALE, Patch, Region, SCALARS};

/// Fraction bits of a ratio.
pub const RATIO_BITS: u32 = 10;

/// Bytes of an encoded feature.
pub const ENCODED: usize = 8;

/// Denominator of a feature.
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

/// A box of a cube, its channel and denominator. Boxes are half-open, in cells of the window and slices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Feature {
    /// Denominator of the ratio.
    pub denominator: Denominator,
    /// Channel of every frame (0..8), of the newest one (8..16), or number of the scalar.
    pub channel: u8,
    /// Columns `x.0..x.1`.
    pub x: (u8, u8),
    /// Rows `y.0..y.1`.
    pub y: (u8, u8),
    /// Slices `t.0..t.1`, 0 the newest.
    pub t: (u8, u8),
}

impl Feature {
    /// Added to each denominator, for each slice: keeps noise on plain sky from having an orientation.
    pub(super) const FLOOR: u32 = 24 * PATCH_SCALE;

    /// The scalar of that number.
    pub const fn scalar(number: u8) -> Self {
        Self { denominator: Denominator::Scalar, channel: number, x: (0, 1), y: (0, 1), t: (0, 1) }
    }

    /// Reads [`ENCODED`] bytes: denominator, channel, x, y, t. `None` when a box is empty or leaves the cube, or a
    /// channel does not exist (those from 8 on are there for slice 0 only).
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

    /// Numerator and denominator: at most 2^21 each, the denominator at least 1.
    #[inline]
    pub(super) fn ratio(
        &self,
        slices: &[Patch],
        newest: &Patch,
        scalars: &[u16; SCALARS],
    ) -> (u32, u32) {
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
        let own_region = Region::new(self.x, self.y);
        let numerator = sum(from, own_channel, &own_region);
        let denominator = match self.denominator {
            Denominator::SameBox => sum(own, MAGNITUDE, &own_region) + Self::FLOOR * count,
            Denominator::Window => sum(own, MAGNITUDE, &Region::WHOLE) + Self::FLOOR * count,
            Denominator::SameChannel => {
                sum(from, own_channel, &Region::WHOLE) + Self::FLOOR * count
            }
            Denominator::Cells | Denominator::Scalar => self.cells() * count,
        };
        (numerator, denominator)
    }

    /// Cells of the box, in the unit of a sum of quarters.
    #[inline(always)]
    pub(super) fn cells(&self) -> u32 {
        u32::from(self.x.1 - self.x.0) * u32::from(self.y.1 - self.y.0) * (4 * PATCH_SCALE)
    }

    /// Whether a ratio in Q10, rounded down and at most 65535, exceeds `threshold`.
    #[inline(always)]
    pub(super) fn ratio_exceeds((numerator, denominator): (u32, u32), threshold: u16) -> bool {
        threshold != u16::MAX
            && u64::from(numerator) << RATIO_BITS
                >= (u64::from(threshold) + 1) * u64::from(denominator)
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
        Self::ratio_exceeds(self.ratio(slices, newest, scalars), threshold)
    }
}

/// Sum of `channel` over a region of slices.
#[inline(always)]
fn sum(slices: &[Patch], channel: usize, region: &Region) -> u32 {
    match slices {
        // All that a small board has.
        [patch] => patch.sum(channel, region),
        _ => slices.iter().map(|patch| patch.sum(channel, region)).sum(),
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

    /// Feature `number`. Panics if there is no such feature.
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

    /// Whether all are features of the newest slice.
    pub fn of_newest_only(&self) -> bool {
        self.encoded.iter().filter_map(Feature::decode).all(|f| f.t == (0, 1))
    }

    /// Whether all are features of a single patch: slice 0, channels 0..8, no scalars.
    pub fn of_patch_only(&self) -> bool {
        self.encoded
            .iter()
            .filter_map(Feature::decode)
            .all(|f| f.t == (0, 1) && f.channel < 8 && f.denominator != Denominator::Scalar)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stcube::cube::tests::cut;
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    /// Cells of a table, a little larger than a window.
    const SIDE: usize = WINDOW + 3;

    /// A table's cells and where to cut the window out, in quarters of a cell.
    type Cells = (Vec<[u8; 8]>, i32, i32);

    fn cells() -> impl Strategy<Value = Cells> {
        let cells = prop_oneof![
            3 => prop::collection::vec(any::<[u8; 8]>(), SIDE * SIDE),
            1 => prop::collection::vec(any::<[bool; 8]>().prop_map(|c| c.map(|on| 255 * u8::from(on))), SIDE * SIDE),
            1 => Just(vec![[0; 8]; SIDE * SIDE]),
        ];
        (cells, -6..18i32, -6..18i32)
    }

    fn patch((cells, x, y): &Cells) -> Patch {
        cut(cells, SIDE, *x, *y)
    }

    /// Sum of a channel over a box of the window, each of whose cells is a mixture of four of the table.
    fn naive_sum((cells, x, y): &Cells, channel: usize, across: (u8, u8), down: (u8, u8)) -> f64 {
        let value = |i: i32, j: i32| {
            let inside = (0..SIDE as i32).contains(&i) && (0..SIDE as i32).contains(&j);
            if inside { f64::from(cells[j as usize * SIDE + i as usize][channel]) } else { 0.0 }
        };
        let mut sum = 0.0;
        for j in i32::from(down.0)..i32::from(down.1) {
            for i in i32::from(across.0)..i32::from(across.1) {
                let (px, py) = (x + 4 * i, y + 4 * j);
                let (cx, cy) = (px.div_euclid(4), py.div_euclid(4));
                let fx = f64::from(px.rem_euclid(4)) / 4.0;
                let fy = f64::from(py.rem_euclid(4)) / 4.0;
                let row = |j| value(cx, j) * (1.0 - fx) + value(cx + 1, j) * fx;
                sum += row(cy) * (1.0 - fy) + row(cy + 1) * fy;
            }
        }
        sum
    }

    prop_compose! {
        fn feature()(
            denominator in 0..5u8, channel in 0..16u8,
            x0 in 0..10u8, w in 0..10u8, y0 in 0..10u8, h in 0..10u8, t0 in 0..4u8, d in 0..4u8,
        ) -> Feature {
            let (t0, t1) = if channel < 8 { (t0, (t0 + 1 + d).min(4)) } else { (0, 1) };
            let bytes = [denominator, channel, x0, (x0 + 1 + w).min(10), y0, (y0 + 1 + h).min(10), t0, t1];
            Feature::decode(&bytes).unwrap()
        }
    }

    /// The definitions of [`Denominator`] in plain numbers.
    fn naive(f: &Feature, slices: &[Cells], newest: &Cells, scalars: &[u16; SCALARS]) -> f64 {
        let channel = usize::from(f.channel);
        let whole = (0, WINDOW as u8);
        let own = &slices[usize::from(f.t.0)..usize::from(f.t.1)];
        let over = |from: &[Cells], channel: usize, x, y| -> f64 {
            from.iter().map(|cells| naive_sum(cells, channel, x, y)).sum()
        };
        let (from, own_channel) =
            if channel < 8 { (own, channel) } else { (core::slice::from_ref(newest), channel - 8) };
        let floor = 24.0 * own.len() as f64;
        let numbered = |of: f64| {
            let energy = over(from, own_channel, f.x, f.y);
            (1024.0 * energy / of).floor().min(65535.0)
        };
        match f.denominator {
            Denominator::SameBox => numbered(over(own, MAGNITUDE, f.x, f.y) + floor),
            Denominator::Window => numbered(over(own, MAGNITUDE, whole, whole) + floor),
            Denominator::SameChannel => numbered(over(from, own_channel, whole, whole) + floor),
            Denominator::Cells => {
                let cells = f64::from(f.x.1 - f.x.0) * f64::from(f.y.1 - f.y.0);
                numbered(4.0 * cells * own.len() as f64)
            }
            Denominator::Scalar => f64::from(scalars[channel]),
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

        #[test]
        fn values_agree_with_f64(
            features in prop::collection::vec(feature(), 1..12),
            slices in prop::collection::vec(cells(), SLICES), newest in cells(), scalars: [u16; SCALARS],
        ) {
            let patches: Vec<Patch> = slices.iter().map(patch).collect();
            for feature in features {
                let value = feature.value(&patches, &patch(&newest), &scalars);
                prop_assert_eq!(f64::from(value), naive(&feature, &slices, &newest, &scalars), "{:?}", feature);
            }
        }

        #[test]
        fn exceeding_is_a_larger_value(
            feature in feature(), slices in prop::collection::vec(cells(), SLICES), newest in cells(), scalars: [u16; SCALARS],
        ) {
            let patches: Vec<Patch> = slices.iter().map(patch).collect();
            let newest = patch(&newest);
            let value = feature.value(&patches, &newest, &scalars);
            for threshold in 0..=u16::MAX {
                let exceeds = feature.exceeds(&patches, &newest, &scalars, threshold);
                prop_assert_eq!(exceeds, value > threshold, "{} of {:?}", threshold, feature);
            }
        }

        #[test]
        fn what_is_decoded_is_encoded(feature in feature(), place in 0..ENCODED, byte in 0..20u8) {
            let mut bytes = feature.encode();
            prop_assert_eq!(Feature::decode(&bytes), Some(feature));
            prop_assert_eq!(Features::parse(&bytes).unwrap().get(0), feature);
            bytes[place] = byte;
            let [kind, channel, x0, x1, y0, y1, t0, t1] = bytes;
            let good = kind <= 4 && channel < 16 && x0 < x1 && x1 <= 10 && y0 < y1 && y1 <= 10
                && t0 < t1 && t1 <= 4 && (kind == 4 || channel < 8 || t1 == 1);
            let decoded = Feature::decode(&bytes);
            prop_assert_eq!(decoded.map(|f| f.encode()), good.then_some(bytes));
            prop_assert_eq!(Features::parse(&bytes).map(|f| f.get(0)), decoded);
        }
    }
}
