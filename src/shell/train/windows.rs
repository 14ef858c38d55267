//! Windows for the scan: positives, random negatives, hard negatives.

use super::boost::{BinnedSamples, Data, SamplesError};
use super::labels::{Offset, Tolerance, TrainingBox, WindowLabel, label, truths};
use super::visit::SampledView;
use crate::channels::scale_space::Pyramid;
use crate::channels::window::PADDING;
use crate::channels::window::Position;
use crate::detector::Config;
use crate::model::Model;
use crate::scan::aggregate::{self, MAP_CHANNELS, MapStrip};
use crate::scan::cascade::{FEATURES, Map};
use crate::scan::{self, Scratch};
use crate::shell::support::random::Random;
use std::vec;
use std::vec::Vec;

/// Tolerance of the scan's labels: half a step between windows, or between levels, is the farthest that a target can be
/// from the nearest of them, and a little more.
fn tolerance(pyramid: &Pyramid<'_>) -> Tolerance {
    let octaves = 1.0 / pyramid.geometry().scales_per_octave() as f64;
    let cells = pyramid.geometry().history().stride() as f64;
    Tolerance {
        distance: 0.5 * cells + 0.3,
        scale: 0.5 * octaves + 0.07,
        far: 3.0,
        other_scale: 1.0,
    }
}

/// A window of the scan: the values of its aggregate channels, and its label.
#[derive(Debug, Clone)]
pub struct Window {
    /// Values of all features.
    pub values: [u8; FEATURES],
    /// The target it shows, a number unlike that of every other target and frame; none for a negative.
    pub target: Option<u32>,
    /// Whether it is of a clip that is held back.
    pub held_back: bool,
}

/// The whole maps of all levels; empty for levels that are not searched.
pub struct Maps {
    columns: Vec<usize>,
    bytes: Vec<Vec<u8>>,
}

impl Maps {
    /// Of the newest frame.
    pub fn of(pyramid: &Pyramid<'_>) -> Self {
        let noise = scan::noise(pyramid, &mut vec![0; scan::noise_words(pyramid.levels())]);
        let mut bytes = vec![Vec::new(); pyramid.levels().len()];
        for pictures in pyramid.searched() {
            let (columns, rows) = pictures.level.cells();
            let height = rows + 2 * PADDING;
            let mut memory = vec![0; aggregate::strip_bytes(columns, height)];
            let mut words = vec![0; aggregate::strip_words(columns)];
            let own = &mut bytes[usize::from(pictures.number)];
            aggregate::strips(
                &pictures.newest,
                &noise,
                (height, 0),
                &mut memory,
                &mut words,
                |strip| {
                    own.extend_from_slice(strip.bytes);
                },
            );
        }
        Self { columns: pyramid.levels().iter().map(|level| level.cells().0).collect(), bytes }
    }

    fn map(&self, level: usize) -> Map<'_> {
        Map::new(MapStrip { top: 0, bytes: &self.bytes[level] }, self.columns[level])
    }
}

/// The windows that the model's scan hands on, best first.
pub fn candidates(pyramid: &Pyramid<'_>, model: &Model<'_>, config: &Config) -> scan::Candidates {
    let geometry = pyramid.geometry();
    let mut bytes = vec![0; scan::bytes_len(geometry, false)];
    let mut words = vec![0; scan::words_len(geometry, false)];
    let scratch = Scratch { bytes: &mut bytes, words: &mut words };
    scan::search(model.scan(), pyramid, config.candidates, false, scratch).0
}

/// All windows that show a target of the frame.
pub fn positives(view: &SampledView<'_>, pyramid: &Pyramid<'_>, maps: &Maps) -> Vec<Window> {
    let truths = truths(&view.boxes);
    let tolerance = tolerance(pyramid);
    let mut windows = Vec::new();
    for (target, truth) in truths.iter().enumerate() {
        let TrainingBox::Target(truth) = truth else { continue };
        for level in pyramid.searched() {
            let offset = Offset::of(truth, Position::default(), &level.level);
            if offset.scale().abs() > tolerance.scale {
                continue;
            }
            let map = maps.map(usize::from(level.number));
            let place = |v: f64, count: usize| {
                let last = count as i16 - 1 - PADDING as i16;
                let first = -(PADDING as i16);
                (first..=last).filter(move |&at| (v - f64::from(at)).abs() <= tolerance.distance)
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
    view: &SampledView<'_>,
    pyramid: &Pyramid<'_>,
    maps: &Maps,
    count: usize,
    random: &mut Random,
) -> Vec<Window> {
    let truths = truths(&view.boxes);
    let tolerance = tolerance(pyramid);
    let active: Vec<usize> = pyramid.searched().map(|level| level.number.into()).collect();
    let mut windows = Vec::new();
    for _ in 0..count {
        let level = active[random.below(active.len())];
        let map = maps.map(level);
        let (columns, rows) = map.windows();
        let place = |v: usize| v as i16 - PADDING as i16;
        let (x, y) = (place(random.below(columns)), place(random.below(rows)));
        if label(&truths, Position::of_cell(x, y), &pyramid.levels()[level], &tolerance)
            == WindowLabel::Negative
        {
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
    view: &SampledView<'_>,
    pyramid: &Pyramid<'_>,
    model: &Model<'_>,
    config: &Config,
) -> Vec<Window> {
    let truths = truths(&view.boxes);
    let (maps, tolerance) = (Maps::of(pyramid), tolerance(pyramid));
    candidates(pyramid, model, config)
        .iter()
        .filter(|c| {
            let level = &pyramid.levels()[usize::from(c.level)];
            label(&truths, scan::window(c), level, &tolerance) == WindowLabel::Negative
        })
        .map(|c| Window {
            values: maps.map(usize::from(c.level)).values(c.x, c.y),
            target: None,
            held_back: view.held_back,
        })
        .collect()
}

/// Windows as the booster takes them.
#[derive(Debug)]
pub struct WindowTable {
    /// Feature values of the windows, binned.
    pub samples: BinnedSamples,
    /// Labels: 1 target, -1 background.
    pub targets: Vec<f32>,
    /// Weights of the rows to learn from; 0 for those held back.
    pub weights: Vec<f32>,
    /// Weights of the rows held back; 0 for the others.
    pub held_back: Vec<f32>,
}

impl WindowTable {
    /// Bins the windows into at most `edges` + 1 bins; of channels from `channels` on nothing is seen. Positives and
    /// negatives weigh the same in all.
    ///
    /// # Errors
    /// [`SamplesError`], when there are too many.
    pub fn new(windows: &[Window], edges: usize, channels: usize) -> Result<Self, SamplesError> {
        let value = |w: &Window, i: usize| {
            if i % MAP_CHANNELS < channels { u16::from(w.values[i]) } else { 0 }
        };
        let column = |i: usize| windows.iter().map(|w| value(w, i)).collect();
        let samples = BinnedSamples::from_columns((0..FEATURES).map(column), edges)?;
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
        let any = |target: f32| {
            self.held_back.iter().zip(&self.targets).any(|(&w, &t)| w > 0.0 && t == target)
        };
        (any(1.0) && any(-1.0)).then_some(Data {
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
