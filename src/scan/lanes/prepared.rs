//! Trees that are prepared for the maps of one width, and the walk of one window through them.

use super::instructions::Lanes;
use crate::channels::window::WINDOW;
use crate::scan::aggregate::MAP_CHANNELS;
use crate::trees::{Forest, Node, Tree};

/// Values in a row of a window's map.
const ROW: usize = WINDOW * MAP_CHANNELS;

/// Values in a window's map, and features of the scan's trees: numbered by row, column and channel.
pub const FEATURES: usize = WINDOW * ROW;

/// From the first byte of a window to the value of a feature, in a map of `width` cells in a row.
#[inline(always)]
pub fn offset(feature: u16, width: usize) -> usize {
    let feature = usize::from(feature);
    let (row, column, channel) =
        (feature / ROW, feature % ROW / MAP_CHANNELS, feature % MAP_CHANNELS);
    (row * MAP_CHANNELS + channel) * width + column
}

/// A value of a map from its byte, or the other way round: bytes are kept less 128, since vector instructions compare signed
/// numbers.
#[inline(always)]
pub const fn signed(byte: u8) -> i8 {
    (byte ^ 128).cast_signed()
}

/// Whether the value in a byte of a map is above a threshold.
#[inline(always)]
pub fn is_above(byte: u8, threshold: u16) -> bool {
    u16::from(byte ^ 128) > threshold
}

/// Trees that are prepared for a map; windows that outlive them go on in the model's bytes. 56 bytes each, on the stack.
const PREPARED: usize = if cfg!(feature = "simd") { 256 } else { 64 };

/// Inner nodes of a tree.
const NODES: usize = 7;

/// A tree of depth 3 for windows of one map.
#[derive(Debug, Clone, Copy)]
pub(super) struct Prepared {
    /// Of each node where its value is, from the value of feature 0.
    pub(super) offsets: [u32; NODES],
    /// To the right where the byte, signed, is at least this.
    pub(super) limits: [i8; NODES],
    /// Little-endian.
    pub(super) leaves: [[u8; 2]; NODES + 1],
    pub(super) reject: i16,
}

impl Prepared {
    const NONE: Self = Self {
        offsets: [0; NODES],
        limits: [0; NODES],
        leaves: [[0; 2]; NODES + 1],
        reject: i16::MIN,
    };

    fn new(tree: &Tree<'_>, width: usize) -> Self {
        let mut prepared =
            Self { reject: tree.reject_threshold().max(-32768) as i16, ..Self::NONE };
        let places = prepared.offsets.iter_mut().zip(&mut prepared.limits);
        for ((place, limit), node) in places.zip(tree.nodes()) {
            *place = offset(node.feature, width) as u32;
            *limit = signed(node.threshold.saturating_add(1).min(255) as u8);
        }
        for (leaf, value) in prepared.leaves.iter_mut().zip(tree.leaves()) {
            *leaf = value.to_le_bytes();
        }
        // From below, so that what is copied is what it should be.
        for (node, Node { threshold, .. }) in tree.nodes().enumerate().rev() {
            if threshold >= 255 {
                prepared.never_right(node);
            }
        }
        prepared
    }

    /// No value is above the threshold of `node`: what is to its right becomes what is to its left.
    fn never_right(&mut self, node: usize) {
        let (mut first, mut count) = (2 * node + 1, 1);
        while first < NODES {
            self.offsets.copy_within(first..first + count, first + count);
            self.limits.copy_within(first..first + count, first + count);
            (first, count) = (2 * first + 1, 2 * count);
        }
        first -= NODES;
        self.leaves.copy_within(first..first + count, first + count);
    }

    #[inline(always)]
    fn leaf(&self, window: &[u8]) -> i16 {
        let right =
            |node: usize| window[self.offsets[node] as usize].cast_signed() >= self.limits[node];
        let leaf = if cfg!(feature = "simd") {
            // Without branches, which a processor of many stages foretells wrongly at every second node.
            let mut i = 1;
            for _ in 0..3 {
                i = 2 * i + usize::from(right((i - 1) % 8));
            }
            i % 8
        } else {
            // A microcontroller saves what numbers of nodes cost.
            match right(0) {
                false if right(1) => 2 + usize::from(right(4)),
                false => usize::from(right(3)),
                true if right(2) => 6 + usize::from(right(6)),
                true => 4 + usize::from(right(5)),
            }
        };
        i16::from_le_bytes(self.leaves[leaf])
    }
}

/// A cascade for the windows of maps of one width.
#[derive(Debug)]
pub struct Cascade<'m> {
    pub(super) lanes: Lanes,
    forest: Forest<'m>,
    prepared: [Prepared; PREPARED],
    /// How many of them there are.
    trees: usize,
}

/// Rows of a planar map and the windows in them.
#[derive(Debug, Clone, Copy)]
pub struct Windows<'a> {
    /// Rows one after the other, each of [`MAP_CHANNELS`] planes.
    pub bytes: &'a [u8],
    /// Cells in a row of a plane.
    pub width: usize,
    /// Windows side by side and one above the other.
    pub count: (usize, usize),
}

impl<'a> Windows<'a> {
    /// The bytes from the first one of a window on.
    #[inline(always)]
    pub fn from(&self, column: usize, row: usize) -> &'a [u8] {
        &self.bytes[row * MAP_CHANNELS * self.width + column..]
    }
}

/// Gets a window's column and row, the number of trees that it has outlived and its score by those.
pub(super) type Survivors<'a> = &'a mut dyn FnMut(usize, usize, usize, i16);

impl<'m> Cascade<'m> {
    /// `forest` for maps of `width` cells in a row. `None` where trees are not of depth 3 or scores leave the range of
    /// `i16`.
    pub fn new(lanes: Lanes, forest: &Forest<'m>, width: usize) -> Option<Self> {
        if forest.depth() != 3 || !forest.fits_i16() {
            return None;
        }
        let mut prepared = [Prepared::NONE; PREPARED];
        let trees = forest.trees().len().min(PREPARED);
        for (prepared, tree) in prepared.iter_mut().zip(forest.trees()) {
            *prepared = Prepared::new(&tree, width);
        }
        Some(Self { lanes, forest: *forest, prepared, trees })
    }

    /// The score of one window, `None` if it is rejected.
    #[inline]
    pub fn window(&self, windows: &Windows<'_>, column: usize, row: usize) -> Option<i32> {
        self.rest(windows, column, row, 0, self.bias())
    }

    /// The score of a window that has outlived the first `tree` trees with `score`.
    #[inline]
    pub(super) fn rest(
        &self,
        windows: &Windows<'_>,
        column: usize,
        row: usize,
        tree: usize,
        mut score: i16,
    ) -> Option<i32> {
        let window = windows.from(column, row);
        for prepared in &self.prepared[tree..self.trees] {
            score += prepared.leaf(window);
            if score < prepared.reject {
                return None;
            }
        }
        let test = |feature: u16, threshold: u16| {
            is_above(window[offset(feature, windows.width)], threshold)
        };
        self.forest.cascade_from(self.trees, i32::from(score), test)
    }

    #[cfg(feature = "simd")]
    pub(super) fn trees(&self) -> &[Prepared] {
        &self.prepared[..self.trees]
    }

    pub(super) fn bias(&self) -> i16 {
        self.forest.bias() as i16
    }
}

/// All windows, from the first tree on.
pub(super) fn scalar(cascade: &Cascade<'_>, windows: &Windows<'_>, survivors: Survivors<'_>) {
    for row in 0..windows.count.1 {
        for column in 0..windows.count.0 {
            survivors(column, row, 0, cascade.bias());
        }
    }
}
