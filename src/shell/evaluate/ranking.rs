//! Detections of all clips ranked by score: the precision-recall curve and what is read off it.
//!
//! Every figure takes how many times each clip counts, so that a resample of clips needs no new ranking.

use std::cmp::Ordering;
use std::vec;
use std::vec::Vec;

/// A detection that counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RankedDetection {
    /// Score; larger is more likely a target.
    pub score: f64,
    /// Whether it found a target.
    pub hit: bool,
    /// Position of the clip in the evaluated list, from 0.
    pub clip: usize,
}

/// Frames and targets of a clip.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ClipCount {
    /// Number of frames that were evaluated.
    pub frames: u64,
    /// Targets that must be found.
    pub targets: usize,
}

/// Point of the precision-recall curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Share of targets found, 0 to 1.
    pub recall: f64,
    /// Share of detections that are right, 0 to 1.
    pub precision: f64,
    /// Detections of this score or more.
    pub score: f64,
    /// False alarms among them.
    pub false_alarms: u64,
}

/// Detections in the order of their scores, highest first; equal ones in the order of clips.
#[derive(Debug, Clone, Default)]
pub struct Ranking {
    clips: Vec<ClipCount>,
    outcomes: Vec<RankedDetection>,
}

/// Read scores are finite; equal ones keep their order.
pub fn surest_first(a: f64, b: f64) -> Ordering {
    b.partial_cmp(&a).unwrap_or(Ordering::Equal)
}

impl Ranking {
    /// Ranks `outcomes`, whose clips are numbers into `clips`.
    pub fn new(clips: Vec<ClipCount>, mut outcomes: Vec<RankedDetection>) -> Self {
        outcomes.sort_by(|a, b| surest_first(a.score, b.score));
        Self { clips, outcomes }
    }

    /// Frames and targets of each clip.
    pub fn clips(&self) -> &[ClipCount] {
        &self.clips
    }

    /// The detections, highest score first.
    pub fn outcomes(&self) -> &[RankedDetection] {
        &self.outcomes
    }

    /// Weights of the clips: each counts once.
    pub fn whole(&self) -> Vec<u32> {
        vec![1; self.clips.len()]
    }

    /// Targets that must be found.
    pub fn targets(&self, times: &[u32]) -> u64 {
        self.clips.iter().zip(times).map(|(clip, &n)| clip.targets as u64 * u64::from(n)).sum()
    }

    fn frames(&self, times: &[u32]) -> u64 {
        self.clips.iter().zip(times).map(|(clip, &n)| clip.frames * u64::from(n)).sum()
    }

    /// The precision-recall curve at each score at which recall grows: elsewhere precision only falls.
    pub fn curve(&self, times: &[u32]) -> Vec<Point> {
        let targets = self.targets(times).max(1) as f64;
        let mut points = Vec::new();
        let (mut right, mut wrong, mut last) = (0u64, 0u64, 0u64);
        for (i, outcome) in self.outcomes.iter().enumerate() {
            let times = u64::from(times[outcome.clip]);
            if outcome.hit {
                right += times;
            } else {
                wrong += times;
            }
            let tied = self.outcomes.get(i + 1).is_some_and(|next| next.score == outcome.score);
            if right > last && !tied {
                last = right;
                points.push(Point {
                    recall: right as f64 / targets,
                    precision: right as f64 / (right + wrong) as f64,
                    score: outcome.score,
                    false_alarms: wrong,
                });
            }
        }
        points
    }

    /// Area under the curve whose precision is the best at that recall or more (AveP), 0 to 1.
    pub fn average_precision(&self, times: &[u32]) -> f64 {
        let mut curve = self.curve(times);
        envelope(&mut curve);
        let mut last = 0.0;
        curve.iter().fold(0.0, |sum, point| {
            let step = point.recall - last;
            last = point.recall;
            sum + step * point.precision
        })
    }

    /// Recall down to the last detection before there are more than `limit` false alarms in 1000 frames.
    pub fn recall_at(&self, times: &[u32], limit: u64) -> f64 {
        let limit = limit * self.frames(times);
        let (mut right, mut wrong) = (0u64, 0u64);
        for outcome in &self.outcomes {
            let times = u64::from(times[outcome.clip]);
            if outcome.hit {
                right += times;
            } else {
                wrong += times;
            }
            if wrong * 1000 > limit {
                break;
            }
        }
        right as f64 / self.targets(times).max(1) as f64
    }

    /// The lowest score from which on there are at most `limit` false alarms in 1000 frames; none if every score has more,
    /// or there is no detection.
    pub fn threshold(&self, limit: u64) -> Option<f64> {
        let limit = limit * self.frames(&self.whole());
        let mut wrong = 0;
        let mut threshold = None;
        for equals in self.outcomes.chunk_by(|a, b| a.score == b.score) {
            wrong += equals.iter().filter(|o| !o.hit).count() as u64;
            if wrong * 1000 > limit {
                break;
            }
            threshold = Some(equals[0].score);
        }
        threshold
    }
}

/// Makes each precision the best at that recall or more.
pub fn envelope(curve: &mut [Point]) {
    for i in (1..curve.len()).rev() {
        curve[i - 1].precision = curve[i - 1].precision.max(curve[i].precision);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Frames, targets, scores and hits.
    type Parts = (u64, usize, Vec<(u8, bool)>);

    fn ranking(clips: &[Parts]) -> Ranking {
        let counts = clips.iter().map(|&(frames, targets, _)| ClipCount { frames, targets });
        let outcomes = clips.iter().enumerate().flat_map(|(clip, (.., outcomes))| {
            outcomes.iter().map(move |&(score, hit)| RankedDetection {
                score: score.into(),
                hit,
                clip,
            })
        });
        Ranking::new(counts.collect(), outcomes.collect())
    }

    proptest! {
        /// The oracle: clips that stand in the list as often as they count.
        #[test]
        fn counting_a_clip_twice_is_having_it_twice(
            clips in prop::collection::vec(
                (0..9u64, prop::collection::vec((0..200u8, any::<bool>()), 0..9), 0u32..4), 1..6),
        ) {
            // Recall at a limit depends on the order of equal scores: there are none.
            let clips: Vec<_> = clips.into_iter().enumerate().map(|(i, (frames, mut outcomes, times))| {
                outcomes.iter_mut().for_each(|o| o.0 = o.0 / 8 * 8 + i as u8);
                outcomes.sort();
                outcomes.dedup_by_key(|o| o.0);
                let targets = outcomes.iter().filter(|o| o.1).count() + 1;
                (times, (frames, targets, outcomes))
            }).collect();
            let once: Vec<_> = clips.iter().map(|c| c.1.clone()).collect();
            let times: Vec<u32> = clips.iter().map(|c| c.0).collect();
            let copies: Vec<_> = clips.iter()
                .flat_map(|c| std::iter::repeat_n(c.1.clone(), c.0 as usize)).collect();
            let (weighted, copied) = (ranking(&once), ranking(&copies));
            let all = copied.whole();
            prop_assert_eq!(weighted.targets(&times), copied.targets(&all));
            prop_assert_eq!(weighted.curve(&times), copied.curve(&all));
            prop_assert_eq!(weighted.average_precision(&times), copied.average_precision(&all));
            for limit in [1, 10, 100, 400] {
                prop_assert_eq!(weighted.recall_at(&times, limit), copied.recall_at(&all, limit));
            }
        }
    }

    #[test]
    fn thresholds_keep_equal_scores_together() {
        let ranking =
            ranking(&[(1000, 9, vec![(9, true), (8, false), (7, true), (7, false), (6, true)])]);
        assert_eq!(ranking.threshold(0), Some(9.0));
        assert_eq!(ranking.threshold(1), Some(8.0));
        assert_eq!(ranking.threshold(2), Some(6.0));
        assert_eq!(ranking.recall_at(&[1], 1), 2.0 / 9.0);
        assert_eq!(Ranking::default().threshold(1), None);
    }
}
