//! What is kept and shown beside the links: event log, recording, page.

use super::capture::Camera;
use super::config::Config;
use super::events::Events;
use super::keys::Key;
use super::record::Recorder;
use super::worker::Seen;
use crate::mavlink::lookout::Onboard;
use crate::mavlink::messages::Blind;
use crate::mavlink::messages::status::State;
use crate::shell::error::Error;
use crate::shell::formats::camera_file::CameraFile;
use crate::shell::link::{Inbound, Links};
use crate::shell::preview::{Preview, Snapshot, snapshot};
use crate::shell::support::clock::now_us;
use crate::tracking::traffic::Traffic;
use mavlink_core::MAVLinkV2MessageRaw;
use std::format;
use std::string::String;
use std::vec::Vec;

/// How it is, for the page.
#[derive(Debug, Clone)]
pub struct Condition {
    /// As the heartbeat tells it.
    pub state: State,
    /// Why nothing can be seen, if so.
    pub blind: Blind,
    /// The source.
    pub camera: Camera,
    /// Frames looked at, left out, and looked at a second.
    pub frames: (u64, u32, f64),
    /// Stages of the work: name, median, 99th percentile in microseconds.
    pub latency: Vec<(&'static str, i64, i64)>,
}

/// The three of them, each where the settings ask for it.
#[derive(Default)]
pub struct Outputs {
    events: Option<Events>,
    recorder: Option<Recorder>,
    preview: Option<Preview>,
    /// Least score of the detections that are recorded.
    least_score: i32,
    /// What the page shows, less the picture.
    shown: Snapshot,
}

impl Outputs {
    /// Opens what the settings ask for; `own` is what the source knows of its camera, `least_score` the detector's.
    ///
    /// # Errors
    /// [`FileError::Write`], [`Error::Preview`].
    pub fn open(
        config: &Config,
        own: Option<&CameraFile>,
        least_score: i32,
    ) -> Result<Self, Error> {
        let mut outputs = Self { least_score, ..Self::default() };
        outputs.open_events(config)?;
        outputs.open_recorder(config, own)?;
        outputs.open_preview(config)?;
        Ok(outputs)
    }

    fn open_events(&mut self, config: &Config) -> Result<(), Error> {
        // What was open is complete before it is opened again, here and below.
        self.events = None;
        let bytes = config.event_log_megabytes.saturating_mul(1_000_000);
        let open = |path| Events::open(path, bytes).map_err(Error::write(path));
        self.events = config.event_log.as_deref().map(open).transpose()?;
        Ok(())
    }

    fn open_recorder(&mut self, config: &Config, own: Option<&CameraFile>) -> Result<(), Error> {
        self.recorder = None;
        let score = self.least_score;
        let open = |path| Recorder::open(path, config, own, score).map_err(Error::write(path));
        self.recorder = config.record.as_deref().map(open).transpose()?;
        Ok(())
    }

    fn open_preview(&mut self, config: &Config) -> Result<(), Error> {
        self.preview = None;
        let start = |address| Preview::start(address, config.preview_token.clone());
        self.preview = config.preview.map(start).transpose().map_err(Error::verb)?;
        if let Some(preview) = &self.preview {
            tracing::info!("page: http://{}/", preview.address());
        }
        Ok(())
    }

    /// Opens anew what the changed settings are about. What fails is told, and stays off.
    pub fn reload(&mut self, config: &Config, own: Option<&CameraFile>, changes: &[&Key]) {
        let about = |prefix: &str| changes.iter().any(|key| key.name.starts_with(prefix));
        let events = if about("event_log") { self.open_events(config) } else { Ok(()) };
        let recorder =
            about("record") || (self.recorder.is_some() && (about("camera.") || about("source")));
        let recorder = if recorder { self.open_recorder(config, own) } else { Ok(()) };
        let preview = if about("preview") { self.open_preview(config) } else { Ok(()) };
        for error in [events, recorder, preview].into_iter().filter_map(Result::err) {
            tracing::error!("{error}");
        }
    }

    /// Takes a message that was heard.
    pub fn heard(&mut self, heard: &Inbound) {
        if let Some(recorder) = &mut self.recorder {
            recorder.heard(&heard.frame, heard.time_us);
        }
    }

    /// Takes a message that was sent.
    pub fn said(&mut self, frame: &MAVLinkV2MessageRaw, now_us: i64) {
        if let Some(events) = &mut self.events {
            events.said(frame, now_us);
        }
        if let Some(recorder) = &mut self.recorder {
            recorder.message(now_us, frame.raw_bytes(), false);
        }
    }

    /// Takes a frame, its number in the run, and what is followed in it.
    pub fn see(&mut self, seen: &Seen, tracks: &[Traffic], onboard: &Onboard, number: u64) {
        if let Some(events) = &mut self.events {
            events.see(seen, tracks, onboard, number);
        }
        if let Some(recorder) = &mut self.recorder {
            recorder.see(seen, tracks, onboard.component().parameters(), number);
        }
        let Some(preview) = &self.preview else { return };
        let frame = &seen.frame;
        let picture = preview.wants_picture().then(|| snapshot::Picture {
            pixels: frame.pixels.clone(),
            width: frame.width,
            height: frame.height,
        });
        self.shown.time_us = frame.time_us;
        self.shown.level = tracks.iter().map(|track| track.level).max().unwrap_or_default();
        let component = onboard.component();
        self.shown.tracks =
            tracks.iter().map(|track| snapshot::Track::named(track, component)).collect();
        preview.publish(Snapshot { picture, ..self.shown.clone() });
    }

    /// Time goes on, and with it what waits.
    pub fn tick(&mut self, now_us: i64) {
        if let Some(events) = &mut self.events {
            events.tick(now_us);
        }
    }

    /// Shows how it is; once a second, also without frames.
    pub fn show(&mut self, condition: Condition, source: &str, onboard: &Onboard, links: &Links) {
        let Some(preview) = &self.preview else { return };
        let shown = &mut self.shown;
        let Condition { state, blind, camera, frames, latency } = condition;
        if state == State::Stalled {
            shown.tracks.clear();
            shown.level = crate::tracking::traffic::Level::None;
        }
        let size = onboard.camera().intrinsics();
        let words = match &camera {
            Camera::Opening => format!("{source}: opening"),
            Camera::Running => format!("{source}, {}x{}", size.width, size.height),
            Camera::Gone(reason) => reason.clone(),
            Camera::Ended => format!("{source}: at its end"),
        };
        shown.health = snapshot::Health {
            state: match state {
                State::Starting => snapshot::State::Starting,
                State::Watching | State::NoAutopilot => snapshot::State::Watching,
                State::Blind(_) => snapshot::State::Blind,
                State::Stalled => snapshot::State::CameraGone,
            },
            blind,
            frames: frames.0,
            dropped: frames.1.into(),
            frames_per_second: frames.2,
            camera: words,
        };
        let milliseconds = |us: i64| us as f64 / 1000.0;
        let line = |(stage, p50, p99): (&str, i64, i64)| snapshot::Latency {
            stage: String::from(stage),
            p50_ms: milliseconds(p50),
            p99_ms: milliseconds(p99),
        };
        shown.latency = latency.into_iter().map(line).collect();
        let statuses = links.specs().zip((0..u8::MAX).map(|link| links.status(link)));
        let now_us = now_us();
        let link = |(spec, status)| snapshot::Link::new(spec, status, now_us);
        shown.links = statuses.map(link).collect();
        let component = onboard.component();
        shown.autopilot =
            component.last_served().map(|served| format!("system {}", served.system_id));
        shown.autopilot_lost = component.autopilot().is_none() && component.last_served().is_some();
        shown.parameters = snapshot::ParameterLine::all(component.parameters());
        shown.look_through(onboard.camera());
        preview.publish(shown.clone());
    }
}
