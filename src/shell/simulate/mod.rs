//! Simulated flights: a procedural scene, a moving camera, another aircraft.
//!
//! The same seed gives the same bytes on every processor: pictures are made with integers and
//! IEEE-exact operations alone, never with functions of the platform's mathematical library.

mod attitude;
mod encounter;
mod files;
mod landscape;
mod rendered;
mod scene;
mod settings;
mod shapes;
pub mod source;
mod telemetry;
mod write;

pub use files::SimulateError;
pub use rendered::RenderedFlightArgs;
pub use settings::{Manoeuvre, SimulateSettings};
pub use telemetry::{FlightTelemetry, START_US};
pub use write::{SimulateArgs, run};

use crate::shell::formats::camera_file::CameraFile;
use crate::shell::formats::clips::TruthBox;
use crate::shell::sources::{Frame, frame_time_us};
use crate::shell::support::random::Random;
use crate::shell::support::vectors::{atan2, dot};
use attitude::CameraPath;
use encounter::{OtherAircraft, encounter};
use scene::{Pose, ProceduralScene};
use shapes::Outline;
use std::vec;
use std::vec::Vec;

/// Instants within the exposure that make up a frame, and the position within the pixel that each samples.
const EXPOSURE: [(f64, f64); 2] = [(0.25, 0.75), (0.75, 0.25)];
/// Seconds from the first to the last of them.
const SHUTTER: f64 = 1.0 / 200.0;
/// Samples of the target along each side of a pixel at each instant.
const LOOKS: usize = 4;
/// Opacity from which on a pixel belongs to the target's box.
const VISIBLE: f64 = 0.15;
/// Focal length over the picture's width, as in the recorded flights.
const FOCAL: f64 = 0.875;
/// Pixels beyond the frame's edge in which the target is drawn, to detect that it is cut.
const MARGIN: i64 = 2;

/// Ground truth of one frame; angles in radians, x right, y down, z forward.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatedTruth {
    /// Yaw of the camera, positive to the right.
    pub yaw: f64,
    /// Pitch, positive above the horizon.
    pub pitch: f64,
    /// Roll about the optical axis.
    pub roll: f64,
    /// The other aircraft, seen or not.
    pub target: Option<SimulatedTarget>,
}

/// The other aircraft in one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulatedTarget {
    /// Bearing in the world, to the right of the z axis, radians.
    pub azimuth: f64,
    /// Below the horizon, radians.
    pub elevation: f64,
    /// Distance in metres.
    pub range: f64,
    /// Seconds at the present closing speed; `None` when it does not come nearer.
    pub time_to_contact: Option<f64>,
    /// Tight box around its visible part; `None` outside the frame.
    pub seen: Option<TruthBox>,
}

/// Renders any frame of one flight.
#[derive(Debug, Clone)]
pub struct Simulator {
    settings: SimulateSettings,
    scene: ProceduralScene,
    camera: CameraPath,
    target: Option<OtherAircraft>,
    /// Width, height and focal length in pixels.
    view: (usize, usize, f64),
    sums: Vec<u32>,
}

impl Simulator {
    /// Prepares a flight; sizes are brought to 16..=4096 pixels and the rate to 1..=1000.
    pub fn new(settings: &SimulateSettings) -> Self {
        let settings = settings.limited();
        let view =
            (settings.width as usize, settings.height as usize, f64::from(settings.width) * FOCAL);
        let (camera, target, trees) =
            encounter(&settings, view.2, &mut Random::stream(settings.seed, 0));
        let scene =
            ProceduralScene::new(&mut Random::stream(settings.seed, 1), trees, 1.0 / view.2);
        Self { scene, camera, target, view, sums: vec![0; view.0 * view.1], settings }
    }

    /// The settings in use.
    pub fn settings(&self) -> &SimulateSettings {
        &self.settings
    }

    /// Focal length, pixels.
    pub fn focal(&self) -> f64 {
        self.view.2
    }

    /// The camera; pixel centres are at whole numbers.
    pub fn camera(&self) -> CameraFile {
        let SimulateSettings { width, height, kind, .. } = self.settings;
        let middle = |side: u32| f64::from(side) / 2.0 - 0.5;
        CameraFile {
            width,
            height,
            fx: self.focal(),
            fy: self.focal(),
            cx: middle(width),
            cy: middle(height),
            kind: Some(kind.name().into()),
        }
    }

    /// Spans of the other aircraft, metres.
    pub fn spans(&self) -> Vec<f64> {
        self.target.iter().map(|target| target.span).collect()
    }

    /// Renders frame `index` (from 0) into `frame` and returns its ground truth.
    pub fn render(&mut self, index: u64, frame: &mut Frame) -> SimulatedTruth {
        let (width, height, _) = self.view;
        let time = index as f64 / f64::from(self.settings.fps);
        self.sums.fill(0);
        for (instant, offset) in instants(time).zip(EXPOSURE) {
            let pose = Pose {
                position: self.camera.position(instant),
                rotation: self.camera.rotation(instant),
            };
            for (row, sums) in self.sums.chunks_exact_mut(width).enumerate() {
                self.scene.add_row(&pose, row as f64, self.view, offset, sums);
            }
        }
        let seen = self.add_target(time);
        frame.width = width;
        frame.height = height;
        frame.time_us = frame_time_us(index, (self.settings.fps, 1));
        expose(&self.sums, &mut Random::stream(self.settings.seed, 2 + index), &mut frame.pixels);
        let [yaw, pitch, roll] = self.camera.attitude(time);
        let target = self.target.as_ref().map(|target| {
            let place = target.place(time);
            let level = (place[0] * place[0] + place[2] * place[2]).sqrt();
            SimulatedTarget {
                azimuth: atan2(place[0], place[2]),
                elevation: atan2(place[1], level),
                range: dot(place, place).sqrt(),
                time_to_contact: target.time_to_contact(time),
                seen,
            }
        });
        SimulatedTruth { yaw, pitch, roll, target }
    }

    /// Lays the target over the sums and gives its box.
    fn add_target(&mut self, time: f64) -> Option<TruthBox> {
        let target = self.target.as_ref()?;
        let mask = OpacityMask::new(&self.outlines(target, time), self.view);
        let (width, height) = (self.view.0 as i64, self.view.1 as i64);
        // Left, top, right, bottom of the visible pixels, all and within the frame.
        let mut inside = [i64::MAX, i64::MAX, i64::MIN, i64::MIN];
        let mut cut = false;
        for (place, &(opacity, tone)) in mask.pixels.iter().enumerate() {
            let x = mask.left + place as i64 % mask.width;
            let y = mask.top + place as i64 / mask.width;
            let within = (0..width).contains(&x) && (0..height).contains(&y);
            if opacity >= VISIBLE && within {
                let [left, top, right, bottom] = inside;
                inside = [left.min(x), top.min(y), right.max(x + 1), bottom.max(y + 1)];
            }
            cut |= opacity >= VISIBLE && !within;
            if within && opacity > 0.0 {
                let sum = &mut self.sums[(y * width + x) as usize];
                let light = (target.tone * opacity + tone) * (256 * EXPOSURE.len()) as f64;
                *sum = (f64::from(*sum) * (1.0 - opacity) + light).max(0.0) as u32;
            }
        }
        let [left, top, right, bottom] = inside;
        (left < right).then(|| TruthBox {
            id: 1,
            left: left as f64,
            top: top as f64,
            width: (right - left) as f64,
            height: (bottom - top) as f64,
            class: target.shape.class,
            visibility: if cut { 0.5 } else { 1.0 },
        })
    }

    /// The target as it is seen at each instant of the exposure; none behind the camera.
    fn outlines(&self, target: &OtherAircraft, time: f64) -> Vec<Outline> {
        instants(time)
            .filter_map(|instant| {
                let camera = self.camera.rotation(instant);
                let place = camera.invert(target.place(instant));
                let attitude = target.attitude(instant);
                // Nearer than a span it would surround the camera.
                (place[2] > target.span).then(|| {
                    let pose = (place, target.span, &attitude);
                    Outline::project(&target.shape, pose, &camera, self.view)
                })
            })
            .collect()
    }
}

/// The instants of the exposure about `time`, seconds.
fn instants(time: f64) -> impl Iterator<Item = f64> {
    let count = EXPOSURE.len();
    (0..count).map(move |i| time + SHUTTER * (i as f64 / (count - 1) as f64 - 0.5))
}

/// Opacity of the target and tone times opacity in the pixels about it.
struct OpacityMask {
    left: i64,
    top: i64,
    width: i64,
    pixels: Vec<(f64, f64)>,
}

impl OpacityMask {
    fn new(outlines: &[Outline], (width, height, _): (usize, usize, f64)) -> Self {
        let mut mask = Self { left: 0, top: 0, width: 1, pixels: Vec::new() };
        let bounds = outlines.iter().map(Outline::bounds);
        let Some([left, top, right, bottom]) =
            bounds.reduce(|a, b| [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3])])
        else {
            return mask;
        };
        let limit =
            |value: f64, side: usize| (value.floor() as i64).clamp(-MARGIN, side as i64 + MARGIN);
        (mask.left, mask.top) = (limit(left, width), limit(top, height));
        let (right, bottom) = (limit(right + 1.0, width), limit(bottom + 1.0, height));
        mask.width = (right - mask.left).max(1);
        let step = 1.0 / LOOKS as f64;
        let share = step * step / EXPOSURE.len() as f64;
        for y in mask.top..bottom {
            for x in mask.left..right {
                let mut pixel = (0.0, 0.0);
                for look in 0..LOOKS * LOOKS * outlines.len() {
                    let (within, outline) = (look % (LOOKS * LOOKS), look / (LOOKS * LOOKS));
                    let (opacity, tone) = outlines[outline].at(
                        x as f64 + step * ((within % LOOKS) as f64 + 0.5),
                        y as f64 + step * ((within / LOOKS) as f64 + 0.5),
                    );
                    pixel.0 += opacity * share;
                    pixel.1 += tone * share;
                }
                mask.pixels.push(pixel);
            }
        }
        mask
    }
}

/// Turns sums over the exposure into pixels with a sensor's noise, standard deviation about 2.
fn expose(sums: &[u32], random: &mut Random, pixels: &mut Vec<u8>) {
    pixels.clear();
    pixels.reserve(sums.len());
    for sums in sums.chunks(4) {
        let mut bits = random.bits();
        for &sum in sums {
            // The sum of two even distributions: near enough to a bell.
            let noise = (bits & 255) as i64 + (bits >> 8 & 255) as i64 - 255;
            bits >>= 16;
            let grey = i64::from(sum) / EXPOSURE.len() as i64 + noise * 5 + 128;
            pixels.push((grey >> 8).clamp(0, 255) as u8);
        }
    }
}

#[cfg(test)]
mod tests;
