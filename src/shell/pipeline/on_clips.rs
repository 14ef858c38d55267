//! Work on many clips at once, results in their order, with a progress bar.

use super::PipelineError;
use crate::shell::pipeline;
use crate::shell::support::interrupt;
use indicatif::{ProgressBar, ProgressStyle};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::vec::Vec;

/// Runs `work` on clips (or what stands for them) and their numbers, `jobs` at a time (0: one per processor core), each on
/// a thread of its own; `None` after Ctrl-C.
///
/// # Errors
/// The error of the first clip in their order that has one.
#[allow(clippy::expect_used, reason = "the template is constant")]
pub fn on_clips<T: Send, E: Send + From<PipelineError>, C: Sync>(
    clips: &[C],
    jobs: usize,
    work: &(dyn Fn(usize, &C) -> Result<T, E> + Sync),
) -> Result<Option<Vec<T>>, E> {
    let cores = thread::available_parallelism().map_or(1, |n| n.get());
    let jobs = if jobs == 0 { cores } else { jobs }.min(clips.len());
    let next = AtomicUsize::new(0);
    let failed = AtomicBool::new(false);
    let results = Mutex::new(Vec::new());
    let style = ProgressStyle::with_template("{wide_bar} {pos}/{len} clips, {eta} left {msg}")
        .expect("the template is constant");
    let bar = ProgressBar::new(clips.len() as u64).with_style(style);
    let worker = || {
        while !failed.load(Ordering::Relaxed) && !interrupt::requested() {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(clip) = clips.get(index) else { break };
            let result = work(index, clip);
            failed.fetch_or(result.is_err(), Ordering::Relaxed);
            results.lock().unwrap_or_else(PoisonError::into_inner).push((index, result));
            bar.inc(1);
        }
    };
    thread::scope(|scope| {
        // Clips side by side: each detector keeps to one thread.
        let workers: Vec<_> =
            (0..jobs).map(|_| scope.spawn(|| pipeline::on_threads(1, worker))).collect();
        workers
            .into_iter()
            .try_for_each(|w| w.join().unwrap_or_else(|p| std::panic::resume_unwind(p)))
    })?;
    bar.finish_and_clear();
    let mut results = results.into_inner().unwrap_or_else(PoisonError::into_inner);
    results.sort_by_key(|r| r.0);
    let results = results.into_iter().map(|r| r.1).collect::<Result<Vec<_>, E>>()?;
    Ok((!interrupt::requested()).then_some(results))
}
