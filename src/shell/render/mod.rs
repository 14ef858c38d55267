//! Rendered flights: photographs and panoramas as backgrounds with depth, a moving camera, and flying objects cut out of
//! recordings or rendered from solid models.
//!
//! In: [`Assets`] (a folder of pictures, splits of clips to cut objects out of, OBJ models) and [`RenderSettings`] (ranges that
//! every flight draws its own values from). Out: [`RenderedFlight`], which yields grey frames with [`RenderedTruth`], the
//! same bytes for the same assets, settings, seed and index on every processor: integers and IEEE-exact operations alone,
//! nothing of a platform's mathematical library.
//!
//! The way of a frame: camera pose (`motion`) -> texture coordinates of a grid of pixels (`view`, `projection`) ->
//! gathering with relief, shimmer and motion blur (`background`, `scene`) -> movers, glints, birds, targets, own craft
//! (`movers`, `targets`, `sprite`) -> vignette, gain, noise (`sensor`) -> video compression (`codec`).
//!
//! May import: random numbers, vectors, sources, clips. Imported by the simulator (as files) and the trainer (in memory).

mod assets;
mod background;
mod codec;
mod cutout;
mod draw;
mod error;
mod motion;
mod movers;
pub(in crate::shell) mod noise;
mod paint;
mod picture;
mod projection;
mod scene;
mod sensor;
mod settings;
mod solid;
mod sprite;
mod sway;
mod targets;
#[cfg(test)]
mod tests;
mod view;

pub use assets::{Assets, CutoutRun};
pub use cutout::Cutout;
pub use error::RenderError;
pub use settings::{
    BackgroundSettings, DEFAULT, MotionSettings, RenderSettings, RenderSettingsError,
    SceneSettings, Sensor, Targets,
};
pub(in crate::shell) use sway::Sway;
pub use targets::Encounter;

use crate::shell::formats::clips::TruthBox;
use crate::shell::sources::{Frame, frame_time_us};
use crate::shell::support::random::Random;
use crate::shell::support::vectors::dot;
use background::Renderer;
use codec::Codec;
use draw::{even, weighted};
use motion::CameraMotion;
use movers::{Glints, Mover, OwnCraft};
use picture::{BackgroundPicture, PictureKind};
use scene::BackgroundScene;
use sensor::SensorModel;
use std::vec::Vec;
use targets::FlyingObject;
use view::Optics;

/// Smallest contrast of an object that has to be found, grey levels; a fainter one has visibility 0.5.
const FAINT: f64 = 6.0;

/// Ground truth of one frame of a flight. Angles in radians; x right, y down, z forward.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RenderedTruth {
    /// Yaw (to the right), pitch (nose up) and roll of the camera at the frame's middle row.
    pub attitude: [f64; 3],
    /// Visible targets and birds (class 4); what moves on the ground is not among them.
    pub boxes: Vec<TruthBox>,
    /// Targets in the air, in view or not; birds are not among them.
    pub targets: Vec<RenderedTarget>,
}

/// A target in one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RenderedTarget {
    /// Its number in the boxes.
    pub id: i64,
    /// Bearing in the world to the right of the z axis, radians.
    pub azimuth: f64,
    /// Below the horizon, radians.
    pub elevation: f64,
    /// Distance in metres.
    pub range: f64,
    /// Seconds at the present closing speed; `None` when it does not come nearer.
    pub time_to_contact: Option<f64>,
}

/// A flight that is rendered frame by frame.
#[derive(Debug)]
pub struct RenderedFlight<'a> {
    settings: &'a RenderSettings,
    kind: Encounter,
    scene: BackgroundScene,
    motion: CameraMotion,
    view: Optics,
    renderer: Renderer,
    movers: Vec<Mover>,
    glints: Glints,
    craft: OwnCraft,
    birds: Vec<FlyingObject<'a>>,
    targets: Vec<FlyingObject<'a>>,
    sensor: SensorModel,
    codec: Codec,
    next: u64,
}

impl<'a> RenderedFlight<'a> {
    /// Draws flight number `index` of a seed. Panics if `assets` has no picture, which [`Assets::load`] excludes.
    pub fn new(assets: &'a Assets, settings: &'a RenderSettings, seed: u64, index: u64) -> Self {
        let flight = Random::stream(seed, index).bits();
        let stream = |part: u64| Random::stream(flight, part);
        let random = &mut stream(0);
        let [width, height] = settings.size;
        let view = Optics {
            size: [width as f64, height as f64],
            focal: even(random, settings.focal) * width as f64 / 640.0,
            undistortion: -even(random, settings.sensor.distortion),
        };
        let (picture, kind) = choose(assets, settings, random);
        let (scene, motion) = BackgroundScene::new(picture, kind, settings, &view, &mut stream(1));
        let random = &mut stream(2);
        let count = if random.chance(settings.scene.movers_probability) {
            let [low, high] = settings.scene.movers;
            low + random.below(high.saturating_sub(low) + 1)
        } else {
            0
        };
        let mover = |_| Mover::draw_anew(assets, &scene, settings, &motion, &view, random);
        let movers = (0..count).filter_map(mover).collect();
        let random = &mut stream(3);
        let glints = Glints::draw_anew(settings, &motion, &view, random);
        let craft = OwnCraft::draw_anew(settings, random);
        let random = &mut stream(4);
        let kind = Encounter::draw(random, settings);
        let mut targets = Vec::new();
        let mut next = kind;
        while next != Encounter::None && targets.len() < 4 {
            targets.extend(FlyingObject::target(next, assets, settings, &motion, &view, random));
            next = Encounter::None;
            if random.chance(settings.targets.more_probability) {
                next = Encounter::draw(random, settings);
            }
        }
        let random = &mut stream(5);
        let count = if random.chance(settings.scene.birds_probability) {
            1 + random.below(settings.scene.birds.max(1))
        } else {
            0
        };
        let bird = |_| FlyingObject::bird(assets, settings, &motion, &view, random);
        let birds = (0..count).filter_map(bird).collect();
        let sensor = SensorModel::draw(&mut stream(6), settings);
        let codec = Codec::draw(&mut stream(7), settings);
        let renderer = Renderer::new(settings.size, &mut stream(8));
        Self {
            settings,
            kind,
            scene,
            motion,
            view,
            renderer,
            movers,
            glints,
            craft,
            birds,
            targets,
            sensor,
            codec,
            next: 0,
        }
    }

    /// Renders the next frame into `frame` (reusing its memory); `None` after the last one.
    pub fn next_frame(&mut self, frame: &mut Frame) -> Option<RenderedTruth> {
        let index = self.next;
        if index >= self.settings.frames {
            return None;
        }
        self.next += 1;
        let [width, height] = self.settings.size;
        let time = index as f64 / f64::from(self.settings.fps);
        frame.width = width;
        frame.height = height;
        frame.time_us = frame_time_us(index, (self.settings.fps, 1));
        frame.pixels.resize(width * height, 0);
        let Self { scene, motion, view, .. } = self;
        let (scene, motion, view) = (&*scene, &*motion, &*view);
        self.renderer.render(scene, motion, view, (time, index), &mut frame.pixels);
        for mover in &self.movers {
            mover.draw(scene, motion, view, time, &mut frame.pixels);
        }
        self.glints.draw((time, index), motion, view, &mut frame.pixels);
        let mut truth =
            RenderedTruth { attitude: motion.attitude(time), ..RenderedTruth::default() };
        // Far ones first.
        let mut objects: Vec<(i64, &FlyingObject<'_>)> =
            (1..).zip(self.targets.iter().chain(&self.birds)).collect();
        let range = |object: &FlyingObject<'_>| {
            let place = object.place(time);
            dot(place, place)
        };
        objects.sort_by(|a, b| range(b.1).total_cmp(&range(a.1)));
        for (id, object) in objects {
            let Some(drawn) = object.draw((time, index), motion, view, &mut frame.pixels) else {
                continue;
            };
            let [left, top, right, bottom] = drawn.bounds;
            let visibility = if drawn.cut || drawn.contrast < FAINT { 0.5 } else { 1.0 };
            let (width, height, class) = (right - left, bottom - top, object.class());
            truth.boxes.push(TruthBox { id, left, top, width, height, class, visibility });
        }
        truth.boxes.sort_by_key(|b| b.id);
        truth.targets =
            (1..).zip(&self.targets).map(|(id, target)| target_truth(id, target, time)).collect();
        self.craft.draw(index, view, &mut frame.pixels);
        self.sensor.apply((time, index), width, &mut frame.pixels);
        let motions = self.renderer.motions(scene);
        self.codec.apply(&mut frame.pixels, &motions);
        Some(truth)
    }

    /// Leaves the compression to an encoder that follows; its quality in H.264's scale (constant rate factor), drawn as
    /// the own compression would have been: its quantiser step is 2^((quality - 4) / 6).
    pub fn without_compression(&mut self) -> u32 {
        self.codec.switch_off()
    }

    /// Manoeuvre of the first target.
    pub fn kind(&self) -> Encounter {
        self.kind
    }

    /// Longest extents of the targets, metres.
    pub fn spans(&self) -> Vec<f64> {
        self.targets.iter().map(|target| target.length).collect()
    }

    /// Focal length in pixels, and radial distortion of the lens.
    pub fn optics(&self) -> (f64, f64) {
        (self.view.focal, -self.view.undistortion)
    }
}

/// A picture of a kind drawn by its share, and the kind of view that it is used as.
fn choose<'a>(
    assets: &'a Assets,
    settings: &RenderSettings,
    random: &mut Random,
) -> (&'a BackgroundPicture, PictureKind) {
    let kinds =
        [PictureKind::Level, PictureKind::Oblique, PictureKind::Nadir, PictureKind::Panorama];
    let of = |kind: PictureKind| assets.pictures.iter().filter(move |p| p.kind == kind);
    let share =
        |i: usize| if of(kinds[i]).next().is_some() { settings.pictures.shares[i] } else { 0.0 };
    let shares: [f64; 4] = core::array::from_fn(share);
    let mut pictures: Vec<&BackgroundPicture> = of(kinds[weighted(random, &shares)]).collect();
    if pictures.is_empty() {
        // Only kinds whose share is 0.
        pictures = assets.pictures.iter().collect();
    }
    let picture = pictures[random.below(pictures.len())];
    let ground =
        picture.kind == PictureKind::Oblique && random.chance(settings.pictures.oblique_as_ground);
    (picture, if ground { PictureKind::Nadir } else { picture.kind })
}

fn target_truth(id: i64, target: &FlyingObject<'_>, time: f64) -> RenderedTarget {
    let place = target.place(time);
    let [azimuth, elevation] = targets::bearing(place);
    let range = dot(place, place).sqrt();
    RenderedTarget { id, azimuth, elevation, range, time_to_contact: target.time_to_contact(time) }
}

impl RenderedFlight<'_> {
    /// One line about the flight, for people: kind of view, texture, speed, height, numbers of objects. Without commas it
    /// fits a column of `flights.csv`.
    pub fn describe(&self) -> std::string::String {
        let [_, _, z] = self.motion.velocity;
        std::format!(
            "{:?} {}x{} forward {z:.1} m/s height {:.0} m movers {} birds {} targets {}",
            self.scene.kind,
            self.scene.width,
            self.scene.height,
            self.motion.height,
            self.movers.len(),
            self.birds.len(),
            self.targets.len()
        )
    }
}
