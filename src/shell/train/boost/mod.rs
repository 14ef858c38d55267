//! Gradient boosting of the forests that [`crate::trees`] evaluates.
//!
//! Newton boosting on histograms (Friedman, Hastie and Tibshirani 2000; Friedman 2001; Chen and Guestrin 2016).
//! Leaves are rounded to the core's integers round by round, and boosting goes on from the rounded scores: the
//! trainer's score of a row is the score that the core computes from the encoded bytes. Training is
//! deterministic, whatever the number of threads, and can be resumed from its forest alone.

mod bagging;
mod forest;
mod grow;
mod loss;
mod options;
mod reject;
mod samples;

pub use bagging::Bagging;
pub use forest::{TrainedForest, TrainedTree};
pub use loss::Loss;
pub use options::Options;
pub use reject::reject_thresholds;
pub use samples::{BinnedSamples, MAX_EDGES, SamplesError, bin, edges};

use crate::trees::{NEVER_REJECT, Node};
use grow::{BoostRow, Limits, Split, grow, leaf_of};
use std::ops::ControlFlow;
use std::vec;
use std::vec::Vec;

/// Most trees of a forest: with a bias of at most 2^30 no score overflows.
pub const MAX_TREES: usize = 32767;

/// Why boosting cannot start.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BoostError {
    /// An option is out of its range.
    #[error("option {field} is out of its range")]
    Option {
        /// The field of [`Options`].
        field: &'static str,
    },
    /// There is not one target and one weight for each row, or there is no feature.
    #[error("{rows} rows of {features} features, {targets} targets, {weights} weights")]
    Shape {
        /// Rows of the samples.
        rows: usize,
        /// Features of the samples.
        features: u16,
        /// Targets given.
        targets: usize,
        /// Weights given.
        weights: usize,
    },
    /// A target is not finite, or not -1 or 1 where labels are needed.
    #[error("row {row}: target {target} cannot be learnt with this loss")]
    Target {
        /// Number of the row, from 0.
        row: usize,
        /// Target of the row.
        target: f32,
    },
    /// A weight is negative or not finite.
    #[error("row {row}: weight {weight}")]
    Weight {
        /// Number of the row, from 0.
        row: usize,
        /// Weight of the row.
        weight: f32,
    },
    /// No row has a weight above 0.
    #[error("no row has a weight above 0")]
    NoWeight,
    /// Validation samples have other bins than the training samples.
    #[error("the validation samples do not share the edges of the training samples")]
    OtherEdges,
    /// A forest to resume from was not trained on bins of these edges.
    #[error("tree {tree}, node {node} does not fit the samples: other features or edges")]
    Forest {
        /// The tree, counted from 0.
        tree: usize,
        /// The node in heap order, counted from 0.
        node: usize,
    },
    /// A forest to resume from has another depth than the options.
    #[error("the forest's trees have depth {depth}, the options another")]
    Depth {
        /// Depth of the forest.
        depth: u8,
    },
}

/// Samples with their targets of learning and weights. A row of weight 0 takes no part, so that one set of samples can serve
/// for training and validation.
#[derive(Debug, Clone, Copy)]
pub struct Data<'a> {
    /// Feature values of the rows, binned.
    pub samples: &'a BinnedSamples,
    /// The response of each row, or its label, -1 or 1.
    pub targets: &'a [f32],
    /// The weight of each row, 0 or more.
    pub weights: &'a [f32],
}

impl Data<'_> {
    fn check(&self, loss: Loss) -> Result<(), BoostError> {
        let (rows, features) = (self.samples.rows(), self.samples.features());
        let (targets, weights) = (self.targets.len(), self.weights.len());
        if features == 0 || targets != rows || weights != rows {
            return Err(BoostError::Shape { rows, features, targets, weights });
        }
        if let Some(row) = self.targets.iter().position(|&target| !loss.takes(target)) {
            return Err(BoostError::Target { row, target: self.targets[row] });
        }
        if let Some(row) = self.weights.iter().position(|w| !(0.0..=f32::MAX).contains(w)) {
            return Err(BoostError::Weight { row, weight: self.weights[row] });
        }
        if !self.weights.iter().any(|&weight| weight > 0.0) {
            return Err(BoostError::NoWeight);
        }
        Ok(())
    }
}

/// Data, and the integer scores of their rows by the trees grown until now.
#[derive(Debug, Clone)]
struct ScoredRows<'a> {
    data: Data<'a>,
    scores: Vec<i32>,
}

impl ScoredRows<'_> {
    fn add(&mut self, splits: &[Split], leaves: &[i16]) {
        for (row, score) in self.scores.iter_mut().enumerate() {
            *score += i32::from(leaves[leaf_of(splits, self.data.samples, row)]);
        }
    }

    /// Mean loss of the rows by their weights.
    fn loss(&self, options: &Options) -> f64 {
        let (mut sum, mut weights) = (0.0, 0.0);
        for ((&score, &target), &weight) in
            self.scores.iter().zip(self.data.targets).zip(self.data.weights)
        {
            if weight > 0.0 {
                let score = f64::from(score) / options.leaf_scale;
                sum += f64::from(weight) * options.loss.value(f64::from(target), score);
                weights += f64::from(weight);
            }
        }
        sum / weights
    }
}

/// Result of a round.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Round {
    /// Trees grown until now.
    pub trees: usize,
    /// Mean loss of the training rows.
    pub train_loss: f64,
    /// Mean loss of the validation rows.
    pub validation_loss: Option<f64>,
}

/// State of boosting: scores of all rows, and the trees grown until now.
#[derive(Debug, Clone)]
pub struct Booster<'a> {
    options: Options,
    train: ScoredRows<'a>,
    validation: Option<ScoredRows<'a>>,
    forest: TrainedForest,
    last: Round,
    best: Round,
}

impl<'a> Booster<'a> {
    /// Starts with no tree and the best constant score.
    ///
    /// # Errors
    /// [`BoostError`] when options or data cannot be used.
    pub fn new(
        options: Options,
        train: Data<'a>,
        validation: Option<Data<'a>>,
    ) -> Result<Self, BoostError> {
        options.check()?;
        for data in [Some(train), validation].into_iter().flatten() {
            data.check(options.loss)?;
        }
        let bound = f64::from(1 << 30);
        let bias = options.loss.constant(train.targets, train.weights) * options.leaf_scale;
        let bias = bias.round().clamp(-bound, bound) as i32;
        let features = train.samples.features();
        let forest = TrainedForest { depth: options.depth, features, bias, trees: vec![] };
        Self::start(options, train, validation, forest)
    }

    /// Goes on from a forest that an earlier booster made with the same edges; with the same options and data,
    /// what follows is what would have followed there. Rounds before count towards the options' rounds.
    ///
    /// # Errors
    /// [`BoostError`] when options, data or forest cannot be used.
    pub fn resume(
        options: Options,
        train: Data<'a>,
        validation: Option<Data<'a>>,
        forest: &TrainedForest,
    ) -> Result<Self, BoostError> {
        options.check()?;
        for data in [Some(train), validation].into_iter().flatten() {
            data.check(options.loss)?;
        }
        if forest.depth != options.depth {
            return Err(BoostError::Depth { depth: forest.depth });
        }
        let empty =
            TrainedForest { features: train.samples.features(), trees: vec![], ..forest.clone() };
        let mut booster = Self::start(options, train, validation, empty)?;
        for (number, tree) in forest.trees.iter().enumerate() {
            let mut splits = Vec::with_capacity(tree.nodes.len());
            for (place, &node) in tree.nodes.iter().enumerate() {
                let split = split_at(train.samples, node);
                splits.push(split.ok_or(BoostError::Forest { tree: number, node: place })?);
            }
            booster.push(&splits, tree.clone());
        }
        Ok(booster)
    }

    fn start(
        options: Options,
        train: Data<'a>,
        validation: Option<Data<'a>>,
        forest: TrainedForest,
    ) -> Result<Self, BoostError> {
        if validation.is_some_and(|data| data.samples.edges() != train.samples.edges()) {
            return Err(BoostError::OtherEdges);
        }
        let scored =
            |data: Data<'a>| ScoredRows { data, scores: vec![forest.bias; data.samples.rows()] };
        let (train, validation) = (scored(train), validation.map(scored));
        let last = Round {
            trees: 0,
            train_loss: train.loss(&options),
            validation_loss: validation.as_ref().map(|data| data.loss(&options)),
        };
        Ok(Self { options, train, validation, forest, last, best: last })
    }

    /// Marks the present forest as the best: [`Booster::run`] leaves out none of its trees.
    pub fn keep(&mut self) {
        self.best = self.last;
    }

    /// Boosts until the options' rounds are done, patience ends, or `report` breaks. Keeps the trees up to the
    /// best validation loss, all without validation; gives the round kept.
    pub fn run(
        mut self,
        mut report: impl FnMut(&Round) -> ControlFlow<()>,
    ) -> (TrainedForest, Round) {
        while !self.ended() && report(&self.round()).is_continue() {}
        self.forest.truncate(self.best.trees);
        (self.forest, self.best)
    }

    /// Whether the options' rounds or patience are at their end.
    pub fn ended(&self) -> bool {
        let waited = self.last.trees - self.best.trees;
        self.last.trees >= self.options.rounds
            || (self.options.patience > 0 && waited >= self.options.patience)
    }

    /// Adds one tree; past [`MAX_TREES`] nothing.
    pub fn round(&mut self) -> Round {
        if self.forest.trees.len() < MAX_TREES {
            self.grow();
        }
        self.last
    }

    fn grow(&mut self) {
        let options = &self.options;
        let mut random = SplitMix64::of(options.seed, self.forest.trees.len() as u64);
        let features = draw(&mut random, self.forest.features, options.feature_fraction);
        let rows = self.rows(&mut random);
        let limits = Limits {
            depth: options.depth,
            lambda: options.lambda,
            min_hessian: options.min_hessian,
            min_rows: options.min_rows,
            min_gain: options.min_gain,
            node_features: 1.0,
            seed: 0,
        };
        let samples = self.train.data.samples;
        let (splits, steps) = grow(samples, &rows, &features, limits);
        let (low, high) = (f64::from(i16::MIN), f64::from(i16::MAX));
        let quantised = |step: &f64| {
            (step * options.shrinkage * options.leaf_scale).round().clamp(low, high) as i16
        };
        let tree = TrainedTree {
            nodes: splits.iter().map(|&split| node_of(samples, split)).collect(),
            leaves: steps.iter().map(quantised).collect(),
            reject_threshold: NEVER_REJECT,
        };
        self.push(&splits, tree);
    }

    /// The rows of the next tree, with their derivatives.
    fn rows(&self, random: &mut SplitMix64) -> Vec<BoostRow> {
        let ScoredRows { data, scores } = &self.train;
        // Exponential weights shrink from round to round; relative to their mean they stay comparable with λ.
        let unit = if self.options.loss == Loss::Exponential { self.last.train_loss } else { 1.0 };
        let mut rows = Vec::new();
        for (row, &score) in scores.iter().enumerate() {
            let weight = f64::from(data.weights[row]);
            if weight > 0.0 && random.chance(self.options.row_fraction) {
                let score = f64::from(score) / self.options.leaf_scale;
                let (gradient, hessian) =
                    self.options.loss.derivatives(f64::from(data.targets[row]), score);
                let [gradient, hessian] = [gradient, hessian].map(|v| (v * weight / unit) as f32);
                rows.push(BoostRow { row: row as u32, gradient, hessian });
            }
        }
        if self.options.trim > 0.0 {
            let mut hessians: Vec<f32> = rows.iter().map(|row| row.hessian).collect();
            hessians.sort_unstable_by(f32::total_cmp);
            let mut left = hessians.iter().map(|&h| f64::from(h)).sum::<f64>() * self.options.trim;
            let least = hessians.iter().find(|&&hessian| {
                left -= f64::from(hessian);
                left < 0.0
            });
            if let Some(&least) = least {
                rows.retain(|row| row.hessian >= least);
            }
        }
        rows
    }

    fn push(&mut self, splits: &[Split], tree: TrainedTree) {
        for data in std::iter::once(&mut self.train).chain(&mut self.validation) {
            data.add(splits, &tree.leaves);
        }
        self.forest.trees.push(tree);
        self.last = Round {
            trees: self.forest.trees.len(),
            train_loss: self.train.loss(&self.options),
            validation_loss: self.validation.as_ref().map(|data| data.loss(&self.options)),
        };
        let better = match (self.last.validation_loss, self.best.validation_loss) {
            (Some(last), Some(best)) => last < best,
            _ => true,
        };
        if better {
            self.best = self.last;
        }
    }

    /// Trees grown until now.
    pub fn forest(&self) -> &TrainedForest {
        &self.forest
    }

    /// Integer score of each training row by the trees grown until now, as the core computes it.
    pub fn scores(&self) -> &[i32] {
        &self.train.scores
    }

    /// Round of the least validation loss; without validation the last one.
    pub fn best(&self) -> Round {
        self.best
    }
}

impl TrainedForest {
    /// The score after each tree of some rows of samples that share the edges of training.
    ///
    /// # Errors
    /// [`BoostError::Forest`] when a node fits no edge.
    ///
    /// # Panics
    /// If there is no such row.
    pub fn running_scores(
        &self,
        samples: &BinnedSamples,
        rows: &[usize],
    ) -> Result<Vec<Vec<i32>>, BoostError> {
        let mut running = vec![Vec::with_capacity(self.trees.len()); rows.len()];
        for (number, tree) in self.trees.iter().enumerate() {
            let splits: Result<Vec<Split>, BoostError> = (tree.nodes.iter().enumerate())
                .map(|(place, &node)| {
                    split_at(samples, node).ok_or(BoostError::Forest { tree: number, node: place })
                })
                .collect();
            let splits = splits?;
            for (&row, scores) in rows.iter().zip(&mut running) {
                let before = scores.last().copied().unwrap_or(self.bias);
                scores.push(before + i32::from(tree.leaves[leaf_of(&splits, samples, row)]));
            }
        }
        Ok(running)
    }
}

/// A split as feature and threshold.
fn node_of(samples: &BinnedSamples, split: Split) -> Node {
    if split == Split::LEFT {
        return Node::LEFT;
    }
    let threshold = samples.edges()[usize::from(split.feature)][usize::from(split.cut)];
    Node { feature: split.feature, threshold }
}

/// A node as a split of bins, if its threshold is one of the edges.
fn split_at(samples: &BinnedSamples, node: Node) -> Option<Split> {
    if node == Node::LEFT {
        return Some(Split::LEFT);
    }
    let edges = samples.edges().get(usize::from(node.feature))?;
    let cut = edges.binary_search(&node.threshold).ok()?;
    Some(Split { feature: node.feature, cut: cut as u8 })
}

/// A share of the features, at least one, in rising order.
fn draw(random: &mut SplitMix64, features: u16, fraction: f64) -> Vec<u16> {
    let mut ids: Vec<u16> = (0..features).collect();
    let wanted = ((f64::from(features) * fraction).ceil() as usize).clamp(1, ids.len());
    if wanted < ids.len() {
        for place in 0..wanted {
            let other = place + (random.next() % (ids.len() - place) as u64) as usize;
            ids.swap(place, other);
        }
        ids.truncate(wanted);
        ids.sort_unstable();
    }
    ids
}

/// A small generator of random numbers (Steele, Lea and Flood, OOPSLA 2014).
#[derive(Debug, Clone)]
struct SplitMix64(u64);

impl SplitMix64 {
    /// One stream for each round of a seed, so that a resumed training draws what it would have drawn.
    fn of(seed: u64, round: u64) -> Self {
        Self(Self(seed).next() ^ Self(!round).next())
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn chance(&mut self, share: f64) -> bool {
        share >= 1.0 || ((self.next() >> 11) as f64) < share * (1u64 << 53) as f64
    }
}

#[cfg(test)]
mod tests;
