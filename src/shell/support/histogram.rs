//! Histogram of durations in constant memory.

use std::vec;
use std::vec::Vec;

/// Bins of each doubling: a percentile is at most 1/16 too large.
const FINE_BITS: u32 = 4;
/// Times from here on, about four minutes, are counted as this long, microseconds.
const LONGEST: i64 = 1 << 28;

/// Times in microseconds. Bins are as wide as a sixteenth of their place.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Histogram {
    bins: Vec<u32>,
    count: u64,
    max: i64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self { bins: vec![0; bin(LONGEST) + 1], count: 0, max: 0 }
    }
}

/// Where a time is counted.
fn bin(time_us: i64) -> usize {
    let time = time_us as u64;
    let fine = 1 << FINE_BITS;
    if time < fine {
        return time as usize;
    }
    let octave = time.ilog2() - FINE_BITS;
    ((u64::from(octave) << FINE_BITS) + (time >> octave)) as usize
}

/// The longest time that is counted in a bin.
fn end(bin: usize) -> i64 {
    let fine = 1usize << FINE_BITS;
    if bin < fine {
        return bin as i64;
    }
    let octave = (bin >> FINE_BITS) - 1;
    (((bin - (octave << FINE_BITS) + 1) << octave) - 1) as i64
}

impl Histogram {
    /// Counts a time; below 0 it counts as 0.
    pub fn add(&mut self, time_us: i64) {
        let time = time_us.clamp(0, LONGEST);
        if let Some(bin) = self.bins.get_mut(bin(time)) {
            *bin = bin.saturating_add(1);
        }
        self.count += 1;
        self.max = self.max.max(time);
    }

    /// Number of durations counted.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The time, in microseconds, that `percent` of all did not exceed; at most 1/16 too large. 0 without any.
    pub fn percentile(&self, percent: u32) -> i64 {
        let wanted = (self.count * u64::from(percent)).div_ceil(100).max(1);
        let mut counted = 0;
        for (place, &bin) in self.bins.iter().enumerate() {
            counted += u64::from(bin);
            if counted >= wanted {
                return end(place).min(self.max);
            }
        }
        0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn percentiles_are_those_of_the_sorted_times(
            mut times in prop::collection::vec(prop_oneof![0..3000i64, -9..LONGEST * 2], 1..200),
            percent in 1..=100u32,
        ) {
            let mut histogram = Histogram::default();
            times.iter().for_each(|&time| histogram.add(time));
            times.sort_unstable();
            let rank = (times.len() * percent as usize).div_ceil(100);
            let exact = times[rank - 1].clamp(0, LONGEST);
            let found = histogram.percentile(percent);
            prop_assert!(found >= exact && found <= exact + exact / 16, "{found} for {exact}");
            prop_assert_eq!(histogram.count(), times.len() as u64);
        }
    }

    #[test]
    fn nothing_took_no_time() {
        assert_eq!(Histogram::default().percentile(99), 0);
    }
}
