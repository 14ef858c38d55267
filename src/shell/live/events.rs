//! The event log, which explains every alert: a line of JSON and a picture of the st-cube.
//!
//! An alert is a track whose level rises. Its line waits a second for the messages about it: they are part of it.

use super::ring::{self, FolderRing};
use super::worker::ProcessedFrame;
use super::writer::Writer;
use crate::channels::window::SLICES;
use crate::image::Rect;
use crate::mavlink::dialect::MavMessage;
use crate::mavlink::lookout::Lookout;
use crate::shell::formats::detections;
use crate::shell::formats::detections::Box4;
use crate::shell::formats::traffic;
use crate::shell::pictures::strip;
use crate::shell::sources::Frame;
use crate::shell::support::clock;
use crate::tracking::traffic::{AlertLevel, Traffic};
use mavlink_core::{MAVLinkV2MessageRaw, MavlinkVersion, Message};
use serde::Serialize;
use std::collections::{BTreeMap, VecDeque};
use std::fmt::Write as _;
use std::fs::{self, OpenOptions};
use std::io::{self, Write as _};
use std::path::Path;
use std::string::String;
use std::sync::Arc;
use std::vec::Vec;
use std::{format, mem};

/// Time that an alert waits for the messages about it, microseconds.
const COLLECTED_US: i64 = 1_000_000;
/// Alerts that wait at most, and alerts that wait to be written.
const PENDING: usize = 32;
/// Messages kept with an alert.
const MESSAGES: usize = 64;
/// Number of folders of the log; the oldest is removed for a new one.
const FOLDERS: u64 = 8;
/// Messages about traffic: ADSB_VEHICLE, COLLISION, STATUSTEXT, OBSTACLE_DISTANCE, OBSTACLE_DISTANCE_3D.
const ABOUT_TRAFFIC: [u32; 5] = [246, 247, 253, 330, 11037];

/// A line of the log.
#[derive(Debug, Clone, Serialize)]
struct EventLine {
    /// Microseconds since 1970 at which the frame was taken.
    time_us: i64,
    level: &'static str,
    track: u16,
    words: String,
    /// To the right of the nose and above the vehicle's plane, degrees.
    azimuth_deg: Option<f64>,
    elevation_deg: Option<f64>,
    /// From body to north, east, down: w, x, y, z. `None` where it is not known.
    attitude: Option<[f64; 4]>,
    /// The frame as `lookout replay --jsonl` has it: all detections with their scores, motion, all tracks.
    frame: serde_json::Value,
    /// The slices of the st-cube, oldest first, beside this file.
    picture: String,
    /// Messages sent within a second of the frame.
    sent: Vec<Sent>,
}

#[derive(Debug, Clone, Serialize)]
struct Sent {
    after_ms: f64,
    message: &'static str,
    bytes: String,
}

/// An alert and what its picture is made of.
#[derive(Debug)]
struct AlertEvent {
    event: EventLine,
    frame_us: i64,
    frames: Vec<(Arc<Frame>, [f64; 2])>,
    rect: Box4,
}

/// Event log: JSON Lines in folders of limited size.
#[derive(Debug)]
pub struct EventLog {
    writer: Writer<AlertEvent>,
    frames: VecDeque<Arc<Frame>>,
    levels: BTreeMap<u16, AlertLevel>,
    pending: VecDeque<AlertEvent>,
}

impl EventLog {
    /// Opens the log in a folder, with a limit of its size in bytes.
    ///
    /// # Errors
    /// The system's.
    pub fn open(root: &Path, bytes: u64) -> io::Result<Self> {
        let mut ring = FolderRing::open(root)?;
        // The folder shows now, not at the first alert, that it can be written.
        while let Err(error) = ring.start() {
            if !ring::is_full(&error) || !ring.give_way(1) {
                return Err(error);
            }
        }
        ring.wrote(0, usize::MAX, bytes);
        let mut number = 0;
        let write = move |alert| {
            number += 1;
            write(&mut ring, bytes, number, &alert)
        };
        Ok(Self {
            writer: Writer::start("event log", PENDING, write)?,
            frames: VecDeque::new(),
            levels: BTreeMap::new(),
            pending: VecDeque::new(),
        })
    }

    /// Takes a frame and what is followed in it.
    pub fn see(
        &mut self,
        seen: &ProcessedFrame,
        tracks: &[Traffic],
        onboard: &Lookout,
        number: u64,
    ) {
        if self.frames.len() == SLICES {
            self.frames.pop_front();
        }
        self.frames.push_back(seen.frame.clone());
        self.levels.retain(|id, _| tracks.iter().any(|track| track.id == *id));
        for track in tracks {
            let level = self.levels.entry(track.id).or_default();
            let rises = track.level > mem::replace(level, track.level);
            if rises && track.confirmed {
                if self.pending.len() == PENDING {
                    self.write_first();
                }
                let alert = self.alert(seen, tracks, track, onboard, number);
                self.pending.push_back(alert);
            }
        }
    }

    /// Takes a message that was sent at `now_us`.
    pub fn said(&mut self, frame: &MAVLinkV2MessageRaw, now_us: i64) {
        if !ABOUT_TRAFFIC.contains(&frame.message_id()) {
            return;
        }
        let message = MavMessage::parse(MavlinkVersion::V2, frame.message_id(), frame.payload());
        let message = message.map_or("", |message| message.message_name());
        for alert in self.pending.iter_mut().filter(|a| a.event.sent.len() < MESSAGES) {
            let mut bytes = String::new();
            for byte in frame.raw_bytes() {
                // Writing to a string cannot fail.
                let _ = write!(bytes, "{byte:02x}");
            }
            let after_ms = (now_us - alert.frame_us) as f64 / 1000.0;
            alert.event.sent.push(Sent { after_ms, message, bytes });
        }
    }

    /// Writes what has waited long enough.
    pub fn tick(&mut self, now_us: i64) {
        while self.pending.front().is_some_and(|alert| now_us - alert.frame_us >= COLLECTED_US) {
            self.write_first();
        }
    }

    fn write_first(&mut self) {
        if let Some(alert) = self.pending.pop_front() {
            self.writer.hand(alert);
        }
    }

    fn alert(
        &self,
        seen: &ProcessedFrame,
        tracks: &[Traffic],
        track: &Traffic,
        onboard: &Lookout,
        number: u64,
    ) -> AlertEvent {
        let frame_us = seen.frame.time_us;
        let degrees = |angle: crate::math::real::Real| angle.to_num::<f64>().to_degrees();
        let attitude = onboard.attitude(frame_us);
        let line = detections::json_line(number, frame_us, &seen.found, Some(tracks));
        let Rect { x, y, width, height } = track.rect;
        // Where the object was in the frames before, as its detection followed it.
        let overlap = |d: &&crate::detector::Detection| d.rect.intersection(&track.rect);
        let own = seen.found.list.iter().filter(|d| overlap(d) > 0).max_by_key(overlap);
        let shift = |ago: usize| match (ago.checked_sub(1), own) {
            (Some(i), Some(own)) => {
                own.shifts.get(i).map_or([0.0; 2], |s| [s.x, s.y].map(|v| v.to_num()))
            }
            _ => [0.0; 2],
        };
        let newest = self.frames.len() - 1;
        let frames = self.frames.iter().enumerate();
        let frames = frames.map(|(place, frame)| (frame.clone(), shift(newest - place))).collect();
        AlertEvent {
            event: EventLine {
                time_us: frame_us + clock::unix_offset_us(),
                level: traffic::name(track.level),
                track: track.id,
                words: traffic::in_words(track, onboard.is_pointed()),
                azimuth_deg: onboard.is_pointed().then(|| degrees(track.body.azimuth())),
                elevation_deg: onboard.is_pointed().then(|| degrees(track.body.elevation())),
                attitude: attitude.map(|a| [a.w, a.x, a.y, a.z].map(|v| v.to_num())),
                frame: serde_json::from_str(&line).unwrap_or_default(),
                picture: String::new(),
                sent: Vec::new(),
            },
            frame_us,
            frames,
            rect: [x, y, width, height].map(|v| v.to_num()),
        }
    }
}

impl Drop for EventLog {
    /// Writes what still waits.
    fn drop(&mut self) {
        while !self.pending.is_empty() {
            self.write_first();
        }
    }
}

/// Writes an alert; on a full disk older ones are removed for it.
fn write(ring: &mut FolderRing, limit: u64, number: u64, alert: &AlertEvent) -> io::Result<()> {
    loop {
        match try_write(ring, limit, number, alert) {
            Err(error) if ring::is_full(&error) && ring.give_way(1) => {}
            written => return written,
        }
    }
}

/// The picture first, so that no line names one that is not there.
fn try_write(ring: &mut FolderRing, limit: u64, number: u64, alert: &AlertEvent) -> io::Result<()> {
    if ring.current_bytes() >= limit / FOLDERS {
        ring.start()?;
    }
    let Some(folder) = ring.current().map(Path::to_path_buf) else { return Ok(()) };
    let picture = format!("{number:06}-track{}-{}.png", alert.event.track, alert.event.level);
    let slices: Vec<_> = alert.frames.iter().map(|(frame, moved)| (&**frame, *moved)).collect();
    let (png, _) = strip::picture(&slices, &alert.rect);
    let mut line =
        serde_json::to_vec(&EventLine { picture: picture.clone(), ..alert.event.clone() })?;
    line.push(b'\n');
    let picture = folder.join(picture);
    let append = || {
        fs::write(&picture, &png)?;
        let log = folder.join("events.jsonl");
        let mut file = OpenOptions::new().create(true).append(true).open(log)?;
        let before = file.metadata()?.len();
        // Half a line would spoil the next one.
        file.write_all(&line).inspect_err(|_| drop(file.set_len(before)))
    };
    // Without its line a picture says nothing.
    append().inspect_err(|_| drop(fs::remove_file(&picture)))?;
    ring.wrote((png.len() + line.len()) as u64, usize::MAX, limit);
    Ok(())
}
