//! The shell: everything that needs an operating system.

pub mod bench;
pub mod cli;
pub mod doctor;
pub mod error;
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "counts and bins of statistics"
)]
pub mod evaluate;
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "texts are read as f64; whole numbers and their ranges are checked before, casts saturate"
)]
pub mod formats;
#[doc(hidden)]
pub mod fuzzing;
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "as formats"
)]
pub mod import;
pub mod link;
pub mod live;
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "places and shares of pixels"
)]
pub mod mask;
pub mod params;
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "places of pixels"
)]
pub mod pictures;
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "fixed-point numbers of the core from f64; casts saturate"
)]
pub mod pipeline;
pub mod preview;
pub mod program;
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "places and intensities of pixels from f64; casts saturate"
)]
pub mod render;
pub mod replay;
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "as render"
)]
pub mod simulate;
pub mod sources;
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "bins of histograms, random numbers in a range"
)]
pub mod support;
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "fixed-point numbers of the core from f64, numbers of rows and windows"
)]
pub mod train;
