//! Fields of a YAML or JSON document by name, without case, `_` and `-`.

use super::error::CalibrationError;
use serde_yaml_ng::Value;
use std::borrow::ToOwned;
use std::string::String;
use std::vec::Vec;

/// The first document of a YAML text, less what OpenCV and `rostopic` write that is not YAML.
pub(super) fn document(text: &str) -> Result<Value, CalibrationError> {
    let text = text.trim_start_matches('\u{feff}').trim_start();
    // OpenCV begins with a directive that YAML does not know; it and YAML's own are lines of their own.
    let text = match text.strip_prefix("%YAML") {
        Some(rest) => rest.split_once('\n').map_or("", |(_, body)| body),
        None => text,
    };
    let text = text.replace("!!opencv-matrix", "");
    let mut documents = serde_yaml_ng::Deserializer::from_str(&text);
    let first = documents.next().map(serde::Deserialize::deserialize);
    Ok(first.transpose()?.unwrap_or(Value::Null))
}

/// The fields of the one camera in a file.
#[derive(Debug)]
pub(super) struct CameraFields {
    /// Name as written, name as compared, value.
    pub(super) entries: Vec<(String, String, Value)>,
}

impl CameraFields {
    pub(super) fn of(value: &Value) -> Result<Self, CalibrationError> {
        let fields = Self::list(value);
        // Kalibr has a table for each camera.
        let cameras: Vec<_> = fields
            .entries
            .iter()
            .filter(|(_, name, value)| {
                name.strip_prefix("cam").is_some_and(|n| n.parse::<u8>().is_ok())
                    && value.is_mapping()
            })
            .collect();
        match cameras.as_slice() {
            [] => Ok(fields),
            [(_, _, camera)] => Ok(Self::list(camera)),
            several => {
                let names: Vec<&str> = several.iter().map(|(name, ..)| name.as_str()).collect();
                Err(CalibrationError::Several(names.join(", ")))
            }
        }
    }

    pub(super) fn list(value: &Value) -> Self {
        let entries = value.as_mapping().into_iter().flatten().filter_map(|(name, value)| {
            let name = name.as_str()?;
            let compared: String =
                name.chars().filter(|c| c.is_ascii_alphanumeric()).collect::<String>();
            Some((name.to_owned(), compared.to_ascii_lowercase(), value.clone()))
        });
        Self { entries: entries.collect() }
    }

    /// The one entry under these names; several must be equal.
    pub(super) fn get(&self, names: &[&str]) -> Result<Option<(&str, &Value)>, CalibrationError> {
        let mut found: Option<(&str, &Value)> = None;
        for (name, compared, value) in &self.entries {
            if !names.contains(&compared.as_str()) {
                continue;
            }
            match found {
                Some((first, other)) if other != value => {
                    let (first, second) = (first.to_owned(), name.clone());
                    return Err(CalibrationError::Contradiction { first, second });
                }
                _ => found = Some((name, value)),
            }
        }
        Ok(found)
    }
}

/// The numbers of a list, a list of lists, or a table with `data`.
pub(super) fn numbers(name: &str, value: &Value) -> Result<Vec<f64>, CalibrationError> {
    let shape =
        || CalibrationError::Shape { field: name.to_owned(), expected: "a list of numbers" };
    if value.is_mapping() {
        let side =
            |key: &str| value.get(key).map(|side| side.as_u64().ok_or_else(shape)).transpose();
        let numbers = numbers(name, value.get("data").ok_or_else(shape)?)?;
        if let (Some(rows), Some(cols)) = (side("rows")?, side("cols")?)
            && rows.checked_mul(cols) != Some(numbers.len() as u64)
        {
            let (field, given) = (name.to_owned(), numbers.len());
            return Err(CalibrationError::Count { field, rows, cols, given });
        }
        return Ok(numbers);
    }
    let mut list = Vec::new();
    for item in value.as_sequence().ok_or_else(shape)? {
        match item {
            Value::Sequence(row) => {
                for number in row {
                    list.push(number.as_f64().ok_or_else(shape)?);
                }
            }
            number => list.push(number.as_f64().ok_or_else(shape)?),
        }
    }
    Ok(list)
}
