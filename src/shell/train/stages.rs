//! Stages of training, each on the model of the stages before it.

use super::boost::{BinnedSamples, Data, Loss, Options, TrainedForest, reject_thresholds};
use super::collection;
use super::cubes::{self, TrainingRow};
use super::file::ModelSections;
use super::fits;
use super::footage::Footage;
use super::growth::boost;
use super::listing::FolderRole;
use super::pool;
use super::report::{TrainingReport, TrainingSummary};
use super::rows::RowFile;
use super::visit::{Depth, SampledView, Selection, visit};
use super::windows::balanced;
use super::{CubeLoss, TrainArgs, TrainError};
use crate::channels::scale_space::Pyramid;
use crate::detector::Config;
use crate::model::{Model, Section};
use crate::shell::error::Error;
use crate::shell::evaluate::fleet::shard::Shard;
use crate::shell::formats::class::Class;
use crate::shell::pipeline::methods::Recipe;
use crate::shell::support::interrupt;
use crate::shell::support::random::Random;
use std::format;
use std::vec::Vec;

/// Bins of a feature less one.
pub(super) const EDGES: usize = 63;

/// Weight of a window of a clip with pasted objects in the regressors of x, y, width and height of a box. At weight 1
/// they pull large targets before the sky in: on clips held back (every fourth), of windows on targets, boxes
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

/// A pass over the sampled frames.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pass<'a> {
    /// Its name on the terminal.
    pub(super) name: &'a str,
    /// Slices that are computed.
    pub(super) depth: Depth,
    /// Every `part.1`th sampled frame, beginning with the `part.0`th.
    pub(super) part: (usize, usize),
    /// Windows that the scan hands on.
    pub(super) candidates: usize,
    /// Whether clips with pasted objects are shown too.
    pub(super) pasted: bool,
}

impl<'a> Pass<'a> {
    /// All frames, of each the newest slice, one candidate.
    pub(super) const fn new(name: &'a str) -> Self {
        Self { name, depth: Depth::Newest, part: (0, 1), candidates: 1, pasted: true }
    }

    /// All frames with their older slices; `candidates` windows of each.
    pub(super) const fn cubes(candidates: usize) -> Self {
        Self { depth: Depth::Cube, candidates, ..Self::new("st-cubes") }
    }
}

/// The clips, the arguments and the method of a training.
pub struct Trainer<'a> {
    pub(super) args: &'a TrainArgs,
    pub(super) recipe: Recipe,
    pub(super) footage: Vec<Footage>,
}

impl<'a> Trainer<'a> {
    /// Looks through the clips; those of `shard` alone where there is one.
    pub fn load(
        args: &'a TrainArgs,
        recipe: Recipe,
        report: &TrainingReport,
        shard: Option<Shard>,
    ) -> Result<Self, Error> {
        let bar = report.bar("reading clips", 0);
        let footage = collection::load(args, shard, || bar.inc(1))?;
        bar.finish_and_clear();
        Ok(Self { args, recipe, footage })
    }

    /// For stages that see no clip.
    pub const fn without_clips(args: &'a TrainArgs, recipe: Recipe) -> Self {
        Self { args, recipe, footage: Vec::new() }
    }

    /// Number of clips and frames learned from, by kind.
    pub fn summary(&self) -> TrainingSummary {
        let own = || self.footage.iter().filter(|f| !f.pasted);
        let samples =
            |held_back| own().filter(|f| f.held_back == held_back).map(|f| f.samples.len()).sum();
        TrainingSummary {
            clips: own().count(),
            pasted_clips: self.footage.len() - own().count(),
            samples: samples(false),
            held_back_clips: self.footage.iter().filter(|f| f.held_back).count(),
            held_back_samples: samples(true),
            rendered: own().filter(|f| f.kind == FolderRole::Rendered).count(),
            empty: own()
                .filter(|f| f.boxes.iter().flatten().all(|b| b.class == Class::Bird))
                .count(),
        }
    }

    pub(super) fn config(
        &self,
        candidates: usize,
    ) -> impl Fn(usize, usize) -> Config + Sync + use<> {
        let method = self.recipe.method;
        move |width, height| Config { candidates, ..Config::for_method(method, width, height) }
    }

    /// Random numbers of one purpose, for one frame.
    pub(super) fn random(&self, purpose: u64, number: u32) -> Random {
        let mut random = Random::new(self.args.seed ^ (purpose << 56) ^ (u64::from(number) << 16));
        random.bits();
        random
    }

    /// Shows frames to `work`, which gives rows of `features` values: the rows in the order of clips and frames, without
    /// their values, and the binned values, with `fixed` edges of the first features among the others.
    pub(super) fn rows(
        &self,
        report: &TrainingReport,
        pass: Pass<'_>,
        features: usize,
        fixed: &[Vec<u16>],
        work: impl Fn(&SampledView<'_>, &Pyramid<'_>) -> Vec<TrainingRow> + Sync,
    ) -> Result<(Vec<TrainingRow>, BinnedSamples), Error> {
        let file = RowFile::create(&self.args.out, features)?;
        let packed = self.pack(report, pass, work, |rows| file.pack(rows))?;
        file.unpack(packed, EDGES, fixed)
    }

    /// Shows frames to `work` and passes its results of each clip to `pack`; in the order of clips.
    pub(super) fn pack<T: Send, P: Send>(
        &self,
        report: &TrainingReport,
        pass: Pass<'_>,
        work: impl Fn(&SampledView<'_>, &Pyramid<'_>) -> Vec<T> + Sync,
        pack: impl Fn(Vec<T>) -> Result<P, Error> + Sync,
    ) -> Result<Vec<P>, Error> {
        let looks = (!self.args.plain).then_some(self.args.seed);
        let selection = Selection { depth: pass.depth, part: pass.part, looks };
        let footage: Vec<&Footage> =
            self.footage.iter().filter(|clip| pass.pasted || !clip.pasted).collect();
        let count: usize = footage.iter().map(|clip| selection.frames(clip).len()).sum();
        let bar = report.bar(pass.name, count as u64);
        let config = self.config(pass.candidates);
        let work = |view: &SampledView<'_>, pyramid: &Pyramid<'_>| {
            if interrupt::requested() { Vec::new() } else { work(view, pyramid) }
        };
        let results = visit(&footage, config, &selection, || bar.inc(1), work, pack);
        bar.finish_and_clear();
        results
    }

    /// Trains φ_h and φ_v.
    pub fn regressors(
        &self,
        parts: &mut ModelSections,
        report: &mut TrainingReport,
    ) -> Result<(), Error> {
        let pool = pool::patch(PATCH_FEATURES, &mut self.random(2, 0));
        let pass = Pass { part: (0, 2), pasted: false, ..Pass::new("patches") };
        let (rows, samples) = self.rows(report, pass, pool.len(), &[], |view, pyramid| {
            cubes::patches(view, pyramid, &pool, &mut self.random(3, view.number))
        })?;
        let sections = [Section::Horizontal, Section::Vertical];
        // None of the rows is of a clip with pasted objects.
        let forests = self.offsets(report, &sections, &rows, &samples, PASTED)?;
        parts.set_forests(Section::PatchFeatures, &pool, forests);
        Ok(())
    }

    /// Regressors, in this order, of the first components of the rows' offsets; `pasted` are the weights of rows of clips
    /// with pasted objects.
    fn offsets(
        &self,
        report: &mut TrainingReport,
        sections: &[Section],
        rows: &[TrainingRow],
        samples: &BinnedSamples,
        pasted: [f32; 4],
    ) -> Result<Vec<(Section, TrainedForest)>, Error> {
        let mut forests = Vec::new();
        for (component, &section) in sections.iter().enumerate() {
            let value = |row: &TrainingRow| {
                row.offset.map_or(0.0, |o| [o.x, o.y, o.width, o.height][component] as f32)
            };
            let targets: Vec<f32> = rows.iter().map(value).collect();
            let weigh = |held_back: bool| -> Vec<f32> {
                let used = |row: &TrainingRow| row.offset.is_some() && row.held_back == held_back;
                let weight = |row: &TrainingRow| if row.pasted { pasted[component] } else { 1.0 };
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
    pub fn cubes(
        &self,
        parts: &mut ModelSections,
        report: &mut TrainingReport,
    ) -> Result<(), Error> {
        let Recipe { method, sees, .. } = self.recipe;
        let pool = pool::cube(self.args.features, sees, method.temporal, &mut self.random(4, 0));
        let bytes = parts.encode();
        let model = Model::parse(&bytes).map_err(TrainError::Model)?;
        let config = self.config(self.args.candidates)(0, 0);
        let pass = Pass::cubes(self.args.candidates);
        let (rows, samples) = self.rows(report, pass, pool.len(), &[], |view, pyramid| {
            let mut random = self.random(5, view.number);
            cubes::cubes(view, pyramid, &model, &config, &pool, &mut random)
        })?;
        if method.stcube {
            self.check_labels(report, &rows)?;
        }
        let mut forests = Vec::new();
        if method.stcube {
            forests.push((Section::Cube, self.classifier(report, &rows, &samples)?));
        }
        let sections = [Section::BoxX, Section::BoxY, Section::BoxWidth, Section::BoxHeight];
        forests.extend(self.offsets(report, &sections, &rows, &samples, PASTED)?);
        parts.set_forests(Section::CubeFeatures, &pool, forests);
        Ok(())
    }

    /// The regressors that fit boxes to objects.
    pub fn fits(
        &self,
        parts: &mut ModelSections,
        report: &mut TrainingReport,
    ) -> Result<(), Error> {
        let temporal = self.recipe.method.temporal;
        let pool = pool::stretched(FIT_FEATURES, temporal, &mut self.random(6, 0));
        let (rows, samples) =
            self.rows(report, Pass::new("fits"), pool.len(), &[], |view, pyramid| {
                fits::fits(view, pyramid, &pool, &mut self.random(7, view.number))
            })?;
        report.note(&format!("{} boxes to fit", rows.len()))?;
        let sections = [Section::FitX, Section::FitY, Section::FitWidth, Section::FitHeight];
        let forests = self.offsets(report, &sections, &rows, &samples, PASTED_FITS)?;
        parts.set_forests(Section::FitFeatures, &pool, forests);
        Ok(())
    }

    /// Whether the classifier has both kinds of candidates to learn from; after Ctrl-C there may be none.
    pub(super) fn check_labels(
        &self,
        report: &mut TrainingReport,
        rows: &[TrainingRow],
    ) -> Result<(), Error> {
        let count = |label: f32| rows.iter().filter(|r| r.label == label).count();
        let (found, missed) = (count(1.0), count(-1.0));
        report.note(&format!("{found} st-cubes of targets, {missed} of false candidates"))?;
        let learned = |label: f32| rows.iter().any(|r| r.label == label && !r.held_back);
        match (learned(1.0), learned(-1.0)) {
            _ if interrupt::requested() => Ok(()),
            (false, _) => Err(TrainError::NoTrueCandidates.into()),
            (true, false) => Err(TrainError::NoFalseCandidates.into()),
            (true, true) => Ok(()),
        }
    }

    /// The classifier of cubes.
    fn classifier(
        &self,
        report: &mut TrainingReport,
        rows: &[TrainingRow],
        samples: &BinnedSamples,
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
        let validation = both(rows).then_some(validation);
        let mut forest = boost(report, "classifier", options, data, validation)?;
        let held_back = rows.iter().any(|r| r.label > 0.0 && r.held_back);
        let kept: Vec<usize> = (0..rows.len())
            .filter(|&r| rows[r].label > 0.0 && rows[r].held_back == held_back)
            .collect();
        let running = forest.running_scores(samples, &kept).map_err(TrainError::Boost)?;
        let bags: Vec<u32> = kept.iter().map(|&r| rows[r].target).collect();
        forest.set_reject_thresholds(&reject_thresholds(&running, &bags, 0.999));
        Ok(forest)
    }
}

/// Whether rows of both labels are held back.
pub(super) fn both(rows: &[TrainingRow]) -> bool {
    let any = |label: f32| rows.iter().any(|r| r.label == label && r.held_back);
    any(1.0) && any(-1.0)
}
