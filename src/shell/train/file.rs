//! The files of a training: the model, section by section, and those in its folder until it is finished.

use super::boost::TrainedForest;
use super::parts::PartFiles;
use super::window_files::WindowFiles;
use crate::model::calibration::Knot;
use crate::model::{self, GEOMETRY, HEADER, MAGIC, Method, Model, Section, VERSION};
use crate::shell::error::Error;
use crate::stcube::feature::Feature;
use std::fs;
use std::path::{Path, PathBuf};
use std::vec::Vec;

/// A forest without trees: its score is 0.
const NO_TREES: [u8; 12] = [0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0];

/// The files of a training, in the folder of the model.
#[derive(Debug)]
pub struct TrainingFiles {
    out: PathBuf,
    /// File of the unfinished model.
    pub partial: PathBuf,
    /// Progress in JSON Lines.
    pub log: PathBuf,
}

impl TrainingFiles {
    /// Of the model file `out`.
    pub fn beside(out: &Path) -> Self {
        let partial = out.with_extension("lkm.partial");
        Self { out: out.into(), partial, log: out.with_extension("jsonl") }
    }

    /// Those of the scan's windows.
    pub fn windows(&self, settings: &str) -> WindowFiles {
        WindowFiles::new(&self.out, settings)
    }

    /// Those of windows that were mined in shards.
    pub fn parts(&self, settings: &str) -> PartFiles {
        PartFiles::new(&self.out, settings)
    }

    /// Removes the partial model and the scan's windows; the log stays.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn remove(&self) -> Result<(), Error> {
        WindowFiles::remove(&self.out);
        PartFiles::remove(&self.out);
        let path = &self.partial;
        fs::remove_file(path).map_err(Error::write(path))
    }
}

/// The sections of a model under way.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ModelSections {
    method: Method,
    sections: [Vec<u8>; Section::ALL.len()],
}

impl ModelSections {
    /// No provenance, no features, forests without trees.
    pub fn new(method: Method) -> Self {
        let no_forests = [
            Section::Provenance,
            Section::PatchFeatures,
            Section::CubeFeatures,
            Section::Calibration,
        ];
        let empty = |s| {
            let none = no_forests.contains(&s) || Section::FIT.contains(&s);
            if none { Vec::new() } else { NO_TREES.to_vec() }
        };
        Self { method, sections: Section::ALL.map(empty) }
    }

    /// The sections of a model.
    pub fn of(model: &Model<'_>) -> Self {
        Self { method: model.method(), sections: Section::ALL.map(|s| model.section(s).to_vec()) }
    }

    /// Puts in sections of a model in place of those that are there.
    pub fn take(&mut self, model: &Model<'_>, sections: &[Section]) {
        for &section in sections {
            self.sections[section as usize] = model.section(section).to_vec();
        }
    }

    /// Whether a forest has trees.
    pub fn has_trees(&self, section: Section) -> bool {
        let bytes = &self.sections[section as usize];
        !bytes.is_empty() && *bytes != NO_TREES
    }

    /// Puts in where the model comes from (JSON).
    pub fn set_provenance(&mut self, text: &str) {
        self.sections[Section::Provenance as usize] = text.as_bytes().to_vec();
    }

    /// Puts in the table of precisions; without knots it is unknown.
    pub fn set_calibration(&mut self, knots: &[Knot]) {
        let bytes = knots.iter().flat_map(|knot| knot.encode()).collect();
        self.sections[Section::Calibration as usize] = bytes;
    }

    /// Puts in a forest whose features are numbered by the core itself.
    pub fn set_forest(&mut self, section: Section, forest: &TrainedForest) {
        self.sections[section as usize] = forest.encode();
    }

    /// Puts in a table of features.
    pub fn set_features(&mut self, section: Section, features: &[Feature]) {
        self.sections[section as usize] = features.iter().flat_map(Feature::encode).collect();
    }

    /// Puts in forests trained on all of `pool` and, in section `features`, those features that they ask for.
    pub fn set_forests(
        &mut self,
        features: Section,
        pool: &[Feature],
        forests: Vec<(Section, TrainedForest)>,
    ) {
        let asked = |(_, forest): &(Section, TrainedForest)| forest.clone().compact();
        let mut used: Vec<u16> = forests.iter().flat_map(asked).collect();
        used.sort_unstable();
        used.dedup();
        let kept: Vec<Feature> = used.iter().map(|&id| pool[usize::from(id)]).collect();
        self.set_features(features, &kept);
        for (section, mut forest) in forests {
            forest.renumber(|id| used.partition_point(|&u| u < id) as u16, used.len() as u16);
            self.set_forest(section, &forest);
        }
    }

    /// The bytes of the file.
    pub fn encode(&self) -> Vec<u8> {
        let length = HEADER + self.sections.iter().map(Vec::len).sum::<usize>();
        let mut covered = GEOMETRY.to_vec();
        covered.extend(self.method.encode());
        self.sections.iter().for_each(|s| covered.extend((s.len() as u32).to_le_bytes()));
        self.sections.iter().for_each(|s| covered.extend(s));
        let mut bytes = MAGIC.to_vec();
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend([0; 2]);
        bytes.extend((length as u32).to_le_bytes());
        bytes.extend(model::checksum(&covered).to_le_bytes());
        bytes.extend(covered);
        bytes
    }
}
