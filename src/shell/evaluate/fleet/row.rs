//! A clip of a manifest.

use crate::shell::error::Error;
use crate::shell::evaluate::facts::{self, Facts, Listed};
use crate::shell::formats::clips::{self, Clip, GroundTruth};
use crate::shell::formats::seqinfo::SeqInfo;
use serde::{Deserialize, Serialize};
use std::format;
use std::path::Path;
use std::string::String;

/// A clip of a manifest.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ManifestRow {
    /// Its name, behind that of the split where there are several; no other one has it.
    pub clip: String,
    /// The folder of clips that it is counted with.
    pub split: String,
    /// Folder, video or address.
    pub path: String,
    /// Ground truth; empty: in the clip's folder.
    #[serde(default)]
    pub labels: String,
    /// The vehicle's log; empty without one.
    #[serde(default)]
    pub telemetry: String,
    /// `NAME=VALUE;NAME=VALUE`.
    #[serde(default)]
    pub tags: String,
}

impl ManifestRow {
    /// The facts of its tags.
    ///
    /// # Errors
    /// What is wrong, in words.
    pub fn listed(&self) -> Result<Listed, String> {
        let mut listed = Listed::default();
        for tag in self.tags.split(';').filter(|tag| !tag.trim().is_empty()) {
            let Some((name, value)) = tag.trim().split_once('=') else { continue };
            let number = || {
                let number = value.parse::<f64>().ok().filter(|value| value.is_finite());
                number.ok_or_else(|| format!("tag {name} is '{value}', expected a number"))
            };
            match name {
                "kind" => listed.kind = Some(value.into()),
                "agitation" => listed.agitation = Some(number()?),
                "movers" => listed.movers = Some(number()?),
                _ => {}
            }
        }
        Ok(listed)
    }

    /// The clip and its facts; `folder` is the manifest's.
    ///
    /// # Errors
    /// [`Error`] of its files.
    pub fn clip(&self, folder: &Path) -> Result<(Clip, Facts), Error> {
        let path = folder.join(&self.path);
        let labels = (!self.labels.is_empty()).then(|| folder.join(&self.labels));
        if labels.is_none() && path.is_file() {
            return Err(clips::ClipsError::NoLabels { path }.into());
        }
        let mut clip = if path.is_dir() {
            clips::clip(&path)?
        } else {
            Clip {
                name: String::new(),
                directory: path.parent().unwrap_or(Path::new("")).into(),
                input: path,
                ground_truth: GroundTruth::default(),
                info: SeqInfo::default(),
            }
        };
        if let Some(labels) = labels {
            clip.ground_truth = GroundTruth::read(&labels).map_err(clips::ClipsError::from)?;
        }
        clip.name.clone_from(&self.clip);
        let facts = facts::of(&clip, self.listed().unwrap_or_default())?;
        Ok((clip, facts))
    }
}
