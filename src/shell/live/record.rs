//! Recording of the last minutes for `lookout replay`, in segments of a minute, the oldest of which are removed.
//!
//! A segment is a folder: `frames/` with the pictures and their times, `telemetry.tlog` with all messages received and sent,
//! `detections.jsonl` with detections and tracks, `parameters.txt`, `camera.json` where the source has a calibration,
//! and `replay.txt` with the command that replays it. Detections depend on the frames before: a later segment begins with
//! the last ones of the segment before it, for which no detections are printed. Detections are the same bit for bit; tracks
//! too, but they start anew in each segment, and with a vehicle's telemetry only nearly: a replay receives it by its own times.

use super::config::ServiceConfig;
use super::ring::{self, FolderRing};
use super::worker::ProcessedFrame;
use super::writer::Writer;
use crate::detector::temporal_score::MEMORY;
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
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::string::String;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::vec::Vec;
use std::{format, mem};

/// Length of a segment, microseconds.
const SEGMENT_US: i64 = 60_000_000;
/// Frames, and other items, that wait to be written at most.
const FRAMES: usize = 30;
const ITEMS: usize = 1024;
/// Messages kept for the segment that begins with an earlier frame.
const BEFORE: usize = 1024;
/// Time from a frame that could not be written to the next that is tried, microseconds.
const AGAIN_US: i64 = 1_000_000;
/// Frames after which a detector finds what one finds that has run for ever: its slices reach 10 frames back, and scores and
/// sizes depend on [`MEMORY`] frames that had all of theirs.
const LEAD: usize = 68;
const _: () = assert!(10 + MEMORY <= LEAD);
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

/// Recording of frames and telemetry in segments.
#[derive(Debug)]
pub struct Recorder {
    writer: Writer<Item>,
    waiting: Arc<AtomicUsize>,
    failing: Arc<AtomicBool>,
    /// Whether every frame since the segment began was handed over.
    whole: bool,
}

impl Recorder {
    /// Records into a folder, as the settings say; `own` is what the source knows of its camera, `least_score` that of the
    /// detections that are recorded.
    ///
    /// # Errors
    /// The system's.
    pub fn open(
        root: &Path,
        config: &ServiceConfig,
        own: Option<&CameraFile>,
        least_score: i32,
    ) -> io::Result<Self> {
        let mut files = RecordWriter {
            ring: FolderRing::open(root)?,
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
            failing: Arc::default(),
            again_us: None,
        };
        let failing = files.failing.clone();
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
        Ok(Self { writer, waiting, failing, whole: true })
    }

    /// Whether frames cannot be written at present.
    pub fn is_failing(&self) -> bool {
        self.failing.load(Ordering::Relaxed)
    }

    /// Takes a frame, its number in the run, what is followed in it, and under which parameters.
    pub fn see(
        &mut self,
        seen: &ProcessedFrame,
        tracks: &[Traffic],
        parameters: &Parameters,
        number: u64,
    ) {
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

    /// Records a received message.
    pub fn heard(&mut self, frame: &MAVLinkMessageRaw, time_us: i64) {
        let bytes = match frame {
            MAVLinkMessageRaw::V1(frame) => frame.raw_bytes(),
            MAVLinkMessageRaw::V2(frame) => frame.raw_bytes(),
        };
        let autopilot = frame.message_id() == HEARTBEAT && frame.component_id() == AUTOPILOT;
        self.message(time_us, bytes, autopilot);
    }

    /// Records a message, received or sent.
    pub fn message(&mut self, time_us: i64, bytes: &[u8], autopilot: bool) {
        self.writer.hand(Item::Message { time_us, bytes: bytes.into(), autopilot });
    }
}

/// The command that replays a segment, from within its folder.
fn command(config: &ServiceConfig, least_score: i32) -> String {
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
    if let Some(path) = &config.camera.mask {
        command += &format!(" --mask '{}'", absolute(path).display());
    }
    if let Some(path) = &config.model {
        command += &format!(" --model '{}'", absolute(path).display());
    }
    command
}

/// State of the writing thread.
struct RecordWriter {
    ring: FolderRing,
    segments: usize,
    bytes: u64,
    command: String,
    /// `camera.json`.
    camera: Option<String>,
    unix_us: i64,
    segment: Option<OpenSegment>,
    /// The last messages with their times.
    before: VecDeque<(i64, Vec<u8>)>,
    /// The last one of the autopilot: a replay must know it before anything else.
    heartbeat: Option<Vec<u8>>,
    /// Whether the last frame could not be written, and before which frame time it is not tried again.
    failing: Arc<AtomicBool>,
    again_us: Option<i64>,
}

/// A file that is appended to. A part that does not fit leaves it as it was.
struct Growing {
    file: File,
    len: u64,
}

impl Growing {
    fn create(path: &Path) -> io::Result<Self> {
        Ok(Self { file: File::create(path)?, len: 0 })
    }

    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        let written = self.file.write_all(bytes);
        match written {
            Ok(()) => self.len += bytes.len() as u64,
            Err(_) => self.cut(self.len),
        }
        written
    }

    /// Goes back to an earlier length.
    fn cut(&mut self, len: u64) {
        // Giving room back does not fail; a file that is gone is not read either.
        let _ = self.file.set_len(len).and_then(|()| self.file.seek(SeekFrom::Start(len)));
        self.len = len;
    }
}

/// The segment that is written.
struct OpenSegment {
    folder: PathBuf,
    /// Time of its first picture, and of the first one that is not from the segment before.
    first_us: i64,
    begun_us: i64,
    size: (usize, usize),
    frames: u64,
    /// Whether it has a frame that the segment before has not.
    own: bool,
    /// Frames to come for which no detections are recorded.
    lead: usize,
    /// The last pictures and their times.
    last: VecDeque<(String, i64)>,
    times: Growing,
    telemetry: Growing,
    lines: Growing,
}

impl RecordWriter {
    fn take(&mut self, item: Item) -> io::Result<()> {
        match item {
            Item::Message { time_us, bytes, autopilot } => {
                if autopilot {
                    self.heartbeat = Some(bytes.clone());
                }
                if let Some(segment) = &mut self.segment {
                    let mut record = Vec::new();
                    tlog::write(&mut record, time_us + self.unix_us, &bytes)?;
                    // A disk that is full is noticed, and said, with the next frame.
                    if segment.telemetry.append(&record).is_ok() {
                        self.ring.wrote(record.len() as u64, self.segments, self.bytes);
                    }
                }
                if self.before.len() == BEFORE {
                    self.before.pop_front();
                }
                self.before.push_back((time_us, bytes));
                Ok(())
            }
            Item::Frame(recorded) => {
                let now_us = recorded.frame.time_us;
                if self.again_us.is_some_and(|again| (again - AGAIN_US..again).contains(&now_us)) {
                    return Ok(());
                }
                let mut written = self.frame(&recorded);
                // As much of the past gives way as the present needs, but never the last whole segment.
                while written.as_ref().is_err_and(ring::is_full)
                    && self.ring.give_way(1 + usize::from(self.segment.is_some()))
                {
                    written = self.frame(&recorded);
                }
                self.again_us = written.is_err().then_some(now_us + AGAIN_US);
                let failing = self.failing.swap(written.is_err(), Ordering::Relaxed);
                match written {
                    Ok(()) if failing => tracing::info!("recording goes on"),
                    Err(error) => {
                        // A segment with a hole would not replay, one without a frame is no segment.
                        if self.segment.take().is_some_and(|segment| !segment.own) {
                            self.ring.abandon();
                        }
                        if !failing {
                            tracing::error!("recording stopped, tried again every second: {error}");
                        }
                    }
                    Ok(()) => {}
                }
                Ok(())
            }
        }
    }

    /// Writes a frame, to a new segment where the one before has ended.
    fn frame(&mut self, recorded: &Recorded) -> io::Result<()> {
        let Recorded { frame, line, .. } = recorded;
        let goes_on = self.segment.as_ref().is_some_and(|segment| {
            recorded.whole
                && segment.size == (frame.width, frame.height)
                && frame.time_us - segment.begun_us < SEGMENT_US
        });
        if !goes_on {
            let folder = self.ring.start()?.to_path_buf();
            match self.begin(folder, recorded) {
                Ok(segment) => self.segment = Some(segment),
                Err(error) => {
                    self.ring.abandon();
                    return Err(error);
                }
            }
        }
        let Some(segment) = &mut self.segment else { return Ok(()) };
        let written = segment.write(frame, line)?;
        self.ring.wrote(written, self.segments, self.bytes);
        Ok(())
    }

    /// Begins a segment in `folder` with a frame, after the segment that was written until now.
    fn begin(&mut self, folder: PathBuf, recorded: &Recorded) -> io::Result<OpenSegment> {
        let before = self.segment.as_ref();
        let frame = &recorded.frame;
        let size = (frame.width, frame.height);
        // A detector that begins remembers nothing. Of one that goes on the frames before are here, or, after a gap, the
        // next ones have to do.
        let begins = recorded.number == 1 || before.is_some_and(|b| b.size != size);
        let before = before.filter(|_| recorded.whole && !begins);
        let lead = match before {
            Some(before) => before.last.len(),
            None if begins => 0,
            None => LEAD,
        };
        fs::create_dir(folder.join("frames"))?;
        let lead_in = if lead > 0 { format!(" --lead {lead}") } else { String::new() };
        fs::write(folder.join("replay.txt"), format!("{}{lead_in}\n", self.command))?;
        params::save(&folder.join("parameters.txt"), &recorded.parameters)?;
        if let Some(camera) = &self.camera {
            fs::write(folder.join("camera.json"), camera)?;
        }
        let oldest = before.and_then(|before| before.last.front());
        let first_us = oldest.map_or(frame.time_us, |(_, time_us)| *time_us);
        let create = |name: &str| Growing::create(&folder.join(name));
        let mut records = Vec::new();
        // The first message is of the time of the first frame: there a replay begins.
        if let Some(first) = self.heartbeat.as_ref().or(self.before.back().map(|(_, bytes)| bytes))
        {
            tlog::write(&mut records, first_us + self.unix_us, first)?;
        }
        for (time_us, bytes) in self.before.iter().filter(|(time, _)| *time >= first_us) {
            tlog::write(&mut records, time_us + self.unix_us, bytes)?;
        }
        let mut telemetry = create("telemetry.tlog")?;
        telemetry.append(&records)?;
        let mut segment = OpenSegment {
            first_us,
            begun_us: frame.time_us,
            size,
            frames: 0,
            own: false,
            lead: if before.is_some() { 0 } else { lead },
            last: VecDeque::new(),
            times: create("frames/times.csv")?,
            lines: create("detections.jsonl")?,
            telemetry,
            folder,
        };
        let taken_over = before.map_or(Ok(0), |before| segment.take_over(before))?;
        self.ring.wrote(taken_over, self.segments, self.bytes);
        Ok(segment)
    }
}

impl OpenSegment {
    /// Writes a frame; gives the bytes that it took. Where a part of it does not fit, nothing of it is left.
    fn write(&mut self, frame: &Frame, line: &str) -> io::Result<u64> {
        let (times, lines) = (self.times.len, self.lines.len);
        let name = format!("{:06}.png", self.frames + 1);
        let written = self.picture(&name, frame, line);
        match &written {
            Ok(_) => {
                self.frames += 1;
                self.own = true;
                self.lead = self.lead.saturating_sub(1);
            }
            Err(_) => {
                self.times.cut(times);
                self.lines.cut(lines);
                for name in [format!(".{name}"), name] {
                    // It may not have come so far.
                    let _ = fs::remove_file(self.folder.join("frames").join(name));
                }
            }
        }
        written
    }

    fn picture(&mut self, name: &str, frame: &Frame, line: &str) -> io::Result<u64> {
        let mut png = Vec::new();
        let (width, height) = frame.size();
        // Of a noisy picture nothing more is gained by harder work.
        PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Up)
            .write_image(&frame.pixels, width, height, ExtendedColorType::L8)
            .map_err(io::Error::other)?;
        let path = self.folder.join("frames").join(name);
        // A picture cut off by a loss of power must not stop a replay; hidden ones are not read.
        let hidden = self.folder.join("frames").join(format!(".{name}"));
        fs::write(&hidden, &png)?;
        self.note_time(name, frame.time_us)?;
        let line = if self.lead > 0 { "" } else { line };
        self.lines.append(line.as_bytes())?;
        fs::rename(hidden, path)?;
        self.remember(name, frame.time_us);
        Ok((png.len() + line.len()) as u64)
    }

    /// Takes the last pictures of the segment before this one over: without work, where the file system has links. Gives
    /// their bytes.
    fn take_over(&mut self, before: &Self) -> io::Result<u64> {
        let mut bytes = 0;
        for (old, time_us) in &before.last {
            self.frames += 1;
            let name = format!("{:06}.png", self.frames);
            let old = before.folder.join("frames").join(old);
            let new = self.folder.join("frames").join(&name);
            fs::hard_link(&old, &new).or_else(|_| fs::copy(&old, &new).map(drop))?;
            bytes += fs::metadata(new)?.len();
            self.note_time(&name, *time_us)?;
            self.remember(&name, *time_us);
        }
        Ok(bytes)
    }

    fn note_time(&mut self, name: &str, time_us: i64) -> io::Result<()> {
        self.times.append(format!("{name},{}\n", time_us - self.first_us).as_bytes())
    }

    /// Keeps the name and time of a picture for the next segment.
    fn remember(&mut self, name: &str, time_us: i64) {
        if self.last.len() == LEAD {
            self.last.pop_front();
        }
        self.last.push_back((name.into(), time_us));
    }
}
