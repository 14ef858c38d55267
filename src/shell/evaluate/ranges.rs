//! Probability of a confirmed track over the distance of the target, by its span.

use super::facts::Facts;
use super::table::{Table, number};
use super::track_metrics::ClipTracks;
use crate::shell::support::file_error::FileError;
use crate::shell::support::sorter::Sorter;
use serde::Serialize;
use std::collections::BTreeMap;
use std::string::String;
use std::vec::Vec;
use std::{format, vec};

/// Upper bounds of the bins of distance, metres.
const BOUNDS_M: [f64; 12] =
    [5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0, 80.0, 120.0, 200.0, 400.0, f64::INFINITY];

/// Names of the groups of span and their upper bounds, metres.
const SPANS: [(&str, f64); 3] =
    [("span below 1 m", 1.0), ("span 1 to 5 m", 5.0), ("span 5 m and more", f64::INFINITY)];

/// Targets of one group of spans.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SpanRanges {
    /// Label of the group.
    pub name: &'static str,
    /// Number of targets in the group.
    pub targets: usize,
    /// Of these, targets that a confirmed track was on at any time.
    pub tracked: usize,
    /// Distance at the first frame with a confirmed track, metres: median over the tracked targets.
    pub first_track_m: Option<f64>,
    /// Farthest distance of a frame with a confirmed track, metres.
    pub farthest_m: Option<f64>,
    /// Figures by distance, nearest first.
    pub bins: Vec<RangeBin>,
}

/// Frames of targets in a bin of distance.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct RangeBin {
    /// From this distance on, metres.
    pub from_m: f64,
    /// Below this one; none: without end.
    pub to_m: Option<f64>,
    /// Frames of targets at a distance within the bin.
    pub frames: u64,
    /// Share of them with a confirmed track on the target; none without frames.
    pub tracked: Option<f64>,
}

impl RangeBin {
    /// Its bounds in words.
    pub fn name(&self) -> String {
        match self.to_m {
            Some(to) => format!("{} to {to}", self.from_m),
            None => format!("{} on", self.from_m),
        }
    }
}

/// Targets of one group of spans, clip by clip.
#[derive(Debug)]
struct SpanTally {
    targets: usize,
    /// Frames of each bin, and those with a track.
    bins: [(u64, u64); BOUNDS_M.len()],
    /// Distances at the first frames with a track, metres.
    firsts: Sorter,
    farthest: Option<f64>,
}

/// Sums over clips that are added one by one.
#[derive(Debug)]
pub struct RangeTally([SpanTally; SPANS.len()]);

impl Default for RangeTally {
    fn default() -> Self {
        Self(SPANS.map(|_| SpanTally {
            targets: 0,
            bins: Default::default(),
            firsts: Sorter::new(|a, b| a.total_cmp(&b)),
            farthest: None,
        }))
    }
}

impl RangeTally {
    /// Adds a clip.
    ///
    /// # Errors
    /// [`FileError::Write`] of a temporary file.
    pub fn add(&mut self, clip: &ClipTracks, facts: &Facts) -> Result<(), FileError> {
        // First distance of each target's track, if there was one.
        let mut firsts: BTreeMap<(usize, i64), Option<f64>> = BTreeMap::new();
        for sample in &clip.ranges {
            let place = usize::try_from(sample.id - 1).ok();
            let Some(&span) = place.and_then(|place| facts.spans_m.get(place)) else { continue };
            let group = SPANS.iter().position(|(_, bound)| span < *bound).unwrap_or(0);
            let bin = BOUNDS_M.partition_point(|&bound| bound <= sample.range_m);
            let own = &mut self.0[group];
            let count = &mut own.bins[bin.min(BOUNDS_M.len() - 1)];
            count.0 += 1;
            let first = firsts.entry((group, sample.id)).or_default();
            if sample.tracked {
                count.1 += 1;
                first.get_or_insert(sample.range_m);
                own.farthest = Some(own.farthest.unwrap_or(0.0).max(sample.range_m));
            }
        }
        firsts.into_iter().try_for_each(|((group, _), first)| {
            let own = &mut self.0[group];
            own.targets += 1;
            first.map_or(Ok(()), |first| own.firsts.push(first, false))
        })
    }

    /// The groups of span that occur; empty where no distances are known.
    ///
    /// # Errors
    /// As [`RangeTally::add`].
    pub fn figures(self) -> Result<Vec<SpanRanges>, FileError> {
        let mut groups = Vec::new();
        for ((name, _), own) in SPANS.iter().zip(self.0) {
            if own.targets == 0 {
                continue;
            }
            let bin = |(b, &(frames, tracked)): (usize, &(u64, u64))| RangeBin {
                from_m: if b == 0 { 0.0 } else { BOUNDS_M[b - 1] },
                to_m: Some(BOUNDS_M[b]).filter(|bound| bound.is_finite()),
                frames,
                tracked: (frames > 0).then(|| tracked as f64 / frames as f64),
            };
            let firsts = own.firsts.finish();
            groups.push(SpanRanges {
                name,
                targets: own.targets,
                tracked: usize::try_from(firsts.len()).unwrap_or(usize::MAX),
                first_track_m: firsts.quantile(0.5)?,
                farthest_m: own.farthest,
                bins: own.bins.iter().enumerate().map(bin).collect(),
            });
        }
        Ok(groups)
    }
}

/// The table for a terminal; a cell is the share of frames with a track, and the frames.
pub fn table(groups: &[SpanRanges]) -> Table {
    let mut heads = vec!["Share of frames with a track, by distance (m)"];
    heads.extend(groups.iter().map(|group| group.name));
    let mut table = Table::new(&heads);
    for bin in 0..BOUNDS_M.len() {
        if groups.iter().all(|group| group.bins[bin].frames == 0) {
            continue;
        }
        let cell = |group: &SpanRanges| match group.bins[bin] {
            RangeBin { frames: 0, .. } => "-".into(),
            RangeBin { tracked, frames, .. } => format!("{} of {frames}", number(tracked, 2)),
        };
        let name = groups.first().map_or(String::new(), |group| group.bins[bin].name());
        table.row(&[name].into_iter().chain(groups.iter().map(cell)).collect::<Vec<_>>());
    }
    let row = |name: &str, cell: &dyn Fn(&SpanRanges) -> String| {
        [name.into()].into_iter().chain(groups.iter().map(cell)).collect::<Vec<String>>()
    };
    table.row(&row("targets tracked", &|g| format!("{} of {}", g.tracked, g.targets)));
    table.row(&row("distance at the first track, median (m)", &|g| number(g.first_track_m, 0)));
    table.row(&row("farthest track (m)", &|g| number(g.farthest_m, 0)));
    table
}

#[cfg(test)]
mod tests {
    use super::super::track_metrics::RangeSample;
    use super::*;

    #[test]
    fn shares_by_distance_and_span() {
        let sample = |id, range_m, tracked| RangeSample { id, range_m, tracked };
        let clip = ClipTracks {
            ranges: vec![
                sample(1, 35.0, false),
                sample(1, 32.0, true),
                sample(1, 4.0, true),
                sample(2, 500.0, false),
                // Its span is not known.
                sample(3, 9.0, true),
            ],
            ..ClipTracks::default()
        };
        let facts = Facts { spans_m: vec![0.55, 12.0], ..Facts::default() };
        let mut tally = RangeTally::default();
        tally.add(&clip, &facts).unwrap();
        let groups = tally.figures().unwrap();
        assert_eq!(groups.len(), 2);
        assert_eq!((groups[0].targets, groups[0].tracked), (1, 1));
        assert_eq!((groups[0].first_track_m, groups[0].farthest_m), (Some(32.0), Some(32.0)));
        let bin = |group: usize, bin: usize| {
            (groups[group].bins[bin].frames, groups[group].bins[bin].tracked)
        };
        assert_eq!([bin(0, 0), bin(0, 1), bin(0, 5)], [(1, Some(1.0)), (0, None), (2, Some(0.5))]);
        assert_eq!(bin(1, 11), (1, Some(0.0)));
        assert_eq!((groups[1].tracked, groups[1].first_track_m), (0, None));
        let text = table(&groups).text();
        assert!(text.contains("30 to 40") && text.contains("0.50 of 2"), "{text}");
        assert!(RangeTally::default().figures().unwrap().is_empty());
    }
}
