//! Why a camera gives no pictures.

use super::PixelFormat;
use rustix::io::Errno;
use std::io;
use std::path::{Path, PathBuf};
use std::string::String;

/// Why a camera gives no pictures or refuses a setting.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum V4l2Error {
    /// No frame came in time; the next may.
    #[error("the camera gave no frame in time")]
    Timeout,
    /// The camera was there and is no more, or broke down; drop it, and open it again later.
    #[error("{}: the camera is gone: {source}", path.display())]
    Gone {
        /// The video node.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// The video node is missing or may not be used.
    #[error("{}: cannot open the camera: {source}{}", path.display(), advice(source))]
    Open {
        /// The video node.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// Somebody else has the camera.
    #[error("{}: another program uses the camera (`fuser {}` names it)", path.display(), path.display())]
    Busy {
        /// The video node.
        path: PathBuf,
    },
    /// A file or a node that gives no pictures.
    #[error("{}: {reason}; `v4l2-ctl --list-devices` names the cameras and their nodes", path.display())]
    NoCamera {
        /// The path that was opened.
        path: PathBuf,
        /// The kind of file or device that it is.
        reason: String,
    },
    /// A camera without the requested format, or without any that is understood.
    #[error("{}: the camera has no format {wanted}, only {offered}", path.display())]
    Format {
        /// The video node.
        path: PathBuf,
        /// The requested format, or those that are understood.
        wanted: String,
        /// Formats, sizes or rates that the camera has.
        offered: String,
    },
    /// Fields that do not come as whole pictures.
    #[error("{}: the camera gives fields apart (V4L2 field order {field}), not pictures; set a progressive mode, or give {{ exec = [..] }} a program that joins them", path.display())]
    Fields {
        /// The video node.
        path: PathBuf,
        /// The kernel's number of the order.
        field: u32,
    },
    /// A size that the camera does not have.
    #[error("{}: the camera has no {}x{} in {format}; the nearest is {}x{}", path.display(), wanted.0, wanted.1, nearest.0, nearest.1)]
    Size {
        /// The video node.
        path: PathBuf,
        /// The format in which the camera comes nearest.
        format: PixelFormat,
        /// Requested width and height.
        wanted: (u32, u32),
        /// Width and height instead.
        nearest: (u32, u32),
    },
    /// A control that the camera does not have.
    #[error("{}: the camera has no control '{name}', only {offered}", path.display())]
    NoControl {
        /// The video node.
        path: PathBuf,
        /// Name of the control.
        name: String,
        /// The names of those it has.
        offered: String,
    },
    /// A value that a control cannot have.
    #[error("{}: control '{name}' cannot be {value}: {reason}", path.display())]
    ControlValue {
        /// The video node.
        path: PathBuf,
        /// Name of the control.
        name: String,
        /// The value given.
        value: i64,
        /// Its range, or the system's reason.
        reason: String,
    },
    /// The system refuses a request.
    #[error("{}: {request}: {source}", path.display())]
    System {
        /// The video node.
        path: PathBuf,
        /// The operation that failed.
        request: &'static str,
        /// The system's reason.
        source: io::Error,
    },
}

impl V4l2Error {
    /// Whether the camera is not there (any more): it may come back, as after its cable was pulled.
    pub fn is_gone(&self) -> bool {
        match self {
            Self::Gone { .. } => true,
            Self::Open { source, .. } => {
                source.kind() == io::ErrorKind::NotFound
                    || Errno::from_io_error(source).is_some_and(is_unplugged)
            }
            _ => false,
        }
    }

    /// For `map_err`: `path` failed in `request`.
    pub(super) fn system(path: &Path, request: &'static str) -> impl FnOnce(Errno) -> Self {
        move |errno| match errno {
            Errno::BUSY => Self::Busy { path: path.into() },
            errno if is_unplugged(errno) => Self::gone(path)(errno),
            _ => Self::System { path: path.into(), request, source: errno.into() },
        }
    }

    /// For `map_err`: `path` failed while its pictures were awaited, whatever the reason.
    pub(super) fn gone(path: &Path) -> impl FnOnce(Errno) -> Self {
        move |errno| Self::Gone { path: path.into(), source: errno.into() }
    }
}

/// Whether an error is that of a driver whose device is gone.
fn is_unplugged(errno: Errno) -> bool {
    matches!(errno, Errno::NODEV | Errno::NXIO)
}

fn advice(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::NotFound => {
            "; is it plugged in? `v4l2-ctl --list-devices` names the cameras and their nodes"
        }
        io::ErrorKind::PermissionDenied => {
            "; add the user to the group video: `sudo usermod -aG video USER`, then log in again"
        }
        _ => "",
    }
}

/// A buffer that does not hold a whole picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Damaged;
