//! The detector: frames in, detections out.
//!
//! In: grey frames of one camera and their times, a checked model, memory. Out: boxes with scores. Imports every folder
//! above it in ARCHITECTURE.md's table of layers; each stage is one of those folders.

pub mod classifier;
mod config;
pub mod detection;
pub mod digest;
pub mod mask;
pub mod temporal_score;

use crate::channels::front_end::FrontEnd;
use crate::channels::method::Alignment;
use crate::image::nms;
use crate::image::{Image, Rect};
use crate::math::threads;
use crate::model::Model;
use crate::registration::global_motion::GlobalMotion;
use crate::scan::cascade::Candidate;
use crate::scan::{self, ScanWork, Scratch, window};
use classifier::{CubeClassifier, Scored, Workspace};
use temporal_score::Persistence;

pub use crate::channels::history::History;
pub use crate::channels::window::SLICES;
pub use crate::scan::MAX_CANDIDATES;
pub use config::{Buffers, Config, Error, MAX_SIDE, TARGETS};
pub use detection::{Detection, Shift};
pub use mask::Mask;

/// Most detections of one frame.
pub const MAX_DETECTIONS: usize = 64;

/// Detections that are refined per frame, the best ones, by [`History`].
const MAX_REFINED: [usize; 2] = [10, 3];

/// Log-odds of a window (Q16) below which its detection is not refined. On `airborne/dev`'s flight_001 refining takes 2.5 ms
/// of a frame instead of 11.4; AveP is 0.815 / 0.897 instead of 0.813 / 0.898.
const LEAST_REFINED: i32 = -2 << 16;

/// Candidates that one thread classifies at a time.
const PIECE: usize = 4;

/// Overlap (IoU, Q8) above which the weaker of two detections goes.
const DETECTION_OVERLAP: u8 = 64;

/// Longest time between two frames of one history, microseconds: [`Detector::process`].
pub const MAX_GAP_US: i64 = 1_000_000;

/// A step of [`Detector::process`], named to an observer when it has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DetectorStage {
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

impl DetectorStage {
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

/// Result of one frame.
///
/// ```
/// use lookout::detector::Detections;
///
/// /// The box of the best detection, pixels of the frame.
/// fn best(detections: &Detections) -> Option<[f32; 4]> {
///     let rect = detections.list.first()?.rect;
///     Some([rect.x, rect.y, rect.width, rect.height].map(|side| side.to_num()))
/// }
///
/// assert_eq!(best(&Detections::default()), None);
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Detections {
    /// The detections, highest score first.
    pub list: heapless::Vec<Detection, MAX_DETECTIONS>,
    /// Proposals: boxes of the nominal target in the windows kept by the scan, best first.
    pub proposals: heapless::Vec<Rect, MAX_CANDIDATES>,
    /// Windows that the scan evaluated.
    pub windows: u32,
    /// Windows that passed the whole cascade.
    pub kept: u32,
    /// Windows and detections left out for want of room.
    pub dropped: u32,
    /// Whether the history was empty before this frame: it is the first one, or its time is earlier than the last one's or
    /// more than [`MAX_GAP_US`] later.
    pub restarted: bool,
    /// Whether the background's motion could be measured; if not, older frames were left where they are.
    pub registered: bool,
    /// Where each point of the background was in the frame before; not valid where that could not be measured.
    pub motion: GlobalMotion,
}

/// Finds flying objects in the frames of one camera.
///
/// ```
/// use lookout::detector::{Buffers, Config, Detections, Detector, Error};
/// use lookout::image::Image;
/// use lookout::model::Model;
///
/// let model = Model::parse(include_bytes!("../../models/lookout.lkm"))?;
/// let config = Config::for_model(&model, 96, 80);
/// let (mut bytes, mut words) = (vec![0; config.bytes_len()], vec![0; config.words_len()]);
/// let buffers = Buffers { bytes: &mut bytes, words: &mut words };
/// let mut detector = Detector::new(&model, config, buffers)?;
///
/// let pixels = [90; 96 * 80];
/// let mut detections = Detections::default();
/// // 30 frames a second, and one after a gap of 5 s: the history starts anew.
/// for (time_us, restarted) in [(0, true), (33_333, false), (5_033_333, true)] {
///     detector.process(Image::packed(&pixels, 96, 80)?, time_us, &mut detections)?;
///     assert_eq!(detections.restarted, restarted);
/// }
/// // Frames of another size are refused.
/// let other = Image::packed(&pixels, 80, 96)?;
/// let refused = detector.process(other, 5_066_666, &mut detections);
/// assert_eq!(refused, Err(Error::FrameSize { width: 80, height: 96 }));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Detector<'m, 'b> {
    model: Model<'m>,
    config: Config,
    front_end: FrontEnd<'b>,
    persistence: Persistence<MAX_DETECTIONS>,
    mask: Option<Mask<'m>>,
    /// Time of the last frame.
    last_us: Option<i64>,
    words: &'b mut [u16],
}

impl<'m, 'b> Detector<'m, 'b> {
    /// A detector that has seen no frame yet.
    ///
    /// # Errors
    /// [`Error::ModelMismatch`]; [`Error::UnsupportedSize`]; [`Error::BufferTooSmall`] with the number of elements needed.
    pub fn new(model: &Model<'m>, config: Config, buffers: Buffers<'b>) -> Result<Self, Error> {
        let linked = cfg!(feature = "std") || !matches!(config.method.alignment, Alignment::Flow);
        if !linked || !model.method().allows(&config.method) {
            return Err(Error::ModelMismatch);
        }
        let Buffers { bytes, words } = buffers;
        let front_end = config.front_end(bytes)?;
        let needed = config.words_len();
        if words.len() < needed {
            return Err(Error::BufferTooSmall { needed });
        }
        Ok(Self {
            model: *model,
            config,
            front_end,
            persistence: Persistence::new(),
            mask: None,
            last_us: None,
            words,
        })
    }

    /// Reports nothing where `picture`, laid over the whole frame, is 0: the own craft's parts, or text in the picture. An
    /// empty picture hides nothing.
    pub const fn set_mask(&mut self, picture: Image<'m>) {
        self.mask = Some(Mask::new(picture, (self.config.width, self.config.height)));
    }

    /// Finds objects in one frame taken at `time_us` (microseconds of any epoch) and writes them to `detections`, which is
    /// cleared before. A time before the last frame's, or more than [`MAX_GAP_US`] after it, starts the history anew;
    /// [`Detections::restarted`] says so.
    ///
    /// # Errors
    /// [`Error::FrameSize`] when the frame has another size than the configuration; detector and `detections` are
    /// unchanged.
    pub fn process(
        &mut self,
        frame: Image<'_>,
        time_us: i64,
        detections: &mut Detections,
    ) -> Result<(), Error> {
        self.process_observed(frame, time_us, detections, &mut |_| {})
    }

    /// As [`Detector::process`]; `observer` is called with each stage as it ends (the core has no clock).
    ///
    /// # Errors
    /// As [`Detector::process`].
    #[inline(never)]
    pub fn process_observed(
        &mut self,
        frame: Image<'_>,
        time_us: i64,
        detections: &mut Detections,
        observer: &mut dyn FnMut(DetectorStage),
    ) -> Result<(), Error> {
        self.front_end.check(frame)?;
        let continues = |last: i64| (0..=MAX_GAP_US).contains(&time_us.saturating_sub(last));
        let restarted = !self.last_us.is_some_and(continues);
        if restarted {
            self.front_end.restart();
            self.persistence.clear();
        }
        self.last_us = Some(time_us);
        let Self { model, config, front_end, persistence, words, .. } = self;
        let (channels, scratch) =
            front_end.process(frame, &mut || observer(DetectorStage::Registration))?;
        observer(DetectorStage::Channels);
        let (scratch, pyramid) = (Scratch { bytes: scratch, words }, &channels.pyramid);
        let (mut candidates, ScanWork { windows, kept, dropped }) =
            scan::search(model.scan(), pyramid, config.candidates, config.parallel, scratch);
        if let Some(mask) = &self.mask {
            let level = |c: &Candidate| pyramid.geometry().level(usize::from(c.level));
            candidates.retain(|c| !mask.hides(&level(c).nominal_box(window(c))));
        }
        observer(DetectorStage::Scan);
        detections.list.clear();
        detections.proposals.clear();
        (detections.windows, detections.kept, detections.dropped) = (windows, kept, dropped);
        detections.restarted = restarted;
        (detections.registered, detections.motion) = (channels.registered(), channels.motion());
        let Config { method, trace, fit, .. } = *config;
        let classifier = CubeClassifier { model, method, trace, fit, channels };
        decide(config, &classifier, (&candidates, self.mask), persistence, detections, observer);
        observer(DetectorStage::Boxes);
        Ok(())
    }

    /// Gives the memory back.
    pub fn release(self) -> Buffers<'b> {
        Buffers { bytes: self.front_end.release(), words: self.words }
    }
}

/// Classifies the proposals and fills the lists of `detections`.
// Not inlined: the cube and the lists are to be on the stack only now.
#[inline(never)]
fn decide(
    config: &Config,
    classifier: &CubeClassifier<'_>,
    (candidates, mask): (&[Candidate], Option<Mask<'_>>),
    persistence: &mut Persistence<MAX_DETECTIONS>,
    detections: &mut Detections,
    observer: &mut dyn FnMut(DetectorStage),
) {
    let mut found: heapless::Vec<Scored, MAX_CANDIDATES> = heapless::Vec::new();
    for candidate in candidates {
        let level = classifier.channels.pyramid.geometry().level(usize::from(candidate.level));
        // As much room as there are candidates, here and below.
        let _ = detections.proposals.push(level.nominal_box(window(candidate)));
    }
    let parallel = config.parallel && threads::several();
    let mut workspace = Workspace::empty();
    if parallel {
        let mut scored = [None; MAX_CANDIDATES];
        threads::pieces(&mut scored[..candidates.len()], PIECE, true, |number, scored| {
            let mut workspace = Workspace::empty();
            for (scored, candidate) in scored.iter_mut().zip(&candidates[number * PIECE..]) {
                *scored = classifier.classify(candidate, &mut workspace);
            }
        });
        found.extend(scored.into_iter().flatten());
    } else {
        found.extend(candidates.iter().filter_map(|c| classifier.classify(c, &mut workspace)));
    }
    found.sort_unstable_by_key(Scored::rank);
    let suppress = |found: &mut [Scored]| {
        nms::suppress(found, |s| s.detection.rect, DETECTION_OVERLAP, MAX_DETECTIONS)
    };
    let (length, dropped) = suppress(&mut found);
    found.truncate(length);
    detections.dropped += dropped;
    observer(DetectorStage::Cubes);
    let refined = found.iter().take(MAX_REFINED[config.method.history as usize]);
    let refined = refined.take_while(|s| s.detection.score >= LEAST_REFINED).count();
    let best = found.get_mut(..refined).unwrap_or_default();
    if parallel {
        threads::pieces(best, 1, true, |_, scored| {
            let mut workspace = Workspace::empty();
            scored.iter_mut().for_each(|scored| classifier.refine(scored, &mut workspace));
        });
    } else {
        best.iter_mut().for_each(|scored| classifier.refine(scored, &mut workspace));
    }
    if config.method.persistence {
        persistence.weigh(&mut found, &detections.motion);
    }
    found.retain(|scored| scored.detection.score >= config.threshold);
    // A window that hangs over the edge may give a box beyond it; only what is in the frame was seen.
    found.retain_mut(|Scored { detection, .. }| {
        detection.rect = detection.rect.within(config.width, config.height);
        let Rect { width, height, .. } = detection.rect;
        width > 0 && height > 0 && !mask.is_some_and(|mask| mask.hides(&detection.rect))
    });
    found.sort_unstable_by_key(Scored::rank);
    let (length, _) = suppress(&mut found);
    found.truncate(length);
    detections.list.extend(found.iter().map(|s| s.detection));
}
