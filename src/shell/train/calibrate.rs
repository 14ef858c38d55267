//! The table of precisions: the whole detector on the clips held back, its detections counted by score.
//!
//! Clips are counted by kind: those of each folder, and all without targets. The precision at a score is R / (R + F): R
//! right detections a frame of that score or more, the mean of the kinds with targets; F false ones a frame, of the kind
//! that has most. So the table holds for the hardest footage that was held back, not for the mean of all of it, which is
//! the nearest to footage that no training saw. Precision must not fall as scores rise: at each score it is the best that
//! was measured from there down.

use super::TrainArgs;
use super::footage;
use super::listing;
use crate::model::Model;
use crate::model::calibration::{Knot, MAX_KNOTS, ONE};
use crate::shell::error::Error;
use crate::shell::evaluate::matching::{self, DetectionRecord, Match, WARMUP};
use crate::shell::formats::clips::Clip;
use crate::shell::formats::detections::{self, SCORE_BITS};
use crate::shell::pipeline::scaled::FrameSize;
use crate::shell::pipeline::{self, DetectorArgs, on_clips};
use crate::shell::sources;
use std::format;
use std::string::String;
use std::vec;
use std::vec::Vec;

/// Intersection over union with a target from which a detection is right.
const IOU: f64 = 0.3;

/// A detection: score (Q16), kind of its clip, whether it is right, and one over the frames of its kind.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Counted {
    score: i32,
    kind: usize,
    right: bool,
    weight: f64,
}

/// Runs the detector on every `hold_back`th clip of each folder and counts. No knots where no clip is held back; none
/// after Ctrl-C.
///
/// # Errors
/// [`Error`] of the first clip that cannot be read.
pub fn measure(
    args: &TrainArgs,
    hold_back: usize,
    model: &Model<'_>,
) -> Result<Option<Vec<Knot>>, Error> {
    let (mut all, mut group_of) = (Vec::new(), Vec::new());
    let folders = listing::folders(args);
    for (number, (folder, kind)) in folders.iter().enumerate() {
        for (place, clip) in listing::clips(folder, *kind)?.into_iter().enumerate() {
            if footage::is_held_back(place, hold_back) {
                let targets = clip.ground_truth.has_target();
                group_of.push(if targets { number } else { folders.len() });
                all.push(clip);
            }
        }
    }
    if all.is_empty() {
        return Ok(Some(Vec::new()));
    }
    let Some(counted) =
        on_clips::<_, Error, _>(&all, 0, &|_, clip| count(clip, args.frame, model))?
    else {
        return Ok(None);
    };
    let mut frames = vec![0; folders.len() + 1];
    counted.iter().zip(&group_of).for_each(|((n, _), &group)| frames[group] += n);
    let detections = counted.iter().zip(&group_of).flat_map(|((_, outcomes), &kind)| {
        let weight = 1.0 / frames[kind].max(1) as f64;
        outcomes.iter().map(move |&(score, right)| Counted { score, kind, right, weight })
    });
    // Folders with targets: R is the mean of these.
    let with_targets = frames[..folders.len()].iter().filter(|&&frames| frames > 0).count();
    Ok(Some(knots(detections.collect(), frames.len(), with_targets)))
}

/// Number of frames, and every detection that counts: score (Q16) and whether it is right.
fn count(
    clip: &Clip,
    frame: Option<FrameSize>,
    model: &Model<'_>,
) -> Result<(u64, Vec<(i32, bool)>), Error> {
    let input = format!("{}", clip.input.display());
    let mut found: Vec<DetectionRecord> = Vec::new();
    let mut source = sources::open(&clip.input)?;
    let args = DetectorArgs { frame, ..DetectorArgs::default() };
    pipeline::run::<Error>(&input, source.as_mut(), model, &args, &mut |number, _, detections| {
        found.extend(detections::found(number, detections));
        Ok(())
    })?;
    let judged = matching::match_detections(&clip.ground_truth, &found, IOU, WARMUP);
    let outcome = |d: &matching::Matched| {
        let hit = matches!(d.kind, Match::TruePositive(_));
        // Six decimals keep all scores apart: this is the detector's own number again.
        let score = (d.score * f64::from(1 << SCORE_BITS)).round() as i32;
        (hit || d.kind == Match::FalsePositive).then_some((score, hit))
    };
    Ok((judged.frames, judged.detections.iter().filter_map(outcome).collect()))
}

/// The table of these detections of `kinds` kinds of clips, of which `with_targets` have targets.
fn knots(mut detections: Vec<Counted>, kinds: usize, with_targets: usize) -> Vec<Knot> {
    detections.sort_by_key(|detection| std::cmp::Reverse(detection.score));
    let (mut right, mut wrong) = (0.0, vec![0.0; kinds]);
    let mut measured: Vec<(i32, f64)> = Vec::new();
    for equals in detections.chunk_by(|a, b| a.score == b.score) {
        for detection in equals {
            let sum = if detection.right { &mut right } else { &mut wrong[detection.kind] };
            *sum += detection.weight;
        }
        let (found, worst) =
            (right / with_targets.max(1) as f64, wrong.iter().copied().fold(0.0, f64::max));
        measured.push((equals[0].score, found / (found + worst)));
    }
    let mut knots: Vec<Knot> = Vec::new();
    for (score, precision) in measured.into_iter().rev() {
        let precision = (precision * f64::from(ONE)) as u32;
        if knots.last().is_none_or(|lower| lower.precision < precision) {
            knots.push(Knot { score, precision });
        }
    }
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

    fn table(detections: &[(i32, bool)]) -> Vec<Knot> {
        let counted = |&(score, right)| Counted { score, kind: 0, right, weight: 1.0 };
        knots(detections.iter().map(counted).collect(), 1, 1)
    }

    fn precision(detections: &[(i32, bool)], score: i32) -> f64 {
        let at: Vec<bool> = detections.iter().filter(|d| d.0 >= score).map(|d| d.1).collect();
        at.iter().filter(|&&hit| hit).count() as f64 / at.len() as f64
    }

    #[test]
    fn by_hand() {
        let detections =
            [(9, true), (8, true), (7, false), (6, true), (5, true), (4, false), (3, false)];
        let found: Vec<(i32, u32)> =
            table(&detections).iter().map(|k| (k.score, k.precision)).collect();
        // 4 of 7, 4 of 6, 4 of 5; 3 of 4 and 2 of 3 are no better; 2 of 2.
        let share =
            |right: u32, all: u32| (f64::from(right) / f64::from(all) * f64::from(ONE)) as u32;
        assert_eq!(found, [(3, share(4, 7)), (4, share(4, 6)), (5, share(4, 5)), (8, ONE)]);
        assert!(table(&[]).is_empty());
        assert_eq!(
            in_words(&table(&detections)),
            "0.5 from score 0.00, 0.8 from score 0.00, 0.9 from score 0.00, \
                                      0.95 from score 0.00, 0.99 from score 0.00"
        );
        assert_eq!(in_words(&[]), "not measured");
    }

    #[test]
    fn false_alarms_of_the_worst_kind_count() {
        let of =
            |score, kind, right, frames: f64| Counted { score, kind, right, weight: 1.0 / frames };
        // Ten frames with targets, of which eight are found at score 9; at score 5 an easy kind has a false alarm in 100
        // frames, and the footage without targets one in 10.
        let mut detections: Vec<Counted> = (0..8).map(|_| of(9, 0, true, 10.0)).collect();
        detections.push(of(5, 0, false, 100.0));
        detections.push(of(5, 1, false, 10.0));
        let table = knots(detections, 2, 1);
        let share = |v: f64| (v * f64::from(ONE)) as u32;
        let found: Vec<(i32, u32)> = table.iter().map(|k| (k.score, k.precision)).collect();
        assert_eq!(found, [(5, share(0.8 / 0.9)), (9, ONE)]);
    }

    #[test]
    fn scores_of_a_known_truth() {
        // A detection of score s is right with the probability of its log-odds, so the table is near it.
        let mut random = crate::shell::support::random::Random::new(4);
        let detections: Vec<(i32, bool)> = (0..40_000)
            .map(|_| {
                let score = random.symmetric() * 5.0;
                let hit = (random.symmetric() + 1.0) / 2.0 < 1.0 / (1.0 + (-score).exp());
                ((score * 65536.0) as i32, hit)
            })
            .collect();
        let table = table(&detections);
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
            let table = table(&detections);
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
