//! Parts of the result of a clip, as its file keeps them.

use crate::shell::evaluate::clip_run::ScanCounts;
use crate::shell::evaluate::facts::Facts;
use crate::shell::evaluate::matching::DetectionRecord;
use crate::shell::evaluate::registration::ClipRegistration;
use crate::shell::evaluate::track_metrics::ClipTracks;
use crate::shell::formats::clips::GroundTruth;
use serde::{Deserialize, Serialize};
use std::string::String;
use std::vec::Vec;

/// All of an outcome but detections and times: the first line of a file of lines, metadata of a Parquet file.
#[derive(Debug, Serialize, Deserialize)]
pub struct Head {
    /// Name of the clip.
    pub clip: String,
    /// Why it can never be measured; none where it was.
    pub broken: Option<String>,
    /// Facts of the clip from its table or manifest.
    pub facts: Facts,
    /// Labels of the clip.
    pub ground_truth: GroundTruth,
    /// Frames of the clip.
    pub frames: u64,
    /// Size of the frames, pixels.
    pub size: (usize, usize),
    /// Frames a second by the frames' own times.
    pub rate: Option<f64>,
    /// Counts of the scan.
    pub scan: ScanCounts,
    /// Registration from frame to frame.
    pub registration: Option<ClipRegistration>,
    /// Texture around each target, grey levels.
    pub textures: Vec<f64>,
    /// Results of tracker and alerts.
    pub tracks: Option<ClipTracks>,
}

/// Parts of an outcome as files keep them: the head, detections, and the time of each frame in milliseconds.
pub type OutcomeParts = (Head, Vec<DetectionRecord>, Vec<f64>);
