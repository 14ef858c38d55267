//! Airborne Object Tracking (Amazon, 2021): `ImageSets/groundtruth.json` with the entities of each flight by picture, and
//! `Images/FLIGHT/NAME.png`, 10 frames a second of 2448 x 2048 pixels.
//!
//! An entity's `id` is its class and a number (`Airplane1`); pictures without a box are entities without `bb`. Frames
//! without a picture on this disk are left out of the sequence, with their labels, so that a part of a flight can be
//! imported.

use super::{ImportError, LabelledBox, Sequence, SequenceFrames};
use serde::Deserialize;
use std::borrow::ToOwned;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::string::String;
use std::vec::Vec;

#[derive(Debug, Deserialize)]
struct AotFile {
    samples: BTreeMap<String, AotFlight>,
}

#[derive(Debug, Deserialize)]
struct AotFlight {
    #[serde(default)]
    metadata: Metadata,
    #[serde(default)]
    entities: Vec<Entity>,
}

#[derive(Debug, Default, Deserialize)]
struct Metadata {
    fps: Option<f64>,
    resolution: Option<Resolution>,
}

#[derive(Debug, Deserialize)]
struct Resolution {
    width: f64,
    height: f64,
}

#[derive(Debug, Deserialize)]
struct Entity {
    id: Option<String>,
    bb: Option<[f64; 4]>,
    img_name: Option<String>,
    blob: Option<AotBlob>,
}

#[derive(Debug, Deserialize)]
struct AotBlob {
    frame: Option<i64>,
}

/// Reads a `groundtruth.json`, or every JSON below a folder that is of this form.
///
/// # Errors
/// [`ImportError`] naming the file and the place.
pub fn read(source: &Path) -> Result<Vec<Sequence>, ImportError> {
    let root = |path: &Path| path.parent().and_then(Path::parent).unwrap_or(source).to_owned();
    super::of_json(source, "ImageSets", root, of_file)
}

fn of_file(path: &Path, root: &Path) -> Result<Vec<Sequence>, ImportError> {
    let bytes = fs::read(path).map_err(ImportError::read(path))?;
    let document: AotFile = serde_json::from_slice(&bytes)
        .map_err(|source| ImportError::Json { path: path.into(), source })?;
    document.samples.into_iter().map(|(name, flight)| sequence(name, flight, root, path)).collect()
}

fn sequence(
    name: String,
    flight: AotFlight,
    root: &Path,
    path: &Path,
) -> Result<Sequence, ImportError> {
    // By the number of the frame, which the pictures' names (times) follow.
    let mut frames: BTreeMap<(i64, String), Vec<&Entity>> = BTreeMap::new();
    for entity in &flight.entities {
        let Some(picture) = &entity.img_name else { continue };
        let number = entity.blob.as_ref().and_then(|blob| blob.frame).unwrap_or(0);
        frames.entry((number, picture.to_owned())).or_default().push(entity);
    }
    let folder = root.join("Images").join(&name);
    let file = |picture: &str| {
        let path = folder.join(picture);
        path.is_file().then_some(path)
    };
    let any = frames.keys().any(|(_, picture)| file(picture).is_some());
    if any {
        frames.retain(|(_, picture), _| file(picture).is_some());
    }
    let mut numbers: BTreeMap<&str, i64> = BTreeMap::new();
    let mut labels = Vec::new();
    for (entities, frame) in frames.values().zip(1..) {
        for entity in entities {
            let (Some(id), Some(rect)) = (&entity.id, entity.bb) else { continue };
            let [_, _, width, height] = rect;
            if width <= 0.0 || height <= 0.0 {
                let (value, expected) =
                    (std::format!("{rect:?} of {id}"), "width and height above 0");
                return Err(ImportError::Value {
                    path: path.into(),
                    line: None,
                    what: "bb",
                    value,
                    expected,
                });
            }
            let next = numbers.len() as i64 + 1;
            let number = *numbers.entry(id).or_insert(next);
            let class = id.trim_end_matches(|c: char| c.is_ascii_digit()).to_owned();
            labels.push(LabelledBox { frame, id: Some(number), rect, class, visibility: 1.0 });
        }
    }
    let pictures: Option<Vec<PathBuf>> = frames.keys().map(|(_, picture)| file(picture)).collect();
    Ok(Sequence {
        name,
        length: Some(frames.len() as u64),
        rate: flight.metadata.fps,
        size: flight.metadata.resolution.map(|r| (r.width as u32, r.height as u32)),
        frames: pictures.filter(|_| any).map_or(SequenceFrames::Missing, SequenceFrames::Pictures),
        labels,
    })
}
