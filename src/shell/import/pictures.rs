//! Pictures of a data set as sequences of frames.
//!
//! Data sets of single pictures name consecutive frames alike: `flight7_0001.jpg`, `flight7_0002.jpg`. Pictures of one
//! folder whose names differ in their last number alone are one sequence. Where hardly any two do, all of a folder are.

use super::ImportError;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::string::String;
use std::vec::Vec;

/// Endings of pictures that the program reads.
const ENDINGS: [&str; 4] = ["png", "jpg", "jpeg", "pgm"];

/// Every file below `folder` whose name ends in one of `endings`, in the order of their paths.
///
/// # Errors
/// [`ImportError::Read`].
pub fn files(folder: &Path, endings: &[&str]) -> Result<Vec<PathBuf>, ImportError> {
    let mut found = Vec::new();
    let mut folders = Vec::from([folder.to_path_buf()]);
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).map_err(ImportError::read(&folder))? {
            let path = entry.map_err(ImportError::read(&folder))?.path();
            let hidden = path.file_name().is_some_and(|n| n.as_encoded_bytes().starts_with(b"."));
            // Links to folders are not followed: they may lead round in a circle.
            if path.is_dir() && !path.is_symlink() && !hidden {
                folders.push(path);
            } else if !hidden && has_ending(&path, endings) {
                found.push(path);
            }
        }
    }
    found.sort();
    Ok(found)
}

/// Every picture below `folder`.
///
/// # Errors
/// [`ImportError::Read`].
pub fn below(folder: &Path) -> Result<Vec<PathBuf>, ImportError> {
    files(folder, &ENDINGS)
}

/// Whether the name of `path` ends in one of `endings` (lower case), in any case.
pub fn has_ending(path: &Path, endings: &[&str]) -> bool {
    let ending = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    ending.is_some_and(|ending| endings.contains(&ending.as_str()))
}

/// A picture's size in pixels.
///
/// # Errors
/// [`ImportError::Picture`].
pub fn size(path: &Path) -> Result<(u32, u32), ImportError> {
    image::image_dimensions(path)
        .map_err(|source| ImportError::Picture { path: path.into(), source })
}

/// Pictures in sequences: the name of each and its pictures in the order of their numbers.
pub fn sequences(pictures: Vec<PathBuf>) -> Vec<(String, Vec<PathBuf>)> {
    let mut folders: BTreeMap<PathBuf, Vec<PathBuf>> = BTreeMap::new();
    for picture in pictures {
        let folder = picture.parent().unwrap_or(Path::new("")).to_path_buf();
        folders.entry(folder).or_default().push(picture);
    }
    let mut all = Vec::new();
    for (folder, pictures) in folders {
        let mut groups: BTreeMap<String, Vec<(u64, PathBuf)>> = BTreeMap::new();
        let count = pictures.len();
        for picture in pictures {
            let (name, number) = split_number(&picture);
            groups.entry(name).or_default().push((number, picture));
        }
        let named = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        // Names that have nothing in common: no numbers of frames.
        if groups.len() > 1 && 2 * groups.len() > count {
            let all_of = groups.into_values().flatten().map(|(_, picture)| picture);
            let mut all_of: Vec<PathBuf> = all_of.collect();
            all_of.sort();
            all.push((named, all_of));
            continue;
        }
        for (name, mut pictures) in groups {
            pictures.sort();
            let name = if name.is_empty() { named.clone() } else { name };
            all.push((name, pictures.into_iter().map(|(_, picture)| picture).collect()));
        }
    }
    all
}

/// A name without its last number and the marks before that, and the number.
fn split_number(path: &Path) -> (String, u64) {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    // Roboflow's ending: `name_0001_jpg.rf.0123abcd`.
    let stem = stem.split("_jpg.rf.").next().unwrap_or_default();
    let name = stem.trim_end_matches(|c: char| c.is_ascii_digit());
    let digits = stem.strip_prefix(name).unwrap_or_default();
    let number = digits.parse().unwrap_or(0);
    (name.trim_end_matches(['_', '-', '.', ' ']).into(), number)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_make_sequences() {
        let names = [
            "d/b_2.png",
            "d/b_10.png",
            "d/a-1.png",
            "d/a-2.png",
            "e/0002.jpg",
            "e/0001.jpg",
            "f/tree.png",
            "f/house.png",
            "f/x1.png",
        ];
        let all = sequences(names.map(PathBuf::from).into());
        let texts =
            |v: &[PathBuf]| v.iter().map(|p| p.to_str().unwrap().into()).collect::<Vec<String>>();
        let named: Vec<(&str, Vec<String>)> =
            all.iter().map(|(n, p)| (n.as_str(), texts(p))).collect();
        let own = |v: &[&str]| v.iter().map(|s| String::from(*s)).collect::<Vec<_>>();
        assert_eq!(named[0], ("a", own(&["d/a-1.png", "d/a-2.png"])));
        assert_eq!(named[1], ("b", own(&["d/b_2.png", "d/b_10.png"])));
        assert_eq!(named[2], ("e", own(&["e/0001.jpg", "e/0002.jpg"])));
        assert_eq!(named[3], ("f", own(&["f/house.png", "f/tree.png", "f/x1.png"])));
    }
}
