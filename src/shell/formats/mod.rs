//! Files: clips and their ground truth, detections, camera calibrations, telemetry logs.
//!
//! In: paths. Out: checked values; an error names the file, the line and the field.

pub mod camera_file;
pub mod clips;
pub mod detections;
pub mod error;
pub mod tlog;
pub mod traffic;
pub mod truth;
