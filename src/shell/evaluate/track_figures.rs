//! Figures of tracks and warnings over all clips.

use super::table::{Table, number};
use super::track_metrics::{ClipTracks, MUST_WARN_TIME, TargetResult};
use crate::shell::support::file_error::FileError;
use crate::shell::support::sorter::Sorter;
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

/// Sums over clips that are added one by one.
#[derive(Debug)]
pub struct TrackTally {
    assumed_cameras: u64,
    without_attitude: u64,
    confirmed_tracks: u64,
    /// Frames of targets, and those covered by the target's most frequent track.
    frames: u64,
    covered: u64,
    id_switches: u64,
    seconds: f64,
    false_tracks: u64,
    /// Angles between tracks and targets, degrees.
    bearing: Sorter,
    /// Frames in which the time to contact is compared, and those in which it was known.
    times: u64,
    known: u64,
    /// Errors of the time to contact in seconds, and in parts of the true one.
    errors: Sorter,
    shares: Sorter,
    /// Squares of these errors over the stated ones.
    honest: f64,
    collisions: Vec<Collision>,
    others: u64,
    falsely_warned: Vec<String>,
}

impl Default for TrackTally {
    fn default() -> Self {
        let [bearing, errors, shares] = [(); 3].map(|()| Sorter::new(|a, b| a.total_cmp(&b)));
        Self {
            assumed_cameras: 0,
            without_attitude: 0,
            confirmed_tracks: 0,
            frames: 0,
            covered: 0,
            id_switches: 0,
            seconds: 0.0,
            false_tracks: 0,
            bearing,
            times: 0,
            known: 0,
            errors,
            shares,
            honest: 0.0,
            collisions: Vec::new(),
            others: 0,
            falsely_warned: Vec::new(),
        }
    }
}

impl TrackTally {
    /// Adds a clip.
    ///
    /// # Errors
    /// [`FileError::Write`] of a temporary file.
    pub fn add(&mut self, clip: &ClipTracks) -> Result<(), FileError> {
        self.assumed_cameras += u64::from(clip.assumed_camera);
        self.without_attitude += u64::from(!clip.with_attitude);
        self.confirmed_tracks += clip.tracks.len() as u64;
        for (_, target) in &clip.targets {
            self.frames += target.frames;
            self.covered += target.covered.values().max().copied().unwrap_or(0);
            self.id_switches += target.switches;
        }
        self.seconds += clip.seconds;
        self.false_tracks += clip.false_tracks;
        clip.bearing.iter().try_for_each(|&angle| self.bearing.push(angle, false))?;
        self.times += clip.times.len() as u64;
        for (time, known) in &clip.times {
            let Some((value, sigma)) = known else { continue };
            let error = (value - time).abs();
            self.known += 1;
            self.honest += (error / sigma.max(1e-3)).powi(2);
            self.errors.push(error, false)?;
            self.shares.push(error / time, false)?;
        }
        if clip.kind == "collision" {
            let targets = clip.targets.iter();
            self.collisions.extend(targets.map(|(_, target)| Collision::new(&clip.name, target)));
        } else {
            self.others += 1;
        }
        if clip.false_warning {
            let name = format!("{} {}", clip.name, clip.kind);
            self.falsely_warned.push(name.trim_end().into());
        }
        Ok(())
    }

    /// Figures over the clips.
    ///
    /// # Errors
    /// As [`TrackTally::add`].
    pub fn figures(self) -> Result<TrackFigures, FileError> {
        let share = |part: f64, whole: u64| (whole > 0).then(|| part / whole as f64);
        let Self { seconds, collisions, falsely_warned, .. } = self;
        let [bearing, errors, shares] =
            [self.bearing, self.errors, self.shares].map(Sorter::finish);
        let must = || collisions.iter().filter(|c| c.longest_px > MUST_WARN_SIZE);
        let in_time = || must().filter(|c| c.in_time());
        let warned: Vec<f64> = must().filter_map(|c| c.warned_s).collect();
        let false_tracks = self.false_tracks as f64 * 60.0 / seconds;
        Ok(TrackFigures {
            assumed_cameras: self.assumed_cameras,
            without_attitude: self.without_attitude,
            confirmed_tracks: self.confirmed_tracks,
            continuity: share(self.covered as f64, self.frames),
            id_switches: self.id_switches,
            false_tracks_per_minute: (seconds > 0.0).then_some(false_tracks),
            bearing_error_deg: (bearing.quantile(0.5)?)
                .zip(bearing.quantile(0.95)?)
                .map(|(half, most)| [half, most]),
            time_known: share(self.known as f64, self.times),
            time_error_s: errors.quantile(0.5)?,
            time_error_share: shares.quantile(0.5)?,
            time_error_over_sigma: share(self.honest, self.known).map(f64::sqrt),
            to_warn: must().count() as u64,
            warned_in_time: in_time().count() as u64,
            flights_to_warn: flights(must()),
            flights_warned_in_time: flights(in_time()),
            warned_before_s: quantile(&warned, 0.5),
            others: self.others,
            false_warnings: falsely_warned.len() as u64,
            collisions,
            falsely_warned,
        })
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
