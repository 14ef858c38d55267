//! Settings that all shards of a run share, in its folder: `run.json`, the model, the manifest; results are in `clips/`.

use super::form::ResultForm;
use super::outcome::hex;
use crate::shell::error::Error;
use crate::shell::support::atomic_file;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::format;
use std::fs;
use std::path::{Path, PathBuf};
use std::string::String;

/// The settings of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunFile {
    /// CRC-32 of the model.
    pub model: String,
    /// Hash of the arguments that results depend on, and of the program's version.
    pub arguments: String,
    /// Least score that was asked for, log-odds.
    pub least: Option<f64>,
    /// Whether figures of tracks are printed.
    pub tracks: bool,
    /// Field of view that stands in for missing `camera.json`, degrees.
    pub assumed_fov: f64,
    /// Form of the results.
    #[serde(default)]
    pub form: ResultForm,
}

impl RunFile {
    /// Reads that of a run's folder.
    ///
    /// # Errors
    /// [`Error`] where there is none.
    pub fn read(run: &Path) -> Result<Self, Error> {
        let path = run.join("run.json");
        let bytes = fs::read(&path).map_err(Error::read(&path))?;
        serde_json::from_slice(&bytes).map_err(|error| {
            let reason = format!("not the settings of a run: {error}");
            Error::verb(super::FleetError::Result { path, reason })
        })
    }

    /// Writes it, the model and the manifest.
    ///
    /// # Errors
    /// The system's.
    pub fn write(&self, run: &Path, model: &[u8], manifest: &[u8]) -> Result<(), Error> {
        let clips = clips(run);
        fs::create_dir_all(&clips).map_err(Error::write(&clips))?;
        let text = serde_json::to_vec(self).unwrap_or_default();
        let files = [
            (self.model_path(run), model),
            (run.join("manifest.csv"), manifest),
            (run.join("run.json"), text.as_slice()),
        ];
        for (path, bytes) in files {
            // All shards write the same.
            if fs::read(&path).is_ok_and(|known| known == bytes) {
                continue;
            }
            atomic_file::write_beside_others(&path, bytes).map_err(Error::write(&path))?;
        }
        Ok(())
    }

    /// The run's copy of the model.
    pub fn model_path(&self, run: &Path) -> PathBuf {
        run.join(format!("model-{}.lkm", self.model))
    }

    /// The end of the names of its results.
    pub fn suffix(&self) -> String {
        format!("-{}-{}.{}", self.model, self.arguments, self.form.extension())
    }
}

/// The folder of results.
pub fn clips(run: &Path) -> PathBuf {
    run.join("clips")
}

/// A short hash of a text.
pub fn hash(text: &str) -> String {
    hex(&Sha256::digest(text.as_bytes())[..4])
}
