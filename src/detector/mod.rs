//! The detector: frames in, detections out (level 8).

pub mod classifier;
pub mod detection;
pub mod digest;
pub mod temporal_score;

use crate::channels::front_end::{FrontEnd, Parts};
use crate::channels::scale_space::Geometry;
use crate::image::nms;
use crate::image::{Image, Rect};
use crate::math::threads;
use crate::model::{Method, Model};
use crate::registration::global_motion::Motion;
use crate::scan::cascade::Candidate;
use crate::scan::{self, Counts, Scratch, window};
use crate::stcube::compensation::Alignment;
use crate::stcube::cube::Cube;
use classifier::{Judge, Judged};
use temporal_score::Persistence;

pub use crate::channels::history::History;
pub use crate::channels::window::SLICES;
pub use crate::scan::MAX_CANDIDATES;
pub use detection::{Detection, Shift};

/// Most detections of one frame.
pub const MAX_DETECTIONS: usize = 64;

/// Most detections of a frame that are looked at again, the surest ones, with a full history and with a half one.
const MAX_REFINED: [usize; 2] = [10, 3];

/// Candidates that one thread judges at a time.
const PIECE: usize = 4;

/// Overlap (IoU, Q8) above which the weaker of two detections goes.
const DETECTION_OVERLAP: u8 = 64;

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
    /// Levels of the pyramid for each doubling of the target's size, 1 to 4.
    pub scales_per_octave: usize,
    /// Windows of the scan that are judged by their st-cube, the best ones; at most [`MAX_CANDIDATES`].
    pub candidates: usize,
    /// What is kept of the last frames, as the model was trained.
    pub history: History,
    /// Memory to work on all levels at the same time, where there are threads for it.
    pub parallel: bool,
    /// Align older frames to the newest one before looking for motion.
    pub registration: bool,
    /// Look at temporal differences.
    pub temporal: bool,
    /// What the older slices of a cube follow: as the model was trained.
    pub alignment: Alignment,
    /// Follow detections through the slices by Algorithm 1, for their shifts.
    pub trace: bool,
    /// Fit the boxes of the surest detections by windows that are stretched to them, where the model can.
    pub fit: bool,
    /// Weigh detections by what was there a frame ago.
    pub persistence: bool,
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
            max_target: 240,
            threshold: i32::MIN,
            scales_per_octave: 2,
            candidates: 48,
            history: History::Full,
            parallel: true,
            registration: true,
            temporal: true,
            alignment: Alignment::Background,
            trace: true,
            fit: true,
            stcube: true,
            persistence: true,
        }
    }

    /// The defaults with the parts that a model was trained with: see [`Model::method`]. A half history is for small
    /// boards: fewer candidates, one level after the other.
    pub const fn of_method(width: usize, height: usize, method: Method) -> Self {
        let full = matches!(method.history, History::Full);
        Self {
            history: method.history,
            parallel: full,
            candidates: if full { 48 } else { 20 },
            // Where older slices are not kept there is nothing to follow an object through.
            trace: full,
            fit: full,
            registration: method.registration,
            temporal: method.temporal,
            alignment: method.alignment,
            stcube: method.stcube,
            persistence: method.persistence,
            scales_per_octave: method.scales_per_octave as usize,
            ..Self::new(width, height)
        }
    }

    /// Bytes that [`Buffers::bytes`] must have.
    pub const fn bytes_len(&self) -> usize {
        let geometry = self.geometry();
        let scratch = scan::bytes_len(&geometry, self.parallel);
        FrontEnd::bytes_len(self.width, self.height, &geometry, scratch)
    }

    /// Words that [`Buffers::words`] must have.
    pub const fn words_len(&self) -> usize {
        scan::words_len(&self.geometry(), self.parallel)
    }

    /// The levels that are searched.
    pub const fn geometry(&self) -> Geometry {
        Geometry::new(
            self.width,
            self.height,
            self.min_target,
            self.max_target,
            self.scales_per_octave,
            self.history,
        )
    }

    /// The front end for this configuration.
    pub const fn front(&self) -> FrontEnd {
        let parts = Parts { registration: self.registration, temporal: self.temporal };
        FrontEnd::new(self.width, self.height, self.geometry(), parts)
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

/// A step of [`Detector::process`], named to an observer when it has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Motion of the background, and the differences that remain.
    Registration,
    /// The pictures of all levels.
    Channels,
    /// Gradients, maps, sliding window, candidates.
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
    /// Boxes of the nominal target in the windows that the scan handed on, best first.
    pub proposals: heapless::Vec<Rect, MAX_CANDIDATES>,
    /// Windows that the scan looked at.
    pub windows: u32,
    /// Windows that the scan kept.
    pub kept: u32,
    /// Candidates or detections that found no room.
    pub dropped: u32,
    /// Whether the background's motion could be measured; if not, older frames were left where they are.
    pub registered: bool,
    /// Where each point of the background was in the frame before; not valid where that could not be measured.
    pub motion: Motion,
}

/// Finds flying objects in the frames of one camera.
#[derive(Debug)]
pub struct Detector<'m, 'b> {
    model: Model<'m>,
    config: Config,
    front: FrontEnd,
    persistence: Persistence<MAX_DETECTIONS>,
    buffers: Buffers<'b>,
}

impl<'m, 'b> Detector<'m, 'b> {
    /// A detector that has seen no frame yet.
    ///
    /// # Errors
    /// [`Error::BufferTooSmall`] with the number of elements needed.
    pub fn new(model: &Model<'m>, config: Config, buffers: Buffers<'b>) -> Result<Self, Error> {
        for (given, needed) in
            [(buffers.bytes.len(), config.bytes_len()), (buffers.words.len(), config.words_len())]
        {
            if given < needed {
                return Err(Error::BufferTooSmall { needed });
            }
        }
        Ok(Self {
            model: *model,
            config,
            front: config.front(),
            persistence: Persistence::new(),
            buffers,
        })
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
    #[inline(never)]
    pub fn process_observed(
        &mut self,
        frame: Image<'_>,
        _time_us: i64,
        observer: &mut dyn FnMut(Stage),
    ) -> Result<Detections, Error> {
        if (frame.width(), frame.height()) != (self.config.width, self.config.height) {
            return Err(Error::FrameSize { width: frame.width(), height: frame.height() });
        }
        let Self { model, config, front, persistence, buffers } = self;
        front.take(frame, buffers.bytes);
        front.build(frame, buffers.bytes, &mut || observer(Stage::Registration));
        let (pyramid, scratch) = front.pyramid(frame, buffers.bytes);
        observer(Stage::Channels);
        let scratch = Scratch { bytes: scratch, words: buffers.words };
        let (candidates, Counts { windows, kept, dropped }) =
            scan::search(model.scan(), &pyramid, config.candidates, config.parallel, scratch);
        observer(Stage::Scan);
        let mut detections = Detections {
            registered: front.registered(),
            motion: front.motion(),
            windows,
            kept,
            dropped,
            ..Detections::default()
        };
        let judge = Judge {
            model,
            alignment: config.alignment,
            trace: config.trace,
            fit: model.fit().filter(|_| config.fit),
            stcube: config.stcube,
            front,
            pyramid,
        };
        decide(config, &judge, &candidates, persistence, &mut detections, observer);
        observer(Stage::Boxes);
        Ok(detections)
    }

    /// Gives the memory back.
    pub fn release(self) -> Buffers<'b> {
        self.buffers
    }
}

/// Judges the candidates and fills the lists of `detections`.
// Not inlined: the cube and the lists are to be on the stack only now.
#[inline(never)]
fn decide(
    config: &Config,
    judge: &Judge<'_>,
    candidates: &[Candidate],
    persistence: &mut Persistence<MAX_DETECTIONS>,
    detections: &mut Detections,
    observer: &mut dyn FnMut(Stage),
) {
    let mut found: heapless::Vec<Judged, MAX_CANDIDATES> = heapless::Vec::new();
    for candidate in candidates {
        let level = &judge.pyramid.levels()[usize::from(candidate.level)];
        // As much room as there are candidates, here and below.
        let _ = detections.proposals.push(level.nominal_box(window(candidate)));
    }
    let parallel = config.parallel && threads::several();
    let mut cube = Cube::EMPTY;
    if parallel {
        let mut judged = [None; MAX_CANDIDATES];
        threads::pieces(&mut judged[..candidates.len()], PIECE, true, |number, judged| {
            let mut cube = Cube::EMPTY;
            for (judged, candidate) in judged.iter_mut().zip(&candidates[number * PIECE..]) {
                *judged = judge.candidate(candidate, &mut cube);
            }
        });
        found.extend(judged.into_iter().flatten());
    } else {
        found.extend(candidates.iter().filter_map(|c| judge.candidate(c, &mut cube)));
    }
    found.sort_unstable_by_key(Judged::rank);
    let suppress = |found: &mut [Judged]| {
        nms::suppress(found, |j| j.detection.rect, DETECTION_OVERLAP, MAX_DETECTIONS)
    };
    let (length, dropped) = suppress(&mut found);
    found.truncate(length);
    detections.dropped += dropped;
    observer(Stage::Cubes);
    let refined = MAX_REFINED[config.history as usize].min(found.len());
    if parallel {
        threads::pieces(&mut found[..refined], 1, true, |_, judged| {
            let mut cube = Cube::EMPTY;
            judged.iter_mut().for_each(|judged| judge.refine(judged, &mut cube));
        });
    } else {
        found[..refined].iter_mut().for_each(|judged| judge.refine(judged, &mut cube));
    }
    if config.persistence {
        for Judged { detection, .. } in &mut found {
            let Detection { rect, score, shifts } = *detection;
            let [Shift { x, y }, ..] = shifts;
            let before = Rect { x: rect.x + x, y: rect.y + y, ..rect };
            (detection.rect, detection.score) = persistence.weigh(rect, score, before);
        }
        persistence.remember(found.iter().map(|j| (j.detection.rect, j.detection.score)));
    }
    found.retain(|judged| judged.detection.score >= config.threshold);
    found.sort_unstable_by_key(Judged::rank);
    let (length, _) = suppress(&mut found);
    found.truncate(length);
    detections.list.extend(found.iter().map(|j| j.detection));
}
