//! The shell: everything that needs an operating system.
// An index that may be out of range is an error: `get`, a pattern, or a reason. The exceptions are folders of arithmetic on
// their own tables and pictures; none of them reads bytes of others.
#![cfg_attr(not(test), deny(clippy::indexing_slicing))]

#[allow(clippy::indexing_slicing, reason = "figures of its own runs")]
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
#[allow(clippy::indexing_slicing, reason = "its own tables of figures")]
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
#[allow(clippy::indexing_slicing, reason = "its own tables of pixels")]
pub mod mask;
pub mod params;
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "places of pixels"
)]
#[allow(clippy::indexing_slicing, reason = "pixels of a picture whose size was checked")]
pub mod pictures;
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "fixed-point numbers of the core from f64; casts saturate"
)]
#[allow(clippy::indexing_slicing, reason = "pixels of frames whose size was checked")]
pub mod pipeline;
pub mod preview;
pub mod program;
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "places and intensities of pixels from f64; casts saturate"
)]
#[allow(
    clippy::indexing_slicing,
    reason = "pixels of pictures whose size was checked, its own tables"
)]
pub mod render;
pub mod replay;
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "as render"
)]
#[allow(clippy::indexing_slicing, reason = "as render")]
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
#[allow(
    clippy::indexing_slicing,
    reason = "windows of frames whose size was checked, its own tables"
)]
pub mod train;
