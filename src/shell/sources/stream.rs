//! Live frames from a program that writes y4m to its standard output: a streamer, a camera's own tool, or `ffmpeg` that
//! receives a network stream.
//!
//! One thread reads all the time and keeps the newest frame, so that nothing piles up in the program or on the network.
//! A frame's time is that of its arrival less the latency of camera, encoder, network and decoder, which only a
//! measurement from outside can find and which therefore has to be given.

use super::process::Process;
use super::y4m::{Header, Y4m};
use super::{Frame, FrameSource, SourceError};
use crate::shell::support::clock::now_us;
use std::boxed::Box;
use std::ffi::OsString;
use std::format;
use std::io::{self, BufReader};
use std::process::{ChildStdout, ExitStatus};
use std::string::{String, ToString};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use std::vec::Vec;

/// Timeout of the first frame: programs start, connect, and wait for a key frame (some cameras send one in 10 s).
const FIRST_FRAME: Duration = Duration::from_secs(15);

/// A line that names an error explains the end of a program that ends within this time, whatever it says after.
const EXPLAINS: Duration = Duration::from_secs(2);

/// Lines of the program's standard error that are logged in [`LOG_SPAN`]; more are counted only.
const LOG_LINES: u32 = 20;
/// See [`LOG_LINES`].
const LOG_SPAN: Duration = Duration::from_secs(10);

/// A program that is started, and the form of its output.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StreamSettings {
    /// The program and its arguments; no shell reads them.
    pub command: Vec<OsString>,
    /// Of frames that come without a header; `None`: y4m.
    pub header: Option<Header>,
    /// Time from exposure to arrival, microseconds.
    pub latency_us: i64,
    /// A stream without a frame for this long is given up (the first may take 15 s).
    pub timeout: Duration,
    /// A part of an address that must not be logged (user and password), where there is one.
    pub secret: Option<String>,
}

/// Why a stream gives no frame.
#[derive(Debug, thiserror::Error)]
pub enum StreamError {
    /// No frame came in the time of this call; the next may.
    #[error("no frame came")]
    Timeout,
    /// The program cannot be started.
    #[error("{program} cannot be started: {source}; install it, or name its path")]
    Start {
        /// Program as the settings name it.
        program: String,
        /// The system's reason.
        source: io::Error,
    },
    /// The program runs and sends nothing.
    #[error("{program} sent no frame for {} ms{}", after.as_millis(), said(last))]
    Silent {
        /// Program as the settings name it.
        program: String,
        /// Time without a frame.
        after: Duration,
        /// The line of its standard error that explains it best, empty if none.
        last: String,
    },
    /// The program ended, or sent something else than frames.
    #[error("{program}: {reason}{}", said(last))]
    Ended {
        /// Program as the settings name it.
        program: String,
        /// Its exit status, or what is wrong with what it sent.
        reason: String,
        /// The line of its standard error that explains it best, empty if none.
        last: String,
    },
}

fn said(last: &str) -> String {
    if last.is_empty() { String::new() } else { format!("; it said: {last}") }
}

/// Between the reading thread and [`ProgramStream::next`].
#[derive(Debug, Default)]
struct FrameSlot {
    newest: Option<Frame>,
    /// Memory for the next frame.
    spare: Frame,
    /// Frames that gave way to `newest`.
    passed_over: u32,
    /// Set once, at the end; the reason unless that was a regular end of the stream.
    ended: Option<Option<String>>,
}

#[derive(Debug, Default)]
struct StreamShared {
    slot: Mutex<FrameSlot>,
    changed: Condvar,
    complaint: Mutex<Complaint>,
}

/// The line of a program's standard error that explains its end best: the first one of its last seconds that names an
/// error, else the last one. GStreamer, for one, says first that there is no camera, then that its pipeline has not
/// started.
#[derive(Debug, Default)]
struct Complaint {
    line: String,
    /// When a line that names an error came.
    error: Option<Instant>,
}

impl Complaint {
    fn add(&mut self, line: String, now: Instant) {
        let holds = self.error.is_some_and(|at| now.saturating_duration_since(at) <= EXPLAINS);
        if !holds {
            let lower = line.to_lowercase();
            let names_one = ["error", "failed", "could not", "cannot"];
            self.error = names_one.iter().any(|word| lower.contains(word)).then_some(now);
            self.line = line;
        }
    }
}

/// A running program that writes frames. Dropped, its process group ends.
#[derive(Debug)]
pub struct ProgramStream {
    settings: StreamSettings,
    process: Process,
    shared: Arc<StreamShared>,
    /// When the program was started or the last frame taken.
    since: Instant,
    any: bool,
}

impl ProgramStream {
    /// Starts the program.
    ///
    /// # Errors
    /// [`StreamError::Start`].
    pub fn start(settings: StreamSettings) -> Result<Self, StreamError> {
        let shared = Arc::<StreamShared>::default();
        let program = program(&settings);
        let log = logger(program.clone(), settings.secret.clone(), shared.clone());
        let (process, stdout) = Process::start(&settings.command, log)
            .map_err(|source| StreamError::Start { program: program.clone(), source })?;
        let (latency_us, header, to) =
            (settings.latency_us, settings.header.clone(), shared.clone());
        // Ends with the pipe, which closes when the process group ends.
        thread::spawn(move || {
            let reader = BufReader::with_capacity(1 << 16, stdout);
            let frames = match header {
                Some(header) => Ok(Y4m::with_header(reader, &program, header)),
                None => Y4m::new(reader, &program),
            };
            read(frames, latency_us, &program, &to);
        });
        Ok(Self { settings, process, shared, since: Instant::now(), any: false })
    }

    /// Writes the newest frame to `frame`, waiting for it at most `timeout`; gives the number of older ones that it replaced.
    ///
    /// # Errors
    /// [`StreamError::Timeout`]: call again. Every other one: drop the stream and start it again later.
    pub fn next(&mut self, frame: &mut Frame, timeout: Duration) -> Result<u32, StreamError> {
        let slot = self.shared.slot.lock().unwrap_or_else(PoisonError::into_inner);
        let waiting = |slot: &mut FrameSlot| slot.newest.is_none() && slot.ended.is_none();
        let waited = self.shared.changed.wait_timeout_while(slot, timeout, waiting);
        let mut slot = waited.unwrap_or_else(PoisonError::into_inner).0;
        if let Some(mut newest) = slot.newest.take() {
            std::mem::swap(frame, &mut newest);
            slot.spare = newest;
            let passed_over = std::mem::take(&mut slot.passed_over);
            drop(slot);
            self.since = Instant::now();
            self.any = true;
            return Ok(passed_over);
        }
        let ended = slot.ended.clone();
        drop(slot);
        let program = program(&self.settings);
        if let Some(reason) = ended {
            // Its exit status, unless it goes on with its output closed: then it is ended.
            let status = self.process.end().map_err(|error| error.to_string());
            let last = self.complaint();
            return Err(StreamError::Ended { program, reason: words(reason, status), last });
        }
        let allowed = if self.any { self.settings.timeout } else { FIRST_FRAME };
        if self.since.elapsed() >= allowed {
            return Err(StreamError::Silent { program, after: allowed, last: self.complaint() });
        }
        Err(StreamError::Timeout)
    }

    fn complaint(&self) -> String {
        self.shared.complaint.lock().unwrap_or_else(PoisonError::into_inner).line.clone()
    }
}

fn program(settings: &StreamSettings) -> String {
    settings.command.first().map(|word| word.to_string_lossy().into_owned()).unwrap_or_default()
}

fn words(reason: Option<String>, status: Result<ExitStatus, String>) -> String {
    match (reason, status) {
        (Some(reason), _) | (None, Err(reason)) => reason,
        (None, Ok(status)) if status.success() => "the stream has ended".into(),
        (None, Ok(status)) => format!("ended with {status}"),
    }
}

/// Reads frames to the end of the stream.
fn read(
    frames: Result<Y4m<BufReader<ChildStdout>>, SourceError>,
    latency_us: i64,
    program: &str,
    to: &StreamShared,
) {
    let mut next = Frame::default();
    let ended = frames.and_then(|mut frames| {
        while frames.next_frame(&mut next)? {
            next.time_us = now_us() - latency_us;
            let mut slot = to.slot.lock().unwrap_or_else(PoisonError::into_inner);
            let spare = std::mem::take(&mut slot.spare);
            let frame = std::mem::replace(&mut next, spare);
            if let Some(older) = slot.newest.replace(frame) {
                slot.passed_over = slot.passed_over.saturating_add(1);
                next = older;
            }
            drop(slot);
            to.changed.notify_one();
        }
        Ok(())
    });
    let mut slot = to.slot.lock().unwrap_or_else(PoisonError::into_inner);
    // Readers name their file, which is the program here; it is named once.
    let reason = |error: SourceError| {
        let text = error.to_string();
        text.strip_prefix(&format!("{program}: ")).map(String::from).unwrap_or(text)
    };
    slot.ended = Some(ended.err().map(reason));
    drop(slot);
    to.changed.notify_one();
}

/// Text of a terminal without its colours and other escape sequences.
fn plain(line: &str) -> String {
    let mut text = String::new();
    let mut rest = line.chars();
    while let Some(letter) = rest.next() {
        if letter == '\u{1b}' && rest.as_str().starts_with('[') {
            // Parameters, then a final letter (ECMA-48, 5.4).
            rest.next();
            rest.by_ref().find(|letter| ('@'..='~').contains(letter));
        } else if !letter.is_control() || letter == '\t' {
            text.push(letter);
        }
    }
    text
}

/// Logs lines of the program's standard error, less `secret`, and keeps the one that explains its end.
fn logger(
    program: String,
    secret: Option<String>,
    shared: Arc<StreamShared>,
) -> Box<dyn FnMut(&str) + Send> {
    let (mut begun, mut lines) = (Instant::now(), 0);
    Box::new(move |line: &str| {
        let line = plain(line);
        let line = match &secret {
            Some(secret) => line.replace(secret.as_str(), "***"),
            None => line,
        };
        if begun.elapsed() > LOG_SPAN {
            if lines > LOG_LINES {
                tracing::warn!("{program}: {} more lines", lines - LOG_LINES);
            }
            (begun, lines) = (Instant::now(), 0);
        }
        lines += 1;
        if lines <= LOG_LINES {
            tracing::warn!("{program}: {line}");
        }
        shared.complaint.lock().unwrap_or_else(PoisonError::into_inner).add(line, Instant::now());
    })
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    fn settings(script: &str) -> StreamSettings {
        StreamSettings {
            command: ["sh", "-c", script].map(OsString::from).into(),
            header: None,
            latency_us: 100_000,
            timeout: Duration::from_millis(300),
            secret: Some("me:pass@".into()),
        }
    }

    const PATIENCE: Duration = Duration::from_secs(20);

    #[test]
    fn the_newest_frame_wins_and_its_age_holds_the_latency() {
        let script = "printf 'YUV4MPEG2 W2 H1 F30:1 Cmono\\nFRAME\\nab'; sleep 0.2; \
                      printf 'FRAME\\ncdFRAME\\nef'; sleep 100";
        let mut stream = ProgramStream::start(settings(script)).unwrap();
        let mut frame = Frame::default();
        assert_eq!(stream.next(&mut frame, PATIENCE).unwrap(), 0);
        assert_eq!((frame.pixels.as_slice(), frame.width, frame.height), (&b"ab"[..], 2, 1));
        let age = now_us() - frame.time_us;
        assert!((100_000..5_000_000).contains(&age), "{age}");
        let first = frame.time_us;
        thread::sleep(Duration::from_millis(600));
        assert_eq!(stream.next(&mut frame, PATIENCE).unwrap(), 1);
        assert_eq!(frame.pixels, b"ef");
        assert!(frame.time_us > first);
        // It stalls: first a timeout of the call, then the stream is given up, with what was said.
        let error = loop {
            match stream.next(&mut frame, Duration::from_millis(50)) {
                Ok(_) => panic!("no frame was sent"),
                Err(StreamError::Timeout) => {}
                Err(error) => break error.to_string(),
            }
        };
        assert_eq!(error, "sh sent no frame for 300 ms");
    }

    #[test]
    fn the_first_error_explains_the_end() {
        let said = |lines: &[(u64, &str)]| {
            let start = Instant::now();
            let mut complaint = Complaint::default();
            for (ms, line) in lines {
                complaint.add((*line).into(), start + Duration::from_millis(*ms));
            }
            complaint.line
        };
        let camera = "ERROR: from element libcamerasrc0: Could not find any supported camera";
        let after = "Failed to set pipeline to PAUSED.";
        assert_eq!(
            said(&[(0, "version 1"), (5, camera), (6, "cameras() is empty"), (7, after)]),
            camera
        );
        assert_eq!(said(&[(0, camera), (9000, after)]), after);
        assert_eq!(said(&[(0, "one"), (1, "two")]), "two");
        let colours = "\u{1b}[1;33m WARN \u{1b}[0mNo IPA\u{7} found\u{1b}";
        assert_eq!(plain(colours), " WARN No IPA found");
        assert_eq!(plain("\u{1b}["), "");
    }

    #[test]
    fn an_end_names_its_reason_and_no_password() {
        let mut frame = Frame::default();
        for (script, wanted) in [
            ("echo no route to rtsp://me:pass@cam >&2; exit 4", "before the first line"),
            ("echo no route to rtsp://me:pass@cam >&2; exit 4", "said: no route to rtsp://***cam"),
            ("printf 'YUV4MPEG2 W2 H1 F30:1 Cmono\\nFRAME\\nab'", "sh: the stream has ended"),
            (
                "printf 'YUV4MPEG2 W2 H1 F30:1 Cmono\\nFRAME\\nab'; exit 9",
                "ended with exit status: 9",
            ),
            ("printf 'YUV4MPEG2 W2 H1 F30:1 Cmono\\nFRAME\\na'", "cut off inside frame 1"),
            ("echo hello", "does not begin with YUV4MPEG2"),
        ] {
            let mut stream = ProgramStream::start(settings(script)).unwrap();
            let error = loop {
                if let Err(error) = stream.next(&mut frame, PATIENCE) {
                    break error.to_string();
                }
            };
            assert!(error.contains(wanted) && !error.contains("pass"), "{script}: {error}");
            assert!(!error.contains("sh: sh:"), "{script}: {error}");
        }
        let command = ["no-such-program"].map(OsString::from).into();
        let error = ProgramStream::start(StreamSettings { command, ..settings("") }).unwrap_err();
        assert!(error.to_string().starts_with("no-such-program cannot be started: no program"));
    }
}
