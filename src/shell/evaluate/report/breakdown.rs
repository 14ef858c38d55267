//! Figures by groups of targets: size, contrast, agitation of the camera, kind of encounter, class.
//!
//! Each target is in one group. A false alarm counts in the group of its own size or contrast, or of its clip; it has no
//! class and counts in every one.

use super::methods::Detected;
use crate::shell::evaluate::bootstrap::{Bootstrap, Interval};
use crate::shell::evaluate::facts::Facts;
use crate::shell::evaluate::matching::{
    self, ClipMatches, DetectionRecord, ExpectedTarget, Match, SIZES,
};
use crate::shell::evaluate::ranking::{ClipCount, Ranking};
use crate::shell::formats::class::Class;
use serde::Serialize;
use std::borrow::ToOwned;
use std::string::String;
use std::vec::Vec;
use std::{format, vec};

/// More different values of agitation than this are put into quartiles.
const MOST_VALUES: usize = 6;

/// Grouping of targets and false alarms by a property.
#[derive(Debug, Clone)]
enum Rule {
    Size,
    Class,
    /// Upper bounds of all groups but the last, grey levels.
    Contrast(Vec<f64>),
    /// The group of each clip.
    Clip(Vec<usize>),
}

/// A way to group targets.
#[derive(Debug, Clone)]
pub struct Dimension {
    /// Its name in the report.
    pub name: &'static str,
    /// Name and unit of the property.
    pub heading: &'static str,
    /// Names of the groups, in the order of the figures.
    pub groups: Vec<String>,
    rule: Rule,
}

/// Everything about a clip that does not depend on the method.
#[derive(Debug, Clone, Copy)]
pub struct ClipTruth<'a> {
    /// Its name and values.
    pub facts: &'a Facts,
    /// Frames of it, the first ones left out.
    pub frames: u64,
    /// Whether anything but birds is labelled in it.
    pub has_target: bool,
    /// Contrast of each target.
    pub contrast: &'a [f64],
}

impl Dimension {
    /// All that the clips allow.
    pub fn all(clips: &[ClipTruth<'_>]) -> Vec<Self> {
        let sizes = (0..SIZES.len()).map(matching::size_name).collect();
        let classes = Class::TARGETS.iter().map(|class| class.name().to_owned()).collect();
        let make = |name, heading, groups, rule| Self { name, heading, groups, rule };
        let mut all = vec![
            make("size", "Longer side of the target (pixels)", sizes, Rule::Size),
            Self::contrast(clips),
        ];
        all.extend(Self::agitation(clips));
        all.extend(Self::kind(clips));
        all.push(make("class", "Class of the target", classes, Rule::Class));
        all
    }

    fn contrast(clips: &[ClipTruth<'_>]) -> Self {
        let bounds = quartiles(clips.iter().flat_map(|c| c.contrast.iter().copied()).collect());
        Self {
            name: "contrast",
            heading: "Contrast of the target to its surroundings (grey levels, quartiles)",
            groups: range_names(&bounds),
            rule: Rule::Contrast(bounds),
        }
    }

    fn agitation(clips: &[ClipTruth<'_>]) -> Option<Self> {
        let values: Vec<f64> =
            clips.iter().map(|c| c.facts.agitation).collect::<Option<Vec<_>>>()?;
        let mut different = values.clone();
        different.sort_by(f64::total_cmp);
        different.dedup();
        let (groups, place): (_, Vec<usize>) = if different.len() <= MOST_VALUES {
            let place = |v: &f64| different.partition_point(|d| d < v);
            (different.iter().map(|v| format!("{v}")).collect(), values.iter().map(place).collect())
        } else {
            let bounds = quartiles(values.clone());
            (range_names(&bounds), values.iter().map(|&v| group_of(&bounds, v)).collect())
        };
        let heading = "Agitation of the camera (column of the split's table; larger is rougher)";
        Some(Self { name: "agitation", heading, groups, rule: Rule::Clip(place) })
    }

    fn kind(clips: &[ClipTruth<'_>]) -> Option<Self> {
        let kinds: Vec<&str> =
            clips.iter().map(|c| c.facts.kind.as_deref()).collect::<Option<Vec<_>>>()?;
        let mut groups = kinds.clone();
        groups.sort_unstable();
        groups.dedup();
        let place = kinds.iter().map(|kind| groups.partition_point(|g| g < kind)).collect();
        let groups = groups.iter().map(|&g| g.to_owned()).collect();
        let heading = "Kind of encounter";
        Some(Self { name: "kind", heading, groups, rule: Rule::Clip(place) })
    }

    fn of_target(&self, clip: usize, target: &ExpectedTarget, contrast: f64) -> usize {
        match &self.rule {
            Rule::Size => matching::size(&target.truth),
            Rule::Class => matching::class(&target.truth),
            Rule::Contrast(bounds) => group_of(bounds, contrast),
            Rule::Clip(groups) => groups[clip],
        }
    }

    /// None: it counts in every group.
    fn of_alarm(&self, clip: usize, found: &DetectionRecord, contrast: f64) -> Option<usize> {
        match &self.rule {
            Rule::Size => Some(matching::size_of(&found.rect)),
            Rule::Class => None,
            Rule::Contrast(bounds) => Some(group_of(bounds, contrast)),
            Rule::Clip(groups) => Some(groups[clip]),
        }
    }

    /// The ranking of each group alone: its targets, what found them, its false alarms.
    pub fn rankings(
        &self,
        clips: &[ClipTruth<'_>],
        matches: &[ClipMatches],
        detected: &[Detected],
    ) -> Vec<Ranking> {
        let mut counts = vec![vec![ClipCount::default(); clips.len()]; self.groups.len()];
        let mut outcomes = vec![Vec::new(); self.groups.len()];
        for (clip, ((truth, matches), detected)) in
            clips.iter().zip(matches).zip(detected).enumerate()
        {
            let targets = matches.targets.iter().zip(truth.contrast);
            let groups: Vec<usize> = targets.map(|(t, &c)| self.of_target(clip, t, c)).collect();
            groups.iter().for_each(|&group| counts[group][clip].targets += 1);
            counts.iter_mut().for_each(|count| count[clip].frames = matches.frames);
            for detection in &matches.detections {
                let Some(outcome) = detection.outcome(clip) else { continue };
                let i = detection.index;
                let group = match detection.kind {
                    Match::TruePositive(target) => Some(groups[target]),
                    _ => self.of_alarm(clip, &detected.found[i], detected.contrast[i]),
                };
                match group {
                    Some(group) => outcomes[group].push(outcome),
                    None => outcomes.iter_mut().for_each(|o| o.push(outcome)),
                }
            }
        }
        counts.into_iter().zip(outcomes).map(|(c, o)| Ranking::new(c, o)).collect()
    }
}

/// The figures of a group.
#[derive(Debug, Clone, Serialize)]
pub struct GroupFigures {
    /// Label of the group.
    pub name: String,
    /// Clips that have such targets.
    pub clips: usize,
    /// Targets in the group.
    pub targets: u64,
    /// Targets found at the method's score of 10 false alarms in 1000 frames, IoU 0.3.
    pub found: u64,
    /// False alarms at that score.
    pub false_alarms: u64,
    /// Area under the precision-recall curve at each intersection over union.
    #[serde(rename = "AveP")]
    pub average_precision: Vec<Interval>,
}

/// The figures of each group of `dimension`; `rankings` are those of [`Dimension::rankings`] at each intersection over
/// union, the last of which is taken at `threshold`.
pub fn figures(
    dimension: &Dimension,
    rankings: &[Vec<Ranking>],
    threshold: Option<f64>,
    bootstrap: &Bootstrap,
) -> Vec<GroupFigures> {
    let figure = |(group, name): (usize, &String)| {
        let counted = &rankings[rankings.len() - 1][group];
        let at = threshold.map_or(&[][..], |threshold| {
            let outcomes = counted.outcomes();
            &outcomes[..outcomes.partition_point(|o| o.score >= threshold)]
        });
        let found = at.iter().filter(|o| o.hit).count();
        GroupFigures {
            name: name.clone(),
            clips: counted.clips().iter().filter(|clip| clip.targets > 0).count(),
            targets: counted.targets(&counted.whole()),
            found: found as u64,
            false_alarms: (at.len() - found) as u64,
            average_precision: rankings
                .iter()
                .map(|r| bootstrap.sample(&r[group], Ranking::average_precision).interval())
                .collect(),
        }
    };
    dimension.groups.iter().enumerate().map(figure).collect()
}

/// Upper bounds of the first three quarters; equal ones once.
pub fn quartiles(mut values: Vec<f64>) -> Vec<f64> {
    values.sort_by(f64::total_cmp);
    let mut bounds: Vec<f64> =
        (1..4).filter_map(|quarter| values.get(values.len() * quarter / 4).copied()).collect();
    bounds.dedup();
    bounds
}

/// The group of a value; a bound belongs to the group above it.
pub fn group_of(bounds: &[f64], value: f64) -> usize {
    bounds.partition_point(|&bound| bound <= value)
}

/// Labels of the groups between bounds.
pub fn range_names(bounds: &[f64]) -> Vec<String> {
    let Some(last) = bounds.last() else { return vec!["all".into()] };
    let first = format!("below {:.1}", bounds[0]);
    let between = bounds.windows(2).map(|b| format!("{:.1}-{:.1}", b[0], b[1]));
    [first].into_iter().chain(between).chain([format!("{last:.1}-")]).collect()
}
