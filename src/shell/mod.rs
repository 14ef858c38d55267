//! The shell: everything that needs an operating system (level 10).

pub mod bench;
pub mod cli;
pub mod doctor;
pub mod error;
pub mod evaluate;
pub mod formats;
#[doc(hidden)]
pub mod fuzzing;
pub mod import;
pub mod link;
pub mod live;
pub mod mask;
pub mod params;
pub mod pictures;
pub mod pipeline;
pub mod preview;
pub mod render;
pub mod replay;
pub mod simulate;
pub mod sources;
pub mod support;
pub mod train;
