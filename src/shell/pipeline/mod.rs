//! From a source through the detector: the model's bytes, the detector's memory, the loop over frames.

pub mod difference;
mod error;
mod mask_file;
pub mod methods;
mod on_clips;
pub mod scaled;

pub use error::PipelineError;
pub use mask_file::MaskFile;
pub use on_clips::on_clips;

use super::formats::detections::SCORE_BITS;
use super::pipeline::scaled::{FrameSize, Scaling};
use super::sources::{Frame, FrameSource};
use super::support::interrupt::{self, Ended};
use crate::detector::{Buffers, Config, Detections, Detector};
use crate::model::calibration::ONE;
use crate::model::{Method, Model};
use crate::shell::support::bounded_file;
use crate::shell::support::file_error::FileError;
use difference::DifferenceDetector;
use methods::MethodName;
use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;
use std::{format, fs, vec};

/// The model that stands in the program itself.
static SHIPPED: &[u8] = include_bytes!("../../../models/lookout.lkm");

/// Ablations: parts of the method to leave out.
#[derive(Debug, Clone, Copy, Default, clap::Args, serde::Serialize)]
pub struct Ablation {
    /// Ablation: no registration of older frames
    #[arg(long)]
    pub no_registration: bool,
    /// Ablation: no temporal-difference channels
    #[arg(long)]
    pub no_temporal: bool,
    /// Ablation: no st-cube stage, keep the scan's score
    #[arg(long)]
    pub no_stcube: bool,
    /// Ablation: no averaging of scores over frames
    #[arg(long)]
    pub no_persistence: bool,
}

impl Ablation {
    /// The method without the parts that are switched off.
    pub fn of(&self, method: Method) -> Method {
        Method {
            registration: method.registration && !self.no_registration,
            temporal: method.temporal && !self.no_temporal,
            stcube: method.stcube && !self.no_stcube,
            persistence: method.persistence && !self.no_persistence,
            ..method
        }
    }
}

/// Options of every verb that runs the detector.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct DetectorArgs {
    /// Model file (default: the one shipped in this program)
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Least score to report, log-odds (default: all; in replay that of precision 0.9, or -1 if the model has no table)
    #[arg(long, value_name = "SCORE", allow_negative_numbers = true, value_parser = parse_score)]
    pub threshold: Option<i32>,
    /// Least score to report, by its precision on training clips held back, 0 to 1
    #[arg(long, value_name = "P", conflicts_with = "threshold", value_parser = parse_precision)]
    pub min_precision: Option<u32>,
    /// Scale frames to this size before detection; results are in pixels of the unscaled frames
    #[arg(long, value_name = "WxH")]
    pub frame: Option<FrameSize>,
    /// Mask of the own craft: a picture with the frames' aspect ratio, black where nothing is reported (`lookout mask`
    /// makes one)
    #[arg(long, value_name = "FILE")]
    pub mask: Option<PathBuf>,
    /// Parts of the method to leave out.
    #[command(flatten)]
    pub ablation: Ablation,
    /// Ablation: do not trace detections through the slices by Algorithm 1
    #[arg(long)]
    pub no_trace: bool,
    /// Ablation: no box refinement
    #[arg(long)]
    pub no_fit: bool,
}

impl DetectorArgs {
    /// The least score to report by `--threshold` or `--min-precision`, if one is given.
    ///
    /// # Errors
    /// [`PipelineError::NotCalibrated`], [`PipelineError::Precision`].
    pub fn least_score(&self, model: &Model<'_>) -> Result<Option<i32>, PipelineError> {
        let Some(wanted) = self.min_precision else { return Ok(self.threshold) };
        let share = |precision: u32| f64::from(precision) / f64::from(ONE);
        match (model.calibration().threshold(wanted), model.calibration().knots().last()) {
            (Some(score), _) => Ok(Some(score)),
            (None, None) => Err(PipelineError::NotCalibrated { wanted: share(wanted) }),
            (None, Some(best)) => {
                Err(PipelineError::Precision { wanted: share(wanted), best: share(best.precision) })
            }
        }
    }

    /// The configuration for frames of this size: the parts that the model was trained with, less those switched off.
    ///
    /// # Errors
    /// As [`DetectorArgs::least_score`].
    pub fn config(
        &self,
        model: &Model<'_>,
        width: usize,
        height: usize,
    ) -> Result<Config, PipelineError> {
        let mut config = Config::for_model(model, width, height);
        config.method = self.ablation.of(config.method);
        config.threshold = self.least_score(model)?.unwrap_or(config.threshold);
        config.trace &= !self.no_trace;
        config.fit &= !self.no_fit;
        Ok(config)
    }
}

/// A precision as the user writes it, Q16, rounded down.
fn parse_precision(text: &str) -> Result<u32, String> {
    let precision: f64 = text.parse().map_err(|_| format!("'{text}' is not a number"))?;
    let inside = precision > 0.0 && precision <= 1.0;
    if !inside {
        return Err(format!("{text} is not above 0 and at most 1"));
    }
    Ok((precision * f64::from(ONE)) as u32)
}

/// A score as the user writes it, in the detector's units.
fn parse_score(text: &str) -> Result<i32, String> {
    let score: f64 = text.parse().map_err(|_| format!("'{text}' is not a number"))?;
    let one = f64::from(1 << SCORE_BITS);
    let bits = (score * one).round();
    let (low, high) = (f64::from(i32::MIN), f64::from(i32::MAX));
    if (low..=high).contains(&bits) {
        Ok(bits as i32)
    } else {
        Err(format!("{text} is not between {} and {}", low / one, (high / one).floor()))
    }
}

/// Most bytes of a model file; the shipped one has less than 1 MB.
const MOST_BYTES: u64 = 64 << 20;

/// The bytes of a model and where they are from.
#[derive(Debug, Clone)]
pub struct ModelFile {
    path: PathBuf,
    bytes: Cow<'static, [u8]>,
}

impl ModelFile {
    /// Reads a file, or takes the shipped model.
    ///
    /// # Errors
    /// [`FileError::Read`].
    pub fn load(path: Option<&Path>) -> Result<Self, PipelineError> {
        match path {
            Some(path) => {
                let bytes =
                    bounded_file::read(path, MOST_BYTES).map_err(FileError::read(path))?.into();
                Ok(Self { path: path.into(), bytes })
            }
            None => Ok(Self { path: "the shipped model".into(), bytes: SHIPPED.into() }),
        }
    }

    /// Reads METHOD.lkm of a folder, as `lookout train --method` writes it.
    ///
    /// # Errors
    /// [`PipelineError::MethodModel`] when it is not there or says that it is of another method.
    pub fn of_method(folder: &Path, method: MethodName) -> Result<Self, PipelineError> {
        let path = folder.join(format!("{method}.lkm"));
        let refused = |reason| PipelineError::MethodModel { method, path: path.clone(), reason };
        let bytes = fs::read(&path).map_err(|error| refused(format!("cannot read: {error}")))?;
        let file = Self { path: path.clone(), bytes: bytes.into() };
        let provenance = serde_json::from_str(file.parse()?.provenance());
        let provenance: serde_json::Value = provenance.unwrap_or_default();
        match provenance["method"].as_str() {
            Some(other) if other != method.to_string() => {
                Err(refused(format!("a model of the method {other}")))
            }
            _ => Ok(file),
        }
    }

    /// Bytes of the model file.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// CRC-32 of its bytes, as the model's card has it.
    pub fn checksum(&self) -> u32 {
        crate::model::checksum(self.bytes.get(20..).unwrap_or_default())
    }

    /// The checked model.
    ///
    /// # Errors
    /// [`PipelineError::Model`].
    pub fn parse(&self) -> Result<Model<'_>, PipelineError> {
        Model::parse(&self.bytes)
            .map_err(|source| PipelineError::Model { path: self.path.clone(), source })
    }
}

/// The memory of one detector.
#[derive(Debug)]
pub struct Memory {
    bytes: Vec<u8>,
    words: Vec<u16>,
}

impl Memory {
    /// Memory for a detector of this configuration.
    pub fn new(config: &Config) -> Self {
        Self { bytes: vec![0; config.bytes_len()], words: vec![0; config.words_len()] }
    }

    /// The bytes for [`Buffers::bytes`].
    pub fn bytes(&mut self) -> &mut [u8] {
        &mut self.bytes
    }

    /// The bytes and words of [`Buffers`].
    pub fn parts(&mut self) -> (&mut [u8], &mut [u16]) {
        (&mut self.bytes, &mut self.words)
    }

    /// Its size in bytes.
    pub fn len_bytes(&self) -> usize {
        self.bytes.len() + size_of_val(self.words.as_slice())
    }

    /// A detector in this memory.
    ///
    /// # Errors
    /// As [`Detector::new`].
    pub fn detector<'m>(
        &mut self,
        model: &Model<'m>,
        config: Config,
    ) -> Result<Detector<'m, '_>, crate::detector::Error> {
        Detector::new(model, config, Buffers { bytes: &mut self.bytes, words: &mut self.words })
    }
}

/// Hears of each frame: its number (from 1), the frame and what was found in it.
pub type Each<'a, E> = dyn FnMut(u64, &Frame, &Detections) -> Result<(), E> + 'a;

/// Runs a detector over all frames.
///
/// # Errors
/// Those of the source, of the detector and of `each`; [`PipelineError::NoFrames`]. `each` has seen every frame before.
pub fn run<E: From<PipelineError>>(
    input: &str,
    source: &mut dyn FrameSource,
    model: &Model<'_>,
    args: &DetectorArgs,
    each: &mut Each<'_, E>,
) -> Result<Ended, E> {
    let first = first_frame(input, source)?;
    let scaling = Scaling::new(args.frame, first.width, first.height);
    let (width, height) = scaling.seen();
    let config = args.config(model, width, height)?;
    let mask = args.mask.as_deref().map(MaskFile::load).transpose()?;
    let mut memory = Memory::new(&config);
    tracing::debug!(input, ?config, bytes = memory.len_bytes(), "detector");
    let refused = |source| PipelineError::Detector { input: input.into(), frame: 1, source };
    let mut detector = memory.detector(model, config).map_err(refused)?;
    if let Some(mask) = &mask {
        detector.set_mask(mask.for_frames(width, height)?);
    }
    let mut seen = Frame::default();
    let mut process = |frame: &Frame| {
        let mut found = Detections::default();
        if scaling.is_none() {
            detector.process(frame.view(), frame.time_us, &mut found)?;
            return Ok(found);
        }
        scaling.apply(frame, &mut seen);
        detector.process(seen.view(), frame.time_us, &mut found)?;
        scaling.restore(&mut found);
        Ok(found)
    };
    process_all(input, source, first, &mut process, each)
}

/// Runs [`DifferenceDetector`], which needs no model, over all frames.
///
/// # Errors
/// As [`run`].
pub fn run_difference<E: From<PipelineError>>(
    input: &str,
    source: &mut dyn FrameSource,
    threshold: Option<i32>,
    each: &mut Each<'_, E>,
) -> Result<Ended, E> {
    let first = first_frame(input, source)?;
    let mut difference = DifferenceDetector::new(first.width, first.height, threshold);
    process_all(input, source, first, &mut |frame| difference.process(frame.view()), each)
}

fn first_frame(input: &str, source: &mut dyn FrameSource) -> Result<Frame, PipelineError> {
    let mut frame = Frame::default();
    if source.next_frame(&mut frame)? {
        Ok(frame)
    } else {
        Err(PipelineError::NoFrames { input: input.into() })
    }
}

/// Shows `frame` and all that follow it to `process`.
fn process_all<E: From<PipelineError>>(
    input: &str,
    source: &mut dyn FrameSource,
    mut frame: Frame,
    process: &mut dyn FnMut(&Frame) -> Result<Detections, crate::detector::Error>,
    each: &mut Each<'_, E>,
) -> Result<Ended, E> {
    for number in 1.. {
        let refused =
            |source| PipelineError::Detector { input: input.into(), frame: number, source };
        let detections = process(&frame).map_err(refused)?;
        tracing::trace!(number, frame.time_us, found = detections.list.len(), "frame");
        each(number, &frame, &detections)?;
        match source.next_frame(&mut frame) {
            // A decoder of ours may have ended by the same Ctrl-C: no fault of the file.
            _ if interrupt::requested() => return Ok(Ended::Interrupted),
            Ok(true) => {}
            Ok(false) => break,
            Err(error) => return Err(PipelineError::from(error).into()),
        }
    }
    Ok(Ended::Complete)
}

/// Runs `work` with this many threads for the core; 0: one per processor core.
///
/// # Errors
/// [`PipelineError::Threads`].
pub fn on_threads<R: Send>(
    threads: usize,
    work: impl FnOnce() -> R + Send,
) -> Result<R, PipelineError> {
    #[cfg(feature = "rayon")]
    {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let reason = |e| PipelineError::Threads { threads, reason: format!("{e}") };
        Ok(pool.map_err(reason)?.install(work))
    }
    #[cfg(not(feature = "rayon"))]
    {
        if threads > 1 {
            tracing::warn!(threads, "built without the feature rayon: one thread");
        }
        Ok(work())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_model_is_valid() {
        let shipped = ModelFile::load(None).unwrap();
        assert!(shipped.parse().is_ok_and(|model| model.bytes().len() == SHIPPED.len()));
    }

    #[test]
    fn scores_of_the_command_line() {
        assert_eq!(parse_score("-1.5"), Ok(-3 << (SCORE_BITS - 1)));
        assert_eq!(parse_score("0.0000153"), Ok(1));
        for bad in ["x", "nan", "inf", "1e10", "-1e10"] {
            assert!(parse_score(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn precisions_of_the_command_line() {
        assert_eq!(parse_precision("0.5"), Ok(ONE / 2));
        assert_eq!(parse_precision("1"), Ok(ONE));
        for bad in ["x", "nan", "0", "-0.1", "1.01"] {
            assert!(parse_precision(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn switches_reach_the_configuration() {
        let shipped = ModelFile::load(None).unwrap();
        let model = shipped.parse().unwrap();
        let all = DetectorArgs::default().config(&model, 64, 48).unwrap();
        assert_eq!(all, Config::for_model(&model, 64, 48));
        let args = DetectorArgs {
            threshold: Some(5),
            ablation: Ablation {
                no_registration: true,
                no_temporal: true,
                no_stcube: true,
                no_persistence: true,
            },
            no_trace: true,
            no_fit: true,
            ..Default::default()
        };
        let none = Config {
            threshold: 5,
            trace: false,
            fit: false,
            method: Method {
                registration: false,
                temporal: false,
                stcube: false,
                persistence: false,
                ..all.method
            },
            ..all
        };
        assert_eq!(args.config(&model, 64, 48).unwrap(), none);
    }
}
