//! Why a training cannot start or go on.

use super::boost::{BoostError, SamplesError};
use super::lightgbm::LightGbmError;
use crate::model::ModelError;
use crate::shell::error::Error;
use crate::shell::pipeline::methods::MethodName;
use crate::shell::render::RenderError;
use std::path::PathBuf;
use std::string::String;
use std::vec::Vec;

/// Why a training cannot start or go on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrainError {
    /// A method that is not trained.
    #[error("{method} learns nothing: run it with `lookout eval DATA_SPLIT --method {method}`")]
    NothingToLearn {
        /// Method that was asked for.
        method: MethodName,
    },
    /// Nothing to paste, or nothing to paste it into.
    #[error(
        "--paste: needs clips to paste into (with truth.csv and camera.json, or without targets) and others whose objects stand before a plain sky, 18 pixels long at least"
    )]
    NothingToPaste,
    /// Footage given as empty that has targets.
    #[error(
        "{}: {boxes} boxes in gt.txt; --empty takes footage without targets, name this folder as DATA", path.display()
    )]
    NotEmpty {
        /// The clip's folder.
        path: PathBuf,
        /// Boxes of its ground truth.
        boxes: usize,
    },
    /// Nothing but footage without targets.
    #[error(
        "--empty alone shows nothing that must be found{}; name clips with targets as DATA too, or add rendered flights (--render N --backgrounds DIR)",
        if *adapts { ", and a model adapted to it would forget its targets" } else { "" }
    )]
    OnlyEmpty {
        /// Whether a model is adapted.
        adapts: bool,
    },
    /// A clip that became shorter during a training.
    #[error(
        "{input}: frame {frame} is not there any more; leave the clips as they are until the training ends"
    )]
    Gone {
        /// Input of the clip.
        input: String,
        /// The frame, from 1.
        frame: usize,
    },
    /// Flights cannot be rendered without pictures.
    #[error(
        "--render: no pictures to fly before; name a folder of photographs with --backgrounds DIR"
    )]
    NoBackgrounds,
    /// Flights of another training.
    #[error("{}: flights of other settings; remove the folder, or name another --out", path.display())]
    OtherFlights {
        /// Their folder.
        path: PathBuf,
    },
    /// No window shows a target.
    #[error(
        "no target in the sampled frames of the clips that are trained on; targets count from 7 pixels on, wholly in view ({clips} clips, {frames} frames sampled): give more clips, or more frames with --samples"
    )]
    NoTargets {
        /// Clips trained on.
        clips: usize,
        /// Frames sampled of them.
        frames: usize,
    },
    /// The scan leaves nothing but targets to the classifier.
    #[error(
        "the scan hands on no window without a target, so the classifier of st-cubes has no negatives; add footage of other backgrounds (--empty DIR), or leave the classifier out (--no-stcube)"
    )]
    NoFalseCandidates,
    /// The scan leaves no target to the classifier.
    #[error(
        "the scan hands on no window with a target; give more clips with targets, or more trees (--scan-trees) or candidates (--candidates)"
    )]
    NoTrueCandidates,
    /// A model to adapt without a part that adapting needs.
    #[error("{}: has no classifier of st-cubes to adapt; leave --adapt out to train one on its scan", path.display())]
    NothingToAdapt {
        /// Path of the model file.
        path: PathBuf,
    },
    /// Shards of a pass that were not mined.
    #[error(
        "pass {pass}: {}", if *other { "there are windows of another number of shards too; remove those".into() } else { std::format!("shard {} of {count} was not mined yet; run lookout mine --shard I/{count} for it", missing.join(", ")) }
    )]
    MissingShards {
        /// Number of the pass, from 0.
        pass: usize,
        /// Numbers of the shards that are missing.
        missing: Vec<String>,
        /// Number of shards.
        count: usize,
        /// Whether there are files of another number of shards.
        other: bool,
    },
    /// Windows of a shard that do not fit.
    #[error("{}: {reason}; remove it and mine the shard again", path.display())]
    Mined {
        /// Path of the file.
        path: PathBuf,
        /// Fault, in words.
        reason: String,
    },
    /// Arguments of trainings that mine nothing.
    #[error("--from and --calibrate: nothing is mined for a scan that is there; run lookout train")]
    NotMined,
    /// Rendered flights that are not there yet.
    #[error("{}: not all flights are rendered yet; run lookout fit with the same arguments first, which renders them", path.display())]
    NotRendered {
        /// Folder of the flights.
        path: PathBuf,
    },
    /// A model of LightGBM that cannot be the scan.
    #[error("--scan-from: {0}")]
    LightGbm(#[from] LightGbmError),
    /// Trees cannot be grown.
    #[error(transparent)]
    Boost(#[from] BoostError),
    /// Values cannot be binned.
    #[error(transparent)]
    Samples(#[from] SamplesError),
    /// The trained model cannot be parsed: a fault of the program.
    #[error("what was trained is no model: {0}; report this")]
    Model(#[from] ModelError),
    /// A model card that is no text.
    #[error("{}: cannot be read as a model card: {source}; name another file with --card", path.display())]
    Card {
        /// Path of the file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// Flights cannot be rendered.
    #[error(transparent)]
    Render(#[from] RenderError),
}

impl From<TrainError> for Error {
    fn from(error: TrainError) -> Self {
        Self::verb(error)
    }
}
