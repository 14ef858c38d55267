//! The vehicle's telemetry along with a replayed flight, and what the component says to it.
//!
//! Everything runs on the clock of the frames: 0 is the first frame. A frame counts as finished a fixed time after it was
//! taken, so that the same flight gives the same messages however fast the machine is.

use crate::mavlink::component::parameters::Parameters;
use crate::mavlink::component::{ComponentEvent, Outgoing, Trust};
use crate::mavlink::lookout::Lookout;
use crate::mavlink::placing::{News, UnplacedCause};
use crate::shell::error::Error;
use crate::shell::formats::flight_log;
use crate::shell::formats::flight_sample::FlightLogError;
use crate::shell::formats::tlog;
use crate::shell::link::signing::{self, Signing};
use crate::shell::link::{LinkSpec, Links, params};
use crate::shell::simulate;
use crate::shell::support::clock;
use mavlink_core::MAVLinkMessageRaw;
use std::boxed::Box;
use std::collections::BTreeMap;
use std::format;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::iter::{self, Peekable};
use std::path::{Path, PathBuf};
use std::string::String;
use std::time::{Duration, Instant};
use std::vec::Vec;

/// Time from a frame to its detections that a replay assumes, microseconds.
pub const LATENCY_US: i64 = 40_000;
/// Microseconds from one look for messages to be sent to the next.
const TICK_US: i64 = 20_000;
/// Telemetry before the first frame that is used, microseconds: heartbeats come once a second.
const BEFORE_US: i64 = 10_000_000;
/// The link that recorded telemetry comes over; no open link has this number.
const RECORDED: u8 = u8::MAX;

/// Telemetry of a replay.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "MAVLink")]
pub struct TelemetryArgs {
    /// The vehicle's log of the flight: telemetry log (.tlog), ArduPilot's .bin or PX4's .ulg; a simulated flight has its own
    #[arg(long, value_name = "FILE")]
    tlog_in: Option<PathBuf>,
    /// Time of the first frame, seconds after the first message of --tlog-in
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, allow_negative_numbers = true, requires = "tlog_in", value_parser = parse_start)]
    tlog_start: f64,
    /// Write every message sent to a telemetry log
    #[arg(long, value_name = "FILE")]
    tlog_out: Option<PathBuf>,
    /// Send over this link in real time: udpout:HOST:PORT, udpin:.., tcpout:.., tcpin:.. or serial:DEVICE:BAUD; may be repeated
    #[arg(long, value_name = "SPEC")]
    link: Vec<LinkSpec>,
    /// Key for signatures on these links, 64 hexadecimal digits; unsigned commands are then refused. The signing time is
    /// kept in FILE.time
    #[arg(long, value_name = "FILE", requires = "link")]
    signing_key: Option<PathBuf>,
    /// The camera is on a gimbal: where it looks comes from GIMBAL_DEVICE_ATTITUDE_STATUS in the log
    #[arg(long, requires = "tlog_in")]
    pub gimbal: bool,
    /// Parameters (LK_..) as `lookout run` keeps them; default: the defaults
    #[arg(long, value_name = "FILE")]
    parameters: Option<PathBuf>,
}

impl TelemetryArgs {
    /// Whether the options ask for messages to be written or sent.
    pub fn speaks(&self) -> bool {
        self.tlog_out.is_some() || !self.link.is_empty()
    }

    /// Whether the vehicle's log is heard.
    pub fn hears(&self) -> bool {
        self.tlog_in.is_some()
    }

    /// The same with the vehicle's log `log`.
    pub fn with_log(self, log: Option<PathBuf>) -> Self {
        Self { tlog_in: log, ..self }
    }

    /// The parameters to begin with.
    ///
    /// # Errors
    /// [`FileError::Read`](crate::shell::support::file_error::FileError::Read).
    pub fn parameters(&self) -> Result<Parameters, Error> {
        match &self.parameters {
            Some(path) => params::load(path).map_err(Error::read(path)),
            None => Ok(Parameters::default()),
        }
    }
}

fn parse_start(text: &str) -> Result<f64, &'static str> {
    let seconds = text.parse().ok().filter(|seconds: &f64| seconds.abs() <= 1e6);
    seconds.ok_or("expected a number of seconds")
}

/// Signatures with the key in the file `key`; the signing times are kept in `time`, by default `key`.time.
///
/// # Errors
/// [`FileError::Read`](crate::shell::support::file_error::FileError::Read).
pub fn signing_with(key: &Path, time: Option<&Path>) -> Result<Signing, Error> {
    let bytes = signing::read_key(key).map_err(Error::read(key))?;
    let mut beside = key.to_path_buf().into_os_string();
    beside.push(".time");
    let time = time.unwrap_or(Path::new(&beside));
    Signing::new(bytes, Some(time), signing::clock()).map_err(Error::read(time))
}

/// Logs the component's events since the last call.
pub fn log_events(onboard: &mut Lookout) {
    while let Some(event) = onboard.event() {
        match event {
            ComponentEvent::Found { system_id, autopilot } => {
                tracing::info!(system_id, autopilot, "autopilot found");
            }
            ComponentEvent::Returned { system_id } => {
                tracing::info!(system_id, "autopilot is back")
            }
            ComponentEvent::Lost => {
                let system_id = onboard.component().system_id();
                tracing::warn!(system_id, "autopilot lost: no traffic on the map until it is back");
            }
            ComponentEvent::Restarted => {
                let system_id = onboard.component().system_id();
                tracing::warn!(system_id, "autopilot restarted");
            }
            ComponentEvent::Parameter(parameter) => {
                let value = onboard.component().parameters().wire(parameter);
                tracing::info!("parameter {} set to {value}", parameter.name());
            }
            ComponentEvent::FieldOfView { degrees } => {
                tracing::info!(
                    "the camera's field of view is {degrees:.1} degrees by its own CAMERA_FOV_STATUS"
                );
            }
            ComponentEvent::Map(News::Lost(cause)) => {
                let often = often(onboard);
                tracing::warn!("traffic is not put on the map: {cause}{often}");
            }
            ComponentEvent::Map(News::Good) => tracing::info!("traffic is put on the map again"),
            ComponentEvent::Attitude { .. }
            | ComponentEvent::Rates { .. }
            | ComponentEvent::Gimbal { .. } => {}
        }
    }
}

/// `; 2.0 attitudes a second`.
fn often(onboard: &Lookout) -> String {
    let interval = onboard.attitude_interval_us().filter(|us| *us > 0);
    interval.map_or(String::new(), |us| format!("; {:.1} attitudes a second", 1e6 / us as f64))
}

/// How many objects had no place on the map, and why: a line for each cause. `None` where all had one.
pub fn unplaced(onboard: &Lookout) -> Option<String> {
    let counts = onboard.placing().counts();
    let mut lines = Vec::new();
    for (cause, lost) in
        UnplacedCause::ALL.into_iter().zip(counts.lost).filter(|(_, lost)| *lost > 0)
    {
        let often =
            if cause == UnplacedCause::RareAttitude { often(onboard) } else { String::new() };
        let all = counts.all();
        lines.push(format!("no place on the map for {lost} of {all} sightings: {cause}{often}"));
    }
    (!lines.is_empty()).then(|| lines.join("\n"))
}

type Feed = Box<dyn Iterator<Item = Result<(i64, MAVLinkMessageRaw), FlightLogError>>>;

/// The telemetry of one replay.
pub struct ReplayTelemetry {
    feed: Peekable<Feed>,
    /// Time of the first frame, microseconds since 1970.
    first_us: i64,
    log: Option<(PathBuf, BufWriter<File>)>,
    links: Option<Links>,
    sequences: BTreeMap<u8, u8>,
    now_us: i64,
    started: Option<Instant>,
}

impl ReplayTelemetry {
    /// Opens what `args` name; `simulated` is the telemetry of a simulated flight.
    ///
    /// # Errors
    /// [`Error::Tlog`], [`FileError::Write`](crate::shell::support::file_error::FileError::Write).
    pub fn open(
        args: &TelemetryArgs,
        simulated: Option<simulate::FlightTelemetry>,
    ) -> Result<Self, Error> {
        let (first_us, feed): (i64, Feed) = match (&args.tlog_in, simulated) {
            (Some(path), _) => {
                let mut messages = flight_log::open(path)?;
                let first = messages.next().transpose()?;
                #[expect(clippy::cast_possible_truncation, reason = "saturates")]
                let start_us = (args.tlog_start * 1e6).round() as i64;
                let first_us = first.as_ref().map_or(0, |(time_us, _)| *time_us);
                let first_us = first_us.saturating_add(start_us);
                let messages = first.into_iter().map(Ok).chain(messages);
                let relative = move |message: Result<(i64, MAVLinkMessageRaw), FlightLogError>| {
                    message.map(|(time_us, raw)| (time_us.saturating_sub(first_us), raw))
                };
                (first_us, Box::new(messages.map(relative)))
            }
            (None, Some(simulated)) => {
                let frames = simulated.map(|(time, raw)| Ok((time, MAVLinkMessageRaw::V2(raw))));
                (simulate::START_US, Box::new(frames))
            }
            (None, None) => (clock::unix_us(), Box::new(iter::empty())),
        };
        let create = |path: &PathBuf| {
            let file = File::create(path).map_err(Error::write(path))?;
            Ok::<_, Error>((path.clone(), BufWriter::new(file)))
        };
        let signing = args.signing_key.as_deref();
        let signing = signing.map(|key| signing_with(key, None)).transpose()?;
        Ok(Self {
            feed: feed.peekable(),
            first_us,
            log: args.tlog_out.as_ref().map(create).transpose()?,
            links: (!args.link.is_empty()).then(|| Links::open_signed(&args.link, signing)),
            sequences: BTreeMap::new(),
            now_us: 0,
            started: None,
        })
    }

    /// Advances the time to `to_us`, with all messages received and sent until then.
    ///
    /// # Errors
    /// [`Error::Tlog`], [`FileError::Write`](crate::shell::support::file_error::FileError::Write).
    pub fn advance(&mut self, onboard: &mut Lookout, to_us: i64) -> Result<(), Error> {
        while self.now_us < to_us {
            self.now_us = (self.now_us + TICK_US).min(to_us);
            self.hear(onboard)?;
            self.wait(onboard);
            log_events(onboard);
            while let Some(message) = onboard.poll(self.now_us) {
                self.say(&message)?;
            }
        }
        Ok(())
    }

    /// Recorded telemetry up to now.
    fn hear(&mut self, onboard: &mut Lookout) -> Result<(), Error> {
        let now_us = self.now_us;
        let due =
            |item: &Result<(i64, _), _>| item.as_ref().map_or(true, |(time, _)| *time <= now_us);
        while let Some(item) = self.feed.next_if(due) {
            let (time_us, frame) = item?;
            if time_us >= -BEFORE_US {
                onboard.receive(RECORDED, &frame, Trust::Open, time_us);
            }
        }
        Ok(())
    }

    /// With links: waits until real time has reached the flight's, and receives meanwhile.
    fn wait(&mut self, onboard: &mut Lookout) {
        let Some(links) = &mut self.links else { return };
        let started = *self.started.get_or_insert_with(Instant::now);
        let due = Duration::from_micros(self.now_us.unsigned_abs());
        loop {
            let left = due.saturating_sub(started.elapsed());
            match links.receive(left) {
                Some(inbound) => {
                    onboard.receive(inbound.link, &inbound.frame, inbound.trust, self.now_us)
                }
                None if left.is_zero() => return,
                None => {}
            }
        }
    }

    fn say(&mut self, message: &Outgoing) -> Result<(), Error> {
        if let Some(links) = &mut self.links {
            links.send(message, self.now_us);
        }
        if let Some((path, log)) = &mut self.log {
            let sequence = self.sequences.entry(message.component_id).or_default();
            let (system, component) = (message.system_id, message.component_id);
            let frame = message.payload.frame(system, component, *sequence, false);
            *sequence = sequence.wrapping_add(1);
            let time_us = self.first_us.saturating_add(self.now_us);
            tlog::write(log, time_us, frame.raw_bytes()).map_err(Error::write(path))?;
        }
        Ok(())
    }

    /// Completes the log.
    ///
    /// # Errors
    /// [`FileError::Write`](crate::shell::support::file_error::FileError::Write).
    pub fn finish(mut self) -> Result<(), Error> {
        match &mut self.log {
            Some((path, log)) => log.flush().map_err(Error::write(path)),
            None => Ok(()),
        }
    }
}
