//! Registration: the motion of the background from frame to frame.
//!
//! Corners of the new frame are tracked into the last one, coarse to fine, from an eighth of the resolution to a half. On
//! each level a global motion is fitted to them robustly and predicts the shifts on the next level. Where that fails, the
//! picture may have moved farther than tracking reaches: it is tried once more from the shift found by block search
//! between the smallest pictures (0.972 of the frames of `moving/train` are registered so, 0.966 without; all of
//! `airborne/train` either way). Beginning with the perspective of a turn, or on the smallest level, registered no more.
//!
//! A further, local correction does not pay: on `airborne/train` even the best shift of each 32x32 block (which moves
//! the targets too) lowers the mean difference by 5 % and the tolerant one by nothing.

pub mod block_search;
pub mod global_motion;
pub mod lucas_kanade;
pub mod warp;

use crate::image::Image;
use crate::image::pyramid;
use crate::math::threads;
pub use global_motion::GlobalMotion;
use global_motion::{CornerShift, MAX_SAMPLES, MIN_INLIERS, fit};

/// Levels of the pyramid: a half, a quarter, an eighth of the frame.
pub const LEVELS: usize = 3;

/// Corners: at most one in each cell of this grid.
const COLUMNS: usize = 20;
/// See [`COLUMNS`].
const ROWS: usize = 15;
const _: () = assert!(COLUMNS * ROWS <= MAX_SAMPLES);

/// Smallest side of a cell, in pixels of the frame's half: fewer corners in small frames.
const MIN_CELL: usize = 8;

/// Corners that one thread detects or tracks at a time.
const PIECE: usize = 30;

/// Density of the corners.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Search {
    /// The strongest corner of every grid cell.
    Dense,
    /// In the middle of cells of twice the smallest side: about a third of the corners, for small boards.
    Sparse,
}

/// Smallest side of a level that is used beside the finest, in pixels of the level.
const MIN_SIDE: usize = 48;

/// Largest shift of a corner, in pixels of the frame, Q8; larger ones are dropped. Keeps the normal equations below 2^46.
const MAX_SHIFT: i32 = 512 << 8;

/// The corners of a frame that could be tracked.
type CornerShifts = heapless::Vec<CornerShift, MAX_SAMPLES>;

/// Why frames cannot be processed in given memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RegistrationError {
    /// The memory has too few bytes.
    BufferTooSmall {
        /// Bytes needed.
        needed: usize,
    },
    /// A frame has another size than those before.
    FrameSize {
        /// Width of the frame in pixels.
        width: usize,
        /// Height of the frame in pixels.
        height: usize,
    },
}

impl core::fmt::Display for RegistrationError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::BufferTooSmall { needed } => write!(f, "a buffer needs {needed} bytes"),
            Self::FrameSize { width, height } => {
                write!(f, "the frame is {width}x{height}, memory was given for another size")
            }
        }
    }
}

impl core::error::Error for RegistrationError {}

/// Bytes that [`Registration`] needs for frames of this size.
pub const fn buffer_len(width: usize, height: usize) -> usize {
    2 * pyramid_len(width, height)
}

const fn pyramid_len(width: usize, height: usize) -> usize {
    let (mut len, mut level) = (0, 1);
    while level <= LEVELS {
        len += (width >> level) * (height >> level);
        level += 1;
    }
    len
}

/// Measures the motion of the background from frame to frame, in memory of its own.
///
/// ```
/// use lookout::image::Image;
/// use lookout::registration::{Registration, buffer_len};
///
/// let mut registration = Registration::new(160, 120, vec![0; buffer_len(160, 120)])?;
/// // A texture that moves two pixels to the left: each point was further right in the frame before.
/// for frame in 0..2 {
///     let grey = |n: usize| {
///         let (x, y) = ((n % 160 + 2 * frame) as f64, (n / 160) as f64);
///         (128.0 + 60.0 * (x / 5.0).sin() * (y / 6.0).cos() + 40.0 * (x / 13.0 + y / 9.0).sin()) as u8
///     };
///     let pixels: Vec<u8> = (0..160 * 120).map(grey).collect();
///     let motion = registration.register(Image::packed(&pixels, 160, 120)?)?;
///     assert_eq!(motion.is_valid(), frame > 0);
///     if motion.is_valid() {
///         // In Q8, to a quarter of a pixel.
///         let (x, y) = motion.map(80 << 8, 60 << 8);
///         assert!((x - (82 << 8)).abs() < 64 && (y - (60 << 8)).abs() < 64);
///     }
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Registration<B> {
    width: usize,
    height: usize,
    /// Whether the last frame's pyramid is in the buffer.
    primed: bool,
    /// Whether the last frame's pyramid is in the second half of the buffer.
    swapped: bool,
    buffer: B,
}

impl<B: AsMut<[u8]>> Registration<B> {
    /// For frames of this size; no frame seen yet.
    ///
    /// # Errors
    /// [`RegistrationError::BufferTooSmall`] if the buffer has fewer bytes than [`buffer_len`].
    pub fn new(width: usize, height: usize, mut buffer: B) -> Result<Self, RegistrationError> {
        let needed = buffer_len(width, height);
        if buffer.as_mut().len() < needed {
            return Err(RegistrationError::BufferTooSmall { needed });
        }
        Ok(Self { width, height, primed: false, swapped: false, buffer })
    }

    /// The motion that leads from `frame` back to the frame of the last call; not valid for the first frame and where
    /// the pictures have too few corners.
    ///
    /// # Errors
    /// [`RegistrationError::FrameSize`] if the frame has another size; it is not taken then.
    pub fn register(&mut self, frame: Image<'_>) -> Result<GlobalMotion, RegistrationError> {
        let (width, height) = (frame.width(), frame.height());
        if (width, height) != (self.width, self.height) {
            return Err(RegistrationError::FrameSize { width, height });
        }
        let len = pyramid_len(width, height);
        let (first, second) = self.buffer.as_mut()[..2 * len].split_at_mut(len);
        let (new, old) = if self.swapped { (first, second) } else { (second, first) };
        let new = build(frame, new);
        self.swapped = !self.swapped;
        if !core::mem::replace(&mut self.primed, true) {
            return Ok(GlobalMotion::IDENTITY);
        }
        let old = levels(width, height, old);
        Ok(measure((width, height), Search::Dense, &new, &old))
    }
}

/// The motion that leads from a frame of `width` x `height` back to an older one: pyramids of both, finest first. Not valid
/// where the pictures give nothing to hold on to.
#[inline(never)]
pub fn measure(
    (width, height): (usize, usize),
    search: Search,
    new: &[Image<'_>; LEVELS],
    old: &[Image<'_>; LEVELS],
) -> GlobalMotion {
    let corners = corners(new[0], search);
    let still = GlobalMotion::still(width, height);
    // A level of few pixels shows the windows only the middle of the picture.
    let side = |level: usize| new[level].width().min(new[level].height());
    let coarsest = (1..LEVELS).rev().find(|&level| side(level) >= MIN_SIDE).unwrap_or(0);
    let mut motion = follow(&corners, (still, still), coarsest, search, new, old);
    if !motion.is_valid() && corners.len() >= MIN_INLIERS {
        let level = LEVELS - 1;
        if let Some(shift) = block_search::shift(new[level], old[level])
            && shift != (0, 0)
        {
            let start = still.shifted(shift, level as u32 + 1);
            // On the level of the search tracking is no more exact than the search.
            motion = follow(&corners, (still, start), coarsest.min(level - 1), search, new, old);
        }
    }
    if motion.is_valid() { motion } else { GlobalMotion::IDENTITY }
}

/// Tracks `corners` from the `coarsest` level to the finest, beginning with the motion `start`.
fn follow(
    corners: &[(i32, i32)],
    (still, start): (GlobalMotion, GlobalMotion),
    coarsest: usize,
    search: Search,
    new: &[Image<'_>; LEVELS],
    old: &[Image<'_>; LEVELS],
) -> GlobalMotion {
    let parallel = search == Search::Dense && threads::several();
    let mut motion = start;
    for level in (0..=coarsest).rev() {
        let bits = level as u32 + 1;
        let track = |&(x, y): &(i32, i32)| {
            let (dx, dy) = motion.shift(x, y);
            let guess = (dx >> bits, dy >> bits);
            let found = lucas_kanade::track(new[level], old[level], (x >> bits, y >> bits), guess);
            let (dx, dy) = found.map(|(dx, dy)| (dx << bits, dy << bits))?;
            (dx.abs().max(dy.abs()) < MAX_SHIFT).then_some(CornerShift { x, y, dx, dy })
        };
        // There are no more corners than the samples have room for.
        let samples: CornerShifts = if parallel {
            let mut tracked = [None; MAX_SAMPLES];
            threads::pieces(&mut tracked[..corners.len()], PIECE, true, |number, tracked| {
                for (tracked, corner) in tracked.iter_mut().zip(&corners[number * PIECE..]) {
                    *tracked = track(corner);
                }
            });
            tracked.into_iter().flatten().collect()
        } else {
            corners.iter().filter_map(track).collect()
        };
        motion = fit(still, &samples, if level == 0 { 8 } else { 6 });
    }
    motion
}

/// Writes the pyramid of `frame` and returns its levels, finest first.
fn build<'b>(frame: Image<'_>, mut buffer: &'b mut [u8]) -> [Image<'b>; LEVELS] {
    let mut pyramid = [EMPTY; LEVELS];
    let mut above = frame;
    for level in &mut pyramid {
        let (width, height) = (above.width() / 2, above.height() / 2);
        let (pixels, rest) = buffer.split_at_mut(width * height);
        pyramid::halve(above, pixels);
        *level = Image::packed(pixels, width, height).unwrap_or(EMPTY);
        above = *level;
        buffer = rest;
    }
    pyramid
}

/// The levels of a pyramid written before by [`build`].
fn levels(width: usize, height: usize, mut buffer: &[u8]) -> [Image<'_>; LEVELS] {
    core::array::from_fn(|level| {
        let (width, height) = (width >> (level + 1), height >> (level + 1));
        let (pixels, rest) = buffer.split_at(width * height);
        buffer = rest;
        Image::packed(pixels, width, height).unwrap_or(EMPTY)
    })
}

const EMPTY: Image<'static> = match Image::packed(&[], 0, 0) {
    Ok(image) => image,
    Err(_) => unreachable!(),
};

/// The strongest corner of each cell of `half`, in pixels of the frame, Q8.
fn corners(half: Image<'_>, search: Search) -> heapless::Vec<(i32, i32), MAX_SAMPLES> {
    let side = |length: usize, cells: usize| match search {
        Search::Dense => length.div_ceil(cells).max(MIN_CELL),
        Search::Sparse => length.div_ceil(cells).max(2 * MIN_CELL),
    };
    let (width, height) = (side(half.width(), COLUMNS), side(half.height(), ROWS));
    let corner_of = |cell: usize| {
        let across = half.width().div_ceil(width);
        let (left, top) = (cell % across * width, cell / across * height);
        let (x, y) = match search {
            Search::Dense => lucas_kanade::corner(half, (left, top), (left + width, top + height)),
            Search::Sparse => {
                lucas_kanade::block_corner(half, (left + width / 2, top + height / 2))
            }
        }?;
        // The middle of a pixel of the half lies at 2 * (x + 1/2) of the frame.
        Some(((2 * x as i32 + 1) << 8, (2 * y as i32 + 1) << 8))
    };
    let cells = half.width().div_ceil(width) * half.height().div_ceil(height);
    if search == Search::Sparse || !threads::several() {
        return (0..cells).filter_map(corner_of).collect();
    }
    let mut found = [None; COLUMNS * ROWS];
    threads::pieces(&mut found[..cells], PIECE, true, |number, found| {
        for (cell, found) in (number * PIECE..).zip(found) {
            *found = corner_of(cell);
        }
    });
    found.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::global_motion::tests::error;
    use crate::registration::lucas_kanade::tests::{render, texture};
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    /// Registers two frames of a size, the older first.
    fn register(w: usize, h: usize, older: &[u8], newer: &[u8]) -> GlobalMotion {
        let buffer = vec![0xa5; buffer_len(w, h)];
        let mut registration = Registration::new(w, h, buffer).unwrap();
        let view = |pixels| Image::packed(pixels, w, h).unwrap();
        assert_eq!(registration.register(view(older)).unwrap(), GlobalMotion::IDENTITY);
        registration.register(view(newer)).unwrap()
    }

    /// Where a camera of focal length 560 px that has turned by these angles (radians) saw a point before.
    fn turned(
        w: usize,
        h: usize,
        [yaw, pitch, roll]: [f64; 3],
    ) -> impl Fn(f64, f64) -> (f64, f64) + Copy {
        let (cx, cy) = (w as f64 / 2.0, h as f64 / 2.0);
        move |x, y| {
            let (x, y, z) = ((x - cx) / 560.0, (y - cy) / 560.0, 1.0);
            let (x, y) = (x * roll.cos() - y * roll.sin(), x * roll.sin() + y * roll.cos());
            let (y, z) = (y * pitch.cos() - z * pitch.sin(), y * pitch.sin() + z * pitch.cos());
            let (x, z) = (x * yaw.cos() + z * yaw.sin(), z * yaw.cos() - x * yaw.sin());
            (x / z * 560.0 + cx, y / z * 560.0 + cy)
        }
    }

    #[test]
    fn recovers_turns_shifts_and_zoom() {
        for (w, h) in [(320, 240), (333, 251)] {
            let older = render(w, h, texture);
            for angles in [[0.02, 0.0, 0.0], [0.004, -0.015, 0.01], [-0.012, 0.008, -0.03]] {
                let truth = turned(w, h, angles);
                let newer = render(w, h, |x, y| {
                    let (x, y) = truth(x, y);
                    texture(x, y)
                });
                let motion = register(w, h, &older, &newer);
                assert!(motion.is_valid());
                let error = error(w, h, &motion, truth);
                assert!(error < 0.15, "{angles:?} {error} {motion:?}");
            }
            for (zoom, dx, dy) in [(1.0, 7.3, -4.8), (1.02, 0.0, 0.0), (0.985, -3.2, 14.5)] {
                let truth = |x: f64, y: f64| (x * zoom + dx, y * zoom + dy);
                let newer = render(w, h, |x, y| texture(truth(x, y).0, truth(x, y).1));
                let motion = register(w, h, &older, &newer);
                assert!(motion.is_valid() && error(w, h, &motion, truth) < 0.15, "{motion:?}");
            }
        }
    }

    #[test]
    fn farther_than_tracking_reaches() {
        let (w, h) = (640, 480);
        let older = render(w, h, texture);
        for (dx, dy) in [(96.0, 0.0), (-70.0, 50.0), (-8.0, -88.0)] {
            let truth = |x: f64, y: f64| (x + dx, y + dy);
            let newer = render(w, h, |x, y| texture(x + dx, y + dy));
            let motion = register(w, h, &older, &newer);
            assert!(motion.is_valid() && error(w, h, &motion, truth) < 0.3, "{dx} {dy} {motion:?}");
        }
        // Another place altogether.
        let newer = render(w, h, |x, y| texture(x + 5000.0, y - 3000.0));
        assert!(!register(w, h, &older, &newer).is_valid());
    }

    #[test]
    fn few_corners_are_nearly_as_accurate() {
        let (w, h) = (320, 240);
        let truth = turned(w, h, [0.01, -0.008, 0.02]);
        let older = render(w, h, texture);
        let newer = render(w, h, |x, y| texture(truth(x, y).0, truth(x, y).1));
        let mut buffers = [(); 2].map(|_| vec![0; pyramid_len(w, h)]);
        let [old, new] = &mut buffers;
        let old = build(Image::packed(&older, w, h).unwrap(), old);
        let new = build(Image::packed(&newer, w, h).unwrap(), new);
        let [dense, sparse] = [Search::Dense, Search::Sparse].map(|s| corners(new[0], s).len());
        assert!(sparse > 40 && 2 * sparse < dense, "{sparse} of {dense} corners");
        let motion = measure((w, h), Search::Sparse, &new, &old);
        assert!(motion.is_valid() && error(w, h, &motion, truth) < 0.4, "{motion:?}");
    }

    #[test]
    fn noise_and_a_large_moving_thing_do_not_mislead() {
        let (w, h) = (320, 240);
        let truth = turned(w, h, [0.01, 0.005, 0.01]);
        let mut state = 1u32;
        let mut noisy = |mut pixels: Vec<u8>| {
            for p in &mut pixels {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *p = p.saturating_add_signed((state >> 24) as i8 / 20);
            }
            pixels
        };
        // A fifth of the picture moves its own way, with the texture of somewhere else.
        let thing = |x: f64, y: f64| (60.0..170.0).contains(&x) && (40.0..190.0).contains(&y);
        let older =
            noisy(render(
                w,
                h,
                |x, y| {
                    if thing(x, y) { texture(x + 999.0, y) } else { texture(x, y) }
                },
            ));
        let newer = noisy(render(w, h, |x, y| {
            if thing(x - 5.0, y + 3.0) {
                texture(x - 5.0 + 999.0, y + 3.0)
            } else {
                texture(truth(x, y).0, truth(x, y).1)
            }
        }));
        let motion = register(w, h, &older, &newer);
        assert!(motion.is_valid() && error(w, h, &motion, truth) < 0.15, "{motion:?}");
        assert_eq!(motion, register(w, h, &older, &newer), "the same again");
    }

    #[test]
    fn nothing_to_hold_on_to_is_no_motion() {
        // A bright sky with noise, and one drone in it that moves.
        let sky = |seed: usize, x0: f64| {
            render(320, 240, move |x, y| {
                let noise =
                    ((x as usize * 7919 + y as usize * 104_729 + seed) * 2_654_435_761) >> 7;
                let drone = (x - x0).abs() < 12.0 && (y - 90.0).abs() < 6.0;
                if drone { 60.0 + 8.0 * x.sin() } else { 190.0 + y / 8.0 + (noise % 5) as f64 }
            })
        };
        assert_eq!(register(320, 240, &sky(1, 100.0), &sky(5, 104.0)), GlobalMotion::IDENTITY);
        assert_eq!(register(320, 240, &[0; 76_800], &[255; 76_800]), GlobalMotion::IDENTITY);
        for (w, h) in [(0, 0), (0, 9), (1, 1), (7, 5), (16, 16), (640, 3), (29, 31)] {
            let pixels = render(w, h, texture);
            assert_eq!(register(w, h, &pixels, &pixels), GlobalMotion::IDENTITY, "{w}x{h}");
        }
    }

    #[test]
    fn a_still_picture_stays_exactly_where_it_is_and_stride_does_not_matter() {
        let pixels = render(200, 150, texture);
        let motion = register(200, 150, &pixels, &pixels);
        assert!(motion.is_valid() && motion.is_identity());

        let view = |stride| Image::new(&pixels, 141, 101, stride).unwrap();
        let mut results = [139usize, 200].map(|_| GlobalMotion::IDENTITY);
        let packed: Vec<u8> = (0..101).flat_map(|y| view(200).row(y).to_vec()).collect();
        let frames = [Image::packed(&packed, 141, 101).unwrap(), view(200)];
        for (result, frame) in results.iter_mut().zip(frames) {
            let buffer = vec![0; buffer_len(141, 101)];
            let mut registration = Registration::new(141, 101, buffer).unwrap();
            let _ = registration.register(view(199)).unwrap();
            *result = registration.register(frame).unwrap();
        }
        assert_eq!(results[0], results[1]);
    }

    proptest! {
        #[test]
        fn any_bytes_will_do(w in 0..90usize, h in 0..90usize, seed: u64) {
            let mut state = seed | 1;
            let frames: [Vec<u8>; 3] = core::array::from_fn(|_| (0..w * h).map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                (state >> 56) as u8
            }).collect());
            let buffer = vec![0; buffer_len(w, h)];
            let mut registration = Registration::new(w, h, buffer).unwrap();
            for frame in &frames {
                let motion = registration.register(Image::packed(frame, w, h).unwrap()).unwrap();
                let _ = (motion.map(i32::MAX, i32::MIN), motion.map(0, 0));
            }
        }
    }

    #[test]
    fn memory_and_frames_of_another_size_are_refused() {
        let needed = buffer_len(64, 48);
        let refused = Registration::new(64, 48, vec![0; needed - 1]).map(drop);
        assert_eq!(refused, Err(RegistrationError::BufferTooSmall { needed }));
        let (first, second) = (render(64, 48, texture), render(64, 48, |x, y| texture(x + 2.0, y)));
        let [first, second] =
            [&first, &second].map(|pixels| Image::packed(pixels, 64, 48).unwrap());
        let mut registration = Registration::new(64, 48, vec![0; needed]).unwrap();
        let motions = [first, second].map(|frame| registration.register(frame).unwrap());
        let mut again = Registration::new(64, 48, vec![0; needed]).unwrap();
        assert_eq!(again.register(first), Ok(motions[0]));
        let error = RegistrationError::FrameSize { width: 48, height: 64 };
        assert_eq!(again.register(Image::packed(&[0; 48 * 64], 48, 64).unwrap()), Err(error));
        assert_eq!(again.register(second), Ok(motions[1]));
    }
}
