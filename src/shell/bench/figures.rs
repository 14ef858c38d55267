//! The figures of a run of `lookout bench`, printed and compared.

use crate::detector::DetectorStage;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;
use std::string::String;

/// Median and 95th percentile of times, in milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Times {
    /// The middle one, or the mean of the two in the middle.
    pub median: f64,
    /// The smallest that at least 95 of 100 do not exceed.
    pub p95: f64,
}

impl Times {
    /// Of times in seconds, which are sorted; 0 where there are none.
    pub fn of_seconds(seconds: &mut [f64]) -> Self {
        seconds.sort_by(f64::total_cmp);
        let at = |n: usize| seconds.get(n).copied().unwrap_or(0.0) * 1e3;
        let count = seconds.len();
        let before_middle = count.saturating_sub(1) / 2;
        Self {
            median: at(before_middle).midpoint(at(count / 2)),
            p95: at((count * 95).div_ceil(100).saturating_sub(1)),
        }
    }
}

/// Figures of a run. Times are over the frames of all passes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BenchFigures {
    /// One over the median time of a frame.
    pub frames_per_second: f64,
    /// Times of a frame.
    pub frame_ms: Times,
    /// Median milliseconds of each stage in a frame.
    pub stages_ms: BTreeMap<String, f64>,
    /// 95th percentile of the milliseconds of each stage in a frame.
    pub stages_p95_ms: BTreeMap<String, f64>,
    /// All memory of the detector.
    pub buffer_bytes: usize,
    /// Frames in a pass.
    pub frames: usize,
    /// Times that the detector ran over them.
    pub passes: u64,
    /// Pixels in a row.
    pub width: usize,
    /// Rows of a frame.
    pub height: usize,
    /// Threads the detector could use; 0: one a processor core.
    pub threads: usize,
    /// Mean number of windows that the scan evaluated in a frame.
    pub windows_per_frame: f64,
    /// Mean number of trees that a window of the scan passes until it is rejected.
    pub trees_per_window: f64,
    /// Mean number of windows that the scan kept in a frame.
    pub kept_per_frame: f64,
    /// Mean number of detections in a frame.
    pub detections_per_frame: f64,
    /// Candidates or detections that found no room, in all.
    pub dropped: u64,
    /// Name of the processor as the operating system gives it.
    pub processor: String,
    /// Instructions that the scan uses.
    pub instruction_set: String,
    /// Version of the program that measured.
    pub version: String,
}

impl BenchFigures {
    /// To print beside those of another run.
    pub fn compared<'a>(&'a self, other: &'a Self) -> Comparison<'a> {
        Comparison { this: self, other }
    }

    /// Times that are printed: name, median, 95th percentile.
    fn times(&self) -> impl Iterator<Item = (&'static str, Times)> {
        let of = |times: &BTreeMap<String, f64>, stage: DetectorStage| {
            times.get(stage.name()).copied().unwrap_or_default()
        };
        let stages = DetectorStage::ALL.map(|stage| {
            let (median, p95) = (of(&self.stages_ms, stage), of(&self.stages_p95_ms, stage));
            (stage.name(), Times { median, p95 })
        });
        stages.into_iter().chain([("frame", self.frame_ms)])
    }
}

impl fmt::Display for BenchFigures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { width, height, frames, passes, threads, .. } = self;
        writeln!(f, "{width}x{height}, {frames} frames, {passes} passes, threads: {threads}")?;
        writeln!(f, "{}, {}, lookout {}", self.processor, self.instruction_set, self.version)?;
        writeln!(f, "frames a second {:9.1} (median)", self.frames_per_second)?;
        writeln!(f, "{:15} {:>9} {:>9}", "milliseconds", "median", "95 %")?;
        for (name, Times { median, p95 }) in self.times() {
            writeln!(f, "{name:15} {median:9.3} {p95:9.3}")?;
        }
        writeln!(f, "memory          {:9.1} MB", self.buffer_bytes as f64 / 1e6)?;
        writeln!(
            f,
            "windows a frame {:9.0}, trees a window {:.2}, kept {:.1}, detections {:.2}",
            self.windows_per_frame,
            self.trees_per_window,
            self.kept_per_frame,
            self.detections_per_frame
        )?;
        write!(f, "dropped         {:9}", self.dropped)
    }
}

/// Figures of two runs.
#[derive(Debug, Clone, Copy)]
pub struct Comparison<'a> {
    this: &'a BenchFigures,
    other: &'a BenchFigures,
}

impl fmt::Display for Comparison<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { this, other } = self;
        for (name, run) in [("this", this), ("other", other)] {
            let BenchFigures { width, height, frames, threads, .. } = run;
            let machine = (&run.processor, &run.instruction_set, &run.version);
            writeln!(
                f,
                "{name:6} {width}x{height}, {frames} frames, threads: {threads}; {}, {}, lookout {}",
                machine.0, machine.1, machine.2
            )?;
        }
        let work = |run: &BenchFigures| (run.width, run.height, run.frames);
        if work(this) != work(other) {
            writeln!(f, "not of the same frames: times are of different work")?;
        }
        writeln!(f, "{:22} {:>9} {:>9} {:>9}", "", "this", "other", "this/other")?;
        let mut row = |name: &str, unit: &str, a: f64, b: f64| {
            let ratio = if b == 0.0 { 1.0 } else { a / b };
            writeln!(f, "{:22} {a:9.3} {b:9.3} {ratio:9.3}", std::format!("{name} {unit}"))
        };
        for ((name, a), (_, b)) in this.times().zip(other.times()) {
            row(name, "ms", a.median, b.median)?;
            row(name, "ms, 95 %", a.p95, b.p95)?;
        }
        let megabytes = |run: &BenchFigures| run.buffer_bytes as f64 / 1e6;
        row("memory", "MB", megabytes(this), megabytes(other))?;
        row("windows", "a frame", this.windows_per_frame, other.windows_per_frame)?;
        row("trees", "a window", this.trees_per_window, other.trees_per_window)?;
        row("detections", "a frame", this.detections_per_frame, other.detections_per_frame)?;
        let ratio = this.frames_per_second / other.frames_per_second.max(1e-9);
        write!(f, "frames a second: {ratio:.2} times the other's")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn medians_and_percentiles() {
        let of = |mut seconds: [f64; 4]| Times::of_seconds(&mut seconds);
        assert_eq!(Times::of_seconds(&mut []), Times { median: 0.0, p95: 0.0 });
        assert_eq!(Times::of_seconds(&mut [3.0, 1.0, 2.0]), Times { median: 2000.0, p95: 3000.0 });
        assert_eq!(of([4.0, 1.0, 2.0, 9.0]), Times { median: 3000.0, p95: 9000.0 });
        let mut hundred: [f64; 100] = core::array::from_fn(|i| (100 - i) as f64 / 1e3);
        assert_eq!(Times::of_seconds(&mut hundred), Times { median: 50.5, p95: 95.0 });
    }

    fn figures(frame: f64) -> BenchFigures {
        let times = |by: f64| DetectorStage::ALL.map(|stage| (stage.name().to_string(), by)).into();
        BenchFigures {
            frames_per_second: 1e3 / frame,
            frame_ms: Times { median: frame, p95: 2.0 * frame },
            stages_ms: times(frame / 5.0),
            stages_p95_ms: times(frame),
            buffer_bytes: 8_000_000,
            frames: 15,
            passes: 1,
            width: 640,
            height: 480,
            threads: 1,
            windows_per_frame: 1000.0,
            trees_per_window: 17.5,
            kept_per_frame: 5.0,
            detections_per_frame: 2.0,
            dropped: 0,
            processor: "P".to_string(),
            instruction_set: "scalar".to_string(),
            version: "1".to_string(),
        }
    }

    #[test]
    fn figures_survive_json_and_compare() {
        let (fast, slow) = (figures(10.0), figures(30.0));
        let text = serde_json::to_string(&slow).unwrap();
        assert_eq!(serde_json::from_str::<BenchFigures>(&text).unwrap(), slow);
        let text = fast.compared(&slow).to_string();
        assert!(text.ends_with("frames a second: 3.00 times the other's"), "{text}");
        assert!(
            text.lines().any(|line| line
                .split_whitespace()
                .eq(["frame", "ms", "10.000", "30.000", "0.333"])),
            "{text}"
        );
        assert!(!text.contains("different work"));
        let other = BenchFigures { width: 320, ..slow };
        assert!(fast.compared(&other).to_string().contains("different work"));
        assert!(fast.to_string().contains("trees a window 17.50"));
    }
}
