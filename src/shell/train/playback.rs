//! A clip's frames, decoded as they are asked for: memory holds the last few alone.

use super::TrainError;
use super::footage::{Footage, HISTORY};
use crate::shell::error::Error;
use crate::shell::pipeline::scaled::Scaling;
use crate::shell::sources::{self, Frame, FrameSource};
use std::boxed::Box;
use std::collections::VecDeque;
use std::vec::Vec;

/// Bytes of a run's header: a run goes on over fewer unchanged pixels than that.
const RUN_HEADER: usize = 6;

/// Decodes a clip from its first frame on.
pub struct Playback<'a> {
    clip: &'a Footage,
    source: Box<dyn FrameSource>,
    decoded: Frame,
    /// The last frames as the detector sees them, the newest last; empty where no sampled frame depends on it.
    recent: VecDeque<Frame>,
    /// Frames decoded.
    read: usize,
    patch: Vec<u8>,
}

impl<'a> Playback<'a> {
    /// Before the first frame of `clip`.
    ///
    /// # Errors
    /// [`Error`] of a source that cannot be opened.
    pub fn open(clip: &'a Footage) -> Result<Self, Error> {
        let source = sources::open(&clip.input)?;
        let (decoded, recent) = (Frame::default(), VecDeque::new());
        Ok(Self { clip, source, decoded, recent, read: 0, patch: Vec::new() })
    }

    /// Frame `number`, from 1: any later one, or one of the last [`HISTORY`] before the newest that was asked for. Empty
    /// where no sampled frame depends on it.
    ///
    /// # Errors
    /// [`Error`] when it cannot be decoded, [`TrainError::Gone`] when it is not there any more.
    pub fn frame(&mut self, number: usize) -> Result<&Frame, Error> {
        while self.read < number {
            self.decode()?;
        }
        let age = self.read - number;
        let place = self.recent.len().checked_sub(age + 1);
        place.and_then(|place| self.recent.get(place)).ok_or_else(|| self.gone(number))
    }

    fn decode(&mut self) -> Result<(), Error> {
        if !self.source.next_frame(&mut self.decoded)? {
            return Err(self.gone(self.read + 1));
        }
        let mut seen = match self.recent.len() > HISTORY {
            true => self.recent.pop_front().unwrap_or_default(),
            false => Frame::default(),
        };
        if self.clip.needs(self.read) {
            let scaling = Scaling::new(self.clip.frame, self.decoded.width, self.decoded.height);
            scaling.apply(&self.decoded, &mut seen);
            self.clip.read_patch(self.read, &mut self.patch)?;
            apply(&self.patch, &mut seen.pixels);
        } else {
            seen.pixels.clear();
            (seen.width, seen.height) = (0, 0);
        }
        self.recent.push_back(seen);
        self.read += 1;
        Ok(())
    }

    fn gone(&self, number: usize) -> Error {
        TrainError::Gone { input: self.clip.input.clone(), frame: number }.into()
    }
}

/// The changes from `before` to `after`, of the same length: runs of start (`u32`), length (`u16`), both little-endian, and
/// pixels.
pub fn difference(before: &[u8], after: &[u8]) -> Vec<u8> {
    let mut patch = Vec::new();
    let mut changed = (0..before.len()).filter(|&i| before[i] != after[i]).peekable();
    while let Some(start) = changed.next() {
        let mut end = start + 1;
        while let Some(&next) = changed.peek() {
            if next - end > RUN_HEADER || next - start >= usize::from(u16::MAX) {
                break;
            }
            end = next + 1;
            changed.next();
        }
        patch.extend((start as u32).to_le_bytes());
        patch.extend(((end - start) as u16).to_le_bytes());
        patch.extend(&after[start..end]);
    }
    patch
}

/// Writes the runs of `patch` over `pixels`.
pub fn apply(mut patch: &[u8], pixels: &mut [u8]) {
    while let [a, b, c, d, e, f, rest @ ..] = patch {
        let start = u32::from_le_bytes([*a, *b, *c, *d]) as usize;
        let (run, next) = rest.split_at(usize::from(u16::from_le_bytes([*e, *f])));
        pixels[start..start + run.len()].copy_from_slice(run);
        patch = next;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn long_runs_are_split() {
        let (before, after) = (std::vec![0; 70_000], std::vec![1; 70_000]);
        let patch = difference(&before, &after);
        assert_eq!(patch.len(), 70_000 + 2 * RUN_HEADER);
        let mut pixels = before.clone();
        apply(&patch, &mut pixels);
        assert_eq!(pixels, after);
    }

    proptest! {
        #[test]
        fn a_patch_makes_the_one_of_the_other(
            pixels in prop::collection::vec((0..3u8, 0..3u8), 0..300),
        ) {
            let (before, after): (Vec<u8>, Vec<u8>) = pixels.into_iter().unzip();
            let patch = difference(&before, &after);
            prop_assert_eq!(patch.is_empty(), before == after);
            let mut patched = before;
            apply(&patch, &mut patched);
            prop_assert_eq!(patched, after);
        }
    }
}
