//! The times of pictures in a folder: `times.csv`, a line `NAME,MICROSECONDS` each, rising, as a recording has it.

use super::SourceError;
use crate::shell::support::text::read_text;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;
use std::{format, io};

/// The time of every picture; `None` where the folder has no such file.
///
/// # Errors
/// [`SourceError::Open`], [`SourceError::Times`].
pub fn read(folder: &Path, pictures: &[PathBuf]) -> Result<Option<Vec<i64>>, SourceError> {
    let path = folder.join("times.csv");
    let text = match read_text(&path) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(source) => return Err(SourceError::Open { path, source }),
    };
    let mut known = HashMap::new();
    let mut last = i64::MIN;
    let wrong =
        |line: usize, reason: String| SourceError::Times { path: path.clone(), line, reason };
    for (number, line) in text.lines().enumerate() {
        let time =
            line.rsplit_once(',').and_then(|(name, time)| Some((name, time.parse::<i64>().ok()?)));
        let (name, time) =
            time.ok_or_else(|| wrong(number + 1, "expected NAME,MICROSECONDS".into()))?;
        if time <= last {
            return Err(wrong(number + 1, "the time is not later than the one before".into()));
        }
        last = time;
        known.insert(name, time);
    }
    let time = |picture: &PathBuf| {
        let name = picture.file_name().unwrap_or_default().to_string_lossy().to_string();
        let time = known.get(name.as_str()).copied();
        time.ok_or_else(|| wrong(text.lines().count(), format!("no line for {name}")))
    };
    pictures.iter().map(time).collect::<Result<Vec<_>, _>>().map(Some)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn times_are_those_of_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let pictures = ["1.png", "2.png"].map(|name| folder.path().join(name));
        assert_eq!(read(folder.path(), &pictures).unwrap(), None);
        for (text, wanted) in [
            ("1.png,0\n2.png,50\n3.png,70", Ok([0, 50])),
            ("1.png,0\n2.png,x", Err("times.csv line 2: expected NAME,MICROSECONDS")),
            ("1.png,0\n2.png,0", Err("times.csv line 2: the time is not later")),
            ("1.png,0", Err("times.csv line 1: no line for 2.png")),
        ] {
            fs::write(folder.path().join("times.csv"), text).unwrap();
            match (read(folder.path(), &pictures), wanted) {
                (Ok(times), Ok(wanted)) => assert_eq!(times.unwrap(), wanted),
                (Err(error), Err(wanted)) => assert!(error.to_string().contains(wanted), "{error}"),
                (found, wanted) => panic!("{found:?}, not {wanted:?}"),
            }
        }
    }
}
