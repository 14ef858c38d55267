//! The candidates of a frame: the scan over the maps of all levels, and which of its windows are handed on.
//!
//! Maps are computed in strips of a few rows and scanned at once: a whole map would be the largest thing in memory.
//!
//! Tried, and not kept: where every second window is looked at, the windows beside those kept as well. With the small model of
//! 2026-11-30 AveP at IoU 0.5 / 0.3 is 0.255 / 0.469 on airborne/dev instead of 0.260 / 0.473, 0.756 / 0.897 on real/dev instead
//! of 0.752 / 0.895. A model that is trained with them was not tried.

pub mod aggregate;
pub mod cascade;
pub mod lanes;

use crate::channels::DIFFERENCES;
use crate::channels::scale_space::{LevelView, Pyramid, PyramidLayout, PyramidLevel};
use crate::channels::window::{PADDING, Position, WINDOW};
use crate::image::nms;
use crate::math::slices;
use crate::trees::Forest;
use aggregate::MapStrip;
use cascade::{Candidate, Map};
use core::cmp::Reverse;
use heapless::binary_heap::{BinaryHeap, Min};
use lanes::{Cascade, Lanes};

/// Most windows that are handed on.
pub const MAX_CANDIDATES: usize = 64;

/// Most windows of one level that are looked at again: the best ones.
const MAX_KEPT: usize = 256;

/// Overlap (IoU, Q8) above which the weaker of two windows goes.
const OVERLAP: u8 = 128;

/// Rows of a map that are computed at a time: those of a window and a few more, since all but the first few are moved
/// up for the next strip.
const STRIP_ROWS: usize = WINDOW + 11;

/// Words of a candidate in memory.
const CANDIDATE_WORDS: usize = 5;

/// Best windows of one level.
type TopWindows = BinaryHeap<(i32, Reverse<(i16, i16)>), Min, MAX_KEPT>;

/// The windows that are handed on, best first.
pub type Candidates = heapless::Vec<Candidate, MAX_CANDIDATES>;

/// Numbers of windows and trees that the scan evaluated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ScanWork {
    /// Windows that the cascade evaluated.
    pub windows: u32,
    /// Windows that the cascade kept.
    pub kept: u32,
    /// Kept windows left out for want of room; those that overlap a better one are not counted.
    pub dropped: u32,
}

/// Memory of the search; what is in it does not matter.
#[derive(Debug)]
pub struct Scratch<'b> {
    /// At least [`bytes_len`] bytes; contents do not matter.
    pub bytes: &'b mut [u8],
    /// At least [`words_len`] words; contents do not matter.
    pub words: &'b mut [u16],
}

/// Window of a candidate on its level.
pub fn window(candidate: &Candidate) -> Position {
    Position::of_cell(candidate.x, candidate.y)
}

/// Bytes and words that a level takes to be scanned.
const fn level_scratch(level: &PyramidLevel) -> (usize, usize) {
    let columns = level.cells().0;
    if level.active {
        (aggregate::strip_bytes(columns, STRIP_ROWS), aggregate::strip_words(columns))
    } else {
        (0, 0)
    }
}

/// Of all levels: the sum where they are scanned in `parallel`, the largest where one follows the other.
const fn scratch(geometry: &PyramidLayout, parallel: bool) -> (usize, usize) {
    let (mut bytes, mut words, mut i) = (0, 0, 0);
    while i < geometry.levels().len() {
        let level = level_scratch(&geometry.levels()[i]);
        bytes = if parallel { bytes + level.0 } else { max(bytes, level.0) };
        words = if parallel { words + level.1 } else { max(words, level.1) };
        i += 1;
    }
    (bytes, words)
}

/// Bytes of [`Scratch`], with room for levels in parallel or for one after the other.
pub const fn bytes_len(geometry: &PyramidLayout, parallel: bool) -> usize {
    scratch(geometry, parallel).0
}

/// Words of [`Scratch`], as [`bytes_len`].
pub const fn words_len(geometry: &PyramidLayout, parallel: bool) -> usize {
    candidate_words(geometry) + scratch(geometry, parallel).1
}

/// Words for the candidates of all levels; before there are any, of the noise.
const fn candidate_words(geometry: &PyramidLayout) -> usize {
    let levels = geometry.levels();
    let (mut i, mut searched) = (0, 0);
    while i < levels.len() {
        searched += levels[i].active as usize;
        i += 1;
    }
    max(searched * MAX_KEPT * CANDIDATE_WORDS, noise_words(levels))
}

/// Words that [`noise`] needs.
pub const fn noise_words(levels: &[PyramidLevel]) -> usize {
    let (mut i, mut words) = (0, 0);
    while i < levels.len() {
        let (columns, rows) = levels[i].cells();
        words = max(words, aggregate::noise_words(columns, rows));
        i += 1;
    }
    words
}

/// Noise of the newest frame's differences: from the finest level that is searched. Panics if there are fewer than
/// [`noise_words`] words.
pub fn noise(pyramid: &Pyramid<'_>, words: &mut [u16]) -> [u32; DIFFERENCES] {
    let finest = pyramid.searched().next();
    finest.map_or([0; DIFFERENCES], |level| aggregate::noise(&level.newest, words))
}

const fn max(a: usize, b: usize) -> usize {
    if a > b { a } else { b }
}

/// The windows that `cascade` finds best, at most `most` of them and [`MAX_CANDIDATES`]; levels in parallel if asked
/// for, where there are threads for it. The result is the same. Panics if `scratch` is too small for it.
#[inline(never)]
pub fn search(
    cascade: &Forest<'_>,
    pyramid: &Pyramid<'_>,
    most: usize,
    parallel: bool,
    scratch: Scratch<'_>,
) -> (Candidates, ScanWork) {
    let (found, strips) = slices::split_mut(scratch.words, candidate_words(pyramid.geometry()));
    let noise = noise(pyramid, found);
    let step = pyramid.geometry().history().stride();
    let (found, _) = found.as_chunks_mut();
    let (mut length, mut counts) = (0, ScanWork::default());
    let mut merge = |level: LevelFound| {
        counts.windows += level.windows;
        counts.kept += level.kept;
        counts.dropped += level.kept - level.best.len() as u32;
        for &(score, Reverse((y, x))) in level.best.iter() {
            found[length] = encode(&Candidate { level: level.number, x, y, score });
            length += 1;
        }
    };
    each_level(
        pyramid,
        parallel,
        Scratch { bytes: scratch.bytes, words: strips },
        &mut merge,
        |level, scratch| scan_level(cascade, level, &noise, step, scratch),
    );
    let found = slices::part_mut(found, 0, length);
    found.sort_unstable_by_key(|words| {
        let Candidate { level, x, y, score } = decode(words);
        (Reverse(score), level, y, x)
    });
    let rect = |words: &[u16; CANDIDATE_WORDS]| {
        let candidate = decode(words);
        pyramid.geometry().level(usize::from(candidate.level)).nominal_box(window(&candidate))
    };
    let (kept, dropped) = nms::suppress(found, rect, OVERLAP, most.min(MAX_CANDIDATES));
    counts.dropped += dropped;
    (slices::part(found, 0, kept).iter().map(decode).collect(), counts)
}

/// Trees of `cascade` that the windows of a frame pass until they are rejected, all together, and the windows: for
/// statistics, one level and window after the other. Panics if `scratch` is too small.
pub fn count_trees(
    cascade: &Forest<'_>,
    pyramid: &Pyramid<'_>,
    scratch: Scratch<'_>,
) -> (u64, u64) {
    let (words, strips) = slices::split_mut(scratch.words, candidate_words(pyramid.geometry()));
    let noise = noise(pyramid, words);
    let step = pyramid.geometry().history().stride();
    let (mut tests, mut windows) = (0, 0);
    for level in pyramid.searched() {
        let columns = level.level.cells().0;
        let rows = (STRIP_ROWS, WINDOW - 1);
        aggregate::strips(&level.newest, &noise, rows, scratch.bytes, strips, |strip| {
            let map = Map::new(strip, columns);
            let counted = map.count_tests(cascade, step);
            tests += counted.0;
            windows += counted.1;
        });
    }
    // Every tree takes as many tests as it is deep.
    (tests / u64::from(cascade.depth()), windows)
}

/// Best windows and counts of one level.
struct LevelFound {
    number: u8,
    windows: u32,
    kept: u32,
    best: TopWindows,
}

/// Does `work` on every searched level, each with memory of its own where they run in parallel, and merges what it
/// gives in the order of levels.
fn each_level(
    pyramid: &Pyramid<'_>,
    parallel: bool,
    scratch: Scratch<'_>,
    merge: &mut impl FnMut(LevelFound),
    work: impl Fn(&LevelView<'_>, Scratch<'_>) -> LevelFound + Sync,
) {
    let Scratch { bytes, words } = scratch;
    #[cfg(feature = "rayon")]
    if parallel && rayon::current_num_threads() > 1 {
        use rayon::prelude::*;
        let (mut bytes, mut words) = (bytes, words);
        let tasks: std::vec::Vec<_> = pyramid
            .searched()
            .map(|level| {
                let (own_bytes, own_words) = level_scratch(&level.level);
                let bytes = bytes.split_off_mut(..own_bytes).unwrap_or_default();
                let words = words.split_off_mut(..own_words).unwrap_or_default();
                (level, Scratch { bytes, words })
            })
            .collect();
        let found: std::vec::Vec<LevelFound> = tasks
            .into_par_iter()
            .with_max_len(1)
            .map(|(level, scratch)| work(&level, scratch))
            .collect();
        found.into_iter().for_each(merge);
        return;
    }
    let _ = parallel;
    for level in pyramid.searched() {
        merge(work(&level, Scratch { bytes: &mut *bytes, words: &mut *words }));
    }
}

/// Scans one level.
#[inline(never)]
fn scan_level(
    cascade: &Forest<'_>,
    level: &LevelView<'_>,
    noise: &[u32; DIFFERENCES],
    step: usize,
    scratch: Scratch<'_>,
) -> LevelFound {
    let columns = level.level.cells().0;
    let mut found =
        LevelFound { number: level.number, windows: 0, kept: 0, best: TopWindows::new() };
    let prepared = Cascade::new(Lanes::fastest(), cascade, columns + 2 * PADDING);
    let scan = |strip: MapStrip<'_>| {
        let map = Map::new(strip, columns);
        let keep = |candidate: Candidate| {
            found.kept += 1;
            let item = (candidate.score, Reverse((candidate.y, candidate.x)));
            let best = &mut found.best;
            if best.push(item).is_err() && best.peek().is_some_and(|worst| *worst < item) {
                best.pop();
                // There is room now.
                let _ = best.push(item);
            }
        };
        found.windows += match &prepared {
            Some(cascade) => map.scan_prepared(level.number, cascade, step, keep),
            None => map.scan(level.number, cascade, step, keep),
        };
    };
    let rows = (STRIP_ROWS, WINDOW - 1);
    aggregate::strips(&level.newest, noise, rows, scratch.bytes, scratch.words, scan);
    found
}

fn encode(candidate: &Candidate) -> [u16; CANDIDATE_WORDS] {
    let Candidate { level, x, y, score } = *candidate;
    let score = score.cast_unsigned();
    [u16::from(level), x.cast_unsigned(), y.cast_unsigned(), (score >> 16) as u16, score as u16]
}

fn decode(words: &[u16; CANDIDATE_WORDS]) -> Candidate {
    let [level, x, y, high, low] = *words;
    let score = (u32::from(high) << 16 | u32::from(low)).cast_signed();
    Candidate { level: level as u8, x: x.cast_signed(), y: y.cast_signed(), score }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn candidates_survive_the_memory(level: u8, x: i16, y: i16, score: i32) {
            let candidate = Candidate { level, x, y, score };
            prop_assert_eq!(decode(&encode(&candidate)), candidate);
        }
    }
}
