//! The scan's trees for neighbouring windows at once, in the lanes of vector registers.
//!
//! The map is planar, so that one value of 16 or 32 windows side by side is one load. All seven nodes of a tree of depth
//! 3 are evaluated, masks select the number of the leaf, byte shuffles look the leaf up, sums are `i16`. A block of
//! windows goes on while more than one of them is alive; the last one is finished alone. Scores and windows are those of
//! [`Forest::cascade`] to the last bit.
//!
//! Instruction sets are those of the processor that runs the program: AVX2 or SSE4.1 on x86-64, NEON on AArch64.

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

/// An instruction set for the lanes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lanes {
    /// One window after the other.
    Scalar,
    /// 16 windows, x86-64 with SSE4.1.
    #[cfg(all(feature = "simd", target_arch = "x86_64"))]
    Sse41,
    /// 32 windows, x86-64 with AVX2.
    #[cfg(all(feature = "simd", target_arch = "x86_64"))]
    Avx2,
    /// 16 windows, AArch64 with NEON.
    #[cfg(all(feature = "simd", target_arch = "aarch64"))]
    Neon,
}

impl Lanes {
    /// All that this processor can execute, the fastest first.
    pub fn available() -> impl Iterator<Item = Self> {
        let all = [
            #[cfg(all(feature = "simd", target_arch = "x86_64"))]
            (Self::Avx2, std::arch::is_x86_feature_detected!("avx2")),
            #[cfg(all(feature = "simd", target_arch = "x86_64"))]
            (Self::Sse41, std::arch::is_x86_feature_detected!("sse4.1")),
            #[cfg(all(feature = "simd", target_arch = "aarch64"))]
            (Self::Neon, std::arch::is_aarch64_feature_detected!("crc")),
            (Self::Scalar, true),
        ];
        all.into_iter().filter_map(|(lanes, available)| available.then_some(lanes))
    }

    /// The fastest of [`Lanes::available`].
    pub fn fastest() -> Self {
        Self::available().next().unwrap_or(Self::Scalar)
    }

    /// The name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Scalar => "scalar",
            #[cfg(all(feature = "simd", target_arch = "x86_64"))]
            Self::Sse41 => "SSE4.1",
            #[cfg(all(feature = "simd", target_arch = "x86_64"))]
            Self::Avx2 => "AVX2",
            #[cfg(all(feature = "simd", target_arch = "aarch64"))]
            Self::Neon => "NEON",
        }
    }
}

/// A tree of depth 3 for windows of one map.
#[derive(Debug, Clone, Copy)]
struct Prepared {
    /// Of each node where its value is, from the value of feature 0.
    offsets: [u32; NODES],
    /// To the right where the byte, signed, is at least this.
    limits: [i8; NODES],
    /// Little-endian.
    leaves: [[u8; 2]; NODES + 1],
    reject: i16,
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
    lanes: Lanes,
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

/// Gets a window's column and row, the number of trees that it has outlived and its score so far.
type Survivors<'a> = &'a mut dyn FnMut(usize, usize, usize, i16);

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

    /// Calls `found` for each window that the cascade does not reject with its column, row and score, row by row.
    pub fn scan(&self, windows: &Windows<'_>, mut found: impl FnMut(usize, usize, i32)) {
        let mut survivors = |column: usize, row: usize, tree: usize, score: i16| {
            if let Some(score) = self.rest(windows, column, row, tree, score) {
                found(column, row, score);
            }
        };
        match self.lanes {
            Lanes::Scalar => scalar(self, windows, &mut survivors),
            #[cfg(all(feature = "simd", target_arch = "x86_64"))]
            Lanes::Sse41 => in_sse41(self, windows, &mut survivors),
            #[cfg(all(feature = "simd", target_arch = "x86_64"))]
            Lanes::Avx2 => in_avx2(self, windows, &mut survivors),
            #[cfg(all(feature = "simd", target_arch = "aarch64"))]
            Lanes::Neon => in_neon(self, windows, &mut survivors),
        }
    }

    /// The score of one window, `None` if it is rejected.
    #[inline]
    pub fn window(&self, windows: &Windows<'_>, column: usize, row: usize) -> Option<i32> {
        self.rest(windows, column, row, 0, self.bias())
    }

    /// The score of a window that has outlived the first `tree` trees with `score`.
    #[inline]
    fn rest(
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
    fn trees(&self) -> &[Prepared] {
        &self.prepared[..self.trees]
    }

    fn bias(&self) -> i16 {
        self.forest.bias() as i16
    }
}

/// All windows, from the first tree on.
fn scalar(cascade: &Cascade<'_>, windows: &Windows<'_>, survivors: Survivors<'_>) {
    for row in 0..windows.count.1 {
        for column in 0..windows.count.0 {
            survivors(column, row, 0, cascade.bias());
        }
    }
}

/// Defines `rows`, which sends blocks of windows through the trees in the lanes of the instruction set that the module
/// around it describes by its operations.
#[cfg(feature = "simd")]
macro_rules! in_lanes {
    ($feature:literal) => {
        /// Sends all windows through the trees.
        #[target_feature(enable = $feature)]
        pub fn rows(cascade: &Cascade<'_>, windows: &Windows<'_>, survivors: Survivors<'_>) {
            let (columns, rows) = windows.count;
            if columns < LANES {
                return scalar(cascade, windows, survivors);
            }
            for row in 0..rows {
                // The last block of a row begins so that it ends with the row: its first windows were in the one before.
                let mut known = 0;
                while known < columns {
                    let column = known.min(columns - LANES);
                    block(
                        cascade,
                        windows.from(column, row),
                        known - column,
                        &mut |lane, tree, score| {
                            survivors(column + lane, row, tree, score);
                        },
                    );
                    known = column + LANES;
                }
            }
        }

        /// Sends the windows from lane `first` on through the trees.
        #[inline]
        #[target_feature(enable = $feature)]
        fn block(
            cascade: &Cascade<'_>,
            bytes: &[u8],
            first: usize,
            survivors: &mut impl FnMut(usize, usize, i16),
        ) {
            // No load is behind this; the compiler knows then that all of it is there.
            let Some(last) = bytes.len().checked_sub(LANES) else { return };
            let mut alive = lanes_from(first);
            let mut sums = splat_sums(cascade.bias());
            let mut mask = 0;
            let mut tree = 0;
            let trees = cascade.trees();
            for pair in trees.chunks(2) {
                for prepared in pair {
                    // Where to go on to the left.
                    let left = |node: usize| {
                        let at = prepared.offsets[node] as usize;
                        assert!(at <= last, "a window ends within the map");
                        step(load(&bytes[at..at + LANES]), prepared, node)
                    };
                    let (a, b, c) = (left(0), left(1), left(2));
                    let (d, e, f, g) = (left(3), left(4), left(5), left(6));
                    let second = pick(a, b, c);
                    let third = pick(a, pick(b, d, e), pick(c, f, g));
                    let (low, high) = leaves(prepared, a, second, third);
                    sums = add(sums, low, high);
                    alive = and_not_below(alive, sums, prepared.reject);
                }
                tree += pair.len();
                mask = to_mask(alive);
                if mask & mask.wrapping_sub(1) == 0 {
                    break;
                }
            }
            if trees.is_empty() {
                mask = to_mask(alive);
            }
            if mask == 0 {
                return;
            }
            let sums = to_array(sums);
            while mask != 0 {
                let lane = mask.trailing_zeros() as usize;
                survivors(lane, tree, sums[lane % LANES]);
                mask &= mask - 1;
            }
        }
    };
}

#[cfg(all(feature = "simd", target_arch = "x86_64"))]
#[multiversion::multiversion(targets("x86_64+sse4.1"))]
fn in_sse41(cascade: &Cascade<'_>, windows: &Windows<'_>, survivors: Survivors<'_>) {
    multiversion::target::match_target! {
        "x86_64+sse4.1" => sse41::rows(cascade, windows, survivors),
        _ => scalar(cascade, windows, survivors),
    }
}

#[cfg(all(feature = "simd", target_arch = "x86_64"))]
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn in_avx2(cascade: &Cascade<'_>, windows: &Windows<'_>, survivors: Survivors<'_>) {
    multiversion::target::match_target! {
        "x86_64+avx2" => avx2::rows(cascade, windows, survivors),
        _ => scalar(cascade, windows, survivors),
    }
}

/// NEON is part of every AArch64 target, for which `multiversion` makes no clone with features of its own, and without one
/// the intrinsics are not to be called without `unsafe`. CRC instructions, which every processor of a companion board has
/// (all from ARMv8.1 on, Cortex-A53 and A72 before), make it one.
#[cfg(all(feature = "simd", target_arch = "aarch64"))]
#[multiversion::multiversion(targets("aarch64+neon+crc"))]
fn in_neon(cascade: &Cascade<'_>, windows: &Windows<'_>, survivors: Survivors<'_>) {
    multiversion::target::match_target! {
        "aarch64+neon+crc" => neon::rows(cascade, windows, survivors),
        _ => scalar(cascade, windows, survivors),
    }
}

/// Operations on 16 bytes and 16 sums.
#[cfg(all(feature = "simd", target_arch = "x86_64"))]
mod sse41 {
    use super::{Cascade, Prepared, Survivors, Windows, scalar};
    use core::arch::x86_64::*;

    const LANES: usize = 16;
    type Bytes = __m128i;
    type Sums = [__m128i; 2];

    in_lanes!("sse4.1");

    #[inline]
    #[target_feature(enable = "sse4.1")]
    fn load(bytes: &[u8]) -> Bytes {
        let (halves, _) = bytes.as_chunks::<8>();
        _mm_set_epi64x(i64::from_le_bytes(halves[1]), i64::from_le_bytes(halves[0]))
    }

    #[inline]
    #[target_feature(enable = "sse4.1")]
    fn lanes_from(first: usize) -> Bytes {
        load(&core::array::from_fn::<u8, LANES, _>(|lane| if lane < first { 0 } else { 255 }))
    }

    #[inline]
    #[target_feature(enable = "sse4.1")]
    fn splat_sums(sum: i16) -> Sums {
        [_mm_set1_epi16(sum); 2]
    }

    #[inline]
    #[target_feature(enable = "sse4.1")]
    fn step(value: Bytes, prepared: &Prepared, node: usize) -> Bytes {
        _mm_cmpgt_epi8(_mm_set1_epi8(prepared.limits[node]), value)
    }

    #[inline]
    #[target_feature(enable = "sse4.1")]
    fn pick(left: Bytes, a: Bytes, b: Bytes) -> Bytes {
        _mm_blendv_epi8(b, a, left)
    }

    /// Low and high bytes of the leaves.
    #[inline]
    #[target_feature(enable = "sse4.1")]
    fn leaves(prepared: &Prepared, a: Bytes, b: Bytes, c: Bytes) -> (Bytes, Bytes) {
        // The leaf's number from masks of the steps to the left, -1 each, is 7 + 4 a + 2 b + c; twice that is its place.
        let number = _mm_add_epi8(_mm_add_epi8(a, a), b);
        let number = _mm_add_epi8(_mm_add_epi8(number, number), c);
        let place = _mm_add_epi8(number, number);
        let table = load(prepared.leaves.as_flattened());
        (
            _mm_shuffle_epi8(table, _mm_add_epi8(place, _mm_set1_epi8(14))),
            _mm_shuffle_epi8(table, _mm_add_epi8(place, _mm_set1_epi8(15))),
        )
    }

    #[inline]
    #[target_feature(enable = "sse4.1")]
    fn add(sums: Sums, low: Bytes, high: Bytes) -> Sums {
        [
            _mm_add_epi16(sums[0], _mm_unpacklo_epi8(low, high)),
            _mm_add_epi16(sums[1], _mm_unpackhi_epi8(low, high)),
        ]
    }

    #[inline]
    #[target_feature(enable = "sse4.1")]
    fn and_not_below(alive: Bytes, sums: Sums, reject: i16) -> Bytes {
        let below = sums.map(|sums| _mm_cmpgt_epi16(_mm_set1_epi16(reject), sums));
        _mm_andnot_si128(_mm_packs_epi16(below[0], below[1]), alive)
    }

    #[inline]
    #[target_feature(enable = "sse4.1")]
    fn to_mask(alive: Bytes) -> u32 {
        _mm_movemask_epi8(alive).cast_unsigned()
    }

    #[inline]
    #[target_feature(enable = "sse4.1")]
    fn to_array(sums: Sums) -> [i16; LANES] {
        let [a, b] = sums;
        let words = [
            _mm_extract_epi64::<0>(a),
            _mm_extract_epi64::<1>(a),
            _mm_extract_epi64::<0>(b),
            _mm_extract_epi64::<1>(b),
        ];
        core::array::from_fn(|lane| (words[lane / 4] >> (lane % 4 * 16)) as i16)
    }
}

/// Operations on 32 bytes and 32 sums. Instructions that widen bytes take the lower and the upper half of the lanes each
/// by itself: the first sums are those of lanes 0 to 7 and 16 to 23.
#[cfg(all(feature = "simd", target_arch = "x86_64"))]
mod avx2 {
    use super::{Cascade, Prepared, Survivors, Windows, scalar};
    use core::arch::x86_64::*;

    const LANES: usize = 32;
    type Bytes = __m256i;
    type Sums = [__m256i; 2];

    in_lanes!("avx2");

    #[inline]
    #[target_feature(enable = "avx2")]
    fn load(bytes: &[u8]) -> Bytes {
        let (parts, _) = bytes.as_chunks::<8>();
        let part = |n: usize| i64::from_le_bytes(parts[n]);
        _mm256_set_epi64x(part(3), part(2), part(1), part(0))
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn lanes_from(first: usize) -> Bytes {
        load(&core::array::from_fn::<u8, LANES, _>(|lane| if lane < first { 0 } else { 255 }))
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn splat_sums(sum: i16) -> Sums {
        [_mm256_set1_epi16(sum); 2]
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn step(value: Bytes, prepared: &Prepared, node: usize) -> Bytes {
        _mm256_cmpgt_epi8(_mm256_set1_epi8(prepared.limits[node]), value)
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn pick(left: Bytes, a: Bytes, b: Bytes) -> Bytes {
        _mm256_blendv_epi8(b, a, left)
    }

    /// Low and high bytes of the leaves.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn leaves(prepared: &Prepared, a: Bytes, b: Bytes, c: Bytes) -> (Bytes, Bytes) {
        // The leaf's number from masks of the steps to the left, -1 each, is 7 + 4 a + 2 b + c; twice that is its place.
        let number = _mm256_add_epi8(_mm256_add_epi8(a, a), b);
        let number = _mm256_add_epi8(_mm256_add_epi8(number, number), c);
        let place = _mm256_add_epi8(number, number);
        let (parts, _) = prepared.leaves.as_flattened().as_chunks::<8>();
        let (low, high) = (i64::from_le_bytes(parts[0]), i64::from_le_bytes(parts[1]));
        let table = _mm256_set_epi64x(high, low, high, low);
        (
            _mm256_shuffle_epi8(table, _mm256_add_epi8(place, _mm256_set1_epi8(14))),
            _mm256_shuffle_epi8(table, _mm256_add_epi8(place, _mm256_set1_epi8(15))),
        )
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn add(sums: Sums, low: Bytes, high: Bytes) -> Sums {
        [
            _mm256_add_epi16(sums[0], _mm256_unpacklo_epi8(low, high)),
            _mm256_add_epi16(sums[1], _mm256_unpackhi_epi8(low, high)),
        ]
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn and_not_below(alive: Bytes, sums: Sums, reject: i16) -> Bytes {
        let below = sums.map(|sums| _mm256_cmpgt_epi16(_mm256_set1_epi16(reject), sums));
        _mm256_andnot_si256(_mm256_packs_epi16(below[0], below[1]), alive)
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn to_mask(alive: Bytes) -> u32 {
        _mm256_movemask_epi8(alive).cast_unsigned()
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn to_array([a, b]: Sums) -> [i16; LANES] {
        let words = [
            _mm256_extract_epi64::<0>(a),
            _mm256_extract_epi64::<1>(a),
            _mm256_extract_epi64::<0>(b),
            _mm256_extract_epi64::<1>(b),
            _mm256_extract_epi64::<2>(a),
            _mm256_extract_epi64::<3>(a),
            _mm256_extract_epi64::<2>(b),
            _mm256_extract_epi64::<3>(b),
        ];
        core::array::from_fn(|lane| (words[lane / 4] >> (lane % 4 * 16)) as i16)
    }
}

/// Operations on 16 bytes and 16 sums.
#[cfg(all(feature = "simd", target_arch = "aarch64"))]
mod neon {
    use super::{Cascade, Prepared, Survivors, Windows, scalar};
    use core::arch::aarch64::*;

    const LANES: usize = 16;
    type Bytes = uint8x16_t;
    type Sums = [int16x8_t; 2];

    in_lanes!("neon");

    #[inline]
    #[target_feature(enable = "neon")]
    fn load(bytes: &[u8]) -> Bytes {
        let (halves, _) = bytes.as_chunks::<8>();
        let half = |n: usize| vcreate_u8(u64::from_le_bytes(halves[n]));
        vcombine_u8(half(0), half(1))
    }

    #[inline]
    #[target_feature(enable = "neon")]
    fn lanes_from(first: usize) -> Bytes {
        load(&core::array::from_fn::<u8, LANES, _>(|lane| if lane < first { 0 } else { 255 }))
    }

    #[inline]
    #[target_feature(enable = "neon")]
    fn splat_sums(sum: i16) -> Sums {
        [vdupq_n_s16(sum); 2]
    }

    #[inline]
    #[target_feature(enable = "neon")]
    fn step(value: Bytes, prepared: &Prepared, node: usize) -> Bytes {
        vcltq_s8(vreinterpretq_s8_u8(value), vdupq_n_s8(prepared.limits[node]))
    }

    #[inline]
    #[target_feature(enable = "neon")]
    fn pick(left: Bytes, a: Bytes, b: Bytes) -> Bytes {
        vbslq_u8(left, a, b)
    }

    /// Low and high bytes of the leaves.
    #[inline]
    #[target_feature(enable = "neon")]
    fn leaves(prepared: &Prepared, a: Bytes, b: Bytes, c: Bytes) -> (Bytes, Bytes) {
        // The leaf's number from masks of the steps to the left, -1 each, is 7 + 4 a + 2 b + c; twice that is its place.
        let number = vaddq_u8(vaddq_u8(a, a), b);
        let number = vaddq_u8(vaddq_u8(number, number), c);
        let place = vaddq_u8(number, number);
        let table = load(prepared.leaves.as_flattened());
        (
            vqtbl1q_u8(table, vaddq_u8(place, vdupq_n_u8(14))),
            vqtbl1q_u8(table, vaddq_u8(place, vdupq_n_u8(15))),
        )
    }

    #[inline]
    #[target_feature(enable = "neon")]
    fn add(sums: Sums, low: Bytes, high: Bytes) -> Sums {
        [
            vaddq_s16(sums[0], vreinterpretq_s16_u8(vzip1q_u8(low, high))),
            vaddq_s16(sums[1], vreinterpretq_s16_u8(vzip2q_u8(low, high))),
        ]
    }

    #[inline]
    #[target_feature(enable = "neon")]
    fn and_not_below(alive: Bytes, sums: Sums, reject: i16) -> Bytes {
        let reject = vdupq_n_s16(reject);
        let [a, b] = sums.map(|sums| vreinterpretq_u8_u16(vcgeq_s16(sums, reject)));
        // Of each mask one byte.
        vandq_u8(alive, vuzp1q_u8(a, b))
    }

    #[inline]
    #[target_feature(enable = "neon")]
    fn to_mask(alive: Bytes) -> u32 {
        // Four bits of each lane, of which one is kept.
        let bits = vshrn_n_u16::<4>(vreinterpretq_u16_u8(alive));
        let bits = vget_lane_u64::<0>(vreinterpret_u64_u8(bits)) & 0x1111_1111_1111_1111;
        // Pairs of nibbles, then of bytes and so on, move together.
        let bits = (bits | bits >> 3) & 0x0303_0303_0303_0303;
        let bits = (bits | bits >> 6) & 0x000f_000f_000f_000f;
        let bits = (bits | bits >> 12) & 0x0000_00ff_0000_00ff;
        (bits | bits >> 24) as u32 & 0xffff
    }

    #[inline]
    #[target_feature(enable = "neon")]
    fn to_array([a, b]: Sums) -> [i16; LANES] {
        let words = [
            vgetq_lane_s64::<0>(vreinterpretq_s64_s16(a)),
            vgetq_lane_s64::<1>(vreinterpretq_s64_s16(a)),
            vgetq_lane_s64::<0>(vreinterpretq_s64_s16(b)),
            vgetq_lane_s64::<1>(vreinterpretq_s64_s16(b)),
        ];
        core::array::from_fn(|lane| (words[lane / 4] >> (lane % 4 * 16)) as i16)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trees::encode;
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
}
