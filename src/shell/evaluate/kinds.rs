//! Recall by kind of encounter; hovering objects before texture are a row of their own.
//!
//! An object that hovers before textured ground does not differ from the background's motion and is hidden by its
//! texture: the hardest kind.

use super::facts::Facts;
use super::matching::{ClipMatches, Match, SIZES, size, size_name};
use super::table::{Table, number};
use serde::Serialize;
use std::collections::BTreeMap;
use std::string::String;
use std::vec::Vec;
use std::{format, vec};

/// Texture around a target (mean absolute deviation of grey levels in the ring around it) from which on its background
/// counts as textured.
pub const TEXTURED: f64 = 10.0;

/// The kind of encounter of hovering objects in `camera.json` and tables.
const HOVER: &str = "hover";

/// Name of the row of hovering objects before texture.
pub const HOVER_BEFORE_TEXTURE: &str = "hover before texture";

/// A clip as this needs it.
#[derive(Debug, Clone, Copy)]
pub struct KindClip<'a> {
    /// Detections of the clip, matched to its ground truth.
    pub matches: &'a ClipMatches,
    /// Texture around each target, grey levels; none where frames were not seen.
    pub textures: Option<&'a [f64]>,
    /// Properties of the clip.
    pub facts: &'a Facts,
}

/// Figures of one kind.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct KindRow {
    /// Kind of footage, as the table of clips names it.
    pub kind: String,
    /// Clips with such targets.
    pub clips: usize,
    /// Number of labelled targets.
    pub targets: usize,
    /// Share of them found at the score of use; none without targets.
    pub recall: Option<f64>,
    /// Share of them found at any score.
    pub recall_at_any_score: Option<f64>,
    /// By the longer side in pixels: share found at the score of use.
    pub by_size: Vec<(String, Option<f64>)>,
}

/// Counts of the targets of one row.
#[derive(Debug, Default)]
struct KindCounts {
    /// Clips with such targets.
    clips: usize,
    /// Targets of each size, and those of them found at the score of use.
    sizes: [(usize, usize); SIZES.len()],
    found_at_all: usize,
}

/// Counts of one kind.
#[derive(Debug, Default)]
struct KindCounter {
    all: KindCounts,
    textured: KindCounts,
    /// Whether texture is not known for a clip.
    unseen: bool,
}

/// Counts by kind.
#[derive(Debug, Default)]
pub struct KindTally(BTreeMap<String, KindCounter>);

impl KindTally {
    /// Adds a clip; `score` is the score of use, log-odds.
    pub fn add(&mut self, clip: &KindClip<'_>, score: Option<f64>) {
        let Some(kind) = &clip.facts.kind else { return };
        let counter = self.0.entry(kind.clone()).or_default();
        counter.unseen |= clip.textures.is_none();
        counter.all.add(clip.matches, score, |_| true);
        counter.textured.add(clip.matches, score, |target| {
            clip.textures.is_some_and(|t| t.get(target).is_some_and(|&t| t >= TEXTURED))
        });
    }

    /// The rows; empty where no kind is known.
    pub fn rows(self) -> Vec<KindRow> {
        let mut rows = Vec::new();
        for (kind, KindCounter { all, textured, unseen }) in self.0 {
            let hover = kind == HOVER && !unseen;
            rows.extend(all.row(kind));
            rows.extend(textured.row(HOVER_BEFORE_TEXTURE.into()).filter(|_| hover));
        }
        rows
    }
}

impl KindCounts {
    fn add(&mut self, matches: &ClipMatches, score: Option<f64>, of_kind: impl Fn(usize) -> bool) {
        let best = best_scores(matches);
        let mut any = false;
        for target in (0..matches.targets.len()).filter(|&target| of_kind(target)) {
            any = true;
            let size = &mut self.sizes[size(&matches.targets[target].truth)];
            let seen = best[target].is_some_and(|best| score.is_none_or(|score| best >= score));
            size.0 += 1;
            size.1 += usize::from(seen);
            self.found_at_all += usize::from(best[target].is_some());
        }
        self.clips += usize::from(any);
    }

    /// None where no target is of the kind.
    fn row(self, kind: String) -> Option<KindRow> {
        let share = |part: usize, whole: usize| (whole > 0).then(|| part as f64 / whole as f64);
        let targets = self.sizes.iter().map(|size| size.0).sum();
        let found = self.sizes.iter().map(|size| size.1).sum();
        let by_size = self.sizes.iter().enumerate();
        let by_size = by_size.map(|(i, &(all, found))| (size_name(i), share(found, all))).collect();
        (targets > 0).then(|| KindRow {
            kind,
            clips: self.clips,
            targets,
            recall: share(found, targets),
            recall_at_any_score: share(self.found_at_all, targets),
            by_size,
        })
    }
}

/// The score at which each target was found.
fn best_scores(matches: &ClipMatches) -> Vec<Option<f64>> {
    let mut best = vec![None; matches.targets.len()];
    for detection in &matches.detections {
        if let Match::TruePositive(target) = detection.kind {
            best[target] = Some(detection.score);
        }
    }
    best
}

/// The table for a terminal.
pub fn table(rows: &[KindRow], stated: &str) -> Table {
    let at_score = format!("recall {stated}");
    let mut heads = vec!["Kind of encounter", "clips", "targets", &at_score, "at any score"];
    let sizes: Vec<String> = (0..SIZES.len()).map(|i| format!("{} px", size_name(i))).collect();
    heads.extend(sizes.iter().map(String::as_str));
    let mut table = Table::new(&heads);
    for row in rows {
        let mut cells =
            vec![row.kind.clone(), format!("{}", row.clips), format!("{}", row.targets)];
        cells.extend([number(row.recall, 3), number(row.recall_at_any_score, 3)]);
        cells.extend(row.by_size.iter().map(|(_, recall)| number(*recall, 3)));
        table.row(&cells);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::super::matching::match_detections;
    use super::super::score::DetectionRecord;
    use super::*;
    use crate::shell::formats::clips::GroundTruth;
    use std::path::Path;

    #[test]
    fn hovering_before_texture_is_a_row() {
        let truth = "1,1,0,0,20,20\n2,1,0,0,20,20\n3,1,0,0,20,20\n";
        let truth = GroundTruth::parse(truth, Path::new("gt.txt")).unwrap();
        let found = |frame, score| DetectionRecord { frame, rect: [0.0, 0.0, 20.0, 20.0], score };
        let matches = match_detections(&truth, &[found(1, 3.0), found(2, 1.0)], 0.3, 0);
        let kind = |kind: &str| Facts { kind: Some(kind.into()), ..Facts::default() };
        let facts = [kind("hover"), kind("crossing"), Facts::default()];
        let clip = |i: usize| KindClip {
            matches: &matches,
            textures: Some(&[2.0, 12.0, 30.0]),
            facts: &facts[i],
        };
        let mut tally = KindTally::default();
        (0..3).for_each(|i| tally.add(&clip(i), Some(2.0)));
        let rows = tally.rows();
        let names: Vec<&str> = rows.iter().map(|row| row.kind.as_str()).collect();
        assert_eq!(names, ["crossing", "hover", HOVER_BEFORE_TEXTURE]);
        assert_eq!((rows[1].targets, rows[1].recall), (3, Some(1.0 / 3.0)));
        assert_eq!((rows[2].targets, rows[2].recall), (2, Some(0.0)));
        assert_eq!(rows[2].recall_at_any_score, Some(0.5));
        assert_eq!(rows[1].by_size[1], ("16-24".into(), Some(1.0 / 3.0)));
        assert!(table(&rows, "at score 2").text().contains("hover before texture"));
    }
}
