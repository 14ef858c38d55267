//! Every instruction set against the forest's own walk.

use super::prepared::FEATURES;
use super::*;
use crate::channels::window::WINDOW;
use crate::scan::aggregate::MAP_CHANNELS;
use crate::trees::{Forest, Node, encode};
use proptest::prelude::*;
use std::vec;
use std::vec::Vec;

/// Reject threshold, nodes, leaves.
type Tree = (i32, Vec<Node>, Vec<i16>);

fn tree(leaf: i16) -> impl Strategy<Value = Tree> {
    let node = (0..FEATURES as u16, prop_oneof![0..256u16, Just(u16::MAX)])
        .prop_map(|(feature, threshold)| Node { feature, threshold });
    let nodes = prop::collection::vec(node, 7);
    let reject = prop_oneof![6 => -90..40i32, 1 => Just(crate::trees::NEVER_REJECT)];
    (reject, nodes, prop::collection::vec(-leaf..leaf, 8))
}

/// Column, row and score of all windows that are not rejected.
type Found = Vec<(usize, usize, i32)>;

fn naive(forest: &Forest<'_>, windows: &Windows<'_>) -> Found {
    let mut found = vec![];
    for row in 0..windows.count.1 {
        for column in 0..windows.count.0 {
            let window = windows.from(column, row);
            let test = |feature: u16, threshold: u16| {
                is_above(window[offset(feature, windows.width)], threshold)
            };
            found.extend(forest.cascade(test).map(|score| (column, row, score)));
        }
    }
    found
}

fn every_way(forest: &Forest<'_>, windows: &Windows<'_>) -> Result<(), TestCaseError> {
    let want = naive(forest, windows);
    for lanes in Lanes::available() {
        let cascade = Cascade::new(lanes, forest, windows.width).unwrap();
        let mut found = vec![];
        cascade.scan(windows, |column, row, score| found.push((column, row, score)));
        prop_assert_eq!(&found, &want, "{:?}", lanes);
    }
    Ok(())
}

/// Bytes of a map of `width` x `height` cells, and the windows in it.
fn bytes(width: usize, height: usize, seed: &[u8]) -> Vec<u8> {
    seed.iter().copied().cycle().take(width * height * MAP_CHANNELS).collect()
}

fn windows(bytes: &[u8], width: usize, height: usize) -> Windows<'_> {
    let count = ((width + 1).saturating_sub(WINDOW), (height + 1).saturating_sub(WINDOW));
    Windows { bytes, width, count }
}

proptest! {
    #[test]
    fn every_instruction_set_finds_the_same(
        width in 8..110usize, height in 8..15usize, bias in -40..100i32,
        trees in prop::collection::vec(tree(100), 0..9), seed in prop::collection::vec(any::<u8>(), 4001),
    ) {
        let file = encode(3, bias, FEATURES as u16, &trees);
        let bytes = bytes(width, height, &seed);
        every_way(&Forest::parse(&file).unwrap().0, &windows(&bytes, width, height))?;
    }

    #[test]
    fn trees_behind_the_prepared_ones_count(
        trees in prop::collection::vec(tree(9), 7), seed in prop::collection::vec(any::<u8>(), 4001), count in 250..270usize,
    ) {
        let trees: Vec<Tree> = trees.into_iter().map(|(_, nodes, leaves)| (-150, nodes, leaves)).cycle().take(count).collect();
        let file = encode(3, 30, FEATURES as u16, &trees);
        let bytes = bytes(70, 11, &seed);
        every_way(&Forest::parse(&file).unwrap().0, &windows(&bytes, 70, 11))?;
    }
}

#[test]
fn other_forests_are_not_prepared() {
    let forest = |depth: u8, bias: i32, leaf: i16, reject: i32| {
        let (nodes, leaves) = (vec![Node::LEFT; (1 << depth) - 1], vec![leaf; 1 << depth]);
        encode(depth, bias, FEATURES as u16, &vec![(reject, nodes, leaves); 4])
    };
    for (file, fits) in [
        (forest(3, 0, 8191, i32::MIN), true),
        (forest(3, 4, 8191, i32::MIN), false),
        (forest(3, 0, -8192, 32767), true),
        (forest(3, -1, -8192, 0), false),
        (forest(3, 32768, 0, 0), false),
        (forest(3, 0, 0, 32768), false),
        (forest(2, 0, 1, 0), false),
        (forest(4, 0, 1, 0), false),
    ] {
        let (forest, _) = Forest::parse(&file).unwrap();
        for lanes in Lanes::available() {
            let taken = Cascade::new(lanes, &forest, 40).is_some();
            assert_eq!(taken, fits, "{forest:?}");
        }
    }
}

#[test]
fn the_fastest_comes_first() {
    assert_eq!(Lanes::available().next(), Some(Lanes::fastest()));
    assert_eq!(Lanes::available().last(), Some(Lanes::Scalar));
}
