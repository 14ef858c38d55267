//! The stage of the scan: a soft cascade over windows, with rounds of hard negatives from whole frames.
//!
//! Windows come in passes over the sampled frames: the first takes targets and random windows, each of the others the windows
//! that the scan of the round before finds best. A pass may be made here, or in shards elsewhere (`parts`).

use super::boost::{Bagging, Loss, Options, TrainedForest, reject_thresholds};
use super::file::ModelSections;
use super::growth::{bag, boost};
use super::lightgbm;
use super::parts::{MinedClip, PartFiles};
use super::report::TrainingReport;
use super::stages::{EDGES, Pass, Trainer};
use super::visit::SampledView;
use super::window_files::WindowFiles;
use super::windows::{self, Maps, Window, WindowTable};
use super::{TrainArgs, TrainError};
use crate::channels::scale_space::Pyramid;
use crate::model::{Model, Section};
use crate::scan::aggregate::MAP_CHANNELS;
use crate::scan::cascade::FEATURES;
use crate::shell::error::Error;
use crate::shell::pipeline::methods::{Learner, Recipe};
use crate::shell::support::interrupt;
use crate::trees::MAX_DEPTH;
use std::format;
use std::vec::Vec;

/// Random windows drawn from each frame before the first round.
const RANDOM_WINDOWS: usize = 12;

/// Hard negatives taken from each frame in a round of mining.
const HARD_WINDOWS: usize = 16;

/// Parameters of a random forest over windows.
const BAGGING: Bagging = Bagging {
    trees: 0,
    depth: MAX_DEPTH,
    min_rows: 5,
    tree_features: 0.3,
    node_features: 0.25,
    leaf_scale: 256.0,
    seed: 0,
};

/// Share of the targets that the rejection thresholds of a round keep, before the last.
const KEPT_IN_ROUNDS: f64 = 0.99;

impl Trainer<'_> {
    /// Rounds after the first, each with a pass of mining before it.
    const fn rounds(args: &TrainArgs, recipe: &Recipe) -> usize {
        // Where no cubes follow, their trees and their negatives are the windows'.
        args.mining + if recipe.method.stcube { 0 } else { 1 }
    }

    /// Passes over the frames, the first among them.
    pub fn passes(args: &TrainArgs, recipe: &Recipe) -> usize {
        if args.scan_from.is_some() { 1 } else { Self::rounds(args, recipe) + 1 }
    }

    /// The windows of a pass by clip; those after the first need the model of the round before.
    fn windows_of<P: Send>(
        &self,
        report: &TrainingReport,
        pass: usize,
        model: Option<&Model<'_>>,
        pack: impl Fn(Vec<Window>) -> Result<P, Error> + Sync,
    ) -> Result<Vec<P>, Error> {
        let (Some(model), Some(round)) = (model, pass.checked_sub(1)) else {
            let first = |view: &SampledView<'_>, pyramid: &Pyramid<'_>| {
                let mut random = self.random(1, view.number);
                let maps = Maps::of(pyramid);
                let mut windows = windows::positives(view, pyramid, &maps);
                let count = RANDOM_WINDOWS;
                windows.extend(windows::random_negatives(view, pyramid, &maps, count, &mut random));
                windows
            };
            return self.pack(report, Pass::new("windows"), first, pack);
        };
        let (part, count) = match round == self.args.mining {
            true => ((0, 1), self.args.candidates),
            false => ((round, 2), HARD_WINDOWS),
        };
        let config = self.config(count)(0, 0);
        let pass = Pass { part, candidates: count, ..Pass::new("hard negatives") };
        let hard = |view: &SampledView<'_>, pyramid: &Pyramid<'_>| {
            windows::hard_negatives(view, pyramid, model, &config)
        };
        self.pack(report, pass, hard, pack)
    }

    /// The windows of a pass in the clips of this trainer, for [`PartFiles`].
    ///
    /// # Errors
    /// [`Error`] of a clip that cannot be decoded.
    pub fn mined(
        &self,
        report: &TrainingReport,
        pass: usize,
        model: Option<&Model<'_>>,
    ) -> Result<Vec<MinedClip>, Error> {
        let windows = self.windows_of(report, pass, model, Ok)?;
        let clips = self.footage.iter().zip(windows).map(|(clip, windows)| MinedClip {
            number: clip.number as u32,
            frames: if clip.held_back { 0 } else { clip.samples.len() as u32 },
            windows,
        });
        Ok(clips.collect())
    }

    /// The soft cascade over windows, with rounds of hard negatives from whole frames. Windows are kept in `files`: a
    /// training that was ended goes on with the round after the last one whose windows are there. With `parts`, passes
    /// are made elsewhere; gives the pass that is to be made next, none when the scan is complete.
    ///
    /// # Errors
    /// [`Error`] of clips that cannot be read, [`TrainError::NoTargets`]; of the files of shards those of
    /// [`PartFiles::join`].
    pub fn scan(
        &self,
        sections: &mut ModelSections,
        report: &mut TrainingReport,
        files: &WindowFiles,
        parts: Option<&PartFiles>,
    ) -> Result<Option<usize>, Error> {
        let flat = |windows: Vec<Vec<Window>>| windows.into_iter().flatten().collect();
        // Clips and frames learned from.
        let (mut clips, mut frames) = {
            let learned = || self.footage.iter().filter(|f| !f.held_back && !f.pasted);
            (learned().count(), learned().map(|f| f.samples.len()).sum())
        };
        let mut windows: Vec<Window> = match (files.load(0), parts) {
            (Some(windows), _) => windows,
            (None, None) => flat(self.windows_of(report, 0, None, Ok)?),
            (None, Some(parts)) => {
                let Some(joined) = parts.join(0, &[])? else { return Ok(Some(0)) };
                (clips, frames) = (joined.clips, joined.frames);
                joined.windows
            }
        };
        if interrupt::requested() {
            return Ok(None);
        }
        if !windows.iter().any(|w| w.target.is_some() && !w.held_back) {
            return Err(TrainError::NoTargets { clips, frames }.into());
        }
        files.save(0, &windows)?;
        if let Some(text) = &self.args.scan_from {
            let channels = self.recipe.map_channels;
            let seen = |feature: usize| feature % MAP_CHANNELS < channels;
            let forest = lightgbm::forest(&text.path, &text.text, FEATURES as u16, seen);
            let mut forest = forest.map_err(TrainError::LightGbm)?;
            report.note(&format!("{}: {} trees", text.path.display(), forest.trees().len()))?;
            Self::reject(&mut forest, &windows, self.args.scan_keep, |forest, rows| {
                let score = |&row: &usize| {
                    let values = &windows[row].values;
                    forest.running_score(|f, t| u16::from(values[usize::from(f)]) > t)
                };
                Ok(rows.iter().map(score).collect())
            })?;
            sections.set_forest(Section::Scan, &forest);
            return Ok(None);
        }
        let alone = !self.recipe.method.stcube;
        let rounds = Self::rounds(self.args, &self.recipe);
        let mut first = 0;
        while first < rounds {
            let saved = match (files.load(first + 1), parts) {
                (Some(saved), _) => saved,
                (None, None) => break,
                (None, Some(parts)) => {
                    let Some(model) = parts.model(first + 1) else { break };
                    let joined = parts.join(first + 1, &model)?;
                    let Some(joined) = joined else { return Ok(Some(first + 1)) };
                    files.save(first + 1, &joined.windows)?;
                    joined.windows
                }
            };
            windows.extend(saved);
            first += 1;
        }
        for round in first..=rounds {
            let last = round == rounds;
            let size = match (last, alone) {
                (true, true) => (self.args.cube_trees, self.args.cube_depth),
                (true, false) => (self.args.scan_trees, self.args.scan_depth),
                _ => (self.args.scan_trees >> (2 - round.min(2)), self.args.scan_depth),
            };
            let channels = self.recipe.map_channels;
            let table = WindowTable::new(&windows, EDGES, channels).map_err(TrainError::Samples)?;
            let positives = windows.iter().filter(|w| w.target.is_some()).count();
            report.note(&format!(
                "round {} of {}: {positives} windows with a target, {} without",
                round + 1,
                rounds + 1,
                windows.len() - positives
            ))?;
            let name = format!("scan {round}/{rounds}");
            let mut forest = self.window_trees(report, &name, round, size, &table)?;
            let keep = if last && !alone { self.args.scan_keep } else { KEPT_IN_ROUNDS };
            Self::reject(&mut forest, &windows, keep, |forest, rows| {
                Ok(forest.running_scores(&table.samples, rows).map_err(TrainError::Boost)?)
            })?;
            sections.set_forest(Section::Scan, &forest);
            if last || interrupt::requested() {
                break;
            }
            drop(table);
            if let Some(parts) = parts {
                let mut known = sections.clone();
                known.set_provenance(parts.settings());
                parts.save_model(round + 1, &known.encode())?;
                return Ok(Some(round + 1));
            }
            let bytes = sections.encode();
            let model = Model::parse(&bytes).map_err(TrainError::Model)?;
            let hard: Vec<Window> = flat(self.windows_of(report, round + 1, Some(&model), Ok)?);
            if interrupt::requested() {
                break;
            }
            files.save(round + 1, &hard)?;
            windows.extend(hard);
        }
        Ok(None)
    }

    /// Sets rejection thresholds that keep a share `keep` of the targets; `running` gives the scores of rows after each
    /// tree.
    fn reject(
        forest: &mut TrainedForest,
        windows: &[Window],
        keep: f64,
        running: impl Fn(&TrainedForest, &[usize]) -> Result<Vec<Vec<i32>>, Error>,
    ) -> Result<(), Error> {
        // From the targets held back, where there are any: those learned from score too well.
        let held_back = windows.iter().any(|w| w.target.is_some() && w.held_back);
        let rows: Vec<usize> = (0..windows.len())
            .filter(|&r| windows[r].target.is_some() && windows[r].held_back == held_back)
            .collect();
        let bags: Vec<u32> = rows.iter().map(|&r| windows[r].target.unwrap_or_default()).collect();
        let running = running(forest, &rows)?;
        forest.set_reject_thresholds(&reject_thresholds(&running, &bags, keep));
        Ok(())
    }

    /// A forest over windows of `trees` trees of depth `depth`.
    fn window_trees(
        &self,
        report: &mut TrainingReport,
        name: &str,
        round: usize,
        (trees, depth): (usize, u8),
        table: &WindowTable,
    ) -> Result<TrainedForest, Error> {
        let seed = self.args.seed + round as u64;
        if self.recipe.windows == Learner::Bagging {
            // More trees only steady what these already say.
            let trees = trees.min(self.args.scan_trees);
            return bag(report, name, &Bagging { trees, seed, ..BAGGING }, table.training());
        }
        let options = Options {
            rounds: trees,
            depth,
            shrinkage: self.args.scan_shrinkage,
            min_hessian: 8.0,
            lambda: 4.0,
            feature_fraction: 0.1,
            row_fraction: 0.5,
            patience: 50,
            seed,
            ..Options::new(Loss::Logistic)
        };
        boost(report, name, options, table.training(), table.validation())
    }
}
