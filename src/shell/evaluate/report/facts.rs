//! What is known of the clips of a split beside their boxes: frame rate, kind of encounter, agitation of the camera.

use crate::shell::error::Error;
use crate::shell::formats::clips::Clip;
use crate::shell::formats::error::FormatError;
use serde_json::Value;
use std::borrow::ToOwned;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;
use std::{format, fs};

/// Frames a second where no `camera.json` says otherwise.
const DEFAULT_RATE: f64 = 30.0;

/// What is known of a clip.
#[derive(Debug, Clone, PartialEq)]
pub struct Facts {
    /// Frames a second.
    pub rate: f64,
    /// Kind of encounter.
    pub kind: Option<String>,
    /// How much the camera turns; larger is rougher.
    pub agitation: Option<f64>,
}

/// Facts of `clips` from their `camera.json` and from the table beside the folder `data`, where these exist.
///
/// # Errors
/// [`FileError::Read`], or [`FormatError::Line`] naming file and line.
pub fn read(data: &Path, clips: &[Clip]) -> Result<Vec<Facts>, Error> {
    let table = table_path(data);
    let rows = match &table {
        Some(path) if path.is_file() => read_table(path)?,
        _ => BTreeMap::new(),
    };
    clips
        .iter()
        .map(|clip| {
            let camera = read_camera(&clip.directory.join("camera.json"))?;
            let row = rows.get(&clip.name).cloned().unwrap_or_default();
            Ok(Facts {
                rate: camera.rate.unwrap_or(DEFAULT_RATE),
                kind: row.kind.or(camera.kind),
                agitation: row.agitation,
            })
        })
        .collect()
}

/// `SPLIT.csv` beside the folder; of a single clip that of the folder it stands in.
fn table_path(data: &Path) -> Option<PathBuf> {
    let data = data.canonicalize().ok()?;
    let split = if data.join("gt.txt").is_file() { data.parent()? } else { &data };
    let name = split.file_name()?.to_string_lossy();
    Some(split.parent()?.join(format!("{name}.csv")))
}

#[derive(Debug, Clone, Default)]
struct Row {
    kind: Option<String>,
    agitation: Option<f64>,
}

/// A row for each clip, which stands in the first column; the other columns are known by their names.
fn read_table(path: &Path) -> Result<BTreeMap<String, Row>, Error> {
    let text = fs::read_to_string(path).map_err(Error::read(path))?;
    let mut lines = text.lines().enumerate();
    let header: Vec<&str> =
        lines.next().map_or(Vec::new(), |l| l.1.split(',').map(str::trim).collect());
    let mut rows = BTreeMap::new();
    for (index, line) in lines.filter(|(_, line)| !line.trim().is_empty()) {
        let bad = |reason| FormatError::Line { path: path.into(), line: index + 1, reason };
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        if fields.len() != header.len() {
            let (found, expected) = (fields.len(), header.len());
            return Err(bad(format!("{found} fields, the first line names {expected}")).into());
        }
        let mut row = Row::default();
        for (name, field) in header.iter().zip(&fields).filter(|(_, field)| !field.is_empty()) {
            match *name {
                "kind" => row.kind = Some((*field).to_owned()),
                "agitation" => {
                    let number = field.parse::<f64>().ok().filter(|v| v.is_finite());
                    let reason = || bad(format!("agitation is '{field}', expected a number"));
                    row.agitation = Some(number.ok_or_else(reason)?);
                }
                _ => {}
            }
        }
        rows.insert(fields[0].to_owned(), row);
    }
    Ok(rows)
}

#[derive(Debug, Default)]
struct Camera {
    rate: Option<f64>,
    kind: Option<String>,
}

fn read_camera(path: &Path) -> Result<Camera, Error> {
    if !path.is_file() {
        return Ok(Camera::default());
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
    Ok(Camera { rate, kind: value["kind"].as_str().map(ToOwned::to_owned) })
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
        let a = Facts { rate: 25.0, kind: kind("hover"), agitation: None };
        let b = Facts { rate: 30.0, kind: None, agitation: None };
        assert_eq!(facts(&data).unwrap(), [a.clone(), b.clone()]);

        write("dev.csv", "clip,kind,agitation\na,crossing,0.35\n\nother,none,2\n");
        let a = Facts { kind: kind("crossing"), agitation: Some(0.35), ..a };
        assert_eq!(facts(&data).unwrap(), [a.clone(), b]);
        assert_eq!(facts(&data.join("a")).unwrap(), [a]);

        write("dev.csv", "clip,kind,agitation\na,crossing,rough\n");
        let error = facts(&data).unwrap_err();
        assert!(error.contains("dev.csv line 2: agitation is 'rough'"), "{error}");
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
