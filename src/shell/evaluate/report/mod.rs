//! The report of `lookout eval`: the detector and other methods beside each other, as one page without network and as JSON.

mod breakdown;
mod collisions;
mod curves;
mod elements;
mod figures;
mod gallery;
mod html;
mod matched;
mod methods;
mod plot;
mod regressors;
mod sections;

pub use figures::{IOUS, InUse, LOOSE};
pub use methods::{External, FrameMeasurements, MeasuringObserver, path_of, readable};

use super::matching::{DetectionRecord, WARMUP};
use super::splits::{Splits, keep};
use crate::model::Model;
use crate::shell::error::Error;
use crate::shell::evaluate::EvaluateError;
use crate::shell::formats::clips::Clip;
use crate::shell::pipeline::DetectorArgs;
use crate::shell::support::file_error::FileError;
use crate::shell::support::interrupt::Ended;
use breakdown::ClipTruth;
use figures::ReportFigures;
use methods::{Detected, MethodDetections, OURS, median};
use regressors::RegressorFigures;
use std::fs;
use std::path::{Path, PathBuf};
use std::string::String;
use std::vec::Vec;

/// Options of a report.
#[derive(Debug, Clone, clap::Args)]
pub struct ReportArgs {
    /// Write report.html and report.json into this folder
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// Compare the detections in FOLDER (CLIP.txt, MOTChallenge) in the report
    #[arg(long, value_name = "NAME=FOLDER", requires = "report", value_parser = External::parse)]
    external: Vec<External>,
}

impl ReportArgs {
    /// Whether the options ask for a report.
    pub fn wanted(&self) -> bool {
        self.report.is_some()
    }
}

/// A report that waits for our detector's run.
#[derive(Debug)]
pub struct Plan {
    folder: PathBuf,
    others: Vec<MethodDetections>,
    regressors: Option<RegressorFigures>,
}

impl Plan {
    /// Reads what is there before the run; none if no report is wanted.
    ///
    /// # Errors
    /// [`Error`] naming the file and the line, or the folder that cannot be made.
    pub fn new(args: &ReportArgs, splits: &Splits) -> Result<Option<Self>, Error> {
        let Some(folder) = &args.report else { return Ok(None) };
        let mut others: Vec<MethodDetections> = Vec::new();
        for external in &args.external {
            let method = MethodDetections::read(external, &splits.clips)?;
            if others.iter().any(|other| other.name == method.name) {
                return Err(EvaluateError::SameName { name: method.name }.into());
            }
            others.push(method);
        }
        fs::create_dir_all(folder).map_err(Error::write(folder))?;
        Ok(Some(Self { folder: folder.clone(), others, regressors: None }))
    }

    /// Leaves out clips that took no part.
    pub fn leave_out(&mut self, kept: &[bool]) {
        self.others.iter_mut().for_each(|other| keep(&mut other.clips, kept));
    }

    /// Puts a method that was run here beside the others; `clips` is what it found in each clip, `times_ms` the time of
    /// each frame in milliseconds.
    ///
    /// # Errors
    /// [`EvaluateError::SameName`].
    pub fn add(
        &mut self,
        name: String,
        clips: Vec<Vec<DetectionRecord>>,
        times_ms: Vec<f64>,
    ) -> Result<(), Error> {
        if self.others.iter().any(|other| other.name == name) {
            return Err(EvaluateError::SameName { name }.into());
        }
        let clips = clips.into_iter().map(|found| Detected { found, contrast: Vec::new() });
        self.others.push(MethodDetections {
            name,
            clips: clips.collect(),
            median_ms: median(times_ms),
        });
        Ok(())
    }

    /// To measure on the frames of clip number `index`.
    pub fn watch<'a>(&'a self, clip: &'a Clip, index: usize) -> MeasuringObserver<'a> {
        MeasuringObserver::new(clip, index, &self.others)
    }

    /// Measures Algorithm 1 alone on frames of the clips; nothing for a model without regressors or after Ctrl-C.
    ///
    /// # Errors
    /// Those of the sources.
    pub fn measure_regressors(
        &mut self,
        clips: &[Clip],
        model: &Model<'_>,
        args: &DetectorArgs,
        jobs: usize,
    ) -> Result<(), Error> {
        let trials = regressors::run(clips, model, args, jobs)?;
        self.regressors = regressors::figures(&trials.unwrap_or_default());
        Ok(())
    }

    /// Writes the report; `runs` is what our detector found and what was seen, by clip.
    ///
    /// # Errors
    /// [`Error`]; a page that cannot be written whole is taken away.
    #[allow(clippy::expect_used, reason = "numbers and names always make JSON")]
    pub fn write(
        self,
        splits: &Splits,
        in_use: InUse,
        runs: Vec<(Vec<DetectionRecord>, FrameMeasurements)>,
        jobs: usize,
    ) -> Result<Ended, Error> {
        let Self { folder, others, regressors } = self;
        let clips = splits.clips.as_slice();
        let mut methods = with_ours(others);
        let (mut contrasts, mut frames) = (Vec::new(), Vec::new());
        let mut times = Vec::new();
        for (found, seen) in runs {
            frames.push((seen.times_ms.len() as u64).saturating_sub(WARMUP));
            times.extend(seen.times_ms);
            contrasts.push(seen.targets);
            methods[0].clips.push(Detected { found, contrast: seen.ours });
            let clip = methods[0].clips.len() - 1;
            for (method, contrast) in methods[1..].iter_mut().zip(seen.others) {
                method.clips[clip].contrast = contrast;
            }
        }
        methods[0].median_ms = median(times);
        let truth: Vec<ClipTruth<'_>> = clips
            .iter()
            .zip(&splits.facts)
            .zip(contrasts.iter().zip(frames))
            .map(|((clip, facts), (contrast, frames))| {
                let has_target = clip.ground_truth.has_target();
                ClipTruth { facts, frames, has_target, contrast }
            })
            .collect();
        let matches: Vec<_> = methods.iter().map(|m| figures::match_method(clips, m)).collect();
        let ours = &matches[0][LOOSE];
        let misses = gallery::misses(clips, ours, &truth);
        let false_alarms = gallery::false_alarms(clips, ours, &methods[0].clips);
        let strips = misses.into_iter().chain(false_alarms).collect();
        let Some(strips) = gallery::cut(clips, jobs, strips)? else {
            return Ok(Ended::Interrupted);
        };
        let (misses, false_alarms) = strips.into_iter().partition(|s| s.score.is_none());
        let figures = ReportFigures {
            lookout: env!("CARGO_PKG_VERSION"),
            data: splits.title(),
            in_use,
            flights: figures::flights(ours, &truth),
            collisions: collisions::figures(&methods, &matches, &truth),
            regressors,
            bootstrap: figures::bootstrap_figures(),
            methods: figures::methods(&methods, &matches, &truth),
            misses,
            false_alarms,
        };
        let json = serde_json::to_string(&figures).expect("numbers and names always make JSON");
        write(&folder.join("report.json"), &json)?;
        write(&folder.join("report.html"), &html::page(&figures))?;
        Ok(Ended::Complete)
    }
}

/// Ours, still without detections, and the others.
fn with_ours(others: Vec<MethodDetections>) -> Vec<MethodDetections> {
    let ours = MethodDetections { name: OURS.into(), clips: Vec::new(), median_ms: None };
    [ours].into_iter().chain(others).collect()
}

fn write(path: &Path, text: &str) -> Result<(), Error> {
    fs::write(path, text).map_err(|source| {
        // Half a page is of no use; the first error is returned.
        let _ = fs::remove_file(path);
        FileError::Write { path: path.into(), source }.into()
    })
}
