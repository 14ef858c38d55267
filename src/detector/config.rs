//! Settings of a detector, the memory that they need, and the errors of both.

use crate::channels::front_end::{self, FrontEnd};
use crate::channels::history::History;
use crate::channels::scale_space::PyramidLayout;
use crate::model::{Method, Model};
use crate::scan;

/// Default range of target sizes of [`Config`], pixels along the longer side. A frame that is too small for the largest is
/// searched up to its own size.
pub const TARGETS: (usize, usize) = (10, 240);

/// Largest width and height of a frame, pixels. Keeps [`Config::bytes_len`] within a `usize`.
pub const MAX_SIDE: usize = if usize::BITS < 64 { 4096 } else { 16_384 };

/// Frame size, range of targets and switches of a detector. Made for a model by [`Config::for_model`].
///
/// ```
/// use lookout::detector::Config;
/// use lookout::model::Model;
///
/// let model = Model::parse(include_bytes!("../../models/lookout.lkm"))?;
/// let config = Config::for_model(&model, 640, 480);
/// // Large targets alone: fewer and coarser levels, less memory.
/// let coarse = Config { min_target: 40, ..config };
/// assert!(coarse.bytes_len() < config.bytes_len());
/// # Ok::<(), lookout::model::ModelError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Config {
    /// Width of the frames in pixels.
    pub width: usize,
    /// Height of the frames in pixels.
    pub height: usize,
    /// Smallest target to find, pixels of the frame along its longer side.
    pub min_target: usize,
    /// Largest target to find, pixels.
    pub max_target: usize,
    /// Least score of a detection that is reported, Q16 log-odds as [`Detection::score`](super::Detection::score).
    pub threshold: i32,
    /// Proposals of the scan that are classified by their st-cube, the best ones; at most [`MAX_CANDIDATES`](scan::MAX_CANDIDATES).
    pub candidates: usize,
    /// Whether there is memory for all levels at once, so that threads can share the work.
    pub parallel: bool,
    /// Parts of the method in use: those of the model, or fewer of them ([`Method::allows`]).
    pub method: Method,
    /// Whether detections are followed through the slices by Algorithm 1, for [`Detection::shifts`](super::Detection::shifts).
    pub trace: bool,
    /// Whether the boxes of the best detections are refined ([`crate::boxes`]), where the model can.
    pub fit: bool,
}

impl Config {
    /// Defaults for a model and frames of this size.
    pub const fn for_model(model: &Model<'_>, width: usize, height: usize) -> Self {
        Self::for_method(model.method(), width, height)
    }

    /// As [`Config::for_model`], from [`Method::of_header`]: for constants, so that static memory has the right size. A
    /// half history is for small boards: fewer proposals, one level after the other.
    pub const fn for_method(method: Method, width: usize, height: usize) -> Self {
        let full = matches!(method.history, History::Full);
        Self {
            width,
            height,
            min_target: TARGETS.0,
            max_target: TARGETS.1,
            threshold: i32::MIN,
            candidates: if full { 48 } else { 20 },
            parallel: full,
            method,
            // Without older slices an object cannot be followed.
            trace: full,
            fit: full,
        }
    }

    /// Whether a detector can be made: usable in constants, `const _: () = assert!(CONFIG.check().is_ok())`.
    ///
    /// # Errors
    /// [`Error::UnsupportedSize`] for frames of more than [`MAX_SIDE`] pixels a side.
    pub const fn check(&self) -> Result<(), Error> {
        let Self { width, height, .. } = *self;
        if width > MAX_SIDE || height > MAX_SIDE {
            return Err(Error::UnsupportedSize { width, height });
        }
        Ok(())
    }

    /// Bytes that [`Buffers::bytes`] must have.
    pub const fn bytes_len(&self) -> usize {
        let geometry = self.geometry();
        let scratch = scan::bytes_len(&geometry, self.parallel);
        FrontEnd::bytes_len(&geometry, scratch)
    }

    /// Words that [`Buffers::words`] must have.
    pub const fn words_len(&self) -> usize {
        scan::words_len(&self.geometry(), self.parallel)
    }

    /// The levels that are searched.
    pub const fn geometry(&self) -> PyramidLayout {
        PyramidLayout::new(
            self.width,
            self.height,
            self.min_target,
            self.max_target,
            self.method.scales_per_octave as usize,
            self.method.history,
        )
    }

    /// The detector's front end alone, in memory of at least [`Config::bytes_len`] bytes: the trainer's way to the same
    /// channels.
    ///
    /// # Errors
    /// [`Error::UnsupportedSize`]; [`Error::BufferTooSmall`] with the number of bytes needed.
    pub fn front_end<'b>(&self, bytes: &'b mut [u8]) -> Result<FrontEnd<'b>, Error> {
        self.check()?;
        let needed = self.bytes_len();
        if bytes.len() < needed {
            return Err(Error::BufferTooSmall { needed });
        }
        Ok(FrontEnd::new(self.geometry(), self.method, bytes)?)
    }
}

/// Memory of a detector, given by the caller.
#[derive(Debug)]
pub struct Buffers<'b> {
    /// At least [`Config::bytes_len`] bytes; what is in them does not matter.
    pub bytes: &'b mut [u8],
    /// At least [`Config::words_len`] words; what is in them does not matter.
    pub words: &'b mut [u16],
}

/// Why a detector cannot be made, or cannot take a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Error {
    /// A buffer has fewer elements than the configuration needs.
    BufferTooSmall {
        /// Elements needed.
        needed: usize,
    },
    /// The configuration has larger frames than [`MAX_SIDE`].
    UnsupportedSize {
        /// Width of the frames in pixels.
        width: usize,
        /// Height of the frames in pixels.
        height: usize,
    },
    /// The model was not trained for the configuration: [`Method::allows`] is false, or the configuration aligns slices
    /// by optical flow in a build without `std`. Make the configuration by [`Config::for_model`].
    ModelMismatch,
    /// A frame has another size than the configuration.
    FrameSize {
        /// Width of the frame in pixels.
        width: usize,
        /// Height of the frame in pixels.
        height: usize,
    },
}

impl core::fmt::Display for Error {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::BufferTooSmall { needed } => write!(f, "a buffer needs {needed} elements"),
            Self::UnsupportedSize { width, height } => write!(
                f,
                "frames of {width}x{height} are not supported, at most {MAX_SIDE} pixels a side"
            ),
            Self::ModelMismatch => f.write_str(
                "the model was not trained for this configuration, make it by Config::for_model",
            ),
            Self::FrameSize { width, height } => {
                write!(f, "the frame is {width}x{height}, the detector was made for another size")
            }
        }
    }
}

impl core::error::Error for Error {}

impl From<front_end::RegistrationError> for Error {
    fn from(error: front_end::RegistrationError) -> Self {
        match error {
            front_end::RegistrationError::BufferTooSmall { needed } => {
                Self::BufferTooSmall { needed }
            }
            front_end::RegistrationError::FrameSize { width, height } => {
                Self::FrameSize { width, height }
            }
        }
    }
}
