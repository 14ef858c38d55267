//! The error of a verb: those of the layers below it, and what only verbs meet. Printed as one line.

use super::formats::clips::ClipsError;
use super::formats::error::FormatError;
use super::formats::flight_sample::FlightLogError;
use super::pictures::PictureError;
use super::pipeline::PipelineError;
use super::simulate::SimulateError;
use super::sources::SourceError;
use super::support::file_error::FileError;
use super::support::interrupt::InterruptError;
use std::boxed::Box;
use std::io;
use std::path::Path;

/// Exit status after which a scheduler must not try the same again.
pub const FOREVER_STATUS: u8 = 42;

/// Why a verb ended early.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The system refuses a file.
    #[error(transparent)]
    File(#[from] FileError),
    /// A file does not say what it should.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// Clips cannot be read.
    #[error(transparent)]
    Clips(#[from] ClipsError),
    /// A telemetry log cannot be read.
    #[error(transparent)]
    Tlog(#[from] FlightLogError),
    /// Frames cannot be read.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// A simulated flight cannot be written.
    #[error(transparent)]
    Simulate(#[from] SimulateError),
    /// A picture or video cannot be written.
    #[error(transparent)]
    Picture(#[from] PictureError),
    /// A model cannot run over a source.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// Signals cannot be watched.
    #[error(transparent)]
    Interrupt(#[from] InterruptError),
    /// After this the same must not be tried again: a scheduler of many runs sees it by the exit status.
    #[error(transparent)]
    Forever(Box<Self>),
    /// An error of one verb alone; its type stands in the verb's folder.
    #[error(transparent)]
    Verb(Box<dyn std::error::Error + Send + Sync>),
}

impl Error {
    /// For `map_err`: `path` cannot be read.
    pub fn read(path: &Path) -> impl FnOnce(io::Error) -> Self + '_ {
        move |source| FileError::read(path)(source).into()
    }

    /// For `map_err`: `path` cannot be written.
    pub fn write(path: &Path) -> impl FnOnce(io::Error) -> Self + '_ {
        move |source| FileError::write(path)(source).into()
    }

    /// The error of one verb.
    pub fn verb(error: impl std::error::Error + Send + Sync + 'static) -> Self {
        Self::Verb(Box::new(error))
    }

    /// The program's exit status: 42 where the same must not be tried again.
    pub fn exit_status(&self) -> u8 {
        if matches!(self, Self::Forever(_)) { FOREVER_STATUS } else { 1 }
    }

    /// Whether the reader of our standard output has left, which is no fault.
    pub fn is_closed_pipe(&self) -> bool {
        matches!(self, Self::File(error) if error.is_closed_pipe())
    }
}
