//! Distractors: objects that move along the ground, and glints. They are no targets and not in the ground truth.

use super::assets::Assets;
use super::cutout::Cutout;
use super::draw::{by_ratio, weighted};
use super::motion::CameraMotion;
use super::paint::{Thing, paint, piece};
use super::picture::PictureKind;
use super::scene::BackgroundScene;
use super::settings::RenderSettings;
use super::sprite::{Placement, Tone, draw};
use super::sway::Sway;
use super::view::Optics;
use crate::shell::support::random::Random;
use crate::shell::support::vectors::{WorldVector, atan2, sin_cos};
use std::vec::Vec;

/// Seconds between two poses of a walking thing.
const STEP: f64 = 0.27;

/// A thing that moves along the textured surface.
#[derive(Debug, Clone)]
pub(super) struct Mover {
    poses: Vec<Cutout>,
    /// Texture coordinates at the flight's middle, and their change a second.
    place: [f64; 2],
    velocity: [f64; 2],
    wander: [Sway; 2],
    /// Relief that it moves on.
    relief: f64,
    /// Longer side in pixels at its first distance.
    pixels: f64,
    distance: Option<f64>,
    /// Turn in the picture, radians; poses that are seen from above point along their way.
    turn: f64,
    mirrored: bool,
    tone: Tone,
    middle: f64,
}

impl Mover {
    /// Draws a mover in view at some instant of the flight.
    pub(super) fn draw_anew(
        assets: &Assets,
        scene: &BackgroundScene,
        settings: &RenderSettings,
        motion: &CameraMotion,
        view: &Optics,
        random: &mut Random,
    ) -> Option<Self> {
        let from_above = scene.kind == PictureKind::Nadir;
        let seconds = settings.frames as f64 / f64::from(settings.fps);
        let time = seconds * random.within(0.1, 0.9);
        // On the ground; a few anywhere, as dirt and reflections are.
        let anywhere = random.chance(0.04);
        let mut place = [0.0; 2];
        let mut relief = 0.0;
        for _ in 0..20 {
            let pixel = [0, 1].map(|i: usize| view.size[i] * random.within(0.05, 0.95));
            let ray = motion.rotation(time).apply(view.ray(pixel));
            place = scene.projection.place(ray, motion.position(time), 0.2)?;
            relief = scene.relief_at(place);
            if from_above || anywhere || relief > 0.0 {
                break;
            }
        }
        if !(from_above || anywhere || relief > 0.0) {
            return None;
        }
        let pixels = by_ratio(random, settings.scene.mover_pixels);
        let kind = weighted(random, &[0.35, 0.2, 0.15, 0.08, 0.08, 0.08, 0.06]);
        let poses = match (kind, from_above) {
            (0, _) => piece(&assets.pictures[random.below(assets.pictures.len())], random)
                .into_iter()
                .collect(),
            (1, true) => paint(Thing::PersonFromAbove, random),
            (1, false) => paint(Thing::Person, random),
            (2, true) => paint(Thing::Car, random),
            (2, false) => paint(Thing::CarFromSide, random),
            (3, _) => paint(Thing::Boat, random),
            (4, _) => paint(Thing::Animal, random),
            (5, _) => paint(Thing::Ball, random),
            _ => paint(Thing::Shadow, random),
        };
        if poses.is_empty() {
            return None;
        }
        let pixels = if kind == 5 { pixels.min(14.0) } else { pixels };
        // Body lengths a second, most of them slow.
        let speed = pixels * if random.chance(0.2) { 0.0 } else { by_ratio(random, [0.15, 4.0]) };
        let angle = core::f64::consts::PI * random.symmetric();
        let (sine, cosine) = sin_cos(angle);
        let flat = if from_above { 1.0 } else { 0.3 };
        let velocity = [speed * cosine, speed * sine * flat];
        let seen_from_above = from_above && !matches!(kind, 0 | 5);
        let wander = 0.15 * pixels * random.within(0.0, 1.0) + 1e-6;
        let mut mover = Self {
            poses,
            place: [0, 1].map(|i: usize| place[i] - velocity[i] * (time - seconds / 2.0)),
            velocity,
            wander: [0, 1].map(|_| Sway::new(random, wander, 0.1, 1.2)),
            relief,
            pixels,
            distance: None,
            // Painted things point upwards.
            turn: if seen_from_above {
                angle + core::f64::consts::FRAC_PI_2
            } else {
                0.1 * random.symmetric()
            },
            mirrored: velocity[0] < 0.0,
            tone: Tone {
                gain: random.within(0.6, 1.1),
                offset: 25.0 * random.symmetric(),
                inverted: false,
                opacity: if kind == 6 {
                    random.within(0.25, 0.6)
                } else {
                    random.within(0.75, 1.0)
                },
            },
            middle: seconds / 2.0,
        };
        mover.distance = mover.seen(scene, motion, time).1;
        Some(mover)
    }

    /// Direction from the camera at an instant, and the distance, metres; no distance in the sky.
    fn seen(
        &self,
        scene: &BackgroundScene,
        motion: &CameraMotion,
        time: f64,
    ) -> (WorldVector, Option<f64>) {
        let passed = time - self.middle;
        let place = [0, 1]
            .map(|i: usize| self.place[i] + self.velocity[i] * passed + self.wander[i].at(time));
        scene.seen(place, self.relief, motion.position(time))
    }

    /// Draws it into the frame at `time`.
    pub(super) fn draw(
        &self,
        scene: &BackgroundScene,
        motion: &CameraMotion,
        view: &Optics,
        time: f64,
        pixels: &mut [u8],
    ) {
        let size = [view.size[0] as usize, view.size[1] as usize];
        let seen =
            |time: f64| view.project(motion, time, |instant| self.seen(scene, motion, instant).0);
        let half = motion.exposure / 2.0;
        let (Some(centre), Some(before), Some(after)) =
            (seen(time), seen(time - half), seen(time + half))
        else {
            return;
        };
        let ratio = match (self.distance, self.seen(scene, motion, time).1) {
            (Some(first), Some(now)) => (first / now).clamp(0.2, 4.0),
            _ => 1.0,
        };
        let cutout = &self.poses[(time / STEP) as usize % self.poses.len()];
        let [_, _, wide, high] = cutout.bounds;
        let scale = self.pixels * ratio / wide.max(high);
        let instant = view.row_time(motion, time, centre[1]);
        let placement = Placement {
            centre,
            size: [wide * scale, high * scale],
            turn: self.turn - motion.attitude(instant)[2],
            mirrored: self.mirrored,
            blur: [after[0] - before[0], after[1] - before[1]],
        };
        draw(pixels, size, cutout, &placement, &self.tone);
    }
}

/// Points that flash: glints on water and glass, lamps.
#[derive(Debug, Clone, Default)]
pub(super) struct Glints {
    /// Direction, share of the time that it shines, and size in pixels.
    points: Vec<(WorldVector, f64, f64)>,
    spot: Option<Cutout>,
    seed: u64,
}

impl Glints {
    /// Draws glints for what the flight sees in its middle.
    pub(super) fn draw_anew(
        settings: &RenderSettings,
        motion: &CameraMotion,
        view: &Optics,
        random: &mut Random,
    ) -> Self {
        let mut points = Vec::new();
        if random.chance(settings.scene.glints_probability) {
            let count = 1 + random.below(40);
            let centre = [0, 1].map(|i: usize| view.size[i] * random.within(0.1, 0.9));
            let spread = random.within(0.05, 0.6);
            let steady = random.chance(0.3);
            for _ in 0..count {
                let pixel =
                    [0, 1].map(|i: usize| centre[i] + view.size[i] * spread * random.symmetric());
                let time = settings.frames as f64 / f64::from(settings.fps) / 2.0;
                let ray = motion.rotation(time).apply(view.ray(pixel));
                let share = if steady { 1.0 } else { random.within(0.05, 0.7) };
                points.push((ray, share, by_ratio(random, [1.2, 7.0])));
            }
        }
        Self { points, spot: paint(Thing::Ball, random).into_iter().next(), seed: random.bits() }
    }

    /// Draws them into the frame at `time`, number `index`.
    pub(super) fn draw(
        &self,
        (time, index): (f64, u64),
        motion: &CameraMotion,
        view: &Optics,
        pixels: &mut [u8],
    ) {
        let size = [view.size[0] as usize, view.size[1] as usize];
        let Some(spot) = &self.spot else { return };
        let mut random = Random::stream(self.seed, index);
        for (ray, share, length) in &self.points {
            let (shines, strength) = (random.chance(*share), random.within(0.5, 1.0));
            let Some(centre) = view.project(motion, time, |_| *ray) else { continue };
            if shines {
                let placement = Placement {
                    centre,
                    size: [*length; 2],
                    turn: 0.0,
                    mirrored: false,
                    blur: [0.0; 2],
                };
                let tone = Tone { gain: 0.0, offset: 255.0, inverted: false, opacity: strength };
                draw(pixels, size, spot, &placement, &tone);
            }
        }
    }
}

/// Parts of the own craft: fixed in the picture but for a little shaking; propellers pass through it.
#[derive(Debug, Clone, Default)]
pub(super) struct OwnCraft {
    parts: Vec<(Cutout, Placement, Tone)>,
    propeller: Option<(Cutout, Placement)>,
    seed: u64,
}

impl OwnCraft {
    /// Draws the parts in view, or none.
    pub(super) fn draw_anew(settings: &RenderSettings, random: &mut Random) -> Self {
        if !random.chance(settings.sensor.own_craft_probability) {
            return Self::default();
        }
        let size = settings.size.map(|s| s as f64);
        let mut craft = Self { seed: random.bits(), ..Self::default() };
        let edge = |random: &mut Random| match random.below(3) {
            0 => {
                [if random.chance(0.5) { 0.0 } else { size[0] }, size[1] * random.within(0.0, 1.0)]
            }
            1 => [size[0] * random.within(0.0, 1.0), 0.0],
            _ => [size[0] * random.within(0.0, 1.0), size[1]],
        };
        for _ in 0..1 + random.below(3) {
            let thing = if random.chance(0.5) { Thing::Ball } else { Thing::Shadow };
            let Some(cutout) = paint(thing, random).into_iter().next() else { continue };
            let centre = edge(random);
            let (long, wide) = (random.within(60.0, 320.0), random.within(14.0, 90.0));
            let inwards = atan2(size[1] / 2.0 - centre[1], size[0] / 2.0 - centre[0]);
            let placement = Placement {
                centre,
                size: [long, wide],
                turn: inwards + 0.5 * random.symmetric(),
                mirrored: false,
                blur: [0.0; 2],
            };
            let dark = if random.chance(0.8) {
                random.within(8.0, 60.0)
            } else {
                random.within(150.0, 230.0)
            };
            craft.parts.push((
                cutout,
                placement,
                Tone { gain: 0.0, offset: dark, inverted: false, opacity: 1.0 },
            ));
        }
        if random.chance(0.35) {
            let blade = paint(Thing::Shadow, random).into_iter().next();
            let size = [random.within(200.0, 420.0), random.within(16.0, 50.0)];
            let placement = Placement {
                centre: edge(random),
                size,
                turn: 0.0,
                mirrored: false,
                blur: [0.0; 2],
            };
            craft.propeller = blade.map(|blade| (blade, placement));
        }
        craft
    }

    /// Draws it into frame number `index`.
    pub(super) fn draw(&self, index: u64, view: &Optics, pixels: &mut [u8]) {
        let size = [view.size[0] as usize, view.size[1] as usize];
        let mut random = Random::stream(self.seed, index);
        let shake = [0; 2].map(|_: i32| 0.6 * random.symmetric());
        for (cutout, placement, tone) in &self.parts {
            let centre = [0, 1].map(|i: usize| placement.centre[i] + shake[i]);
            draw(pixels, size, cutout, &Placement { centre, ..*placement }, tone);
        }
        if let Some((blade, placement)) = &self.propeller {
            let turn = core::f64::consts::TAU * random.within(0.0, 1.0);
            let tone = Tone { opacity: 0.25, ..Tone::PLAIN };
            draw(pixels, size, blade, &Placement { turn, ..*placement }, &tone);
        }
    }
}
