//! The shell: everything that needs an operating system (level 9).

pub mod annotate;
pub mod bench;
pub mod camera;
pub mod cli;
pub mod clips;
pub mod detections;
pub mod digest;
pub mod error;
pub mod eval;
pub mod flight;
pub mod interrupt;
pub mod judge;
pub mod link;
pub mod parallel;
pub mod pictures;
pub mod pipeline;
pub mod ranking;
pub mod replay;
pub mod report;
pub mod score;
pub mod simulate;
pub mod source;
pub mod tracks;
pub mod traffic;
pub mod train;
pub mod truth;
