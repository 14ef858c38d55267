//! Capture thread: takes frames, reopens the source when it fails.

use super::config::ServiceConfig;
use super::mailbox::{Mailbox, Pool};
use super::source::{LiveError, OpenSource};
use crate::shell::link::Inbound;
use crate::shell::sources::SourceError;
use crate::shell::support::repeats::Repeats;
use crossbeam_channel::Sender;
use std::format;
use std::string::{String, ToString};
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Timeout of one call for a frame; bounds the latency of a shutdown.
const SLICE: Duration = Duration::from_millis(100);
/// The first wait before it is opened again; it doubles up to the last, so that a camera that is back is used within two
/// seconds.
const FIRST_WAIT: Duration = Duration::from_millis(200);
const LAST_WAIT: Duration = Duration::from_secs(1);

/// State of the capture.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum CaptureState {
    /// The source is being opened.
    #[default]
    Opening,
    /// Frames are taken.
    Running,
    /// The source is gone, for this reason; it is tried again.
    Gone(String),
    /// The last frame of a flight was taken, or none can be read of it any more.
    Ended,
}

/// Shared view of the capture.
#[derive(Debug, Default)]
pub struct Capture {
    /// Place that the newest frame waits in for the detector.
    pub mailbox: Mailbox,
    /// Frames lost on the way from the camera, since the start.
    pub missed: AtomicU32,
    /// Number of times that the source was opened.
    pub opened: AtomicU32,
    /// Rises as long as the thread goes on, also while it waits.
    pub pulse: AtomicU64,
    state: Mutex<CaptureState>,
    settings: Mutex<Option<ServiceConfig>>,
}

impl Capture {
    /// State of the capture now.
    pub fn state(&self) -> CaptureState {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Opens the source anew with other settings.
    pub fn reopen(&self, config: ServiceConfig) {
        *self.settings.lock().unwrap_or_else(PoisonError::into_inner) = Some(config);
    }

    fn set(&self, state: CaptureState) {
        *self.state.lock().unwrap_or_else(PoisonError::into_inner) = state;
    }

    fn new_settings(&self) -> Option<ServiceConfig> {
        self.settings.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    /// Takes frames until `stop`, or to the end of a flight.
    ///
    /// # Errors
    /// Those of a file, which end it too; a camera is opened again.
    pub fn run(
        &self,
        mut config: ServiceConfig,
        open: &OpenSource,
        heard: &Sender<Inbound>,
        stop: &AtomicBool,
    ) -> Result<(), SourceError> {
        let mut wait = FIRST_WAIT;
        let mut pool = Pool::default();
        let mut said = Repeats::default();
        while !stop.load(Ordering::Relaxed) {
            if let Some(changed) = self.new_settings() {
                config = changed;
                wait = FIRST_WAIT;
            }
            self.set(CaptureState::Opening);
            let reason = match self.serve(&config, open, heard, stop, &mut pool, &mut wait) {
                // Told to stop, or to open anew.
                Ok(()) => continue,
                Err(LiveError::Ended) => {
                    self.set(CaptureState::Ended);
                    return Ok(());
                }
                Err(LiveError::Broken(error)) => {
                    self.set(CaptureState::Ended);
                    return Err(error);
                }
                Err(error) => error.to_string(),
            };
            if wait == FIRST_WAIT {
                // Frames came since the last one.
                said.forget();
            }
            let text = format!("{}: {reason}", config.source);
            if said.is_news(&text, Instant::now()) {
                tracing::warn!("{text}; tried again until it is there");
            }
            self.set(CaptureState::Gone(reason));
            let until = Instant::now() + wait;
            while Instant::now() < until && !stop.load(Ordering::Relaxed) {
                self.pulse.fetch_add(1, Ordering::Relaxed);
                thread::sleep(Duration::from_millis(20));
            }
            wait = (wait * 2).min(LAST_WAIT);
        }
        Ok(())
    }

    /// Opens the source and takes its frames until it fails, or the settings or the user end it.
    fn serve(
        &self,
        config: &ServiceConfig,
        open: &OpenSource,
        heard: &Sender<Inbound>,
        stop: &AtomicBool,
        pool: &mut Pool,
        wait: &mut Duration,
    ) -> Result<(), LiveError> {
        let mut source = open(config, heard)?;
        let mut last = Instant::now();
        let mut running = false;
        while !stop.load(Ordering::Relaxed) {
            if self.settings.lock().unwrap_or_else(PoisonError::into_inner).is_some() {
                return Ok(());
            }
            self.pulse.fetch_add(1, Ordering::Relaxed);
            let mut shared = pool.take();
            // The pool gives what nobody else holds.
            let Some(frame) = Arc::get_mut(&mut shared) else { continue };
            let taken = source.next(frame, SLICE);
            pool.give(shared.clone());
            match taken {
                Ok(taken) => {
                    self.missed.fetch_add(taken.missed, Ordering::Relaxed);
                    self.mailbox.pass_over(taken.passed_over);
                    self.mailbox.put(shared);
                    last = Instant::now();
                    if !running {
                        running = true;
                        self.opened.fetch_add(1, Ordering::Relaxed);
                        tracing::info!("{}: frames come", config.source);
                        self.set(CaptureState::Running);
                        *wait = FIRST_WAIT;
                    }
                }
                Err(LiveError::Timeout) if last.elapsed() < source.silence() => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}
