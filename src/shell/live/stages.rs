//! Latency of each stage, from the exposure of a frame to the last byte sent about it.

use super::worker::ProcessedFrame;
use crate::detector::DetectorStage;
use crate::shell::support::histogram::Histogram;
use std::fmt::Write;
use std::string::String;
use std::vec::Vec;

/// Stages before the detector's, and after.
const BEFORE: &str = "exposure to detector";
const AFTER: [&str; 2] = ["tracks and threat", "exposure to tracks"];
/// The last one, which only the links know.
const SENT: &str = "exposure to last byte sent";

/// A histogram for each stage.
#[derive(Debug, Clone)]
pub struct Stages {
    stages: Vec<(&'static str, Histogram)>,
}

impl Default for Stages {
    fn default() -> Self {
        let names =
            [BEFORE].into_iter().chain(DetectorStage::ALL.map(DetectorStage::name)).chain(AFTER);
        Self { stages: names.map(|name| (name, Histogram::default())).collect() }
    }
}

impl Stages {
    /// Counts a frame whose tracks were ready at `tracked_us`.
    pub fn add(&mut self, seen: &ProcessedFrame, received_us: i64, tracked_us: i64) {
        let exposed_us = seen.frame.time_us;
        let mut last = exposed_us;
        let steps = [seen.begun_us]
            .into_iter()
            .chain(seen.ended_us)
            .map(|end| end - core::mem::replace(&mut last, end));
        let steps = steps
            .collect::<Vec<_>>()
            .into_iter()
            .chain([tracked_us - received_us, tracked_us - exposed_us]);
        for ((_, histogram), time_us) in self.stages.iter_mut().zip(steps) {
            histogram.add(time_us);
        }
    }

    /// Name, median and 99th percentile in microseconds of every stage; `sent` is [`crate::shell::link::Links::latency`].
    pub fn percentiles(&self, sent: &Histogram) -> Vec<(&'static str, i64, i64)> {
        let all = self.stages.iter().map(|(name, histogram)| (*name, histogram));
        let all = all.chain([(SENT, sent)]).filter(|(_, histogram)| histogram.count() > 0);
        all.map(|(name, h)| (name, h.percentile(50), h.percentile(99))).collect()
    }

    /// The same as a table in words, milliseconds.
    pub fn table(&self, sent: &Histogram) -> String {
        let mut text = String::from("latency in ms                  p50      p99\n");
        for (name, p50, p99) in self.percentiles(sent) {
            let [p50, p99] = [p50, p99].map(|us| us as f64 / 1000.0);
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{name:26} {p50:8.1} {p99:8.1}");
        }
        text
    }
}
