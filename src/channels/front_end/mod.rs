//! The front end: from frames to the pyramids of grey and difference images that scan and st-cubes read.
//!
//! It keeps the last frames ([`History`](crate::channels::history::History) says how many, at which size), measures the
//! background's motion between them, takes the temporal differences that remain after that motion is removed, and fills the
//! levels of the scale space.

mod state;

use crate::channels::history::FARTHEST;
use crate::channels::method::Method;
use crate::channels::scale_space::{LevelView, Pyramid, PyramidLayout};
use crate::channels::window::SLICES;
use crate::channels::{NewestChannels, Slice};
use crate::image::Image;
use crate::registration::GlobalMotion;
use state::{FrontEndState, coarse_len, pixels};

pub use crate::registration::RegistrationError;

/// Longest temporal lag of any channel, in frames. A st-cube depends on [`SLICES`] - 1 frames more, those of its oldest
/// slice.
pub const REACH: usize = FARTHEST;

/// Channels of one level of the last frames, of which the slices of a st-cube are cut.
#[derive(Debug, Clone, Copy)]
pub struct Slices<'a> {
    /// Frames on the level, newest first; frames not yet seen repeat the oldest. Slices that are not there stay empty.
    pub slices: [Option<Slice<'a>>; SLICES],
    /// The newest frame on the level.
    pub newest: NewestChannels<'a>,
    /// Motion of the background from the frame k ago to the one before it.
    pub motions: [GlobalMotion; SLICES - 1],
    /// Frame pixels of a pixel of the level, Q16.
    pub scale: u32,
}

/// Frames in, channels out. Owns its memory while it lives.
///
/// Every frame is passed to [`FrontEnd::process`], or to [`FrontEnd::skip`] if its channels are not needed; any order of
/// the two is valid.
///
/// ```
/// use lookout::channels::front_end::FrontEnd;
/// use lookout::channels::method::Method;
/// use lookout::channels::scale_space::PyramidLayout;
/// use lookout::image::Image;
///
/// let method = Method::of_header(include_bytes!("../../../models/lookout.lkm")).unwrap();
/// // Targets of 10 to 100 pixels, two levels an octave.
/// let geometry = PyramidLayout::new(96, 80, 10, 100, 2, method.history);
/// let mut memory = vec![0; FrontEnd::bytes_len(&geometry, 0)];
/// let mut front_end = FrontEnd::new(geometry, method, &mut memory)?;
///
/// let grey = [90; 96 * 80];
/// let (channels, _free) = front_end.process(Image::packed(&grey, 96, 80)?, &mut || {})?;
/// let finest = channels.pyramid.level(0);
/// assert_eq!(finest.newest.slice.grey.row(7)[..3], [90; 3]);
/// // A uniform picture has no corners to measure a motion by.
/// assert!(!channels.registered());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct FrontEnd<'b> {
    state: FrontEndState,
    memory: &'b mut [u8],
}

impl<'b> FrontEnd<'b> {
    /// A front end for the levels of `geometry` that has seen no frame.
    ///
    /// # Errors
    /// [`RegistrationError::BufferTooSmall`] if `memory` has fewer than [`FrontEnd::bytes_len`] bytes. Bytes beyond that
    /// are scratch memory of [`FrontEnd::process`].
    pub fn new(
        geometry: PyramidLayout,
        method: Method,
        memory: &'b mut [u8],
    ) -> Result<Self, RegistrationError> {
        let needed = Self::bytes_len(&geometry, 0);
        if memory.len() < needed {
            return Err(RegistrationError::BufferTooSmall { needed });
        }
        Ok(Self { state: FrontEndState::new(geometry, method), memory })
    }

    /// Bytes of memory, of which at least `scratch` are free between two frames.
    pub const fn bytes_len(geometry: &PyramidLayout, scratch: usize) -> usize {
        let ((width, height), history) = (geometry.frame(), geometry.history());
        // A warped frame is needed only while the scratch memory is not.
        let warped = pixels(width, height, history.octave() as usize);
        history.frames() * width * height
            + history.halves() * pixels(width, height, 1)
            + history.coarse() * coarse_len(width, height)
            + geometry.bytes_len()
            + if scratch > warped { scratch } else { warped }
    }

    /// Forgets all frames: the next one is the first of a history.
    pub fn restart(&mut self) {
        self.state.restart();
    }

    /// Whether a frame has the right size.
    ///
    /// # Errors
    /// [`RegistrationError::FrameSize`] if not.
    pub fn check(&self, frame: Image<'_>) -> Result<(), RegistrationError> {
        let (width, height) = (frame.width(), frame.height());
        if (width, height) == self.state.geometry.frame() {
            Ok(())
        } else {
            Err(RegistrationError::FrameSize { width, height })
        }
    }

    /// The channels of the next frame, and the memory that is free until the one after it. `registered` is called when
    /// the background's motion is measured and the differences are taken, before the levels are filled.
    ///
    /// # Errors
    /// [`RegistrationError::FrameSize`]; the frame is not taken then.
    pub fn process<'a>(
        &'a mut self,
        frame: Image<'a>,
        registered: &mut dyn FnMut(),
    ) -> Result<(FrameChannels<'a>, &'a mut [u8]), RegistrationError> {
        self.check(frame)?;
        let Self { state, memory } = self;
        state.push_frame(frame, memory);
        state.filled = (state.filled + 1).min(SLICES);
        state.build(frame, memory, registered);
        let (pyramid, scratch) = state.pyramid(frame, memory);
        Ok((FrameChannels { pyramid, motions: &state.motions }, scratch))
    }

    /// Takes the next frame without computing its channels: later frames are compared with it, but it is no slice of
    /// their st-cubes. The slices of the next frames are as if the history began after this one.
    ///
    /// # Errors
    /// As [`FrontEnd::process`].
    pub fn skip(&mut self, frame: Image<'_>) -> Result<(), RegistrationError> {
        self.check(frame)?;
        self.state.push_frame(frame, self.memory);
        self.state.filled = 0;
        Ok(())
    }

    /// Gives the memory back.
    pub fn release(self) -> &'b mut [u8] {
        self.memory
    }
}

/// Channels of the newest frame.
#[derive(Debug, Clone, Copy)]
pub struct FrameChannels<'a> {
    /// The levels of the newest frame and of the slices before it.
    pub pyramid: Pyramid<'a>,
    motions: &'a [GlobalMotion; FARTHEST],
}

impl<'a> FrameChannels<'a> {
    /// Whether the background's motion since the frame before could be measured.
    pub fn registered(&self) -> bool {
        self.motion().is_valid()
    }

    /// The background's motion to the frame before; the identity where it could not be measured.
    pub fn motion(&self) -> GlobalMotion {
        self.motions[0]
    }

    /// The slices that st-cubes of a level are cut from.
    pub fn slices(&self, level: &LevelView<'a>) -> Slices<'a> {
        Slices {
            slices: level.slices,
            newest: level.newest,
            motions: core::array::from_fn(|age| self.motions[age]),
            scale: level.level.scale,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::channels::history::History;
    use crate::channels::method::Alignment;
    use std::vec;
    use std::vec::Vec;

    const WIDTH: usize = 96;
    const HEIGHT: usize = 80;

    const METHOD: Method = Method {
        registration: true,
        temporal: true,
        alignment: Alignment::Regressors,
        stcube: true,
        persistence: true,
        scales_per_octave: 2,
        history: History::Full,
    };

    fn geometry(history: History) -> PyramidLayout {
        PyramidLayout::new(WIDTH, HEIGHT, 10, 40, 2, history)
    }

    /// Frame `number` of a smooth texture that moves a pixel a frame.
    fn frame(number: usize) -> Vec<u8> {
        let value = |x: usize, y: usize| {
            ((x / 5 * 37) ^ (y / 4 * 59)).wrapping_mul(2_654_435_761) as u8 / 2
        };
        (0..WIDTH * HEIGHT).map(|n| value(n % WIDTH + number, n / WIDTH)).collect()
    }

    fn view(pixels: &[u8]) -> Image<'_> {
        Image::packed(pixels, WIDTH, HEIGHT).unwrap()
    }

    /// All pixels that scan and st-cubes may read, level by level.
    fn pixels(channels: &FrameChannels<'_>, slices: usize) -> Vec<Vec<u8>> {
        let rows =
            |image: Image<'_>| (0..image.height()).flat_map(|y| image.row(y).to_vec()).collect();
        let mut all = Vec::new();
        for level in channels.pyramid.searched() {
            let older = level.slices.into_iter().take(slices).flatten();
            let images = older.flat_map(|slice| [slice.grey, slice.near.picture]);
            let newest = [level.newest.far.picture, level.newest.plain.picture];
            all.extend(images.chain(newest).map(rows));
        }
        all
    }

    #[test]
    fn skipped_frames_count_for_differences() {
        for history in [History::Full, History::Half] {
            let geometry = geometry(history);
            let mut memories = [(); 2].map(|()| vec![0; FrontEnd::bytes_len(&geometry, 0)]);
            let [all, some] = &mut memories;
            let mut all = FrontEnd::new(geometry, METHOD, all).unwrap();
            let mut some = FrontEnd::new(geometry, METHOD, some).unwrap();
            for number in 0..30 {
                let frame = frame(number);
                let (want, _) = all.process(view(&frame), &mut || {}).unwrap();
                // Runs of three frames that are processed, of six that are skipped.
                let run = number % 9;
                if run < 6 {
                    some.skip(view(&frame)).unwrap();
                    continue;
                }
                let (got, _) = some.process(view(&frame), &mut || {}).unwrap();
                assert_eq!(got.motion(), want.motion());
                let filled = run - 5;
                assert_eq!(pixels(&got, filled), pixels(&want, filled), "{history:?} {number}");
                // Slices from before the run repeat its oldest frame.
                if history == History::Full {
                    let level = got.pyramid.level(0);
                    let rows =
                        level.slices.map(|slice| slice.unwrap().near.picture.row(40).to_vec());
                    assert!(rows[filled..].iter().all(|row| *row == rows[filled - 1]), "{number}");
                }
            }
        }
    }

    #[test]
    fn what_does_not_fit_is_refused_and_changes_nothing() {
        let geometry = geometry(History::Full);
        let needed = FrontEnd::bytes_len(&geometry, 0);
        let refused = FrontEnd::new(geometry, METHOD, &mut vec![0; needed - 1]).unwrap_err();
        assert_eq!(refused, RegistrationError::BufferTooSmall { needed });
        let mut memory = vec![0; needed];
        let mut front_end = FrontEnd::new(geometry, METHOD, &mut memory).unwrap();
        let pixels_of = |front_end: &mut FrontEnd<'_>, number| {
            pixels(&front_end.process(view(&frame(number)), &mut || {}).unwrap().0, 4)
        };
        pixels_of(&mut front_end, 0);
        let want = pixels_of(&mut front_end, 1);
        front_end.restart();
        pixels_of(&mut front_end, 0);
        let small = frame(9);
        let small = Image::packed(&small, HEIGHT, WIDTH).unwrap();
        let error = RegistrationError::FrameSize { width: HEIGHT, height: WIDTH };
        assert_eq!(front_end.skip(small), Err(error));
        assert_eq!(front_end.process(small, &mut || {}).map(|_| ()), Err(error));
        assert_eq!(pixels_of(&mut front_end, 1), want);
        assert_eq!(front_end.release().len(), needed);
    }
}
