//! Sums over runs of a cube's slices: a box of a feature then takes four values, whatever slices it spans. And values of
//! features that were asked for: thousands of trees ask for the same few thousand features.
//!
//! Without the feature `simd` no slices are summed up and no values are kept: small boards have one slice, and no memory
//! for more.

use crate::channels::window::SLICES;
use crate::channels::{CHANNELS, MAGNITUDE};
use crate::stcube::cube::{Corners, Cube, NOTHING, Patch, Region, SCALARS};
use crate::stcube::feature::{Denominator, Feature, Features, RATIO_BITS};
use core::cell::Cell;

/// Runs of more than one slice.
const RUNS: usize = SLICES * (SLICES - 1) / 2;

/// First and last slice of the runs of more than one slice.
const ENDS: [(usize, usize); RUNS] = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)];

/// How many of them are summed up: all or none.
const SUMMED: usize = if cfg!(feature = "simd") { RUNS } else { 0 };

/// Number of the table of a run, by its first slice and by the one behind its last, in three bits each: slices, then runs
/// in the order of [`ENDS`].
static TABLES: [u8; 64] = {
    let mut tables = [0; 64];
    let mut i = 0;
    while i < SLICES {
        tables[i << 3 | (i + 1)] = i as u8;
        i += 1;
    }
    i = 0;
    // Not `<`: on small boards none is summed up, and nothing is less than 0.
    while i != SUMMED {
        let (first, last) = ENDS[i];
        tables[first << 3 | (last + 1)] = (SLICES + i) as u8;
        i += 1;
    }
    tables
};

/// Number of the table of what the newest frame alone has.
const NEWEST: usize = SLICES + SUMMED;

/// Room for the tables: a power of two, so that looking one up needs no check.
const ROOM: usize = (NEWEST + 1).next_power_of_two();

/// Features whose values are kept, those of the lowest numbers: all that a trained model has.
const KEPT: usize = if cfg!(feature = "simd") { 4096 } else { 0 };

/// No value: values are below 2^16.
const UNKNOWN: u32 = u32::MAX;

/// Memory for values of features.
#[derive(Debug)]
pub struct Values([Cell<u32>; KEPT]);

impl Values {
    /// None is known.
    pub const fn empty() -> Self {
        Self([const { Cell::new(UNKNOWN) }; KEPT])
    }

    /// Forgets all.
    fn cleared(&mut self) -> &[Cell<u32>] {
        self.0.fill(Cell::new(UNKNOWN));
        &self.0
    }
}

/// Memory for the sums of a cube, and for values of its features.
#[derive(Debug)]
pub struct Spans {
    sums: [Corners; SUMMED],
    values: Values,
}

/// A cube of which many features of one table are asked.
#[derive(Debug)]
pub struct Ready<'a> {
    features: &'a Features<'a>,
    /// Values of the first features, or [`UNKNOWN`].
    values: &'a [Cell<u32>],
    slices: &'a [Patch],
    newest: &'a Patch,
    scalars: &'a [u16; SCALARS],
    /// Summed-area tables of each slice, of each run that is summed up, and of the newest frame.
    tables: [&'a Corners; ROOM],
    /// Their sums over the whole window.
    whole: [[u32; CHANNELS]; ROOM],
}

impl Spans {
    /// Sums of no cube.
    pub const fn empty() -> Self {
        Self { sums: [NOTHING; SUMMED], values: Values::empty() }
    }

    /// Computes the sums of `cube`, of which `features` will be asked.
    pub fn ready<'a>(&'a mut self, cube: &'a Cube, features: &'a Features<'a>) -> Ready<'a> {
        #[cfg(feature = "simd")]
        {
            // In the order of [`ENDS`]; the longer runs are shorter ones and a slice.
            let [a, b, c, d] = cube.slices.each_ref().map(|patch| &patch.corners);
            let [ab, abc, abcd, bc, bcd, cd] = &mut self.sums;
            add(a, b, ab);
            add(ab, c, abc);
            add(abc, d, abcd);
            add(b, c, bc);
            add(bc, d, bcd);
            add(c, d, cd);
        }
        let mut tables = [&cube.newest.corners; ROOM];
        for (table, patch) in tables.iter_mut().zip(&cube.slices) {
            *table = &patch.corners;
        }
        for (table, sum) in tables[SLICES..].iter_mut().zip(&self.sums) {
            *table = sum;
        }
        let mut sums = [[0; CHANNELS]; ROOM];
        for (sums, table) in sums.iter_mut().zip(&tables[..=NEWEST]) {
            *sums = whole(table);
        }
        let Cube { slices, newest, scalars } = cube;
        let values = self.values.cleared();
        Ready { features, values, slices, newest, scalars, tables, whole: sums }
    }
}

/// Sums over the whole window.
fn whole(table: &Corners) -> [u32; CHANNELS] {
    core::array::from_fn(|channel| Region::WHOLE.sum(table, channel))
}

/// The sum of two tables.
#[cfg(feature = "simd")]
#[multiversion::multiversion(targets("x86_64+avx2", "x86_64+sse4.1"))]
fn add(first: &Corners, second: &Corners, sum: &mut Corners) {
    let values = first.as_flattened().iter().zip(second.as_flattened());
    for (sum, (a, b)) in sum.as_flattened_mut().iter_mut().zip(values) {
        *sum = a + b;
    }
}

impl<'a> Ready<'a> {
    /// The newest slice, what the newest frame alone has, and scalars. Features of older slices are not there: they may
    /// panic.
    pub fn of_newest(
        slice: &'a Patch,
        newest: &'a Patch,
        scalars: &'a [u16; SCALARS],
        features: &'a Features<'a>,
        values: &'a mut Values,
    ) -> Self {
        let (mut tables, mut sums) = ([&newest.corners; ROOM], [[0; CHANNELS]; ROOM]);
        tables[0] = &slice.corners;
        (sums[0], sums[NEWEST]) = (whole(&slice.corners), whole(&newest.corners));
        let slices = core::slice::from_ref(slice);
        Self { features, values: values.cleared(), slices, newest, scalars, tables, whole: sums }
    }

    /// Whether feature `number` of the cube exceeds `threshold`. Panics if there is no such feature.
    #[inline(always)]
    pub fn exceeds(&self, number: u16, threshold: u16) -> bool {
        let Some(kept) = self.values.get(usize::from(number)) else {
            return self.feature_exceeds(&self.features.get(number), threshold);
        };
        let mut value = kept.get();
        if value == UNKNOWN {
            value = self.value(number);
            kept.set(value);
        }
        value > u32::from(threshold)
    }

    /// [`Feature::value`] of the cube. Not inlined: most values are known, and the loop over trees stays short.
    #[inline(never)]
    fn value(&self, number: u16) -> u32 {
        let feature = &self.features.get(number);
        if feature.denominator == Denominator::Scalar {
            return self.scalar(feature).into();
        }
        let (numerator, denominator) = self.ratio(feature);
        ((numerator << RATIO_BITS) / denominator.max(1)).min(u32::from(u16::MAX))
    }

    /// [`Feature::exceeds`] of the cube. A call of its own would be a fifth of its instructions.
    #[inline(always)]
    fn feature_exceeds(&self, feature: &Feature, threshold: u16) -> bool {
        if feature.denominator == Denominator::Scalar {
            return self.scalar(feature) > threshold;
        }
        Feature::ratio_exceeds(self.ratio(feature), threshold)
    }

    /// The scalar that a feature is.
    #[inline(always)]
    fn scalar(&self, feature: &Feature) -> u16 {
        self.scalars[usize::from(feature.channel) % SCALARS]
    }

    /// Numerator and denominator of a feature that is no scalar.
    #[inline(always)]
    fn ratio(&self, feature: &Feature) -> (u32, u32) {
        let channel = usize::from(feature.channel);
        if SUMMED < RUNS && feature.t.1.wrapping_sub(feature.t.0) != 1 {
            return feature.ratio(self.slices, self.newest, self.scalars);
        }
        let run = usize::from(feature.t.0 << 3 | feature.t.1);
        let own = usize::from(TABLES[run % 64]) % ROOM;
        let count = u32::from(feature.t.1.wrapping_sub(feature.t.0));
        let from = if channel < CHANNELS { own } else { NEWEST };
        let region = Region::new(feature.x, feature.y);
        let numerator = region.sum(self.tables[from], channel % CHANNELS);
        let over = |energy: u32| energy + Feature::FLOOR * count;
        let denominator = match feature.denominator {
            Denominator::SameBox => over(region.sum(self.tables[own], MAGNITUDE)),
            Denominator::Window => over(self.whole[own][MAGNITUDE]),
            Denominator::SameChannel => over(self.whole[from][channel % CHANNELS]),
            Denominator::Cells | Denominator::Scalar => feature.cells() * count,
        };
        (numerator, denominator)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::channels::Square;
    use crate::stcube::feature::ENCODED;
    use proptest::prelude::*;
    use std::vec::Vec;

    proptest! {
        #[test]
        fn spans_exceed_as_slices_do(
            seed: u32, few: bool, scalars: [u16; SCALARS], thresholds in prop::collection::vec(any::<u16>(), 40),
            bytes in prop::collection::vec(prop::array::uniform8(0..11u8), 40..400),
        ) {
            let mut cube = Cube::EMPTY;
            let fill = |k: usize| -> Square<11> {
                let value = |n: usize| (((n * 8 + k) as u32 ^ seed).wrapping_mul(2_654_435_761) >> 24) as u8;
                core::array::from_fn(|j| core::array::from_fn(|i| core::array::from_fn(|c| {
                    value((j * 11 + i) * 8 + c) / if few { 100 } else { 1 }
                })))
            };
            for (k, patch) in cube.slices.iter_mut().chain([&mut cube.newest]).enumerate() {
                patch.fill(&fill(k));
            }
            cube.scalars = scalars;
            let encoded: Vec<[u8; ENCODED]> = bytes
                .into_iter()
                .map(|[kind, channel, x0, x1, y0, y1, t0, t1]| {
                    [kind % 5, channel + (x0 % 2) * 5, x0, x1, y0, y1, t0 % 4, t1 % 5]
                })
                .filter(|encoded| Feature::decode(encoded).is_some())
                .collect();
            let features = Features::parse(encoded.as_flattened()).unwrap();
            let (mut spans, mut values) = (Spans::empty(), Values::empty());
            let ready = spans.ready(&cube, &features);
            let (slice, scalars) = (&cube.slices[0], &cube.scalars);
            let newest = Ready::of_newest(slice, &cube.newest, scalars, &features, &mut values);
            for number in 0..features.len() as u16 {
                let feature = features.get(number);
                let value = feature.value(&cube.slices, &cube.newest, &cube.scalars);
                let around = [value.saturating_sub(1), value, value.saturating_add(1), 0, u16::MAX];
                for threshold in thresholds.iter().copied().chain(around) {
                    let want = feature.exceeds(&cube.slices, &cube.newest, &cube.scalars, threshold);
                    // The value is computed at the first question and kept for the others.
                    prop_assert_eq!(ready.exceeds(number, threshold), want, "{:?} {}", feature, threshold);
                    prop_assert_eq!(ready.feature_exceeds(&feature, threshold), want, "{:?} {}", feature, threshold);
                    if feature.t == (0, 1) {
                        prop_assert_eq!(newest.exceeds(number, threshold), want, "{:?} {}", feature, threshold);
                    }
                }
            }
        }
    }
}
