//! YOLO: for each picture a text with lines `class x y width height [object]`, the box's middle and size in shares of the
//! picture's (Darknet, Ultralytics).
//!
//! `images/.../NAME.jpg` has its labels in `labels/.../NAME.txt`, or in `NAME.txt` beside it; a picture without one shows
//! nothing. Names of classes: `names:` in a YAML, or `classes.txt`, `obj.names`; without these the numbers are the names.

use super::{ImportError, LabelledBox, Sequence, SequenceFrames, classes, pictures};
use serde::Deserialize;
use std::borrow::ToOwned;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::string::String;
use std::vec::Vec;
use std::{format, fs};

/// `names` of a data set's YAML: a list, or a table by number.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Names {
    List(Vec<String>),
    Table(BTreeMap<u32, String>),
}

#[derive(Debug, Deserialize)]
struct DataSet {
    names: Names,
}

/// Reads the pictures below `source` and their labels.
///
/// # Errors
/// [`ImportError`] naming file, line and field.
pub fn read(source: &Path) -> Result<Vec<Sequence>, ImportError> {
    let names = names(source)?;
    let mut any = false;
    let mut sequences = Vec::new();
    for (name, files) in pictures::sequences(pictures::below(source)?) {
        let mut sequence = Sequence { name, ..Sequence::default() };
        for (picture, frame) in files.iter().zip(1..) {
            let Some(path) = labels_of(picture) else { continue };
            any = true;
            let size = pictures::size(picture)?;
            sequence.size = sequence.size.or(Some(size));
            let text = fs::read_to_string(&path).map_err(ImportError::read(&path))?;
            for (line, number) in text.trim_start_matches('\u{feff}').lines().zip(1..) {
                if !line.trim().is_empty() {
                    let label = parse(line, size, &names, &path, number)?;
                    sequence.labels.push(LabelledBox { frame, ..label });
                }
            }
        }
        sequence.length = Some(files.len() as u64);
        sequence.frames = SequenceFrames::Pictures(files);
        sequences.push(sequence);
    }
    let same = same_names(&sequences);
    for sequence in sequences.iter_mut().filter(|s| same.contains(&s.name)) {
        // train/a and val/a are two clips.
        let SequenceFrames::Pictures(files) = &sequence.frames else { continue };
        let folder = files.first().and_then(|file| file.parent()).and_then(Path::file_name);
        let folder = folder.unwrap_or_default().to_string_lossy();
        sequence.name = format!("{folder}_{}", sequence.name);
    }
    if any { Ok(sequences) } else { Err(ImportError::Nothing { path: source.into() }) }
}

fn same_names(sequences: &[Sequence]) -> Vec<String> {
    let mut names: Vec<&String> = sequences.iter().map(|sequence| &sequence.name).collect();
    names.sort();
    let pairs = names.iter().zip(names.iter().skip(1));
    pairs.filter(|(a, b)| a == b).map(|(name, _)| (*name).clone()).collect()
}

/// The text of a picture's labels: the last `images` of its path is `labels` there, or it lies beside the picture.
fn labels_of(picture: &Path) -> Option<PathBuf> {
    let beside = picture.with_extension("txt");
    if beside.is_file() {
        return Some(beside);
    }
    let parts: Vec<_> = picture.iter().collect();
    let place = parts.iter().rposition(|part| *part == "images")?;
    let own = parts.iter().enumerate();
    let path: PathBuf =
        own.map(|(i, part)| if i == place { "labels".as_ref() } else { *part }).collect();
    let path = path.with_extension("txt");
    path.is_file().then_some(path)
}

/// The names of the classes by number.
fn names(source: &Path) -> Result<BTreeMap<u32, String>, ImportError> {
    for path in pictures::files(source, &["yaml", "yml"])? {
        let text = fs::read_to_string(&path).map_err(ImportError::read(&path))?;
        match serde_yaml_ng::from_str(&text) {
            Ok(DataSet { names: Names::List(names) }) => return Ok((0..).zip(names).collect()),
            Ok(DataSet { names: Names::Table(names) }) => return Ok(names),
            // Some other YAML.
            Err(_) => {}
        }
    }
    for path in pictures::files(source, &["txt", "names"])? {
        let name = path.file_name().unwrap_or_default();
        if name == "classes.txt" || name == "obj.names" {
            let text = fs::read_to_string(&path).map_err(ImportError::read(&path))?;
            return Ok((0..).zip(text.lines().map(|line| line.trim().to_owned())).collect());
        }
    }
    Ok(BTreeMap::new())
}

fn parse(
    line: &str,
    (width, height): (u32, u32),
    names: &BTreeMap<u32, String>,
    path: &Path,
    number: u32,
) -> Result<LabelledBox, ImportError> {
    let fields: Vec<&str> = line.split_whitespace().collect();
    let wrong = |what, value: &str, expected| ImportError::Value {
        path: path.into(),
        line: Some(number),
        what,
        value: value.to_owned(),
        expected,
    };
    let (class, texts, id) = match *fields.as_slice() {
        [class, x, y, w, h] => (class, [x, y, w, h], None),
        [class, x, y, w, h, id] => (class, [x, y, w, h], Some(id)),
        _ => {
            return Err(wrong(
                "the line",
                line,
                "class x y width height, in shares of the picture",
            ));
        }
    };
    let number = class.parse::<u32>();
    let class = number.map_err(|_| wrong("class", class, "a whole number from 0"))?;
    let mut shares = [0.0; 4];
    for (share, text) in shares.iter_mut().zip(texts) {
        let value = text.parse::<f64>().ok().filter(|value| (-0.5..=1.5).contains(value));
        *share = value.ok_or_else(|| wrong("x, y, width or height", text, "a share, 0 to 1"))?;
    }
    let [x, y, w, h] = shares;
    if w <= 0.0 || h <= 0.0 {
        return Err(wrong("width or height", line, "more than 0"));
    }
    let (across, down) = (f64::from(width), f64::from(height));
    Ok(LabelledBox {
        frame: 0,
        id: id.and_then(|text| text.parse::<i64>().ok()),
        rect: [(x - w / 2.0) * across, (y - h / 2.0) * down, w * across, h * down],
        class: names.get(&class).cloned().unwrap_or_else(|| classes::numbered(class)),
        visibility: 1.0,
    }
    .checked())
}

impl LabelledBox {
    /// The same, with edges that a share's rounding put a thousandth beside whole pixels on them.
    fn checked(mut self) -> Self {
        for value in &mut self.rect {
            let whole = value.round();
            if (*value - whole).abs() < 1e-3 {
                *value = whole;
            }
        }
        self
    }
}
