//! Decoding of a clip's frames in order; memory holds only the last few.

use super::TrainError;
use super::footage::{Footage, HISTORY};
use super::patch::apply;
use crate::shell::error::Error;
use crate::shell::pipeline::scaled::Scaling;
use crate::shell::sources::{self, Frame, FrameSource};
use std::boxed::Box;
use std::collections::VecDeque;
use std::vec::Vec;

/// Decodes a clip from its first frame on.
pub struct Playback<'a> {
    clip: &'a Footage,
    source: Box<dyn FrameSource>,
    decoded: Frame,
    /// The last frames as the detector sees them, the newest last; empty where no sampled frame depends on it.
    recent: VecDeque<Frame>,
    /// Number of frames decoded.
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

    /// Frame `number`, from 1: any later one, or one of the last [`HISTORY`] before the newest decoded. Empty
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
