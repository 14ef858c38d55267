//! Growing forests with a progress bar and the log.

use super::TrainError;
use super::boost::{Bagging, Booster, Data, Options, Round, TrainedForest};
use super::report::TrainingReport;
use crate::shell::error::Error;
use crate::shell::support::interrupt;
use std::format;
use std::ops::ControlFlow;
use std::string::String;

/// Boosts with a progress bar and the log.
pub(super) fn boost(
    report: &mut TrainingReport,
    name: &str,
    options: Options,
    data: Data<'_>,
    validation: Option<Data<'_>>,
) -> Result<TrainedForest, Error> {
    let booster = Booster::new(options, data, validation).map_err(TrainError::Boost)?;
    grow(report, name, options.rounds, booster)
}

/// Boosts with a progress bar and the log.
pub(super) fn grow(
    report: &mut TrainingReport,
    name: &str,
    rounds: usize,
    booster: Booster<'_>,
) -> Result<TrainedForest, Error> {
    let bar = report.bar(name, rounds as u64);
    let mut failed = None;
    let (forest, best) = booster.run(|round: &Round| {
        bar.inc(1);
        bar.set_message(format!("{name}: loss {:.4}{}", round.train_loss, held_back(round)));
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
        "{name}: {} trees, loss {:.4}{}",
        best.trees,
        best.train_loss,
        held_back(&best)
    ))?;
    Ok(forest)
}

/// The loss on what is held back, in words.
fn held_back(round: &Round) -> String {
    round.validation_loss.map_or_else(String::new, |loss| format!(", {loss:.4} on held-back clips"))
}

/// Grows a random forest with a progress bar and the log.
pub(super) fn bag(
    report: &mut TrainingReport,
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
    let forest = forest.map_err(TrainError::Boost)?;
    report.note(&format!("{name}: {} trees of a random forest", forest.trees().len()))?;
    Ok(forest)
}
