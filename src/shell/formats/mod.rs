//! Files: clips and their ground truth, detections, camera calibrations, logs of flights.
//!
//! In: paths. Out: checked values; an error names the file, the line and the field.

pub mod calibration;
pub mod camera_file;
pub mod class;
pub mod clips;
mod dataflash;
pub mod detections;
pub mod error;
pub mod flight_log;
pub mod flight_sample;
pub mod ground_truth;
pub mod seqinfo;
mod timeline;
pub mod tlog;
pub mod traffic;
pub mod truth;
mod ulog;
