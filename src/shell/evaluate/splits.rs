//! The clips of all splits that the user names, with their facts; clips that cannot be read are listed and left out.

use super::EvaluateError;
use super::facts::{self, Facts};
use crate::shell::error::Error;
use crate::shell::formats::clips::{self, Clip};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;
use std::{eprintln, format};

/// A clip that took no part, and why.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct UnusableClip {
    /// Name of the clip's folder or file.
    pub clip: String,
    /// The reason in words.
    pub reason: String,
}

/// The clips of one or more splits.
#[derive(Debug)]
pub struct Splits {
    /// The folders as the user named them.
    pub folders: Vec<PathBuf>,
    /// The clips that can be read; with several splits their names begin with that of the split.
    pub clips: Vec<Clip>,
    /// Facts of each clip.
    pub facts: Vec<Facts>,
    /// Number of each clip's folder in `folders`.
    pub split: Vec<usize>,
    /// Clips that took no part.
    pub broken: Vec<UnusableClip>,
}

impl Splits {
    /// Reads the clips whose names contain one of `names`; all without any.
    ///
    /// # Errors
    /// [`Error`] when a folder holds no such clip, or the table beside it is broken.
    pub fn read(folders: &[PathBuf], names: &[String]) -> Result<Self, Error> {
        let (clips, facts, split, broken) = Default::default();
        let mut all = Self { folders: folders.into(), clips, facts, split, broken };
        for (number, folder) in folders.iter().enumerate() {
            let wanted = |name: &str| names.is_empty() || names.iter().any(|n| name.contains(n));
            let mut found = Vec::new();
            let mut any = false;
            for clip in clips::find(folder)? {
                match clip {
                    Ok(clip) if wanted(&clip.name) => found.push(clip),
                    Err(broken) if wanted(&broken.name) => {
                        let reason = broken.error.to_string();
                        all.broken
                            .push(UnusableClip { clip: all.named(number, &broken.name), reason });
                    }
                    _ => continue,
                }
                any = true;
            }
            if !any {
                return Err(
                    EvaluateError::NoClips { path: folder.clone(), names: names.into() }.into()
                );
            }
            all.facts.extend(facts::read(folder, &found)?);
            all.split.extend(found.iter().map(|_| number));
            for mut clip in found {
                clip.name = all.named(number, &clip.name);
                all.clips.push(clip);
            }
        }
        Ok(all)
    }

    /// A clip's name, behind the split's where there are several.
    fn named(&self, split: usize, clip: &str) -> String {
        if self.folders.len() < 2 { clip.into() } else { format!("{}/{clip}", self.label(split)) }
    }

    /// Short name of a split: the last two parts of its path, with its number where another one has the same.
    pub fn label(&self, split: usize) -> String {
        let name = |path: &Path| {
            let full = path.canonicalize().unwrap_or_else(|_| path.into());
            let parts: Vec<String> =
                full.iter().map(|part| part.to_string_lossy().into_owned()).collect();
            parts[parts.len().saturating_sub(2)..].join("-").replace('/', "")
        };
        let own = name(&self.folders[split]);
        let same = self.folders.iter().filter(|folder| name(folder) == own).count();
        if same > 1 { format!("{own}-{}", split + 1) } else { own }
    }

    /// The folders in one line.
    pub fn title(&self) -> String {
        let names: Vec<String> = self.folders.iter().map(|f| f.display().to_string()).collect();
        names.join(", ")
    }

    /// Leaves out clips, with reasons.
    pub fn leave_out(&mut self, reasons: &[Option<String>]) {
        for (clip, reason) in self.clips.iter().zip(reasons) {
            if let Some(reason) = reason {
                self.broken.push(UnusableClip { clip: clip.name.clone(), reason: reason.clone() });
            }
        }
        let kept: Vec<bool> = reasons.iter().map(Option::is_none).collect();
        keep(&mut self.clips, &kept);
        keep(&mut self.facts, &kept);
        keep(&mut self.split, &kept);
    }

    /// Lists the clips that took no part on standard error.
    ///
    /// # Errors
    /// As [`complain`].
    pub fn complain(&self) -> Result<(), Error> {
        complain(&self.broken, self.clips.len())
    }

    /// Prints what the labels of the clips needed a word about on standard error.
    pub fn note_labels(&self) {
        self.clips.iter().flat_map(label_notes).for_each(|note| eprintln!("{note}"));
    }
}

/// Lists the clips that took no part on standard error; `others` did.
///
/// # Errors
/// [`Error::BrokenClips`](crate::shell::evaluate::EvaluateError::BrokenClips) when there is one.
pub fn complain(broken: &[UnusableClip], others: usize) -> Result<(), Error> {
    for UnusableClip { clip, reason } in broken {
        eprintln!("lookout: {clip} left out: {}", reason.replace(['\r', '\n'], " "));
    }
    match broken.len() {
        0 => Ok(()),
        broken => Err(EvaluateError::BrokenClips { broken, all: broken + others }.into()),
    }
}

/// Lines about labels of a clip that needed a word.
pub fn label_notes(clip: &Clip) -> impl Iterator<Item = String> + '_ {
    let sentences = clip.ground_truth.notes.sentences().into_iter();
    sentences.map(|sentence| format!("lookout: {}: labels: {sentence}", clip.name))
}

/// Keeps the items whose place in `kept` is true.
pub fn keep<T>(items: &mut Vec<T>, kept: &[bool]) {
    let mut place = 0;
    items.retain(|_| {
        place += 1;
        kept[place - 1]
    });
}
