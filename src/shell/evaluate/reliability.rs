//! Reliability of the model's table of precisions: the precision that it states for a score against the one found.

use super::bootstrap::{Bootstrap, Interval};
use super::matching::{ClipMatches, Match};
use super::table::{Table, number, with_interval};
use crate::model::Model;
use crate::model::calibration::ONE;
use crate::shell::formats::detections::Decimal;
use serde::Serialize;
use std::format;
use std::vec::Vec;

/// Stated precisions that are looked up.
const STATED: [f64; 8] = [0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99];

/// The precision at which figures of use are taken.
pub const WORKING_PRECISION: f64 = 0.9;

/// One row of the table; detections of that score or more.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ReliabilityRow {
    /// Share of right ones that the model states.
    pub stated: f64,
    /// The score, log-odds.
    pub score: f64,
    /// Detections of this score or more that are right or wrong.
    pub detections: u64,
    /// Share of right ones found, with the interval over clips.
    pub found: Interval,
    /// Share of all targets found; none without targets.
    pub recall: Option<f64>,
}

/// Score (log-odds) from which on the model states this precision.
pub fn score_of(model: &Model<'_>, precision: f64) -> Option<f64> {
    let wanted = (precision * f64::from(ONE)) as u32;
    model.calibration().threshold(wanted).map(|bits| Decimal::score(bits).to_f64())
}

/// Counts of right and wrong detections, by clip, for each row of the table.
#[derive(Debug, Default)]
pub struct ReliabilityTally {
    rows: Vec<RowTally>,
    targets: usize,
}

#[derive(Debug)]
struct RowTally {
    stated: f64,
    score: f64,
    counts: Vec<(u64, u64)>,
}

impl ReliabilityTally {
    /// For the rows whose scores are `least` or more, which was the least that the detector reported.
    pub fn new(model: &Model<'_>, least: Option<f64>) -> Self {
        let scored = STATED.map(|stated| Some((stated, score_of(model, stated)?)));
        let reported = |(_, score): &(f64, f64)| least.is_none_or(|least| *score >= least);
        Self::of_scores(scored.into_iter().flatten().filter(reported))
    }

    fn of_scores(scored: impl Iterator<Item = (f64, f64)>) -> Self {
        let rows = scored.map(|(stated, score)| RowTally { stated, score, counts: Vec::new() });
        Self { rows: rows.collect(), targets: 0 }
    }

    /// Adds a clip.
    pub fn add(&mut self, clip: &ClipMatches) {
        self.targets += clip.targets.len();
        for row in &mut self.rows {
            let counted = clip.detections.iter().filter(|d| d.score >= row.score);
            row.counts.push(counted.fold(
                (0, 0),
                |(right, wrong), detection| match detection.kind {
                    Match::TruePositive(_) => (right + 1, wrong),
                    Match::FalsePositive => (right, wrong + 1),
                    Match::Ignored { .. } => (right, wrong),
                },
            ));
        }
    }

    /// The rows of the table; `bootstrap` draws as many clips as were added.
    pub fn rows(self, bootstrap: &Bootstrap) -> Vec<ReliabilityRow> {
        let targets = self.targets;
        let row = |RowTally { stated, score, counts }| {
            let sum = |of: &dyn Fn(&(u64, u64)) -> u64| counts.iter().map(of).sum::<u64>();
            let (right, wrong) = (sum(&|clip| clip.0), sum(&|clip| clip.1));
            ReliabilityRow {
                stated,
                score,
                detections: right + wrong,
                found: bootstrap.share(&counts),
                recall: (targets > 0).then(|| right as f64 / targets as f64),
            }
        };
        self.rows.into_iter().map(row).collect()
    }
}

/// The table for a terminal.
pub fn table(rows: &[ReliabilityRow]) -> Table {
    let heads =
        ["Precision stated", "score from", "detections", "precision found (95 %)", "recall"];
    let mut table = Table::new(&heads);
    for row in rows {
        let Interval { value, low, high } = row.found;
        table.row(&[
            format!("{:.2}", row.stated),
            format!("{:.3}", row.score),
            format!("{}", row.detections),
            with_interval(value, low, high, 3),
            number(row.recall, 3),
        ]);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::super::matching::{WARMUP, match_detections};
    use super::super::score::DetectionRecord;
    use super::*;
    use crate::shell::formats::clips::GroundTruth;
    use std::path::Path;
    use std::string::String;

    #[test]
    fn precision_found_by_hand() {
        // Four clips of one target; scores 3 and 1 on it, 2 beside it in every second clip.
        let truth: String = (4..=9).map(|f| format!("{f},1,10,10,20,20\n")).collect();
        let truth = GroundTruth::parse(&truth, Path::new("gt.txt")).unwrap();
        let clip = |number: usize| {
            let mut found: Vec<DetectionRecord> = Vec::new();
            for frame in 4..=9 {
                let score = if frame % 2 == 0 { 3.0 } else { 1.0 };
                found.push(DetectionRecord { frame, rect: [10.0, 10.0, 20.0, 20.0], score });
                if number.is_multiple_of(2) {
                    found.push(DetectionRecord {
                        frame,
                        rect: [60.0, 60.0, 20.0, 20.0],
                        score: 2.0,
                    });
                }
            }
            match_detections(&truth, &found, 0.3, WARMUP)
        };
        let matches: Vec<ClipMatches> = (0..4).map(clip).collect();
        let bootstrap = Bootstrap::new(4, 200, 1);
        let row = |score: f64| {
            let mut tally = ReliabilityTally::of_scores([(0.9, score)].into_iter());
            matches.iter().for_each(|clip| tally.add(clip));
            tally.rows(&bootstrap).remove(0)
        };
        let high = row(2.5);
        assert_eq!((high.detections, high.found.value, high.recall), (12, Some(1.0), Some(0.5)));
        let low = row(0.5);
        assert_eq!((low.detections, low.recall), (36, Some(1.0)));
        let Interval { value, low, high } = low.found;
        assert_eq!(value, Some(24.0 / 36.0));
        assert!(low < Some(0.6) && high > Some(0.75), "{low:?} {high:?}");
        assert!(row(9.0).found.value.is_none());
    }
}
