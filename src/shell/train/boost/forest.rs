//! Forests that a trainer owns, and the writer of their bytes.

use crate::trees::{Forest, NEVER_REJECT, Node};
use std::vec::Vec;

/// A tree that a trainer owns; see [`crate::trees`] for the order of nodes and leaves.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TrainedTree {
    pub(super) nodes: Vec<Node>,
    pub(super) leaves: Vec<i16>,
    pub(super) reject_threshold: i32,
}

impl TrainedTree {
    /// Inner nodes in heap order.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// Leaves from left to right.
    pub fn leaves(&self) -> &[i16] {
        &self.leaves
    }
}

/// A forest that a trainer owns. Read back from its bytes it gives the trainer's own scores.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TrainedForest {
    pub(super) depth: u8,
    pub(super) features: u16,
    pub(super) bias: i32,
    pub(super) trees: Vec<TrainedTree>,
}

impl From<Forest<'_>> for TrainedForest {
    fn from(forest: Forest<'_>) -> Self {
        let trees = forest.trees().map(|tree| TrainedTree {
            nodes: tree.nodes().collect(),
            leaves: tree.leaves().collect(),
            reject_threshold: tree.reject_threshold(),
        });
        Self {
            depth: forest.depth(),
            features: forest.features(),
            bias: forest.bias(),
            trees: trees.collect(),
        }
    }
}

impl TrainedForest {
    /// A forest of complete trees of this depth, each its nodes in heap order and its leaves; bias 0, nothing is rejected.
    /// `None` for more trees than a forest holds.
    pub fn of_trees(depth: u8, features: u16, trees: Vec<(Vec<Node>, Vec<i16>)>) -> Option<Self> {
        if trees.len() > super::MAX_TREES {
            return None;
        }
        let tree = |(nodes, leaves)| TrainedTree { nodes, leaves, reject_threshold: NEVER_REJECT };
        Some(Self { depth, features, bias: 0, trees: trees.into_iter().map(tree).collect() })
    }

    /// The score after each tree of a row; `above` is whether a feature's value is above a threshold.
    pub fn running_score(&self, above: impl Fn(u16, u16) -> bool) -> Vec<i32> {
        let mut score = self.bias;
        let after = |tree: &TrainedTree| {
            let mut place = 1;
            while let Some(node) = tree.nodes.get(place - 1) {
                place = 2 * place + usize::from(above(node.feature, node.threshold));
            }
            let leaf = tree.leaves.get(place - 1 - tree.nodes.len()).copied();
            score += i32::from(leaf.unwrap_or_default());
            score
        };
        self.trees.iter().map(after).collect()
    }

    /// The trees in the order in which they were boosted.
    pub fn trees(&self) -> &[TrainedTree] {
        &self.trees
    }

    /// The bytes that [`Forest::parse`] reads.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        bytes.extend((self.trees.len() as u16).to_le_bytes());
        bytes.extend([self.depth, 0]);
        bytes.extend(self.bias.to_le_bytes());
        bytes.extend(self.features.to_le_bytes());
        bytes.extend([0, 0]);
        for tree in &self.trees {
            bytes.extend(tree.reject_threshold.to_le_bytes());
            for node in &tree.nodes {
                bytes.extend(node.feature.to_le_bytes());
                bytes.extend(node.threshold.to_le_bytes());
            }
            bytes.extend(tree.leaves.iter().flat_map(|leaf| leaf.to_le_bytes()));
        }
        debug_assert!(Forest::parse(&bytes).is_ok());
        bytes
    }

    /// The thresholds that the trees compare each of `features` features with, ascending.
    pub fn thresholds(&self, features: usize) -> Vec<Vec<u16>> {
        let mut thresholds = std::vec![Vec::new(); features];
        let nodes = self.trees.iter().flat_map(|tree| &tree.nodes);
        for node in nodes.filter(|node| **node != Node::LEFT) {
            if let Some(of) = thresholds.get_mut(usize::from(node.feature)) {
                of.push(node.threshold);
            }
        }
        for of in &mut thresholds {
            of.sort_unstable();
            of.dedup();
        }
        thresholds
    }

    /// The rejection thresholds of the trees.
    pub fn reject_thresholds(&self) -> Vec<i32> {
        self.trees.iter().map(|tree| tree.reject_threshold).collect()
    }

    /// Keeps the first `trees` trees only.
    pub fn truncate(&mut self, trees: usize) {
        self.trees.truncate(trees);
    }

    /// Sets the reject threshold of the first trees from `thresholds`, of any others to [`NEVER_REJECT`].
    pub fn set_reject_thresholds(&mut self, thresholds: &[i32]) {
        let thresholds = thresholds.iter().copied().chain(std::iter::repeat(NEVER_REJECT));
        for (tree, threshold) in self.trees.iter_mut().zip(thresholds) {
            tree.reject_threshold = threshold;
        }
    }

    /// Raises the reject thresholds from the ninth tree on, where there are any; the first trees have seen too little.
    pub fn raise_reject_thresholds(&mut self, by: i32) {
        for tree in self.trees.iter_mut().skip(8).filter(|t| t.reject_threshold != NEVER_REJECT) {
            tree.reject_threshold = tree.reject_threshold.saturating_add(by);
        }
    }

    /// Renumbers every feature that is used to `number(old)`, below `features`.
    pub fn renumber(&mut self, number: impl Fn(u16) -> u16, features: u16) {
        for node in self.trees.iter_mut().flat_map(|tree| &mut tree.nodes) {
            node.feature = if *node == Node::LEFT { 0 } else { number(node.feature) };
        }
        self.features = features;
    }

    /// Renumbers the features so that only those used remain; returns the old id of each new one, ascending.
    pub fn compact(&mut self) -> Vec<u16> {
        let nodes = self.trees.iter().flat_map(|tree| &tree.nodes);
        // Nodes that no value passes may name any feature: they keep none alive.
        let mut used: Vec<u16> =
            nodes.filter(|node| **node != Node::LEFT).map(|node| node.feature).collect();
        used.sort_unstable();
        used.dedup();
        if used.is_empty() {
            used.push(0);
        }
        for node in self.trees.iter_mut().flat_map(|tree| &mut tree.nodes) {
            node.feature = match *node {
                Node::LEFT => 0,
                _ => used.partition_point(|&id| id < node.feature) as u16,
            };
        }
        self.features = used.len() as u16;
        used
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec;

    prop_compose! {
        fn forest()(depth in 1..=3u8)(
            depth in Just(depth),
            bias in -1000..1000i32,
            trees in prop::collection::vec((
                prop::collection::vec((0..40u16, 0..99u16), (1 << depth) - 1),
                prop::collection::vec(any::<i16>(), 1 << depth),
                any::<i32>(),
            ), 0..5),
        ) -> TrainedForest {
            let trees = trees.into_iter().map(|(nodes, leaves, reject_threshold)| TrainedTree {
                nodes: nodes.into_iter().map(|(feature, threshold)| {
                    if threshold == 0 { Node::LEFT } else { Node { feature, threshold } }
                }).collect(),
                leaves,
                reject_threshold,
            });
            TrainedForest { depth, features: 40, bias, trees: trees.collect() }
        }
    }

    proptest! {
        #[test]
        fn bytes_and_back(forest in forest()) {
            let bytes = forest.encode();
            let thresholds = forest.thresholds(40);
            for node in forest.trees.iter().flat_map(|tree| &tree.nodes) {
                let known = thresholds[usize::from(node.feature)].contains(&node.threshold);
                prop_assert!(known || *node == Node::LEFT);
            }
            let (view, rest) = Forest::parse(&bytes).unwrap();
            prop_assert!(rest.is_empty());
            prop_assert_eq!(TrainedForest::from(view), forest);
        }

        #[test]
        fn compacting_changes_no_score(forest in forest(), values in prop::collection::vec(0..99u16, 40)) {
            let (wide, mut small) = (forest.encode(), forest);
            let kept = small.compact();
            let narrow = small.encode();
            let score = |bytes, value: &dyn Fn(u16) -> u16| {
                Forest::parse(bytes).unwrap().0.score(|feature, threshold| value(feature) > threshold)
            };
            prop_assert_eq!(
                score(&wide, &|feature| values[usize::from(feature)]),
                score(&narrow, &|feature| values[usize::from(kept[usize::from(feature)])])
            );
        }
    }

    #[test]
    fn missing_thresholds_never_reject() {
        let tree = TrainedTree { nodes: vec![Node::LEFT], leaves: vec![1, 1], reject_threshold: 5 };
        let mut forest =
            TrainedForest { depth: 1, features: 1, bias: 0, trees: vec![tree.clone(), tree] };
        forest.set_reject_thresholds(&[-3]);
        let thresholds: Vec<i32> =
            forest.trees().iter().map(|tree| tree.reject_threshold).collect();
        assert_eq!(thresholds, [-3, NEVER_REJECT]);
    }

    #[test]
    fn thresholds_are_raised_behind_the_first_trees() {
        let tree = TrainedTree { nodes: vec![Node::LEFT], leaves: vec![1, 1], reject_threshold: 5 };
        let mut forest = TrainedForest { depth: 1, features: 1, bias: 0, trees: vec![tree; 11] };
        forest.set_reject_thresholds(&[[7; 8].as_slice(), &[7, i32::MAX]].concat());
        forest.raise_reject_thresholds(3);
        let raised = [[7; 8].as_slice(), &[10, i32::MAX, NEVER_REJECT]].concat();
        assert_eq!(forest.reject_thresholds(), raised);
    }
}
