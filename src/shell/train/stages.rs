//! The stages of training, each from the parts before it.

use super::boost::{
    Bagging, Booster, Data, Loss, Options, Round, Samples, TrainedForest, reject_thresholds,
};
use super::cubes::{self, Row};
use super::file::Parts;
use super::fits;
use super::footage::{self, Depth, Footage, Selection, View, visit};
use super::pool;
use super::report::{Report, Summary};
use super::windows::{self, Table, Window, balanced};
use super::{CubeLoss, TrainArgs};
use crate::channels::scale_space::Pyramid;
use crate::detector::Config;
use crate::model::{Model, Section};
use crate::shell::error::Error;
use crate::shell::pipeline::methods::{Learner, Recipe};
use crate::shell::support::interrupt;
use crate::shell::support::random::Random;
use crate::shell::train::TrainError;
use crate::trees::MAX_DEPTH;
use std::format;
use std::ops::ControlFlow;
use std::vec::Vec;

/// Bins of a feature less one.
const EDGES: usize = 63;

/// Random windows drawn from each frame before the first round.
const RANDOM_WINDOWS: usize = 12;

/// Hard negatives taken from each frame in a round of mining.
const HARD_WINDOWS: usize = 16;

/// How a random forest over windows is grown.
const BAGGING: Bagging = Bagging {
    trees: 0,
    depth: MAX_DEPTH,
    min_rows: 5,
    tree_features: 0.3,
    node_features: 0.25,
    leaf_scale: 256.0,
    seed: 0,
};

/// What a window of a clip with pasted objects weighs where a box's x, y, width and height are learned. Weighing as much
/// as others they pull large targets before the sky in: on clips held back (every fourth), of windows on targets, boxes
/// with an IoU over 0.5 were 0.851 of the airborne and 0.972 of the real ones without them, 0.872 and 0.951 at weight 1,
/// 0.867 and 0.964 at 0.3; heights gained nothing.
const PASTED: [f32; 4] = [0.3, 0.3, 0.3, 0.0];

/// Weights of such windows where fits are learned.
const PASTED_FITS: [f32; 4] = [1.0; 4];

/// Features to choose from for fits; with half of them AveP is 0.006 less (IoU 0.5, airborne flights held back). Trees of
/// depth 6 gain 0.001, at four times the bytes.
const FIT_FEATURES: usize = 3000;

/// Features to choose from for φ_h and φ_v.
const PATCH_FEATURES: usize = 900;

/// The flights and the settings.
pub struct Trainer<'a> {
    args: &'a TrainArgs,
    recipe: Recipe,
    footage: Vec<Footage>,
}

impl<'a> Trainer<'a> {
    /// Reads the flights.
    pub fn load(args: &'a TrainArgs, recipe: Recipe, report: &Report) -> Result<Self, Error> {
        let bar = report.bar("reading clips", 0);
        let footage = footage::load(args, || bar.inc(1))?;
        bar.finish_and_clear();
        Ok(Self { args, recipe, footage })
    }

    /// What was learned from.
    pub fn summary(&self) -> Summary {
        let own = || self.footage.iter().filter(|f| !f.pasted);
        let samples =
            |held_back| own().filter(|f| f.held_back == held_back).map(|f| f.samples.len()).sum();
        Summary {
            clips: own().count(),
            pasted_clips: self.footage.len() - own().count(),
            samples: samples(false),
            held_back_clips: self.footage.iter().filter(|f| f.held_back).count(),
            held_back_samples: samples(true),
        }
    }

    fn config(&self, candidates: usize) -> impl Fn(usize, usize) -> Config + Sync + use<> {
        let method = self.recipe.method;
        move |width, height| Config { candidates, ..Config::for_method(method, width, height) }
    }

    /// Random numbers of one purpose, for one frame.
    fn random(&self, purpose: u64, number: u32) -> Random {
        let mut random = Random::new(self.args.seed ^ (purpose << 56) ^ (u64::from(number) << 16));
        random.bits();
        random
    }

    /// Shows every `part.1`th sampled frame, beginning with the `part.0`th, to `work`.
    fn each<T: Send>(
        &self,
        report: &Report,
        what: &str,
        depth: Depth,
        part: (usize, usize),
        candidates: usize,
        work: impl Fn(&View<'_>, &Pyramid<'_>) -> Vec<T> + Sync,
    ) -> Vec<T> {
        let looks = (!self.args.plain).then_some(self.args.seed);
        let selection = Selection { depth, part, looks };
        let count: usize = self.footage.iter().map(|clip| selection.frames(clip).len()).sum();
        let bar = report.bar(what, count as u64);
        let config = self.config(candidates);
        let work = |view: &View<'_>, pyramid: &Pyramid<'_>| {
            if interrupt::requested() { Vec::new() } else { work(view, pyramid) }
        };
        let results = visit(&self.footage, config, &selection, || bar.inc(1), work);
        bar.finish_and_clear();
        results
    }

    /// The soft cascade over windows, with rounds of hard negatives from whole frames.
    pub fn scan(&self, parts: &mut Parts, report: &mut Report) -> Result<(), Error> {
        let mut windows: Vec<Window> =
            self.each(report, "windows", Depth::Newest, (0, 1), 1, |view, pyramid| {
                let mut random = self.random(1, view.number);
                let mut windows = windows::positives(view, pyramid);
                windows.extend(windows::random_negatives(
                    view,
                    pyramid,
                    RANDOM_WINDOWS,
                    &mut random,
                ));
                windows
            });
        // Where no cubes follow, their trees and their negatives are the windows'.
        let alone = !self.recipe.method.stcube;
        let rounds = self.args.mining + usize::from(alone);
        for round in 0..=rounds {
            let last = round == rounds;
            let size = match (last, alone) {
                (true, true) => (self.args.cube_trees, self.args.cube_depth),
                (true, false) => (self.args.scan_trees, self.args.scan_depth),
                _ => (self.args.scan_trees >> (2 - round.min(2)), self.args.scan_depth),
            };
            let channels = self.recipe.map_channels;
            let table = Table::new(&windows, EDGES, channels).map_err(training)?;
            let positives = windows.iter().filter(|w| w.target.is_some()).count();
            report.note(&format!(
                "scan, round {round}: {positives} positives, {} negatives",
                windows.len() - positives
            ))?;
            let name = format!("scan {round}/{rounds}");
            let mut forest = self.window_trees(report, &name, round, size, &table)?;
            // Thresholds from the targets held back, where there are any: those learned from score too well.
            let held_back = table.validation().is_some();
            let rows: Vec<usize> = (0..windows.len())
                .filter(|&r| windows[r].target.is_some() && windows[r].held_back == held_back)
                .collect();
            let running = forest.running_scores(&table.samples, &rows).map_err(training)?;
            let bags: Vec<u32> =
                rows.iter().map(|&r| windows[r].target.unwrap_or_default()).collect();
            let keep = if last && !alone { self.args.scan_keep } else { 0.99 };
            forest.set_reject_thresholds(&reject_thresholds(&running, &bags, keep));
            parts.set_forest(Section::Scan, &forest);
            if last || interrupt::requested() {
                break;
            }
            drop(table);
            let bytes = parts.encode();
            let model = Model::parse(&bytes).map_err(training)?;
            let (part, count) = match round == self.args.mining {
                true => ((0, 1), self.args.candidates),
                false => ((round, 2), HARD_WINDOWS),
            };
            let config = self.config(count)(0, 0);
            let hard =
                self.each(report, "hard negatives", Depth::Newest, part, count, |view, pyramid| {
                    windows::hard_negatives(view, pyramid, &model, &config)
                });
            windows.extend(hard);
        }
        Ok(())
    }

    /// The trees over windows, so many of such a depth.
    fn window_trees(
        &self,
        report: &mut Report,
        name: &str,
        round: usize,
        (trees, depth): (usize, u8),
        table: &Table,
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

    /// φ_h and φ_v.
    pub fn regressors(&self, parts: &mut Parts, report: &mut Report) -> Result<(), Error> {
        let pool = pool::patch(PATCH_FEATURES, &mut self.random(2, 0));
        let rows: Vec<Row> =
            self.each(report, "patches", Depth::Newest, (0, 2), 1, |view, pyramid| {
                let mut random = self.random(3, view.number);
                cubes::patches(view, pyramid, &pool, &mut random)
            });
        let sections = [Section::Horizontal, Section::Vertical];
        // None of the rows is of a clip with pasted objects.
        let forests = self.offsets(report, &sections, &rows, &columns(&rows)?, PASTED)?;
        parts.set_forests(Section::PatchFeatures, &pool, forests);
        Ok(())
    }

    /// Regressors, in this order, of the first components of the rows' offsets; `pasted` are the weights of rows of clips
    /// with pasted objects.
    fn offsets(
        &self,
        report: &mut Report,
        sections: &[Section],
        rows: &[Row],
        samples: &Samples,
        pasted: [f32; 4],
    ) -> Result<Vec<(Section, TrainedForest)>, Error> {
        let mut forests = Vec::new();
        for (component, &section) in sections.iter().enumerate() {
            let value = |row: &Row| {
                row.offset.map_or(0.0, |o| [o.x, o.y, o.width, o.height][component] as f32)
            };
            let targets: Vec<f32> = rows.iter().map(value).collect();
            let weigh = |held_back: bool| -> Vec<f32> {
                let used = |row: &Row| row.offset.is_some() && row.held_back == held_back;
                let weight = |row: &Row| if row.pasted { pasted[component] } else { 1.0 };
                rows.iter().map(|row| if used(row) { weight(row) } else { 0.0 }).collect()
            };
            let (weights, held_back) = (weigh(false), weigh(true));
            let options = Options {
                rounds: self.args.regressor_trees,
                depth: 4,
                shrinkage: 0.1,
                min_rows: 50,
                feature_fraction: 0.2,
                row_fraction: 0.5,
                patience: 30,
                seed: self.args.seed + component as u64,
                ..Options::new(Loss::Squared)
            };
            let training = Data { samples, targets: &targets, weights: &weights };
            let validation = Data { weights: &held_back, ..training };
            let validation = held_back.iter().any(|&w| w > 0.0).then_some(validation);
            let name = format!("{section:?}");
            forests.push((section, boost(report, &name, options, training, validation)?));
        }
        Ok(forests)
    }

    /// The classifier of cubes, where there is one, and the box.
    pub fn cubes(&self, parts: &mut Parts, report: &mut Report) -> Result<(), Error> {
        let Recipe { method, sees, .. } = self.recipe;
        let pool = pool::cube(self.args.features, sees, method.temporal, &mut self.random(4, 0));
        let bytes = parts.encode();
        let model = Model::parse(&bytes).map_err(training)?;
        let config = self.config(self.args.candidates)(0, 0);
        let rows: Vec<Row> = self.each(
            report,
            "cubes",
            Depth::Cube,
            (0, 1),
            self.args.candidates,
            |view, pyramid| {
                let mut random = self.random(5, view.number);
                cubes::cubes(view, pyramid, &model, &config, &pool, &mut random)
            },
        );
        let (found, missed) = (
            rows.iter().filter(|r| r.label > 0.0).count(),
            rows.iter().filter(|r| r.label < 0.0).count(),
        );
        report.note(&format!("cubes: {found} positives, {missed} negatives"))?;
        let samples = columns(&rows)?;
        let mut forests = Vec::new();
        if method.stcube {
            forests.push((Section::Cube, self.classifier(report, &rows, &samples)?));
        }
        let sections = [Section::BoxX, Section::BoxY, Section::BoxWidth, Section::BoxHeight];
        forests.extend(self.offsets(report, &sections, &rows, &samples, PASTED)?);
        parts.set_forests(Section::CubeFeatures, &pool, forests);
        Ok(())
    }

    /// What fits boxes to objects.
    pub fn fits(&self, parts: &mut Parts, report: &mut Report) -> Result<(), Error> {
        let temporal = self.recipe.method.temporal;
        let pool = pool::stretched(FIT_FEATURES, temporal, &mut self.random(6, 0));
        let rows: Vec<Row> =
            self.each(report, "fits", Depth::Newest, (0, 1), 1, |view, pyramid| {
                fits::fits(view, pyramid, &pool, &mut self.random(7, view.number))
            });
        report.note(&format!("fits: {} windows", rows.len()))?;
        let sections = [Section::FitX, Section::FitY, Section::FitWidth, Section::FitHeight];
        let forests = self.offsets(report, &sections, &rows, &columns(&rows)?, PASTED_FITS)?;
        parts.set_forests(Section::FitFeatures, &pool, forests);
        Ok(())
    }

    /// The classifier of cubes.
    fn classifier(
        &self,
        report: &mut Report,
        rows: &[Row],
        samples: &Samples,
    ) -> Result<TrainedForest, Error> {
        let targets: Vec<f32> =
            rows.iter().map(|r| if r.label > 0.0 { 1.0 } else { -1.0 }).collect();
        let weigh = |held_back: bool| {
            balanced(&targets, |r| rows[r].label != 0.0 && rows[r].held_back == held_back)
        };
        let (weights, held_back) = (weigh(false), weigh(true));
        let loss = match self.args.cube_loss {
            CubeLoss::Adaboost => Loss::Exponential,
            CubeLoss::Logistic => Loss::Logistic,
        };
        let options = Options {
            rounds: self.args.cube_trees,
            depth: self.args.cube_depth,
            shrinkage: 0.08,
            min_hessian: 8.0,
            lambda: 4.0,
            feature_fraction: 0.08,
            row_fraction: 0.5,
            patience: 80,
            seed: self.args.seed,
            ..Options::new(loss)
        };
        let data = Data { samples, targets: &targets, weights: &weights };
        let validation = Data { weights: &held_back, ..data };
        let validation = held_back.iter().any(|&w| w > 0.0).then_some(validation);
        let mut forest = boost(report, "cube", options, data, validation)?;
        let any_held_back = validation.is_some();
        let kept: Vec<usize> = (0..rows.len())
            .filter(|&r| rows[r].label > 0.0 && rows[r].held_back == any_held_back)
            .collect();
        let running = forest.running_scores(samples, &kept).map_err(training)?;
        let bags: Vec<u32> = kept.iter().map(|&r| rows[r].target).collect();
        forest.set_reject_thresholds(&reject_thresholds(&running, &bags, 0.999));
        Ok(forest)
    }
}

/// Bins the rows' values.
fn columns(rows: &[Row]) -> Result<Samples, Error> {
    let features = rows.first().map_or(0, |row| row.values.len());
    let column = |i: usize| rows.iter().map(|row| row.values[i]).collect();
    Samples::from_columns((0..features).map(column), EDGES).map_err(training)
}

/// Boosts with a progress bar and the log.
fn boost(
    report: &mut Report,
    name: &str,
    options: Options,
    data: Data<'_>,
    validation: Option<Data<'_>>,
) -> Result<TrainedForest, Error> {
    let bar = report.bar(name, options.rounds as u64);
    let booster = Booster::new(options, data, validation).map_err(training)?;
    let mut failed = None;
    let (forest, best) = booster.run(|round: &Round| {
        bar.inc(1);
        bar.set_message(format!(
            "{name}: loss {:.4}, held back {:.4}",
            round.train_loss,
            round.validation_loss.unwrap_or(f64::NAN)
        ));
        if let Err(error) = report.round(name, round) {
            failed = Some(error);
        }
        if failed.is_some() || interrupt::requested() {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    });
    bar.finish_and_clear();
    if let Some(error) = failed {
        return Err(error);
    }
    report.note(&format!(
        "{name}: {} trees, loss {:.4}, held back {:.4}",
        best.trees,
        best.train_loss,
        best.validation_loss.unwrap_or(f64::NAN)
    ))?;
    Ok(forest)
}

/// Grows a random forest with a progress bar and the log.
fn bag(
    report: &mut Report,
    name: &str,
    bagging: &Bagging,
    data: Data<'_>,
) -> Result<TrainedForest, Error> {
    let bar = report.bar(name, bagging.trees as u64);
    let forest = bagging.run(data, || {
        bar.inc(1);
        if interrupt::requested() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    bar.finish_and_clear();
    let forest = forest.map_err(training)?;
    report.note(&format!("{name}: {} trees of a random forest", forest.trees().len()))?;
    Ok(forest)
}

fn training(source: impl core::fmt::Display) -> Error {
    TrainError::Training { reason: format!("{source}") }.into()
}
