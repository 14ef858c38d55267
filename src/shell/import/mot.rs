//! MOTChallenge: folders with `gt/gt.txt`, `seqinfo.ini` and the pictures that it names; classes are numbers there.
//!
//! Classes 1 to 4 (and -1, not given) are ours unless the table maps the numbers, so that the program's own `gt.txt` can
//! be read, too. Rows with `conf` 0 are not to be evaluated.

use super::{ImportError, LabelledBox, Sequence, SequenceFrames, classes, pictures};
use crate::shell::formats::class::Class;
use crate::shell::formats::seqinfo::SeqInfo;
use crate::shell::sources;
use std::borrow::ToOwned;
use std::fs;
use std::path::{Path, PathBuf};
use std::string::String;
use std::vec::Vec;

/// Reads the sequences in `source`, or `source` itself.
///
/// # Errors
/// [`ImportError`] naming file, line and field.
pub fn read(source: &Path) -> Result<Vec<Sequence>, ImportError> {
    let texts = pictures::files(source, &["txt"])?;
    let texts = texts.iter().filter(|path| path.file_name().is_some_and(|name| name == "gt.txt"));
    texts.map(|path| sequence(path)).collect()
}

fn sequence(path: &Path) -> Result<Sequence, ImportError> {
    let mut folder = path.parent().unwrap_or(Path::new(""));
    if folder.ends_with("gt") {
        folder = folder.parent().unwrap_or(Path::new(""));
    }
    let info = SeqInfo::beside(folder)?;
    let named = folder.join(info.directory.as_deref().unwrap_or("img1"));
    let frames = match sources::clip_input(folder) {
        _ if named.is_dir() => SequenceFrames::Pictures(ordered(&named)?),
        Some(found) if found.is_dir() => SequenceFrames::Pictures(ordered(&found)?),
        Some(video) => SequenceFrames::Video(video),
        None => SequenceFrames::Missing,
    };
    let full = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let text = fs::read_to_string(path).map_err(ImportError::read(path))?;
    let mut labels = Vec::new();
    for (line, number) in text.trim_start_matches('\u{feff}').lines().zip(1..) {
        let line = line.trim();
        let header = number == 1 && line.starts_with(|c: char| c.is_alphabetic() || c == '"');
        if !line.is_empty() && !line.starts_with('#') && !header {
            labels.push(parse(line, path, number)?);
        }
    }
    Ok(Sequence {
        name: full.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        frames,
        rate: info.frame_rate,
        length: info.length,
        size: info.size,
        labels,
    })
}

/// The pictures of a folder in the order of their numbers.
fn ordered(folder: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let mut all = pictures::below(folder)?;
    let key = |path: &PathBuf| {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        (stem.parse::<u64>().unwrap_or(0), stem)
    };
    all.sort_by_key(key);
    Ok(all)
}

const FIELDS: [&str; 9] =
    ["frame", "id", "left", "top", "width", "height", "conf", "class", "visibility"];

fn parse(line: &str, path: &Path, number: u32) -> Result<LabelledBox, ImportError> {
    let fields: Vec<&str> = line.split(',').map(str::trim).collect();
    let wrong = |what, value: &str, expected| ImportError::Value {
        path: path.into(),
        line: Some(number),
        what,
        value: value.to_owned(),
        expected,
    };
    let value = |index: usize, default: Option<f64>| {
        let name = FIELDS.get(index).copied().unwrap_or_default();
        let text = fields.get(index).copied().unwrap_or_default();
        let parsed = text.parse::<f64>().ok().filter(|value| value.is_finite());
        let given = if text.is_empty() { default } else { parsed };
        given.ok_or_else(|| wrong(name, text, "a number"))
    };
    let frame = value(0, None)?;
    if !(1.0..=4e6).contains(&frame) {
        let text = fields.first().copied().unwrap_or_default();
        return Err(wrong("frame", text, "a number from 1"));
    }
    let rect = [value(2, None)?, value(3, None)?, value(4, None)?, value(5, None)?];
    let [_, _, width, height] = rect;
    if width <= 0.0 || height <= 0.0 {
        return Err(wrong("width or height", line, "more than 0"));
    }
    let (conf, visibility) = (value(6, Some(1.0))?, value(8, Some(1.0))?);
    let class = value(7, Some(-1.0))? as i64;
    let seen = if visibility < 0.0 { 1.0 } else { visibility.min(1.0) };
    Ok(LabelledBox {
        frame: frame as u64,
        id: Some(value(1, None)? as i64),
        rect,
        class: class_name(class),
        visibility: if conf == 0.0 { 0.0 } else { seen },
    })
}

/// The name under which a table may map a class: its number; our own are known by their names.
fn class_name(number: i64) -> String {
    let known = u32::try_from(number).ok().and_then(Class::from_number);
    match known {
        Some(class) => class.name().into(),
        None if number == -1 => Class::Drone.name().into(),
        None => classes::numbered(number),
    }
}
