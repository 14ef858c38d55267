//! COCO: JSON with `images`, `annotations` and `categories`; CocoVID adds `videos`, `video_id`, `frame_id` and an object
//! number (`instance_id` or `track_id`).
//!
//! Boxes are left, top, width, height from 0. `iscrowd` or `ignore` boxes are not to be evaluated.

use super::{ImportError, LabelledBox, Sequence, SequenceFrames, pictures};
use serde::Deserialize;
use std::borrow::ToOwned;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;

#[derive(Debug, Deserialize)]
struct CocoFile {
    images: Vec<CocoImage>,
    annotations: Vec<CocoAnnotation>,
    categories: Vec<Named>,
    #[serde(default)]
    videos: Vec<Named>,
}

#[derive(Debug, Deserialize)]
struct CocoImage {
    id: i64,
    file_name: String,
    width: Option<f64>,
    height: Option<f64>,
    video_id: Option<i64>,
    #[serde(alias = "frame_index")]
    frame_id: Option<i64>,
}

#[derive(Debug, Deserialize)]
struct CocoAnnotation {
    image_id: i64,
    category_id: i64,
    bbox: [f64; 4],
    #[serde(default)]
    iscrowd: f64,
    #[serde(default)]
    ignore: f64,
    #[serde(alias = "track_id")]
    instance_id: Option<i64>,
}

#[derive(Debug, Deserialize)]
struct Named {
    id: i64,
    name: String,
}

/// Reads a JSON, or every JSON below a folder that is of this form.
///
/// # Errors
/// [`ImportError`] naming the file and the place.
pub fn read(source: &Path) -> Result<Vec<Sequence>, ImportError> {
    // annotations/train.json lies beside images/.
    super::of_json(source, "annotations", |_| source.to_owned(), of_file)
}

fn of_file(path: &Path, root: &Path) -> Result<Vec<Sequence>, ImportError> {
    let bytes = fs::read(path).map_err(ImportError::read(path))?;
    let bytes = bytes.strip_prefix("\u{feff}".as_bytes()).unwrap_or(&bytes);
    let document: CocoFile = serde_json::from_slice(bytes)
        .map_err(|source| ImportError::Json { path: path.into(), source })?;
    let categories: BTreeMap<i64, &str> =
        document.categories.iter().map(|c| (c.id, c.name.as_str())).collect();
    let mut labels: BTreeMap<i64, Vec<LabelledBox>> = BTreeMap::new();
    let wrong = |what, value: String, expected| ImportError::Value {
        path: path.into(),
        line: None,
        what,
        value,
        expected,
    };
    for annotation in &document.annotations {
        let number = annotation.category_id;
        let class = categories.get(&number).ok_or_else(|| {
            wrong("category_id", number.to_string(), "a number that categories holds")
        })?;
        let [_, _, width, height] = annotation.bbox;
        if width <= 0.0 || height <= 0.0 {
            let text = std::format!("{:?} of image {}", annotation.bbox, annotation.image_id);
            return Err(wrong("bbox", text, "width and height above 0"));
        }
        let counts = annotation.iscrowd == 0.0 && annotation.ignore == 0.0;
        labels.entry(annotation.image_id).or_default().push(LabelledBox {
            frame: 0,
            id: annotation.instance_id,
            rect: annotation.bbox,
            class: (*class).into(),
            visibility: if counts { 1.0 } else { 0.0 },
        });
    }
    let there = Places::new(root)?;
    let videos: BTreeMap<i64, &str> =
        document.videos.iter().map(|v| (v.id, v.name.as_str())).collect();
    let mut by_video: BTreeMap<i64, Vec<&CocoImage>> = BTreeMap::new();
    let mut singles: BTreeMap<PathBuf, &CocoImage> = BTreeMap::new();
    for image in &document.images {
        match image.video_id {
            Some(video) => by_video.entry(video).or_default().push(image),
            None => drop(singles.insert(root.join(&image.file_name), image)),
        }
    }
    let mut sequences = Vec::new();
    for (video, mut images) in by_video {
        images.sort_by(|a, b| (a.frame_id, &a.file_name).cmp(&(b.frame_id, &b.file_name)));
        let name = videos.get(&video).map_or(std::format!("video{video}"), ToString::to_string);
        sequences.push(sequence(name, &images, &labels, &there));
    }
    for (name, files) in pictures::sequences(singles.keys().cloned().collect()) {
        let images: Vec<&CocoImage> =
            files.iter().filter_map(|file| singles.get(file).copied()).collect();
        sequences.push(sequence(name, &images, &labels, &there));
    }
    Ok(sequences)
}

fn sequence(
    name: String,
    images: &[&CocoImage],
    labels: &BTreeMap<i64, Vec<LabelledBox>>,
    there: &Places,
) -> Sequence {
    let files: Option<Vec<PathBuf>> = images.iter().map(|i| there.find(&i.file_name)).collect();
    let size = images.first().and_then(|image| image.width.zip(image.height));
    let mut all = Vec::new();
    for (image, frame) in images.iter().zip(1..) {
        let own = labels.get(&image.id).into_iter().flatten();
        all.extend(own.map(|label| LabelledBox { frame, ..label.clone() }));
    }
    Sequence {
        name,
        frames: files.map_or(SequenceFrames::Missing, SequenceFrames::Pictures),
        length: Some(images.len() as u64),
        size: size.map(|(width, height)| (width as u32, height as u32)),
        labels: all,
        ..Sequence::default()
    }
}

/// The pictures of the data set by name.
struct Places {
    root: PathBuf,
    by_name: BTreeMap<String, PathBuf>,
}

impl Places {
    fn new(root: &Path) -> Result<Self, ImportError> {
        let name = |path: &PathBuf| path.file_name().unwrap_or_default().to_string_lossy().into();
        let by_name = pictures::below(root)?.into_iter().map(|path| (name(&path), path)).collect();
        Ok(Self { root: root.into(), by_name })
    }

    /// The file where the JSON says, else anywhere below by its bare name.
    fn find(&self, name: &str) -> Option<PathBuf> {
        let path = self.root.join(name);
        let bare = Path::new(name).file_name()?.to_string_lossy();
        path.is_file().then_some(path).or_else(|| self.by_name.get(bare.as_ref()).cloned())
    }
}
