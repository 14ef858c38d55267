//! Errors of running a model over frames.

use super::methods::MethodName;
use crate::detector;
use crate::model::ModelError;
use crate::shell::sources::SourceError;
use crate::shell::support::file_error::FileError;
use std::path::PathBuf;
use std::string::String;

/// Why a model cannot run over a source.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// The system refuses a file.
    #[error(transparent)]
    File(#[from] FileError),
    /// Frames cannot be read.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// Bytes that are not a model of this version.
    #[error("{}: {source}; leave --model out for the shipped one, or train one with `lookout train`", path.display())]
    Model {
        /// Path of the file.
        path: PathBuf,
        /// Error of the model file.
        source: ModelError,
    },
    /// No model of a method, or one of another method.
    #[error("{}: {reason}; make it with `lookout train DATA... --method {method} --out {}`, or name its folder with --models", path.display(), path.display())]
    MethodModel {
        /// Method that was asked for.
        method: MethodName,
        /// Path of the file.
        path: PathBuf,
        /// Reason, in words.
        reason: String,
    },
    /// `--min-precision` with a model that has no table of precisions.
    #[error(
        "--min-precision {wanted:.3}: the model has no table of precisions; give --threshold, or measure one with `lookout train --calibrate`"
    )]
    NotCalibrated {
        /// The precision given.
        wanted: f64,
    },
    /// `--min-precision` above the highest precision of the model.
    #[error(
        "--min-precision {wanted:.3}: no score of this model reached more than {best:.3}; ask for less, or give --threshold"
    )]
    Precision {
        /// The precision given.
        wanted: f64,
        /// The highest precision in the model's table.
        best: f64,
    },
    /// A source that holds no frame at all.
    #[error("{input}: no frames in it; give a folder of pictures, a .y4m or a video with frames")]
    NoFrames {
        /// The input as the user named it.
        input: String,
    },
    /// The detector refuses its configuration or a frame.
    #[error("{input}, frame {frame}: {source}")]
    Detector {
        /// The input as the user named it.
        input: String,
        /// The frame, from 1.
        frame: u64,
        /// Error of the detector.
        source: detector::Error,
    },
    /// Frames so large that the live detector would take too much memory.
    #[error(
        "frames of {width}x{height}: the detector would take {} MB for them, at most {} MB are used; set camera.width and camera.height, or scale a file or program to at most 3840x2160",
        bytes / 1_000_000,
        most / 1_000_000
    )]
    Memory {
        /// Width in pixels.
        width: usize,
        /// Height in pixels.
        height: usize,
        /// Bytes of the detector.
        bytes: usize,
        /// Bytes allowed.
        most: usize,
    },
    /// A picture that is no mask for the frames.
    #[error("{}: {reason}; make a mask with `lookout mask VIDEO --out FILE`", path.display())]
    Mask {
        /// Path of the file.
        path: PathBuf,
        /// Fault of the value.
        reason: String,
    },
    /// Threads cannot be started.
    #[error("cannot start {threads} threads: {reason}; try a smaller --threads")]
    Threads {
        /// The number given.
        threads: usize,
        /// The system's reason.
        reason: String,
    },
}
