//! The methods that are compared, each as the parts of the detector that it has and those that it lacks.
//!
//! The paper's competitors (its table 1 and section 4.4), as far as they are combinations of one detector's parts: the same
//! frames, boxes, negatives, trees, box regressors and non-maximum suppression. [`Recipe`] alone holds the differences.

use crate::channels::history::History;
use crate::model::Method;
use crate::scan::aggregate::MAP_CHANNELS;
use crate::stcube::compensation::Alignment;
use core::fmt;

/// A method by its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum MethodName {
    /// The shipped detector
    #[default]
    Ours,
    /// The paper's method alone: Algorithm 1, no registration, no temporal differences
    Paper,
    /// St-cubes without motion compensation
    Stcube,
    /// St-cubes along the Lucas-Kanade flow of their windows
    StcubeFlow,
    /// Stabilised frames, temporal differences beside gradients, sliding window (Park et al. 2013)
    Park,
    /// Aggregate channel features of a single frame, soft cascade (Dollar et al. 2014)
    Acf,
    /// Random forest on the HoG of a window of a single frame
    Forest,
    /// 3-D HoG of the uncompensated cube (Weinland et al. 2010)
    Hog3d,
    /// Thresholded frame difference after registration, blobs; nothing is learned
    Difference,
}

impl fmt::Display for MethodName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ours => "ours",
            Self::Paper => "paper",
            Self::Stcube => "stcube",
            Self::StcubeFlow => "stcube-flow",
            Self::Park => "park",
            Self::Acf => "acf",
            Self::Forest => "forest",
            Self::Hog3d => "hog3d",
            Self::Difference => "difference",
        })
    }
}

/// Training of the trees over windows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Learner {
    /// One after the other, each on what the ones before got wrong.
    Boosting,
    /// Each for itself on rows drawn at random: a random forest.
    Bagging,
}

/// Slices that the features of a cube may use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sees {
    /// Boxes of all slices, and the way Algorithm 1 took.
    Cube,
    /// Boxes of the newest slice.
    Newest,
    /// The cells of a regular grid over all slices: a 3-D HoG.
    Grid,
}

/// A method: the parts that are trained, and their features.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Recipe {
    /// The parts that training and detector share.
    pub method: Method,
    /// Training of the trees over windows.
    pub windows: Learner,
    /// Channels of the scan's map that these trees may ask, from the first one on (see [`crate::scan::aggregate::strips`]).
    pub map_channels: usize,
    /// Slices that the features of classifier and box regressors may use.
    pub sees: Sees,
    /// Whether boxes are fitted by windows that are stretched to them: no part of the paper or of what it compares.
    pub fit: bool,
}

/// Orientations of the map: a HoG, each cell against its surroundings.
const HOG: usize = 6;

/// All of the map but the temporal differences.
const APPEARANCE: usize = 10;

/// Everything on, as in the detector.
const OURS: Recipe = Recipe {
    method: Method {
        registration: true,
        temporal: true,
        alignment: Alignment::Background,
        stcube: true,
        persistence: true,
        scales_per_octave: 2,
        history: History::Full,
    },
    windows: Learner::Boosting,
    map_channels: MAP_CHANNELS,
    sees: Sees::Cube,
    fit: true,
};

/// St-cubes of frames as they are, each frame for itself.
const PURE: Recipe = Recipe {
    method: Method { registration: false, temporal: false, persistence: false, ..OURS.method },
    map_channels: APPEARANCE,
    fit: false,
    ..OURS
};

/// A sliding window over a single frame, without cubes.
const SINGLE: Recipe =
    Recipe { method: Method { stcube: false, ..PURE.method }, sees: Sees::Newest, ..PURE };

const fn aligned(recipe: Recipe, alignment: Alignment) -> Recipe {
    Recipe { method: Method { alignment, ..recipe.method }, ..recipe }
}

impl MethodName {
    /// Its training recipe; `None` for a method that learns nothing.
    pub const fn recipe(self) -> Option<Recipe> {
        Some(match self {
            Self::Ours => OURS,
            Self::Paper => aligned(PURE, Alignment::Regressors),
            Self::Stcube => PURE,
            Self::StcubeFlow => aligned(PURE, Alignment::Flow),
            Self::Park => Recipe {
                method: Method { registration: true, temporal: true, ..SINGLE.method },
                map_channels: MAP_CHANNELS,
                ..SINGLE
            },
            Self::Acf => SINGLE,
            Self::Forest => Recipe { windows: Learner::Bagging, map_channels: HOG, ..SINGLE },
            // The differences between frames left where they are, which the cubes alone see: the third component of
            // the gradient.
            Self::Hog3d => Recipe {
                method: Method { temporal: true, ..PURE.method },
                sees: Sees::Grid,
                ..PURE
            },
            Self::Difference => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::ValueEnum;
    use std::string::ToString;
    use std::vec::Vec;

    #[test]
    fn names_are_those_of_the_command_line() {
        for method in MethodName::value_variants() {
            let name = method.to_possible_value().unwrap().get_name().to_string();
            assert_eq!(method.to_string(), name);
            assert_eq!(serde_json::to_value(method).unwrap(), name);
        }
    }

    #[test]
    fn no_two_methods_are_the_same() {
        let recipes: Vec<_> = MethodName::value_variants().iter().map(|m| m.recipe()).collect();
        for (i, recipe) in recipes.iter().enumerate() {
            assert!(!recipes[..i].contains(recipe), "{recipe:?}");
        }
    }

    #[test]
    fn single_frames_see_nothing_older() {
        for method in [MethodName::Acf, MethodName::Forest] {
            let recipe = method.recipe().unwrap();
            assert!(!recipe.method.temporal && !recipe.method.persistence);
            assert_eq!((recipe.method.stcube, recipe.sees), (false, Sees::Newest));
        }
    }
}
