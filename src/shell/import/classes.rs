//! Names of classes in other data sets, and what they are here.

use super::{ImportError, Sequence};
use crate::shell::formats::class::Class;
use std::borrow::ToOwned;
use std::collections::BTreeMap;
use std::path::Path;
use std::string::{String, ToString};
use std::vec::Vec;
use std::{format, fs};

/// Mapping of a data set's class.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mapped {
    /// Boxes of this class.
    Class(Class),
    /// Boxes that count neither way.
    Ignore,
    /// Nothing: as if not labelled.
    Skip,
}

/// Names that need no table, lower case, without spaces, dashes and underscores.
const KNOWN: [(Class, &[&str]); 4] = [
    (
        Class::Drone,
        &[
            "drone",
            "uav",
            "uas",
            "quadcopter",
            "quadrotor",
            "multirotor",
            "multicopter",
            "hexacopter",
            "octocopter",
        ],
    ),
    (Class::Airplane, &["airplane", "aeroplane", "plane", "aircraft", "fixedwing", "glider"]),
    (Class::Helicopter, &["helicopter"]),
    (Class::Bird, &["bird", "birds", "flock"]),
];

/// A table of class names; names that it does not hold are looked up among the usual ones.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ClassMap {
    table: BTreeMap<String, Mapped>,
}

impl ClassMap {
    /// Reads a table: lines `NAME = CLASS` (or `NAME,CLASS`); empty lines and those with `#` at the start are skipped.
    ///
    /// # Errors
    /// [`ImportError`] naming the line.
    pub fn read(path: &Path) -> Result<Self, ImportError> {
        let text = fs::read_to_string(path).map_err(ImportError::read(path))?;
        let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
        let mut table = BTreeMap::new();
        for (line, number) in text.lines().zip(1..) {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let wrong = |value: &str| ImportError::Value {
                path: path.into(),
                line: Some(number),
                what: "the line",
                value: value.to_owned(),
                expected: "NAME = drone, airplane, helicopter, bird, ignore or skip",
            };
            let separated = line.rsplit_once('=').or_else(|| line.rsplit_once(','));
            let (name, class) = separated.ok_or_else(|| wrong(line))?;
            let unquoted = |text: &str| text.trim().trim_matches(['"', '\'']).to_owned();
            let mapped = match unquoted(class).to_ascii_lowercase().as_str() {
                "ignore" => Mapped::Ignore,
                "skip" => Mapped::Skip,
                class => Mapped::Class(Class::from_name(class).ok_or_else(|| wrong(line))?),
            };
            table.insert(unquoted(name), mapped);
        }
        Ok(Self { table })
    }

    /// Mapping of the class `name`.
    pub fn get(&self, name: &str) -> Option<Mapped> {
        self.table.get(name).copied().or_else(|| {
            let plain: String = name.chars().filter(|c| c.is_alphanumeric()).collect();
            let plain = plain.to_lowercase();
            let known = KNOWN.iter().find(|(_, names)| names.contains(&plain.as_str()));
            known.map(|(class, _)| Mapped::Class(*class))
        })
    }

    /// Checks that every class of the sequences is known.
    ///
    /// # Errors
    /// [`ImportError::Classes`] with those that are not and how often they occur.
    pub fn check(&self, sequences: &[Sequence]) -> Result<(), ImportError> {
        let mut unknown: BTreeMap<&str, u64> = BTreeMap::new();
        for label in sequences.iter().flat_map(|sequence| &sequence.labels) {
            if self.get(&label.class).is_none() {
                *unknown.entry(&label.class).or_default() += 1;
            }
        }
        if unknown.is_empty() {
            return Ok(());
        }
        let named = unknown.iter().map(|(name, count)| format!("'{name}' ({count} boxes)"));
        Err(ImportError::Classes { classes: named.collect::<Vec<_>>() })
    }
}

/// The name of a class that a data set knows by a number alone.
pub fn numbered(number: impl ToString) -> String {
    number.to_string()
}

#[cfg(test)]
mod tests {
    use super::super::LabelledBox;
    use super::*;
    use std::vec;

    #[test]
    fn tables_and_usual_names() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let text = "\u{feff}# ours\r\nPerson=skip\r\n\"small bird\" = Bird\r\nkite, ignore\r\n2 = helicopter\r\n";
        fs::write(&file, text).unwrap();
        let map = ClassMap::read(file.path()).unwrap();
        assert_eq!(map.get("Person"), Some(Mapped::Skip));
        assert_eq!(map.get("small bird"), Some(Mapped::Class(Class::Bird)));
        assert_eq!(map.get("kite"), Some(Mapped::Ignore));
        assert_eq!(map.get("2"), Some(Mapped::Class(Class::Helicopter)));
        assert_eq!(map.get("Fixed-Wing"), Some(Mapped::Class(Class::Airplane)));
        assert_eq!(map.get("UAV"), Some(Mapped::Class(Class::Drone)));
        assert_eq!(map.get("car"), None);
        fs::write(&file, "car = drone\ncar = tank\n").unwrap();
        let error = ClassMap::read(file.path()).unwrap_err().to_string();
        assert!(error.contains(":2: the line is 'car = tank', expected NAME = drone"), "{error}");
    }

    #[test]
    fn unknown_classes_are_listed() {
        let label = |class: &str| LabelledBox {
            frame: 1,
            id: None,
            rect: [0.0, 0.0, 9.0, 9.0],
            class: class.into(),
            visibility: 1.0,
        };
        let labels = vec![label("drone"), label("car"), label("van"), label("car")];
        let sequence = Sequence { labels, ..Sequence::default() };
        let error = ClassMap::default().check(&[sequence]).unwrap_err().to_string();
        assert!(error.starts_with("classes not known: 'car' (2 boxes), 'van' (1 boxes); map them"));
    }
}
