//! The scan in front of the st-cubes: a soft cascade over every window of every level.
//!
//! Each weak learner is a small tree over single values of the level's map (Dollar et al. 2014, aggregate channel
//! features), with a rejection threshold after each tree (Bourdev & Brandt 2005). Map and thresholds are bytes.

use crate::channels::window::PADDING;
use crate::channels::window::WINDOW;
use crate::scan::aggregate::{MAP_CHANNELS, MapStrip};
use crate::scan::lanes::{self, Cascade, Windows};
use crate::trees::Forest;

pub use crate::scan::lanes::{FEATURES, Lanes};

/// A window that the scan kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Candidate {
    /// Number of the level.
    pub level: u8,
    /// Left edge in cells of the level.
    pub x: i16,
    /// Upper edge in cells of the level.
    pub y: i16,
    /// Score of the cascade.
    pub score: i32,
}

/// The map of a level, or rows of it, as the scan reads it.
#[derive(Debug, Clone, Copy)]
pub struct Map<'a> {
    windows: Windows<'a>,
    /// Number of the first row, counted from the first row of padding.
    top: usize,
}

impl<'a> Map<'a> {
    /// Rows of the map of a level of `columns` cells in a row.
    pub fn new(strip: MapStrip<'a>, columns: usize) -> Self {
        let width = columns + 2 * PADDING;
        let MapStrip { top, bytes } = strip;
        let rows = bytes.len() / (width * MAP_CHANNELS);
        let count = ((width + 1).saturating_sub(WINDOW), (rows + 1).saturating_sub(WINDOW));
        Self { windows: Windows { bytes, width, count }, top }
    }

    /// Positions of windows in a row and in a column; of a whole map the first of each is [`PADDING`] cells outside the
    /// picture.
    pub fn windows(&self) -> (usize, usize) {
        self.windows.count
    }

    /// Values of all features of the window at (x, y) in cells of the level; cells count from the picture's corner,
    /// windows may hang over by [`PADDING`]. Panics if the window is not one of the scan's.
    pub fn values(&self, x: i16, y: i16) -> [u8; FEATURES] {
        let place = |v: i16| (i32::from(v) + PADDING as i32) as usize;
        let window = self.windows.from(place(x), place(y) - self.top);
        core::array::from_fn(|i| window[lanes::offset(i as u16, self.windows.width)] ^ 128)
    }

    fn candidate(&self, level: u8, column: usize, row: usize, score: i32) -> Candidate {
        let place = |v: usize| v as i16 - PADDING as i16;
        Candidate { level, x: place(column), y: place(self.top + row), score }
    }

    /// Runs `cascade` over every `step`th window across and down, from the first one of the whole map on; `found` gets
    /// each window that it does not reject. Gives the number of windows. Panics if `step` is 0.
    #[inline(never)]
    pub fn scan(
        &self,
        level: u8,
        cascade: &Forest<'_>,
        step: usize,
        mut found: impl FnMut(Candidate),
    ) -> u32 {
        let mut windows = 0;
        for (column, row) in self.places(step) {
            windows += 1;
            if let Some(score) = cascade.cascade(self.test(column, row)) {
                found(self.candidate(level, column, row, score));
            }
        }
        windows
    }

    /// Every `step`th window across and down, from the first one of the whole map on.
    fn places(&self, step: usize) -> impl Iterator<Item = (usize, usize)> + use<> {
        let (columns, rows) = self.windows.count;
        let first = self.top.next_multiple_of(step) - self.top;
        let across = move |row| (0..columns).step_by(step).map(move |column| (column, row));
        (first..rows).step_by(step).flat_map(across)
    }

    /// Whether a feature of a window is above a threshold.
    #[inline(always)]
    fn test(&self, column: usize, row: usize) -> impl Fn(u16, u16) -> bool + use<'a> {
        let (window, width) = (self.windows.from(column, row), self.windows.width);
        move |feature, threshold| lanes::is_above(window[lanes::offset(feature, width)], threshold)
    }

    /// Tests of nodes that [`Map::scan`] makes, and windows.
    pub fn count_tests(&self, cascade: &Forest<'_>, step: usize) -> (u64, u64) {
        let (mut tests, mut windows) = (0, 0);
        for (column, row) in self.places(step) {
            windows += 1;
            let test = self.test(column, row);
            let _ = cascade.cascade(|feature, threshold| {
                tests += 1;
                test(feature, threshold)
            });
        }
        (tests, windows)
    }

    /// As [`Map::scan`] with trees that are prepared for the map; where every window is looked at, many at once.
    #[inline(never)]
    pub fn scan_prepared(
        &self,
        level: u8,
        cascade: &Cascade<'_>,
        step: usize,
        mut found: impl FnMut(Candidate),
    ) -> u32 {
        let mut keep = |column, row, score| found(self.candidate(level, column, row, score));
        if step == 1 {
            cascade.scan(&self.windows, keep);
            return (self.windows.count.0 * self.windows.count.1) as u32;
        }
        let mut windows = 0;
        for (column, row) in self.places(step) {
            windows += 1;
            if let Some(score) = cascade.window(&self.windows, column, row) {
                keep(column, row, score);
            }
        }
        windows
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trees::{Node, encode};
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    /// Reject threshold, nodes, leaves.
    type Tree = (i32, Vec<Node>, Vec<i16>);

    fn tree() -> impl Strategy<Value = Tree> {
        let node = (0..FEATURES as u16, 0..256u16)
            .prop_map(|(feature, threshold)| Node { feature, threshold });
        let nodes = prop::collection::vec(node, 3);
        (-90..60i32, nodes, prop::collection::vec(-100..100i16, 4))
    }

    proptest! {
        #[test]
        fn agrees_with_a_walk_over_windows(
            columns in 1..13usize, rows in 1..11usize, first in 0..9usize, step in 1..4usize, bias in -40..100i32,
            trees in prop::collection::vec(tree(), 0..5),
            seed in prop::collection::vec(any::<u8>(), 4000),
        ) {
            let (width, height) = (columns + 2 * PADDING, rows + 2 * PADDING);
            let bytes: Vec<u8> = seed.into_iter().cycle().take(width * height * MAP_CHANNELS).collect();
            let map = Map::new(MapStrip { top: first, bytes: &bytes }, columns);
            let file = encode(2, bias, FEATURES as u16, &trees);
            let (forest, _) = Forest::parse(&file).unwrap();
            let (mut naive, mut windows) = (vec![], 0);
            for top in 0..height {
                for left in 0..width {
                    let inside = left + WINDOW <= width && top + WINDOW <= height;
                    if !inside || left % step > 0 || (first + top) % step > 0 {
                        continue;
                    }
                    windows += 1;
                    let (x, y) = (left as i16 - PADDING as i16, (first + top) as i16 - PADDING as i16);
                    let values = map.values(x, y);
                    let (mut score, mut rejected) = (bias, false);
                    for (reject, nodes, leaves) in &trees {
                        let above = |n: usize| {
                            let feature = usize::from(nodes[n].feature);
                            let (row, rest) = (feature / (WINDOW * MAP_CHANNELS), feature % (WINDOW * MAP_CHANNELS));
                            let (column, channel) = (rest / MAP_CHANNELS, rest % MAP_CHANNELS);
                            let plane = (top + row) * MAP_CHANNELS + channel;
                            let value = bytes[plane * width + left + column] ^ 128;
                            assert_eq!(values[feature], value);
                            u16::from(value) > nodes[n].threshold
                        };
                        let leaf = match (above(0), above(1), above(2)) {
                            (false, second, _) => usize::from(second),
                            (true, _, third) => 2 + usize::from(third),
                        };
                        score += i32::from(leaves[leaf]);
                        rejected |= score < *reject;
                    }
                    if !rejected {
                        naive.push(Candidate { level: 3, x, y, score });
                    }
                }
            }
            let mut found = vec![];
            prop_assert_eq!(map.scan(3, &forest, step, |candidate| found.push(candidate)), windows);
            prop_assert_eq!(found, naive);
        }

        #[test]
        fn prepared_trees_find_the_same(
            columns in 1..60usize, rows in 1..11usize, first in 0..9usize, step in 1..4usize, bias in -40..100i32,
            trees in prop::collection::vec((tree(), tree()), 0..5),
            seed in prop::collection::vec(any::<u8>(), 4000),
        ) {
            let (width, height) = (columns + 2 * PADDING, rows + 2 * PADDING);
            let bytes: Vec<u8> = seed.into_iter().cycle().take(width * height * MAP_CHANNELS).collect();
            let map = Map::new(MapStrip { top: first, bytes: &bytes }, columns);
            // Seven nodes and eight leaves of two trees.
            let trees: Vec<Tree> = trees.into_iter().map(|((reject, nodes, leaves), (_, others, more))| {
                let nodes = nodes.iter().chain(&others).chain(&others[..1]).copied().collect();
                (reject, nodes, [leaves, more].concat())
            }).collect();
            let file = encode(3, bias, FEATURES as u16, &trees);
            let (forest, _) = Forest::parse(&file).unwrap();
            let mut want = vec![];
            let windows = map.scan(3, &forest, step, |candidate| want.push(candidate));
            for lanes in Lanes::available() {
                let cascade = Cascade::new(lanes, &forest, width).unwrap();
                let mut found = vec![];
                let count = map.scan_prepared(3, &cascade, step, |candidate| found.push(candidate));
                prop_assert_eq!((count, &found), (windows, &want), "{:?}", lanes);
            }
        }
    }
}
