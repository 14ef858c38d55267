//! Where frames come from.

use crate::image::Image;
use std::boxed::Box;
use std::vec::Vec;

/// One grey frame, owned, and when it was taken.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Frame {
    /// Rows of `width` pixels without padding.
    pub pixels: Vec<u8>,
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// When it was taken, microseconds since the first frame.
    pub time_us: i64,
}

impl Frame {
    /// The frame as the core sees it.
    pub fn view(&self) -> Image<'_> {
        Image::packed(&self.pixels, self.width, self.height)
            .expect("a frame's pixels always fill its size")
    }
}

/// A sequence of frames of one size.
pub trait FrameSource {
    /// Writes the next frame into `frame` (reusing its memory); `false` at the end.
    ///
    /// # Errors
    /// [`SourceError`] naming the file and the frame; what was read before stays valid.
    fn next_frame(&mut self, frame: &mut Frame) -> Result<bool, SourceError>;

    /// How many frames there will be in all, where that is known beforehand.
    fn frame_count(&self) -> Option<u64> {
        None
    }
}

impl FrameSource for Box<dyn FrameSource> {
    fn next_frame(&mut self, frame: &mut Frame) -> Result<bool, SourceError> {
        (**self).next_frame(frame)
    }

    fn frame_count(&self) -> Option<u64> {
        (**self).frame_count()
    }
}

/// Why frames cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {}
