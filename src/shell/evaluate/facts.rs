//! Properties of clips that labels do not hold: frame rate, kind of encounter, agitation of the camera, movers on the ground.

use crate::shell::error::Error;
use crate::shell::formats::clips::Clip;
use crate::shell::formats::error::FormatError;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::borrow::ToOwned;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;
use std::{format, fs};

/// Frames a second where no `camera.json` says otherwise.
const DEFAULT_RATE: f64 = 30.0;

/// Properties of a clip.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Facts {
    /// Frame rate, frames a second.
    pub rate: f64,
    /// Whether a file says that rate; else it is measured, or 30.
    pub rate_given: bool,
    /// Kind of encounter, as `camera.json` or the table names it.
    pub kind: Option<String>,
    /// Agitation of the camera; larger is rougher.
    pub agitation: Option<f64>,
    /// Things that move along the ground and are not labelled; none where the table has no such column.
    pub movers: Option<f64>,
    /// Wingspans in metres of the targets, by number from 1.
    pub spans_m: Vec<f64>,
}

impl Facts {
    /// Takes a rate measured on the frames where no file gives one.
    pub fn measured(&mut self, rate: Option<f64>) {
        if let Some(rate) = rate.filter(|rate| !self.rate_given && *rate > 0.0) {
            // Times of frames are whole microseconds.
            let whole = rate.round();
            self.rate = if (rate / whole - 1.0).abs() < 1e-4 { whole } else { rate };
        }
    }
}

/// Facts of `clips` from their `camera.json` and from the table beside the folder `data`, where these exist.
///
/// # Errors
/// [`FileError::Read`](crate::shell::support::file_error::FileError::Read), or [`FormatError::Line`] naming file and line.
pub fn read(data: &Path, clips: &[Clip]) -> Result<Vec<Facts>, Error> {
    let table = table_path(data);
    let rows = match &table {
        Some(path) if path.is_file() => read_table(path)?,
        _ => BTreeMap::new(),
    };
    clips.iter().map(|clip| of(clip, rows.get(&clip.name).cloned().unwrap_or_default())).collect()
}

/// Facts of a clip from its `camera.json` and what a table or manifest says of it.
///
/// # Errors
/// As [`read`].
pub fn of(clip: &Clip, listed: Listed) -> Result<Facts, Error> {
    let camera = read_camera(&clip.directory.join("camera.json"))?;
    let rate = camera.rate.or(clip.info.frame_rate);
    Ok(Facts {
        rate: rate.unwrap_or(DEFAULT_RATE),
        rate_given: rate.is_some(),
        kind: listed.kind.or(camera.kind),
        agitation: listed.agitation,
        movers: listed.movers,
        spans_m: camera.spans_m,
    })
}

/// `SPLIT.csv` beside the folder; of a single clip that of the folder it stands in.
fn table_path(data: &Path) -> Option<PathBuf> {
    let data = data.canonicalize().ok()?;
    let split = if data.join("gt.txt").is_file() { data.parent()? } else { &data };
    let name = split.file_name()?.to_string_lossy();
    Some(split.parent()?.join(format!("{name}.csv")))
}

/// Columns of a table or manifest about a clip, as in [`Facts`].
#[allow(missing_docs, reason = "Facts has the same fields")]
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Listed {
    pub kind: Option<String>,
    pub agitation: Option<f64>,
    pub movers: Option<f64>,
}

/// A row for each clip, which stands in the first column; the other columns are known by their names.
fn read_table(path: &Path) -> Result<BTreeMap<String, Listed>, Error> {
    let text = fs::read_to_string(path).map_err(Error::read(path))?;
    let mut lines = text.lines().enumerate();
    let header: Vec<&str> =
        lines.next().map_or(Vec::new(), |l| l.1.split(',').map(str::trim).collect());
    let mut rows = BTreeMap::new();
    // Some other table of that name.
    if !header.first().is_some_and(|name| ["clip", "flight", "name"].contains(name)) {
        return Ok(rows);
    }
    for (index, line) in lines.filter(|(_, line)| !line.trim().is_empty()) {
        let bad = |reason| FormatError::Line { path: path.into(), line: index + 1, reason };
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        if fields.len() != header.len() {
            let (found, expected) = (fields.len(), header.len());
            return Err(bad(format!("{found} fields, the first line names {expected}")).into());
        }
        let mut row = Listed::default();
        for (name, field) in header.iter().zip(&fields).filter(|(_, field)| !field.is_empty()) {
            match *name {
                "kind" => row.kind = Some((*field).to_owned()),
                "agitation" | "movers" => {
                    let number = field.parse::<f64>().ok().filter(|v| v.is_finite());
                    let reason = || bad(format!("{name} is '{field}', expected a number"));
                    let number = Some(number.ok_or_else(reason)?);
                    if *name == "movers" { row.movers = number } else { row.agitation = number }
                }
                _ => {}
            }
        }
        rows.insert(fields[0].to_owned(), row);
    }
    Ok(rows)
}

#[derive(Debug, Default)]
struct CameraFacts {
    rate: Option<f64>,
    kind: Option<String>,
    spans_m: Vec<f64>,
}

fn read_camera(path: &Path) -> Result<CameraFacts, Error> {
    if !path.is_file() {
        return Ok(CameraFacts::default());
    }
    let bytes = fs::read(path).map_err(Error::read(path))?;
    let bad = |line, reason| FormatError::Line { path: path.into(), line, reason };
    let value: Value = serde_json::from_slice(&bytes).map_err(|e| bad(e.line(), e.to_string()))?;
    let rate = match &value["fps"] {
        Value::Null => None,
        fps => {
            let rate = fps.as_f64().filter(|rate| (1e-3..=1e6).contains(rate));
            let reason = || bad(1, format!("fps is {fps}, expected frames a second"));
            Some(rate.ok_or_else(reason)?)
        }
    };
    let spans = value["spans_m"].as_array().map_or(&[][..], Vec::as_slice);
    Ok(CameraFacts {
        rate,
        kind: value["kind"].as_str().map(ToOwned::to_owned),
        spans_m: spans.iter().filter_map(Value::as_f64).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shell::formats::clips::clips;

    #[test]
    fn facts_by_name_and_errors_by_place() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| {
            let path = folder.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        };
        let data = folder.path().join("dev");
        for clip in ["a", "b"] {
            write(&format!("dev/{clip}/gt.txt"), "");
            write(&format!("dev/{clip}/1.png"), "");
        }
        write("dev/a/camera.json", r#"{"fps": 25, "kind": "hover"}"#);
        let facts = |data: &Path| read(data, &clips(data).unwrap()).map_err(|e| e.to_string());
        let kind = |kind: &str| Some(kind.to_string());
        let a = Facts { rate: 25.0, rate_given: true, kind: kind("hover"), ..Facts::default() };
        let b = Facts { rate: 30.0, ..Facts::default() };
        assert_eq!(facts(&data).unwrap(), [a.clone(), b.clone()]);

        write("dev.csv", "clip,kind,agitation\na,crossing,0.35\n\nother,none,2\n");
        let a = Facts { kind: kind("crossing"), agitation: Some(0.35), ..a };
        assert_eq!(facts(&data).unwrap(), [a.clone(), b]);
        assert_eq!(facts(&data.join("a")).unwrap(), [a]);

        write("dev.csv", "clip,kind,agitation\na,crossing,rough\n");
        let error = facts(&data).unwrap_err();
        assert!(error.contains("dev.csv line 2: agitation is 'rough'"), "{error}");
        write("dev.csv", "Some,other\ntable\n");
        assert_eq!(facts(&data).unwrap()[1], Facts { rate: 30.0, ..Facts::default() });
        write("dev.csv", "clip,kind,agitation\na,crossing\n");
        assert!(facts(&data).unwrap_err().contains("line 2: 2 fields"));
        write("dev.csv", "");
        write("dev/a/camera.json", r#"{"fps": "x"}"#);
        let error = facts(&data).unwrap_err();
        assert!(error.contains("camera.json line 1: fps is \"x\""), "{error}");
        write("dev/a/camera.json", "{\n\"fps\"");
        assert!(facts(&data).unwrap_err().contains("camera.json line 2"));
    }
}
