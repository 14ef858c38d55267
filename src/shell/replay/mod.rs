//! `lookout replay`: a recorded or simulated flight through the detector.

pub mod flight;
#[cfg(feature = "mcap")]
mod mcap;
mod shard;
pub mod telemetry;

use super::error::Error;
use super::formats::camera_file::{CameraArgs, CameraFile};
use super::formats::detections::{self, SCORE_BITS, TextFile};
use super::formats::traffic;
use super::pictures::PictureOutput;
use super::pictures::annotate::ColourPicture;
use super::pictures::colour::Colours;
use super::pipeline::{self, DetectorArgs, ModelFile};
use super::sources::Frame;
use super::support::interrupt::{self, Ended};
use crate::detector::digest::Digest;
use crate::detector::{Detection, Detections};
use crate::mavlink::component;
use crate::mavlink::component::parameters::Parameters;
use crate::mavlink::lookout::Lookout;
use crate::model::Model;
use crate::model::calibration::ONE;
use crate::shell::support::print::print_line;
use crate::tracking::tracker;
use crate::tracking::traffic::AlertLevel;
use flight::FlightArgs;
use indicatif::{ProgressBar, ProgressStyle};
use std::collections::BTreeMap;

use shard::ReplayShardArgs;
use std::path::PathBuf;
use std::string::String;
use std::time::{Duration, Instant};
use std::{eprintln, format};
use telemetry::{LATENCY_US, ReplayTelemetry, TelemetryArgs, unplaced};

/// Default precision (Q16) of reported detections, for models with a calibration.
const PRECISION: u32 = ONE * 9 / 10;

/// Time between two lines of progress where there is no terminal.
const PROGRESS_INTERVAL: Duration = Duration::from_secs(5);

/// Least score that is reported where it does not: on the training clips held back, 96 of 100 such detections on
/// airborne flights were targets, 97 on those from the ground (models/README.md).
const THRESHOLD: i32 = -1 << SCORE_BITS;

/// Command-line arguments of `lookout replay`.
#[derive(Debug, Clone, clap::Args)]
#[command(mut_arg("kind", |kind| kind.conflicts_with_all(["input", "manifest"])))]
pub struct ReplayArgs {
    /// Folder of PNG, JPEG or PGM pictures, .y4m, - (y4m on standard input), or any video ffmpeg reads; none: a simulated
    /// flight
    #[arg(value_name = "INPUT")]
    input: Option<PathBuf>,
    #[command(flatten)]
    detector: DetectorArgs,
    /// Write detections in MOTChallenge form: frame,-1,left,top,width,height,score
    #[arg(long, value_name = "FILE")]
    detections: Option<PathBuf>,
    /// Write a line of JSON a frame: detections, motion of the background, tracks
    #[arg(long, value_name = "FILE")]
    jsonl: Option<PathBuf>,
    /// Draw boxes, scores and motion: PNG pictures in a folder, or a video through ffmpeg
    #[arg(long, value_name = "DIR|FILE.mp4")]
    annotate: Option<PathBuf>,
    /// Write pictures, boxes, tracks, bearings and alerts for Foxglove (MCAP)
    #[cfg(feature = "mcap")]
    #[arg(long, value_name = "FILE")]
    mcap: Option<PathBuf>,
    /// Print a CRC-64 of all detections
    #[arg(long)]
    digest: bool,
    /// Threads to use; 1: the main thread alone, 0: one per processor core
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
    /// Process this many frames at the start without reporting: recordings begin with the frames that later detections
    /// depend on
    #[arg(long, value_name = "N", default_value_t = 0)]
    lead: u64,
    #[command(flatten)]
    many: ReplayShardArgs,
    #[command(flatten)]
    telemetry: TelemetryArgs,
    #[command(flatten)]
    camera: CameraArgs,
    #[command(flatten)]
    flight: FlightArgs,
}

/// Replays a flight.
///
/// # Errors
/// [`Error`]; what was written before stays.
pub fn run(args: &ReplayArgs) -> Result<Ended, Error> {
    if let Some(manifest) = &args.many.manifest {
        return shard::run(args, manifest);
    }
    let model = ModelFile::load(args.detector.model.as_deref())?;
    let model = model.parse()?;
    let (args, threshold, tracks) = prepared(args, &model)?;
    interrupt::watch()?;
    pipeline::on_threads(args.threads, || replay(&args, threshold, tracks, &model))?
}

/// Arguments with the least score that the detector reports, the least that is written (both log-odds), and the tracker's
/// settings.
fn prepared(
    args: &ReplayArgs,
    model: &Model<'_>,
) -> Result<(ReplayArgs, i32, tracker::TrackerSettings), Error> {
    let mut args = args.clone();
    let asked = args.detector.least_score(model)?;
    args.detector.min_precision = None;
    let threshold = asked.unwrap_or_else(|| default_threshold(model));
    // A track goes on with weaker detections than are reported.
    let tracks = tracker::TrackerSettings::calibrated(model.calibration());
    args.detector.threshold = Some(threshold.min(tracks.keep_score));
    Ok((args, threshold, tracks))
}

/// People look at the reports of a replay: a score at which few are false.
fn default_threshold(model: &Model<'_>) -> i32 {
    let table = model.calibration();
    let surest = || table.knots().last().map(|knot| knot.score);
    table.threshold(PRECISION).or_else(surest).unwrap_or(THRESHOLD)
}

fn replay(
    args: &ReplayArgs,
    threshold: i32,
    tracks: tracker::TrackerSettings,
    model: &Model<'_>,
) -> Result<Ended, Error> {
    let input = args.input.as_deref();
    let own = args.flight.camera(input)?;
    let mut source = args.flight.open(input)?;
    let mut outputs = ReplayOutputs::create(args, threshold, own, tracks)?;
    let count = source.frame_count();
    // Many clips have one bar of their own.
    let quiet = args.many.manifest.is_some();
    let bar = if quiet { ProgressBar::hidden() } else { progress(count) };
    let mut spoken = SpokenProgress::new(bar.is_hidden() && !quiet);
    let mut each = |number, frame: &Frame, detections: &Detections| {
        bar.inc(1);
        spoken.frame(number, count);
        outputs.take(number, frame, detections)
    };
    let name = args.flight.name(input);
    let ended = pipeline::run(&name, source.as_mut(), model, &args.detector, &mut each);
    bar.finish_and_clear();
    outputs.finish(ended)
}

fn progress(frames: Option<u64>) -> ProgressBar {
    let (bar, template) = match frames {
        Some(frames) => (
            ProgressBar::new(frames),
            "{wide_bar} {pos}/{len} frames, {per_sec} frames a second, {eta} left",
        ),
        None => (ProgressBar::new_spinner(), "{spinner} {pos} frames, {per_sec} frames a second"),
    };
    // Constant templates are good.
    let style = ProgressStyle::with_template(template);
    let style = style.unwrap_or_else(|_| ProgressStyle::default_spinner());
    // indicatif's own unit says only `/s`.
    bar.with_style(style.with_key(
        "per_sec",
        |state: &indicatif::ProgressState, w: &mut dyn std::fmt::Write| {
            let _ = write!(w, "{:.1}", state.per_sec());
        },
    ))
}

/// Lines of progress on standard error where no bar can be drawn: a log, a pipe.
struct SpokenProgress {
    start: Instant,
    /// When the next line is due; none where a bar is drawn.
    due: Option<Instant>,
}

impl SpokenProgress {
    fn new(wanted: bool) -> Self {
        let start = Instant::now();
        Self { start, due: wanted.then(|| start + PROGRESS_INTERVAL) }
    }

    fn frame(&mut self, number: u64, count: Option<u64>) {
        let now = Instant::now();
        if self.due.is_none_or(|due| now < due) {
            return;
        }
        self.due = Some(now + PROGRESS_INTERVAL);
        let rate = number as f64 / (now - self.start).as_secs_f64();
        let of = count.map_or(String::new(), |count| format!(" of {count}"));
        eprintln!("lookout: frame {number}{of}, {rate:.1} frames a second");
    }
}

/// Outputs of a replay, written frame by frame.
struct ReplayOutputs {
    threshold: i32,
    lead: u64,
    camera: (CameraArgs, Option<CameraFile>),
    telemetry: ReplayTelemetry,
    tracks: tracker::TrackerSettings,
    parameters: Parameters,
    /// The camera is on a gimbal.
    gimbal: bool,
    onboard: Option<Lookout>,
    levels: BTreeMap<u16, AlertLevel>,
    mot: Option<TextFile>,
    jsonl: Option<TextFile>,
    pictures: Option<PictureOutput>,
    #[cfg(feature = "mcap")]
    mcap: Option<mcap::McapWriter>,
    digest: Option<Digest>,
    /// No output was requested: detections are printed in words.
    print: bool,
    picture: ColourPicture,
    colours: Colours,
    frames: u64,
    found: u64,
    dropped: u64,
    start: Instant,
    /// Whether positions matter: the vehicle's log was given, or messages are sent.
    heard: bool,
    /// No line about the end of the flight: it is one of many.
    quiet: bool,
}

impl ReplayOutputs {
    fn create(
        args: &ReplayArgs,
        threshold: i32,
        own: Option<CameraFile>,
        tracks: tracker::TrackerSettings,
    ) -> Result<Self, Error> {
        let simulated = args.flight.telemetry(args.input.as_deref());
        let create = |path: &Option<PathBuf>| path.as_deref().map(TextFile::create).transpose();
        let outputs = Self {
            threshold,
            lead: args.lead,
            camera: (args.camera.clone(), own),
            parameters: args.telemetry.parameters()?,
            gimbal: args.telemetry.gimbal,
            telemetry: ReplayTelemetry::open(&args.telemetry, simulated)?,
            tracks,
            onboard: None,
            levels: BTreeMap::new(),
            mot: create(&args.detections)?,
            jsonl: create(&args.jsonl)?,
            pictures: args.annotate.as_deref().map(PictureOutput::create).transpose()?,
            #[cfg(feature = "mcap")]
            mcap: args.mcap.as_deref().map(mcap::McapWriter::create).transpose()?,
            digest: args.digest.then(Digest::default),
            print: false,
            picture: ColourPicture::default(),
            colours: match args.annotate {
                Some(_) => Colours::open(args.input.as_deref()),
                None => Colours::Grey,
            },
            frames: 0,
            found: 0,
            dropped: 0,
            start: Instant::now(),
            heard: args.telemetry.hears() || args.telemetry.speaks(),
            quiet: args.many.manifest.is_some(),
        };
        let asked = outputs.mot.is_some()
            || outputs.jsonl.is_some()
            || outputs.pictures.is_some()
            || outputs.digest.is_some()
            || args.telemetry.speaks();
        #[cfg(feature = "mcap")]
        let asked = asked || outputs.mcap.is_some();
        Ok(Self { print: !asked, ..outputs })
    }

    fn take(&mut self, number: u64, frame: &Frame, found: &Detections) -> Result<(), Error> {
        self.frames = number;
        let onboard = match &mut self.onboard {
            Some(onboard) => onboard,
            none => {
                let (args, own) = &self.camera;
                let camera = args.camera(frame.width, frame.height, own.as_ref())?;
                let component =
                    component::ComponentConfig { gimbal: self.gimbal, ..Default::default() };
                let kept = self.parameters;
                none.insert(Lookout::new(camera, self.tracks, component, kept, 0))
            }
        };
        let now_us = frame.time_us.saturating_add(LATENCY_US);
        self.telemetry.advance(onboard, now_us)?;
        let tracks = onboard.process(found, frame.time_us, now_us);
        if number <= self.lead {
            return Ok(());
        }
        let mut found = found.clone();
        found.list.retain(|detection| detection.score >= self.threshold);
        let found = &found;
        self.found += found.list.len() as u64;
        self.dropped += u64::from(found.dropped);
        if let Some(mot) = &mut self.mot {
            mot.write(&detections::mot_lines(number, found))?;
        }
        if let Some(jsonl) = &mut self.jsonl {
            jsonl.write(&detections::json_line(number, frame.time_us, found, Some(&tracks)))?;
        }
        if let Some(pictures) = &mut self.pictures {
            self.colours.next(frame, &mut self.picture);
            self.picture.detections(found);
            self.picture.tracks(&tracks);
            pictures.write(number, frame.time_us, &self.picture)?;
        }
        #[cfg(feature = "mcap")]
        if let Some(mcap) = &mut self.mcap {
            mcap.take(number, frame, found, (&tracks, onboard.is_pointed()))?;
        }
        if let Some(digest) = &mut self.digest {
            digest.update(&found.list);
        }
        if self.print {
            for detection in &found.list {
                print_line(&in_words(number, frame.time_us, detection))?;
            }
            for track in &tracks {
                let level = self.levels.entry(track.id).or_default();
                if track.level > *level {
                    let seconds = frame.time_us as f64 / 1e6;
                    let words = traffic::in_words(track, onboard.is_pointed());
                    print_line(&format!("frame {number}, {seconds:.3} s: {words}"))?;
                }
                *level = track.level;
            }
        }
        Ok(())
    }

    /// Completes the files also after an error; returns the first error.
    fn finish(self, ended: Result<Ended, Error>) -> Result<Ended, Error> {
        let completed = self.pictures.map_or(Ok(()), PictureOutput::finish);
        #[cfg(feature = "mcap")]
        let written = self.mcap.map_or(Ok(()), mcap::McapWriter::finish);
        let logged = self.telemetry.finish();
        let ended = ended?;
        logged?;
        completed?;
        #[cfg(feature = "mcap")]
        written?;
        let Self { frames, found, dropped, .. } = self;
        if let Some(digest) = self.digest.filter(|_| ended == Ended::Complete) {
            print_line(&format!("{:016x}", digest.value()))?;
        }
        if self.quiet {
            return Ok(ended);
        }
        let rate = frames as f64 / self.start.elapsed().as_secs_f64();
        let lost = if dropped > 0 {
            format!(
                " ({:.0} candidate windows a frame beyond the limit, the weakest, not classified)",
                f64::from(u32::try_from(dropped).unwrap_or(u32::MAX)) / frames.max(1) as f64
            )
        } else {
            String::new()
        };
        eprintln!("{frames} frames, {found} detections{lost}, {rate:.1} frames a second");
        if let Some(words) = self.onboard.as_ref().filter(|_| self.heard).and_then(unplaced) {
            eprintln!("lookout: {words}");
        }
        if ended == Ended::Interrupted {
            eprintln!(
                "lookout: interrupted after frame {frames}; what was written is complete up to there"
            );
        }
        Ok(ended)
    }
}

/// `frame 12, 0.367 s: 14.0x9.5 px at (120.0, 33.5), score 3.21 (log-odds), moving (+1.2, -0.4) px a frame`.
fn in_words(number: u64, time_us: i64, detection: &Detection) -> String {
    let [x, y, width, height] = detections::rect(detection).map(|v| v.to_f64());
    let score = detections::Decimal::score(detection.score).to_f64();
    let oldest = detection.shifts.last().copied().unwrap_or_default();
    let per_frame =
        |shift: fixed::types::I28F4| 0.0 - shift.to_num::<f64>() / detection.shifts.len() as f64;
    let (vx, vy) = (per_frame(oldest.x), per_frame(oldest.y));
    let seconds = time_us as f64 / 1e6;
    format!(
        "frame {number}, {seconds:.3} s: {width:.1}x{height:.1} px at ({x:.1}, {y:.1}), score {score:.2} (log-odds), \
         moving ({vx:+.1}, {vy:+.1}) px a frame"
    )
}
