//! Whole flights over pictures that are made here: the same bytes, boxes on the targets, nothing else in the truth.

use super::noise::fractal;
use super::*;
use crate::shell::formats::class::Class;
use crate::shell::support::vectors::{direction, sin_cos};
use std::vec;

/// A picture of fractal noise; a bright smooth sky above `horizon`.
fn picture(width: usize, height: usize, horizon: usize, kind: PictureKind) -> BackgroundPicture {
    let grey = |i: usize| {
        let (x, y) = (i % width, i / width);
        if y < horizon {
            return (200 - y * 30 / horizon.max(1)) as u8;
        }
        (40 + fractal(x as u32, y as u32, 11, 6, 2, 170, 7) / 420) as u8
    };
    BackgroundPicture::new((0..width * height).map(grey).collect(), width, height, Some(kind))
}

/// A dark cross that turns a little from frame to frame.
fn run(class: Class) -> CutoutRun {
    let frame = |step: usize| {
        let pixel = |i: usize| {
            let (x, y) = ((i % 40) as f64 - 19.5, (i / 40) as f64 - 14.5);
            let (s, c) = sin_cos(0.02 * step as f64);
            let (u, v) = ((x * c + y * s).abs(), (y * c - x * s).abs());
            let inside = u < 16.0 && v < 3.0 || u < 3.0 && v < 9.0;
            if inside { [255, 30] } else { [0, 0] }
        };
        Cutout::of(40, 30, (0..40 * 30).map(pixel).collect(), class).unwrap()
    };
    (0..10).map(frame).collect()
}

const CUBE: &str = "v 1 1 1\nv -1 1 1\nv -1 -1 1\nv 1 -1 1\nv 1 1 -1\nv -1 1 -1\nv -1 -1 -1\nv 1 -1 -1\n\
    f 1 2 3 4\nf 8 7 6 5\nf 1 5 6 2\nf 2 6 7 3\nf 3 7 8 4\nf 4 8 5 1\n";

fn assets() -> Assets {
    Assets {
        pictures: vec![
            picture(900, 600, 250, PictureKind::Level),
            picture(800, 600, 0, PictureKind::Oblique),
            picture(700, 700, 0, PictureKind::Nadir),
            picture(1024, 512, 230, PictureKind::Panorama),
        ],
        scenes: ["a", "b", "c", "d"].map(std::path::PathBuf::from).into(),
        targets: vec![vec![run(Class::Drone)], vec![run(Class::Airplane)]],
        birds: vec![run(Class::Bird)],
        solids: vec![solid::Solid::parse(CUBE, Class::Drone).unwrap()],
    }
}

/// Small frames, targets in plain view.
fn settings() -> RenderSettings {
    let mut settings = RenderSettings { size: [320, 240], frames: 12, ..RenderSettings::default() };
    settings.targets.kinds = [0.3, 0.3, 0.2, 0.2, 0.0];
    settings.targets.pixels = [14.0, 50.0];
    settings
}

/// Neither noise nor compression: what differs between two flights is what was drawn.
fn plain() -> RenderSettings {
    let mut settings = settings();
    settings.sensor.noise = [0.001, 0.001];
    settings.sensor.quantiser = [0.5, 0.6];
    settings.sensor.own_craft_probability = 0.0;
    settings.scene.birds_probability = 0.0;
    settings
}

fn frames(mut flight: RenderedFlight<'_>) -> Vec<(Frame, RenderedTruth)> {
    let mut frame = Frame::default();
    core::iter::from_fn(|| flight.next_frame(&mut frame).map(|truth| (frame.clone(), truth)))
        .collect()
}

#[test]
fn the_same_seed_and_index_give_the_same_bytes_and_truth() {
    let (assets, settings) = (assets(), settings());
    for index in 0..4 {
        let first = frames(RenderedFlight::new(&assets, &settings, 5, index));
        assert_eq!(first, frames(RenderedFlight::new(&assets, &settings, 5, index)));
    }
}

#[test]
fn a_flight_has_its_length_and_size_and_depends_on_seed_and_index() {
    let (assets, settings) = (assets(), settings());
    let first = frames(RenderedFlight::new(&assets, &settings, 1, 0));
    assert_eq!(first.len(), 12);
    for (number, (frame, _)) in first.iter().enumerate() {
        assert_eq!((frame.width, frame.height, frame.pixels.len()), (320, 240, 320 * 240));
        assert_eq!(frame.time_us, number as i64 * 1_000_000 / 30);
    }
    for [seed, index] in [[1, 1], [2, 0]] {
        assert_ne!(frames(RenderedFlight::new(&assets, &settings, seed, index))[0].0, first[0].0);
    }
}

/// With and without the targets: pixels differ in the boxes and nowhere else.
#[test]
fn boxes_hold_the_targets_and_nothing_else_changes() {
    let (assets, settings) = (assets(), plain());
    let mut seen = 0;
    for index in 0..24 {
        let with = frames(RenderedFlight::new(&assets, &settings, 3, index));
        let mut flight = RenderedFlight::new(&assets, &settings, 3, index);
        flight.targets.clear();
        for ((frame, truth), (empty, nothing)) in with.iter().zip(frames(flight)) {
            assert!(nothing.boxes.is_empty() && nothing.targets.is_empty());
            let changed = |x: usize, y: usize| {
                frame.pixels[y * 320 + x].abs_diff(empty.pixels[y * 320 + x]) > 3
            };
            let places = || (0..240).flat_map(|y| (0..320).map(move |x| (x, y)));
            for (x, y) in places().filter(|&(x, y)| changed(x, y)) {
                let near = |b: &TruthBox| {
                    // Below the opacity that counts an edge fades out over some pixels of motion blur.
                    let reach = 3.0 + 0.2 * b.width.max(b.height);
                    (b.left - reach..b.left + b.width + reach).contains(&(x as f64))
                        && (b.top - reach..b.top + b.height + reach).contains(&(y as f64))
                };
                // An object of which only the faint edge is in the frame has no box.
                let edge = x < 3 || y < 3 || x > 316 || y > 236;
                assert!(edge || truth.boxes.iter().any(near), "{index}: {x} {y} {:?}", truth.boxes);
            }
            for b in truth.boxes.iter().filter(|b| b.visibility == 1.0) {
                let inside = |&(x, y): &(usize, usize)| {
                    (b.left..b.left + b.width).contains(&(x as f64))
                        && (b.top..b.top + b.height).contains(&(y as f64))
                };
                assert!(places().filter(inside).any(|(x, y)| changed(x, y)), "{index}: {b:?}");
                seen += 1;
            }
        }
    }
    assert!(seen > 60, "{seen}");
}

#[test]
fn movers_glints_and_craft_are_never_in_the_truth() {
    let assets = assets();
    let mut busy = plain();
    busy.scene.movers_probability = 1.0;
    busy.scene.movers = [8, 12];
    busy.scene.glints_probability = 1.0;
    busy.sensor.own_craft_probability = 1.0;
    let (mut differences, mut movers) = (0, 0);
    for index in 0..6 {
        let mut flight = RenderedFlight::new(&assets, &busy, 9, index);
        // Fewer than asked for where the camera sees hardly any ground.
        movers += flight.movers.len();
        flight.movers.clear();
        flight.glints = Glints::default();
        flight.craft = OwnCraft::default();
        let still = frames(flight);
        for ((frame, truth), (other, same)) in
            frames(RenderedFlight::new(&assets, &busy, 9, index)).iter().zip(&still)
        {
            assert_eq!(truth.targets, same.targets);
            let places = |truth: &RenderedTruth| {
                truth
                    .boxes
                    .iter()
                    .map(|b| (b.id, b.left, b.top, b.width, b.height, b.class))
                    .collect::<Vec<_>>()
            };
            assert_eq!(places(truth), places(same));
            differences += usize::from(frame != other);
        }
    }
    assert!(movers > 15, "{movers}");
    assert!(differences > 60, "{differences}");
}

#[test]
fn empty_flights_have_birds_at_most() {
    let assets = assets();
    let mut empty = settings();
    empty.targets.kinds = [0.0, 0.0, 0.0, 0.0, 1.0];
    empty.targets.more_probability = 1.0;
    empty.scene.birds_probability = 0.5;
    let mut birds = 0;
    for index in 0..12 {
        for (_, truth) in frames(RenderedFlight::new(&assets, &empty, 2, index)) {
            assert!(truth.targets.is_empty());
            assert!(truth.boxes.iter().all(|b| b.class == Class::Bird), "{:?}", truth.boxes);
            birds += truth.boxes.len();
        }
    }
    assert!(birds > 0);
}

#[test]
fn a_collision_keeps_its_bearing_and_its_box_is_where_its_bearing_is() {
    let assets = assets();
    let mut settings = plain();
    settings.targets.kinds = [0.0, 0.0, 1.0, 0.0, 0.0];
    settings.targets.more_probability = 0.0;
    settings.frames = 60;
    let mut boxes = 0;
    for index in 0..8 {
        let flight = RenderedFlight::new(&assets, &settings, 4, index);
        let (motion, view) = (flight.motion.clone(), flight.view);
        let shown = frames(flight);
        let first = shown[0].1.targets[0];
        for (number, (_, truth)) in shown.iter().enumerate() {
            let target = truth.targets[0];
            assert!((target.azimuth - first.azimuth).abs() < 0.01, "{index}: {target:?} {first:?}");
            assert!((target.elevation - first.elevation).abs() < 0.01);
            let contact = target.time_to_contact.unwrap();
            let left = first.time_to_contact.unwrap() - number as f64 / 30.0;
            assert!((contact / left - 1.0).abs() < 0.1, "{index}: {contact} {left}");
            let time = number as f64 / 30.0;
            let ray = direction(target.azimuth, target.elevation);
            let Some([x, y]) = view.project(&motion, time, |_| ray) else { continue };
            for b in truth.boxes.iter().filter(|b| b.id == 1 && b.visibility == 1.0) {
                let slack = 2.0 + 0.3 * b.width.max(b.height);
                assert!((b.left + b.width / 2.0 - x).abs() < slack, "{index}: {x} {b:?}");
                assert!((b.top + b.height / 2.0 - y).abs() < slack, "{index}: {y} {b:?}");
                boxes += 1;
            }
        }
    }
    assert!(boxes > 100, "{boxes}");
}

/// The block motions that the codec predicts by carry the background of one frame to the next.
#[test]
fn block_motions_follow_the_background() {
    let assets = assets();
    let mut settings = plain();
    settings.scene.movers_probability = 0.0;
    settings.scene.glints_probability = 0.0;
    settings.scene.birds_probability = 0.0;
    settings.scene.shimmer = [0.0, 0.0];
    settings.scene.structure = [0.0, 0.0];
    settings.targets.kinds = [0.0, 0.0, 0.0, 0.0, 1.0];
    settings.motion.agitation = [1.5, 1.5001];
    let (mut moved, mut still) = (0u64, 0u64);
    for index in 0..8 {
        let mut flight = RenderedFlight::new(&assets, &settings, 6, index);
        let (mut before, mut frame) = (Frame::default(), Frame::default());
        flight.next_frame(&mut before).unwrap();
        while flight.next_frame(&mut frame).is_some() {
            let motions = flight.renderer.motions(&flight.scene);
            for (number, [dx, dy]) in motions.iter().enumerate() {
                let (left, top) = ((number % 20 * 16) as i32, (number / 20 * 16) as i32);
                for i in 0..256 {
                    let (x, y) = (left + i % 16, top + i / 16);
                    let (u, v) = (x + (dx + 2).div_euclid(4), y + (dy + 2).div_euclid(4));
                    if (0..320).contains(&u) && (0..240).contains(&v) {
                        let here = frame.pixels[(y * 320 + x) as usize];
                        moved += u64::from(here.abs_diff(before.pixels[(v * 320 + u) as usize]));
                        still += u64::from(here.abs_diff(before.pixels[(y * 320 + x) as usize]));
                    }
                }
            }
            core::mem::swap(&mut before, &mut frame);
        }
    }
    assert!(moved * 10 < still * 8, "{moved} {still}");
}
