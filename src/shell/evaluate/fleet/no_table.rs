//! In place of `table` where the feature `parquet` is off: every Parquet file is an error that says so.

use super::FleetError;
use super::parts::OutcomeParts;
use super::row::ManifestRow;
use crate::shell::error::Error;
use crate::shell::evaluate::matching::DetectionRecord;
use std::path::Path;
use std::string::String;
use std::vec::Vec;

fn missing(path: &Path, instead: &'static str) -> Error {
    FleetError::NoParquet { path: path.into(), instead }.forever()
}

/// As that of `table`.
///
/// # Errors
/// [`FleetError::NoParquet`].
pub fn encode_manifest(path: &Path, _: &[ManifestRow]) -> Result<Vec<u8>, Error> {
    Err(missing(path, "name a file that ends in .csv"))
}

/// As that of `table`.
///
/// # Errors
/// [`FleetError::NoParquet`].
pub fn read_manifest(path: &Path) -> Result<Vec<ManifestRow>, Error> {
    Err(missing(path, "write the manifest as CSV"))
}

/// As that of `table`.
///
/// # Errors
/// [`FleetError::NoParquet`].
pub fn encode_outcome(_: &OutcomeParts) -> Result<Vec<u8>, Error> {
    Err(missing(Path::new("--parquet"), "write lines of JSON"))
}

/// As that of `table`.
///
/// # Errors
/// [`FleetError::NoParquet`].
pub fn read_outcome(path: &Path) -> Result<(String, Vec<DetectionRecord>), Error> {
    Err(missing(path, "evaluate without --parquet"))
}

/// As that of `table`.
///
/// # Errors
/// [`FleetError::NoParquet`].
pub fn read_head(path: &Path) -> Result<String, Error> {
    Err(missing(path, "evaluate without --parquet"))
}
