//! `lookout bench`: how fast the detector is and how much memory it takes.

use super::error::Error;
use super::pipeline::scaled::Scaling;
use super::pipeline::{self, DetectorArgs, Memory, ModelFile};
use super::replay::flight::FlightArgs;
use super::sources::Frame;
use super::support::interrupt::Ended;
use crate::detector::{Config, Detections, Detector, SLICES, Stage};
use crate::model::Model;
use crate::shell::pipeline::PipelineError;
use crate::shell::support::print::print_line;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;
use std::string::String;
use std::time::Instant;
use std::vec::Vec;

/// What `lookout bench` can be told.
#[derive(Debug, Clone, clap::Args)]
pub struct BenchArgs {
    /// What `replay` takes as INPUT; sim: a simulated flight
    #[arg(long, value_name = "INPUT|sim", default_value = "sim")]
    input: String,
    #[command(flatten)]
    detector: DetectorArgs,
    /// Frames to decode into memory before the clock starts
    #[arg(long, value_name = "N", default_value_t = 150, value_parser = clap::value_parser!(u64).range(1..))]
    frames: u64,
    /// Times that the detector runs over them
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..))]
    passes: u64,
    /// Threads to use; 0: one a processor core
    #[arg(long, value_name = "N", default_value_t = 1)]
    threads: usize,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    flight: FlightArgs,
}

impl BenchArgs {
    fn input(&self) -> Option<&str> {
        Some(self.input.as_str()).filter(|&input| input != "sim")
    }
}

/// What was measured. Times are medians over the frames of all passes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figures {
    /// One over the median time of a frame.
    pub frames_per_second: f64,
    /// Median milliseconds of each stage in a frame.
    pub stages_ms: BTreeMap<&'static str, f64>,
    /// All memory of the detector.
    pub buffer_bytes: usize,
    /// Frames in a pass.
    pub frames: usize,
    /// Times that the detector ran over them.
    pub passes: u64,
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Threads the detector could use; 0: one a processor core.
    pub threads: usize,
    /// Mean number of windows that the scan looked at in a frame.
    pub windows_per_frame: f64,
    /// Mean number of windows that the scan kept in a frame.
    pub kept_per_frame: f64,
    /// Mean number of detections in a frame.
    pub detections_per_frame: f64,
    /// Candidates or detections that found no room, in all.
    pub dropped: u64,
}

/// Measures, and prints the figures.
///
/// # Errors
/// [`Error`].
pub fn run(args: &BenchArgs) -> Result<Ended, Error> {
    let model = ModelFile::load(args.detector.model.as_deref())?;
    let model = model.parse()?;
    let figures = pipeline::on_threads(args.threads, || measure(args, &model))??;
    if args.json {
        print_line(&serde_json::to_string(&figures).expect("numbers and names always make JSON"))?;
    } else {
        print_line(&std::format!("{figures}"))?;
    }
    Ok(Ended::Complete)
}

fn measure(args: &BenchArgs, model: &Model<'_>) -> Result<Figures, Error> {
    let input = args.flight.name(args.input());
    let frames = decode(args)?;
    let Some(Frame { width, height, .. }) = frames.first() else {
        return Err(PipelineError::NoFrames { input }.into());
    };
    let config = args.detector.config(model, *width, *height)?;
    let mut memory = Memory::new(&config);
    let mut clock = Clock::default();
    for pass in 0..args.passes {
        let refused = |frame| {
            let input = input.clone();
            move |source| PipelineError::Detector { input, frame, source }
        };
        let mut detector = memory.detector(model, config).map_err(refused(1))?;
        for (index, frame) in frames.iter().enumerate() {
            // While the st-cube fills there is less to do: not typical.
            let counts = index >= SLICES || frames.len() <= SLICES;
            clock
                .time(&mut detector, frame, counts, pass == 0)
                .map_err(refused(index as u64 + 1))?;
        }
    }
    Ok(clock.figures(args, &config, memory.len_bytes(), frames.len()))
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

/// Times of frames and stages in seconds, counts of the first pass.
#[derive(Debug, Default)]
struct Clock {
    frames: Vec<f64>,
    stages: [Vec<f64>; Stage::ALL.len()],
    windows: u64,
    kept: u64,
    found: u64,
    dropped: u64,
}

impl Clock {
    fn time(
        &mut self,
        detector: &mut Detector<'_, '_>,
        frame: &Frame,
        timed: bool,
        counted: bool,
    ) -> Result<(), crate::detector::Error> {
        let start = Instant::now();
        let mut last = start;
        let mut stages = [0.0; Stage::ALL.len()];
        let found = detector.process_observed(frame.view(), frame.time_us, &mut |stage| {
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
    ) -> Figures {
        let a_frame = |count: u64| count as f64 / frames as f64;
        Figures {
            frames_per_second: 1.0 / median(&mut self.frames).max(1e-9),
            stages_ms: Stage::ALL
                .map(|stage| (stage.name(), median(&mut self.stages[stage as usize]) * 1e3))
                .into(),
            buffer_bytes: buffers + size_of::<Detector<'_, '_>>(),
            frames,
            passes: args.passes,
            width: config.width,
            height: config.height,
            threads: args.threads,
            windows_per_frame: a_frame(self.windows),
            kept_per_frame: a_frame(self.kept),
            detections_per_frame: a_frame(self.found),
            dropped: self.dropped,
        }
    }
}

/// The middle one, or the mean of the two in the middle.
fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => 0.0,
        n => values[(n - 1) / 2].midpoint(values[n / 2]),
    }
}

impl fmt::Display for Figures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { width, height, frames, passes, .. } = self;
        writeln!(
            f,
            "{width}x{height}, {frames} frames, {passes} passes, threads: {}",
            self.threads
        )?;
        writeln!(f, "frames a second {:9.1} (median)", self.frames_per_second)?;
        for stage in Stage::ALL {
            let time = self.stages_ms.get(stage.name()).copied().unwrap_or_default();
            writeln!(f, "{:15} {time:9.3} ms", stage.name())?;
        }
        writeln!(f, "memory          {:9.1} MB", self.buffer_bytes as f64 / 1e6)?;
        writeln!(
            f,
            "windows a frame {:9.0}, kept {:.1}, detections {:.2}",
            self.windows_per_frame, self.kept_per_frame, self.detections_per_frame
        )?;
        write!(f, "dropped         {:9}", self.dropped)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians() {
        assert_eq!(median(&mut []), 0.0);
        assert_eq!(median(&mut [3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&mut [4.0, 1.0, 2.0, 9.0]), 3.0);
    }

    #[test]
    fn stages_index_their_own_row() {
        for (index, stage) in Stage::ALL.into_iter().enumerate() {
            assert_eq!(stage as usize, index);
        }
    }
}
