//! The detector: frames in, detections out (level 7).

use crate::cube::{Cube, WINDOW};
use crate::fixed::exp2_q16;
use crate::front::{FrontEnd, Parts};
use crate::gradient::CELL;
use crate::image::{Image, Rect};
use crate::levels::{Geometry, LevelBuffers, MAX_LEVELS, Pyramid};
use crate::model::Model;
use crate::motion::{self, Path, Position};
use crate::nms;
use crate::scan::{Candidate, Map};
use core::cmp::Reverse;
use fixed::types::I28F4;
use heapless::binary_heap::{BinaryHeap, Min};

pub use crate::cube::SLICES;

/// Most detections of one frame.
pub const MAX_DETECTIONS: usize = 64;

/// Most windows of one level that the scan hands on: the best ones.
pub const MAX_CANDIDATES: usize = 256;

/// Overlap (IoU, Q8) above which the weaker of two windows of the scan goes.
const CANDIDATE_OVERLAP: u8 = 128;

/// Overlap (IoU, Q8) above which the weaker of two detections goes.
const DETECTION_OVERLAP: u8 = 64;

/// Farthest that a box's centre may be from its window's, in cells, Q8.
const FARTHEST_CENTRE: i32 = (WINDOW as i32) << 8;

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
    /// Align older frames to the newest one before looking for motion.
    pub registration: bool,
    /// Look at temporal differences.
    pub temporal: bool,
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
            max_target: 240,
            threshold: i32::MIN,
            scales_per_octave: 2,
            candidates: 48,
            registration: true,
            temporal: true,
            compensation: true,
            stcube: true,
        }
    }

    /// Bytes that [`Buffers::bytes`] must have.
    pub const fn bytes_len(&self) -> usize {
        FrontEnd::bytes_len(self.width, self.height, &self.geometry())
    }

    /// Words that [`Buffers::words`] must have.
    pub const fn words_len(&self) -> usize {
        FrontEnd::words_len(&self.geometry())
    }

    /// The levels that are searched.
    pub const fn geometry(&self) -> Geometry {
        Geometry::new(
            self.width,
            self.height,
            self.min_target,
            self.max_target,
            self.scales_per_octave,
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
    /// How sure the detector is: log-odds in Q16, larger is surer; any sign.
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
}

/// Best windows of one level.
type Kept = BinaryHeap<(i32, Reverse<(i16, i16)>), Min, MAX_CANDIDATES>;

/// Windows of all levels.
pub type Candidates = heapless::Vec<Candidate, { MAX_LEVELS * MAX_CANDIDATES }>;

/// Finds flying objects in the frames of one camera.
#[derive(Debug)]
pub struct Detector<'m, 'b> {
    model: Model<'m>,
    config: Config,
    front: FrontEnd,
    buffers: Buffers<'b>,
}

/// Runs `work` on every searched level, in parallel with the feature `rayon`.
fn each_level<'a>(pyramid: &mut Pyramid<'a>, work: impl Fn(&mut LevelBuffers<'a>) + Send + Sync) {
    #[cfg(feature = "rayon")]
    {
        use rayon::prelude::*;
        if rayon::current_num_threads() > 1 {
            let levels = pyramid.as_mut_slice().par_iter_mut().with_max_len(1);
            return levels.filter(|l| l.level.active).for_each(work);
        }
    }
    pyramid.iter_mut().filter(|l| l.level.active).for_each(work);
}

/// The box of the nominal target in the middle of a window whose pixels are `scale` frame pixels.
fn nominal(position: Position, level: &LevelBuffers<'_>) -> Rect {
    boxed(position.centre(level.level.scale), level.level.target_q4(), level.level.target_q4())
}

/// A box around a centre (Q8 pixels) of a size in Q4 pixels.
fn boxed(centre: (i32, i32), width: i32, height: i32) -> Rect {
    Rect {
        x: I28F4::from_bits((centre.0 >> 4) - width / 2),
        y: I28F4::from_bits((centre.1 >> 4) - height / 2),
        width: I28F4::from_bits(width),
        height: I28F4::from_bits(height),
    }
}

/// The window of a candidate.
pub fn window(candidate: &Candidate) -> Position {
    let quarters = |v: i16| i32::from(v) * crate::cube::SUBCELL;
    Position { x: quarters(candidate.x), y: quarters(candidate.y) }
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
        Ok(Self { model: *model, config, front: config.front(), buffers })
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
        let Self { model, config, front, buffers } = self;
        front.take(frame, buffers.bytes);
        front.build(frame, buffers.bytes, &mut || observer(Stage::Registration));
        let mut pyramid = front.pyramid(buffers.bytes, buffers.words);
        each_level(&mut pyramid, |level| front.fill_tables(level));
        let noise = FrontEnd::noise(&pyramid);
        each_level(&mut pyramid, |level| front.fill_map(level, &noise));
        observer(Stage::Channels);
        let mut detections = Detections { registered: front.registered(), ..Detections::default() };
        let candidates = scan(model, config, &pyramid, &mut detections);
        observer(Stage::Scan);
        let mut found: heapless::Vec<Detection, MAX_CANDIDATES> = heapless::Vec::new();
        let mut cube = Cube::EMPTY;
        for candidate in &candidates {
            let level = &pyramid[usize::from(candidate.level)];
            // As much room as there are candidates.
            let _ = detections.proposals.push(nominal(window(candidate), level));
            let Some(detection) = judge(model, config, front, level, candidate, &mut cube) else {
                continue;
            };
            if found.push(detection).is_err() {
                detections.dropped += 1;
            }
        }
        observer(Stage::Cubes);
        found.sort_unstable_by_key(|d| {
            (Reverse(d.score), d.rect.x, d.rect.y, d.rect.width, d.rect.height)
        });
        detections.dropped +=
            nms::suppress(&mut found, |d| d.rect, DETECTION_OVERLAP, MAX_DETECTIONS);
        detections.list.extend(found);
        observer(Stage::Boxes);
        Ok(detections)
    }

    /// Gives the memory back.
    pub fn release(self) -> Buffers<'b> {
        self.buffers
    }
}

/// The windows that the scan hands on, best first. The pyramid's maps must be filled.
pub fn scan(
    model: &Model<'_>,
    config: &Config,
    pyramid: &Pyramid<'_>,
    detections: &mut Detections,
) -> Candidates {
    let search = |level: &LevelBuffers<'_>| {
        let (columns, rows) = level.level.cells();
        let map = Map::new(level.map(), columns, rows);
        let (mut kept, mut number) = (Kept::new(), 0u32);
        map.scan(level.number, model.scan(), |candidate| {
            number += 1;
            let item = (candidate.score, Reverse((candidate.y, candidate.x)));
            if kept.push(item).is_err() && kept.peek().is_some_and(|worst| *worst < item) {
                kept.pop();
                // There is room now.
                let _ = kept.push(item);
            }
        });
        (level.number, map.window_count(), number, kept)
    };
    let mut all = Candidates::new();
    let mut merge = |(level, windows, number, kept): (u8, u32, u32, Kept)| {
        detections.windows += windows;
        detections.kept += number;
        detections.dropped += number - kept.len() as u32;
        for &(score, Reverse((y, x))) in kept.iter() {
            // The room is that of all levels together.
            let _ = all.push(Candidate { level, x, y, score });
        }
    };
    let active = || pyramid.iter().filter(|l| l.level.active);
    #[cfg(feature = "rayon")]
    {
        use rayon::prelude::*;
        if rayon::current_num_threads() > 1 {
            let found: std::vec::Vec<_> = active()
                .collect::<std::vec::Vec<_>>()
                .into_par_iter()
                .with_max_len(1)
                .map(search)
                .collect();
            found.into_iter().for_each(&mut merge);
        } else {
            active().map(search).for_each(&mut merge);
        }
    }
    #[cfg(not(feature = "rayon"))]
    active().map(search).for_each(&mut merge);
    all.sort_unstable_by_key(|c| (Reverse(c.score), c.level, c.y, c.x));
    let rect = |c: &Candidate| nominal(window(c), &pyramid[usize::from(c.level)]);
    detections.dropped +=
        nms::suppress(&mut all, rect, CANDIDATE_OVERLAP, config.candidates.min(MAX_CANDIDATES));
    all
}

/// Cuts the cube of a candidate from the window at `start`: Algorithm 1, and what is known beside the channels.
pub fn cut(
    model: &Model<'_>,
    config: &Config,
    front: &FrontEnd,
    level: &LevelBuffers<'_>,
    candidate: &Candidate,
    start: Position,
    cube: &mut Cube,
) -> Path {
    let regressors = config.compensation.then_some(model.regressors());
    cube.scalars = [0; crate::cube::SCALARS];
    cube.scalars[0] = candidate.score.saturating_add(32768).clamp(0, 65535) as u16;
    cube.scalars[1] = (level.level.target_q4() >> 4) as u16;
    cube.scalars[2] = u16::from(front.registered());
    motion::compensate(&front.slices(level), regressors, start, cube)
}

/// Judges a candidate by its cube and gives it a box; `None` if it is rejected.
fn judge(
    model: &Model<'_>,
    config: &Config,
    front: &FrontEnd,
    level: &LevelBuffers<'_>,
    candidate: &Candidate,
    cube: &mut Cube,
) -> Option<Detection> {
    let path = cut(model, config, front, level, candidate, window(candidate), cube);
    let test = |feature, threshold| model.features().exceeds(feature, threshold, cube);
    let score = if config.stcube { model.cube().cascade(test)? } else { candidate.score };
    // Leaves are in Q8.
    let score = score.saturating_mul(256);
    if score < config.threshold {
        return None;
    }
    let [x, y, width, height] = model.boxes().each_ref().map(|forest| forest.score(test));
    let scale = level.level.scale;
    let centres = path.positions.map(|position| position.centre(scale));
    // Q8 cells to Q8 pixels of the frame. A centre farther than a window away is none of this window's.
    let pixels = |cells: i32| {
        let cells = i64::from(cells.clamp(-FARTHEST_CENTRE, FARTHEST_CENTRE));
        ((cells * CELL as i64 * i64::from(scale)) >> 16) as i32
    };
    let size = |log: i32| {
        ((i64::from(level.level.target_q4()) * i64::from(exp2_q16(log)) + 32768) >> 16) as i32
    };
    let (cx, cy) = centres[0];
    Some(Detection {
        rect: boxed((cx + pixels(x), cy + pixels(y)), size(width), size(height)),
        score,
        shifts: core::array::from_fn(|k| Shift {
            x: I28F4::from_bits((centres[k + 1].0 - cx) >> 4),
            y: I28F4::from_bits((centres[k + 1].1 - cy) >> 4),
        }),
    })
}
