//! Frames in rings of memory: which frame lies where, its differences to older ones, the levels of its pyramid.

use crate::channels::history::{FARTHEST, FrameRing, History};
use crate::channels::method::Method;
use crate::channels::scale_space::{self, Halvings, Plane, Pyramid, PyramidLayout};
use crate::channels::window::SLICES;
use crate::image::{Image, pyramid};
use crate::math::{slices, threads};
use crate::registration::{self, GlobalMotion, LEVELS, warp};

/// All of a front end but its memory: which frames are where in it. Its functions panic if the memory is shorter than
/// `FrontEnd::bytes_len` or the frame has another size than the levels are laid out for.
#[derive(Debug, Clone)]
pub(super) struct FrontEndState {
    width: usize,
    height: usize,
    method: Method,
    pub(super) geometry: PyramidLayout,
    /// Motion from the frame k ago to the one before it.
    pub(super) motions: [GlobalMotion; FARTHEST],
    /// Frames seen, at most one more than there are motions.
    seen: usize,
    /// Frames in a row, up to the newest, of which the channels were computed; at most [`SLICES`].
    pub(super) filled: usize,
    frames: FrameRing,
    halves: FrameRing,
    coarse: FrameRing,
    slots: FrameRing,
}

/// The memory, divided. Rings of frames: whole, halved once, halved twice and three times.
pub(super) struct Divided<'a> {
    frames: &'a mut [u8],
    halves: &'a mut [u8],
    coarse: &'a mut [u8],
    levels: &'a mut [u8],
    scratch: &'a mut [u8],
}

/// Pixels of a frame of `width` x `height` that is halved `octave` times.
pub(super) const fn pixels(width: usize, height: usize, octave: usize) -> usize {
    (width >> octave) * (height >> octave)
}

/// Pixels of a frame halved twice and three times.
pub(super) const fn coarse_len(width: usize, height: usize) -> usize {
    pixels(width, height, 2) + pixels(width, height, 3)
}

impl FrontEndState {
    pub(super) const fn new(geometry: PyramidLayout, method: Method) -> Self {
        let ((width, height), history) = (geometry.frame(), geometry.history());
        Self {
            width,
            height,
            method,
            geometry,
            motions: [GlobalMotion::IDENTITY; FARTHEST],
            seen: 0,
            filled: 0,
            frames: FrameRing::new(history.frames()),
            halves: FrameRing::new(history.halves()),
            coarse: FrameRing::new(history.coarse()),
            slots: FrameRing::new(history.slices()),
        }
    }

    pub(super) fn divide<'a>(&self, bytes: &'a mut [u8]) -> Divided<'a> {
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

    /// The age of the oldest slice, if `age` is older.
    fn slice(&self, age: usize) -> usize {
        age.min(self.filled.saturating_sub(1))
    }

    /// Whether there may be several threads: a half history is for processors with one core.
    fn parallel(&self) -> bool {
        self.geometry.history() == History::Full
    }

    pub(super) fn restart(&mut self) {
        self.motions = [GlobalMotion::IDENTITY; FARTHEST];
        (self.seen, self.filled) = (0, 0);
    }

    /// Keeps one frame and measures the background's motion to the one before.
    #[inline(never)]
    pub(super) fn push_frame(&mut self, frame: Image<'_>, bytes: &mut [u8]) {
        let (width, height) = (self.width, self.height);
        for ring in [&mut self.frames, &mut self.halves, &mut self.coarse, &mut self.slots] {
            ring.advance();
        }
        self.seen = (self.seen + 1).min(FARTHEST + 1);
        let Divided { frames, halves, coarse, .. } = self.divide(bytes);
        let half = at_mut(halves, pixels(width, height, 1), self.halves.slot(0));
        let keep = || {
            if frames.is_empty() {
                return;
            }
            let newest = at_mut(frames, width * height, self.frames.slot(0));
            for (y, row) in slices::rows_mut(newest, width).enumerate() {
                slices::copy(frame.row(y), row);
            }
        };
        let halve = || {
            pyramid::halve(frame, half);
        };
        threads::both(self.parallel(), keep, halve);
        let half: &[u8] = at(halves, pixels(width, height, 1), self.halves.slot(0));
        let coarse_half = at_mut(coarse, coarse_len(width, height), self.coarse.slot(0));
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
                GlobalMotion::IDENTITY
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
        let half = at(halves, pixels(width, height, 1), self.halves.slot(age));
        let coarse = at(coarse, coarse_len(width, height), self.coarse.slot(age));
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

    /// Takes the differences of the frame just taken to older ones, calls `registered`, and fills the pictures of all
    /// levels.
    #[inline(never)]
    pub(super) fn build(&self, frame: Image<'_>, bytes: &mut [u8], registered: &mut dyn FnMut()) {
        let geometry = &self.geometry;
        let slot = self.slots.slot(0);
        let Divided { frames, halves, coarse, levels, scratch } = self.divide(bytes);
        if !geometry.levels().is_empty() {
            let kinds = [Plane::Far, Plane::Near, Plane::Plain];
            if self.method.temporal && self.seen > 1 {
                let (octave, parallel) = (geometry.history().octave(), self.parallel());
                let older = |age| match geometry.history() {
                    History::Full => {
                        let pixels = at(frames, self.width * self.height, self.frames.slot(age));
                        picture(pixels, self.width, self.height, 0)
                    }
                    History::Half => {
                        let length = pixels(self.width, self.height, 1);
                        let pixels = at(halves, length, self.halves.slot(age));
                        picture(pixels, self.width, self.height, 1)
                    }
                };
                let newest = older(0);
                let warped = slices::part_mut(scratch, 0, newest.width() * newest.height());
                let [far, near] = geometry.history().lags().map(|lag| self.seen(lag));
                let chain = |age: usize| &self.motions[..age];
                warp::warp(older(far), newest, octave, chain(far), parallel, warped);
                let [far_place, near_place, plain_place] =
                    kinds.map(|kind| geometry.byte_range(0, kind, slot));
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
                    slices::of_mut(levels, geometry.byte_range(0, kind, slot)).fill(0);
                }
            }
        }
        registered();
        scale_space::build(geometry, levels, &self.halvings(frame, halves, coarse, 0), slot);
    }

    /// The levels of the frame just taken, and the memory that is free until the next one.
    pub(super) fn pyramid<'a>(
        &'a self,
        frame: Image<'a>,
        bytes: &'a mut [u8],
    ) -> (Pyramid<'a>, &'a mut [u8]) {
        let Divided { frames, halves, coarse, levels, scratch } = self.divide(bytes);
        let (frames, halves, coarse): (&[u8], &[u8], &[u8]) = (frames, halves, coarse);
        let frame_of = |age: usize| match self.geometry.history() {
            History::Full => {
                let age = self.slice(age);
                let whole = at(frames, self.width * self.height, self.frames.slot(age));
                self.halvings(picture(whole, self.width, self.height, 0), halves, coarse, age)
            }
            History::Half => self.halvings(frame, halves, coarse, 0),
        };
        let slots = match self.geometry.history() {
            History::Full => core::array::from_fn(|age| self.slots.slot(self.slice(age))),
            History::Half => [0; SLICES],
        };
        let pyramid = Pyramid::new(&self.geometry, levels, core::array::from_fn(frame_of), slots);
        (pyramid, scratch)
    }
}

/// Picture number `place` of a ring of pictures of `length` bytes each.
fn at(ring: &[u8], length: usize, place: usize) -> &[u8] {
    slices::part(ring, place * length, length)
}

/// As [`at`], to write.
fn at_mut(ring: &mut [u8], length: usize, place: usize) -> &mut [u8] {
    slices::part_mut(ring, place * length, length)
}

/// The picture of a frame of `width` x `height` halved `octave` times.
fn picture(pixels: &[u8], width: usize, height: usize, octave: usize) -> Image<'_> {
    scale_space::packed(pixels, (width >> octave, height >> octave))
}
