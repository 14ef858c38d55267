//! Evaluation of flights on a collision course, where the target hardly moves in the picture.

use super::breakdown::ClipTruth;
use super::matched::{IOUS, MethodMatches, hours};
use super::methods::MethodDetections;
use crate::shell::evaluate::bootstrap::{Bootstrap, Interval, RESAMPLES, SEED, Sampled};
use crate::shell::evaluate::matching::ClipMatches;
use crate::shell::evaluate::ranking::{ClipCount, Ranking};
use serde::Serialize;
use std::string::String;
use std::vec::Vec;

/// The kind of encounter in `camera.json`.
const KIND: &str = "collision";

/// Figures of these flights.
#[derive(Debug, Clone, Serialize)]
pub struct CollisionFigures {
    /// Number of flights that the figures are of.
    pub clips: usize,
    /// Length of the flights, hours.
    pub hours: f64,
    /// Targets in these flights.
    pub targets: u64,
    /// Figures of each method, in the order of the report.
    pub methods: Vec<CollisionMethod>,
}

/// Figures of a method.
#[derive(Debug, Clone, Serialize)]
pub struct CollisionMethod {
    /// Name of the method in the report.
    pub name: String,
    /// Area under the precision-recall curve of these flights at each intersection over union.
    #[serde(rename = "AveP")]
    pub average_precision: Vec<Interval>,
    /// AveP of the first method less that of this one, on the same draws.
    pub first_less_this: Option<Vec<Interval>>,
}

/// The figures; none where no flight is on a collision course.
pub fn figures(
    methods: &[MethodDetections],
    matches: &[MethodMatches],
    truth: &[ClipTruth<'_>],
) -> Option<CollisionFigures> {
    let collides = |t: &ClipTruth<'_>| t.facts.kind.as_deref() == Some(KIND);
    let chosen: Vec<usize> = (0..truth.len()).filter(|&i| collides(&truth[i])).collect();
    if chosen.is_empty() {
        return None;
    }
    let bootstrap = Bootstrap::new(chosen.len(), RESAMPLES, SEED);
    let mut first: Vec<Sampled> = Vec::new();
    let mut targets = 0;
    let mut all = Vec::new();
    for (method, matches) in methods.iter().zip(matches) {
        let rankings: Vec<Ranking> = matches.iter().map(|j| ranking(j, &chosen)).collect();
        targets = rankings[0].targets(&rankings[0].whole());
        let sampled: Vec<Sampled> = (0..IOUS.len())
            .map(|i| bootstrap.sample(&rankings[i], Ranking::average_precision))
            .collect();
        let less = |(first, this): (&Sampled, &Sampled)| first.less(this).interval();
        all.push(CollisionMethod {
            name: method.name.clone(),
            average_precision: sampled.iter().map(Sampled::interval).collect(),
            first_less_this: (!first.is_empty())
                .then(|| first.iter().zip(&sampled).map(less).collect()),
        });
        if first.is_empty() {
            first = sampled;
        }
    }
    let hours = chosen.iter().map(|&i| hours(&truth[i])).sum();
    Some(CollisionFigures { clips: chosen.len(), hours, targets, methods: all })
}

/// The ranking of the chosen clips alone.
fn ranking(matches: &[ClipMatches], chosen: &[usize]) -> Ranking {
    let clips = chosen.iter().map(|&i| &matches[i]);
    let counts =
        clips.clone().map(|c| ClipCount { frames: c.frames, targets: c.targets.len() }).collect();
    let outcomes = clips
        .enumerate()
        .flat_map(|(i, clip)| clip.detections.iter().filter_map(move |d| d.outcome(i)));
    Ranking::new(counts, outcomes.collect())
}
