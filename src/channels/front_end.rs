//! The front end: from frames to the pictures of all levels, for the last frames (level 6).
//!
//! Keeps what [`History`] says of the last frames, measures the background's motion between them, takes the differences
//! that remain to older frames, and fills the pictures that the scan and the st-cubes read.

use crate::channels::history::{FARTHEST, History, Ring};
use crate::channels::method::Method;
use crate::channels::scale_space::{self, Geometry, Halvings, Picture, Pictures, Pyramid};
use crate::channels::window::SLICES;
use crate::channels::{Newest, Slice};
use crate::image::Image;
use crate::image::pyramid;
use crate::math::{slices, threads};
use crate::registration::warp;
use crate::registration::{self, LEVELS, Motion};

/// Frames before a frame that its channels depend on, at most; with those of the oldest slice of a cube
/// [`SLICES`] - 1 more.
pub const REACH: usize = FARTHEST;

/// Channels of one level of the last frames, of which the slices of a st-cube are cut.
#[derive(Debug, Clone, Copy)]
pub struct Slices<'a> {
    /// Frames on the level, newest first; frames not yet seen repeat the oldest. Slices that are not there stay empty.
    pub slices: [Option<Slice<'a>>; SLICES],
    /// The newest frame on the level.
    pub newest: Newest<'a>,
    /// Motion of the background from the frame k ago to the one before it.
    pub motions: [Motion; SLICES - 1],
    /// Frame pixels of a pixel of the level, Q16.
    pub scale: u32,
}

/// Frames in, channels out. Its memory is the caller's and passed to each call.
#[derive(Debug, Clone)]
pub struct FrontEnd {
    width: usize,
    height: usize,
    method: Method,
    geometry: Geometry,
    /// Motion from the frame k ago to the one before it.
    motions: [Motion; FARTHEST],
    /// Frames seen, at most one more than there are motions.
    seen: usize,
    frames: Ring,
    halves: Ring,
    coarse: Ring,
    slots: Ring,
}

/// The memory, divided. Rings of frames: whole, halved once, halved twice and three times.
struct Divided<'a> {
    frames: &'a mut [u8],
    halves: &'a mut [u8],
    coarse: &'a mut [u8],
    levels: &'a mut [u8],
    scratch: &'a mut [u8],
}

/// Pixels of a frame halved so many times.
const fn pixels(width: usize, height: usize, octave: usize) -> usize {
    (width >> octave) * (height >> octave)
}

/// Pixels of a frame halved twice and three times.
const fn coarse_len(width: usize, height: usize) -> usize {
    pixels(width, height, 2) + pixels(width, height, 3)
}

impl FrontEnd {
    /// For frames of `width` x `height` and the levels of `geometry`, which must be of the same size; no frame seen.
    pub const fn new(width: usize, height: usize, geometry: Geometry, method: Method) -> Self {
        let history = geometry.history();
        Self {
            width,
            height,
            method,
            geometry,
            motions: [Motion::IDENTITY; FARTHEST],
            seen: 0,
            frames: Ring::new(history.frames()),
            halves: Ring::new(history.halves()),
            coarse: Ring::new(history.coarse()),
            slots: Ring::new(history.slices()),
        }
    }

    /// Bytes of memory, of which `scratch` are free between the calls.
    pub const fn bytes_len(
        width: usize,
        height: usize,
        geometry: &Geometry,
        scratch: usize,
    ) -> usize {
        let history = geometry.history();
        // A warped frame is needed only while the scratch memory is not.
        let warped = pixels(width, height, history.octave() as usize);
        history.frames() * width * height
            + history.halves() * pixels(width, height, 1)
            + history.coarse() * coarse_len(width, height)
            + geometry.bytes_len()
            + if scratch > warped { scratch } else { warped }
    }

    fn divide<'a>(&self, bytes: &'a mut [u8]) -> Divided<'a> {
        let (width, height, history) = (self.width, self.height, self.geometry.history());
        let (frames, rest) = slices::split_mut(bytes, history.frames() * width * height);
        let (halves, rest) = slices::split_mut(rest, history.halves() * pixels(width, height, 1));
        let (coarse, rest) = slices::split_mut(rest, history.coarse() * coarse_len(width, height));
        let (levels, scratch) = slices::split_mut(rest, self.geometry.bytes_len());
        Divided { frames, halves, coarse, levels, scratch }
    }

    /// The age of the oldest frame seen, if `age` is older.
    fn seen(&self, age: usize) -> usize {
        age.min(self.seen.saturating_sub(1))
    }

    /// Whether there may be several threads: a half history is for processors with one core.
    fn parallel(&self) -> bool {
        self.geometry.history() == History::Full
    }

    /// Forgets the frames seen.
    pub fn restart(&mut self) {
        self.motions = [Motion::IDENTITY; FARTHEST];
        self.seen = 0;
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
    #[inline(never)]
    pub fn take(&mut self, frame: Image<'_>, bytes: &mut [u8]) {
        let (width, height) = (self.width, self.height);
        for ring in [&mut self.frames, &mut self.halves, &mut self.coarse, &mut self.slots] {
            ring.advance();
        }
        self.seen = (self.seen + 1).min(FARTHEST + 1);
        let Divided { frames, halves, coarse, .. } = self.divide(bytes);
        let half = place(halves, pixels(width, height, 1), self.halves.place(0));
        let keep = || {
            if frames.is_empty() {
                return;
            }
            let newest = place(frames, width * height, self.frames.place(0));
            for (y, row) in slices::rows_mut(newest, width).enumerate() {
                slices::copy(frame.row(y), row);
            }
        };
        let halve = || {
            pyramid::halve(frame, half);
        };
        threads::both(self.parallel(), keep, halve);
        let half: &[u8] = at(halves, pixels(width, height, 1), self.halves.place(0));
        let coarse_half = place(coarse, coarse_len(width, height), self.coarse.place(0));
        let (quarter, eighth) = slices::split_mut(coarse_half, pixels(width, height, 2));
        pyramid::halve(picture(half, width, height, 1), quarter);
        pyramid::halve(picture(quarter, width, height, 2), eighth);
        if self.method.registration {
            let motion = if self.seen > 1 {
                let [new, old] = [0, 1].map(|age| self.coarse_frames(halves, coarse, age));
                let search = match self.geometry.history() {
                    History::Full => registration::Search::Dense,
                    History::Half => registration::Search::Sparse,
                };
                registration::measure((width, height), search, &new, &old)
            } else {
                Motion::IDENTITY
            };
            self.motions.copy_within(..FARTHEST - 1, 1);
            self.motions[0] = motion;
        }
    }

    /// The halves of one of the last frames, finest first.
    fn coarse_frames<'a>(
        &self,
        halves: &'a [u8],
        coarse: &'a [u8],
        age: usize,
    ) -> [Image<'a>; LEVELS] {
        let (width, height) = (self.width, self.height);
        let half = at(halves, pixels(width, height, 1), self.halves.place(age));
        let coarse = at(coarse, coarse_len(width, height), self.coarse.place(age));
        let (quarter, eighth) = slices::split(coarse, pixels(width, height, 2));
        let picture = |(pixels, octave)| picture(pixels, width, height, octave);
        [(half, 1), (quarter, 2), (eighth, 3)].map(picture)
    }

    /// A frame that is `age` frames old, and its halves.
    fn halvings<'a>(
        &self,
        frame: Image<'a>,
        halves: &'a [u8],
        coarse: &'a [u8],
        age: usize,
    ) -> Halvings<'a> {
        let [half, quarter, eighth] = self.coarse_frames(halves, coarse, age);
        [frame, half, quarter, eighth]
    }

    /// Takes the differences of the frame just taken to older ones and fills the pictures of all levels; `observer`
    /// hears when the differences are there. Panics as [`FrontEnd::take`].
    #[inline(never)]
    pub fn build(&self, frame: Image<'_>, bytes: &mut [u8], observer: &mut dyn FnMut()) {
        let geometry = &self.geometry;
        let slot = self.slots.place(0);
        let Divided { frames, halves, coarse, levels, scratch } = self.divide(bytes);
        if !geometry.levels().is_empty() {
            let kinds = [Picture::Far, Picture::Near, Picture::Plain];
            if self.method.temporal && self.seen > 1 {
                let (octave, parallel) = (geometry.history().octave(), self.parallel());
                let older = |age| match geometry.history() {
                    History::Full => {
                        let pixels = at(frames, self.width * self.height, self.frames.place(age));
                        picture(pixels, self.width, self.height, 0)
                    }
                    History::Half => {
                        let length = pixels(self.width, self.height, 1);
                        let pixels = at(halves, length, self.halves.place(age));
                        picture(pixels, self.width, self.height, 1)
                    }
                };
                let newest = older(0);
                let warped = slices::part_mut(scratch, 0, newest.width() * newest.height());
                let [far, near] = geometry.history().lags().map(|lag| self.seen(lag));
                let chain = |age: usize| &self.motions[..age];
                warp::warp(older(far), newest, octave, chain(far), parallel, warped);
                let [far_place, near_place, plain_place] =
                    kinds.map(|kind| geometry.place(0, kind, slot));
                let out = slices::of_mut(levels, far_place);
                warp::temporal_difference(newest, warped, parallel, out);
                warp::warp(older(near), newest, octave, chain(near), parallel, warped);
                // The plain difference lies behind the others.
                let (before, plain) = slices::split_mut(levels, plain_place.start);
                let out = slices::of_mut(before, near_place);
                let warped: &[u8] = warped;
                threads::both(
                    parallel,
                    || warp::temporal_difference(newest, warped, parallel, out),
                    || warp::plain_difference(newest, warped, parallel, plain),
                );
            } else {
                for kind in kinds {
                    slices::of_mut(levels, geometry.place(0, kind, slot)).fill(0);
                }
            }
        }
        observer();
        scale_space::build(geometry, levels, &self.halvings(frame, halves, coarse, 0), slot);
    }

    /// The levels of the frame just taken, and the memory that is free until the next one.
    pub fn pyramid<'a>(
        &'a self,
        frame: Image<'a>,
        bytes: &'a mut [u8],
    ) -> (Pyramid<'a>, &'a mut [u8]) {
        let Divided { frames, halves, coarse, levels, scratch } = self.divide(bytes);
        let (frames, halves, coarse): (&[u8], &[u8], &[u8]) = (frames, halves, coarse);
        let frame_of = |age: usize| match self.geometry.history() {
            History::Full => {
                let age = self.seen(age);
                let whole = at(frames, self.width * self.height, self.frames.place(age));
                self.halvings(picture(whole, self.width, self.height, 0), halves, coarse, age)
            }
            History::Half => self.halvings(frame, halves, coarse, 0),
        };
        let slots = match self.geometry.history() {
            History::Full => core::array::from_fn(|age| self.slots.place(self.seen(age))),
            History::Half => [0; SLICES],
        };
        let pyramid = Pyramid::new(&self.geometry, levels, core::array::from_fn(frame_of), slots);
        (pyramid, scratch)
    }

    /// What the cubes of a level are cut from.
    pub fn slices<'a>(&self, level: &Pictures<'a>) -> Slices<'a> {
        Slices {
            slices: level.slices,
            newest: level.newest,
            motions: core::array::from_fn(|age| self.motions[age]),
            scale: level.level.scale,
        }
    }
}

/// Element `place` of a ring of pictures.
fn at(ring: &[u8], length: usize, place: usize) -> &[u8] {
    slices::part(ring, place * length, length)
}

/// As [`at`], to write.
fn place(ring: &mut [u8], length: usize, place: usize) -> &mut [u8] {
    slices::part_mut(ring, place * length, length)
}

/// A frame of `width` x `height` halved so many times.
fn picture(pixels: &[u8], width: usize, height: usize, octave: usize) -> Image<'_> {
    scale_space::packed(pixels, (width >> octave, height >> octave))
}
