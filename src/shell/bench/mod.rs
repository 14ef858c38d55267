//! `lookout bench`: how fast the detector is and how much memory it takes.

mod figures;
mod machine;

use super::error::Error;
use super::pipeline::scaled::Scaling;
use super::pipeline::{self, DetectorArgs, MaskFile, Memory, ModelFile};
use super::replay::flight::FlightArgs;
use super::sources::Frame;
use super::support::interrupt::Ended;
use crate::detector::{Config, Detections, Detector, DetectorStage, SLICES};
use crate::model::Model;
use crate::scan::{self, Scratch};
use crate::shell::pipeline::PipelineError;
use crate::shell::support::print::print_line;
pub use figures::{BenchFigures, Times};
use std::format;
use std::fs;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::time::Instant;
use std::vec::Vec;

/// Arguments of `lookout bench`.
#[derive(Debug, Clone, clap::Args)]
pub struct BenchArgs {
    /// Input as for `replay`; sim: a simulated flight
    #[arg(long, value_name = "INPUT|sim", default_value = "sim")]
    input: PathBuf,
    #[command(flatten)]
    detector: DetectorArgs,
    /// Frames to decode into memory before the measurement
    #[arg(long, value_name = "N", default_value_t = 150, value_parser = clap::value_parser!(u64).range(1..))]
    frames: u64,
    /// Passes over these frames
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..))]
    passes: u64,
    /// Threads to use; 0: one per processor core
    #[arg(long, value_name = "N", default_value_t = 1)]
    threads: usize,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Figures of another run, as --json printed them, to compare with
    #[arg(long, value_name = "OTHER.json", conflicts_with = "json")]
    compare: Option<PathBuf>,
    #[command(flatten)]
    flight: FlightArgs,
}

impl BenchArgs {
    fn input(&self) -> Option<&Path> {
        Some(self.input.as_path()).filter(|input| *input != Path::new("sim"))
    }
}

/// Measures, and prints the figures.
///
/// # Errors
/// [`Error`].
#[allow(clippy::expect_used, reason = "numbers and names always make JSON")]
pub fn run(args: &BenchArgs) -> Result<Ended, Error> {
    // Read first: a mistake in the name is not to cost the time of a measurement.
    let other = args.compare.as_deref().map(read).transpose()?;
    let model = ModelFile::load(args.detector.model.as_deref())?;
    let model = model.parse()?;
    let figures = pipeline::on_threads(args.threads, || measure(args, &model))??;
    if args.json {
        print_line(&serde_json::to_string(&figures).expect("numbers and names always make JSON"))?;
    } else if let Some(other) = &other {
        print_line(&figures.compared(other).to_string())?;
    } else {
        print_line(&format!("{figures}"))?;
    }
    Ok(Ended::Complete)
}

/// Figures of another run.
fn read(path: &Path) -> Result<BenchFigures, Error> {
    let text = fs::read_to_string(path).map_err(Error::read(path))?;
    serde_json::from_str(&text)
        .map_err(|source| Error::verb(NotFigures { path: path.to_path_buf(), source }))
}

/// A file to compare with that holds no figures.
#[derive(Debug, thiserror::Error)]
#[error("{}: {source}; give what `lookout bench --json` of this version printed", path.display())]
struct NotFigures {
    path: PathBuf,
    source: serde_json::Error,
}

fn measure(args: &BenchArgs, model: &Model<'_>) -> Result<BenchFigures, Error> {
    let input = args.flight.name(args.input());
    let frames = decode(args)?;
    let Some(Frame { width, height, .. }) = frames.first() else {
        return Err(PipelineError::NoFrames { input }.into());
    };
    let config = args.detector.config(model, *width, *height)?;
    let mask = args.detector.mask.as_deref().map(MaskFile::load).transpose()?;
    let mask = mask.as_ref().map(|mask| mask.for_frames(*width, *height)).transpose()?;
    let mut memory = Memory::new(&config);
    let mut clock = StageTimes::default();
    for pass in 0..args.passes {
        let refused = |frame| {
            let input = input.clone();
            move |source| PipelineError::Detector { input, frame, source }
        };
        let mut detector = memory.detector(model, config).map_err(refused(1))?;
        if let Some(mask) = mask {
            detector.set_mask(mask);
        }
        for (index, frame) in frames.iter().enumerate() {
            // While the st-cube fills there is less to do: not typical.
            let counts = index >= SLICES || frames.len() <= SLICES;
            clock
                .time(&mut detector, frame, counts, pass == 0)
                .map_err(refused(index as u64 + 1))?;
        }
    }
    let trees = trees_per_window(model, &config, &frames, &mut memory)
        .map_err(|source| PipelineError::Detector { input, frame: 1, source })?;
    Ok(clock.figures(args, &config, memory.len_bytes(), frames.len(), trees))
}

fn decode(args: &BenchArgs) -> Result<Vec<Frame>, Error> {
    let mut source = args.flight.open(args.input())?;
    let mut frames = Vec::new();
    while (frames.len() as u64) < args.frames {
        let mut frame = Frame::default();
        if !source.next_frame(&mut frame)? {
            break;
        }
        let scaling = Scaling::new(args.detector.frame, frame.width, frame.height);
        let mut seen = Frame::default();
        scaling.apply(&frame, &mut seen);
        frames.push(seen);
    }
    Ok(frames)
}

/// Frames in which trees are counted, from the first one on.
const COUNTED: usize = 30;

/// Mean number of trees of the scan that a window passes until it is rejected, in the first frames. Counted apart from
/// the measurement: in vector registers windows are not evaluated one by one.
fn trees_per_window(
    model: &Model<'_>,
    config: &Config,
    frames: &[Frame],
    memory: &mut Memory,
) -> Result<f64, crate::detector::Error> {
    let (bytes, words) = memory.parts();
    let mut front_end = config.front_end(bytes)?;
    let (mut trees, mut windows) = (0, 0);
    for frame in frames.iter().take(COUNTED) {
        let (channels, scratch) = front_end.process(frame.view(), &mut || {})?;
        let scratch = Scratch { bytes: scratch, words };
        let counted = scan::count_trees(model.scan(), &channels.pyramid, scratch);
        trees += counted.0;
        windows += counted.1;
    }
    Ok(trees as f64 / (windows as f64).max(1.0))
}

/// Times of frames and stages in seconds, counts of the first pass.
#[derive(Debug, Default)]
struct StageTimes {
    frames: Vec<f64>,
    stages: [Vec<f64>; DetectorStage::ALL.len()],
    windows: u64,
    kept: u64,
    found: u64,
    dropped: u64,
}

impl StageTimes {
    fn time(
        &mut self,
        detector: &mut Detector<'_, '_>,
        frame: &Frame,
        timed: bool,
        counted: bool,
    ) -> Result<(), crate::detector::Error> {
        let start = Instant::now();
        let mut last = start;
        let mut stages = [0.0; DetectorStage::ALL.len()];
        let mut found = Detections::default();
        detector.process_observed(frame.view(), frame.time_us, &mut found, &mut |stage| {
            let now = Instant::now();
            // A stage may be entered more than once in a frame.
            stages[stage as usize] += (now - last).as_secs_f64();
            last = now;
        })?;
        let whole = start.elapsed().as_secs_f64();
        if timed {
            self.frames.push(whole);
            self.stages.iter_mut().zip(stages).for_each(|(all, time)| all.push(time));
        }
        if counted {
            self.count(&found);
        }
        Ok(())
    }

    fn count(&mut self, found: &Detections) {
        self.windows += u64::from(found.windows);
        self.kept += u64::from(found.kept);
        self.found += found.list.len() as u64;
        self.dropped += u64::from(found.dropped);
    }

    fn figures(
        mut self,
        args: &BenchArgs,
        config: &Config,
        buffers: usize,
        frames: usize,
        trees_per_window: f64,
    ) -> BenchFigures {
        let a_frame = |count: u64| count as f64 / frames as f64;
        let frame_ms = Times::of_seconds(&mut self.frames);
        let stage = |stage: DetectorStage| {
            (stage.name().to_string(), Times::of_seconds(&mut self.stages[stage as usize]))
        };
        let stages: Vec<_> = DetectorStage::ALL.map(stage).into();
        BenchFigures {
            frames_per_second: 1e3 / frame_ms.median.max(1e-6),
            frame_ms,
            stages_ms: stages.iter().map(|(name, times)| (name.clone(), times.median)).collect(),
            stages_p95_ms: stages.into_iter().map(|(name, times)| (name, times.p95)).collect(),
            buffer_bytes: buffers + size_of::<Detector<'_, '_>>(),
            frames,
            passes: args.passes,
            width: config.width,
            height: config.height,
            threads: args.threads,
            windows_per_frame: a_frame(self.windows),
            trees_per_window,
            kept_per_frame: a_frame(self.kept),
            detections_per_frame: a_frame(self.found),
            dropped: self.dropped,
            processor: machine::processor(),
            instruction_set: scan::lanes::Lanes::fastest().name().to_string(),
            version: env!("CARGO_PKG_VERSION").to_string(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_index_their_own_row() {
        for (index, stage) in DetectorStage::ALL.into_iter().enumerate() {
            assert_eq!(stage as usize, index);
        }
    }
}
