//! Small pictures of people, vehicles and the like, painted from ellipses and bars.

use super::cutout::Cutout;
use super::picture::BackgroundPicture;
use crate::shell::formats::class::Class;
use crate::shell::support::random::Random;
use crate::shell::support::vectors::sin_cos;
use std::vec;
use std::vec::Vec;

/// Side of a painted picture, pixels.
const SIDE: usize = 56;

/// A shape with its texture; its longer side is along y.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Thing {
    /// A person seen from the side.
    Person,
    /// A person seen from above.
    PersonFromAbove,
    /// A car or van seen from above.
    Car,
    /// A car seen from the side.
    CarFromSide,
    /// A boat seen from above, with a wake.
    Boat,
    /// An animal on four legs, from the side.
    Animal,
    /// A ball or a buoy.
    Ball,
    /// A shadow.
    Shadow,
}

/// A picture of opacity and light, painted over and over; coordinates from -1 to 1.
struct Canvas {
    pixels: Vec<[f64; 2]>,
}

impl Canvas {
    fn new() -> Self {
        Self { pixels: vec![[0.0; 2]; SIDE * SIDE] }
    }

    /// Paints where `cover` (0 to 1) of a point says.
    fn paint(&mut self, grey: f64, cover: impl Fn(f64, f64) -> f64) {
        for (i, pixel) in self.pixels.iter_mut().enumerate() {
            let at = |i: usize| (i as f64 + 0.5) / (SIDE as f64 / 2.0) - 1.0;
            let cover = cover(at(i % SIDE), at(i / SIDE)).clamp(0.0, 1.0);
            pixel[1] = pixel[1] * (1.0 - cover) + grey * cover;
            pixel[0] += (1.0 - pixel[0]) * cover;
        }
    }

    /// An ellipse; `soft` is the width of its edge as a share of its radius.
    fn ellipse(&mut self, [x, y]: [f64; 2], [rx, ry]: [f64; 2], grey: f64, soft: f64) {
        self.paint(grey, |px, py| {
            let (dx, dy) = ((px - x) / rx, (py - y) / ry);
            (1.0 - (dx * dx + dy * dy).sqrt()) / soft + 0.5
        });
    }

    /// A bar between two points.
    fn bar(&mut self, from: [f64; 2], to: [f64; 2], radius: f64, grey: f64) {
        let way = [to[0] - from[0], to[1] - from[1]];
        let square = (way[0] * way[0] + way[1] * way[1]).max(1e-9);
        self.paint(grey, |px, py| {
            let (dx, dy) = (px - from[0], py - from[1]);
            let along = ((dx * way[0] + dy * way[1]) / square).clamp(0.0, 1.0);
            let (dx, dy) = (dx - along * way[0], dy - along * way[1]);
            (radius - (dx * dx + dy * dy).sqrt()) * SIDE as f64 / 2.0 + 0.5
        });
    }

    /// A rectangle with slightly round corners.
    fn rectangle(&mut self, [x, y]: [f64; 2], [rx, ry]: [f64; 2], grey: f64) {
        self.paint(grey, |px, py| {
            let (dx, dy) = ((px - x).abs() - rx, (py - y).abs() - ry);
            -dx.max(dy).max(0.7 * (dx + dy) + 0.06) * SIDE as f64 / 2.0 + 0.5
        });
    }

    fn finish(self) -> Option<Cutout> {
        let byte = |v: f64| (v + 0.5).clamp(0.0, 255.0) as u8;
        let pixels = self.pixels.iter().map(|p| [byte(p[0] * 255.0), byte(p[1])]).collect();
        // It is not labelled: its class is not read.
        Cutout::of(SIDE, SIDE, pixels, Class::default())
    }
}

/// Paints a thing in two poses (steps, strokes), between which it changes as it moves.
pub(super) fn paint(thing: Thing, random: &mut Random) -> Vec<Cutout> {
    let mut grey =
        || if random.chance(0.5) { random.within(10.0, 90.0) } else { random.within(150.0, 250.0) };
    let (main, second, third) = (grey(), grey(), grey());
    let slim = random.within(0.8, 1.2);
    let pose = |step: f64| {
        let mut canvas = Canvas::new();
        match thing {
            Thing::Person => {
                for side in [-1.0, 1.0] {
                    canvas.bar([0.0, 0.1], [side * 0.22 * step, 0.92], 0.1 * slim, second);
                    canvas.bar([0.0, -0.45], [-side * 0.25 * step, 0.12], 0.065, main);
                }
                canvas.ellipse([0.0, -0.2], [0.2 * slim, 0.4], main, 0.25);
                canvas.ellipse([0.0, -0.78], [0.13, 0.16], third, 0.3);
            }
            Thing::PersonFromAbove => {
                canvas.bar([-0.1, 0.0], [-0.15, 0.6 * step], 0.12, second);
                canvas.bar([0.1, 0.0], [0.15, -0.6 * step], 0.12, second);
                canvas.ellipse([0.0, 0.0], [0.55 * slim, 0.3], main, 0.3);
                canvas.ellipse([0.0, -0.05], [0.2, 0.22], third, 0.4);
            }
            Thing::Car => {
                let wide = 0.42 * slim;
                canvas.rectangle([0.0, 0.0], [wide, 0.92], main);
                let glass = if main > 120.0 { 40.0 } else { 150.0 };
                canvas.rectangle([0.0, -0.4], [wide * 0.8, 0.12], glass);
                canvas.rectangle([0.0, 0.62], [wide * 0.75, 0.09], glass);
            }
            Thing::CarFromSide => {
                canvas.ellipse([0.0, -0.1], [0.55, 0.3], main * 0.7 + 20.0, 0.2);
                canvas.rectangle([0.0, 0.1], [0.93, 0.2], main);
                for x in [-0.55, 0.55] {
                    canvas.ellipse([x, 0.28], [0.17, 0.17], 20.0, 0.3);
                }
            }
            Thing::Boat => {
                for side in [-1.0, 1.0] {
                    canvas.bar([side * 0.12, 0.1], [side * (0.3 + 0.05 * step), 0.95], 0.06, 225.0);
                }
                canvas.ellipse([0.0, 0.55], [0.18, 0.42], 215.0, 0.6);
                canvas.ellipse([0.0, -0.4], [0.26 * slim, 0.55], main, 0.12);
                canvas.ellipse([0.0, -0.3], [0.15 * slim, 0.3], second, 0.3);
            }
            Thing::Animal => {
                for x in [-0.45, -0.3, 0.3, 0.42] {
                    canvas.bar([x, 0.1], [x + 0.15 * step, 0.75], 0.06, second);
                }
                canvas.ellipse([0.0, -0.05], [0.6, 0.26], main, 0.2);
                canvas.bar([0.45, -0.1], [0.75, -0.45], 0.12, main);
                canvas.ellipse([0.8, -0.45], [0.17, 0.11], main, 0.3);
            }
            Thing::Ball => canvas.ellipse([0.0, 0.0], [0.9, 0.9], main, 0.15),
            Thing::Shadow => canvas.ellipse([0.0, 0.0], [0.9, 0.45 * slim], 12.0, 0.7),
        }
        canvas.finish()
    };
    [pose(1.0), pose(-0.3)].into_iter().flatten().collect()
}

/// A piece of a picture with a rectangular, round or ragged outline.
pub(super) fn piece(picture: &BackgroundPicture, random: &mut Random) -> Option<Cutout> {
    let longer = random.within(20.0, 56.0);
    let aspect = random.within(0.3, 1.0);
    let (mut wide, mut high) = (longer, (longer * aspect).max(8.0));
    if random.chance(0.5) {
        core::mem::swap(&mut wide, &mut high);
    }
    let (width, height) = (wide as usize, high as usize);
    let left = random.below(picture.width.saturating_sub(width).max(1));
    let top = random.below(picture.height.saturating_sub(height).max(1));
    let outline = random.below(3);
    let turn = sin_cos(core::f64::consts::TAU * random.within(0.0, 1.0));
    let gain = random.within(0.6, 1.6);
    let shift = 70.0 * random.symmetric();
    let opacity = if random.chance(0.3) { random.within(0.35, 0.9) } else { 1.0 };
    let lobes = random.within(2.0, 6.0);
    let cover = |x: usize, y: usize| {
        let (u, v) = (
            (x as f64 + 0.5) / width as f64 * 2.0 - 1.0,
            (y as f64 + 0.5) / height as f64 * 2.0 - 1.0,
        );
        let edge = |distance: f64| (distance * longer / 3.0 + 0.3).clamp(0.0, 1.0);
        let radius = (u * u + v * v).sqrt();
        match outline {
            0 => edge(1.0 - u.abs().max(v.abs())),
            1 => edge(1.0 - radius),
            _ => {
                let wave = sin_cos(lobes * (u * turn.0 + v * turn.1) + 2.0 * u * v).0;
                edge(0.75 + 0.25 * wave - radius)
            }
        }
    };
    let pixels = (0..width * height).map(|i| {
        let (x, y) = (i % width, i / width);
        let source = picture.pixels
            [(top + y).min(picture.height - 1) * picture.width + (left + x).min(picture.width - 1)];
        let cover = cover(x, y) * opacity;
        let grey = ((f64::from(source) - 128.0) * gain + 128.0 + shift).clamp(0.0, 255.0);
        [(cover * 255.0) as u8, (grey * cover) as u8]
    });
    Cutout::of(width, height, pixels.collect(), Class::default())
}
