//! Windows for the scan: positives, random negatives, hard negatives.

use super::boost::{Data, Samples, SamplesError};
use super::footage::View;
use super::labels::{Label, Offset, Tolerance, Truth, label, truths};
use super::random::Random;
use crate::channels::MAP_CHANNELS;
use crate::cube::SUBCELL;
use crate::detector::{self, Config, Detections};
use crate::judge;
use crate::levels::Pyramid;
use crate::model::Model;
use crate::motion::Position;
use crate::scan::{FEATURES, Map};
use std::vec::Vec;

/// Tolerance of the scan's labels: windows step by a cell, levels by half an octave.
const TOLERANCE: Tolerance = Tolerance { distance: 0.8, scale: 0.32, far: 3.0, other_scale: 1.0 };

/// Values of a window's map and what it shows.
#[derive(Debug, Clone)]
pub struct Window {
    /// All values.
    pub values: [u8; FEATURES],
    /// The target it shows, a number unlike that of every other target and frame; none for a negative.
    pub target: Option<u32>,
    /// Whether it is of a clip that is held back.
    pub held_back: bool,
}

fn map<'a>(pyramid: &'a Pyramid<'_>, level: usize) -> Map<'a> {
    let (columns, rows) = pyramid[level].level.cells();
    Map::new(pyramid[level].map(), columns, rows)
}

/// The position of the scan's window (x, y) in cells.
fn position(x: i16, y: i16) -> Position {
    Position { x: i32::from(x) * SUBCELL, y: i32::from(y) * SUBCELL }
}

/// All windows that show a target of the frame.
pub fn positives(view: &View<'_>, pyramid: &Pyramid<'_>) -> Vec<Window> {
    let truths = truths(&view.boxes);
    let mut windows = Vec::new();
    for (target, truth) in truths.iter().enumerate() {
        let Truth::Target(truth) = truth else { continue };
        for (index, level) in pyramid.iter().enumerate().filter(|(_, l)| l.level.active) {
            let offset = Offset::of(truth, Position::default(), &level.level);
            if offset.scale().abs() > TOLERANCE.scale {
                continue;
            }
            let map = map(pyramid, index);
            let place = |v: f64, count: usize| {
                let last = count as i16 - 1 - crate::channels::PADDING as i16;
                let first = -(crate::channels::PADDING as i16);
                (first..=last).filter(move |&at| (v - f64::from(at)).abs() <= TOLERANCE.distance)
            };
            for y in place(offset.y, map.windows().1) {
                for x in place(offset.x, map.windows().0) {
                    windows.push(Window {
                        values: map.values(x, y),
                        target: Some(view.number * 16 + target.min(15) as u32),
                        held_back: view.held_back,
                    });
                }
            }
        }
    }
    windows
}

/// `count` windows that show no target, levels drawn alike, places at random.
pub fn random_negatives(
    view: &View<'_>,
    pyramid: &Pyramid<'_>,
    count: usize,
    random: &mut Random,
) -> Vec<Window> {
    let truths = truths(&view.boxes);
    let active: Vec<usize> = (0..pyramid.len()).filter(|&i| pyramid[i].level.active).collect();
    let mut windows = Vec::new();
    for _ in 0..count {
        let level = active[random.below(active.len())];
        let map = map(pyramid, level);
        let (columns, rows) = map.windows();
        let place = |v: usize| v as i16 - crate::channels::PADDING as i16;
        let (x, y) = (place(random.below(columns)), place(random.below(rows)));
        if label(&truths, position(x, y), &pyramid[level].level, &TOLERANCE) == Label::Negative {
            windows.push(Window {
                values: map.values(x, y),
                target: None,
                held_back: view.held_back,
            });
        }
    }
    windows
}

/// The windows that the model's scan finds best and that show no target.
pub fn hard_negatives(
    view: &View<'_>,
    pyramid: &Pyramid<'_>,
    model: &Model<'_>,
    config: &Config,
) -> Vec<Window> {
    let truths = truths(&view.boxes);
    let candidates = detector::scan(model, config, pyramid, &mut Detections::default());
    candidates
        .iter()
        .filter(|c| {
            let level = &pyramid[usize::from(c.level)].level;
            label(&truths, judge::window(c), level, &TOLERANCE) == Label::Negative
        })
        .map(|c| Window {
            values: map(pyramid, usize::from(c.level)).values(c.x, c.y),
            target: None,
            held_back: view.held_back,
        })
        .collect()
}

/// Windows as the booster takes them.
#[derive(Debug)]
pub struct Table {
    /// Binned values.
    pub samples: Samples,
    /// 1 or -1.
    pub targets: Vec<f32>,
    /// Weights of the rows to learn from; 0 for those held back.
    pub weights: Vec<f32>,
    /// Weights of the rows held back; 0 for the others.
    pub held_back: Vec<f32>,
}

impl Table {
    /// Bins the windows into at most `edges` + 1 bins; of channels from `channels` on nothing is seen. Positives and negatives weigh the same in all.
    ///
    /// # Errors
    /// [`SamplesError`], when there are too many.
    pub fn new(windows: &[Window], edges: usize, channels: usize) -> Result<Self, SamplesError> {
        let value = |w: &Window, i: usize| {
            if i % MAP_CHANNELS < channels { u16::from(w.values[i]) } else { 0 }
        };
        let column = |i: usize| windows.iter().map(|w| value(w, i)).collect();
        let samples = Samples::from_columns((0..FEATURES).map(column), edges)?;
        let targets: Vec<f32> =
            windows.iter().map(|w| if w.target.is_some() { 1.0 } else { -1.0 }).collect();
        let weigh = |held_back: bool| balanced(&targets, |row| windows[row].held_back == held_back);
        let (weights, held_back) = (weigh(false), weigh(true));
        Ok(Self { samples, targets, weights, held_back })
    }

    /// The rows to learn from.
    pub fn training(&self) -> Data<'_> {
        Data { samples: &self.samples, targets: &self.targets, weights: &self.weights }
    }

    /// The rows held back, if there are any of both kinds.
    pub fn validation(&self) -> Option<Data<'_>> {
        let any = self.held_back.iter().any(|&w| w > 0.0);
        any.then_some(Data {
            samples: &self.samples,
            targets: &self.targets,
            weights: &self.held_back,
        })
    }
}

/// Weights of the rows that `of` names, 0 for the others: both classes have half of the weight, 1 a row on average.
pub fn balanced(targets: &[f32], of: impl Fn(usize) -> bool) -> Vec<f32> {
    let count = |sign: f32| (0..targets.len()).filter(|&r| of(r) && targets[r] == sign).count();
    let (positives, negatives) = (count(1.0), count(-1.0));
    let half = (positives + negatives) as f32 / 2.0;
    let weight = |row: usize| {
        let class = if targets[row] > 0.0 { positives } else { negatives };
        if of(row) { half / class as f32 } else { 0.0 }
    };
    (0..targets.len()).map(weight).collect()
}
