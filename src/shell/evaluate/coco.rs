//! Ground truth and detections as COCO JSON, for pycocotools and the programs that read what it reads.
//!
//! One category, since the detector does not name classes; that of the labels stands beside as `class`. Boxes that the
//! scorer ignores are crowd regions: pycocotools then counts a detection neither way that lies on it with the share of its
//! own area that the threshold asks for (half at IoU 0.5, as the scorer). The first frames, which the scorer leaves out, are
//! left out.

use super::matching::{DetectionRecord, WARMUP, must_be_found};
use crate::shell::error::Error;
use crate::shell::formats::clips::Clip;
use serde::Serialize;
use std::path::Path;
use std::string::String;
use std::vec::Vec;
use std::{format, fs};

/// The one category.
const CATEGORY: u32 = 1;

#[derive(Debug, Serialize)]
struct GroundTruthFile<'a> {
    info: Info,
    images: Vec<ImageRow>,
    annotations: Vec<AnnotationRow>,
    categories: [Category<'a>; 1],
}

#[derive(Debug, Serialize)]
struct Info {
    description: &'static str,
}

#[derive(Debug, Serialize)]
struct ImageRow {
    id: u64,
    file_name: String,
    width: u32,
    height: u32,
}

#[derive(Debug, Serialize)]
struct AnnotationRow {
    id: u64,
    image_id: u64,
    category_id: u32,
    bbox: [f64; 4],
    area: f64,
    iscrowd: u8,
    class: &'static str,
    track_id: i64,
}

#[derive(Debug, Serialize)]
struct Category<'a> {
    id: u32,
    name: &'a str,
}

#[derive(Debug, Serialize)]
struct DetectionRow {
    image_id: u64,
    category_id: u32,
    bbox: [f64; 4],
    score: f64,
}

/// Writes `ground_truth.json` and `detections.json` into `folder`; `found` is by clip.
///
/// # Errors
/// [`Error::Write`](crate::shell::support::file_error::FileError::Write).
#[allow(clippy::expect_used, reason = "numbers and names make JSON")]
pub fn write(folder: &Path, clips: &[Clip], found: &[&[DetectionRecord]]) -> Result<(), Error> {
    let (truth, detections) = rows(clips, found);
    fs::create_dir_all(folder).map_err(Error::write(folder))?;
    let text = |value: serde_json::Result<String>| value.expect("numbers and names make JSON");
    for (name, json) in [
        ("ground_truth.json", text(serde_json::to_string(&truth))),
        ("detections.json", text(serde_json::to_string(&detections))),
    ] {
        let path = folder.join(name);
        fs::write(&path, json).map_err(Error::write(&path))?;
    }
    Ok(())
}

fn rows(
    clips: &[Clip],
    found: &[&[DetectionRecord]],
) -> (GroundTruthFile<'static>, Vec<DetectionRow>) {
    let (mut images, mut annotations, mut detections) = (Vec::new(), Vec::new(), Vec::new());
    for (clip, found) in clips.iter().zip(found) {
        let first = images.len() as u64;
        let (width, height) = clip.info.size.unwrap_or_default();
        let last_found = found.iter().map(|detection| detection.frame).max().unwrap_or(0);
        let last = clip.ground_truth.last_frame().max(last_found);
        let id = |frame: u64| first + frame - WARMUP;
        for frame in WARMUP + 1..=last {
            let file_name = format!("{}/{frame:06}", clip.name);
            images.push(ImageRow { id: id(frame), file_name, width, height });
        }
        for (frame, truth) in clip.ground_truth.boxes().filter(|(frame, _)| *frame > WARMUP) {
            annotations.push(AnnotationRow {
                id: annotations.len() as u64 + 1,
                image_id: id(frame),
                category_id: CATEGORY,
                bbox: [truth.left, truth.top, truth.width, truth.height],
                area: truth.width * truth.height,
                iscrowd: u8::from(!must_be_found(truth)),
                class: truth.class.name(),
                track_id: truth.id,
            });
        }
        detections.extend(found.iter().filter(|d| d.frame > WARMUP).map(|d| DetectionRow {
            image_id: id(d.frame),
            category_id: CATEGORY,
            bbox: d.rect,
            score: d.score,
        }));
    }
    let truth = GroundTruthFile {
        info: Info { description: concat!("lookout ", env!("CARGO_PKG_VERSION")) },
        images,
        annotations,
        categories: [Category { id: CATEGORY, name: "flying object" }],
    };
    (truth, detections)
}
