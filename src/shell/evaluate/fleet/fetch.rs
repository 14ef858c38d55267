//! Clips whose path is an address: fetched by `curl` into a folder that goes with them.

use super::FleetError;
use super::row::ManifestRow;
use crate::shell::error::Error;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::string::{String, ToString};
use std::{format, fs};

/// A clip's files on this machine, removed when this is dropped.
#[derive(Debug)]
pub struct Fetched {
    folder: PathBuf,
    /// The clip, with paths in the folder.
    pub row: ManifestRow,
}

impl Fetched {
    /// Where the files are.
    pub fn folder(&self) -> &Path {
        &self.folder
    }
}

impl Drop for Fetched {
    fn drop(&mut self) {
        // What stays is found by whoever cleans the folder of temporary files.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// Whether a path of a manifest is an address.
pub fn is_address(path: &str) -> bool {
    ["https://", "http://", "file://"].iter().any(|scheme| path.starts_with(scheme))
}

/// Fetches what a row names by addresses; none where it names no address.
///
/// # Errors
/// [`FleetError::Fetch`]; the next attempt may succeed.
pub fn fetch(row: &ManifestRow) -> Result<Option<Fetched>, Error> {
    if !is_address(&row.path) {
        return Ok(None);
    }
    let name = format!(
        "lookout-{}-{:016x}",
        std::process::id(),
        crate::shell::support::atomic_file::unique()
    );
    let folder = std::env::temp_dir().join(name);
    fs::create_dir(&folder).map_err(Error::write(&folder))?;
    let mut fetched = Fetched { folder, row: row.clone() };
    fetched.row.path = one(&fetched.folder, "video", &row.path)?;
    if is_address(&row.labels) {
        fetched.row.labels = one(&fetched.folder, "labels", &row.labels)?;
    }
    Ok(Some(fetched))
}

/// Fetches one file; gives its name.
fn one(folder: &Path, name: &str, url: &str) -> Result<String, Error> {
    // The ending says the form.
    let path = url.split(['?', '#']).next().unwrap_or_default();
    let ending = Path::new(path).extension().unwrap_or_default().to_string_lossy().to_string();
    let name = format!("{name}.{ending}");
    let failed = |reason: String| Error::verb(FleetError::Fetch { url: url.into(), reason });
    let output = Command::new("curl")
        .args(["--fail", "--silent", "--show-error", "--location", "--retry", "3", "--output"])
        .arg(folder.join(&name))
        .args(["--", url])
        .stdin(Stdio::null())
        .output()
        .map_err(|error| failed(format!("curl cannot be started: {error}")))?;
    if output.status.success() {
        return Ok(name);
    }
    Err(failed(String::from_utf8_lossy(&output.stderr).trim().to_string()))
}
