//! Sums over runs of a cube's slices: a box of a feature then takes four values, whatever slices it spans.
//!
//! Without the feature `simd` no slices are summed up: small boards have one slice, and no memory for more.

use crate::channels::window::SLICES;
use crate::channels::{CHANNELS, MAGNITUDE};
use crate::stcube::cube::{Corners, Cube, NOTHING, Patch, Region, SCALARS};
use crate::stcube::feature::{Denominator, Feature, Features};

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

/// Memory for the sums of a cube.
#[derive(Debug)]
pub struct Spans {
    sums: [Corners; SUMMED],
}

/// A cube of which many features are asked.
#[derive(Debug)]
pub struct Ready<'a> {
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
    pub const EMPTY: Self = Self { sums: [NOTHING; SUMMED] };

    /// Computes the sums of `cube`.
    pub fn ready<'a>(&'a mut self, cube: &'a Cube) -> Ready<'a> {
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
        Ready { slices, newest, scalars, tables, whole: sums }
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
    pub fn of_newest(slice: &'a Patch, newest: &'a Patch, scalars: &'a [u16; SCALARS]) -> Self {
        let (mut tables, mut sums) = ([&newest.corners; ROOM], [[0; CHANNELS]; ROOM]);
        tables[0] = &slice.corners;
        (sums[0], sums[NEWEST]) = (whole(&slice.corners), whole(&newest.corners));
        Self { slices: core::slice::from_ref(slice), newest, scalars, tables, whole: sums }
    }

    /// Whether feature `number` of the cube exceeds `threshold`.
    #[inline]
    pub fn exceeds(&self, features: &Features<'_>, number: u16, threshold: u16) -> bool {
        self.feature_exceeds(&features.get(number), threshold)
    }

    /// [`Feature::exceeds`] of the cube. A call of its own would be a fifth of its instructions.
    #[inline(always)]
    fn feature_exceeds(&self, feature: &Feature, threshold: u16) -> bool {
        let channel = usize::from(feature.channel);
        if feature.denominator == Denominator::Scalar {
            return self.scalars[channel % SCALARS] > threshold;
        }
        if SUMMED < RUNS && feature.t.1.wrapping_sub(feature.t.0) != 1 {
            return feature.exceeds(self.slices, self.newest, self.scalars, threshold);
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
        Feature::ratio_exceeds((numerator, denominator), threshold)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::channels::Square;
    use crate::stcube::feature::ENCODED;
    use proptest::prelude::*;

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
            let mut spans = Spans::EMPTY;
            let ready = spans.ready(&cube);
            for bytes in bytes {
                let [kind, channel, x0, x1, y0, y1, t0, t1] = bytes;
                let encoded: [u8; ENCODED] = [kind % 5, channel + (x0 % 2) * 5, x0, x1, y0, y1, t0 % 4, t1 % 5];
                let Some(feature) = Feature::decode(&encoded) else { continue };
                let value = feature.value(&cube.slices, &cube.newest, &cube.scalars);
                let around = [value.saturating_sub(1), value, value.saturating_add(1), 0, u16::MAX];
                for threshold in thresholds.iter().copied().chain(around) {
                    let want = feature.exceeds(&cube.slices, &cube.newest, &cube.scalars, threshold);
                    prop_assert_eq!(ready.feature_exceeds(&feature, threshold), want, "{:?} {}", feature, threshold);
                    if feature.t == (0, 1) {
                        let newest = Ready::of_newest(&cube.slices[0], &cube.newest, &cube.scalars);
                        prop_assert_eq!(newest.feature_exceeds(&feature, threshold), want, "{:?} {}", feature, threshold);
                    }
                }
            }
        }
    }
}
