//! Why flights cannot be rendered.

use crate::shell::formats::clips::ClipsError;
use crate::shell::sources::SourceError;
use std::io;
use std::path::PathBuf;
use std::string::String;

/// Why flights cannot be rendered.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// A file or folder cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// There is no picture in a folder.
    #[error("{}: no JPEG or PNG picture in it; give a folder of photographs or panoramas", path.display())]
    NoPictures {
        /// Path of the folder.
        path: PathBuf,
    },
    /// A picture cannot be decoded.
    #[error("{}: is no picture that can be decoded: {source}; convert it to JPEG or PNG", path.display())]
    Picture {
        /// Path of the file.
        path: PathBuf,
        /// The decoder's error.
        source: image::ImageError,
    },
    /// A picture is too small to render from.
    #[error("{}: {width}x{height} pixels, at least 64x64 are needed", path.display())]
    SmallPicture {
        /// Path of the file.
        path: PathBuf,
        /// Pixels in a row.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// An OBJ model cannot be read.
    #[error("{}: {reason}", path.display())]
    Shape {
        /// Path of the file.
        path: PathBuf,
        /// Line and field.
        reason: String,
    },
    /// A split of clips to cut objects out of cannot be read.
    #[error(transparent)]
    Clips(#[from] ClipsError),
    /// A clip to cut objects out of cannot be decoded.
    #[error(transparent)]
    Source(#[from] SourceError),
}
