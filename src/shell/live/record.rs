//! The last minutes as the detector saw them, for `lookout replay`: segments of a minute, of which the oldest give way.
//!
//! A segment is a folder: `frames/` with the pictures and their times, `telemetry.tlog` with all that was heard and said,
//! `detections.jsonl` with what was found and followed, `parameters.txt`, `camera.json` where the source knows its camera,
//! and `replay.txt` with the command that finds the same. The detector remembers the frames before: a later segment begins
//! with the last ones of the segment before it, of which nothing is told. Detections come out the same bit for bit; tracks
//! too, but made anew in each segment, and with a vehicle's telemetry only nearly: a replay hears that by its own times.

use super::config::Config;
use super::ring::Ring;
use super::worker::Seen;
use super::writer::Writer;
use crate::mavlink::component::parameters::Parameters;
use crate::shell::formats::camera_file::CameraFile;
use crate::shell::formats::detections;
use crate::shell::formats::tlog;
use crate::shell::link::params;
use crate::shell::sources::Frame;
use crate::shell::support::clock;
use crate::tracking::traffic::Traffic;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use mavlink_core::MAVLinkMessageRaw;
use std::collections::VecDeque;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::string::String;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::vec::Vec;
use std::{format, mem};

/// How long a segment is, microseconds.
const SEGMENT_US: i64 = 60_000_000;
/// Frames, and other items, that wait to be written at most.
const FRAMES: usize = 30;
const ITEMS: usize = 1024;
/// Messages kept for the segment that begins with an earlier frame.
const BEFORE: usize = 1024;
/// Frames after which a detector finds what one finds that has run for ever: its slices reach 10 frames back, and what it
/// keeps of scores and sizes fades by half each frame.
const LEAD: usize = 64;
/// MAVLink's HEARTBEAT.
const HEARTBEAT: u32 = 0;
/// The component id of autopilots.
const AUTOPILOT: u8 = 1;

#[derive(Debug)]
enum Item {
    Frame(Recorded),
    Message { time_us: i64, bytes: Vec<u8>, autopilot: bool },
}

/// A frame and what is kept with it.
#[derive(Debug)]
struct Recorded {
    frame: Arc<Frame>,
    /// In the run, from 1.
    number: u64,
    line: String,
    parameters: Parameters,
    /// Whether it follows the one that was handed over before it.
    whole: bool,
}

/// Records.
#[derive(Debug)]
pub struct Recorder {
    writer: Writer<Item>,
    waiting: Arc<AtomicUsize>,
    /// Whether every frame since the segment began was handed over.
    whole: bool,
}

impl Recorder {
    /// Records into a folder, as the settings say; `own` is what the source knows of its camera, `least_score` that of the
    /// detections that are told.
    ///
    /// # Errors
    /// The system's.
    pub fn open(
        root: &Path,
        config: &Config,
        own: Option<&CameraFile>,
        least_score: i32,
    ) -> io::Result<Self> {
        let mut files = Files {
            ring: Ring::open(root)?,
            // The one that is written holds less than a minute.
            segments: usize::try_from(config.record_minutes)
                .unwrap_or(usize::MAX)
                .saturating_add(1),
            bytes: config.record_megabytes.saturating_mul(1_000_000),
            command: command(config, least_score),
            camera: own.map(serde_json::to_string).transpose()?,
            unix_us: clock::unix_offset_us(),
            segment: None,
            before: VecDeque::new(),
            heartbeat: None,
        };
        let waiting = Arc::<AtomicUsize>::default();
        let done = waiting.clone();
        let write = move |item| {
            let frame = matches!(item, Item::Frame(_));
            let written = files.take(item);
            if frame {
                done.fetch_sub(1, Ordering::Relaxed);
            }
            written
        };
        let writer = Writer::start("recording", ITEMS, write)?;
        Ok(Self { writer, waiting, whole: true })
    }

    /// Takes a frame, its number in the run, what is followed in it, and under which parameters.
    pub fn see(&mut self, seen: &Seen, tracks: &[Traffic], parameters: &Parameters, number: u64) {
        let room = self.waiting.fetch_add(1, Ordering::Relaxed) < FRAMES;
        let frame = seen.frame.clone();
        let line = detections::json_line(number, frame.time_us, &seen.found, Some(tracks));
        let (parameters, whole) = (*parameters, self.whole);
        // Without room the same is said, but of a frame that is lost.
        let recorded = Recorded { frame, number, line, parameters, whole };
        let handed = room && self.writer.hand(Item::Frame(recorded));
        if !handed {
            self.waiting.fetch_sub(1, Ordering::Relaxed);
            if mem::replace(&mut self.whole, false) {
                tracing::warn!("recording: the disk is too slow, a new segment begins after a gap");
            }
        } else {
            self.whole = true;
        }
    }

    /// Takes a message that was heard.
    pub fn heard(&mut self, frame: &MAVLinkMessageRaw, time_us: i64) {
        let bytes = match frame {
            MAVLinkMessageRaw::V1(frame) => frame.raw_bytes(),
            MAVLinkMessageRaw::V2(frame) => frame.raw_bytes(),
        };
        let autopilot = frame.message_id() == HEARTBEAT && frame.component_id() == AUTOPILOT;
        self.message(time_us, bytes, autopilot);
    }

    /// Takes a message, heard or said.
    pub fn message(&mut self, time_us: i64, bytes: &[u8], autopilot: bool) {
        self.writer.hand(Item::Message { time_us, bytes: bytes.into(), autopilot });
    }
}

/// The command that replays a segment, from within its folder.
fn command(config: &Config, least_score: i32) -> String {
    let score = f64::from(least_score) / f64::from(1 << detections::SCORE_BITS);
    let mut command = format!(
        "lookout replay frames --tlog-in telemetry.tlog --parameters parameters.txt --threshold={score} --digest"
    );
    let absolute = |path: &Path| std::path::absolute(path).unwrap_or(path.into());
    if let Some(path) = &config.camera.calibration {
        command += &format!(" --camera '{}'", absolute(path).display());
    } else {
        command += &format!(" --fov {}", config.camera.field_of_view);
    }
    if config.camera.mounting.iter().any(|&angle| angle != 0.0) {
        let angles: Vec<_> =
            config.camera.mounting.iter().map(|angle| format!("{angle}")).collect();
        command += &format!(" --mounting={}", angles.join(","));
    }
    if let Some(path) = &config.model {
        command += &format!(" --model '{}'", absolute(path).display());
    }
    command
}

/// What the writing thread works on.
struct Files {
    ring: Ring,
    segments: usize,
    bytes: u64,
    command: String,
    /// `camera.json`.
    camera: Option<String>,
    unix_us: i64,
    segment: Option<Segment>,
    /// The last messages with their times.
    before: VecDeque<(i64, Vec<u8>)>,
    /// The last one of the autopilot: a replay must know it before anything else.
    heartbeat: Option<Vec<u8>>,
}

/// The segment that is written.
struct Segment {
    folder: PathBuf,
    /// Of its first picture, and of the first one that was not taken over.
    first_us: i64,
    begun_us: i64,
    size: (usize, usize),
    frames: u64,
    /// Frames to come of which nothing is told.
    lead: usize,
    /// The last pictures and their times.
    last: VecDeque<(String, i64)>,
    times: File,
    telemetry: File,
    lines: File,
}

impl Files {
    fn take(&mut self, item: Item) -> io::Result<()> {
        match item {
            Item::Message { time_us, bytes, autopilot } => {
                if autopilot {
                    self.heartbeat = Some(bytes.clone());
                }
                if let Some(segment) = &mut self.segment {
                    tlog::write(&mut segment.telemetry, time_us + self.unix_us, &bytes)?;
                    self.ring.wrote(bytes.len() as u64 + 8, self.segments, self.bytes)?;
                }
                if self.before.len() == BEFORE {
                    self.before.pop_front();
                }
                self.before.push_back((time_us, bytes));
                Ok(())
            }
            Item::Frame(recorded) => {
                let Recorded { frame, line, .. } = &recorded;
                let goes_on = self.segment.as_ref().is_some_and(|segment| {
                    recorded.whole
                        && segment.size == (frame.width, frame.height)
                        && frame.time_us - segment.begun_us < SEGMENT_US
                });
                if !goes_on {
                    // Where it cannot be begun, the next frame tries again.
                    let before = self.segment.take();
                    self.segment = Some(self.begin(&recorded, before)?);
                }
                let Some(segment) = &mut self.segment else { return Ok(()) };
                let written = segment.write(frame, line);
                if written.is_err() {
                    // A segment with a hole would not replay.
                    self.segment = None;
                }
                self.ring.wrote(written?, self.segments, self.bytes)
            }
        }
    }

    /// Begins a segment with a frame, after the segment that was written until now.
    fn begin(&mut self, recorded: &Recorded, before: Option<Segment>) -> io::Result<Segment> {
        let frame = &recorded.frame;
        let size = (frame.width, frame.height);
        // A detector that begins remembers nothing. Of one that goes on the frames before are here, or, after a gap, the
        // next ones have to do.
        let begins = recorded.number == 1 || before.as_ref().is_some_and(|b| b.size != size);
        let before = before.filter(|_| recorded.whole && !begins);
        let lead = match &before {
            Some(before) => before.last.len(),
            None if begins => 0,
            None => LEAD,
        };
        let folder = self.ring.start()?.to_path_buf();
        fs::create_dir(folder.join("frames"))?;
        let lead_in = if lead > 0 { format!(" --lead {lead}") } else { String::new() };
        fs::write(folder.join("replay.txt"), format!("{}{lead_in}\n", self.command))?;
        params::save(&folder.join("parameters.txt"), &recorded.parameters)?;
        if let Some(camera) = &self.camera {
            fs::write(folder.join("camera.json"), camera)?;
        }
        let oldest = before.as_ref().and_then(|before| before.last.front());
        let first_us = oldest.map_or(frame.time_us, |(_, time_us)| *time_us);
        let create = |name: &str| File::create(folder.join(name));
        let mut telemetry = create("telemetry.tlog")?;
        // The first message is of the time of the first frame: there a replay begins.
        if let Some(first) = self.heartbeat.as_ref().or(self.before.back().map(|(_, bytes)| bytes))
        {
            tlog::write(&mut telemetry, first_us + self.unix_us, first)?;
        }
        for (time_us, bytes) in self.before.iter().filter(|(time, _)| *time >= first_us) {
            tlog::write(&mut telemetry, time_us + self.unix_us, bytes)?;
        }
        let mut segment = Segment {
            first_us,
            begun_us: frame.time_us,
            size,
            frames: 0,
            lead: if before.is_some() { 0 } else { lead },
            last: VecDeque::new(),
            times: create("frames/times.csv")?,
            lines: create("detections.jsonl")?,
            telemetry,
            folder,
        };
        let taken_over = before.map_or(Ok(0), |before| segment.take_over(&before))?;
        self.ring.wrote(taken_over, self.segments, self.bytes)?;
        Ok(segment)
    }
}

impl Segment {
    /// Writes a frame; gives the bytes that it took.
    fn write(&mut self, frame: &Frame, line: &str) -> io::Result<u64> {
        let name = self.next_name();
        let mut png = Vec::new();
        // Of a noisy picture nothing more is gained by harder work.
        PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Up)
            .write_image(
                &frame.pixels,
                frame.width as u32,
                frame.height as u32,
                ExtendedColorType::L8,
            )
            .map_err(io::Error::other)?;
        let path = self.folder.join("frames").join(&name);
        // A picture cut off by a loss of power must not stop a replay; hidden ones are not read.
        let hidden = self.folder.join("frames").join(format!(".{name}"));
        fs::write(&hidden, &png)?;
        self.note(name, frame.time_us)?;
        fs::rename(hidden, path)?;
        if self.lead > 0 {
            self.lead -= 1;
            return Ok(png.len() as u64);
        }
        self.lines.write_all(line.as_bytes())?;
        Ok((png.len() + line.len()) as u64)
    }

    /// Takes the last pictures of the segment before this one over: without work, where the file system has links. Gives
    /// their bytes.
    fn take_over(&mut self, before: &Self) -> io::Result<u64> {
        let mut bytes = 0;
        for (old, time_us) in &before.last {
            let name = self.next_name();
            let old = before.folder.join("frames").join(old);
            let new = self.folder.join("frames").join(&name);
            fs::hard_link(&old, &new).or_else(|_| fs::copy(&old, &new).map(drop))?;
            bytes += fs::metadata(new)?.len();
            self.note(name, *time_us)?;
        }
        Ok(bytes)
    }

    fn next_name(&mut self) -> String {
        self.frames += 1;
        format!("{:06}.png", self.frames)
    }

    /// Notes the time of a picture.
    fn note(&mut self, name: String, time_us: i64) -> io::Result<()> {
        let time = format!("{name},{}\n", time_us - self.first_us);
        self.times.write_all(time.as_bytes())?;
        if self.last.len() == LEAD {
            self.last.pop_front();
        }
        self.last.push_back((name, time_us));
        Ok(())
    }
}
