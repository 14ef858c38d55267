//! Simplification of curves to a plot's resolution.

use crate::shell::evaluate::ranking::{Point, Ranking, envelope};
use std::vec::Vec;

/// Smallest step of recall that is drawn.
const STEP: f64 = 1.0 / 400.0;

/// Recall and the best precision at that recall or more: the curve whose area is AveP.
pub fn precision_recall(ranking: &Ranking) -> Vec<[f64; 2]> {
    let mut curve = ranking.curve(&ranking.whole());
    envelope(&mut curve);
    let first = curve.first().map(|p| [0.0, p.precision]);
    first.into_iter().chain(thin(&curve).map(|p| [p.recall, p.precision])).collect()
}

/// False alarms in an hour, and recall there.
pub fn recall_per_hour(ranking: &Ranking, hours: f64) -> Vec<[f64; 2]> {
    let curve = ranking.curve(&ranking.whole());
    let point = |p: Point| [p.false_alarms as f64 / hours, p.recall];
    if hours > 0.0 { thin(&curve).map(point).collect() } else { Vec::new() }
}

/// The points where recall has grown by a step since the last one, and the very last.
fn thin(curve: &[Point]) -> impl Iterator<Item = Point> + '_ {
    let mut last = 0.0;
    let end = curve.len();
    curve.iter().enumerate().filter_map(move |(i, &point)| {
        let seen = point.recall - last >= STEP || i + 1 == end;
        if seen {
            last = point.recall;
        }
        seen.then_some(point)
    })
}
