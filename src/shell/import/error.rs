//! Why a data set cannot be imported.

use std::io;
use std::path::{Path, PathBuf};
use std::string::String;
use std::vec::Vec;

/// Why `lookout import` ended early.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// A file or folder cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// A file or folder cannot be written.
    #[error("{}: cannot be written: {source}", path.display())]
    Write {
        /// Path of the file.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// A folder without labels of this form.
    #[error("{}: no labels of this form in it; give the data set's top folder, or the file with the labels", path.display())]
    Nothing {
        /// Path of the folder.
        path: PathBuf,
    },
    /// JSON that is not of the form.
    #[error("{}: {source}", path.display())]
    Json {
        /// Path of the file.
        path: PathBuf,
        /// Place and reason.
        source: serde_json::Error,
    },
    /// XML that is damaged.
    #[error("{}: {source}", path.display())]
    Xml {
        /// Path of the file.
        path: PathBuf,
        /// Place and reason.
        source: roxmltree::Error,
    },
    /// A value that is missing or not understood.
    #[error("{}{}: {what} is '{value}', expected {expected}", path.display(), line.map_or(String::new(), |l| std::format!(":{l}")))]
    Value {
        /// Path of the file.
        path: PathBuf,
        /// The line, from 1, where there are lines.
        line: Option<u32>,
        /// Field of the label at fault.
        what: &'static str,
        /// Its text; empty where it is missing.
        value: String,
        /// The expected form.
        expected: &'static str,
    },
    /// A picture whose size cannot be read.
    #[error("{}: not a picture: {source}", path.display())]
    Picture {
        /// Path of the picture.
        path: PathBuf,
        /// The decoder's reason.
        source: image::ImageError,
    },
    /// Classes that no table names.
    #[error(
        "class{} not known: {}; map {} in a file given with --classes, lines NAME = drone|airplane|helicopter|bird|ignore|skip",
        if classes.len() == 1 { "" } else { "es" }, classes.join(", "), if classes.len() == 1 { "it" } else { "them" }
    )]
    Classes {
        /// Names, each with how many boxes have it.
        classes: Vec<String>,
    },
    /// A clip that is there already.
    #[error("{}: is there already; import into another folder, or take it away", path.display())]
    Exists {
        /// The clip's folder.
        path: PathBuf,
    },
    /// Two sequences of one name.
    #[error(
        "two sequences of the name {name}: import them one after the other into different folders"
    )]
    SameName {
        /// Name that is not known.
        name: String,
    },
    /// A `gt.txt` that is not understood.
    #[error(transparent)]
    SeqInfo(#[from] crate::shell::formats::seqinfo::SeqInfoError),
}

impl ImportError {
    /// For `map_err`: `path` cannot be read.
    pub fn read(path: &Path) -> impl FnOnce(io::Error) -> Self + '_ {
        move |source| Self::Read { path: path.into(), source }
    }

    /// For `map_err`: `path` cannot be written.
    pub fn write(path: &Path) -> impl FnOnce(io::Error) -> Self + '_ {
        move |source| Self::Write { path: path.into(), source }
    }
}
