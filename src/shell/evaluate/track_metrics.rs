//! Tracks and alerts of one clip against its ground truth.

use super::score::{WARMUP, must_be_found};
use crate::camera::Camera;
use crate::camera::attitude::Attitude;
use crate::camera::attitude_buffer::AttitudeBuffer;
use crate::detector::detection::Detection;
use crate::math::real::{PI, Real};
use crate::registration::global_motion::GlobalMotion;
use crate::shell::error::Error;
use crate::shell::formats::camera_file::{CameraFile, number};
use crate::shell::formats::class::Class;
use crate::shell::formats::clips::{Clip, TruthBox};
use crate::shell::formats::error::FormatError;
use crate::shell::formats::truth::{self, FrameTruth};
use crate::tracking::traffic::{AlertLevel, Traffic};
use crate::tracking::{TrafficMonitor, TrafficSettings};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::format;
use std::string::{String, ToString};
use std::vec::Vec;

/// Seconds before contact at which the warning must be there.
pub const MUST_WARN_TIME: f64 = 2.0;

/// Times to contact that are compared, in seconds.
const COMPARED: f64 = 4.0;

/// Settings of tracking clips.
#[derive(Debug, Clone, Copy)]
pub struct FollowSettings {
    /// Settings of tracker and alerts.
    pub tracking: TrafficSettings,
    /// Whether to use the attitudes of `truth.csv`.
    pub with_attitude: bool,
    /// Horizontal field of view that is assumed without `camera.json`, degrees.
    pub assumed_fov: f64,
    /// Whether a `camera.json` or `truth.csv` that is not understood is an error; else it is as if not there.
    pub strict: bool,
}

/// Follows the objects of one clip and keeps what its figures need.
#[derive(Debug)]
pub struct ClipWatch<'a> {
    clip: &'a Clip,
    settings: FollowSettings,
    camera: Option<CameraFile>,
    truth: BTreeMap<u64, FrameTruth>,
    attitudes: Option<AttitudeBuffer>,
    /// Made with the first frame, whose size it needs.
    watch: Option<TrafficMonitor>,
    targets: BTreeMap<i64, TargetResult>,
    tracks: BTreeMap<u16, TrackResult>,
    result: ClipTracks,
}

/// A target over a clip.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct TargetResult {
    /// Frames in which it must be found.
    pub frames: u64,
    /// Of these, frames by the track that covered it.
    pub covered: BTreeMap<u16, u64>,
    last: Option<u16>,
    /// Changes from one track to another.
    pub switches: u64,
    /// Longest side while there was time to warn, in pixels.
    pub longest: f64,
    /// Time to contact at the first warning, in seconds.
    pub warned: Option<f64>,
    /// Time to contact where the recording ends, in seconds.
    pub end: f64,
}

/// A confirmed track over a clip.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub struct TrackResult {
    /// Frames in which it was confirmed.
    pub frames: u64,
    /// Frames on a labelled object of any kind.
    pub right: u64,
    /// Frames on a bird.
    pub on_bird: u64,
    /// Number of rises to caution.
    pub cautions: u64,
    /// Number of rises to warning.
    pub warnings: u64,
    /// Level in the last frame; of no use after it.
    #[serde(skip)]
    pub level: AlertLevel,
}

impl TrackResult {
    /// Whether it was less than half of its frames on an object.
    pub fn is_false(&self) -> bool {
        2 * self.right < self.frames
    }

    /// Whether it was half of its frames or more on a bird.
    pub fn is_bird(&self) -> bool {
        2 * self.on_bird >= self.frames
    }
}

/// One frame of a target whose distance is known.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RangeSample {
    /// Number of the target.
    pub id: i64,
    /// Distance between camera and target, metres.
    pub range_m: f64,
    /// Whether a confirmed track was on it.
    pub tracked: bool,
}

/// Figures of a clip.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct ClipTracks {
    /// Name of the clip.
    pub name: String,
    /// Kind of encounter; empty where not known.
    pub kind: String,
    /// Time of the last frame, seconds.
    pub seconds: f64,
    /// Whether there was no `camera.json`, so that the field of view is assumed.
    pub assumed_camera: bool,
    /// Whether the attitude was known.
    pub with_attitude: bool,
    /// Targets by number; birds are none.
    pub targets: Vec<(i64, TargetResult)>,
    /// Tracks that were confirmed at any time.
    pub tracks: Vec<TrackResult>,
    /// Confirmed tracks that were on no object most of the time.
    pub false_tracks: u64,
    /// Whether it warned without a collision course.
    pub false_warning: bool,
    /// Angles between tracks and targets, degrees.
    pub bearing: Vec<f64>,
    /// True time to contact, the estimate and its error where it is known.
    pub times: Vec<(f64, Option<(f64, f64)>)>,
    /// One sample a frame and target whose distance is known.
    pub ranges: Vec<RangeSample>,
}

impl<'a> ClipWatch<'a> {
    /// Reads `camera.json` and `truth.csv` of the clip, where there are any.
    ///
    /// # Errors
    /// [`Error`] naming the file and the field.
    pub fn new(
        clip: &'a Clip,
        kind: Option<&str>,
        settings: FollowSettings,
    ) -> Result<Self, Error> {
        let camera = match CameraFile::beside(&clip.directory) {
            Err(error) if settings.strict => return Err(error.into()),
            camera => camera.unwrap_or_default(),
        };
        let path = clip.directory.join("truth.csv");
        let truth = match path.is_file().then(|| truth::read(&path)) {
            Some(Err(error)) if settings.strict => return Err(error.into()),
            Some(Ok(truth)) => truth,
            _ => BTreeMap::new(),
        };
        let known = settings.with_attitude && !truth.is_empty();
        let kind = kind.map(ToString::to_string).or_else(|| camera.as_ref()?.kind.clone());
        let result = ClipTracks {
            name: clip.name.clone(),
            kind: kind.unwrap_or_default(),
            assumed_camera: camera.is_none(),
            with_attitude: known,
            ..ClipTracks::default()
        };
        Ok(Self {
            clip,
            settings,
            camera,
            truth,
            attitudes: known.then(AttitudeBuffer::new),
            watch: None,
            targets: BTreeMap::new(),
            tracks: BTreeMap::new(),
            result,
        })
    }

    /// The camera for frames of this size: that of `camera.json`, else one of the assumed field of view.
    fn camera(&self, (width, height): (usize, usize)) -> Result<Camera, Error> {
        let path = self.clip.directory.join("camera.json");
        let wrong = |reason| Error::from(FormatError::Camera { path: path.clone(), reason });
        match &self.camera {
            Some(file)
                if self.settings.strict
                    && (file.width as usize, file.height as usize) != (width, height) =>
            {
                Err(wrong(format!(
                    "it is of {}x{}, the frames are {width}x{height}; calibrate at their size",
                    file.width, file.height
                )))
            }
            Some(file) if (file.width as usize, file.height as usize) == (width, height) => {
                file.camera().map_err(wrong)
            }
            _ => {
                let view = number("fov", self.settings.assumed_fov).map_err(wrong)? * PI / 180;
                Camera::from_field_of_view(width as u32, height as u32, view)
                    .map_err(|e| wrong(e.to_string()))
            }
        }
    }

    /// The objects followed in frame `number`, from 1, of frames of `size`.
    ///
    /// # Errors
    /// [`FormatError::Camera`] where `camera.json` does not fit the first frame.
    pub fn frame(
        &mut self,
        number: u64,
        time_us: i64,
        size: (usize, usize),
        found: &[Detection],
        motion: &GlobalMotion,
    ) -> Result<(), Error> {
        let none = FrameTruth::default();
        let truth = self.truth.get(&number).unwrap_or(&none);
        if let Some(attitudes) = &mut self.attitudes {
            attitudes.push(time_us, attitude(truth.attitude));
        }
        if self.watch.is_none() {
            self.watch = Some(TrafficMonitor::new(self.settings.tracking, self.camera(size)?));
        }
        let Some(watch) = &mut self.watch else { return Ok(()) };
        let empty = AttitudeBuffer::new();
        let attitudes = self.attitudes.as_ref().unwrap_or(&empty);
        let traffic = watch.update(found, time_us, motion, attitudes);
        self.result.seconds = time_us as f64 / 1e6;
        if number <= WARMUP {
            return Ok(());
        }
        let boxes = self.clip.ground_truth.frame(number);
        let traffic: Vec<&Traffic> = traffic.iter().filter(|t| t.confirmed).collect();
        let right = assign(boxes, &traffic);
        for (traffic, right) in traffic.iter().zip(&right) {
            let track = self.tracks.entry(traffic.id).or_default();
            let bird = right.is_some_and(|index| boxes[index].class == Class::Bird);
            track.frames += 1;
            track.right += u64::from(right.is_some());
            track.on_bird += u64::from(bird);
            let rose = |level| track.level < level && traffic.level >= level;
            track.cautions += u64::from(rose(AlertLevel::Caution));
            track.warnings += u64::from(rose(AlertLevel::Warning));
            track.level = traffic.level;
        }
        for (index, target) in boxes.iter().enumerate().filter(|(_, t)| t.class != Class::Bird) {
            let known = truth.targets.iter().find(|t| t.id == target.id);
            let found = right.iter().position(|r| *r == Some(index)).map(|i| traffic[i]);
            self.result.target(self.targets.entry(target.id).or_default(), target, known, found);
            if let (Some(known), Some(found), true) = (known, found, self.attitudes.is_some()) {
                self.result.bearing.push(degrees_between(found, truth.attitude, known));
            }
        }
        Ok(())
    }

    /// Figures of the clip.
    pub fn finish(self) -> ClipTracks {
        let collision = self.result.kind == "collision";
        let wrong = |t: &TrackResult| !collision || t.is_false() || t.is_bird();
        let tracks: Vec<TrackResult> = self.tracks.into_values().collect();
        ClipTracks {
            false_tracks: tracks.iter().filter(|t| t.is_false()).count() as u64,
            false_warning: tracks.iter().any(|t| t.warnings > 0 && wrong(t)),
            targets: self.targets.into_iter().collect(),
            tracks,
            ..self.result
        }
    }
}

impl ClipTracks {
    fn target(
        &mut self,
        result: &mut TargetResult,
        target: &TruthBox,
        known: Option<&truth::TargetRow>,
        found: Option<&Traffic>,
    ) {
        if must_be_found(target) {
            result.frames += 1;
        }
        if let Some(known) = known.filter(|_| target.visibility >= 1.0) {
            let (id, range_m) = (target.id, known.range);
            self.ranges.push(RangeSample { id, range_m, tracked: found.is_some() });
        }
        let time = known.and_then(|known| known.time_to_contact);
        result.end = time.unwrap_or(result.end);
        if time.is_some_and(|time| time >= MUST_WARN_TIME) {
            result.longest = result.longest.max(target.longer_side());
        }
        if let Some(found) = found {
            if must_be_found(target) {
                *result.covered.entry(found.id).or_default() += 1;
            }
            if result.last.is_some_and(|last| last != found.id) {
                result.switches += 1;
            }
            result.last = Some(found.id);
            if found.level == AlertLevel::Warning && result.warned.is_none() {
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
fn degrees_between(found: &Traffic, angles: [f64; 3], known: &truth::TargetRow) -> f64 {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shell::formats::clips;
    use std::fs;

    fn follow(text: &str, extra: &[(&str, &str)], strict: bool) -> Result<ClipTracks, String> {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("gt.txt"), text).unwrap();
        fs::write(folder.path().join("1.png"), "").unwrap();
        for (name, text) in extra {
            fs::write(folder.path().join(name), text).unwrap();
        }
        let clip = clips::clip(folder.path()).unwrap();
        let tracking = TrafficSettings::default();
        let settings = FollowSettings { tracking, with_attitude: true, assumed_fov: 60.0, strict };
        let words = |error: Error| error.to_string();
        let mut watch = ClipWatch::new(&clip, Some("collision"), settings).map_err(words)?;
        for number in 1..=6 {
            let time_us = number as i64 * 33_333;
            watch.frame(number, time_us, (64, 48), &[], &GlobalMotion::IDENTITY).map_err(words)?;
        }
        Ok(watch.finish())
    }

    #[test]
    fn birds_of_a_collision_flight_are_no_targets() {
        let rows = (1..=6).map(|f| format!("{f},1,10,10,20,20,1,1,1\n{f},2,40,10,20,20,1,4,1\n"));
        let tracks = follow(&rows.collect::<String>(), &[], true).unwrap();
        let numbers: Vec<i64> = tracks.targets.iter().map(|(id, _)| *id).collect();
        assert_eq!(numbers, [1]);
        assert_eq!(tracks.targets[0].1.frames, 3);
    }

    #[test]
    fn clips_without_camera_are_followed() {
        let tracks = follow("1,1,10,10,20,20\n", &[], true).unwrap();
        assert!(tracks.assumed_camera && !tracks.with_attitude);
        let other = r#"{"fps": 10, "kind": "hover"}"#;
        let error = follow("", &[("camera.json", other)], true).unwrap_err();
        assert!(error.contains("camera.json") && error.contains("width"), "{error}");
        assert!(follow("", &[("camera.json", other)], false).unwrap().assumed_camera);
        let large = r#"{"width": 640, "height": 480, "fx": 500, "fy": 500, "cx": 320, "cy": 240}"#;
        let error = follow("", &[("camera.json", large)], true).unwrap_err();
        assert!(error.contains("640x480, the frames are 64x48"), "{error}");
        assert!(follow("", &[("camera.json", large)], false).is_ok());
    }

    #[test]
    fn a_track_on_a_bird_is_no_false_track_but_its_warning_is_false() {
        let bird = TrackResult { frames: 10, right: 9, on_bird: 9, ..TrackResult::default() };
        assert!(bird.is_bird() && !bird.is_false());
        let target = TrackResult { frames: 10, right: 9, on_bird: 1, ..TrackResult::default() };
        assert!(!target.is_bird() && !target.is_false());
        assert!(TrackResult { frames: 10, right: 4, ..TrackResult::default() }.is_false());
    }
}
