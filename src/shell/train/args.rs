//! The command line of `lookout train`: arguments, and the recipe and stages that they select.

use super::TrainError;
use super::listing;
use super::rendered::TrainRenderArgs;
use super::stage::TrainingStage;
use crate::channels::history::History;
use crate::model::Method;
use crate::shell::error::Error;
use crate::shell::pipeline::Ablation;
use crate::shell::pipeline::methods::{MethodName, Recipe, Sees};
use crate::shell::pipeline::scaled::FrameSize;
use crate::stcube::compensation::Alignment;
use std::borrow::ToOwned;
use std::format;
use std::path::PathBuf;
use std::string::String;
use std::vec::Vec;

/// Loss that the classifier of st-cubes minimises.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum CubeLoss {
    /// exp(-y F), by Newton steps: gentle AdaBoost.
    Adaboost,
    /// ln(1 + exp(-y F)): scores are log-odds; outliers weigh less.
    Logistic,
}

/// Alignment of the older slices of st-cubes: [`Alignment`] on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Following {
    /// By the background's motion: the object's own motion remains.
    Background,
    /// By Algorithm 1 of the paper: the object is centred in every slice.
    Regressors,
    /// By the optical flow of the window.
    Flow,
}

impl From<Following> for Alignment {
    fn from(following: Following) -> Self {
        match following {
            Following::Background => Self::Background,
            Following::Regressors => Self::Regressors,
            Following::Flow => Self::Flow,
        }
    }
}

/// Command-line arguments of `lookout train`.
#[derive(Debug, Clone, clap::Args, serde::Serialize)]
pub struct TrainArgs {
    /// Folders of clips with ground truth, of equal weight
    #[arg(required_unless_present = "empty", value_name = "DATA")]
    pub data: Vec<PathBuf>,
    /// Footage of the user's own camera with nothing in the air: a video, or a folder of videos or of clips. All of it
    /// is background; objects cut out of DATA are pasted into a copy of it. Beside DATA or rendered flights: alone it shows
    /// nothing that must be found
    #[arg(long, value_name = "DIR", num_args = 1..)]
    pub empty: Vec<PathBuf>,
    /// Model file to write; a partial one beside it lets an interrupted run go on
    #[arg(long, value_name = "FILE")]
    #[serde(skip)]
    pub out: PathBuf,
    /// Write a model card (Markdown), or the generated part of the one that is there; without it no text is written
    #[arg(long, value_name = "FILE")]
    #[serde(skip)]
    pub card: Option<PathBuf>,
    /// Train even if OUT is a model of the same settings
    #[arg(long)]
    #[serde(skip)]
    pub again: bool,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Frames to train on, in each folder
    #[arg(long, default_value_t = 1800)]
    pub samples: usize,
    /// Only measure the calibration (precision by score) of this model again, on the clips held back from it
    #[arg(long, value_name = "MODEL")]
    #[serde(skip)]
    pub calibrate: Option<PathBuf>,
    /// With --calibrate: raise the scan's rejection thresholds by this, log-odds, from its ninth tree on. Faster; the scan
    /// keeps the best windows alone, which are all that are classified
    #[arg(long, value_name = "LOGODDS", requires = "calibrate", value_parser = margin)]
    #[serde(skip)]
    pub scan_margin: Option<f64>,
    /// Adapt this model: its classifier of st-cubes gets more trees from these clips, the rest stays. With another method,
    /// or other parts, than the model's: train the classifier and boxes on the scan and the shift regressors of this model
    #[arg(long, value_name = "MODEL")]
    pub from: Option<PathBuf>,
    /// Hold back every Nth clip of a folder for early stopping and calibration; 0: none
    #[arg(long, value_name = "N", default_value_t = 8)]
    pub hold_back: usize,
    /// Train on frames scaled to this size, for a smaller camera
    #[arg(long, value_name = "WxH")]
    pub frame: Option<FrameSize>,
    /// Keep older frames at half size and use cubes of the newest slice alone, for small boards
    #[arg(long)]
    pub half_history: bool,
    /// Levels of the pyramid for each doubling of the target's size
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u8).range(1..=4))]
    pub scales_per_octave: u8,
    /// Trees of the scan
    #[arg(long, default_value_t = 256)]
    pub scan_trees: usize,
    /// Depth of the scan's trees
    #[arg(long, default_value_t = 3)]
    pub scan_depth: u8,
    /// Take the scan's trees from this model of LightGBM (text form; objective=binary, max_depth=8), trained on the windows of
    /// `lookout mine --csv`; its rejection thresholds come from the clips
    #[arg(long, value_name = "MODEL.txt", value_parser = scan_text, conflicts_with_all = ["from", "calibrate"])]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scan_from: Option<ScanText>,
    /// Shrinkage of the scan's trees: with larger steps fewer trees reject a window, for small boards
    #[arg(long, default_value_t = 0.1)]
    pub scan_shrinkage: f64,
    /// Share of the held-back targets that the scan's rejection thresholds keep
    #[arg(long, default_value_t = 0.93)]
    pub scan_keep: f64,
    /// Rounds of mining hard negatives for the scan
    #[arg(long, default_value_t = 3)]
    pub mining: usize,
    /// Trees of each regressor, at most
    #[arg(long, default_value_t = 400)]
    pub regressor_trees: usize,
    /// Trees of the classifier of cubes, at most
    #[arg(long, default_value_t = 800)]
    pub cube_trees: usize,
    /// Trees that are added to the classifier of cubes of a model that is adapted, at most
    #[arg(long, default_value_t = 200)]
    pub adapt_trees: usize,
    /// Depth of the classifier's trees
    #[arg(long, default_value_t = 4)]
    pub cube_depth: u8,
    /// Loss of the classifier: gentle AdaBoost as in the paper, or logistic
    #[arg(long, value_enum, default_value_t = CubeLoss::Logistic)]
    pub cube_loss: CubeLoss,
    /// Size of the random feature pool for cubes
    #[arg(long, default_value_t = 2500)]
    pub features: usize,
    /// Candidates of each frame that cubes are cut for
    #[arg(long, default_value_t = 24)]
    pub candidates: usize,
    /// No augmentation: frames are not mirrored, scaled or changed in contrast
    #[arg(long)]
    pub plain: bool,
    /// Objects of other clips pasted into a copy of each clip whose camera's attitude is known (truth.csv, camera.json)
    #[arg(long, default_value_t = 0)]
    pub paste: usize,
    /// Rendered flights.
    #[command(flatten)]
    #[serde(flatten)]
    pub rendered: TrainRenderArgs,
    /// Method to train; the options below change it
    #[arg(long, value_enum, default_value_t)]
    pub method: MethodName,
    /// Alignment of the older slices of st-cubes
    #[arg(long, value_enum)]
    pub alignment: Option<Following>,
    /// Parts to leave out.
    #[command(flatten)]
    #[serde(flatten)]
    pub ablation: Ablation,
}

impl TrainArgs {
    /// The method with the changes that the arguments ask for.
    pub(super) fn recipe(&self) -> Result<Recipe, Error> {
        let name = self.method;
        let recipe = name.recipe().ok_or(TrainError::NothingToLearn { method: name })?;
        let alignment = self.alignment.map_or(recipe.method.alignment, Alignment::from);
        let scales_per_octave = self.scales_per_octave;
        let method = self.ablation.of(recipe.method);
        let history = if self.half_history { History::Half } else { method.history };
        let method = Method { alignment, scales_per_octave, history, ..method };
        // Without older slices there is nothing to see in them.
        let sees = if history.slices() == 1 { Sees::Newest } else { recipe.sees };
        let fit = recipe.fit && history == History::Full;
        Ok(Recipe { method, sees, fit, ..recipe })
    }

    /// The folder of the rendered flights.
    pub(super) fn flights(&self) -> PathBuf {
        self.out.with_extension("flights")
    }

    /// The same, with a number of clips to hold back that fits the clips there are, and in words where it is another one.
    ///
    /// # Errors
    /// [`Error`] of a folder without clips.
    pub(super) fn fitted(&self) -> Result<(Self, Option<&'static str>), Error> {
        let (hold_back, remark) = match self.hold_back {
            0 => (0, None),
            wanted => {
                let mut most = self.rendered.render;
                for (folder, kind) in listing::folders(self) {
                    if kind != listing::FolderRole::Rendered {
                        most = most.max(listing::clips(&folder, kind)?.len());
                    }
                }
                match most {
                    most if most >= wanted => (wanted, None),
                    2.. => (most, Some(FEWER)),
                    _ => (0, Some(NONE)),
                }
            }
        };
        Ok((Self { hold_back, ..self.clone() }, remark))
    }

    /// The stages of training, in their order.
    pub(super) fn stages(&self, recipe: &Recipe, adapts: bool) -> Vec<TrainingStage> {
        if adapts {
            return Vec::from([TrainingStage::Adaptation]);
        }
        // Without cubes or older slices there is nothing to compensate; without cubes, of their trees only those of the box.
        let mut stages = match (recipe.method.stcube, recipe.method.history) {
            (true, History::Full) => {
                Vec::from([TrainingStage::Scan, TrainingStage::Compensation, TrainingStage::Cubes])
            }
            (true, History::Half) => Vec::from([TrainingStage::Scan, TrainingStage::Cubes]),
            (false, _) => Vec::from([TrainingStage::Scan, TrainingStage::Boxes]),
        };
        stages.extend(recipe.fit.then_some(TrainingStage::Fits));
        stages
    }
}

/// A model of LightGBM; its checksum is part of the settings of a training.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct ScanText {
    /// Path of the file.
    pub path: PathBuf,
    /// CRC-32 of the text.
    checksum: u32,
    /// Contents of the file.
    #[serde(skip)]
    pub text: String,
}

fn scan_text(path: &str) -> Result<ScanText, String> {
    let text = std::fs::read_to_string(path).map_err(|error| format!("cannot read: {error}"))?;
    let checksum = crate::model::checksum(text.as_bytes());
    Ok(ScanText { path: path.into(), checksum, text })
}

/// A margin of rejection thresholds.
fn margin(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(margin) if (0.0..=8.0).contains(&margin) => Ok(margin),
        _ => Err("a number of log-odds, 0 to 8".into()),
    }
}

/// Remarks for folders with fewer clips than `--hold-back`.
const FEWER: &str = "no folder has as many clips as --hold-back says; the last clip of the largest folder is held back";
const NONE: &str = "a single clip: none can be held back, so no tree is left out again and the precision of scores \
                    stays unknown (no --min-precision); give a second clip to mend that";
