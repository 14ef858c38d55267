//! Boosted decision trees evaluated where their bytes lie.
//!
//! Every tree is a complete binary tree of the same depth, so that evaluation takes `depth` steps for any bytes and cannot
//! fail. Features are the caller's: `test(feature, threshold)` is whether the feature's value is above the threshold.
//!
//! # Bytes
//! Little-endian, without padding; a multiple of 4 bytes long.
//!
//! | part | bytes |
//! | --- | --- |
//! | header | trees `u16`, depth `u8` (1 to 8), zero `u8`, bias `i32`, features `u16`, zero `u16` |
//! | each tree, `6 << depth` bytes | reject threshold `i32`, then `(1 << depth) - 1` nodes {feature `u16`, threshold `u16`}, then `1 << depth` leaves `i16` |
//!
//! Nodes are in heap order. Counted from one, node `i` has the children `2 i` (answer no) and `2 i + 1` (yes);
//! the reject threshold takes slot 0, so that slot and node have the same number. A child number of `1 << depth`
//! and above is a leaf.
//!
//! # Scores
//! The score is the bias plus one leaf of each tree, in the trainer's units. It fits in `i32` at every tree:
//! [`Forest::parse`] refuses a bias that leaves no room for the largest and smallest leaves of all trees
//! (65535 · 32768 < 2³¹, so that a bias of zero always fits).

use core::fmt;

/// Bytes of the header.
const HEADER: usize = 12;

/// Largest depth of a tree.
pub const MAX_DEPTH: u8 = 8;

/// The reject threshold of a tree after which nothing is rejected.
pub const NEVER_REJECT: i32 = i32::MIN;

/// Why bytes are not a [`Forest`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ForestError {
    /// There are fewer bytes than the trees need.
    TooShort {
        /// Bytes needed.
        needed: usize,
        /// Bytes given.
        given: usize,
    },
    /// The depth is not 1 to [`MAX_DEPTH`].
    Depth {
        /// The depth found.
        depth: u8,
    },
    /// A reserved field is not zero: the bytes are of another version.
    Reserved {
        /// Place of the field in the forest.
        offset: usize,
    },
    /// The bias and this many trees could add up to more than an `i32` holds.
    Bias {
        /// The bias found.
        bias: i32,
        /// Number of trees.
        trees: u16,
    },
    /// A node tests a feature that does not exist.
    Feature {
        /// The tree, counted from 0.
        tree: usize,
        /// The node in heap order, counted from 0.
        node: usize,
        /// The feature found.
        feature: u16,
        /// Features that exist.
        features: u16,
    },
}

impl fmt::Display for ForestError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TooShort { needed, given } => {
                write!(f, "the trees need {needed} bytes, {given} were given")
            }
            Self::Depth { depth } => write!(f, "trees of depth {depth}, 1 to {MAX_DEPTH} can be"),
            Self::Reserved { offset } => write!(f, "the reserved byte {offset} is not zero"),
            Self::Bias { bias, trees } => {
                write!(f, "the score of {trees} trees from a bias of {bias} may overflow")
            }
            Self::Feature { tree, node, feature, features } => {
                write!(f, "tree {tree}, node {node}: feature {feature} of {features}")
            }
        }
    }
}

impl core::error::Error for ForestError {}

/// An inner node of a tree.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Node {
    /// Number of the feature that is tested.
    pub feature: u16,
    /// To the right if the feature's value is above this.
    pub threshold: u16,
}

impl Node {
    /// A node whose test is always false: evaluation continues to the left.
    pub const LEFT: Self = Self { feature: 0, threshold: u16::MAX };

    #[inline]
    fn from_bytes([f0, f1, t0, t1]: [u8; 4]) -> Self {
        Self { feature: u16::from_le_bytes([f0, f1]), threshold: u16::from_le_bytes([t0, t1]) }
    }
}

/// One tree of a [`Forest`].
#[derive(Debug, Clone, Copy)]
pub struct Tree<'m> {
    /// `1 << depth` slots: the reject threshold, then the nodes.
    slots: &'m [[u8; 4]],
    /// `1 << depth` leaves.
    leaves: &'m [[u8; 2]],
}

impl<'m> Tree<'m> {
    /// A tree in its `6 << depth` bytes.
    #[inline]
    fn new(bytes: &'m [u8]) -> Self {
        let (slots, leaves) = bytes.split_at(bytes.len() / 3 * 2);
        Self { slots: slots.as_chunks().0, leaves: leaves.as_chunks().0 }
    }

    /// Inner nodes in heap order.
    pub fn nodes(&self) -> impl ExactSizeIterator<Item = Node> + DoubleEndedIterator + use<'m> {
        self.slots[1..].iter().map(|&slot| Node::from_bytes(slot))
    }

    /// Leaves from left to right.
    pub fn leaves(&self) -> impl ExactSizeIterator<Item = i16> + use<'m> {
        self.leaves.iter().map(|&leaf| i16::from_le_bytes(leaf))
    }

    /// A score below this after the tree ends a [cascade](Forest::cascade); [`NEVER_REJECT`] for none.
    #[inline]
    pub fn reject_threshold(&self) -> i32 {
        i32::from_le_bytes(self.slots[0])
    }

    /// The leaf that the answers of `test(feature, threshold)` lead to.
    #[inline]
    pub fn leaf(&self, mut test: impl FnMut(u16, u16) -> bool) -> i16 {
        // From node 1, each step doubles the number: it passes the last slot after `depth` steps, at a leaf.
        let mut i = 1;
        while let Some(&slot) = self.slots.get(i) {
            let node = Node::from_bytes(slot);
            i = 2 * i + usize::from(test(node.feature, node.threshold));
        }
        i16::from_le_bytes(self.leaves[i - self.slots.len()])
    }
}

/// Checked boosted trees, a view of the bytes of a model.
#[derive(Debug, Clone, Copy)]
pub struct Forest<'m> {
    depth: u8,
    features: u16,
    bias: i32,
    trees: &'m [u8],
    /// Whether bias, sums after any number of trees and reject thresholds fit `i16`.
    narrow: bool,
}

impl<'m> Forest<'m> {
    /// Checks the forest at the start of `bytes` once; afterwards evaluation cannot fail. Gives the bytes behind it, too.
    ///
    /// # Errors
    /// [`ForestError`] with the place and the reason.
    pub fn parse(bytes: &'m [u8]) -> Result<(Self, &'m [u8]), ForestError> {
        let Some((header, body)) = bytes.split_first_chunk::<HEADER>() else {
            return Err(ForestError::TooShort { needed: HEADER, given: bytes.len() });
        };
        let [t0, t1, depth, r0, b0, b1, b2, b3, f0, f1, r1, r2] = *header;
        let trees = u16::from_le_bytes([t0, t1]);
        let bias = i32::from_le_bytes([b0, b1, b2, b3]);
        let features = u16::from_le_bytes([f0, f1]);
        if depth == 0 || depth > MAX_DEPTH {
            return Err(ForestError::Depth { depth });
        }
        for (offset, reserved) in [(3, r0), (10, r1), (11, r2)] {
            if reserved != 0 {
                return Err(ForestError::Reserved { offset });
            }
        }
        let bound = |leaf: i16| i64::from(bias) + i64::from(trees) * i64::from(leaf);
        if bound(i16::MIN) < i64::from(i32::MIN) || bound(i16::MAX) > i64::from(i32::MAX) {
            return Err(ForestError::Bias { bias, trees });
        }
        // At most 65535 · 6 · 256 bytes, about 100 MB: also on a 32 bit machine.
        let Some((trees, rest)) = body.split_at_checked(usize::from(trees) * (6 << depth)) else {
            let needed = HEADER + usize::from(trees) * (6 << depth);
            return Err(ForestError::TooShort { needed, given: bytes.len() });
        };
        let mut forest = Self { depth, features, bias, trees, narrow: false };
        forest.narrow = forest.is_narrow();
        for (tree, view) in forest.trees().enumerate() {
            for (node, Node { feature, .. }) in view.nodes().enumerate() {
                if feature >= features {
                    return Err(ForestError::Feature { tree, node, feature, features });
                }
            }
        }
        Ok((forest, rest))
    }

    /// Whether the score stays within `i16` whatever leaves are reached, and no window is rejected for being below more
    /// than that.
    fn is_narrow(&self) -> bool {
        let (mut least, mut most) = (i64::from(self.bias), i64::from(self.bias));
        let fits = |sum: i64| i16::try_from(sum).is_ok();
        fits(least)
            && self.trees().all(|tree| {
                least += i64::from(tree.leaves().min().unwrap_or(0));
                most += i64::from(tree.leaves().max().unwrap_or(0));
                fits(least) && fits(most) && tree.reject_threshold() <= i32::from(i16::MAX)
            })
    }

    /// Whether scores after any number of trees fit `i16`, and no reject threshold is above that.
    pub fn fits_i16(&self) -> bool {
        self.narrow
    }

    /// Steps from a root to a leaf, 1 to [`MAX_DEPTH`].
    pub fn depth(&self) -> u8 {
        self.depth
    }

    /// Features that nodes may ask for: all ids are below this.
    pub fn features(&self) -> u16 {
        self.features
    }

    /// The score before the first tree.
    pub fn bias(&self) -> i32 {
        self.bias
    }

    /// The trees in the order in which they were boosted.
    #[inline]
    pub fn trees(&self) -> impl ExactSizeIterator<Item = Tree<'m>> + use<'m> {
        self.trees.chunks_exact(6 << self.depth).map(Tree::new)
    }

    /// The bias plus the leaf of each tree that the answers of `test(feature, threshold)` lead to.
    #[inline]
    pub fn score(&self, mut test: impl FnMut(u16, u16) -> bool) -> i32 {
        self.trees().fold(self.bias, |score, tree| score + i32::from(tree.leaf(&mut test)))
    }

    /// As [`Forest::score`], but `None` as soon as the score after a tree is below the tree's reject threshold.
    ///
    /// The soft cascade of Bourdev and Brandt, CVPR 2005.
    #[inline]
    pub fn cascade(&self, test: impl FnMut(u16, u16) -> bool) -> Option<i32> {
        self.cascade_from(0, self.bias, test)
    }

    /// As [`Forest::cascade`], from tree `first` on, before which the score is `score`.
    #[inline]
    pub fn cascade_from(
        &self,
        first: usize,
        score: i32,
        mut test: impl FnMut(u16, u16) -> bool,
    ) -> Option<i32> {
        self.trees().skip(first).try_fold(score, |score, tree| {
            let score = score + i32::from(tree.leaf(&mut test));
            (score >= tree.reject_threshold()).then_some(score)
        })
    }
}

/// Bytes of a forest, for tests: of each tree the reject threshold, the nodes in heap order, the leaves.
#[cfg(test)]
pub(crate) fn encode(
    depth: u8,
    bias: i32,
    features: u16,
    trees: &[(i32, std::vec::Vec<Node>, std::vec::Vec<i16>)],
) -> std::vec::Vec<u8> {
    let mut bytes = std::vec::Vec::from((trees.len() as u16).to_le_bytes());
    bytes.extend([depth, 0]);
    bytes.extend(bias.to_le_bytes());
    bytes.extend(features.to_le_bytes());
    bytes.extend([0, 0]);
    for (reject, nodes, leaves) in trees {
        bytes.extend(reject.to_le_bytes());
        for node in nodes {
            bytes.extend(node.feature.to_le_bytes());
            bytes.extend(node.threshold.to_le_bytes());
        }
        bytes.extend(leaves.iter().flat_map(|leaf| leaf.to_le_bytes()));
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::boxed::Box;
    use std::vec;
    use std::vec::Vec;

    /// A tree with pointers, the way a textbook has it.
    #[derive(Debug, Clone)]
    enum Naive {
        Leaf(i16),
        Split(Node, Box<Self>, Box<Self>),
    }

    impl Naive {
        fn walk(&self, values: &[u16]) -> f64 {
            match self {
                Self::Leaf(leaf) => f64::from(*leaf),
                Self::Split(node, left, right) => {
                    let right_side = values[usize::from(node.feature)] > node.threshold;
                    if right_side { right.walk(values) } else { left.walk(values) }
                }
            }
        }

        /// Nodes level by level, then leaves from left to right.
        fn flatten(&self) -> (Vec<Node>, Vec<i16>) {
            let (mut nodes, mut leaves, mut level) = (vec![], vec![], vec![self]);
            while !level.is_empty() {
                let mut next = vec![];
                for tree in level {
                    match tree {
                        Self::Leaf(leaf) => leaves.push(*leaf),
                        Self::Split(node, left, right) => {
                            nodes.push(*node);
                            next.extend([&**left, &**right]);
                        }
                    }
                }
                level = next;
            }
            (nodes, leaves)
        }
    }

    const FEATURES: u16 = 5;

    fn encode(depth: u8, bias: i32, trees: &[(Naive, i32)]) -> Vec<u8> {
        let trees: Vec<_> = trees
            .iter()
            .map(|(tree, reject)| {
                let (nodes, leaves) = tree.flatten();
                (*reject, nodes, leaves)
            })
            .collect();
        super::encode(depth, bias, FEATURES, &trees)
    }

    fn tree(depth: u8) -> BoxedStrategy<Naive> {
        if depth == 0 {
            return any::<i16>().prop_map(Naive::Leaf).boxed();
        }
        (0..FEATURES, any::<u16>(), tree(depth - 1), tree(depth - 1))
            .prop_map(|(feature, threshold, left, right)| {
                Naive::Split(Node { feature, threshold }, Box::new(left), Box::new(right))
            })
            .boxed()
    }

    prop_compose! {
        fn forest()(depth in 1..=5u8)(
            depth in Just(depth),
            bias in -100_000..100_000i32,
            trees in prop::collection::vec((tree(depth), -60_000..40_000i32), 0..6),
        ) -> (u8, i32, Vec<(Naive, i32)>) {
            (depth, bias, trees)
        }
    }

    proptest! {
        #[test]
        fn agrees_with_pointers(
            (depth, bias, trees) in forest(),
            values in prop::collection::vec(any::<u16>(), usize::from(FEATURES)),
            tail in prop::collection::vec(any::<u8>(), 0..9),
        ) {
            let mut bytes = encode(depth, bias, &trees);
            bytes.extend(&tail);
            let (forest, rest) = Forest::parse(&bytes).unwrap();
            prop_assert_eq!(rest, &tail);
            prop_assert_eq!((forest.depth(), forest.bias()), (depth, bias));
            prop_assert_eq!(forest.trees().len(), trees.len());
            for (view, (naive, reject)) in forest.trees().zip(&trees) {
                prop_assert_eq!((view.nodes().collect(), view.leaves().collect()), naive.flatten());
                prop_assert_eq!(view.reject_threshold(), *reject);
            }
            let test = |feature, threshold| values[usize::from(feature)] > threshold;
            let mut score = f64::from(bias);
            let mut rejected = false;
            for (tree, reject) in &trees {
                score += tree.walk(&values);
                rejected |= score < f64::from(*reject);
            }
            prop_assert_eq!(f64::from(forest.score(test)), score);
            prop_assert_eq!(forest.cascade(test).map(f64::from), (!rejected).then_some(score));
        }

        #[test]
        fn every_truncation_is_refused((depth, bias, trees) in forest()) {
            let bytes = encode(depth, bias, &trees);
            for length in 0..bytes.len() {
                let error = Forest::parse(&bytes[..length]).unwrap_err();
                let needed = if length < HEADER { HEADER } else { bytes.len() };
                prop_assert_eq!(error, ForestError::TooShort { needed, given: length });
            }
        }

        #[test]
        fn any_bytes_are_refused_or_walk(
            mut bytes in prop::collection::vec(any::<u8>(), 0..200),
            depth in 0..4u8,
            features in any::<u16>(),
            answers in any::<u64>(),
        ) {
            // Half the way to a header, so that bodies are reached, too.
            if bytes.len() >= HEADER && depth > 0 {
                bytes[0] %= 8;
                bytes[1..4].copy_from_slice(&[0, depth, 0]);
                bytes[8..12].copy_from_slice(&[features as u8, (features >> 8) as u8, 0, 0]);
            }
            if let Ok((forest, _)) = Forest::parse(&bytes) {
                let mut asked = 0;
                let test = |feature: u16, _| {
                    assert!(feature < forest.features());
                    asked += 1;
                    answers >> (asked % 64) & 1 == 1
                };
                forest.score(test);
                prop_assert_eq!(asked, forest.trees().len() * usize::from(forest.depth()));
            }
        }
    }

    #[test]
    fn refusals_name_the_field() {
        let leaf = |v| Box::new(Naive::Leaf(v));
        let split = Naive::Split(Node { feature: 4, threshold: 7 }, leaf(-3), leaf(3));
        let good = encode(1, 0, &[(split.clone(), NEVER_REJECT), (split, NEVER_REJECT)]);
        let parse = |place: usize, byte: u8| {
            let mut bytes = good.clone();
            bytes[place] = byte;
            Forest::parse(&bytes).map(|_| ()).unwrap_err()
        };
        assert_eq!(parse(2, 0), ForestError::Depth { depth: 0 });
        assert_eq!(parse(2, 9), ForestError::Depth { depth: 9 });
        assert_eq!(parse(11, 1), ForestError::Reserved { offset: 11 });
        assert_eq!(
            parse(HEADER + 12 + 4, 5),
            ForestError::Feature { tree: 1, node: 0, feature: 5, features: 5 }
        );
        let mut bytes = good.clone();
        bytes[4..8].copy_from_slice(&(i32::MAX - 1000).to_le_bytes());
        let error = Forest::parse(&bytes).unwrap_err();
        assert_eq!(error, ForestError::Bias { bias: i32::MAX - 1000, trees: 2 });
    }

    #[test]
    fn the_largest_forest_does_not_overflow() {
        let leaf = || Box::new(Naive::Leaf(i16::MIN));
        let split = Naive::Split(Node::LEFT, leaf(), leaf());
        let bytes = encode(1, 0, &vec![(split, NEVER_REJECT); 65535]);
        let (forest, _) = Forest::parse(&bytes).unwrap();
        assert_eq!(forest.score(|_, _| true), -65535 * 32768);
        assert_eq!(forest.cascade(|_, _| true), Some(-65535 * 32768));
    }
}
