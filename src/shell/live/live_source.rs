//! The interface of a live source of frames, and its errors.

use crate::shell::sources::{Frame, SourceError};
use std::string::String;
use std::time::Duration;

/// Counts and times that come with a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CaptureInfo {
    /// Frames lost before this one: for want of a buffer, or damaged.
    pub missed: u32,
    /// Older ones that were ready as well and were left out.
    pub passed_over: u32,
}

/// Why there is no frame.
#[derive(Debug, thiserror::Error)]
pub enum LiveError {
    /// None came in the time given.
    #[error("no frame came")]
    Timeout,
    /// That was the last one.
    #[error("the flight has ended")]
    Ended,
    /// Error that opening the source again may remove.
    #[error("{0}")]
    Gone(String),
    /// A file that no opening again will mend.
    #[error(transparent)]
    Broken(#[from] SourceError),
}

/// A source of frames that come when they come.
pub trait LiveSource {
    /// Writes the newest frame into `frame`, its time by [`crate::shell::support::clock::now_us`], waiting at most `timeout`.
    ///
    /// # Errors
    /// [`LiveError`]; `frame` may hold anything then.
    fn next(&mut self, frame: &mut Frame, timeout: Duration) -> Result<CaptureInfo, LiveError>;

    /// Without a frame for this long the source is opened again.
    fn silence(&self) -> Duration {
        Duration::from_secs(3)
    }
}
