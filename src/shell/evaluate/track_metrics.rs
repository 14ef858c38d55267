//! How good tracks and warnings are, by the truth of the flights.

use super::score::{WARMUP, must_be_found};
use crate::camera::attitude::Attitude;
use crate::camera::attitude_buffer::Attitudes;
use crate::detector::detection::Detection;
use crate::math::real::Real;
use crate::registration::global_motion::Motion;
use crate::shell::error::Error;
use crate::shell::formats::camera_file::{CameraFile, number};
use crate::shell::formats::clips::{Clip, TruthBox};
use crate::shell::formats::error::FormatError;
use crate::shell::formats::truth::{self, FrameTruth};
use crate::tracking::traffic::{Level, Traffic};
use crate::tracking::{Settings, Watch};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::string::{String, ToString};
use std::vec::Vec;
use std::{format, fs};

/// Targets of a collision flight that must be warned of: at least so long, in pixels, while there was time to.
const MUST_WARN_SIZE: f64 = 16.0;

/// Seconds before contact at which the warning must be there.
const MUST_WARN_TIME: f64 = 2.0;

/// Times to contact that are compared, in seconds.
const COMPARED: f64 = 4.0;

/// Follows the objects of one clip and keeps what its figures need.
#[derive(Debug)]
pub struct ClipWatch<'a> {
    clip: &'a Clip,
    truth: BTreeMap<u64, FrameTruth>,
    kind: String,
    attitudes: Option<Attitudes>,
    watch: Watch,
    /// Size of the frames.
    pub size: (usize, usize),
    targets: BTreeMap<i64, TargetResult>,
    tracks: BTreeMap<u16, TrackResult>,
    result: ClipResult,
}

/// A target over a clip.
#[derive(Debug, Clone, Default)]
struct TargetResult {
    frames: u64,
    covered: BTreeMap<u16, u64>,
    last: Option<u16>,
    switches: u64,
    /// Longest side while there was time to warn, in pixels.
    longest: f64,
    /// Time to contact at the first warning, in seconds.
    warned: Option<f64>,
    /// Time to contact where the recording ends, in seconds.
    end: f64,
}

/// A track over a clip.
#[derive(Debug, Clone, Copy, Default)]
struct TrackResult {
    frames: u64,
    /// Frames on a target, or on what is ignored.
    right: u64,
    warned: bool,
}

/// What a clip gave.
#[derive(Debug, Clone, Default)]
pub struct ClipResult {
    name: String,
    kind: String,
    frames: u64,
    seconds: f64,
    targets: Vec<(i64, TargetResult)>,
    false_tracks: u64,
    false_warning: bool,
    /// Angles between tracks and targets, degrees.
    bearing: Vec<f64>,
    /// True time to contact, the estimate and its error where it is known.
    times: Vec<(f64, Option<(f64, f64)>)>,
}

impl<'a> ClipWatch<'a> {
    /// Reads what is known of the clip.
    ///
    /// # Errors
    /// [`Error`] naming the file and the field.
    pub fn new(clip: &'a Clip, with_attitude: bool, settings: Settings) -> Result<Self, Error> {
        let path = clip.directory.join("camera.json");
        let text = fs::read_to_string(&path).map_err(Error::read(&path))?;
        let wrong = |reason| FormatError::Camera { path: path.clone(), reason };
        let file: CameraFile = serde_json::from_str(&text).map_err(|e| wrong(e.to_string()))?;
        Ok(Self {
            clip,
            truth: truth::read(&clip.directory.join("truth.csv"))?,
            watch: Watch::new(settings, file.camera().map_err(wrong)?),
            size: (file.width as usize, file.height as usize),
            kind: file.kind.unwrap_or_default(),
            attitudes: with_attitude.then(Attitudes::new),
            targets: BTreeMap::new(),
            tracks: BTreeMap::new(),
            result: ClipResult::default(),
        })
    }

    /// The objects followed in frame `number`, from 1.
    pub fn frame(&mut self, number: u64, time_us: i64, found: &[Detection], motion: &Motion) {
        let none = FrameTruth::default();
        let truth = self.truth.get(&number).unwrap_or(&none);
        if let Some(attitudes) = &mut self.attitudes {
            attitudes.push(time_us, attitude(truth.attitude));
        }
        let empty = Attitudes::new();
        let attitudes = self.attitudes.as_ref().unwrap_or(&empty);
        let traffic = self.watch.update(found, time_us, motion, attitudes);
        self.result.frames = number;
        self.result.seconds = time_us as f64 / 1e6;
        if number <= WARMUP {
            return;
        }
        let boxes = self.clip.ground_truth.frame(number);
        let traffic: Vec<&Traffic> = traffic.iter().filter(|t| t.confirmed).collect();
        let right = assign(boxes, &traffic);
        for (traffic, right) in traffic.iter().zip(&right) {
            let track = self.tracks.entry(traffic.id).or_default();
            track.frames += 1;
            track.right += u64::from(right.is_some());
            track.warned |= traffic.level == Level::Warning;
        }
        for (index, target) in boxes.iter().enumerate() {
            let known = truth.targets.iter().find(|t| t.id == target.id);
            let found = right.iter().position(|r| *r == Some(index)).map(|i| traffic[i]);
            self.result.target(self.targets.entry(target.id).or_default(), target, known, found);
            if let (Some(known), Some(found)) = (known, found) {
                self.result.bearing.push(degrees_between(found, truth.attitude, known));
            }
        }
    }

    /// What the clip gave.
    pub fn finish(self) -> ClipResult {
        let collision = self.kind == "collision";
        let wrong = |t: &TrackResult| 2 * t.right < t.frames;
        ClipResult {
            name: self.clip.name.clone(),
            false_tracks: self.tracks.values().filter(|t| wrong(t)).count() as u64,
            false_warning: self.tracks.values().any(|t| t.warned && (!collision || wrong(t))),
            kind: self.kind,
            targets: self.targets.into_iter().collect(),
            ..self.result
        }
    }
}

impl ClipResult {
    fn target(
        &mut self,
        result: &mut TargetResult,
        target: &TruthBox,
        known: Option<&truth::Target>,
        found: Option<&Traffic>,
    ) {
        if must_be_found(target) {
            result.frames += 1;
        }
        let time = known.and_then(|known| known.time_to_contact);
        result.end = time.unwrap_or(result.end);
        if time.is_some_and(|time| time >= MUST_WARN_TIME) {
            result.longest = result.longest.max(target.width.max(target.height));
        }
        if let Some(found) = found {
            if must_be_found(target) {
                *result.covered.entry(found.id).or_default() += 1;
            }
            if result.last.is_some_and(|last| last != found.id) {
                result.switches += 1;
            }
            result.last = Some(found.id);
            if found.level == Level::Warning && result.warned.is_none() {
                result.warned = Some(time.unwrap_or(0.0));
            }
            if let Some(time) = time.filter(|time| *time <= COMPARED) {
                let known = found.time_to_contact.map(|t| (t.value.to_num(), t.sigma.to_num()));
                self.times.push((time, known));
            }
        }
    }
}

fn attitude(angles: [f64; 3]) -> Attitude {
    let [roll, pitch, yaw] = angles.map(|v| number("attitude", v).unwrap_or(Real::ZERO));
    Attitude::from_euler(roll, pitch, yaw)
}

/// Angle between a track and where its target is, in degrees.
fn degrees_between(found: &Traffic, angles: [f64; 3], known: &truth::Target) -> f64 {
    let world = attitude(angles).rotate(found.body.into()).map(|v| v.to_num::<f64>());
    let away = known.direction();
    let square: f64 = world.iter().zip(away).map(|(a, b)| (a - b) * (a - b)).sum();
    (square.sqrt() / 2.0).min(1.0).asin().to_degrees() * 2.0
}

/// Gives tracks to boxes, the nearest pair first: for each track the box that it is on. A track is on a box when its middle is
/// within the box, half as large again, and its size is a third to three times that of the box.
fn assign(boxes: &[TruthBox], traffic: &[&Traffic]) -> Vec<Option<usize>> {
    let mut right = std::vec![None; traffic.len()];
    let mut pairs = Vec::new();
    for (t, found) in traffic.iter().enumerate() {
        let [x, y, w, h] = [found.rect.x, found.rect.y, found.rect.width, found.rect.height]
            .map(|v| v.to_num::<f64>());
        for (b, truth) in boxes.iter().enumerate() {
            let dx = (x + w / 2.0 - truth.left - truth.width / 2.0).abs();
            let dy = (y + h / 2.0 - truth.top - truth.height / 2.0).abs();
            let size = ((w * h) / (truth.width * truth.height)).sqrt();
            let near = dx <= truth.width * 0.75 && dy <= truth.height * 0.75;
            if near && (1.0 / 3.0..=3.0).contains(&size) {
                pairs.push((dx.hypot(dy), t, b));
            }
        }
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    for (_, t, b) in pairs {
        if right[t].is_none() && !right.contains(&Some(b)) {
            right[t] = Some(b);
        }
    }
    right
}

/// A target of a collision flight.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Collision {
    /// The flight.
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

/// How many flights these are of.
fn flights<'c>(collisions: impl Iterator<Item = &'c Collision>) -> u64 {
    collisions.map(|c| c.flight.as_str()).collect::<BTreeSet<_>>().len() as u64
}

/// The figures of all clips together.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figures {
    /// Share of the targets' frames covered by the target's most frequent track.
    pub continuity: f64,
    /// How often a target's track was followed by another one.
    pub id_switches: u64,
    /// Confirmed tracks that were less than half of the time on an object, per minute of flight.
    pub false_tracks_per_minute: f64,
    /// Median and 95th percentile of the angle between track and target, in degrees.
    pub bearing_error_deg: [f64; 2],
    /// Share of the tracked frames in the last 4 s before contact in which the time to contact was known.
    pub time_known: f64,
    /// Median absolute error of the time to contact there, in seconds.
    pub time_error_s: f64,
    /// The same in parts of the true time.
    pub time_error_share: f64,
    /// Root mean square of that error over the stated one; 1 is honest.
    pub time_error_over_sigma: f64,
    /// Targets of collision flights that were over 16 px with 2 s to contact or more.
    pub to_warn: u64,
    /// Of these, warned at least 2 s before contact.
    pub warned_in_time: u64,
    /// Median of the time to contact at the first warning, in seconds.
    pub warned_before_s: f64,
    /// Flights with such a target.
    pub flights_to_warn: u64,
    /// Of these, flights that warned of one in time.
    pub flights_warned_in_time: u64,
    /// Flights without a collision.
    pub others: u64,
    /// Flights that raised a warning without a collision course.
    pub false_warnings: u64,
    /// The targets of collision flights.
    pub collisions: Vec<Collision>,
    /// The flights of `false_warnings`.
    pub falsely_warned: Vec<String>,
}

impl Figures {
    /// Of clips.
    pub fn new(clips: &[ClipResult]) -> Self {
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
        let falsely: Vec<String> = clips
            .iter()
            .filter(|c| c.false_warning)
            .map(|c| format!("{} {}", c.name, c.kind))
            .collect();
        Self {
            continuity: covered as f64 / frames.max(1) as f64,
            id_switches: targets().map(|t| t.switches).sum(),
            false_tracks_per_minute: false_tracks as f64 * 60.0 / seconds.max(1e-3),
            bearing_error_deg: [quantile(bearing.clone(), 0.5), quantile(bearing, 0.95)],
            time_known: known.len() as f64 / times().count().max(1) as f64,
            time_error_s: quantile(known.iter().map(|k| k.1).collect(), 0.5),
            time_error_share: quantile(known.iter().map(|k| k.1 / k.0).collect(), 0.5),
            time_error_over_sigma: (honest / known.len().max(1) as f64).sqrt(),
            to_warn: must().count() as u64,
            warned_in_time: in_time().count() as u64,
            flights_to_warn: flights(must()),
            flights_warned_in_time: flights(in_time()),
            warned_before_s: quantile(warned, 0.5),
            others: clips.iter().filter(|c| c.kind != "collision").count() as u64,
            false_warnings: falsely.len() as u64,
            collisions,
            falsely_warned: falsely,
        }
    }
}

/// The value below which this share of all lies; 0 of none.
fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let index = (values.len().saturating_sub(1) as f64 * share).round() as usize;
    values.get(index).copied().unwrap_or(0.0)
}

impl fmt::Display for Figures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "track_continuity: {:.3}", self.continuity)?;
        writeln!(f, "id_switches: {}", self.id_switches)?;
        writeln!(f, "false_tracks_per_minute: {:.2}", self.false_tracks_per_minute)?;
        let [half, most] = self.bearing_error_deg;
        writeln!(f, "bearing_error_deg: median {half:.3}, 95 % {most:.3}")?;
        writeln!(
            f,
            "time_to_contact_last_4_s: known {:.3}, error median {:.2} s ({:.0} %), rms error over sigma {:.2}",
            self.time_known,
            self.time_error_s,
            self.time_error_share * 100.0,
            self.time_error_over_sigma
        )?;
        writeln!(
            f,
            "warned_2_s_before_contact: {} of {} flights, {} of {} targets, at {:.2} s (median)",
            self.flights_warned_in_time,
            self.flights_to_warn,
            self.warned_in_time,
            self.to_warn,
            self.warned_before_s
        )?;
        write!(f, "false_warnings: {} of {} other flights", self.false_warnings, self.others)?;
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
