//! Visits the sampled frames of all clips with the front end's channels after each.

use super::footage::Footage;
use super::look::Look;
use super::playback::Playback;
use crate::channels::front_end::{self, FrameChannels, REACH};
use crate::channels::scale_space::Pyramid;
use crate::channels::window::SLICES;
use crate::detector::Config;
use crate::shell::error::Error;
use crate::shell::formats::clips::TruthBox;
use crate::shell::pipeline::{Memory, PipelineError};
use crate::shell::sources::Frame;
use crate::shell::support::parallel;
use crate::shell::support::random::Random;
use std::vec::Vec;

/// Sampled frames in a row that are shown with the same look.
const SEGMENT: usize = 6;

/// Slices that are computed for a sampled frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Depth {
    /// Channels of the sampled frame only.
    Newest,
    /// Tables of all slices too, as the detector has them in flight.
    Cube,
}

/// A sampled frame as the front end shows it.
#[derive(Debug)]
pub struct SampledView<'a> {
    /// A number unlike that of every other sampled frame.
    pub number: u32,
    /// The boxes of the frame as it looks.
    pub boxes: Vec<TruthBox>,
    /// Whether objects were pasted into it.
    pub pasted: bool,
    /// Whether it is of a clip that is held back.
    pub held_back: bool,
    /// Channels of the frame, from the detector's own front end.
    pub channels: FrameChannels<'a>,
}

/// Frames to visit, and their augmentation.
#[derive(Debug, Clone, Copy)]
pub struct Selection {
    /// Number of slices whose channels are computed.
    pub depth: Depth,
    /// Every `part.1`th sampled frame of a clip, beginning with the `part.0`th.
    pub part: (usize, usize),
    /// Seed of the looks; none shows the frames as they are. Held-back clips are always shown as they are.
    pub looks: Option<u64>,
}

impl Selection {
    /// The frames of a clip that are shown.
    pub fn frames(&self, clip: &Footage) -> Vec<usize> {
        clip.samples.iter().copied().skip(self.part.0 % self.part.1).step_by(self.part.1).collect()
    }

    /// Augmentation of the frames of a segment.
    fn look(&self, clip: &Footage, segment: usize) -> Look {
        match self.looks.filter(|_| !clip.held_back) {
            Some(seed) => {
                let key = (clip.number * 1024 + segment) as u64;
                Look::draw(&mut Random::new(seed ^ key.rotate_left(32)))
            }
            None => Look::PLAIN,
        }
    }
}

/// Shows the selected frames to `work`, clips in parallel, and passes its results of each clip to `pack`. Results come in
/// the order of the clips, whatever the number of threads.
///
/// # Errors
/// [`Error`] of the first clip that cannot be decoded, or of `pack`.
pub fn visit<T: Send, P: Send>(
    footage: &[&Footage],
    config: impl Fn(usize, usize) -> Config + Sync,
    selection: &Selection,
    tick: impl Fn() + Sync,
    work: impl Fn(&SampledView<'_>, &Pyramid<'_>) -> Vec<T> + Sync,
    pack: impl Fn(Vec<T>) -> Result<P, Error> + Sync,
) -> Result<Vec<P>, Error> {
    let results = parallel::map(footage.to_vec(), |clip: &Footage| {
        let mut results = Vec::new();
        let frames = selection.frames(clip);
        if !frames.is_empty() {
            let mut playback = Playback::open(clip)?;
            for (segment, frames) in frames.chunks(SEGMENT).enumerate() {
                let look = selection.look(clip, segment);
                show(
                    clip,
                    &mut playback,
                    (frames, selection.depth, look),
                    &config,
                    |view, pyramid| {
                        results.extend(work(view, pyramid));
                        tick();
                    },
                )?;
            }
        }
        pack(results)
    });
    results.into_iter().collect()
}

/// Shows frames of a clip with one look.
fn show(
    clip: &Footage,
    playback: &mut Playback<'_>,
    (frames, depth, look): (&[usize], Depth, Look),
    config: &impl Fn(usize, usize) -> Config,
    mut work: impl FnMut(&SampledView<'_>, &Pyramid<'_>),
) -> Result<(), Error> {
    let (width, height) = look.size(clip.size.0, clip.size.1);
    let config = config(width, height);
    let mut memory = Memory::new(&config);
    let refused =
        |frame, source| PipelineError::Detector { input: clip.input.clone(), frame, source };
    let mut front_end = config.front_end(memory.bytes()).map_err(|source| refused(1, source))?;
    let mut last = 0;
    let mut picture = Frame::default();
    let slices = if depth == Depth::Cube { SLICES } else { 1 };
    for &frame in frames {
        let start = frame.saturating_sub(slices - 1 + REACH).max(1);
        if last == 0 || start > last + 1 {
            front_end.restart();
            last = start - 1;
        }
        for number in last + 1..=frame {
            look.apply(playback.frame(number)?, &mut picture);
            let refused =
                |error: front_end::RegistrationError| refused(number as u64, error.into());
            // Older frames are only there to be compared with.
            if number + slices <= frame {
                front_end.skip(picture.view()).map_err(refused)?;
                continue;
            }
            let (channels, _) = front_end.process(picture.view(), &mut || {}).map_err(refused)?;
            if number == frame {
                let truth = |truth| look.truth(truth, clip.size.0);
                let view = SampledView {
                    number: (clip.number * 4096 + frame) as u32,
                    boxes: clip.boxes[frame - 1].iter().map(truth).collect(),
                    pasted: clip.pasted,
                    held_back: clip.held_back,
                    channels,
                };
                work(&view, &channels.pyramid);
            }
        }
        last = frame;
    }
    Ok(())
}
