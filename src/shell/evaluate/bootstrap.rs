//! Confidence intervals by the percentile bootstrap over clips (Efron & Tibshirani 1993, chapter 13).
//!
//! Frames of a clip are alike: only clips are drawn anew, with replacement, as many as there are. All figures are taken on
//! the same draws, so that differences between methods are paired.

use crate::shell::evaluate::ranking::Ranking;
use crate::shell::support::parallel;
use crate::shell::support::random::Random;
use serde::Serialize;
use std::vec;
use std::vec::Vec;

/// Number of resamples.
pub const RESAMPLES: usize = 1000;
/// The seed of the draws.
pub const SEED: u64 = 1;
/// Share of the draws that an interval holds.
pub const LEVEL: f64 = 0.95;

/// With targets in fewer clips than this there is no interval: resampling so few is meaningless.
pub const FEWEST_CLIPS: usize = 3;

/// A figure and its confidence interval; none where too few clips have targets.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Interval {
    /// On the clips as they are; none where nothing can be found.
    pub value: Option<f64>,
    /// Lower end of the interval; `None` with too few clips.
    pub low: Option<f64>,
    /// Upper end of the interval; `None` with too few clips.
    pub high: Option<f64>,
}

/// The draws: how many times each clip counts. They are drawn anew for each figure, the same each time: kept, they would
/// take 4 kB a clip.
#[derive(Debug, Clone, Copy)]
pub struct Bootstrap {
    clips: usize,
    resamples: usize,
    seed: u64,
}

impl Bootstrap {
    /// `resamples` draws of `clips` clips each.
    pub const fn new(clips: usize, resamples: usize, seed: u64) -> Self {
        Self { clips, resamples, seed }
    }

    /// Shows `take` every draw.
    fn each(&self, mut take: impl FnMut(&[u32])) {
        let mut random = Random::new(self.seed);
        let mut times = vec![0; self.clips];
        for _ in 0..self.resamples {
            times.fill(0);
            (0..self.clips).for_each(|_| times[random.below(self.clips)] += 1);
            take(&times);
        }
    }

    /// A figure of the clips as they are and of every draw; none where there is no target.
    pub fn sample(
        &self,
        ranking: &Ranking,
        figure: impl Fn(&Ranking, &[u32]) -> f64 + Sync,
    ) -> Sampled {
        let value = |times: &[u32]| (ranking.targets(times) > 0).then(|| figure(ranking, times));
        let with_targets = ranking.clips().iter().filter(|clip| clip.targets > 0).count();
        let mut draws: Vec<Vec<u32>> = Vec::new();
        if with_targets >= FEWEST_CLIPS {
            self.each(|times| draws.push(times.to_vec()));
        }
        let piece = |draws: &[Vec<u32>]| draws.iter().map(|d| value(d)).collect::<Vec<_>>();
        let draws = parallel::map(draws.chunks(32).collect(), piece).concat();
        Sampled { value: value(&ranking.whole()), draws }
    }

    /// The share of right ones among counts of right and wrong by clip; no interval where fewer than [`FEWEST_CLIPS`] have any.
    pub fn share(&self, counts: &[(u64, u64)]) -> Interval {
        let share = |times: &dyn Fn(usize) -> u64| {
            let sum = |(r, w): (u64, u64), (i, c): (usize, &(u64, u64))| {
                (r + c.0 * times(i), w + c.1 * times(i))
            };
            let (right, wrong) = counts.iter().enumerate().fold((0, 0), sum);
            (right + wrong > 0).then(|| right as f64 / (right + wrong) as f64)
        };
        let clips = counts.iter().filter(|(right, wrong)| right + wrong > 0).count();
        let mut draws = Vec::new();
        if clips >= FEWEST_CLIPS {
            self.each(|times| draws.push(share(&|clip| u64::from(times[clip]))));
        }
        Sampled { value: share(&|_| 1), draws }.interval()
    }
}

/// A figure of the clips as they are and of every draw.
#[derive(Debug, Clone, PartialEq)]
pub struct Sampled {
    value: Option<f64>,
    draws: Vec<Option<f64>>,
}

impl Sampled {
    /// The figure with the middle [`LEVEL`] of the draws that have targets.
    pub fn interval(&self) -> Interval {
        let mut sorted: Vec<f64> = self.draws.iter().copied().flatten().collect();
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| {
            sorted.get((sorted.len().saturating_sub(1) as f64 * share).round() as usize).copied()
        };
        let tail = (1.0 - LEVEL) / 2.0;
        Interval { value: self.value, low: at(tail), high: at(1.0 - tail) }
    }

    /// Difference to `other`, resample by resample.
    pub fn less(&self, other: &Self) -> Self {
        let minus = |a: Option<f64>, b: Option<f64>| Some(a? - b?);
        let draws = self.draws.iter().zip(&other.draws).map(|(&a, &b)| minus(a, b)).collect();
        Self { value: minus(self.value, other.value), draws }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shell::evaluate::ranking::{ClipCount, RankedDetection, Ranking};

    /// Clips whose difficulty differs: targets of a clip are found alike.
    fn clips(count: usize, random: &mut Random) -> Ranking {
        let mut outcomes = Vec::new();
        for clip in 0..count {
            let ease = random.symmetric();
            for _ in 0..20 {
                let hit = random.symmetric() < ease;
                let score = random.symmetric() + if hit { 0.7 } else { 0.0 };
                outcomes.push(RankedDetection { score, hit, clip });
            }
        }
        Ranking::new(vec![ClipCount { frames: 20, targets: 20 }; count], outcomes)
    }

    fn interval(ranking: &Ranking, seed: u64) -> Interval {
        let draws = Bootstrap::new(ranking.clips().len(), 200, seed);
        draws.sample(ranking, Ranking::average_precision).interval()
    }

    #[test]
    fn same_seed_same_interval() {
        let ranking = clips(12, &mut Random::new(3));
        let [first, again, other] = [1, 1, 2].map(|seed| interval(&ranking, seed));
        assert_eq!(first, again);
        assert_ne!(first, other);
        assert!(first.low < first.value && first.value < first.high, "{first:?}");
        assert!(first.low > Some(0.0), "{first:?}");
    }

    #[test]
    fn the_truth_is_inside_as_often_as_claimed() {
        let mut random = Random::new(5);
        let truth = clips(20_000, &mut random);
        let truth = truth.average_precision(&truth.whole());
        let trials = 200;
        let inside = (0..trials).filter(|&trial| {
            let interval = interval(&clips(40, &mut random), trial);
            (interval.low.unwrap()..=interval.high.unwrap()).contains(&truth)
        });
        let share = inside.count() as f64 / trials as f64;
        assert!((0.88..=0.99).contains(&share), "{share} of intervals hold the truth");
    }

    #[test]
    fn shares_of_counts() {
        let draws = Bootstrap::new(4, 200, 1);
        let alike = draws.share(&[(9, 1), (9, 1), (9, 1), (9, 1)]);
        assert_eq!(alike, Interval { value: Some(0.9), low: Some(0.9), high: Some(0.9) });
        let mixed = draws.share(&[(10, 0), (10, 0), (0, 10), (10, 0)]);
        assert_eq!(mixed.value, Some(0.75));
        assert!(mixed.low < Some(0.6) && mixed.high == Some(1.0), "{mixed:?}");
        assert_eq!(draws.share(&[(3, 1), (0, 0), (0, 0), (1, 3)]).low, None);
        assert_eq!(draws.share(&[(0, 0); 4]), Interval::default());
    }

    #[test]
    fn too_few_clips_give_no_interval() {
        let ranking = clips(FEWEST_CLIPS - 1, &mut Random::new(3));
        let Interval { value, low, high } = interval(&ranking, 1);
        assert_eq!((value.is_some(), low, high), (true, None, None));
        let nothing = Ranking::new(vec![ClipCount::default(); 9], Vec::new());
        assert_eq!(interval(&nothing, 1), Interval::default());
    }

    #[test]
    fn differences_are_paired() {
        let ranking = clips(20, &mut Random::new(3));
        let draws = Bootstrap::new(20, 200, 1);
        let a = draws.sample(&ranking, |r, t| r.average_precision(t) + 0.125);
        let b = draws.sample(&ranking, Ranking::average_precision);
        let Interval { value, low, high } = a.less(&b).interval();
        for v in [value, low, high] {
            assert!((v.unwrap() - 0.125).abs() < 1e-9, "the same draws differ by the same");
        }
    }
}
