//! What scores are worth: the whole detector on the clips held back, its detections counted.
//!
//! Precision must not fall as scores rise, so adjacent violators are pooled (Ayer et al. 1955) in the rate of right
//! detections by score. At the ends of the pools, the corners of the ROC curve's convex hull (Fawcett &
//! Niculescu-Mizil 2007), the share of right ones among all detections down to there is as measured, and rises.

use super::footage;
use crate::model::Model;
use crate::model::calibration::{Knot, MAX_KNOTS, ONE};
use crate::shell::error::Error;
use crate::shell::evaluate::matching::{self, Found, Verdict, WARMUP};
use crate::shell::formats::clips::{self, Clip};
use crate::shell::formats::detections::{self, SCORE_BITS};
use crate::shell::pipeline::on_clips;
use crate::shell::pipeline::scaled::FrameSize;
use crate::shell::pipeline::{self, DetectorArgs};
use crate::shell::sources;
use std::format;
use std::path::PathBuf;
use std::string::String;
use std::vec;
use std::vec::Vec;

/// Intersection over union with a target from which a detection is right.
const IOU: f64 = 0.3;

/// Detections of one score; weights.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Pool {
    /// The lowest score in it, Q16.
    score: i32,
    right: f64,
    wrong: f64,
}

impl Pool {
    fn precision(&self) -> f64 {
        self.right / (self.right + self.wrong)
    }

    fn add(&mut self, lower: &Self) {
        self.score = lower.score;
        self.right += lower.right;
        self.wrong += lower.wrong;
    }
}

/// Runs the detector on every `hold_back`th clip of each folder, its frames scaled to `frame`, and counts; folders weigh the same. No knots where
/// no clip is held back; none after Ctrl-C.
///
/// # Errors
/// [`Error`] of the first clip that cannot be read.
pub fn measure(
    folders: &[PathBuf],
    hold_back: usize,
    frame: Option<FrameSize>,
    model: &Model<'_>,
) -> Result<Option<Vec<Knot>>, Error> {
    let (mut all, mut folder_of) = (Vec::new(), Vec::new());
    for (number, folder) in folders.iter().enumerate() {
        for (place, clip) in clips::clips(folder)?.into_iter().enumerate() {
            if footage::is_held_back(place, hold_back) {
                all.push(clip);
                folder_of.push(number);
            }
        }
    }
    if all.is_empty() {
        return Ok(Some(Vec::new()));
    }
    let Some(counted) = on_clips::<_, Error>(&all, 0, &|_, clip| count(clip, frame, model))? else {
        return Ok(None);
    };
    let mut frames = vec![0; folders.len()];
    counted.iter().zip(&folder_of).for_each(|((n, _), &folder)| frames[folder] += n);
    let pools = counted.iter().zip(&folder_of).flat_map(|((_, outcomes), &folder)| {
        let weight = 1.0 / frames[folder].max(1) as f64;
        outcomes.iter().map(move |&(score, hit)| {
            let (right, wrong) = if hit { (weight, 0.0) } else { (0.0, weight) };
            Pool { score, right, wrong }
        })
    });
    Ok(Some(knots(pools.collect())))
}

/// Frames judged, and every detection that counts: score (Q16) and whether it is right.
fn count(
    clip: &Clip,
    frame: Option<FrameSize>,
    model: &Model<'_>,
) -> Result<(u64, Vec<(i32, bool)>), Error> {
    let input = format!("{}", clip.input.display());
    let mut found: Vec<Found> = Vec::new();
    let mut source = sources::open(&input)?;
    let args = DetectorArgs { frame, ..DetectorArgs::default() };
    pipeline::run::<Error>(&input, source.as_mut(), model, &args, &mut |number, _, detections| {
        found.extend(detections::found(number, detections));
        Ok(())
    })?;
    let judged = matching::judge(&clip.ground_truth, &found, IOU, WARMUP);
    let outcome = |d: &matching::JudgedDetection| {
        let hit = matches!(d.verdict, Verdict::Target(_));
        // Six decimals keep all scores apart: this is the detector's own number again.
        let score = (d.score * f64::from(1 << SCORE_BITS)).round() as i32;
        (hit || d.verdict == Verdict::Alarm).then_some((score, hit))
    };
    Ok((judged.frames, judged.detections.iter().filter_map(outcome).collect()))
}

/// The table of these detections.
fn knots(mut detections: Vec<Pool>) -> Vec<Knot> {
    detections.sort_by_key(|pool| std::cmp::Reverse(pool.score));
    let mut pools: Vec<Pool> = Vec::new();
    for equals in detections.chunk_by(|a, b| a.score == b.score) {
        let mut pool = equals[0];
        equals[1..].iter().for_each(|other| pool.add(other));
        while let Some(higher) = pools.pop_if(|higher| higher.precision() <= pool.precision()) {
            pool =
                Pool { right: higher.right + pool.right, wrong: higher.wrong + pool.wrong, ..pool };
        }
        pools.push(pool);
    }
    let mut all = Pool { score: i32::MAX, right: 0.0, wrong: 0.0 };
    let mut least = ONE;
    let mut knots: Vec<Knot> = pools
        .iter()
        .map(|pool| {
            all.add(pool);
            // Sums of weights are rounded: never more than at the higher score.
            least = least.min((all.precision() * f64::from(ONE)) as u32);
            Knot { score: all.score, precision: least }
        })
        .collect();
    knots.reverse();
    thin(&mut knots);
    knots
}

/// Takes out knots between two that are nearest in precision until there is room for the others.
fn thin(knots: &mut Vec<Knot>) {
    while knots.len() > MAX_KNOTS {
        let gap = |&i: &usize| knots[i + 1].precision - knots[i - 1].precision;
        let Some(place) = (1..knots.len() - 1).min_by_key(gap) else { return };
        knots.remove(place);
    }
}

/// The table in words, for the log and the card.
pub fn in_words(knots: &[Knot]) -> String {
    let score = |precision: f64| {
        let knot = knots.iter().find(|k| f64::from(k.precision) >= precision * f64::from(ONE));
        knot.map(|k| format!("{precision} from score {:.2}", score_of(k)))
    };
    let words: Vec<String> = [0.5, 0.8, 0.9, 0.95, 0.99].into_iter().filter_map(score).collect();
    if words.is_empty() { "not measured".into() } else { words.join(", ") }
}

fn score_of(knot: &Knot) -> f64 {
    f64::from(knot.score) / f64::from(1 << SCORE_BITS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::calibration::Calibration;
    use proptest::prelude::*;

    fn pool(score: i32, hit: bool) -> Pool {
        let (right, wrong) = if hit { (1.0, 0.0) } else { (0.0, 1.0) };
        Pool { score, right, wrong }
    }

    fn precision(detections: &[(i32, bool)], score: i32) -> f64 {
        let at: Vec<bool> = detections.iter().filter(|d| d.0 >= score).map(|d| d.1).collect();
        at.iter().filter(|&&hit| hit).count() as f64 / at.len() as f64
    }

    #[test]
    fn by_hand() {
        let detections =
            [(9, true), (8, true), (7, false), (6, true), (5, true), (4, false), (3, false)];
        let table = knots(detections.map(|(score, hit)| pool(score, hit)).into());
        let found: Vec<(i32, u32)> = table.iter().map(|k| (k.score, k.precision)).collect();
        // 4 of 7, 4 of 5, 2 of 2; that 7 alone is wrong is pooled with 6 and 5.
        assert_eq!(found, [(3, 4 * ONE / 7), (5, 4 * ONE / 5), (8, ONE)]);
        assert!(knots(Vec::new()).is_empty());
        assert_eq!(
            in_words(&table),
            "0.5 from score 0.00, 0.8 from score 0.00, 0.9 from score 0.00, \
                                      0.95 from score 0.00, 0.99 from score 0.00"
        );
        assert_eq!(in_words(&[]), "not measured");
    }

    #[test]
    fn scores_of_a_known_truth() {
        // A detection of score s is right with the probability of its log-odds: so many, so the table is near it.
        let mut random = crate::shell::support::random::Random::new(4);
        let detections: Vec<(i32, bool)> = (0..40_000)
            .map(|_| {
                let score = random.symmetric() * 5.0;
                let hit = (random.symmetric() + 1.0) / 2.0 < 1.0 / (1.0 + (-score).exp());
                ((score * 65536.0) as i32, hit)
            })
            .collect();
        let table = knots(detections.iter().map(|&(score, hit)| pool(score, hit)).collect());
        assert_eq!(table.len(), MAX_KNOTS);
        for Knot { score, precision } in table {
            let s = f64::from(score) / 65536.0;
            // Mean of the logistic function over s..5.
            let mean = ((1.0 + 5f64.exp()).ln() - (1.0 + s.exp()).ln()) / (5.0 - s);
            let measured = f64::from(precision) / f64::from(ONE);
            assert!((measured - mean).abs() < 0.02 || s > 4.5, "{s}: {measured}, {mean}");
        }
    }

    proptest! {
        #[test]
        fn every_knot_is_as_measured_and_none_is_worse_below(
            detections in prop::collection::vec((-20..20i32, any::<bool>()), 1..120),
        ) {
            let table = knots(detections.iter().map(|&(score, hit)| pool(score, hit)).collect());
            let bytes: Vec<u8> = table.iter().flat_map(|k| k.encode()).collect();
            prop_assert!(Calibration::parse(&bytes).is_some());
            for knot in &table {
                let measured = precision(&detections, knot.score) * f64::from(ONE);
                prop_assert!((f64::from(knot.precision) - measured).abs() <= 1.0);
            }
            // The best precision of all thresholds is the highest knot's, that of all detections the lowest's.
            let best = detections.iter().map(|d| precision(&detections, d.0)).fold(0.0, f64::max);
            let highest = f64::from(table[table.len() - 1].precision);
            prop_assert!((highest - best * f64::from(ONE)).abs() <= 1.0);
            prop_assert_eq!(table[0].score, detections.iter().map(|d| d.0).min().unwrap());
        }
    }
}
