//! The list of clips: CSV, or Parquet, with the columns clip, split, path, labels, telemetry and tags.
//!
//! Paths are relative to the manifest's folder where they lie below it. `path` is a clip's folder, a video, or an address
//! (`https://`), which is fetched when the clip's turn comes. `tags` are the facts of the table beside a split:
//! `kind=hover;agitation=0.3;movers=2`; others are kept and not read.

use super::form::is_parquet;
use super::row::ManifestRow;
use super::{FleetError, table};
use crate::shell::error::Error;
use crate::shell::evaluate::facts::Facts;
use crate::shell::evaluate::splits::Splits;
use crate::shell::formats::clips;
use crate::shell::sources::has_extension;
use crate::shell::support::atomic_file;
use crate::shell::support::interrupt::Ended;
use crate::shell::support::print::print_line;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;
use std::{format, fs};

/// Command-line arguments of `lookout manifest`.
#[derive(Debug, Clone, clap::Args)]
pub struct ManifestArgs {
    /// Folders of clips, as `lookout eval` takes them
    #[arg(value_name = "DATA_SPLIT", required = true)]
    data: Vec<PathBuf>,
    /// Only clips whose names contain one of these
    #[arg(long, value_name = "TEXT", value_delimiter = ',')]
    clips: Vec<String>,
    /// The manifest to write: CSV, or Parquet where its name ends in .parquet (feature `parquet`)
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// A manifest as it was read.
#[derive(Debug, Clone)]
pub struct Manifest {
    /// Its folder, which paths are relative to.
    pub folder: PathBuf,
    /// One row a clip, in the order of the file.
    pub rows: Vec<ManifestRow>,
    /// The clips as CSV, for the folder of the run.
    pub bytes: Vec<u8>,
}

/// Writes a manifest of folders of clips.
///
/// # Errors
/// [`Error`] where there is no clip, or the file cannot be written; after it was written, where clips had to be left out.
pub fn run(args: &ManifestArgs) -> Result<Ended, Error> {
    let splits = Splits::read(&args.data, &args.clips)?;
    let folder = Path::new(".").join(folder_of(&args.out));
    let folder = folder.canonicalize().map_err(Error::read(&folder))?;
    let mut rows = Vec::new();
    for (number, clip) in splits.clips.iter().enumerate() {
        let labels = clips::labels_of_clip(clip);
        // A video in a folder of videos is a clip by itself.
        let alone = clips::labels(&clip.directory).is_none();
        let path = if alone { &clip.input } else { &clip.directory };
        rows.push(ManifestRow {
            clip: clip.name.clone(),
            split: splits.folders[splits.split[number]].display().to_string(),
            path: below(&folder, path),
            labels: labels.map_or(String::new(), |labels| below(&folder, &labels)),
            telemetry: if alone {
                String::new()
            } else {
                log_in(&clip.directory).map_or(String::new(), |log| below(&folder, &log))
            },
            tags: tags(&splits.facts[number]),
        });
    }
    let bytes = match is_parquet(&args.out) {
        true => table::encode_manifest(&args.out, &rows)?,
        false => csv_of(&args.out, &rows)?,
    };
    atomic_file::write(&args.out, &bytes).map_err(Error::write(&args.out))?;
    print_line(&format!("{}: {} clips", args.out.display(), splits.clips.len()))?;
    splits.complain()?;
    Ok(Ended::Complete)
}

/// The rows as CSV.
fn csv_of(path: &Path, rows: &[ManifestRow]) -> Result<Vec<u8>, Error> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for row in rows {
        writer.serialize(row).map_err(|error| wrong(path, 0, &error))?;
    }
    writer.into_inner().map_err(|error| wrong(path, 0, error.error()))
}

fn wrong(path: &Path, line: u64, reason: &dyn ToString) -> Error {
    FleetError::Manifest { path: path.into(), line, reason: reason.to_string() }.forever()
}

fn folder_of(manifest: &Path) -> PathBuf {
    match manifest.parent() {
        Some(folder) if folder != Path::new("") => folder.into(),
        _ => PathBuf::new(),
    }
}

/// A path as the manifest has it.
fn below(folder: &Path, path: &Path) -> String {
    let path = path.canonicalize().unwrap_or_else(|_| path.into());
    path.strip_prefix(folder).unwrap_or(&path).display().to_string()
}

/// The vehicle's log in a clip's folder.
fn log_in(folder: &Path) -> Option<PathBuf> {
    let entries = fs::read_dir(folder).ok()?.flatten().map(|entry| entry.path());
    entries.filter(|path| has_extension(path, &["tlog", "bin", "ulg"])).min()
}

/// Facts of a clip that are not in its `camera.json`, as tags.
fn tags(facts: &Facts) -> String {
    let number = |name: &str, value: Option<f64>| value.map(|value| format!("{name}={value}"));
    let kind = facts.kind.as_deref().map(|kind| format!("kind={}", kind.replace(';', ",")));
    let all = [kind, number("agitation", facts.agitation), number("movers", facts.movers)];
    all.into_iter().flatten().collect::<Vec<_>>().join(";")
}

impl Manifest {
    /// Reads one; of its clips those whose names contain one of `names`, all without any.
    ///
    /// # Errors
    /// [`Error`] where it cannot be read; [`FleetError::Manifest`] where it makes no sense.
    pub fn read(path: &Path, names: &[String]) -> Result<Self, Error> {
        let bytes = match is_parquet(path) {
            true => csv_of(path, &table::read_manifest(path)?)?,
            false => fs::read(path).map_err(Error::read(path))?,
        };
        let mut rows: Vec<ManifestRow> = Vec::new();
        let mut known = BTreeSet::new();
        for row in csv::Reader::from_reader(bytes.as_slice()).deserialize() {
            let row: ManifestRow = row.map_err(|error| {
                let line = error.position().map_or(1, csv::Position::line);
                wrong(path, line, &error)
            })?;
            // The header is the first line.
            let line = known.len() as u64 + 2;
            if row.clip.is_empty() || row.path.is_empty() {
                return Err(wrong(path, line, &"clip or path is empty"));
            }
            if !known.insert(row.clip.clone()) {
                let reason = format!("a second clip of the name {}", row.clip);
                return Err(wrong(path, line, &reason));
            }
            row.listed().map_err(|reason| wrong(path, line, &reason))?;
            if names.is_empty() || names.iter().any(|name| row.clip.contains(name)) {
                rows.push(row);
            }
        }
        if rows.is_empty() {
            return Err(wrong(path, 1, &"no clip in it, or none of that name"));
        }
        Ok(Self { folder: folder_of(path), rows, bytes })
    }

    /// The folders of the splits, and the number of each row's split.
    pub fn splits(&self) -> (Vec<PathBuf>, Vec<usize>) {
        let mut folders: Vec<PathBuf> = Vec::new();
        let mut number = |row: &ManifestRow| {
            let folder = PathBuf::from(&row.split);
            folders.iter().position(|known| *known == folder).unwrap_or_else(|| {
                folders.push(folder);
                folders.len() - 1
            })
        };
        let numbers = self.rows.iter().map(&mut number).collect();
        (folders, numbers)
    }
}
