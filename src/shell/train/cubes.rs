//! Patches for φ_h and φ_v, cubes for the classifier and the box regressors.

use super::labels::{Offset, Tolerance, TrainingBox, WindowLabel, label, truths};
use super::visit::SampledView;
use super::windows;
use crate::channels::scale_space::Pyramid;
use crate::channels::window::Position;
use crate::channels::window::{SUBCELL, WINDOW};
use crate::detector::Config;
use crate::detector::classifier::CubeClassifier;
use crate::model::Model;
use crate::scan;
use crate::scan::cascade::Candidate;
use crate::shell::support::random::Random;
use crate::stcube::cube::{Cube, Patch, SCALARS};
use crate::stcube::feature::Feature;
use std::vec::Vec;

/// Tolerance of a cube's label, after Algorithm 1.
const TOLERANCE: Tolerance = Tolerance { distance: 1.5, scale: 0.6, far: 2.5, other_scale: 1.0 };

/// Patches drawn for each target: the paper shifts each box at random.
const PATCHES: usize = 6;

/// Tolerance of windows that the box regressors learn from: wider, since they must correct boxes from there.
const REACH: Tolerance = Tolerance { distance: 2.0, scale: 1.1, far: 0.0, other_scale: 0.0 };

/// Windows drawn around each target on each level within reach, for the box regressors, in addition to the scan's: how far
/// from the target's middle, in cells. Most are near it, where re-evaluation is.
const JITTER: [f64; 3] = [1.0, 0.35, 0.35];

/// A training row: feature values, label, offset of the target, origin.
#[derive(Debug, Clone)]
pub struct TrainingRow {
    /// Values of all features of the pool.
    pub values: Vec<u16>,
    /// 1 for a target, -1 for background, 0 where the classifier learns nothing.
    pub label: f32,
    /// Where the target is, if one is near.
    pub offset: Option<Offset>,
    /// The target's number, unlike that of every other target and frame.
    pub target: u32,
    /// Whether it is of a clip that objects were pasted into.
    pub pasted: bool,
    /// Whether it is of a clip that is held back.
    pub held_back: bool,
}

impl TrainingRow {
    /// A row for the box regressors alone: no label for the classifier.
    pub fn of_offset(view: &SampledView<'_>, values: Vec<u16>, offset: Offset) -> Self {
        let SampledView { pasted, held_back, .. } = *view;
        Self { values, label: 0.0, offset: Some(offset), target: 0, pasted, held_back }
    }
}

/// The window whose centre is `away` cells from `truth`'s.
fn around(truth: &Offset, away: (f64, f64)) -> Position {
    let quarters = |v: f64| (v * f64::from(SUBCELL)).round() as i32;
    Position { x: quarters(truth.x + away.0), y: quarters(truth.y + away.1) }
}

/// Patches around every target, shifted at random by up to half its longer side, with the values of `pool`.
pub fn patches(
    view: &SampledView<'_>,
    pyramid: &Pyramid<'_>,
    pool: &[Feature],
    random: &mut Random,
) -> Vec<TrainingRow> {
    let mut rows = Vec::new();
    let mut patch = Patch::EMPTY;
    for truth in truths(&view.boxes) {
        let TrainingBox::Target(truth) = truth else { continue };
        for level in pyramid.searched() {
            let from_origin = Offset::of(&truth, Position::default(), &level.level);
            if from_origin.scale().abs() > 0.45 {
                continue;
            }
            let reach = from_origin.scale().exp2() * WINDOW as f64 / 4.0;
            for _ in 0..PATCHES {
                let away = (random.symmetric() * reach, random.symmetric() * reach);
                let position = around(&from_origin, away);
                patch.cut(&level.newest.slice, position.x, position.y);
                let value = |f: &Feature| {
                    f.value(core::slice::from_ref(&patch), &Patch::EMPTY, &[0; SCALARS])
                };
                let values = pool.iter().map(value).collect();
                let offset = Offset::of(&truth, position, &level.level);
                rows.push(TrainingRow::of_offset(view, values, offset));
            }
        }
    }
    rows
}

/// The cubes of the scan's candidates and of windows around the targets, with the values of `pool`.
pub fn cubes(
    view: &SampledView<'_>,
    pyramid: &Pyramid<'_>,
    model: &Model<'_>,
    config: &Config,
    pool: &[Feature],
    random: &mut Random,
) -> Vec<TrainingRow> {
    let truths = truths(&view.boxes);
    let found = windows::candidates(pyramid, model, config);
    let mut candidates: Vec<(Candidate, Position, bool)> =
        found.iter().map(|c| (*c, scan::window(c), true)).collect();
    for truth in &truths {
        let TrainingBox::Target(truth) = truth else { continue };
        for level in pyramid.searched() {
            let offset = Offset::of(truth, Position::default(), &level.level);
            if offset.scale().abs() > REACH.scale {
                continue;
            }
            for reach in JITTER {
                let away = (reach * random.symmetric(), reach * random.symmetric());
                let position = around(&offset, away);
                let candidate = Candidate { level: level.number, x: 0, y: 0, score: 0 };
                candidates.push((candidate, position, false));
            }
        }
    }
    let classifier = CubeClassifier {
        model,
        method: config.method,
        trace: false,
        fit: false,
        channels: view.channels,
    };
    let mut rows = Vec::new();
    let mut cube = Cube::EMPTY;
    for (candidate, position, scanned) in candidates {
        let level = &pyramid.levels()[usize::from(candidate.level)];
        let path = classifier.cut(&candidate, position, &mut cube);
        let at = path.positions[0];
        let (class, target) = match label(&truths, at, level, &TOLERANCE) {
            WindowLabel::Positive(target, _) => (1.0, view.number * 16 + target.min(15) as u32),
            WindowLabel::Negative => (-1.0, 0),
            WindowLabel::Ignore => (0.0, 0),
        };
        let class = if scanned { class } else { 0.0 };
        let offset = match label(&truths, at, level, &REACH) {
            WindowLabel::Positive(_, offset) => Some(offset),
            WindowLabel::Negative | WindowLabel::Ignore => None,
        };
        if class == 0.0 && offset.is_none() {
            continue;
        }
        let value = |f: &Feature| f.value(&cube.slices, &cube.newest, &cube.scalars);
        rows.push(TrainingRow {
            values: pool.iter().map(value).collect(),
            label: class,
            offset,
            target,
            pasted: view.pasted,
            held_back: view.held_back,
        });
    }
    rows
}
