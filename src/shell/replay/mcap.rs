//! `lookout replay --mcap FILE`: pictures, boxes, tracks, bearings and alerts for Foxglove.
//!
//! Topics: `/lookout/image` (foxglove.CompressedImage, PNG), `/lookout/boxes` (foxglove.ImageAnnotations: detections with
//! scores, confirmed tracks with number and level), `/lookout/alerts` (foxglove.Log), `/lookout/bearings` and
//! `/lookout/frame` (schemas of our own: directions of confirmed tracks in degrees; the line of `--jsonl`). All are JSON with
//! JSON schemas. Times are those of frames: from the first one on, or since 1970 where the source has such.

use crate::detector::Detections;
use crate::shell::error::Error;
use crate::shell::formats::{detections, traffic};
use crate::shell::sources::Frame;
use crate::shell::support::file_error::FileError;
use crate::tracking::traffic::{AlertLevel, Traffic};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use image::ExtendedColorType;
use image::ImageEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use mcap::records::MessageHeader;
use mcap::{McapError, Writer};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::format;
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;

/// The topics and the names of their schemas.
const TOPICS: [(&str, &str); 5] = [
    ("/lookout/image", "foxglove.CompressedImage"),
    ("/lookout/boxes", "foxglove.ImageAnnotations"),
    ("/lookout/alerts", "foxglove.Log"),
    ("/lookout/bearings", "lookout.Bearings"),
    ("/lookout/frame", "lookout.Frame"),
];
const IMAGE: usize = 0;
const BOXES: usize = 1;
const ALERTS: usize = 2;
const BEARINGS: usize = 3;
const FRAME: usize = 4;

/// The name of the camera's frame of reference.
const FRAME_ID: &str = "camera";

/// A file under way.
pub struct McapWriter {
    path: PathBuf,
    writer: Writer<BufWriter<File>>,
    channels: [u16; TOPICS.len()],
    sequence: u32,
    levels: BTreeMap<u16, AlertLevel>,
}

impl McapWriter {
    /// Creates a file.
    ///
    /// # Errors
    /// [`FileError::Write`].
    pub fn create(path: &Path) -> Result<Self, Error> {
        let file = File::create(path).map_err(Error::write(path))?;
        let failed = |error: McapError| failed(path, error);
        let mut writer = Writer::new(BufWriter::new(file)).map_err(failed)?;
        let mut channels = [0; TOPICS.len()];
        for (channel, (topic, name)) in channels.iter_mut().zip(TOPICS) {
            let schema = schema(name).to_string();
            let id = writer.add_schema(name, "jsonschema", schema.as_bytes()).map_err(failed)?;
            *channel = writer.add_channel(id, topic, "json", &BTreeMap::new()).map_err(failed)?;
        }
        Ok(Self { path: path.into(), writer, channels, sequence: 0, levels: BTreeMap::new() })
    }

    /// Writes a frame and all that is known of it; `pointed`: whether directions from the vehicle are known. Without it tracks
    /// have no bearings.
    ///
    /// # Errors
    /// [`FileError::Write`].
    pub fn take(
        &mut self,
        number: u64,
        frame: &Frame,
        found: &Detections,
        (tracks, pointed): (&[Traffic], bool),
    ) -> Result<(), Error> {
        let time_us = frame.time_us.max(0);
        let stamp = json!({"sec": time_us / 1_000_000, "nsec": time_us % 1_000_000 * 1000});
        let png = png(frame)
            .map_err(|error| failed(&self.path, McapError::Io(io::Error::other(error))))?;
        let image = json!({
            "timestamp": stamp, "frame_id": FRAME_ID, "format": "png", "data": STANDARD.encode(png),
        });
        self.write(IMAGE, time_us, &image)?;
        self.write(BOXES, time_us, &annotations(&stamp, found, tracks))?;
        let line = detections::json_line(number, frame.time_us, found, Some(tracks));
        self.write_text(FRAME, time_us, line.trim_end())?;
        let confirmed = tracks.iter().filter(|track| pointed && track.confirmed);
        let bearings: Vec<Value> = confirmed
            .map(|track| {
                let degrees = |v: crate::math::real::Real| v.to_num::<f64>().to_degrees();
                let (azimuth, elevation) = (track.body.azimuth(), track.body.elevation());
                json!({
                    "id": track.id, "level": traffic::name(track.level),
                    "azimuth_deg": degrees(azimuth), "elevation_deg": degrees(elevation),
                })
            })
            .collect();
        self.write(BEARINGS, time_us, &json!({"timestamp": stamp, "tracks": bearings}))?;
        self.levels.retain(|id, _| tracks.iter().any(|track| track.id == *id));
        for track in tracks.iter().filter(|track| track.confirmed) {
            let level = self.levels.entry(track.id).or_default();
            if track.level > std::mem::replace(level, track.level) {
                // Foxglove's numbers: information, warning, error.
                let level = match track.level {
                    AlertLevel::Warning => 4,
                    AlertLevel::Caution => 3,
                    _ => 2,
                };
                let message = traffic::in_words(track, pointed);
                let log = json!({
                    "timestamp": stamp, "level": level, "message": message, "name": "lookout", "file": "", "line": 0,
                });
                self.write(ALERTS, time_us, &log)?;
            }
        }
        Ok(())
    }

    /// Completes the file.
    ///
    /// # Errors
    /// [`FileError::Write`].
    pub fn finish(mut self) -> Result<(), Error> {
        self.writer.finish().map(drop).map_err(|error| failed(&self.path, error))
    }

    fn write(&mut self, topic: usize, time_us: i64, message: &Value) -> Result<(), Error> {
        self.write_text(topic, time_us, &message.to_string())
    }

    fn write_text(&mut self, topic: usize, time_us: i64, text: &str) -> Result<(), Error> {
        let time = time_us.unsigned_abs().saturating_mul(1000);
        self.sequence = self.sequence.wrapping_add(1);
        let header = MessageHeader {
            channel_id: self.channels.get(topic).copied().unwrap_or_default(),
            sequence: self.sequence,
            log_time: time,
            publish_time: time,
        };
        let written = self.writer.write_to_known_channel(&header, text.as_bytes());
        written.map_err(|error| failed(&self.path, error))
    }
}

fn failed(path: &Path, error: McapError) -> Error {
    let source = match error {
        McapError::Io(error) => error,
        other => io::Error::other(other.to_string()),
    };
    FileError::Write { path: path.into(), source }.into()
}

/// A frame as PNG, quickly rather than small.
fn png(frame: &Frame) -> Result<Vec<u8>, image::ImageError> {
    let mut bytes = Vec::new();
    let encoder =
        PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive);
    // No frame has so many pixels.
    let [width, height] = [frame.width, frame.height].map(|s| u32::try_from(s).unwrap_or(u32::MAX));
    encoder.write_image(&frame.pixels, width, height, ExtendedColorType::L8)?;
    Ok(bytes)
}

fn annotations(stamp: &Value, found: &Detections, tracks: &[Traffic]) -> Value {
    let colour = |[r, g, b]: [f64; 3]| json!({"r": r, "g": g, "b": b, "a": 1.0});
    let none = json!({"r": 0.0, "g": 0.0, "b": 0.0, "a": 0.0});
    let (mut points, mut texts) = (Vec::new(), Vec::new());
    let mut add = |[left, top, width, height]: [f64; 4], text: String, of: [f64; 3]| {
        let corners = [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)];
        let corners = corners.map(|(x, y)| json!({"x": left + x, "y": top + y}));
        points.push(json!({
            // A closed line.
            "timestamp": stamp, "type": 2, "points": corners, "outline_color": colour(of), "outline_colors": [],
            "fill_color": none, "thickness": 1.0,
        }));
        texts.push(json!({
            "timestamp": stamp, "position": {"x": left, "y": top}, "text": text, "font_size": 12.0,
            "text_color": colour(of), "background_color": none,
        }));
    };
    for detection in &found.list {
        let rect = detections::rect(detection).map(detections::Decimal::to_f64);
        let score = detections::Decimal::score(detection.score).to_f64();
        add(rect, format!("{score:.1}"), [1.0, 0.85, 0.0]);
    }
    for track in tracks.iter().filter(|track| track.confirmed) {
        let rect = track.rect;
        let rect = [rect.x, rect.y, rect.width, rect.height].map(|v| v.to_num::<f64>());
        let text = format!("{} {}", track.id, traffic::name(track.level));
        add(
            rect,
            text,
            if track.level == AlertLevel::Warning { [1.0, 0.1, 0.1] } else { [0.1, 0.8, 1.0] },
        );
    }
    json!({"circles": [], "points": points, "texts": texts})
}

/// A schema: the fields that are written, with their types.
fn schema(name: &str) -> Value {
    let object = |fields: Value| json!({"type": "object", "properties": fields});
    let list = |of: Value| json!({"type": "array", "items": of});
    let (number, whole, text) =
        (json!({"type": "number"}), json!({"type": "integer"}), json!({"type": "string"}));
    let time = object(json!({"sec": whole, "nsec": whole}));
    let point = object(json!({"x": number, "y": number}));
    let colour = object(json!({"r": number, "g": number, "b": number, "a": number}));
    let mut schema = match name {
        "foxglove.CompressedImage" => object(json!({
            "timestamp": time, "frame_id": text, "format": text,
            "data": {"type": "string", "contentEncoding": "base64"},
        })),
        "foxglove.ImageAnnotations" => object(json!({
            "circles": list(object(json!({
                "timestamp": time, "position": point, "diameter": number, "thickness": number,
                "fill_color": colour, "outline_color": colour,
            }))),
            "points": list(object(json!({
                "timestamp": time, "type": whole, "points": list(point.clone()), "outline_color": colour,
                "outline_colors": list(colour.clone()), "fill_color": colour, "thickness": number,
            }))),
            "texts": list(object(json!({
                "timestamp": time, "position": point, "text": text, "font_size": number, "text_color": colour,
                "background_color": colour,
            }))),
        })),
        "foxglove.Log" => object(json!({
            "timestamp": time, "level": whole, "message": text, "name": text, "file": text, "line": whole,
        })),
        "lookout.Bearings" => object(json!({
            "timestamp": time,
            "tracks": list(object(json!({
                "id": whole, "level": text, "azimuth_deg": number, "elevation_deg": number,
            }))),
        })),
        _ => object(json!({
            "frame": whole, "time_us": whole, "detections": list(json!({"type": "object"})),
            "tracks": list(json!({"type": "object"})),
        })),
    };
    if let Some(fields) = schema.as_object_mut() {
        fields.insert(String::from("title"), name.into());
    }
    schema
}
