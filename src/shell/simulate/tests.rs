//! Whole flights: the same bytes everywhere, tight boxes, true bearings, files.

use super::*;
use crate::shell::formats::clips::clips;
use crate::shell::sources;
use std::fs;
use std::path::Path;
use std::string::{String, ToString};

const KINDS: [Kind; 5] = [Kind::Crossing, Kind::Hover, Kind::Collision, Kind::Receding, Kind::None];

fn small(kind: Kind, seed: u64) -> SimulateSettings {
    SimulateSettings { seed, kind, width: 320, height: 240, ..SimulateSettings::default() }
}

fn render(settings: &SimulateSettings, index: u64) -> (Frame, Truth) {
    let mut frame = Frame::default();
    let truth = Simulator::new(settings).render(index, &mut frame);
    (frame, truth)
}

/// Golden: whoever changes the simulator on purpose puts the new numbers here.
#[test]
fn the_bytes_are_the_same_everywhere() {
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
    let found = KINDS.map(|kind| {
        let mut simulator = Simulator::new(&small(kind, 7));
        let mut frame = Frame::default();
        let mut digest = crc.digest();
        for index in 0..3 {
            simulator.render(index, &mut frame);
            digest.update(&frame.pixels);
        }
        digest.finalize()
    });
    assert_eq!(found, GOLDEN, "{found:#x?}");
}

const GOLDEN: [u32; 5] = [0x38aa_de02, 0x5a94_d3da, 0xbfe5_4902, 0x847a_2816, 0xbd96_838d];

#[test]
fn another_seed_is_another_flight() {
    let (first, _) = render(&small(Kind::None, 1), 0);
    let (second, _) = render(&small(Kind::None, 2), 0);
    assert_ne!(first.pixels, second.pixels);
    // Any frame can be rendered alone.
    let mut simulator = Simulator::new(&small(Kind::Hover, 1));
    let mut frame = Frame::default();
    simulator.render(0, &mut frame);
    let truth = simulator.render(9, &mut frame);
    assert_eq!((frame, truth), render(&small(Kind::Hover, 1), 9));
}

/// The flight without the target differs exactly where the target is.
#[test]
fn boxes_are_tight() {
    let mut boxes = 0;
    for kind in [Kind::Crossing, Kind::Hover, Kind::Collision, Kind::Receding] {
        for seed in [0, 2] {
            let index = seed * 60;
            let mut simulator = Simulator::new(&small(kind, seed));
            let (mut with, mut without) = (Frame::default(), Frame::default());
            let truth = simulator.render(index, &mut with);
            simulator.target = None;
            simulator.render(index, &mut without);
            let (mut any, mut strong) = ([i64::MAX, i64::MAX, -1, -1], 0);
            let seen = truth.target.unwrap().seen;
            for (place, (a, b)) in with.pixels.iter().zip(&without.pixels).enumerate() {
                let (x, y) = (place as i64 % 320, place as i64 / 320);
                if a != b {
                    let [left, top, right, bottom] = any;
                    any = [left.min(x), top.min(y), right.max(x + 1), bottom.max(y + 1)];
                }
                // More than a pixel below the limit of opacity can differ.
                if a.abs_diff(*b) > 40 {
                    strong += 1;
                    let seen = seen.expect("what is this plain has a box");
                    let column = seen.left..seen.left + seen.width;
                    let row = seen.top..seen.top + seen.height;
                    assert!(column.contains(&(x as f64)) && row.contains(&(y as f64)));
                }
            }
            let Some(seen) = seen else { continue };
            boxes += u32::from(strong > 0);
            let [left, top, right, bottom] = any.map(|x| x as f64);
            for (inner, outer) in [
                (seen.left, left),
                (seen.top, top),
                (right, seen.left + seen.width),
                (bottom, seen.top + seen.height),
            ] {
                assert!((inner - outer).abs() <= 4.0, "{kind:?} {seed}: {any:?} {seen:?}");
            }
        }
    }
    assert!(boxes >= 5, "only {boxes} targets stand out");
}

#[test]
fn the_frame_edge_cuts_boxes() {
    let mut simulator = Simulator::new(&small(Kind::Hover, 1));
    let mut cut = 0;
    for step in 0..80 {
        let target = simulator.target.as_mut().unwrap();
        target.aim(f64::from(step) * 0.02 - 0.8, 12.0);
        let Some(seen) = simulator.render(0, &mut Frame::default()).target.unwrap().seen else {
            continue;
        };
        assert!(seen.left >= 0.0 && seen.left + seen.width <= 320.0);
        let touches = seen.left == 0.0 || seen.left + seen.width == 320.0;
        assert!(touches || seen.visibility == 1.0);
        cut += u32::from(seen.visibility < 1.0);
    }
    assert!(cut > 2 && cut < 30, "{cut}");
}

/// Bearing and attitude of `truth.csv` lead to the box, by the formula in the data's README.
#[test]
fn truth_leads_to_the_box() {
    for (seed, kind) in (0..).zip([Kind::Crossing, Kind::Hover, Kind::Collision, Kind::Receding]) {
        let (_, truth) = render(&small(kind, seed), 70);
        let target = truth.target.unwrap();
        let (sin, cos) = target.elevation.sin_cos();
        let [x, y, z] = [target.azimuth.sin() * cos, sin, target.azimuth.cos() * cos];
        let (sin, cos) = truth.yaw.sin_cos();
        let [x, z] = [cos * x - sin * z, sin * x + cos * z];
        let (sin, cos) = truth.pitch.sin_cos();
        let [y, z] = [cos * y + sin * z, cos * z - sin * y];
        let (sin, cos) = truth.roll.sin_cos();
        let [x, y] = [cos * x + sin * y, cos * y - sin * x];
        let (column, row) = (160.0 + 280.0 * x / z, 120.0 + 280.0 * y / z);
        let seen = target.seen.unwrap();
        assert!((seen.left..seen.left + seen.width).contains(&column), "{kind:?}");
        assert!((seen.top..seen.top + seen.height).contains(&row), "{kind:?}");
    }
}

fn arguments(out: &Path) -> SimulateArgs {
    let settings =
        SimulateSettings { seconds: 0.1, width: 96, height: 64, ..SimulateSettings::default() };
    SimulateArgs { out: out.into(), settings }
}

#[test]
fn files_have_the_form_of_the_recorded_flights() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a").join("flight");
    let arguments = arguments(&out);
    run(&arguments).unwrap();
    let clip = clips(&folder.path().join("a")).unwrap().remove(0);
    assert_eq!(clip.name, "flight");
    let mut frames = sources::open(clip.input.to_str().unwrap()).unwrap();
    let mut simulator = Simulator::new(&arguments.settings);
    let (mut read, mut expected) = (Frame::default(), Frame::default());
    for index in 0..3 {
        assert!(frames.next_frame(&mut read).unwrap());
        let truth = simulator.render(index, &mut expected);
        assert_eq!(read, expected);
        let seen = truth.target.unwrap().seen;
        assert_eq!(clip.ground_truth.frame(index + 1).first(), seen.as_ref());
    }
    assert!(!frames.next_frame(&mut read).unwrap());
    let table = fs::read_to_string(out.join("truth.csv")).unwrap();
    let columns: Vec<usize> = table.lines().map(|line| line.split(',').count()).collect();
    assert_eq!(columns, [10; 4]);
    let camera = fs::read_to_string(out.join("camera.json")).unwrap();
    let camera: serde_json::Value = serde_json::from_str(&camera).unwrap();
    assert_eq!((camera["fx"].as_f64(), camera["cx"].as_f64()), (Some(84.0), Some(47.5)));
    assert_eq!((camera["kind"].as_str(), camera["height"].as_u64()), (Some("collision"), Some(64)));
    // What is there is not overwritten.
    let error = run(&arguments).unwrap_err().to_string();
    assert!(error.contains("flight: not empty; give a new folder"), "{error}");
}

#[test]
fn flights_without_a_target_have_no_boxes() {
    let folder = tempfile::tempdir().unwrap();
    let mut arguments = arguments(folder.path());
    arguments.settings.kind = Kind::None;
    run(&arguments).unwrap();
    assert_eq!(fs::read_to_string(folder.path().join("gt.txt")).unwrap(), "");
    let table = fs::read_to_string(folder.path().join("truth.csv")).unwrap();
    assert!(table.lines().skip(1).all(|line| line.ends_with(",,,,,")));
}

#[test]
fn an_unwritable_folder_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    let error = run(&arguments(&file.join("out"))).unwrap_err().to_string();
    assert!(error.contains("file/out: cannot be written"), "{error}");
}

#[derive(clap::Parser)]
struct Program {
    #[command(flatten)]
    arguments: SimulateArgs,
}

fn parse(words: &str) -> Result<SimulateArgs, String> {
    let words = core::iter::once("simulate").chain(words.split_whitespace());
    <Program as clap::Parser>::try_parse_from(words)
        .map(|program| program.arguments)
        .map_err(|error| error.to_string())
}

#[test]
fn the_command_line_has_the_defaults_of_the_library() {
    let found = parse("--out flight").unwrap();
    assert_eq!(found.settings, SimulateSettings::default());
    assert_eq!(found.settings.frames(), 150);
    let found = parse("--out f --kind none --seed 9 --seconds 0.5 --fps 10").unwrap();
    assert_eq!((found.settings.kind, found.settings.frames()), (Kind::None, 5));
    for bad in
        ["--seconds abc", "--seconds=-1", "--seconds nan", "--width 0", "--kind up", "--fps 0"]
    {
        let error = parse(&["--out f ", bad].concat()).unwrap_err();
        assert!(error.contains("invalid value"), "{error}");
    }
}

#[test]
fn absurd_settings_are_limited() {
    let settings = SimulateSettings {
        seconds: f64::NAN,
        width: 0,
        height: 1,
        fps: 0,
        ..SimulateSettings::default()
    };
    let (frame, _) = render(&settings, 0);
    assert_eq!((frame.width, frame.height, settings.frames()), (16, 16, 1));
}
