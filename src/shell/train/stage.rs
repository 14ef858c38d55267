//! The stages of training: titles, the forests that each adds to the model, shares of the time.

use crate::model::Section;

/// A stage of training.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TrainingStage {
    /// The soft cascade over windows, with rounds of hard negatives.
    Scan,
    /// The shift regressors of Algorithm 1.
    Compensation,
    /// The classifier of st-cubes and the boxes of windows.
    Cubes,
    /// The boxes of windows alone, for methods without st-cubes.
    Boxes,
    /// The fit of boxes to objects.
    Fits,
    /// More trees for the classifier of a model that is there.
    Adaptation,
}

impl TrainingStage {
    /// Name of the stage in progress and reports.
    pub const fn title(self) -> &'static str {
        match self {
            Self::Scan => "the scan, which proposes windows",
            Self::Compensation => "the regressors that follow an object through the frames",
            Self::Cubes => "the classifier of proposed windows, and their boxes",
            Self::Boxes => "the boxes of proposed windows",
            Self::Fits => "the fit of boxes to objects",
            Self::Adaptation => "more trees for the classifier of the model",
        }
    }

    /// The forests that it leaves in the model; with trees in the first, it is done.
    pub const fn forests(self) -> &'static [Section] {
        match self {
            Self::Scan => &[Section::Scan],
            Self::Compensation => &[Section::Horizontal],
            Self::Cubes | Self::Adaptation => &[Section::Cube],
            Self::Boxes => &[Section::BoxX],
            Self::Fits => &[Section::FitX],
        }
    }

    /// Share of a training's time, in percent: of the shipped model's.
    pub const fn share(self) -> u64 {
        match self {
            Self::Scan => 40,
            Self::Compensation => 6,
            Self::Cubes | Self::Boxes => 28,
            Self::Fits => 18,
            Self::Adaptation => 90,
        }
    }
}
