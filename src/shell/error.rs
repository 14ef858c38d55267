//! What can go wrong in a verb, told in one line: the file, the place, what to do.

use super::formats::clips::ClipsError;
use super::formats::tlog::TlogError;
use super::pipeline::methods::MethodName;
use super::preview::PreviewError;
use super::simulate::SimulateError;
use super::sources::SourceError;
use crate::detector;
use crate::model::ModelError;
use std::io;
use std::path::{Path, PathBuf};
use std::string::String;
use std::vec::Vec;

/// Why a verb ended early.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Frames cannot be read.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// A simulated flight cannot be written.
    #[error(transparent)]
    Simulate(#[from] SimulateError),
    /// Clips cannot be read.
    #[error(transparent)]
    Clips(#[from] ClipsError),
    /// A camera file or option that makes no camera.
    #[error("{}: {reason}", path.display())]
    Camera {
        /// The file, or the options.
        path: PathBuf,
        /// The field, and what is expected.
        reason: String,
    },
    /// A source that holds no frame at all.
    #[error("{input}: no frames in it; give a folder of pictures, a .y4m or a video with frames")]
    NoFrames {
        /// The input as the user named it.
        input: String,
    },
    /// A file cannot be read.
    #[error("{}: cannot read: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// A file or folder cannot be written.
    #[error("{}: cannot write: {source}{}", path.display(), advice(source))]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// Bytes that are not a model of this version.
    #[error("{}: {source}; leave --model out for the shipped one, or train one with `lookout train`", path.display())]
    Model {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: ModelError,
    },
    /// A precision is asked for of a model that does not know what its scores are worth.
    #[error(
        "--min-precision {wanted:.3}: the model has no table of precisions; give --threshold, or measure one with `lookout train --calibrate`"
    )]
    NotCalibrated {
        /// What was asked for.
        wanted: f64,
    },
    /// A precision is asked for that the model does not reach.
    #[error(
        "--min-precision {wanted:.3}: no score of this model reached more than {best:.3}; ask for less, or give --threshold"
    )]
    Precision {
        /// What was asked for.
        wanted: f64,
        /// The best that was measured.
        best: f64,
    },
    /// Training cannot go on.
    #[error("training: {reason}; give more flights with targets, or other settings")]
    Training {
        /// What stands in the way.
        reason: String,
    },
    /// A line of a text file that does not say what it should.
    #[error("{} line {line}: {reason}", path.display())]
    Text {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What is wrong, and what belongs there.
        reason: String,
    },
    /// The detector refuses its configuration or a frame.
    #[error("{input}, frame {frame}: {source}")]
    Detector {
        /// The input as the user named it.
        input: String,
        /// The frame, from 1.
        frame: u64,
        /// Its reason.
        source: detector::Error,
    },
    /// A video encoder that cannot be started or gave up.
    #[error("{}: {reason}", path.display())]
    Encoder {
        /// The video.
        path: PathBuf,
        /// What happened and what to do.
        reason: String,
    },
    /// No clip of a folder has a name that was asked for.
    #[error("{}: no clip in it whose name contains '{}'", path.display(), names.join("' or '"))]
    NoClips {
        /// The folder.
        path: PathBuf,
        /// What was asked for.
        names: Vec<String>,
    },
    /// A folder that holds detections of none of the clips.
    #[error("{}: no CLIP.txt in it for any clip of the split; give the folder with its detections", path.display())]
    NoDetections {
        /// The folder.
        path: PathBuf,
    },
    /// Two methods of one name.
    #[error("--external {name}: two methods of this name; take another name for one of them")]
    SameName {
        /// The name.
        name: String,
    },
    /// A method that is not trained.
    #[error("{method} learns nothing: run it with `lookout eval DATA_SPLIT --method {method}`")]
    NothingToLearn {
        /// The method.
        method: MethodName,
    },
    /// No model of a method, or one of another method.
    #[error("{}: {reason}; make it with `lookout train DATA... --method {method} --out {}`, or name its folder with --models", path.display(), path.display())]
    MethodModel {
        /// The method.
        method: MethodName,
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A telemetry log that cannot be read.
    #[error(transparent)]
    Tlog(#[from] TlogError),
    /// A link on which nothing was heard.
    #[error(
        "{link}: nothing was heard in {seconds} s; is the autopilot on, does it send MAVLink to this port, is the \
        baud rate its own?"
    )]
    Silent {
        /// The link as the user named it.
        link: String,
        /// How long it was listened to.
        seconds: u32,
    },
    /// The doctor's verdict.
    #[error("missing: {missing}, see above")]
    Missing {
        /// How many things are missing.
        missing: usize,
    },
    /// Ctrl-C cannot be watched.
    #[error("cannot watch for Ctrl-C: {reason}")]
    Interrupt {
        /// The system's reason.
        reason: String,
    },
    /// The page cannot be shown.
    #[error(transparent)]
    Preview(#[from] PreviewError),
    /// A thread of a service cannot be started.
    #[error("cannot start a thread: {source}; end other programs, or raise the limit of tasks")]
    Thread {
        /// The system's reason.
        source: io::Error,
    },
    /// Threads cannot be started.
    #[error("cannot start {threads} threads: {reason}; try a smaller --threads")]
    Threads {
        /// How many were asked for.
        threads: usize,
        /// The system's reason.
        reason: String,
    },
}

impl Error {
    /// For `map_err`: `path` cannot be read.
    pub fn read(path: &Path) -> impl FnOnce(io::Error) -> Self + '_ {
        move |source| Self::Read { path: path.into(), source }
    }

    /// For `map_err`: `path` cannot be written.
    pub fn write(path: &Path) -> impl FnOnce(io::Error) -> Self + '_ {
        move |source| Self::Write { path: path.into(), source }
    }

    /// Whether the reader of our standard output has left, which is no fault.
    pub fn is_closed_pipe(&self) -> bool {
        matches!(self, Self::Write { source, path }
            if source.kind() == io::ErrorKind::BrokenPipe && path == Path::new(STDOUT))
    }
}

/// The name of standard output in messages.
pub const STDOUT: &str = "standard output";

/// What the user can do about a failed write.
fn advice(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "; make room or write elsewhere, what was written before is kept"
        }
        io::ErrorKind::NotFound => "; make its folder first",
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
            "; write to a folder of your own"
        }
        io::ErrorKind::NotADirectory | io::ErrorKind::AlreadyExists => {
            "; a file stands where a folder is needed"
        }
        _ => "",
    }
}
