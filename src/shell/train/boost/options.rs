//! Parameters of boosting.

use super::{BoostError, Loss, MAX_TREES};
use crate::trees::MAX_DEPTH;

/// Parameters of boosting.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Loss that boosting minimises.
    pub loss: Loss,
    /// Trees, at most [`MAX_TREES`].
    pub rounds: usize,
    /// Depth of each tree, 1 to [`MAX_DEPTH`].
    pub depth: u8,
    /// Part of each Newton step to take, above 0.
    pub shrinkage: f64,
    /// Integer score of 1.0. A leaf is at most 32767 in size: choose the scale so that a step fits.
    pub leaf_scale: f64,
    /// Added to each hessian sum, in rows of weight 1; for [`Loss::Exponential`] of mean boosting weight.
    pub lambda: f64,
    /// Least hessian sum of a child, in the same units.
    pub min_hessian: f64,
    /// Least rows of a child.
    pub min_rows: u32,
    /// Least gain of a split, GL² / (HL + λ) + GR² / (HR + λ) - G² / (H + λ).
    pub min_gain: f64,
    /// Share of the features that each tree may use, above 0 to 1.
    pub feature_fraction: f64,
    /// Share of the rows that each tree learns from, above 0 to 1.
    pub row_fraction: f64,
    /// Share of the hessian sum whose smallest rows a tree leaves out (weight trimming), 0 to below 1.
    pub trim: f64,
    /// Rounds without a better validation loss before boosting ends; 0 never ends it early.
    pub patience: usize,
    /// Seed of the features and rows drawn.
    pub seed: u64,
}

impl Options {
    /// Usual values for `loss`; scores of 1.0 are 256 (Q8).
    pub const fn new(loss: Loss) -> Self {
        Self {
            loss,
            rounds: 256,
            depth: 3,
            shrinkage: 0.1,
            leaf_scale: 256.0,
            lambda: 1.0,
            min_hessian: 1.0,
            min_rows: 5,
            min_gain: 0.0,
            feature_fraction: 1.0,
            row_fraction: 1.0,
            trim: 0.0,
            patience: 0,
            seed: 1,
        }
    }

    pub(super) fn check(&self) -> Result<(), BoostError> {
        let positive = |value: f64| value > 0.0 && value.is_finite();
        let share = |value: f64| value > 0.0 && value <= 1.0;
        let not_negative = |value: f64| value >= 0.0 && value.is_finite();
        let checks = [
            ("rounds", self.rounds <= MAX_TREES),
            ("depth", (1..=MAX_DEPTH).contains(&self.depth)),
            ("shrinkage", positive(self.shrinkage)),
            ("leaf_scale", positive(self.leaf_scale)),
            ("lambda", not_negative(self.lambda)),
            ("min_hessian", not_negative(self.min_hessian)),
            ("min_gain", not_negative(self.min_gain)),
            ("feature_fraction", share(self.feature_fraction)),
            ("row_fraction", share(self.row_fraction)),
            ("trim", not_negative(self.trim) && self.trim < 1.0),
        ];
        match checks.iter().find(|(_, good)| !good) {
            Some((field, _)) => Err(BoostError::Option { field }),
            None => Ok(()),
        }
    }
}
