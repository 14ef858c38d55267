//! CVAT: XML of "CVAT for video 1.1" (tracks of boxes) or "CVAT for images 1.1" (boxes by picture).
//!
//! Frames count from 0 there. `outside` boxes are left out, `occluded` ones are partly seen.

use super::xml::{self, Xml};
use super::{ImportError, LabelledBox, Sequence, SequenceFrames, pictures};
use crate::shell::sources;
use roxmltree::Node;
use std::borrow::ToOwned;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::string::String;
use std::vec::Vec;

/// Reads an XML, or every XML below a folder.
///
/// # Errors
/// [`ImportError`] naming file, line and field.
pub fn read(source: &Path) -> Result<Vec<Sequence>, ImportError> {
    let files = match source.is_dir() {
        true => pictures::files(source, &["xml"])?,
        false => [source.to_path_buf()].into(),
    };
    let mut sequences = Vec::new();
    for path in files {
        let text = xml::text(&path)?;
        let xml = Xml::parse(&path, &text)?;
        let root = xml.document.root_element();
        if !root.has_tag_name("annotations") {
            continue;
        }
        let folder = path.parent().unwrap_or(Path::new(""));
        if xml::children(root, "image").next().is_some() {
            sequences.extend(of_images(&xml, root, folder)?);
        } else {
            sequences.push(of_video(&xml, root, folder, &path)?);
        }
    }
    Ok(sequences)
}

fn of_video(
    xml: &Xml<'_>,
    root: Node<'_, '_>,
    folder: &Path,
    path: &Path,
) -> Result<Sequence, ImportError> {
    let meta = |name: &str| {
        root.descendants().find(|node| node.has_tag_name(name)).and_then(|node| node.text())
    };
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let source = meta("source").map(str::trim).filter(|source| !source.is_empty());
    let name = meta("name").map_or(stem.clone(), |name| name.trim().to_owned());
    let size = root.descendants().find(|node| node.has_tag_name("original_size"));
    let size = size.map(|node| {
        Ok::<_, ImportError>((xml.child(node, "width")? as u32, xml.child(node, "height")? as u32))
    });
    let mut sequence = Sequence {
        name: if name.is_empty() { stem.clone() } else { name },
        frames: frames(folder, source, &stem)?,
        length: meta("size").and_then(|text| text.trim().parse().ok()),
        size: size.transpose()?,
        ..Sequence::default()
    };
    for track in xml::children(root, "track") {
        let label = track.attribute("label");
        let class = label.ok_or_else(|| xml.wrong(track, "label", None, "the class"))?;
        let id = xml.attribute(track, "id")?;
        // Ground truth holds numbers that an f64 holds exactly.
        if !(0.0..=9e15).contains(&id) {
            let expected = "a number from 0 to 9e15";
            return Err(xml.wrong(track, "id", track.attribute("id"), expected));
        }
        for node in xml::children(track, "box") {
            if node.attribute("outside") == Some("1") {
                continue;
            }
            let frame = xml.attribute(node, "frame")?;
            if !(0.0..=4e6).contains(&frame) {
                return Err(xml.wrong(node, "frame", node.attribute("frame"), "a number from 0"));
            }
            let label = boxed(xml, node, class)?;
            // Numbers from 1: 0 is a number of no object in MOTChallenge text.
            sequence.labels.push(LabelledBox {
                frame: frame as u64 + 1,
                id: Some(id as i64 + 1),
                ..label
            });
        }
    }
    sequence.labels.sort_by_key(|label| label.frame);
    Ok(sequence)
}

/// The video that the XML names or that has its name, else the one video or the pictures beside it.
fn frames(folder: &Path, source: Option<&str>, stem: &str) -> Result<SequenceFrames, ImportError> {
    let named = source.map(|source| folder.join(Path::new(source).file_name().unwrap_or_default()));
    if let Some(video) = named.filter(|path| sources::is_video(path)) {
        return Ok(SequenceFrames::Video(video));
    }
    let videos = pictures::files(folder, &["mp4", "avi", "mkv", "mov", "webm"])?;
    let own = |video: &&PathBuf| video.file_stem().is_some_and(|s| s.to_string_lossy() == stem);
    if let Some(video) = videos.iter().find(own).or(videos.first().filter(|_| videos.len() == 1)) {
        return Ok(SequenceFrames::Video(video.clone()));
    }
    let pictures = pictures::below(folder)?;
    Ok(if pictures.is_empty() {
        SequenceFrames::Missing
    } else {
        SequenceFrames::Pictures(pictures)
    })
}

fn of_images(
    xml: &Xml<'_>,
    root: Node<'_, '_>,
    folder: &Path,
) -> Result<Vec<Sequence>, ImportError> {
    let there = pictures::below(folder)?;
    let mut images: BTreeMap<PathBuf, (bool, Vec<LabelledBox>)> = BTreeMap::new();
    let mut size = None;
    for image in xml::children(root, "image") {
        let name = image.attribute("name");
        let name = name.ok_or_else(|| xml.wrong(image, "name", None, "the picture's name"))?;
        size = size.or(Some((
            xml.attribute(image, "width")? as u32,
            xml.attribute(image, "height")? as u32,
        )));
        let boxes = xml::children(image, "box").map(|node| {
            let class = node.attribute("label");
            boxed(xml, node, class.ok_or_else(|| xml.wrong(node, "label", None, "the class"))?)
        });
        let boxes = boxes.collect::<Result<Vec<LabelledBox>, ImportError>>()?;
        let file = there.iter().find(|path| path.ends_with(name));
        let path = file.cloned().unwrap_or_else(|| folder.join(name));
        images.insert(path, (file.is_some(), boxes));
    }
    let paths = images.keys().cloned().collect();
    let sequence = |(name, files): (String, Vec<PathBuf>)| {
        let mut labels = Vec::new();
        for (path, frame) in files.iter().zip(1..) {
            let own = images.get(path).into_iter().flat_map(|(_, labels)| labels);
            labels.extend(own.map(|label| LabelledBox { frame, ..label.clone() }));
        }
        let length = Some(files.len() as u64);
        let all = files.iter().all(|path| images.get(path).is_some_and(|(there, _)| *there));
        let frames = if all { SequenceFrames::Pictures(files) } else { SequenceFrames::Missing };
        Sequence { name, frames, length, size, labels, ..Sequence::default() }
    };
    Ok(pictures::sequences(paths).into_iter().map(sequence).collect())
}

/// A box by its corners.
fn boxed(xml: &Xml<'_>, node: Node<'_, '_>, class: &str) -> Result<LabelledBox, ImportError> {
    let (left, top) = (xml.attribute(node, "xtl")?, xml.attribute(node, "ytl")?);
    let (width, height) = (xml.attribute(node, "xbr")? - left, xml.attribute(node, "ybr")? - top);
    if width <= 0.0 || height <= 0.0 {
        return Err(xml.wrong(node, "box", None, "xbr above xtl and ybr above ytl"));
    }
    let occluded = node.attribute("occluded") == Some("1");
    let visibility = if occluded { 0.5 } else { 1.0 };
    let rect = [left, top, width, height];
    Ok(LabelledBox { frame: 0, id: None, rect, class: class.to_owned(), visibility })
}
