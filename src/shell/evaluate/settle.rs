//! Clips after their turn: which count, and what their frames say of labels and rate.

use super::clip_run::ClipResult;
use super::facts::Facts;
use super::report::Plan;
use super::splits::Splits;
use crate::shell::error::Error;
use crate::shell::formats::clips::Clip;
use crate::shell::pipeline::PipelineError;
use crate::shell::support::file_error::FileError;
use std::string::{String, ToString};
use std::vec::Vec;

/// An error that is of the clip alone and ends nothing else becomes its reason.
///
/// # Errors
/// The others.
pub fn of_the_clip(result: Result<ClipResult, Error>) -> Result<Result<ClipResult, String>, Error> {
    match result {
        Err(
            error @ (Error::File(FileError::Write { .. })
            | Error::Pipeline(PipelineError::Threads { .. })),
        ) => Err(error),
        Err(error) => Ok(Err(error.to_string())),
        Ok(result) => Ok(Ok(result)),
    }
}

/// Leaves out the clips that could not be measured, and takes from the others what their frames say of labels and rate.
pub fn settle(
    tried: Vec<Result<ClipResult, String>>,
    splits: &mut Splits,
    plan: Option<&mut Plan>,
) -> Vec<ClipResult> {
    let reasons: Vec<Option<String>> = tried.iter().map(|r| r.as_ref().err().cloned()).collect();
    let kept: Vec<bool> = reasons.iter().map(Option::is_none).collect();
    splits.leave_out(&reasons);
    if let Some(plan) = plan {
        plan.leave_out(&kept);
    }
    let results: Vec<ClipResult> = tried.into_iter().filter_map(Result::ok).collect();
    let facts = splits.facts.iter_mut();
    for ((clip, facts), result) in splits.clips.iter_mut().zip(facts).zip(&results) {
        measured(clip, facts, result);
    }
    results
}

/// Takes from a clip's result what its frames say of labels and rate.
pub fn measured(clip: &mut Clip, facts: &mut Facts, result: &ClipResult) {
    if result.frames > 0 {
        clip.ground_truth.end_at(result.frames);
    }
    if result.size.0 > 0 {
        clip.info.size = Some((result.size.0 as u32, result.size.1 as u32));
    }
    facts.measured(result.rate);
}
