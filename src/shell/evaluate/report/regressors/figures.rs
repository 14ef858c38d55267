//! Error figures of the trials.

use super::super::breakdown::{group_of, quartiles, range_names};
use super::trials::{PixelVector, SEED, Trial, WAYS};
use crate::channels::window::SLICES;
use crate::shell::evaluate::matching::{self, SIZES};
use crate::stcube::compensation::MAX_MOVES;
use serde::Serialize;
use std::borrow::ToOwned;
use std::format;
use std::string::String;
use std::vec;
use std::vec::Vec;

/// Upper bounds of the groups of starts, in lengths of the target.
const STARTS: [f64; 4] = [0.15, 0.3, 0.45, 0.6];

/// A slice is centred if the target's centre is no farther from its middle, in lengths of the target.
const CENTRED: f64 = 0.15;

/// Evaluation of Algorithm 1 apart from the detector.
#[derive(Debug, Clone, Serialize)]
pub struct RegressorFigures {
    /// Seed of frames and starts.
    pub seed: u64,
    /// Clips that trials are from.
    pub clips: usize,
    /// Number of st-cubes that were cut.
    pub cubes: usize,
    /// Share of cubes whose every slice came to rest before n_max moves.
    pub share_settled: f64,
    /// The same for slices.
    pub share_slices_settled: f64,
    /// Share of slices by number of moves, from none to n_max.
    pub moves: Vec<f64>,
    /// Mean number of moves of a slice.
    pub mean_moves: f64,
    /// Share of older slices in which the flow was found.
    pub share_followed: f64,
    /// Farthest that a centred slice is off, in lengths of the target.
    pub centred_within: f64,
    /// Share of cubes with every slice centred, by way.
    pub share_centred: Vec<WayShare>,
    /// Errors by groups of trials.
    pub breakdowns: Vec<ErrorBreakdown>,
}

/// A share by way.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WayShare {
    /// Name of the way to place slices.
    pub way: &'static str,
    /// Share of the slices, 0 to 1.
    pub share: f64,
}

/// Errors by groups.
#[derive(Debug, Clone, Serialize)]
pub struct ErrorBreakdown {
    /// Name of the property that groups are formed by.
    pub by: &'static str,
    /// The same with its unit.
    pub heading: &'static str,
    /// One entry a group of targets.
    pub groups: Vec<Group>,
}

/// Errors in a group.
#[derive(Debug, Clone, Serialize)]
pub struct Group {
    /// Label of the group.
    pub name: String,
    /// Slices of st-cubes in the group.
    pub slices: usize,
    /// Distance of the newest window from the target's centre before all: median, lengths of the target.
    pub start: Option<f64>,
    /// Errors of each way of alignment.
    pub ways: Vec<WayErrors>,
}

/// Errors of a way.
#[derive(Debug, Clone, Serialize)]
pub struct WayErrors {
    /// Name of the way to place slices.
    pub way: &'static str,
    /// Distance of the window's centre from the target's in the slice, pixels.
    pub centre_px: ErrorSpread,
    /// The same in lengths of the target.
    pub centre_relative: ErrorSpread,
    /// Distance of the window's motion since the newest slice from the target's, pixels.
    pub motion_px: ErrorSpread,
    /// The same in lengths of the target.
    pub motion_relative: ErrorSpread,
}

/// The middle and the far end of some errors; none without any.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct ErrorSpread {
    /// Half of them are no larger.
    pub median: Option<f64>,
    /// 90 % of them are no larger.
    pub p90: Option<f64>,
}

impl ErrorSpread {
    fn of(mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        // The smallest value that so many are not larger than.
        let at = |percent: usize| {
            values.get((values.len() * percent).div_ceil(100).saturating_sub(1)).copied()
        };
        Self { median: at(50), p90: at(90) }
    }
}

fn length([x, y]: PixelVector) -> f64 {
    x.hypot(y)
}

fn minus(a: PixelVector, b: PixelVector) -> PixelVector {
    [a[0] - b[0], a[1] - b[1]]
}

/// Distance of the start from the target's centre, in its lengths.
fn start(trial: &Trial) -> f64 {
    length(trial.off[0][0]) / trial.size
}

/// The figures; none without trials.
pub fn figures(trials: &[Trial]) -> Option<RegressorFigures> {
    if trials.is_empty() {
        return None;
    }
    let share = |count: usize, of: usize| count as f64 / of as f64;
    let count = |test: &dyn Fn(&Trial) -> bool| trials.iter().filter(|t| test(t)).count();
    let slices = trials.len() * SLICES;
    let mut moves = vec![0; MAX_MOVES + 1];
    trials.iter().flat_map(|t| t.moves).for_each(|n| moves[usize::from(n).min(MAX_MOVES)] += 1);
    let followed = trials.iter().flat_map(|t| &t.followed[1..]).filter(|&&f| f).count();
    let clips = trials.chunk_by(|a, b| a.clip == b.clip).count();
    let centred =
        |way: usize| count(&|t| t.off[way].iter().all(|&off| length(off) <= CENTRED * t.size));
    Some(RegressorFigures {
        seed: SEED,
        clips,
        cubes: trials.len(),
        share_settled: share(count(&|t| t.settled == [true; SLICES]), trials.len()),
        share_slices_settled: share(
            trials.iter().flat_map(|t| t.settled).filter(|&s| s).count(),
            slices,
        ),
        mean_moves: share(moves.iter().enumerate().map(|(n, count)| n * count).sum(), slices),
        moves: moves.into_iter().map(|n| share(n, slices)).collect(),
        share_followed: share(followed, trials.len() * (SLICES - 1)),
        centred_within: CENTRED,
        share_centred: (0..WAYS.len())
            .map(|way| WayShare { way: WAYS[way], share: share(centred(way), trials.len()) })
            .collect(),
        breakdowns: breakdowns(trials),
    })
}

fn breakdowns(trials: &[Trial]) -> Vec<ErrorBreakdown> {
    let contrasts = quartiles(trials.iter().map(|t| t.contrast).collect());
    let size = |t: &Trial| matching::size_of(&[0.0, 0.0, t.size, t.size]);
    let sizes = (0..SIZES.len()).map(matching::size_name).collect();
    let backgrounds = ["registered", "sky: nothing to hold on to"].map(ToOwned::to_owned).into();
    let starts = ["below 0.15", "0.15-0.3", "0.3-0.45", "0.45-0.6", "0.6-"].map(ToOwned::to_owned);
    let older = 1..SLICES;
    let by = |by, heading, names: Vec<String>, place: &dyn Fn(&Trial) -> usize| {
        let group = |(i, name): (usize, String)| {
            let of: Vec<&Trial> = trials.iter().filter(|t| place(t) == i).collect();
            group(name, &of, older.clone())
        };
        ErrorBreakdown { by, heading, groups: names.into_iter().enumerate().map(group).collect() }
    };
    let all: Vec<&Trial> = trials.iter().collect();
    let slice = |k: usize| {
        let name = ["newest frame", "1 frame ago"]
            .get(k)
            .map_or(format!("{k} frames ago"), |n| (*n).into());
        group(name, &all, k..k + 1)
    };
    vec![
        by("all", "All older slices", vec!["all".into()], &|_| 0),
        by(
            "start",
            "Start from the target's centre (lengths of the target)",
            starts.into(),
            &|t| group_of(&STARTS, start(t)),
        ),
        by("size", "Longer side of the target (pixels)", sizes, &size),
        by(
            "contrast",
            "Contrast of the target to its surroundings (grey levels, quartiles)",
            range_names(&contrasts),
            &|t| group_of(&contrasts, t.contrast),
        ),
        by("background", "Background", backgrounds, &|t| usize::from(!t.registered)),
        ErrorBreakdown { by: "slice", heading: "Slice", groups: (0..SLICES).map(slice).collect() },
    ]
}

/// Errors of these slices of these trials.
fn group(name: String, trials: &[&Trial], slices: std::ops::Range<usize>) -> Group {
    let ways = (0..WAYS.len()).map(|way| {
        let each = |error: &dyn Fn(&Trial, usize) -> f64| {
            let error = |t: &&Trial| slices.clone().map(|k| error(t, k)).collect::<Vec<_>>();
            ErrorSpread::of(trials.iter().flat_map(error).collect())
        };
        let centre = |t: &Trial, k: usize| length(t.off[way][k]);
        let motion = |t: &Trial, k: usize| length(minus(t.off[way][k], t.off[way][0]));
        WayErrors {
            way: WAYS[way],
            centre_px: each(&centre),
            centre_relative: each(&|t, k| centre(t, k) / t.size),
            motion_px: each(&motion),
            motion_relative: each(&|t, k| motion(t, k) / t.size),
        }
    });
    Group {
        name,
        slices: trials.len() * slices.len(),
        start: ErrorSpread::of(trials.iter().map(|t| start(t)).collect()).median,
        ways: ways.collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spreads() {
        let hundred = (1..=100).rev().map(f64::from).collect();
        assert_eq!(ErrorSpread::of(hundred), ErrorSpread { median: Some(50.0), p90: Some(90.0) });
        assert_eq!(ErrorSpread::of(vec![7.0]), ErrorSpread { median: Some(7.0), p90: Some(7.0) });
        assert_eq!(ErrorSpread::of(vec![]), ErrorSpread::default());
    }

    #[test]
    fn by_hand() {
        // A target of 20 px; a start of (3, 4) px, the target moves by (6, 0) a frame: ours ends 1 px off.
        let start = [3.0, 4.0];
        let background = [0.0, 1.0, 2.0, 3.0].map(|k| [3.0 - 6.0 * k, 4.0]);
        let trial = Trial {
            size: 20.0,
            contrast: 30.0,
            registered: true,
            off: [background, [[1.0, 0.0]; SLICES], [start; SLICES]],
            moves: [2, 1, 4, 0],
            settled: [true, true, false, true],
            followed: [true, true, true, false],
            clip: 0,
        };
        let still = Trial { moves: [0; 4], settled: [true; 4], clip: 2, ..trial.clone() };
        let figures = figures(&[trial, still]).unwrap();
        assert_eq!((figures.clips, figures.cubes), (2, 2));
        assert_eq!((figures.share_settled, figures.share_slices_settled), (0.5, 7.0 / 8.0));
        assert_eq!(figures.moves, [5.0 / 8.0, 1.0 / 8.0, 1.0 / 8.0, 0.0, 1.0 / 8.0]);
        assert_eq!((figures.mean_moves, figures.share_followed), (7.0 / 8.0, 4.0 / 6.0));
        let centred: Vec<f64> = figures.share_centred.iter().map(|w| w.share).collect();
        assert_eq!(centred, [0.0, 1.0, 0.0]);
        for breakdown in &figures.breakdowns {
            let slices: usize = breakdown.groups.iter().map(|g| g.slices).sum();
            assert_eq!(slices, if breakdown.by == "slice" { 8 } else { 6 }, "{}", breakdown.by);
        }
        let group = |breakdown: usize, group: usize| &figures.breakdowns[breakdown].groups[group];
        let older = group(0, 0);
        assert_eq!(older.start, Some(0.25));
        let [alone, ours, flow] = [0, 1, 2].map(|way: usize| &older.ways[way]);
        // 1, 2, 3 frames ago (-3, 4), (-9, 4), (-15, 4); the motion is off by 6, 12, 18.
        assert_eq!(alone.centre_px.median, Some(97f64.sqrt()));
        assert_eq!(alone.centre_relative.p90, Some(241f64.sqrt() / 20.0));
        assert_eq!((alone.motion_px.median, alone.motion_px.p90), (Some(12.0), Some(18.0)));
        assert_eq!((ours.centre_px.p90, ours.motion_px.p90), (Some(1.0), Some(0.0)));
        assert_eq!((flow.centre_px.p90, flow.motion_relative.p90), (Some(5.0), Some(0.0)));
        // Start of 0.25 lengths, 16 to 24 px long, registered; the newest slice.
        assert_eq!([group(1, 1), group(2, 1), group(4, 0)].map(|g| g.slices), [6; 3]);
        assert_eq!(group(5, 0).ways[0].centre_px.median, Some(5.0));
        assert!(super::figures(&[]).is_none());
    }
}
