//! Clips in which nothing flies that may be reported: false detections, false tracks and alerts an hour.
//!
//! Intervals are Poisson's. They hold for events that come one by one: of detections, of which one object gives many,
//! they are too narrow.

use super::facts::Facts;
use super::matching::{ClipMatches, Match};
use super::poisson::PoissonRate;
use super::table::{Table, with_interval};
use super::track_metrics::{ClipTracks, TrackResult};
use serde::Serialize;
use std::format;
use std::string::String;
use std::vec;
use std::vec::Vec;

/// Events of one kind in a track.
type Count = fn(&TrackResult) -> u64;

/// A clip as this needs it.
#[derive(Debug, Clone, Copy)]
pub struct QuietClip<'a> {
    /// Detections of the clip, matched to its ground truth.
    pub matches: &'a ClipMatches,
    /// Its tracks; none where nothing was followed.
    pub tracks: Option<&'a ClipTracks>,
    /// Properties of the clip.
    pub facts: &'a Facts,
    /// Length of the clip in hours.
    pub hours: f64,
}

/// Cause of a false report, as far as labels and tables have it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum FalseReportCause {
    /// On a labelled bird.
    Bird,
    /// In a clip with things that move along the ground.
    Movers,
    /// In a clip of which the table says that nothing moves on the ground.
    StillBackground,
    /// In a clip of which nothing is known.
    NotKnown,
}

const CAUSES: [(FalseReportCause, &str); 4] = [
    (FalseReportCause::Bird, "on a bird"),
    (FalseReportCause::Movers, "clips with movers on the ground"),
    (FalseReportCause::StillBackground, "clips without movers"),
    (FalseReportCause::NotKnown, "cause not known"),
];

fn cause(facts: &Facts, bird: bool) -> FalseReportCause {
    match (bird, facts.movers) {
        (true, _) => FalseReportCause::Bird,
        (false, Some(movers)) if movers > 0.0 => FalseReportCause::Movers,
        (false, Some(_)) => FalseReportCause::StillBackground,
        (false, None) => FalseReportCause::NotKnown,
    }
}

/// Rates of one kind of event.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EventRates {
    /// Kind of footage that the rates are of.
    pub name: &'static str,
    /// Rate of all false reports.
    pub all: PoissonRate,
    /// By cause; only causes with events.
    by_cause: Vec<CauseRate>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
struct CauseRate {
    cause: FalseReportCause,
    #[serde(flatten)]
    rate: PoissonRate,
}

/// Figures of the clips without a target.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WithoutTarget {
    /// Clips without a target.
    pub clips: usize,
    /// Length of these clips together, hours.
    pub hours: f64,
    /// Least score of the detections counted, log-odds; none: all.
    pub score: Option<f64>,
    /// The kinds of events.
    pub events: Vec<EventRates>,
}

/// Kinds of events of tracks.
const OF_TRACKS: [(&str, Count); 3] = [
    ("confirmed false tracks", |_| 1),
    ("cautions", |track| track.cautions),
    ("warnings", |track| track.warnings),
];

/// Events by cause.
type Causes = [u64; CAUSES.len()];

/// Counts over clips without a target.
#[derive(Debug, Default)]
pub struct WithoutTargetTally {
    clips: usize,
    hours: f64,
    detections: Causes,
    of_tracks: [Causes; OF_TRACKS.len()],
    /// Whether nothing was followed in one of them.
    not_followed: bool,
}

impl WithoutTargetTally {
    /// Adds a clip. Detections count from `score` on.
    pub fn add(&mut self, clip: &QuietClip<'_>, score: Option<f64>) {
        self.clips += 1;
        self.hours += clip.hours;
        self.not_followed |= clip.tracks.is_none();
        for bird in [true, false] {
            let own = cause(clip.facts, bird);
            let place = CAUSES.iter().position(|(cause, _)| *cause == own).unwrap_or(0);
            let counted = |d: f64| score.is_none_or(|score| d >= score);
            let found = clip.matches.detections.iter().filter(|d| counted(d.score));
            let found = found.filter(|d| match d.kind {
                Match::Ignored { bird: on } => on && bird,
                Match::FalsePositive => !bird,
                Match::TruePositive(_) => false,
            });
            self.detections[place] += found.count() as u64;
            let tracks = clip.tracks.into_iter().flat_map(|tracks| &tracks.tracks);
            for track in tracks.filter(|track| track.is_bird() == bird) {
                for (counts, (_, of)) in self.of_tracks.iter_mut().zip(OF_TRACKS) {
                    counts[place] += of(track);
                }
            }
        }
    }

    /// The figures; none where there is no such clip.
    pub fn figures(self, score: Option<f64>) -> Option<WithoutTarget> {
        let Self { clips, hours, detections, of_tracks, not_followed } = self;
        if clips == 0 {
            return None;
        }
        let mut rates = vec![events("false detections", &detections, hours)];
        if !not_followed {
            let tracks = OF_TRACKS.iter().zip(&of_tracks);
            rates.extend(tracks.map(|((name, _), counts)| events(name, counts, hours)));
        }
        Some(WithoutTarget { clips, hours, score, events: rates })
    }
}

impl WithoutTarget {
    /// Name and rate of each kind of event, causes behind their kind.
    pub fn rows(&self) -> Vec<(String, PoissonRate)> {
        let mut rows = Vec::new();
        for EventRates { name, all, by_cause } in &self.events {
            rows.push(((*name).into(), *all));
            for CauseRate { cause, rate } in by_cause {
                let cause = CAUSES.iter().find(|(one, _)| one == cause).map_or("", |c| c.1);
                rows.push((format!("\u{2013} {cause}"), *rate));
            }
        }
        rows
    }

    /// The table for a terminal.
    pub fn table(&self) -> Table {
        let first = format!("Clips without a target: {}, {:.4} hours", self.clips, self.hours);
        let mut table = Table::new(&[&first, "events", "an hour (95 %, Poisson)"]);
        for (name, PoissonRate { events, per_hour, low, high }) in self.rows() {
            let rate = with_interval(per_hour, low, high, 1);
            table.row(&[&name, &format!("{events}"), &rate]);
        }
        table
    }
}

/// Rates of events of which there were so many of each cause.
fn events(name: &'static str, counts: &Causes, hours: f64) -> EventRates {
    let of_cause = |(&(cause, _), &count): (&(FalseReportCause, &str), &u64)| {
        (count > 0).then(|| CauseRate { cause, rate: PoissonRate::new(count, hours) })
    };
    let by_cause = CAUSES.iter().zip(counts).filter_map(of_cause).collect();
    EventRates { name, all: PoissonRate::new(counts.iter().sum(), hours), by_cause }
}

#[cfg(test)]
mod tests {
    use super::super::matching::match_detections;
    use super::super::score::DetectionRecord;
    use super::*;
    use crate::shell::formats::clips::GroundTruth;
    use std::path::Path;

    #[test]
    fn events_an_hour_by_cause() {
        // A bird in frame 1: one detection on it, two beside it, of which one is weak.
        let truth = GroundTruth::parse("1,1,10,10,20,20,1,4,1", Path::new("gt.txt")).unwrap();
        let found = |left: f64, score: f64| DetectionRecord {
            frame: 1,
            rect: [left, 10.0, 20.0, 20.0],
            score,
        };
        let found = [found(10.0, 5.0), found(60.0, 4.0), found(90.0, 1.0)];
        let matches = match_detections(&truth, &found, 0.3, 0);
        let track = |on_bird, warnings| TrackResult {
            frames: 10,
            on_bird,
            warnings,
            ..TrackResult::default()
        };
        let tracks = ClipTracks { tracks: vec![track(9, 1), track(0, 0)], ..ClipTracks::default() };
        let facts = [Facts { movers: Some(2.0), ..Facts::default() }, Facts::default()];
        let clip = |i: usize| QuietClip {
            matches: &matches,
            tracks: Some(&tracks),
            facts: &facts[i],
            hours: 0.25,
        };
        let figures = |clips: &[QuietClip<'_>], score| {
            let mut tally = WithoutTargetTally::default();
            clips.iter().for_each(|clip| tally.add(clip, score));
            tally.figures(score)
        };
        let all = figures(&[clip(0), clip(1)], Some(2.0)).unwrap();
        assert_eq!((all.clips, all.hours), (2, 0.5));
        let counts = |i: usize| {
            let events: &EventRates = &all.events[i];
            let by: Vec<(FalseReportCause, u64)> =
                events.by_cause.iter().map(|c| (c.cause, c.rate.events)).collect();
            (events.name, events.all.events, by)
        };
        let (bird, movers, other) =
            (FalseReportCause::Bird, FalseReportCause::Movers, FalseReportCause::NotKnown);
        assert_eq!(counts(0), ("false detections", 4, vec![(bird, 2), (movers, 1), (other, 1)]));
        assert_eq!(
            counts(1),
            ("confirmed false tracks", 4, vec![(bird, 2), (movers, 1), (other, 1)])
        );
        assert_eq!(counts(3), ("warnings", 2, vec![(bird, 2)]));
        assert_eq!(all.events[3].all.per_hour, Some(4.0));
        let text = all.table().text();
        assert!(text.contains("warnings") && text.contains("4.0 (0.5 to 14.4)"), "{text}");
        // Without tracks there are detections alone.
        let one = QuietClip { tracks: None, ..clip(0) };
        assert_eq!(figures(&[one], None).unwrap().events.len(), 1);
        assert!(figures(&[], None).is_none());
    }
}
