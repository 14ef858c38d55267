//! Confidence intervals by the percentile bootstrap over clips (Efron & Tibshirani 1993, chapter 13).
//!
//! Frames of a clip are alike: only clips are drawn anew, with replacement, as many as there are. All figures are taken on the same
//! draws, so that differences between methods are paired.

use crate::shell::parallel;
use crate::shell::train::random::Random;
use serde::Serialize;
use std::vec;
use std::vec::Vec;

/// How many times clips are drawn anew.
pub const RESAMPLES: usize = 1000;
/// The seed of the draws.
pub const SEED: u64 = 1;
/// Share of the draws that an interval holds.
pub const LEVEL: f64 = 0.95;

/// A figure and its confidence interval; none where there are too few clips.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Interval {
    /// On the clips as they are; none where nothing can be found.
    pub value: Option<f64>,
    /// Lower end.
    pub low: Option<f64>,
    /// Upper end.
    pub high: Option<f64>,
}

/// The draws: how many times each clip counts.
#[derive(Debug, Clone)]
pub struct Bootstrap {
    draws: Vec<Vec<u32>>,
}

impl Bootstrap {
    /// So many draws of `clips` clips.
    pub fn new(clips: usize, resamples: usize, seed: u64) -> Self {
        let mut random = Random::new(seed);
        let mut draw = || {
            let mut times = vec![0; clips];
            (0..clips).for_each(|_| times[random.below(clips)] += 1);
            times
        };
        // One clip drawn again is the same clip: that tells nothing.
        let resamples = if clips < 2 { 0 } else { resamples };
        Self { draws: (0..resamples).map(|_| draw()).collect() }
    }

    /// A figure on every draw; it is none where the draw holds no target.
    pub fn samples(&self, figure: impl Fn(&[u32]) -> Option<f64> + Sync) -> Vec<Option<f64>> {
        let pieces: Vec<&[Vec<u32>]> = self.draws.chunks(32).collect();
        let piece = |draws: &[Vec<u32>]| draws.iter().map(|d| figure(d)).collect::<Vec<_>>();
        parallel::map(pieces, piece).concat()
    }
}

impl Interval {
    /// The figure on the clips as they are, with the middle [`LEVEL`] of the draws.
    pub fn new(value: Option<f64>, samples: &[Option<f64>]) -> Self {
        let mut sorted: Vec<f64> = samples.iter().copied().flatten().collect();
        sorted.sort_by(f64::total_cmp);
        // Half of the draws without a target: nothing is known of the other half.
        if sorted.is_empty() || sorted.len() * 2 < samples.len() || value.is_none() {
            return Self { value, low: None, high: None };
        }
        let at = |share: f64| sorted[((sorted.len() - 1) as f64 * share).round() as usize];
        let tail = (1.0 - LEVEL) / 2.0;
        Self { value, low: Some(at(tail)), high: Some(at(1.0 - tail)) }
    }

    /// How much more one figure is than another on the same draws.
    pub fn difference(a: (Option<f64>, &[Option<f64>]), b: (Option<f64>, &[Option<f64>])) -> Self {
        let minus = |a: Option<f64>, b: Option<f64>| Some(a? - b?);
        let samples: Vec<_> = a.1.iter().zip(b.1).map(|(&a, &b)| minus(a, b)).collect();
        Self::new(minus(a.0, b.0), &samples)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shell::ranking::{ClipCount, Outcome, Ranking};

    /// Clips whose difficulty differs: targets of a clip are found alike.
    fn clips(count: usize, random: &mut Random) -> Ranking {
        let mut outcomes = Vec::new();
        for clip in 0..count {
            let ease = random.symmetric();
            for _ in 0..20 {
                let hit = random.symmetric() < ease;
                let score = random.symmetric() + if hit { 0.7 } else { 0.0 };
                outcomes.push(Outcome { score, hit, clip });
            }
        }
        Ranking::new(vec![ClipCount { frames: 20, targets: 20 }; count], outcomes)
    }

    #[test]
    fn same_seed_same_interval() {
        let ranking = clips(12, &mut Random::new(3));
        let interval = |seed| {
            let draws = Bootstrap::new(12, 200, seed);
            let value = ranking.average_precision(&ranking.whole());
            Interval::new(Some(value), &draws.samples(|t| Some(ranking.average_precision(t))))
        };
        assert_eq!(interval(1), interval(1));
        assert_ne!(interval(1), interval(2));
        let Interval { value, low, high } = interval(1);
        assert!(low < value && value < high && low > Some(0.0), "{:?}", interval(1));
    }

    #[test]
    fn the_truth_is_inside_as_often_as_claimed() {
        let mut random = Random::new(5);
        let average = |r: &Ranking| r.average_precision(&r.whole());
        let truth = average(&clips(20_000, &mut random));
        let trials = 200;
        let inside = (0..trials).filter(|&trial| {
            let ranking = clips(40, &mut random);
            let draws = Bootstrap::new(40, 200, trial);
            let samples = draws.samples(|t| Some(ranking.average_precision(t)));
            let interval = Interval::new(Some(average(&ranking)), &samples);
            (interval.low.unwrap()..=interval.high.unwrap()).contains(&truth)
        });
        let share = inside.count() as f64 / trials as f64;
        assert!((0.88..=0.99).contains(&share), "{share} of intervals hold the truth");
    }

    #[test]
    fn too_little_gives_no_interval() {
        let none = Interval { value: Some(0.5), low: None, high: None };
        assert_eq!(Interval::new(Some(0.5), &Bootstrap::new(1, 9, 1).samples(|_| Some(1.0))), none);
        assert_eq!(Interval::new(Some(0.5), &[None, None, Some(0.1)]), none);
        assert_eq!(Interval::new(None, &[Some(0.1)]).low, None);
        let paired = Interval::difference(
            (Some(0.5), &[Some(0.6), Some(0.4)]),
            (Some(0.4), &[Some(0.5), Some(0.3)]),
        );
        assert!((paired.low.unwrap() - 0.1).abs() < 1e-12);
    }
}
