//! Algorithm 1 alone: how far windows are from the target's centre before and after it, beside Lucas-Kanade tracking.
//!
//! Windows start a known way off targets of the ground truth, on frames drawn at random. That is the paper's figure 2
//! as numbers.

mod figures;
mod flow;
mod page;
mod trials;

pub use figures::{RegressorFigures, figures};
pub use page::section;
pub use trials::run;
