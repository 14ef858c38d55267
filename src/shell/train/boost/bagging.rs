//! Random forests (Breiman 2001).
//!
//! Each tree learns from a bootstrap sample of the rows, and each of its nodes chooses among a random subset of the
//! features. A leaf holds log-odds; the forest's score is the mean of its trees.

use super::grow::{BoostRow, Limits, grow};
use super::{
    BoostError, Data, Loss, MAX_TREES, SplitMix64, TrainedForest, TrainedTree, draw, node_of,
};
use crate::trees::{MAX_DEPTH, NEVER_REJECT};
use std::ops::ControlFlow;
use std::vec;
use std::vec::Vec;

/// Log-odds of a leaf count no more than this.
const SUREST: f64 = 8.0;

/// Parameters of a random forest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bagging {
    /// Trees, at most [`MAX_TREES`].
    pub trees: usize,
    /// Depth of each tree, 1 to [`MAX_DEPTH`].
    pub depth: u8,
    /// Least rows of a child.
    pub min_rows: u32,
    /// Share of the features that each tree may ask, above 0 to 1.
    pub tree_features: f64,
    /// Share of those that each node may ask, above 0 to 1.
    pub node_features: f64,
    /// Integer score of log-odds of 1.0.
    pub leaf_scale: f64,
    /// Seed of all that is drawn.
    pub seed: u64,
}

impl Bagging {
    fn check(&self) -> Result<(), BoostError> {
        let share = |value: f64| value > 0.0 && value <= 1.0;
        let checks = [
            ("trees", (1..=MAX_TREES).contains(&self.trees)),
            ("depth", (1..=MAX_DEPTH).contains(&self.depth)),
            ("tree_features", share(self.tree_features)),
            ("node_features", share(self.node_features)),
            ("leaf_scale", self.leaf_scale > 0.0 && self.leaf_scale.is_finite()),
        ];
        match checks.iter().find(|(_, valid)| !valid) {
            Some(&(field, _)) => Err(BoostError::Option { field }),
            None => Ok(()),
        }
    }

    /// Grows the forest from rows labelled -1 or 1; `tick` is called after each tree and may end it early.
    ///
    /// # Errors
    /// [`BoostError`] when options or data cannot be used.
    pub fn run(
        &self,
        data: Data<'_>,
        mut tick: impl FnMut() -> ControlFlow<()>,
    ) -> Result<TrainedForest, BoostError> {
        self.check()?;
        data.check(Loss::Logistic)?;
        let features = data.samples.features();
        let mut forest = TrainedForest { depth: self.depth, features, bias: 0, trees: vec![] };
        let used: Vec<usize> =
            (0..data.samples.rows()).filter(|&row| data.weights[row] > 0.0).collect();
        for number in 0..self.trees {
            forest.trees.push(self.tree(&data, &used, number as u64));
            if tick().is_break() {
                break;
            }
        }
        Ok(forest)
    }

    fn tree(&self, data: &Data<'_>, used: &[usize], number: u64) -> TrainedTree {
        let mut random = SplitMix64::of(self.seed, number);
        let mut drawn = vec![0u16; used.len()];
        for _ in used {
            let place = (random.next() % used.len() as u64) as usize;
            drawn[place] = drawn[place].saturating_add(1);
        }
        let rows: Vec<BoostRow> = used
            .iter()
            .zip(&drawn)
            .filter(|(_, times)| **times > 0)
            .map(|(&row, &times)| {
                let weight = data.weights[row] * f32::from(times);
                // Of the squared loss: splits are those of Gini's impurity, a leaf is the mean label.
                let gradient = -weight * data.targets[row];
                BoostRow { row: row as u32, gradient, hessian: weight }
            })
            .collect();
        let asked = draw(&mut random, data.samples.features(), self.tree_features);
        let limits = Limits {
            depth: self.depth,
            lambda: 1.0,
            min_hessian: 0.0,
            min_rows: self.min_rows,
            min_gain: 0.0,
            node_features: self.node_features,
            seed: random.next(),
        };
        let (splits, means) = grow(data.samples, &rows, &asked, limits);
        let unit = self.leaf_scale / self.trees as f64;
        let leaf = |mean: &f64| {
            let odds = ((1.0 + mean) / (1.0 - mean)).ln().clamp(-SUREST, SUREST);
            (odds * unit).round().clamp(f64::from(i16::MIN), f64::from(i16::MAX)) as i16
        };
        TrainedTree {
            nodes: splits.iter().map(|&split| node_of(data.samples, split)).collect(),
            leaves: means.iter().map(leaf).collect(),
            reject_threshold: NEVER_REJECT,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::BinnedSamples;
    use super::*;

    const BAGGING: Bagging = Bagging {
        trees: 60,
        depth: 6,
        min_rows: 2,
        tree_features: 1.0,
        node_features: 0.5,
        leaf_scale: 256.0,
        seed: 5,
    };

    /// Points of a square, 1 inside a disc, -1 outside, and features of pure noise.
    fn disc(seed: u64, rows: usize) -> (Vec<Vec<u16>>, Vec<f32>) {
        let mut random = SplitMix64::of(seed, 0);
        let columns: Vec<Vec<u16>> =
            (0..6).map(|_| (0..rows).map(|_| (random.next() % 200) as u16).collect()).collect();
        let inside = |row: usize| {
            let [x, y] = [0, 1].map(|c: usize| f64::from(columns[c][row]) - 100.0);
            if x * x + y * y < 80.0 * 80.0 { 1.0 } else { -1.0 }
        };
        let targets = (0..rows).map(inside).collect();
        (columns, targets)
    }

    fn go_on() -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    #[test]
    fn a_disc_is_learned_and_unseen_points_are_known() {
        let (columns, targets) = disc(1, 2000);
        let samples = BinnedSamples::from_columns(columns, 63).unwrap();
        let weights = vec![1.0; 2000];
        let data = Data { samples: &samples, targets: &targets, weights: &weights };
        let forest = BAGGING.run(data, go_on).unwrap();
        let (unseen, truth) = disc(2, 1000);
        let unseen = BinnedSamples::with_edges(samples.edges().to_vec(), 1000, unseen).unwrap();
        let rows: Vec<usize> = (0..1000).collect();
        let right = forest.running_scores(&unseen, &rows).unwrap();
        let right = right
            .iter()
            .zip(&truth)
            .filter(|(scores, truth)| (scores[scores.len() - 1] > 0) == (**truth > 0.0));
        // One feature alone gets about 0.7 of them right.
        assert!(right.count() > 920);
        assert_eq!(BAGGING.run(data, go_on).unwrap(), forest);
    }

    #[test]
    fn trees_are_not_alike_and_may_end_early() {
        let (columns, targets) = disc(1, 300);
        let samples = BinnedSamples::from_columns(columns, 63).unwrap();
        let mut weights = vec![1.0; 300];
        let data = Data { samples: &samples, targets: &targets, weights: &weights };
        let mut left = 3;
        let forest = BAGGING.run(data, || {
            left -= 1;
            if left == 0 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        let forest = forest.unwrap();
        assert_eq!(forest.trees().len(), 3);
        assert_ne!(forest.trees()[0].nodes, forest.trees()[1].nodes);
        let none = Bagging { trees: 0, ..BAGGING };
        assert_eq!(none.run(data, go_on), Err(BoostError::Option { field: "trees" }));
        weights.fill(0.0);
        let data = Data { samples: &samples, targets: &targets, weights: &weights };
        assert_eq!(BAGGING.run(data, go_on), Err(BoostError::NoWeight));
    }
}
