//! Figures of tracks and warnings over all clips.

use super::table::{Table, number};
use super::track_metrics::{ClipTracks, MUST_WARN_TIME, TargetResult};
use serde::Serialize;
use std::collections::BTreeSet;
use std::fmt;
use std::format;
use std::string::String;
use std::vec::Vec;

/// Least length in pixels of targets of a collision flight that must be warned of, while there was time to.
const MUST_WARN_SIZE: f64 = 16.0;

/// A target of a collision flight.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Collision {
    /// Name of the flight.
    pub flight: String,
    /// Longest side while there was time to warn, in pixels.
    pub longest_px: f64,
    /// Time to contact at the first warning, in seconds; none without one.
    pub warned_s: Option<f64>,
    /// Time to contact when the recording ends, in seconds: where it is more than there must be for a warning, one may have
    /// come in time that is not seen.
    pub end_s: f64,
}

impl Collision {
    fn new(flight: &str, target: &TargetResult) -> Self {
        Self {
            flight: flight.into(),
            longest_px: target.longest,
            warned_s: target.warned,
            end_s: target.end,
        }
    }

    /// Whether there was a warning in time.
    fn in_time(&self) -> bool {
        self.warned_s.is_some_and(|time| time >= MUST_WARN_TIME)
    }
}

/// Number of flights.
fn flights<'c>(collisions: impl Iterator<Item = &'c Collision>) -> u64 {
    collisions.map(|c| c.flight.as_str()).collect::<BTreeSet<_>>().len() as u64
}

/// The figures of all clips together; none where nothing was there to measure on.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrackFigures {
    /// Clips without `camera.json`: directions by an assumed field of view.
    pub assumed_cameras: u64,
    /// Clips without attitudes: the pictures' own motion instead.
    pub without_attitude: u64,
    /// Tracks that were confirmed at any time.
    pub confirmed_tracks: u64,
    /// Share of the targets' frames covered by the target's most frequent track.
    pub continuity: Option<f64>,
    /// Number of changes of a target's track.
    pub id_switches: u64,
    /// Confirmed tracks that were less than half of the time on an object, per minute of flight.
    pub false_tracks_per_minute: Option<f64>,
    /// Median and 95th percentile of the angle between track and target, in degrees.
    pub bearing_error_deg: Option<[f64; 2]>,
    /// Share of the tracked frames in the last 4 s before contact in which the time to contact was known.
    pub time_known: Option<f64>,
    /// Median absolute error of the time to contact there, in seconds.
    pub time_error_s: Option<f64>,
    /// The same in parts of the true time.
    pub time_error_share: Option<f64>,
    /// Root mean square of that error over the stated one; 1 is honest.
    pub time_error_over_sigma: Option<f64>,
    /// Targets of collision flights that were over 16 px with 2 s to contact or more.
    pub to_warn: u64,
    /// Of these, warned at least 2 s before contact.
    pub warned_in_time: u64,
    /// Median of the time to contact at the first warning, in seconds.
    pub warned_before_s: Option<f64>,
    /// Flights with such a target.
    pub flights_to_warn: u64,
    /// Of these, flights that warned of one in time.
    pub flights_warned_in_time: u64,
    /// Flights without a collision.
    pub others: u64,
    /// Flights that raised a warning without a collision course, or on a bird.
    pub false_warnings: u64,
    /// The targets of collision flights.
    pub collisions: Vec<Collision>,
    /// The flights of `false_warnings`.
    pub falsely_warned: Vec<String>,
}

impl TrackFigures {
    /// Figures over the clips.
    pub fn new(clips: &[&ClipTracks]) -> Self {
        let targets = || clips.iter().flat_map(|c| c.targets.iter().map(|(_, t)| t));
        let frames: u64 = targets().map(|t| t.frames).sum();
        let covered: u64 = targets().filter_map(|t| t.covered.values().max()).sum();
        let seconds: f64 = clips.iter().map(|c| c.seconds).sum();
        let false_tracks: u64 = clips.iter().map(|c| c.false_tracks).sum();
        let bearing: Vec<f64> = clips.iter().flat_map(|c| c.bearing.iter().copied()).collect();
        let times = || clips.iter().flat_map(|c| c.times.iter());
        let known: Vec<(f64, f64, f64)> =
            times().filter_map(|(t, known)| known.map(|(v, s)| (*t, (v - t).abs(), s))).collect();
        let honest = known.iter().map(|(_, e, s)| (e / s.max(1e-3)).powi(2)).sum::<f64>();
        let collisions: Vec<Collision> = clips
            .iter()
            .filter(|c| c.kind == "collision")
            .flat_map(|c| c.targets.iter().map(|(_, target)| Collision::new(&c.name, target)))
            .collect();
        let must = || collisions.iter().filter(|c| c.longest_px > MUST_WARN_SIZE);
        let in_time = || must().filter(|c| c.in_time());
        let warned: Vec<f64> = must().filter_map(|c| c.warned_s).collect();
        let falsely = clips.iter().filter(|c| c.false_warning);
        let falsely: Vec<String> =
            falsely.map(|c| format!("{} {}", c.name, c.kind).trim_end().into()).collect();
        let count =
            |of: &dyn Fn(&ClipTracks) -> bool| clips.iter().filter(|c| of(c)).count() as u64;
        let share = |part: f64, whole: u64| (whole > 0).then(|| part / whole as f64);
        let known_count = known.len() as u64;
        Self {
            assumed_cameras: count(&|c| c.assumed_camera),
            without_attitude: count(&|c| !c.with_attitude),
            confirmed_tracks: clips.iter().map(|c| c.tracks.len() as u64).sum(),
            continuity: share(covered as f64, frames),
            id_switches: targets().map(|t| t.switches).sum(),
            false_tracks_per_minute: (seconds > 0.0).then(|| false_tracks as f64 * 60.0 / seconds),
            bearing_error_deg: quantile(&bearing, 0.5)
                .zip(quantile(&bearing, 0.95))
                .map(|(half, most)| [half, most]),
            time_known: share(known.len() as f64, times().count() as u64),
            time_error_s: quantile(&known.iter().map(|k| k.1).collect::<Vec<_>>(), 0.5),
            time_error_share: quantile(&known.iter().map(|k| k.1 / k.0).collect::<Vec<_>>(), 0.5),
            time_error_over_sigma: share(honest, known_count).map(f64::sqrt),
            to_warn: must().count() as u64,
            warned_in_time: in_time().count() as u64,
            flights_to_warn: flights(must()),
            flights_warned_in_time: flights(in_time()),
            warned_before_s: quantile(&warned, 0.5),
            others: count(&|c| c.kind != "collision"),
            false_warnings: falsely.len() as u64,
            collisions,
            falsely_warned: falsely,
        }
    }
}

/// The value below which this share of all lies; none of none.
pub fn quantile(values: &[f64], share: f64) -> Option<f64> {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    values.get((values.len().saturating_sub(1) as f64 * share).round() as usize).copied()
}

impl fmt::Display for TrackFigures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut table = Table::new(&["Tracks", ""]);
        let mut row = |name: &str, value: String| table.row(&[name, &value]);
        row("confirmed tracks", format!("{}", self.confirmed_tracks));
        row("targets' frames covered by one track", number(self.continuity, 3));
        row("changes from one track to another", format!("{}", self.id_switches));
        row("false tracks a minute", number(self.false_tracks_per_minute, 2));
        let bearing = |i: usize| number(self.bearing_error_deg.map(|error| error[i]), 3);
        row("direction error, median (degrees)", bearing(0));
        row("direction error, 95 % below (degrees)", bearing(1));
        row("last 4 s: share with a time to contact", number(self.time_known, 3));
        row("time to contact error, median (s)", number(self.time_error_s, 2));
        let percent = self.time_error_share.map(|share| share * 100.0);
        row("time to contact error, median (%)", number(percent, 0));
        row("time to contact error over sigma, rms", number(self.time_error_over_sigma, 2));
        let of = |part: u64, whole: u64| format!("{part} of {whole}");
        let (flights, targets) = (self.flights_to_warn, self.to_warn);
        row("flights warned of 2 s before contact", of(self.flights_warned_in_time, flights));
        row("targets warned of 2 s before contact", of(self.warned_in_time, targets));
        row("time to contact at the warning, median (s)", number(self.warned_before_s, 2));
        row("falsely warned, of flights without collision", of(self.false_warnings, self.others));
        write!(f, "{}", table.text())?;
        if self.confirmed_tracks == 0 {
            write!(f, "\nNo track was confirmed: errors of directions and times are not known.")?;
        }
        for name in &self.falsely_warned {
            write!(f, "\n  falsely warned: {name}")?;
        }
        for collision in self.collisions.iter().filter(|c| !c.in_time()) {
            let Collision { flight, longest_px, warned_s, end_s } = collision;
            let when = match warned_s {
                Some(time) => format!("{time:.2} s before contact"),
                None => format!("not until {end_s:.2} s before contact, where the recording ends"),
            };
            write!(f, "\n  {flight}, {longest_px:.0} px: warned {when}")?;
        }
        Ok(())
    }
}
