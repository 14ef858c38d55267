//! Flying objects: targets on courses relative to the camera, and birds.

use super::assets::{Assets, CutoutRun};
use super::cutout::Cutout;
use super::draw::{by_ratio, even, weighted};
use super::motion::CameraMotion;
use super::settings::RenderSettings;
use super::solid::{Solid, SolidPose};
use super::sprite::{Drawn, Placement, Tone, draw};
use super::sway::Sway;
use super::view::Optics;
use crate::shell::formats::class::Class;
use crate::shell::support::random::Random;
use crate::shell::support::vectors::{Rotation, WorldVector, add, atan2, direction, dot};
use std::vec::Vec;

/// Metres a second that count as coming nearer.
const CLOSING: f64 = 0.05;

/// Manoeuvre of a target.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encounter {
    /// Flies across the view.
    Crossing,
    /// Stays where it is, before sky or ground.
    Hover,
    /// Comes nearer on a constant bearing; contact is shortly after the end.
    Collision,
    /// Flies away from the camera.
    Receding,
    /// No target.
    None,
}

impl Encounter {
    const ALL: [Self; 5] =
        [Self::Crossing, Self::Hover, Self::Collision, Self::Receding, Self::None];

    /// The word for it in `camera.json`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Crossing => "crossing",
            Self::Hover => "hover",
            Self::Collision => "collision",
            Self::Receding => "receding",
            Self::None => "none",
        }
    }

    /// Draws a kind by the settings' shares.
    pub(super) fn draw(random: &mut Random, settings: &RenderSettings) -> Self {
        Self::ALL[weighted(random, &settings.targets.kinds)]
    }
}

/// Appearance of a flying object.
#[derive(Debug, Clone)]
enum Appearance<'a> {
    /// Frames of a recording, shown forth and back.
    Run { run: &'a CutoutRun, phase: usize, mirrored: bool, stretch: f64, tone: Tone, bank: Sway },
    /// A solid, its heading and rate of turn, and its tilt about two axes.
    Solid {
        solid: &'a Solid,
        heading: [f64; 2],
        tilt: [Sway; 2],
        sun: WorldVector,
        tones: [f64; 2],
    },
}

/// A flying object of a flight.
#[derive(Debug, Clone)]
pub(super) struct FlyingObject<'a> {
    figure: Appearance<'a>,
    /// Longest extent, metres.
    pub length: f64,
    /// From the camera at time 0, metres in the axes of the world.
    start: WorldVector,
    /// Against the camera, metres a second.
    velocity: WorldVector,
    /// Deviations from the straight course, metres.
    wander: [Sway; 3],
    class: Class,
}

impl<'a> FlyingObject<'a> {
    /// Draws a target of a kind.
    pub(super) fn target(
        kind: Encounter,
        assets: &'a Assets,
        settings: &RenderSettings,
        motion: &CameraMotion,
        view: &Optics,
        random: &mut Random,
    ) -> Option<Self> {
        let figure = Appearance::target(assets, settings, random)?;
        let class = figure.class();
        let length = match (&figure, class) {
            (Appearance::Solid { solid, .. }, _) => solid.length,
            (_, Class::Drone) => by_ratio(random, [0.3, 1.8]),
            (_, Class::Airplane) => by_ratio(random, [2.0, 34.0]),
            _ => by_ratio(random, [8.0, 18.0]),
        };
        let seconds = settings.frames as f64 / f64::from(settings.fps);
        let near = by_ratio(random, settings.targets.pixels);
        let far = match kind {
            Encounter::Collision => near * random.within(0.15, 0.5),
            Encounter::Receding => near * random.within(0.2, 0.7),
            _ => near * random.within(0.7, 1.0),
        };
        // Never so small that nothing can be learned from it.
        let range =
            |pixels: f64| view.focal * length / pixels.max(0.6 * settings.targets.pixels[0]);
        let (near, far) = (range(near), range(far));
        // Bearings inside of the picture at an instant, by the attitude at it.
        let aim = |random: &mut Random, time: f64, share: f64| {
            let place =
                [0, 1].map(|i: usize| view.size[i] * (0.5 + 0.5 * share * random.symmetric()));
            let ray = motion.rotation(time).apply(view.ray(place));
            let length = dot(ray, ray).sqrt();
            ray.map(|v| v / length)
        };
        let scaled = |v: WorldVector, range: f64| v.map(|x| x * range);
        let (from, to) = match kind {
            Encounter::Collision => {
                let bearing = aim(random, seconds / 2.0, 0.6);
                // Contact from 0.2 to 2.5 s after the end.
                (scaled(bearing, far), scaled(bearing, near))
            }
            Encounter::Receding => {
                let (first, last) =
                    (aim(random, seconds * 0.2, 0.7), aim(random, seconds * 0.8, 0.7));
                (scaled(first, near), scaled(last, far))
            }
            Encounter::Hover => {
                let bearing = aim(random, seconds / 2.0, 0.75);
                // It stands in the world; only from a camera that would soon be past it, it flies along.
                let travel = motion.velocity.map(|v| v * seconds / 2.0);
                let share = 0.4 * near / dot(travel, travel).sqrt().max(0.4 * near);
                let middle = scaled(bearing, near);
                (add(middle, travel, share), add(middle, travel, -share))
            }
            _ => {
                let (start, end) = (random.within(0.0, 0.3), random.within(0.7, 1.0));
                let first = aim(random, seconds * start, 0.95);
                let last = aim(random, seconds * end, 0.95);
                (scaled(first, near), scaled(last, far))
            }
        };
        let wander = match kind {
            Encounter::Collision => 0.0005 * near,
            Encounter::Hover => 0.01 * near,
            _ => 0.004 * near,
        };
        Some(Self {
            figure,
            length,
            start: from,
            velocity: add(to, from, -1.0).map(|v| v / seconds),
            wander: [0, 1, 2].map(|_| Sway::new(random, wander, 0.03, 0.6)),
            class,
        })
    }

    /// Draws a bird; `None` without recordings of any.
    pub(super) fn bird(
        assets: &'a Assets,
        settings: &RenderSettings,
        motion: &CameraMotion,
        view: &Optics,
        random: &mut Random,
    ) -> Option<Self> {
        if assets.birds.is_empty() {
            return None;
        }
        let run = &assets.birds[random.below(assets.birds.len())];
        let figure = Appearance::recorded(run, settings, random);
        let length = random.within(0.3, 1.6);
        let range = view.focal * length / by_ratio(random, [4.0, 45.0]);
        let seconds = settings.frames as f64 / f64::from(settings.fps);
        let time = seconds * random.within(0.1, 0.9);
        let place = [0, 1].map(|i: usize| view.size[i] * (0.5 + 0.48 * random.symmetric()));
        let ray = motion.rotation(time).apply(view.ray(place));
        let norm = dot(ray, ray).sqrt();
        let speed = random.within(0.0, 0.25) * range;
        let course =
            direction(core::f64::consts::PI * random.symmetric(), 0.3 * random.symmetric());
        let velocity = course.map(|v| v * speed);
        Some(Self {
            figure,
            length,
            start: add(ray.map(|v| v * range / norm), velocity, -time),
            velocity,
            wander: [0, 1, 2].map(|_| Sway::new(random, 0.02 * range, 0.1, 0.9)),
            class: Class::Bird,
        })
    }

    /// From the camera to the object at `time`, metres in the axes of the world.
    pub(super) fn place(&self, time: f64) -> WorldVector {
        let straight = add(self.start, self.velocity, time);
        core::array::from_fn(|i| straight[i] + self.wander[i].at(time))
    }

    /// Class of the ground truth.
    pub(super) fn class(&self) -> Class {
        self.class
    }

    /// Seconds until the camera is reached at the present rate; `None` when it does not come nearer.
    pub(super) fn time_to_contact(&self, time: f64) -> Option<f64> {
        let range = |time: f64| {
            let place = self.place(time);
            dot(place, place).sqrt()
        };
        let closing = (range(time - 0.005) - range(time + 0.005)) / 0.01;
        (closing > CLOSING).then(|| range(time) / closing)
    }

    /// Draws it into the frame at `time`, number `index`.
    pub(super) fn draw(
        &self,
        (time, index): (f64, u64),
        motion: &CameraMotion,
        view: &Optics,
        pixels: &mut [u8],
    ) -> Option<Drawn> {
        let size = [view.size[0] as usize, view.size[1] as usize];
        let seen = |time: f64| view.project(motion, time, |instant| self.place(instant));
        let centre = seen(time)?;
        let (before, after) =
            (seen(time - motion.exposure / 2.0)?, seen(time + motion.exposure / 2.0)?);
        let blur = [after[0] - before[0], after[1] - before[1]];
        let instant = view.row_time(motion, time, centre[1]);
        let place = self.place(instant);
        let range = dot(place, place).sqrt();
        if range < 2.0 * self.length {
            return None;
        }
        match &self.figure {
            Appearance::Run { run, phase, mirrored, stretch, tone, bank } => {
                let cutout = frame_of(run, phase + index as usize);
                let [_, _, wide, high] = cutout.bounds;
                let (wide, high) = (wide * stretch, high);
                let scale = view.focal * self.length / range / wide.max(high);
                let placement = Placement {
                    centre,
                    size: [wide * scale, high * scale],
                    turn: bank.at(time) - motion.attitude(instant)[2],
                    mirrored: *mirrored,
                    blur,
                };
                draw(pixels, size, cutout, &placement, tone)
            }
            Appearance::Solid { solid, heading, tilt, sun, tones } => {
                let [pitch, roll] = [0, 1].map(|i: usize| tilt[i].at(time));
                let attitude = Rotation::new(heading[0] + heading[1] * time, pitch, roll);
                let camera = motion.rotation(instant);
                let pose = SolidPose {
                    place: camera.invert(place),
                    length: self.length,
                    attitude: &attitude,
                    camera: &camera,
                    focal: view.focal,
                    sun: *sun,
                    tones: *tones,
                };
                let (cutout, middle, extent) = solid.render(&pose)?;
                // Where its place would be without distortion, to carry the offset of its bounds over.
                let straight = [0, 1].map(|i: usize| view.focal * pose.place[i] / pose.place[2]);
                let placement = Placement {
                    centre: [0, 1].map(|i: usize| centre[i] + middle[i] - straight[i]),
                    size: extent,
                    turn: 0.0,
                    mirrored: false,
                    blur,
                };
                draw(pixels, size, &cutout, &placement, &Tone::PLAIN)
            }
        }
    }
}

impl<'a> Appearance<'a> {
    fn target(assets: &'a Assets, settings: &RenderSettings, random: &mut Random) -> Option<Self> {
        let solid = random.chance(settings.targets.solid_probability) && !assets.solids.is_empty();
        if solid || assets.targets.is_empty() {
            let drones: Vec<&Solid> =
                assets.solids.iter().filter(|s| s.class == Class::Drone).collect();
            let all: Vec<&Solid> = assets.solids.iter().collect();
            let choice = if random.chance(0.5) && !drones.is_empty() { drones } else { all };
            if choice.is_empty() {
                return None;
            }
            let tilt = random.within(0.03, 0.2);
            let bright = if random.chance(0.3) { [120.0, 245.0] } else { [25.0, 130.0] };
            let lit = even(random, bright);
            return Some(Self::Solid {
                solid: choice[random.below(choice.len())],
                heading: [core::f64::consts::PI * random.symmetric(), 0.5 * random.symmetric()],
                tilt: [0, 1].map(|_| Sway::new(random, tilt, 0.1, 1.0)),
                sun: direction(
                    core::f64::consts::PI * random.symmetric(),
                    random.within(-1.4, -0.2),
                ),
                tones: [lit, lit * random.within(0.15, 0.6)],
            });
        }
        // First the clip, then the run: clips with many runs are not favoured.
        let clip = &assets.targets[random.below(assets.targets.len())];
        Some(Self::recorded(&clip[random.below(clip.len())], settings, random))
    }

    fn recorded(run: &'a CutoutRun, settings: &RenderSettings, random: &mut Random) -> Self {
        Self::Run {
            run,
            phase: random.below(2 * run.len()),
            mirrored: random.chance(0.5),
            stretch: by_ratio(random, [0.7, 1.4]),
            tone: Tone {
                gain: even(random, settings.targets.contrast),
                offset: 25.0 * random.symmetric(),
                inverted: random.chance(settings.targets.inverted_probability),
                opacity: if random.chance(0.12) { random.within(0.45, 0.9) } else { 1.0 },
            },
            bank: Sway::new(random, 0.08, 0.05, 0.8),
        }
    }

    fn class(&self) -> Class {
        match self {
            Self::Run { run, .. } => run[0].class,
            Self::Solid { solid, .. } => solid.class,
        }
    }
}

/// The frame of a run at a place, forth and back through it.
fn frame_of(run: &CutoutRun, place: usize) -> &Cutout {
    let at = place % (2 * run.len());
    &run[at.min(2 * run.len() - 1 - at)]
}

/// Azimuth and elevation (down positive) of a direction, radians.
pub(super) fn bearing(place: WorldVector) -> [f64; 2] {
    let level = (place[0] * place[0] + place[2] * place[2]).sqrt();
    [atan2(place[0], place[2]), atan2(place[1], level)]
}
