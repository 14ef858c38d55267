//! Pascal VOC: an XML for each picture, with `filename`, `size` and an `object` a box.
//!
//! Corners are taken as pixel edges from 0, as LabelImg, Roboflow and torchvision have them (the first VOC counted
//! pixels from 1, which is half a pixel off). `difficult` is not to be evaluated, `truncated` and `occluded` are partly
//! seen.

use super::xml::{self, Xml};
use super::{ImportError, LabelledBox, Sequence, SequenceFrames, pictures};
use std::borrow::ToOwned;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::string::String;
use std::vec::Vec;

/// Reads every XML below `source`.
///
/// # Errors
/// [`ImportError`] naming file, line and field.
pub fn read(source: &Path) -> Result<Vec<Sequence>, ImportError> {
    let mut labels: BTreeMap<String, (PathBuf, Vec<LabelledBox>)> = BTreeMap::new();
    let mut size = BTreeMap::new();
    for path in pictures::files(source, &["xml"])? {
        let text = xml::text(&path)?;
        let xml = Xml::parse(&path, &text)?;
        let root = xml.document.root_element();
        if !root.has_tag_name("annotation") {
            continue;
        }
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        if let Some(node) = xml::child(root, "size") {
            let pixels = (xml.child(node, "width")? as u32, xml.child(node, "height")? as u32);
            size.insert(stem.clone(), pixels);
        }
        let objects = xml::children(root, "object").map(|node| object(&xml, node));
        let objects = objects.collect::<Result<Vec<LabelledBox>, ImportError>>()?;
        labels.insert(stem, (path.clone(), objects));
    }
    if labels.is_empty() {
        return Err(ImportError::Nothing { path: source.into() });
    }
    // Pictures whose file is not there still take their place among the frames.
    let mut found: BTreeMap<String, PathBuf> = BTreeMap::new();
    for picture in pictures::below(source)? {
        let stem = picture.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        found.insert(stem, picture);
    }
    let there = labels.keys().filter_map(|stem| found.get(stem).cloned()).collect::<Vec<_>>();
    let missing = there.len() < labels.len();
    let of_labels = labels.values().map(|(path, _)| path.clone());
    let frames: Vec<PathBuf> = if missing { of_labels.collect() } else { there };
    let sequence = |(name, files): (String, Vec<PathBuf>)| {
        let stems = files.iter().map(|f| f.file_stem().unwrap_or_default().to_string_lossy());
        let mut sequence = Sequence { name, ..Sequence::default() };
        for (stem, frame) in stems.zip(1..) {
            sequence.size = sequence.size.or_else(|| size.get(stem.as_ref()).copied());
            let labels = labels.get(stem.as_ref()).into_iter().flat_map(|(_, labels)| labels);
            sequence.labels.extend(labels.map(|label| LabelledBox { frame, ..label.clone() }));
        }
        sequence.length = Some(files.len() as u64);
        sequence.frames =
            if missing { SequenceFrames::Missing } else { SequenceFrames::Pictures(files) };
        sequence
    };
    Ok(pictures::sequences(frames).into_iter().map(sequence).collect())
}

fn object(xml: &Xml<'_>, node: roxmltree::Node<'_, '_>) -> Result<LabelledBox, ImportError> {
    let text = |name: &str| xml::child(node, name).and_then(|child| child.text()).map(str::trim);
    let class = text("name").ok_or_else(|| xml.wrong(node, "name", None, "the class"))?.to_owned();
    let bounds = xml::child(node, "bndbox");
    let bounds = bounds.ok_or_else(|| xml.wrong(node, "bndbox", None, "the box"))?;
    let left = xml.child(bounds, "xmin")?;
    let top = xml.child(bounds, "ymin")?;
    let (width, height) = (xml.child(bounds, "xmax")? - left, xml.child(bounds, "ymax")? - top);
    if width <= 0.0 || height <= 0.0 {
        return Err(xml.wrong(bounds, "bndbox", None, "xmax above xmin and ymax above ymin"));
    }
    let set = |name: &str| text(name).is_some_and(|text| text == "1");
    let visibility = match (set("difficult"), set("truncated") || set("occluded")) {
        (true, _) => 0.0,
        (false, true) => 0.5,
        (false, false) => 1.0,
    };
    Ok(LabelledBox { frame: 0, id: None, rect: [left, top, width, height], class, visibility })
}
