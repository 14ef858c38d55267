//! The last minutes as the detector saw them, for `lookout replay`: segments of a minute, of which the oldest give way.
//!
//! A segment is a folder: `frames/` with the pictures and their times, `telemetry.tlog` with all that was heard and said,
//! `detections.jsonl` with what was found, `replay.txt` with the command that finds the same. The detector remembers the
//! frames before, which a later segment does not hold: its first frames may be judged otherwise.

use super::config::Config;
use super::ring::Ring;
use super::service::keep_score;
use super::worker::Seen;
use super::writer::Writer;
use crate::shell::clock;
use crate::shell::detections;
use crate::shell::source::Frame;
use crate::shell::tlog;
use crate::traffic::Traffic;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use mavlink::MAVLinkMessageRaw;
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
const BEFORE: usize = 256;
/// MAVLink's HEARTBEAT.
const HEARTBEAT: u32 = 0;
/// The component id of autopilots.
const AUTOPILOT: u8 = 1;

#[derive(Debug)]
enum Item {
    Frame { frame: Arc<Frame>, line: String, whole: bool },
    Message { time_us: i64, bytes: Vec<u8>, autopilot: bool },
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
    /// Records into a folder, as the settings say.
    ///
    /// # Errors
    /// The system's.
    pub fn open(root: &Path, config: &Config) -> io::Result<Self> {
        let mut files = Files {
            ring: Ring::open(root)?,
            // The one that is written holds less than a minute.
            segments: usize::try_from(config.record_minutes)
                .unwrap_or(usize::MAX)
                .saturating_add(1),
            bytes: config.record_megabytes.saturating_mul(1_000_000),
            command: command(config),
            unix_us: clock::unix_offset_us(),
            segment: None,
            before: VecDeque::new(),
            heartbeat: None,
        };
        let waiting = Arc::<AtomicUsize>::default();
        let done = waiting.clone();
        let write = move |item| {
            let frame = matches!(item, Item::Frame { .. });
            let written = files.take(item);
            if frame {
                done.fetch_sub(1, Ordering::Relaxed);
            }
            written
        };
        let writer = Writer::start("recording", ITEMS, write)?;
        Ok(Self { writer, waiting, whole: true })
    }

    /// Takes a frame, its number in the run, and what is followed in it.
    pub fn see(&mut self, seen: &Seen, tracks: &[Traffic], number: u64) {
        let room = self.waiting.fetch_add(1, Ordering::Relaxed) < FRAMES;
        let frame = seen.frame.clone();
        let line = detections::json_line(number, frame.time_us, &seen.found, Some(tracks));
        // Without room the same is said, but of a frame that is lost.
        let handed = room && self.writer.hand(Item::Frame { frame, line, whole: self.whole });
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
fn command(config: &Config) -> String {
    let score = f64::from(keep_score()) / f64::from(1 << detections::SCORE_BITS);
    let mut command =
        format!("lookout replay frames --tlog-in telemetry.tlog --threshold={score} --digest");
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
    first_us: i64,
    size: (usize, usize),
    frames: u64,
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
            Item::Frame { frame, line, whole } => {
                let size = (frame.width, frame.height);
                let goes_on = self.segment.as_ref().is_some_and(|segment| {
                    whole && segment.size == size && frame.time_us - segment.first_us < SEGMENT_US
                });
                if !goes_on {
                    // Where it cannot be begun, the next frame tries again.
                    self.segment = None;
                    self.segment = Some(self.begin(&frame)?);
                }
                let Some(segment) = &mut self.segment else { return Ok(()) };
                let written = segment.write(&frame, &line);
                if written.is_err() {
                    // A segment with a hole would not replay.
                    self.segment = None;
                }
                self.ring.wrote(written?, self.segments, self.bytes)
            }
        }
    }

    fn begin(&mut self, frame: &Frame) -> io::Result<Segment> {
        let folder = self.ring.start()?.to_path_buf();
        fs::create_dir(folder.join("frames"))?;
        fs::write(folder.join("replay.txt"), format!("{}\n", self.command))?;
        let create = |name: &str| File::create(folder.join(name));
        let mut telemetry = create("telemetry.tlog")?;
        // The first message is of the time of the first frame: there a replay begins.
        if let Some(heartbeat) = &self.heartbeat {
            tlog::write(&mut telemetry, frame.time_us + self.unix_us, heartbeat)?;
        }
        for (time_us, bytes) in self.before.iter().filter(|(time, _)| *time >= frame.time_us) {
            tlog::write(&mut telemetry, time_us + self.unix_us, bytes)?;
        }
        Ok(Segment {
            first_us: frame.time_us,
            size: (frame.width, frame.height),
            frames: 0,
            times: create("frames/times.csv")?,
            lines: create("detections.jsonl")?,
            telemetry,
            folder,
        })
    }
}

impl Segment {
    /// Writes a frame; gives the bytes that it took.
    fn write(&mut self, frame: &Frame, line: &str) -> io::Result<u64> {
        self.frames += 1;
        let name = format!("{:06}.png", self.frames);
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
        fs::rename(hidden, path)?;
        let time = format!("{name},{}\n", frame.time_us - self.first_us);
        self.times.write_all(time.as_bytes())?;
        self.lines.write_all(line.as_bytes())?;
        Ok((png.len() + time.len() + line.len()) as u64)
    }
}
