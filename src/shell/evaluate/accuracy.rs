//! Accuracy of matched clips in memory that does not grow with them: the figures of [`super::score::Scorer`], to the last bit.

use super::matching::ClipMatches;
use super::ranking::surest_first;
use super::score::{AccuracyReport, FALSE_ALARMS, PRECISIONS, Tallies};
use crate::shell::support::file_error::FileError;
use crate::shell::support::sorter::{Sorted, Sorter};
use crate::shell::support::spool::Spool;
use std::mem;
use std::ops::{ControlFlow, Range};
use std::vec::Vec;

/// Points of the precision-recall curve that are kept in memory.
const POINTS: usize = 1 << 13;

/// Accumulates matched clips into one report.
#[derive(Debug)]
pub struct AccuracyTally {
    iou: f64,
    frames: u64,
    targets: u64,
    tallies: Tallies,
    outcomes: Sorter,
}

impl AccuracyTally {
    /// For clips matched at the intersection over union `iou`.
    pub fn new(iou: f64) -> Self {
        let outcomes = Sorter::new(surest_first);
        Self { iou, frames: 0, targets: 0, tallies: Tallies::default(), outcomes }
    }

    /// Adds a clip.
    ///
    /// # Errors
    /// [`FileError::Write`] of a temporary file.
    pub fn add(&mut self, matches: &ClipMatches) -> Result<(), FileError> {
        self.frames += matches.frames;
        self.targets += matches.targets.len() as u64;
        self.tallies.add(matches);
        for detection in &matches.detections {
            if let Some(outcome) = detection.outcome(0) {
                self.outcomes.push(outcome.score, outcome.hit)?;
            }
        }
        Ok(())
    }

    /// The figures of all clips together.
    ///
    /// # Errors
    /// [`FileError::Write`] of a temporary file.
    pub fn report(self) -> Result<AccuracyReport, FileError> {
        let Self { iou, frames, targets, tallies, outcomes } = self;
        let outcomes = outcomes.finish();
        let figures = CurveFigures::new(&outcomes, targets.max(1) as f64, frames)?;
        Ok(AccuracyReport {
            average_precision: figures.average_precision,
            iou,
            frames,
            positives: tallies.targets(),
            detections: usize::try_from(outcomes.len()).unwrap_or(usize::MAX),
            recall_at_precision: figures.recall_at_precision,
            recall_at_false_alarms: figures.recall_at_false_alarms,
            by_size: tallies.by_size(),
            by_class: tallies.by_class(),
        })
    }
}

/// Figures that are read off the precision-recall curve.
struct CurveFigures {
    average_precision: f64,
    recall_at_precision: [f64; 3],
    recall_at_false_alarms: [f64; 3],
}

impl CurveFigures {
    fn new(outcomes: &Sorted, targets: f64, frames: u64) -> Result<Self, FileError> {
        let limits = FALSE_ALARMS.map(|limit| limit * frames);
        let (mut right, mut wrong, mut last) = (0u64, 0u64, 0u64);
        // Right ones down to the last detection within each limit; none while there may be more.
        let mut within: [Option<u64>; 3] = [None; 3];
        let mut recall_at_precision = [0.0; 3];
        let mut curve = Curve::default();
        let mut point = |right: u64, wrong: u64, curve: &mut Curve| {
            let (recall, precision) =
                (right as f64 / targets, right as f64 / (right + wrong) as f64);
            for (best, least) in recall_at_precision.iter_mut().zip(PRECISIONS) {
                if precision >= least {
                    *best = f64::max(*best, recall);
                }
            }
            curve.push([recall, precision])
        };
        let mut before: Option<f64> = None;
        let mut failed = None;
        outcomes.each(|outcome| {
            // The last of equal scores has the point.
            if right > last && before != Some(outcome.value) {
                last = right;
                if let Err(error) = point(right, wrong, &mut curve) {
                    failed = Some(error);
                    return ControlFlow::Break(());
                }
            }
            before = Some(outcome.value);
            if outcome.mark {
                right += 1;
            } else {
                wrong += 1;
            }
            for (within, limit) in within.iter_mut().zip(limits) {
                if within.is_none() && wrong * 1000 > limit {
                    *within = Some(right);
                }
            }
            ControlFlow::Continue(())
        })?;
        if let Some(error) = failed {
            return Err(error);
        }
        if right > last {
            point(right, wrong, &mut curve)?;
        }
        Ok(Self {
            average_precision: curve.area()?,
            recall_at_precision,
            recall_at_false_alarms: within.map(|within| within.unwrap_or(right) as f64 / targets),
        })
    }
}

/// Points of recall and precision in the order of rising recall.
#[derive(Debug, Default)]
struct Curve {
    memory: Vec<[f64; 2]>,
    pieces: Vec<Range<u64>>,
    spool: Option<Spool>,
}

impl Curve {
    fn push(&mut self, point: [f64; 2]) -> Result<(), FileError> {
        self.memory.push(point);
        if self.memory.len() == POINTS {
            let spool = match &mut self.spool {
                Some(spool) => spool,
                none => none.insert(Spool::create(&std::env::temp_dir().join("lookout-curve"))?),
            };
            self.pieces.push(write(spool, &self.memory)?);
            self.memory.clear();
        }
        Ok(())
    }

    /// Area under the curve whose precision is the best at that recall or more.
    fn area(mut self) -> Result<f64, FileError> {
        let mut best = None;
        envelope(&mut self.memory, &mut best);
        if let Some(spool) = &self.spool {
            let mut points = Vec::new();
            for piece in self.pieces.iter_mut().rev() {
                read(spool, piece.clone(), &mut points)?;
                envelope(&mut points, &mut best);
                *piece = write(spool, &points)?;
            }
        }
        let (mut sum, mut last) = (0.0, 0.0);
        let mut add = |points: &[[f64; 2]]| {
            for [recall, precision] in points {
                sum += (recall - last) * precision;
                last = *recall;
            }
        };
        if let Some(spool) = &self.spool {
            let mut points = Vec::new();
            for piece in mem::take(&mut self.pieces) {
                read(spool, piece, &mut points)?;
                add(&points);
            }
        }
        add(&self.memory);
        Ok(sum)
    }
}

/// Makes each precision the best from there on; `best` is that of the points behind.
fn envelope(points: &mut [[f64; 2]], best: &mut Option<f64>) {
    for [_, precision] in points.iter_mut().rev() {
        *precision = best.map_or(*precision, |best| precision.max(best));
        *best = Some(*precision);
    }
}

fn write(spool: &Spool, points: &[[f64; 2]]) -> Result<Range<u64>, FileError> {
    let bytes: Vec<u8> = points.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
    spool.append(&bytes)
}

fn read(spool: &Spool, piece: Range<u64>, points: &mut Vec<[f64; 2]>) -> Result<(), FileError> {
    let mut bytes = Vec::new();
    spool.read(piece, &mut bytes)?;
    let number = |bytes: &[u8; 8]| f64::from_le_bytes(*bytes);
    points.clear();
    let pairs = bytes.as_chunks::<8>().0.as_chunks::<2>().0;
    points.extend(pairs.iter().map(|[recall, precision]| [number(recall), number(precision)]));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::matching::{ExpectedTarget, Match, Matched};
    use super::super::score::Scorer;
    use super::*;
    use crate::shell::formats::clips::GroundTruth;
    use crate::shell::support::random::Random;
    use std::path::Path;

    fn clip(random: &mut Random, detections: usize) -> ClipMatches {
        let text = "4,1,10,10,20,20\n4,2,10,50,90,20\n";
        let truth = GroundTruth::parse(text, Path::new("gt.txt")).unwrap();
        let boxes = truth.frame(4);
        let mut matches = ClipMatches { frames: detections as u64 / 2, ..ClipMatches::default() };
        for index in 0..detections {
            let target = matches.targets.len();
            let kind = match random.below(5) {
                0 | 1 => Match::TruePositive(target),
                2 => Match::Ignored { bird: false },
                _ => Match::FalsePositive,
            };
            if random.chance(0.8) || kind == Match::TruePositive(target) {
                let truth = boxes[random.below(2)];
                matches.targets.push(ExpectedTarget { frame: 4, truth });
            }
            // Some scores are equal, right ones are surer.
            let score = random.below(900) as f64 / 7.0
                + if kind == Match::TruePositive(target) { 60.0 } else { 0.0 };
            matches.detections.push(Matched { index, score, kind });
        }
        matches
    }

    /// The ranking in memory is the oracle.
    #[test]
    fn the_report_is_that_of_the_ranking_in_memory() {
        for (seed, (clips, detections)) in
            [(0, 0), (1, 0), (3, 1), (9, 40), (60, 800)].into_iter().enumerate()
        {
            let mut random = Random::new(seed as u64);
            let (mut scorer, mut tally) = (Scorer::new(0.5, 3), AccuracyTally::new(0.5));
            for _ in 0..clips {
                let matches = clip(&mut random, detections);
                scorer.add_matches(&matches);
                tally.add(&matches).unwrap();
            }
            let (expected, found) = (scorer.report(), tally.report().unwrap());
            assert_eq!(found, expected);
            assert_eq!(found.average_precision.to_bits(), expected.average_precision.to_bits());
        }
    }

    #[test]
    fn curves_longer_than_memory_have_the_same_area() {
        let mut random = Random::new(1);
        let count = 3 * POINTS + 11;
        let mut points: Vec<[f64; 2]> = Vec::new();
        let mut curve = Curve::default();
        for i in 0..count {
            let point = [(i + 1) as f64 / count as f64, random.within(0.0, 1.0)];
            points.push(point);
            curve.push(point).unwrap();
        }
        envelope(&mut points, &mut None);
        let mut last = 0.0;
        let expected = points.iter().fold(0.0, |sum, [recall, precision]| {
            let step = recall - last;
            last = *recall;
            sum + step * precision
        });
        assert_eq!(curve.area().unwrap().to_bits(), expected.to_bits());
    }
}
