//! Adapting a model to other footage: more trees for its classifier of st-cubes.
//!
//! The scan, the shift regressors, the boxes and their fit stay, and so do the trees of the classifier: boosting goes on
//! from their scores on the st-cubes of the new clips. A few clips then add
//! negatives such as one camera's false alarms, without retraining the other parts.

use super::TrainError;
use super::boost::{Booster, Data, Loss, Options, TrainedForest};
use super::cubes;
use super::file::ModelSections;
use super::growth::grow;
use super::pool;
use super::report::TrainingReport;
use super::stages::{Pass, Trainer, both};
use super::windows::balanced;
use crate::model::{Model, Section};
use crate::shell::error::Error;
use crate::stcube::feature::Feature;
use std::format;
use std::vec::Vec;

/// Weight of a step of the added trees.
const SHRINKAGE: f64 = 0.05;

impl Trainer<'_> {
    /// Adds trees to the classifier of st-cubes of the model in `parts`.
    ///
    /// # Errors
    /// [`TrainError::NoTrueCandidates`] and [`TrainError::NoFalseCandidates`] where there is nothing to learn from; [`Error`]
    /// of clips that cannot be read.
    pub fn adapt(
        &self,
        parts: &mut ModelSections,
        report: &mut TrainingReport,
    ) -> Result<(), Error> {
        let bytes = parts.encode();
        let model = Model::parse(&bytes).map_err(TrainError::Model)?;
        let old = TrainedForest::from(*model.cube());
        let pool = self.adapting_pool(&model);
        let fixed = old.thresholds(pool.len());
        let config = self.config(self.args.candidates)(0, 0);
        let pass = Pass::cubes(self.args.candidates);
        let (rows, samples) = self.rows(report, pass, pool.len(), &fixed, |view, pyramid| {
            cubes::cubes(view, pyramid, &model, &config, &pool, &mut self.random(8, view.number))
        })?;
        self.check_labels(report, &rows)?;
        let targets: Vec<f32> =
            rows.iter().map(|r| if r.label > 0.0 { 1.0 } else { -1.0 }).collect();
        let weigh = |held_back: bool| {
            balanced(&targets, |r| rows[r].label != 0.0 && rows[r].held_back == held_back)
        };
        let (weights, held_back) = (weigh(false), weigh(true));
        let options = Options {
            rounds: old.trees().len() + self.args.adapt_trees,
            depth: model.cube().depth(),
            shrinkage: SHRINKAGE,
            min_hessian: 8.0,
            lambda: 4.0,
            feature_fraction: 0.08,
            row_fraction: 0.5,
            patience: 40,
            seed: self.args.seed,
            ..Options::new(Loss::Logistic)
        };
        let data = Data { samples: &samples, targets: &targets, weights: &weights };
        let validation = both(&rows).then_some(Data { weights: &held_back, ..data });
        let mut booster =
            Booster::resume(options, data, validation, &old).map_err(TrainError::Boost)?;
        booster.keep();
        let forest = grow(report, "classifier", options.rounds, booster)?;
        let added = forest.trees().len() - old.trees().len();
        report.note(&format!("{added} trees added to {}", old.trees().len()))?;
        put(parts, &model, &pool, forest);
        Ok(())
    }

    /// The features of the model's st-cubes, then new ones.
    fn adapting_pool(&self, model: &Model<'_>) -> Vec<Feature> {
        let table = model.features();
        let mut pool: Vec<Feature> = (0..table.len()).map(|id| table.get(id as u16)).collect();
        let (sees, temporal) = (self.recipe.sees, self.recipe.method.temporal);
        let more = pool::cube(self.args.features, sees, temporal, &mut self.random(9, 0));
        let known = pool.clone();
        pool.extend(more.into_iter().filter(|feature| !known.contains(feature)));
        pool
    }
}

/// Puts the classifier and the features that it asks for beyond the model's own into the parts; old features keep their
/// numbers, for the boxes ask for them too.
fn put(parts: &mut ModelSections, model: &Model<'_>, pool: &[Feature], mut forest: TrainedForest) {
    let old = model.features().len();
    let mut asked = forest.clone().compact();
    asked.retain(|&id| usize::from(id) >= old);
    let number = |id: u16| match usize::from(id) < old {
        true => id,
        false => (old + asked.partition_point(|&a| a < id)) as u16,
    };
    // Of the added trees none rejects: what they have seen is not all that there is.
    let thresholds = TrainedForest::from(*model.cube()).reject_thresholds();
    forest.set_reject_thresholds(&thresholds);
    let mut features: Vec<Feature> = pool[..old].to_vec();
    features.extend(asked.iter().map(|&id| pool[usize::from(id)]));
    forest.renumber(number, features.len() as u16);
    parts.set_features(Section::CubeFeatures, &features);
    parts.set_forest(Section::Cube, &forest);
}
