//! One regression tree by histograms: complete, level by level, second order.
//!
//! Gradients and hessians are rounded to integers, so that sums do not depend on their order: every number of
//! threads grows the same tree, and the histogram of a node minus that of one child is exactly that of the other.

use super::SplitMix64;
use super::samples::BinnedSamples;
#[cfg(feature = "rayon")]
use rayon::prelude::*;
use std::ops::{AddAssign, Range, Sub};
use std::vec;
use std::vec::Vec;

/// Limits of a tree.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    pub depth: u8,
    pub lambda: f64,
    pub min_hessian: f64,
    pub min_rows: u32,
    pub min_gain: f64,
    /// Share of the features that each node may use, drawn anew for it; 1 for all.
    pub node_features: f64,
    /// Seed of that draw.
    pub seed: u64,
}

impl Limits {
    /// Whether node `number` (in heap order) may use `feature`.
    fn may_ask(&self, number: usize, feature: u16) -> bool {
        let key = (number as u64) << 16 | u64::from(feature);
        SplitMix64::of(self.seed, key).chance(self.node_features)
    }
}

/// A row in training, with the derivatives of its loss.
#[derive(Debug, Clone, Copy)]
pub(super) struct BoostRow {
    pub row: u32,
    pub gradient: f32,
    pub hessian: f32,
}

/// "To the right if the bin of `feature` is above `cut`."
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Split {
    pub feature: u16,
    pub cut: u8,
}

impl Split {
    /// A split that no bin passes.
    pub const LEFT: Self = Self { feature: 0, cut: u8::MAX };
}

/// The number of the leaf that `row` reaches.
#[inline]
pub(super) fn leaf_of(splits: &[Split], samples: &BinnedSamples, row: usize) -> usize {
    let mut node = 0;
    while let Some(split) = splits.get(node) {
        let right = samples.column(split.feature)[row] > split.cut;
        node = 2 * node + 1 + usize::from(right);
    }
    node - splits.len()
}

/// Sums of integer derivatives; the hessian's word has the number of rows in its upper bits.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Sum {
    gradient: i64,
    hessian_rows: u64,
}

impl AddAssign for Sum {
    #[inline]
    fn add_assign(&mut self, other: Self) {
        self.gradient += other.gradient;
        self.hessian_rows += other.hessian_rows;
    }
}

impl Sub for Sum {
    type Output = Self;
    #[inline]
    fn sub(self, other: Self) -> Self {
        Self {
            gradient: self.gradient - other.gradient,
            hessian_rows: self.hessian_rows - other.hessian_rows,
        }
    }
}

/// Scale of real derivatives as integers, such that no sum overflows.
#[derive(Debug, Clone, Copy)]
struct Scale {
    gradient: f64,
    hessian: f64,
    /// Bits of a hessian sum; the number of rows is above them.
    shift: u32,
}

impl Scale {
    fn new(rows: &[BoostRow]) -> Self {
        let row_bits = (rows.len() as u64 + 1).next_power_of_two().ilog2().max(1);
        let largest = |value: fn(&BoostRow) -> f32| {
            let largest = rows.iter().map(value).fold(0.0, f32::max);
            if largest > 0.0 { f64::from(largest) } else { 1.0 }
        };
        let bits = |bits: u32| f64::from((1u32 << bits) - 1);
        Self {
            gradient: bits(30) / largest(|row| row.gradient.abs()),
            hessian: bits((64 - 2 * row_bits).min(30)) / largest(|row| row.hessian),
            shift: 64 - row_bits,
        }
    }

    fn pair(&self, row: &BoostRow) -> (i32, u32) {
        (
            (f64::from(row.gradient) * self.gradient).round() as i32,
            (f64::from(row.hessian) * self.hessian).round() as u32,
        )
    }

    #[inline]
    fn sum(&self, (gradient, hessian): (i32, u32)) -> Sum {
        Sum { gradient: i64::from(gradient), hessian_rows: u64::from(hessian) | 1 << self.shift }
    }

    fn rows(&self, sum: Sum) -> u64 {
        sum.hessian_rows >> self.shift
    }

    fn gradient(&self, sum: Sum) -> f64 {
        sum.gradient as f64 / self.gradient
    }

    fn hessian(&self, sum: Sum) -> f64 {
        (sum.hessian_rows & ((1 << self.shift) - 1)) as f64 / self.hessian
    }
}

/// A node of the newest level: its rows, and whether it may be split.
#[derive(Debug, Clone)]
struct OpenNode {
    rows: Range<usize>,
    sum: Sum,
    alive: bool,
}

/// The best split of a node.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Best {
    gain: f64,
    split: Split,
    left: Sum,
}

/// A tree in the making.
struct Grower<'a> {
    samples: &'a BinnedSamples,
    limits: Limits,
    scale: Scale,
    /// Row numbers and derivatives, the rows of each open node together, in rising order.
    rows: Vec<u32>,
    pairs: Vec<(i32, u32)>,
    open: Vec<OpenNode>,
}

/// Column of a feature: its histograms for the nodes of the newest level.
struct Column {
    feature: u16,
    histograms: Vec<Sum>,
    best: Vec<Option<Best>>,
}

impl Grower<'_> {
    fn histogram(&self, column: &[u8], rows: Range<usize>) -> [Sum; 256] {
        let mut histogram = [Sum::default(); 256];
        for (&row, &pair) in self.rows[rows.clone()].iter().zip(&self.pairs[rows]) {
            histogram[usize::from(column[row as usize])] += self.scale.sum(pair);
        }
        histogram
    }

    /// Brings a feature's histograms to the newest level and finds its best split of each node.
    fn search(&self, column: &mut Column) {
        let bins = self.samples.column(column.feature);
        let width = self.samples.edges()[usize::from(column.feature)].len() + 1;
        if self.open.len() == 1 {
            column.histograms = self.histogram(bins, self.open[0].rows.clone())[..width].to_vec();
        } else {
            let parents = std::mem::take(&mut column.histograms);
            let mut children = vec![Sum::default(); self.open.len() * width];
            for ((parent, children), open) in parents
                .chunks_exact(width)
                .zip(children.chunks_exact_mut(2 * width))
                .zip(self.open.chunks_exact(2))
            {
                if open.iter().any(|node| node.alive) {
                    let (left, right) = children.split_at_mut(width);
                    let (small, small_node, large) = if open[0].rows.len() <= open[1].rows.len() {
                        (left, &open[0], right)
                    } else {
                        (right, &open[1], left)
                    };
                    let histogram = self.histogram(bins, small_node.rows.clone());
                    small.copy_from_slice(&histogram[..width]);
                    for ((large, &parent), &small) in large.iter_mut().zip(parent).zip(&*small) {
                        *large = parent - small;
                    }
                }
            }
            column.histograms = children;
        }
        let nodes = self.open.iter().zip(column.histograms.chunks_exact(width));
        // The nodes of a level are as many as all above them, and one more.
        let above = self.open.len() - 1;
        let best = nodes.enumerate().map(|(i, (node, sums))| {
            let asks = self.limits.may_ask(above + i, column.feature);
            if asks { self.best(column.feature, node, sums) } else { None }
        });
        column.best = best.collect();
    }

    /// The best split of a node by one feature, given its histogram.
    fn best(&self, feature: u16, node: &OpenNode, histogram: &[Sum]) -> Option<Best> {
        if !node.alive {
            return None;
        }
        let before = self.worth(node.sum);
        // Rounding alone must not look like a gain.
        let least = self.limits.min_gain.max(before * 1e-9);
        let (mut left, mut best) = (Sum::default(), None::<Best>);
        for (cut, &sum) in histogram[..histogram.len() - 1].iter().enumerate() {
            if sum == Sum::default() {
                continue;
            }
            left += sum;
            let sides = [left, node.sum - left];
            let wide = |&side: &Sum| {
                self.scale.rows(side) >= u64::from(self.limits.min_rows.max(1))
                    && self.scale.hessian(side) >= self.limits.min_hessian
            };
            let gain = sides.map(|side| self.worth(side)).iter().sum::<f64>() - before;
            if gain > best.map_or(least, |best| best.gain) && sides.iter().all(wide) {
                let split = Split { feature, cut: cut as u8 };
                best = Some(Best { gain, split, left });
            }
        }
        best
    }

    /// Twice the fall of the loss by the best constant: G² / (H + λ).
    fn worth(&self, sum: Sum) -> f64 {
        let (gradient, hessian) = (self.scale.gradient(sum), self.scale.hessian(sum));
        if sum.gradient == 0 { 0.0 } else { gradient * gradient / (hessian + self.limits.lambda) }
    }

    /// The constant of least loss: -G / (H + λ).
    fn value(&self, sum: Sum) -> f64 {
        if sum.gradient == 0 {
            return 0.0;
        }
        let value = -self.scale.gradient(sum) / (self.scale.hessian(sum) + self.limits.lambda);
        if value.is_finite() { value } else { 0.0 }
    }

    /// Replaces each open node by its two children.
    fn split(&mut self, splits: &[Option<Best>]) {
        let mut right = Vec::new();
        let mut children = Vec::with_capacity(2 * self.open.len());
        for (node, split) in self.open.iter().zip(splits) {
            let Some(Best { split, left, .. }) = split else {
                // Both children have the node's value, and the left one has its rows.
                for rows in [node.rows.clone(), node.rows.end..node.rows.end] {
                    children.push(OpenNode { rows, sum: node.sum, alive: false });
                }
                continue;
            };
            let column = self.samples.column(split.feature);
            let mut middle = node.rows.start;
            right.clear();
            for i in node.rows.clone() {
                let (row, pair) = (self.rows[i], self.pairs[i]);
                if column[row as usize] > split.cut {
                    right.push((row, pair));
                } else {
                    (self.rows[middle], self.pairs[middle]) = (row, pair);
                    middle += 1;
                }
            }
            for (i, &(row, pair)) in (middle..).zip(&right) {
                (self.rows[i], self.pairs[i]) = (row, pair);
            }
            let ends = [node.rows.start..middle, middle..node.rows.end];
            for (rows, sum) in ends.into_iter().zip([*left, node.sum - *left]) {
                children.push(OpenNode { rows, sum, alive: true });
            }
        }
        self.open = children;
    }
}

/// Grows a tree on `rows` (rising row numbers, hessians not negative) with `features` only.
///
/// Gives the splits in heap order and each leaf's Newton step.
pub(super) fn grow(
    samples: &BinnedSamples,
    rows: &[BoostRow],
    features: &[u16],
    limits: Limits,
) -> (Vec<Split>, Vec<f64>) {
    let scale = Scale::new(rows);
    let pairs: Vec<(i32, u32)> = rows.iter().map(|row| scale.pair(row)).collect();
    let mut sum = Sum::default();
    for &pair in &pairs {
        sum += scale.sum(pair);
    }
    let mut grower = Grower {
        samples,
        limits,
        scale,
        rows: rows.iter().map(|row| row.row).collect(),
        pairs,
        open: vec![OpenNode { rows: 0..rows.len(), sum, alive: true }],
    };
    let mut columns: Vec<Column> = features
        .iter()
        .filter(|&&feature| !samples.edges()[usize::from(feature)].is_empty())
        .map(|&feature| Column { feature, histograms: vec![], best: vec![] })
        .collect();
    let mut splits = Vec::new();
    for _ in 0..limits.depth {
        #[cfg(feature = "rayon")]
        columns.par_iter_mut().for_each(|column| grower.search(column));
        #[cfg(not(feature = "rayon"))]
        columns.iter_mut().for_each(|column| grower.search(column));
        let mut level: Vec<Option<Best>> = vec![None; grower.open.len()];
        for column in &columns {
            for (best, candidate) in level.iter_mut().zip(&column.best) {
                // Of equal gains the first feature's: the order of threads does not matter.
                if let Some(candidate) = candidate
                    && best.is_none_or(|best| candidate.gain > best.gain)
                {
                    *best = Some(*candidate);
                }
            }
        }
        splits.extend(level.iter().map(|best| best.map_or(Split::LEFT, |best| best.split)));
        grower.split(&level);
    }
    let leaves = grower.open.iter().map(|leaf| grower.value(leaf.sum)).collect();
    (splits, leaves)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Loss of the best constants on either side of every split, by the definition.
    fn brute_force(samples: &BinnedSamples, rows: &[BoostRow], limits: Limits) -> f64 {
        let worth = |side: &dyn Fn(&BoostRow) -> bool| {
            let (mut g, mut h, mut n) = (0.0, 0.0, 0);
            for row in rows.iter().filter(|row| side(row)) {
                g += f64::from(row.gradient);
                h += f64::from(row.hessian);
                n += 1;
            }
            let allowed = n >= limits.min_rows && h >= limits.min_hessian;
            if allowed { g * g / (h + limits.lambda) } else { f64::NEG_INFINITY }
        };
        let mut best = f64::NEG_INFINITY;
        for feature in 0..samples.features() {
            for cut in 0..samples.edges()[usize::from(feature)].len() {
                let right =
                    |row: &BoostRow| usize::from(samples.column(feature)[row.row as usize]) > cut;
                best = best.max(worth(&right) + worth(&|row| !right(row)));
            }
        }
        best - worth(&|_| true)
    }

    prop_compose! {
        fn case()(rows in 8..60usize)(
            columns in prop::collection::vec(prop::collection::vec(0..12u16, rows), 1..5),
            derivatives in prop::collection::vec((-3.0..3.0f32, 0.1..2.0f32), rows),
        ) -> (BinnedSamples, Vec<BoostRow>) {
            let rows = (0..).zip(derivatives);
            let rows = rows.map(|(row, (gradient, hessian))| BoostRow { row, gradient, hessian });
            (BinnedSamples::from_columns(columns, 64).unwrap(), rows.collect())
        }
    }

    const LIMITS: Limits = Limits {
        depth: 1,
        lambda: 0.5,
        min_hessian: 1.5,
        min_rows: 2,
        min_gain: 0.0,
        node_features: 1.0,
        seed: 0,
    };

    proptest! {
        #[test]
        fn first_split_is_the_best_of_all((samples, rows) in case()) {
            let features: Vec<u16> = (0..samples.features()).collect();
            let (splits, leaves) = grow(&samples, &rows, &features, LIMITS);
            let expected = brute_force(&samples, &rows, LIMITS);
            let sides = [0, 1].map(|leaf| rows.iter()
                .filter(|row| leaf_of(&splits, &samples, row.row as usize) == leaf)
                .fold((0.0, 0.0), |(g, h), row| (g + f64::from(row.gradient), h + f64::from(row.hessian))));
            if splits[0] == Split::LEFT {
                prop_assert!(expected < 1e-6, "a gain of {expected} was missed");
                prop_assert_eq!(leaves[0], leaves[1]);
            } else {
                let worth = |g: f64, h: f64| g * g / (h + LIMITS.lambda);
                let [l, r] = sides;
                let gain = worth(l.0, l.1) + worth(r.0, r.1) - worth(l.0 + r.0, l.1 + r.1);
                prop_assert!((gain - expected).abs() < 1e-5, "{gain} {expected}");
                for (leaf, (g, h)) in leaves.iter().zip(sides) {
                    prop_assert!((leaf + g / (h + LIMITS.lambda)).abs() < 1e-5);
                }
            }
        }

        #[test]
        fn deeper_levels_split_the_rows_of_their_node((samples, rows) in case()) {
            let features: Vec<u16> = (0..samples.features()).collect();
            let (splits, leaves) = grow(&samples, &rows, &features, Limits { depth: 3, ..LIMITS });
            prop_assert_eq!((splits.len(), leaves.len()), (7, 8));
            // Each subtree is the tree grown on its rows alone.
            for (side, inner, half) in [(0, [1, 3, 4], 0..4), (1, [2, 5, 6], 4..8)] {
                let part: Vec<BoostRow> = rows.iter().copied()
                    .filter(|row| leaf_of(&splits[..1], &samples, row.row as usize) == side)
                    .collect();
                if splits[0] == Split::LEFT || part.is_empty() {
                    continue;
                }
                let (own, values) = grow(&samples, &part, &features, Limits { depth: 2, ..LIMITS });
                prop_assert_eq!(own, inner.map(|node| splits[node]));
                for (own, whole) in values.iter().zip(&leaves[half]) {
                    prop_assert!((own - whole).abs() < 1e-5);
                }
            }
        }
    }
}
