//! Main loop of `lookout run`: detections and received messages in, messages out.
//!
//! Three threads share the work: capture, detector, and this one, which tracks, assesses threats and sends messages. It
//! waits for neither of them, nor for a link or a disk, which have threads of their own.

use super::capture::{Capture, CaptureState};
use super::components::{component, parameters, specs};
use super::config::ServiceConfig;
use super::notify::Notify;
use super::outputs::{Condition, ServiceOutputs};
use super::pace::Pace;
use super::source::{self, OpenSource};
use super::summary::{ServiceSummary, state_in_words};
use super::worker::{self, ProcessedFrame};
use crate::mavlink::component::parameters::Parameters;
use crate::mavlink::lookout::Lookout;
use crate::mavlink::messages::Blind;
use crate::mavlink::messages::status::LookoutState;
use crate::mavlink::messages::text::Notice;
use crate::shell::error::Error;
use crate::shell::formats::camera_file::CameraFile;
use crate::shell::link::{Inbound, Links, params};
use crate::shell::pipeline::{self, DetectorArgs, ModelFile};
use crate::shell::replay::telemetry::{self, signing_with};
use crate::shell::support::clock::now_us;
use crate::shell::support::interrupt::ServiceOrders;
use crate::shell::support::keeper::Keeper;
use crate::tracking::tracker;
use crossbeam_channel::{Receiver, bounded, select};
use std::format;
use std::io;
use std::panic::resume_unwind;
use std::string::{String, ToString};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

/// Why the service cannot start.
#[derive(Debug, thiserror::Error)]
pub enum ServiceError {
    /// A thread of a service cannot be started.
    #[error("cannot start a thread: {source}; end other programs, or raise the limit of tasks")]
    Thread {
        /// The system's reason.
        source: io::Error,
    },
}

impl From<ServiceError> for Error {
    fn from(error: ServiceError) -> Self {
        Self::verb(error)
    }
}

/// From one look for messages to be sent to the next.
const TICK: Duration = Duration::from_millis(20);
/// Processed frames that wait to be tracked.
const WAITING: usize = 2;
/// Time between two texts about what fails, and between two about the same, microseconds: one that was sent before a
/// link was open is lost.
const NOTICE_US: i64 = 1_000_000;
const NOTICE_AGAIN_US: i64 = 60_000_000;
/// From one line about the state to the next, microseconds.
const STATUS_US: i64 = 1_000_000;

/// Runs until `control` orders the end, or to the end of a recorded flight. `reread` reads the settings again for a reload.
///
/// # Errors
/// [`Error`]: what can be known to be wrong at the start, and a file that cannot be read further.
pub fn run(
    config: ServiceConfig,
    reread: &dyn Fn() -> Result<ServiceConfig, Error>,
    control: &ServiceOrders,
    open: &OpenSource,
) -> Result<ServiceSummary, Error> {
    let file = ModelFile::load(config.model.as_deref())?;
    let model = file.parse()?;
    let capture = Capture::default();
    let (worker_pulse, stop) = (AtomicU64::new(0), AtomicBool::new(false));
    let (sender, seen) = bounded(WAITING);
    let tracks = tracker::TrackerSettings::calibrated(model.calibration());
    let mut service = Service::new(config.clone(), tracks, &capture, &worker_pulse)?;
    let heard = service.links.heard().clone();
    let panicked = AtomicBool::new(false);
    thread::scope(|scope| {
        // However this ends, the other threads end too.
        let ending = Flag { flag: &stop, on_panic_only: false };
        let spawn = |name: &str| thread::Builder::new().name(name.into());
        let failed = |source| ServiceError::Thread { source };
        let taking = spawn("capture")
            .spawn_scoped(scope, || {
                let _flag = Flag { flag: &panicked, on_panic_only: true };
                capture.run(config.clone(), open, &heard, &stop)
            })
            .map_err(failed)?;
        let looking = || {
            // Detections below this score are used by no track.
            let threshold = Some(tracks.keep_score);
            let mask = config.camera.mask.clone();
            let args = DetectorArgs { threshold, mask, ..DetectorArgs::default() };
            let look =
                || worker::run(&model, &args, &capture.mailbox, &worker_pulse, &sender, &stop);
            let ended = pipeline::on_threads(config.threads, look)
                .unwrap_or_else(|error| Err(error.into()));
            // The loop sees that nothing comes any more.
            drop(sender);
            ended
        };
        let looking = spawn("detector").spawn_scoped(scope, looking);
        let served = match &looking {
            Ok(_) => service.serve(seen, reread, control, &panicked),
            Err(_) => Ok(()),
        };
        drop(ending);
        let taken = taking.join().unwrap_or_else(|panic| resume_unwind(panic));
        let looked = looking.map_err(failed)?.join().unwrap_or_else(|panic| resume_unwind(panic));
        let finished = service.finish();
        served.and(looked)?;
        taken?;
        finished
    })
}

/// Sets a flag when it is dropped.
struct Flag<'a> {
    flag: &'a AtomicBool,
    on_panic_only: bool,
}

impl Drop for Flag<'_> {
    fn drop(&mut self) {
        if !self.on_panic_only || thread::panicking() {
            self.flag.store(true, Ordering::Relaxed);
        }
    }
}

/// State of the main loop.
struct Service<'a> {
    config: ServiceConfig,
    own_camera: Option<CameraFile>,
    /// Size of the frames that the camera model is made for, pixels.
    size: Option<(usize, usize)>,
    capture: &'a Capture,
    /// Counters that rise while capture and detector go on, and their values when the watchdog was last fed.
    pulses: [&'a AtomicU64; 2],
    fed: [u64; 2],
    links: Links,
    onboard: Lookout,
    /// The parameters as they were last handed over to be kept, and who keeps them.
    kept: Parameters,
    keeper: Option<Keeper>,
    /// When it was last reported, microseconds, that this fails: recording, parameters, signing time.
    noticed: [Option<i64>; 3],
    noticed_us: i64,
    /// Whether a peer that signs with a time of the future was reported.
    refused_future: bool,
    outputs: ServiceOutputs,
    notify: Notify,
    summary: ServiceSummary,
    pace: Pace,
    blind: Blind,
    state: LookoutState,
    /// Frames and time of the last status.
    status: (u64, i64),
}

impl<'a> Service<'a> {
    fn new(
        config: ServiceConfig,
        tracks: tracker::TrackerSettings,
        capture: &'a Capture,
        worker_pulse: &'a AtomicU64,
    ) -> Result<Self, Error> {
        let (kept, keeper) = parameters(config.parameters.as_deref());
        let signing = config
            .signing_key
            .as_deref()
            .map(|key| signing_with(key, config.signing_time.as_deref()))
            .transpose()?;
        let links = Links::open_signed(&specs(&config), signing);
        let own_camera = source::own_camera(&config)?;
        let camera = source::first_camera(&config, own_camera.as_ref())?;
        let onboard = Lookout::new(camera, tracks, component(&config), kept, now_us());
        let state = onboard.component().state();
        let outputs = ServiceOutputs::open(&config, own_camera.as_ref(), tracks.keep_score);
        Ok(Self {
            own_camera,
            size: None,
            capture,
            pulses: [&capture.pulse, worker_pulse],
            fed: [0; 2],
            links,
            onboard,
            kept,
            keeper,
            noticed: [None; 3],
            noticed_us: i64::MIN,
            refused_future: false,
            outputs,
            notify: Notify::from_environment(),
            summary: ServiceSummary::default(),
            pace: Pace::default(),
            blind: Blind::NO,
            state,
            status: (0, now_us()),
            config,
        })
    }

    fn serve(
        &mut self,
        seen: Receiver<ProcessedFrame>,
        reread: &dyn Fn() -> Result<ServiceConfig, Error>,
        control: &ServiceOrders,
        panicked: &AtomicBool,
    ) -> Result<(), Error> {
        let inbound = self.links.inbound().clone();
        self.notify.ready();
        while !control.stop.load(Ordering::Relaxed) && !panicked.load(Ordering::Relaxed) {
            if control.reload.swap(false, Ordering::Relaxed) {
                self.notify.reloading();
                self.reload(reread);
                self.notify.ready();
            }
            select! {
                recv(seen) -> looked => match looked {
                    Ok(looked) => self.see(looked)?,
                    Err(_) => break,
                },
                recv(inbound) -> heard => heard.into_iter().for_each(|heard| self.hear(&heard)),
                default(TICK) => {}
            }
            self.speak(None);
            self.tick();
            let drained = self.capture.mailbox.is_drained(self.summary.frames);
            if self.capture.state() == CaptureState::Ended && drained {
                break;
            }
        }
        self.notify.stopping();
        // The ground learns it from us, not from a silence. The links write what they have before they end.
        self.onboard.end();
        self.speak(None);
        Ok(())
    }

    fn hear(&mut self, heard: &Inbound) {
        self.outputs.heard(heard);
        self.onboard.receive(heard.link, &heard.frame, heard.trust, heard.time_us);
        telemetry::log_events(&mut self.onboard);
        let parameters = *self.onboard.component().parameters();
        if parameters != self.kept {
            self.kept = parameters;
            if let Some(keeper) = &self.keeper {
                keeper.keep(params::text(&parameters).into_bytes(), 0);
            }
        }
    }

    fn see(&mut self, seen: ProcessedFrame) -> Result<(), Error> {
        let received_us = now_us();
        let size = (seen.frame.width, seen.frame.height);
        if self.size != Some(size) {
            self.onboard.set_camera(self.config.camera(size, self.own_camera.as_ref())?);
            self.size = Some(size);
        }
        self.blind = seen.blind;
        let finished_us = seen.ended_us.iter().copied().fold(seen.begun_us, i64::max);
        let (busy_us, left_out) = (finished_us - seen.begun_us, self.capture.mailbox.dropped());
        if let Some(advice) = self.pace.add(size, busy_us, left_out, finished_us) {
            tracing::warn!("{advice}");
        }
        self.onboard.report(left_out, seen.blind, busy_us);
        let tracks = self.onboard.process(&seen.found, seen.frame.time_us, received_us);
        self.summary.frames += 1;
        self.summary.digest.update(&seen.found.list);
        self.summary.stages.add(&seen, received_us, now_us());
        self.outputs.see(&seen, &tracks, &self.onboard, self.summary.frames);
        self.speak(Some(seen.frame.time_us));
        Ok(())
    }

    /// Sends the messages that are due; `exposed_us` is the exposure time of the frame that they are about.
    fn speak(&mut self, exposed_us: Option<i64>) {
        let now_us = now_us();
        while let Some(message) = self.onboard.poll(now_us) {
            if let Some(frame) = self.links.send_about(&message, now_us, exposed_us) {
                self.outputs.said(&frame, now_us);
            }
        }
    }

    /// Updates log, service manager and page.
    fn tick(&mut self) {
        // Also what happens while nothing is heard: the autopilot's loss.
        telemetry::log_events(&mut self.onboard);
        let state = self.onboard.component().state();
        if state != self.state {
            self.state = state;
            match state {
                LookoutState::Watching | LookoutState::Starting | LookoutState::Ending => {
                    tracing::info!("{}", state_in_words(state))
                }
                LookoutState::Blind(_)
                | LookoutState::Stalled
                | LookoutState::Slow
                | LookoutState::NoAutopilot => {
                    tracing::warn!("{}", state_in_words(state));
                }
            }
        }
        if self.notify.is_due() {
            let now = self.pulses.map(|pulse| pulse.load(Ordering::Relaxed));
            let ended = self.capture.state() == CaptureState::Ended;
            if (now[0] != self.fed[0] || ended) && now[1] != self.fed[1] {
                self.fed = now;
                self.notify.feed();
            }
        }
        let now_us = now_us();
        self.outputs.tick(now_us);
        self.notice(now_us);
        let (frames, last_us) = self.status;
        let span_us = now_us - last_us;
        if span_us >= STATUS_US {
            let rate = (self.summary.frames - frames) as f64 * 1e6 / span_us as f64;
            self.status = (self.summary.frames, now_us);
            let condition = self.condition(rate);
            self.notify.status(self.in_words(&condition));
            self.outputs.show(
                condition,
                &self.config.source.to_string(),
                &self.onboard,
                &self.links,
            );
        }
    }

    /// Sends texts about what fails, and that it does no more; at most one a second.
    fn notice(&mut self, now_us: i64) {
        if now_us.saturating_sub(self.noticed_us) < NOTICE_US {
            return;
        }
        let failing = [
            self.outputs.is_recording_lost(),
            self.keeper.as_ref().is_some_and(Keeper::is_failing),
            self.links.is_signing_time_lost(),
        ];
        let notices = [
            (Notice::RecordingStopped, Some(Notice::RecordingGoesOn)),
            (Notice::ParametersNotKept, None),
            (Notice::SigningTimeNotKept, None),
        ];
        let notices = notices.into_iter().zip(failing).zip(&mut self.noticed);
        for (((stopped, goes_on), failing), noticed) in notices {
            let before = *noticed;
            let due = before.is_none_or(|before| now_us.saturating_sub(before) >= NOTICE_AGAIN_US);
            let notice = match (failing, before) {
                (true, _) if due => Some(stopped),
                (false, Some(_)) => goes_on,
                _ => continue,
            };
            *noticed = failing.then_some(now_us);
            self.noticed_us = now_us;
            return notice.into_iter().for_each(|notice| self.onboard.notify(notice));
        }
        if self.links.take_refused_future() && !self.refused_future {
            self.refused_future = true;
            tracing::warn!("a frame is rightly signed, but more than a day ahead of our clock");
            self.onboard.notify(Notice::ClockOfPeer);
        }
    }

    fn condition(&self, rate: f64) -> Condition {
        Condition {
            state: self.state,
            blind: self.blind,
            camera: self.capture.state(),
            frames: (self.summary.frames, self.capture.mailbox.dropped(), rate),
            latency: self.summary.stages.percentiles(&self.links.latency()),
            advice: self.pace.advice().map(String::from),
        }
    }

    fn in_words(&self, condition: &Condition) -> String {
        let mut words = state_in_words(condition.state);
        let rate = condition.frames.2;
        if let CaptureState::Gone(reason) = &condition.camera {
            words = format!("{words} ({reason})");
        }
        let autopilot = match self.onboard.component().autopilot() {
            Some(_) => format!("autopilot of system {}", self.onboard.component().system_id()),
            None => "no autopilot".into(),
        };
        format!("{words}; {rate:.1} frames a second, {autopilot}")
    }

    fn reload(&mut self, reread: &dyn Fn() -> Result<ServiceConfig, Error>) {
        let config = match reread() {
            Ok(config) => config,
            Err(error) => {
                tracing::error!("the settings stay as they are: {error}");
                return;
            }
        };
        let changes = self.config.changes(&config);
        for key in &changes {
            if key.reload {
                tracing::info!("{} changes", key.name);
            } else {
                tracing::warn!("{} changes with the next start only", key.name);
            }
        }
        let any = |prefixes: &[&str]| {
            changes.iter().any(|key| prefixes.iter().any(|prefix| key.name.starts_with(prefix)))
        };
        if any(&["source", "repeat", "stream.", "camera."]) {
            match source::own_camera(&config) {
                Ok(own) => self.own_camera = own,
                Err(error) => tracing::error!("{error}"),
            }
            self.size = None;
            self.capture.reopen(config.clone());
        }
        if any(&["links"]) {
            self.links.reopen(&specs(&config));
        }
        self.outputs.reload(&config, self.own_camera.as_ref(), &changes);
        self.config = config;
    }

    fn finish(self) -> Result<ServiceSummary, Error> {
        Ok(ServiceSummary {
            dropped: self.capture.mailbox.dropped(),
            missed: self.capture.missed.load(Ordering::Relaxed),
            opened: self.capture.opened.load(Ordering::Relaxed),
            sent: self.links.latency(),
            unplaced: telemetry::unplaced(&self.onboard).unwrap_or_default(),
            ..self.summary
        })
    }
}
