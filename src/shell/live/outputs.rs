//! Secondary outputs: event log, recording, page, lines of JSON.
//!
//! Their failures never stop detection: an output that cannot be opened is logged and tried again.

use super::capture::CaptureState;
use super::config::ServiceConfig;
use super::events::EventLog;
use super::json_stream::{self, JsonStream};
use super::keys::Key;
use super::record::Recorder;
use super::worker::ProcessedFrame;
use crate::mavlink::lookout::Lookout;
use crate::mavlink::messages::Blind;
use crate::mavlink::messages::status::LookoutState;
use crate::shell::error::Error;
use crate::shell::formats::camera_file::CameraFile;
use crate::shell::link::{Inbound, Links};
use crate::shell::preview::{Preview, Snapshot, snapshot};
use crate::shell::support::clock::now_us;
use crate::tracking::traffic::Traffic;
use mavlink_core::MAVLinkV2MessageRaw;
use std::format;
use std::string::{String, ToString};
use std::vec::Vec;

/// Time between two attempts to open an output, microseconds.
const AGAIN_US: i64 = 1_000_000;

/// State of the lookout, for the page.
#[derive(Debug, Clone)]
pub struct Condition {
    /// As in the heartbeat.
    pub state: LookoutState,
    /// Why nothing can be seen, if so.
    pub blind: Blind,
    /// State of the source.
    pub camera: CaptureState,
    /// Frames processed and dropped, and frames processed a second.
    pub frames: (u64, u32, f64),
    /// Stages of the work: name, median, 99th percentile in microseconds.
    pub latency: Vec<(&'static str, i64, i64)>,
    /// Advice where the detector is too slow for the frame rate.
    pub advice: Option<String>,
}

/// One output.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum OutputKind {
    Events,
    Recorder,
    Preview,
    Json,
}

impl OutputKind {
    const ALL: [Self; 4] = [Self::Events, Self::Recorder, Self::Preview, Self::Json];

    fn name(self) -> &'static str {
        match self {
            Self::Events => "event log",
            Self::Recorder => "recording",
            Self::Preview => "page",
            Self::Json => "json",
        }
    }
}

/// The outputs, each open where the settings name it.
pub struct ServiceOutputs {
    config: ServiceConfig,
    /// The camera file of the source.
    own: Option<CameraFile>,
    /// Least score of the detections that are recorded.
    least_score: i32,
    events: Option<EventLog>,
    recorder: Option<Recorder>,
    preview: Option<Preview>,
    json: Option<JsonStream>,
    /// Whether the last attempt to open failed, by [`OutputKind`], and when the next one is due.
    failed: [bool; OutputKind::ALL.len()],
    next_us: i64,
    /// State for the page, without the picture.
    shown: Snapshot,
}

impl ServiceOutputs {
    /// Opens what the settings name. `own` is the camera file of the source, `least_score` the detector's.
    pub fn open(config: &ServiceConfig, own: Option<&CameraFile>, least_score: i32) -> Self {
        let mut outputs = Self {
            config: config.clone(),
            own: own.cloned(),
            least_score,
            events: None,
            recorder: None,
            preview: None,
            json: None,
            failed: Default::default(),
            next_us: 0,
            shown: Snapshot::default(),
        };
        OutputKind::ALL.into_iter().for_each(|kind| outputs.reopen(kind));
        outputs
    }

    /// Whether the last attempt to open an output failed.
    #[cfg_attr(not(test), expect(clippy::indexing_slicing, reason = "as many places as kinds"))]
    fn failed(&mut self, kind: OutputKind) -> &mut bool {
        &mut self.failed[kind as usize]
    }

    /// Opens an output anew; the first failure in a row is logged, and the success after it.
    fn reopen(&mut self, kind: OutputKind) {
        let opened = match kind {
            OutputKind::Events => self.open_events(),
            OutputKind::Recorder => self.open_recorder(),
            OutputKind::Preview => self.open_preview(),
            OutputKind::Json => self.open_json(),
        };
        let failed = std::mem::replace(self.failed(kind), opened.is_err());
        match opened {
            Err(error) if !failed => {
                tracing::error!("{}: {error}; tried again every second", kind.name());
            }
            Ok(()) if failed => tracing::info!("{}: open", kind.name()),
            _ => {}
        }
    }

    fn open_events(&mut self) -> Result<(), Error> {
        // The one that was open is complete before it is opened again, here and below.
        self.events = None;
        let bytes = self.config.event_log_megabytes.saturating_mul(1_000_000);
        let open = |path| EventLog::open(path, bytes).map_err(Error::write(path));
        self.events = self.config.event_log.as_deref().map(open).transpose()?;
        Ok(())
    }

    fn open_recorder(&mut self) -> Result<(), Error> {
        self.recorder = None;
        let (config, own, score) = (&self.config, self.own.as_ref(), self.least_score);
        let open = |path| Recorder::open(path, config, own, score).map_err(Error::write(path));
        self.recorder = config.record.as_deref().map(open).transpose()?;
        Ok(())
    }

    fn open_preview(&mut self) -> Result<(), Error> {
        self.preview = None;
        let token = &self.config.preview_token;
        let start = |address| Preview::start(address, token.clone());
        self.preview = self.config.preview.map(start).transpose().map_err(Error::verb)?;
        if let Some(preview) = &self.preview {
            tracing::info!("page: http://{}/", preview.address());
        }
        Ok(())
    }

    fn open_json(&mut self) -> Result<(), Error> {
        self.json = None;
        let place = self.config.json.as_deref().and_then(|text| json_stream::address(text).ok());
        self.json = place.map(JsonStream::open).transpose().map_err(Error::verb)?;
        Ok(())
    }

    /// Opens anew what the changed settings are about, and what failed before.
    pub fn reload(&mut self, config: &ServiceConfig, own: Option<&CameraFile>, changes: &[&Key]) {
        self.config = config.clone();
        self.own = own.cloned();
        let about = |prefix: &str| changes.iter().any(|key| key.name.starts_with(prefix));
        let source = self.recorder.is_some() && (about("camera.") || about("source"));
        for kind in OutputKind::ALL {
            let changed = match kind {
                OutputKind::Events => about("event_log"),
                OutputKind::Recorder => about("record") || source,
                OutputKind::Preview => about("preview"),
                OutputKind::Json => about("json"),
            };
            if changed || *self.failed(kind) {
                self.reopen(kind);
            }
        }
    }

    /// Whether frames should be recorded and are not.
    pub fn is_recording_lost(&self) -> bool {
        let recorder = self.recorder.as_ref();
        self.config.record.is_some() && recorder.is_none_or(Recorder::is_failing)
    }

    /// Takes a received message.
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
    pub fn see(
        &mut self,
        seen: &ProcessedFrame,
        tracks: &[Traffic],
        onboard: &Lookout,
        number: u64,
    ) {
        if let Some(events) = &mut self.events {
            events.see(seen, tracks, onboard, number);
        }
        if let Some(recorder) = &mut self.recorder {
            recorder.see(seen, tracks, onboard.component().parameters(), number);
        }
        if let Some(json) = &mut self.json {
            json.see(seen, tracks, number);
        }
        let Some(preview) = &self.preview else { return };
        let frame = &seen.frame;
        let picture = preview.wants_picture().then(|| snapshot::PictureView {
            pixels: frame.pixels.clone(),
            width: frame.width,
            height: frame.height,
        });
        self.shown.time_us = frame.time_us;
        self.shown.level = tracks.iter().map(|track| track.level).max().unwrap_or_default();
        let component = onboard.component();
        self.shown.tracks =
            tracks.iter().map(|track| snapshot::TrackView::named(track, component)).collect();
        preview.publish(Snapshot { picture, ..self.shown.clone() });
    }

    /// Writes events whose delay has elapsed, and tries again what could not be opened.
    pub fn tick(&mut self, now_us: i64) {
        if let Some(events) = &mut self.events {
            events.tick(now_us);
        }
        if self.failed.contains(&true) && now_us >= self.next_us {
            self.next_us = now_us + AGAIN_US;
            for kind in OutputKind::ALL {
                if *self.failed(kind) {
                    self.reopen(kind);
                }
            }
        }
    }

    /// Shows how it is; once a second, also without frames.
    pub fn show(&mut self, condition: Condition, source: &str, onboard: &Lookout, links: &Links) {
        let Some(preview) = &self.preview else { return };
        let shown = &mut self.shown;
        let Condition { state, blind, camera, frames, latency, advice } = condition;
        if matches!(state, LookoutState::Stalled | LookoutState::Slow) {
            shown.tracks.clear();
            shown.level = crate::tracking::traffic::AlertLevel::None;
        }
        let size = onboard.camera().intrinsics();
        let words = match &camera {
            CaptureState::Opening => format!("{source}: opening"),
            CaptureState::Running => format!("{source}, {}x{}", size.width, size.height),
            CaptureState::Gone(reason) => reason.clone(),
            CaptureState::Ended => format!("{source}: at its end"),
        };
        shown.health = snapshot::HealthView {
            state: match state {
                LookoutState::Starting => snapshot::StateView::Starting,
                LookoutState::Watching | LookoutState::NoAutopilot => snapshot::StateView::Watching,
                LookoutState::Blind(_) => snapshot::StateView::Blind,
                LookoutState::Stalled | LookoutState::Ending => snapshot::StateView::CameraGone,
                LookoutState::Slow => snapshot::StateView::Slow,
            },
            blind,
            frames: frames.0,
            dropped: frames.1.into(),
            frames_per_second: frames.2,
            camera: words,
            advice,
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
        let link = |(spec, status)| snapshot::LinkView::new(spec, status, now_us);
        shown.links = statuses.map(link).collect();
        let component = onboard.component();
        shown.autopilot =
            component.last_served().map(|served| format!("system {}", served.system_id));
        shown.autopilot_lost = component.autopilot().is_none() && component.last_served().is_some();
        shown.off_map = onboard.placing().current().map(|cause| cause.to_string());
        shown.parameters = snapshot::ParameterLine::all(component.parameters());
        shown.look_through(onboard.camera_on_vehicle().as_ref());
        preview.publish(shown.clone());
    }
}
