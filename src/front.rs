//! The front end: from frames to the channels of all levels, for the last frames (level 6).
//!
//! Keeps the last [`SLICES`] frames, measures the background's motion between them, takes the differences that remain
//! to older frames, and fills the tables and maps that the scan and the st-cubes read.

use crate::channels::{self, DIFFERENCES};
use crate::cube::SLICES;
use crate::image::Image;
use crate::levels::{self, Geometry, LevelBuffers, Pyramid};
use crate::motion::Slices;
use crate::registration::{Motion, Registration};
use crate::warp;

/// Frames back to which differences are taken: far back for what moves slowly against the background, and to the oldest
/// slice of a cube for what moves fast.
const LAGS: [usize; 2] = [10, SLICES - 1];

/// Frames kept: the newest and as many before it as the longest lag.
pub const KEPT: usize = LAGS[0] + 1;

/// Which parts of the front end are on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Parts {
    /// Align older frames to the newest one by the background's motion.
    pub registration: bool,
    /// Fill the temporal-difference channels; they are 0 otherwise.
    pub temporal: bool,
}

/// Frames in, channels out. Its memory is the caller's and passed to each call.
#[derive(Debug, Clone)]
pub struct FrontEnd {
    width: usize,
    height: usize,
    parts: Parts,
    geometry: Geometry,
    registration: Registration,
    /// Motion from the frame k ago to the one before it.
    motions: [Motion; KEPT - 1],
    /// Frames seen, at most [`KEPT`].
    seen: usize,
    /// Place of the newest frame in the ring of frames.
    place: usize,
    /// Place of the newest frame's tables in the rings of the levels.
    slot: usize,
}

/// The frame's own memory, divided.
struct Divided<'a> {
    frames: &'a mut [u8],
    warped: &'a mut [u8],
    differences: &'a mut [u8],
    registration: &'a mut [u8],
    levels: &'a mut [u8],
}

impl FrontEnd {
    /// For frames of `width` x `height` and the levels of `geometry`, which must be of the same size; no frame seen.
    pub const fn new(width: usize, height: usize, geometry: Geometry, parts: Parts) -> Self {
        Self {
            width,
            height,
            parts,
            geometry,
            registration: Registration::new(width, height),
            motions: [Motion::IDENTITY; KEPT - 1],
            seen: 0,
            place: 0,
            slot: 0,
        }
    }

    /// Bytes of memory.
    pub const fn bytes_len(width: usize, height: usize, geometry: &Geometry) -> usize {
        (KEPT + 1 + DIFFERENCES) * width * height
            + Registration::buffer_len(width, height)
            + geometry.bytes_len()
    }

    /// Words of memory.
    pub const fn words_len(geometry: &Geometry) -> usize {
        geometry.words_len()
    }

    fn divide<'a>(&self, bytes: &'a mut [u8]) -> Divided<'a> {
        let pixels = self.width * self.height;
        let (frames, rest) = bytes.split_at_mut(KEPT * pixels);
        let (warped, rest) = rest.split_at_mut(pixels);
        let (differences, rest) = rest.split_at_mut(DIFFERENCES * pixels);
        let (registration, levels) =
            rest.split_at_mut(Registration::buffer_len(self.width, self.height));
        Divided { frames, warped, differences, registration, levels }
    }

    /// Place in the rings of the levels of the frame `age` frames ago; the oldest one seen stands for those before it.
    fn slot(&self, age: usize) -> usize {
        let age = age.min(self.seen.saturating_sub(1));
        (self.slot + SLICES - age) % SLICES
    }

    /// Place in the ring of frames of the frame `age` frames ago.
    fn place(&self, age: usize) -> usize {
        (self.place + KEPT - age) % KEPT
    }

    /// Whether the background's motion to the frame before could be measured.
    pub fn registered(&self) -> bool {
        self.motions[0].is_valid()
    }

    /// The background's motion to the frame before.
    pub fn motion(&self) -> Motion {
        self.motions[0]
    }

    /// Takes in one frame and measures its motion. Panics if the frame has another size or the memory is not that of
    /// the last call.
    pub fn take(&mut self, frame: Image<'_>, bytes: &mut [u8]) {
        let (width, height) = (self.width, self.height);
        let pixels = width * height;
        self.slot = (self.slot + 1) % SLICES;
        self.place = (self.place + 1) % KEPT;
        self.seen = (self.seen + 1).min(KEPT);
        let Divided { frames, registration, .. } = self.divide(bytes);
        let newest = &mut frames[self.place * pixels..(self.place + 1) * pixels];
        for y in 0..height {
            newest[y * width..(y + 1) * width].copy_from_slice(frame.row(y));
        }
        if self.parts.registration {
            let motion = self.registration.register(frame, registration);
            self.motions.copy_within(..KEPT - 2, 1);
            self.motions[0] = motion;
        }
    }

    /// Takes the differences of the frame just taken to older ones and fills the pictures of all levels; `observer`
    /// hears when the differences are there. Then fill each level with [`FrontEnd::fill_tables`] and
    /// [`FrontEnd::fill_map`], in any order of levels. Panics as [`FrontEnd::take`].
    pub fn build(&self, frame: Image<'_>, bytes: &mut [u8], observer: &mut dyn FnMut()) {
        let (width, height) = (self.width, self.height);
        let pixels = width * height;
        let Divided { frames, warped, differences, levels, .. } = self.divide(bytes);
        let picture = |pixels| {
            Image::packed(pixels, width, height).expect("buffers are made for the frame's size")
        };
        if self.parts.temporal && self.seen > 1 {
            let (far, rest) = differences.split_at_mut(pixels);
            let (near, plain) = rest.split_at_mut(pixels);
            for (lag, out) in LAGS.into_iter().zip([far, near]) {
                let age = lag.min(self.seen - 1);
                let older = &frames[self.place(age) * pixels..][..pixels];
                warp::warp(picture(older), frame, &self.motions[..age], warped);
                warp::temporal_difference(frame, warped, out);
            }
            for (y, out) in plain.chunks_exact_mut(width.max(1)).enumerate() {
                for ((out, a), b) in out.iter_mut().zip(frame.row(y)).zip(&warped[y * width..]) {
                    *out = a.abs_diff(*b);
                }
            }
        } else {
            differences.fill(0);
        }
        observer();
        let differences: &[u8] = differences;
        let images = core::array::from_fn(|i| picture(&differences[i * pixels..(i + 1) * pixels]));
        let mut pyramid = levels::divide(&self.geometry, levels, &mut []);
        levels::build(&self.geometry, &mut pyramid, frame, images);
    }

    /// The levels and their memory.
    pub fn pyramid<'a>(&self, bytes: &'a mut [u8], words: &'a mut [u16]) -> Pyramid<'a> {
        self.pyramid_and_frames(bytes, words).0
    }

    /// The levels and their memory, and the frames of the slices of a cube, newest first; the oldest one seen stands for
    /// those before it.
    pub fn pyramid_and_frames<'a>(
        &self,
        bytes: &'a mut [u8],
        words: &'a mut [u16],
    ) -> (Pyramid<'a>, [Image<'a>; SLICES]) {
        let pixels = self.width * self.height;
        let Divided { frames, levels, .. } = self.divide(bytes);
        let frames: &[u8] = frames;
        let frame = |age: usize| {
            let age = age.min(self.seen.saturating_sub(1));
            Image::packed(&frames[self.place(age) * pixels..][..pixels], self.width, self.height)
                .expect("buffers are made for the frame's size")
        };
        (levels::divide(&self.geometry, levels, words), core::array::from_fn(frame))
    }

    /// Fills the tables of a level for the newest frame.
    pub fn fill_tables(&self, level: &mut LevelBuffers<'_>) {
        level.fill_tables(self.slot);
    }

    /// Noise of the newest frame's differences: from the finest level that is searched, whose tables must be filled.
    pub fn noise(pyramid: &Pyramid<'_>) -> [u32; DIFFERENCES] {
        let finest = pyramid.iter().find(|l| l.level.active);
        finest.map_or([0; DIFFERENCES], |level| channels::noise(&level.newest()))
    }

    /// Fills the scan's map of a level, whose tables must be filled.
    pub fn fill_map(&self, level: &mut LevelBuffers<'_>, noise: &[u32; DIFFERENCES]) {
        level.fill_map(self.slot, noise);
    }

    /// What the cubes of a level are cut from.
    pub fn slices<'a>(&self, level: &'a LevelBuffers<'_>) -> Slices<'a> {
        Slices {
            tables: core::array::from_fn(|age| level.table(self.slot(age))),
            newest: level.newest(),
            motions: core::array::from_fn(|age| self.motions[age]),
            scale: level.level.scale,
        }
    }
}
