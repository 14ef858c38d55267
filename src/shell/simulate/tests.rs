//! Whole flights: the same bytes everywhere, tight boxes, true bearings, files.

use super::*;
use crate::shell::formats::clips::clips;
use crate::shell::sources;
use std::fs;
use std::path::Path;
use std::string::{String, ToString};

const KINDS: [Manoeuvre; 5] = [
    Manoeuvre::Crossing,
    Manoeuvre::Hover,
    Manoeuvre::Collision,
    Manoeuvre::Receding,
    Manoeuvre::None,
];

fn small(kind: Manoeuvre, seed: u64) -> SimulateSettings {
    SimulateSettings { seed, kind, width: 320, height: 240, ..SimulateSettings::default() }
}

fn render(settings: &SimulateSettings, index: u64) -> (Frame, SimulatedTruth) {
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
    let (first, _) = render(&small(Manoeuvre::None, 1), 0);
    let (second, _) = render(&small(Manoeuvre::None, 2), 0);
    assert_ne!(first.pixels, second.pixels);
    // Any frame can be rendered alone.
    let mut simulator = Simulator::new(&small(Manoeuvre::Hover, 1));
    let mut frame = Frame::default();
    simulator.render(0, &mut frame);
    let truth = simulator.render(9, &mut frame);
    assert_eq!((frame, truth), render(&small(Manoeuvre::Hover, 1), 9));
}

/// The flight without the target differs exactly where the target is.
#[test]
fn boxes_are_tight() {
    let mut boxes = 0;
    for kind in [Manoeuvre::Crossing, Manoeuvre::Hover, Manoeuvre::Collision, Manoeuvre::Receding] {
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
    let mut simulator = Simulator::new(&small(Manoeuvre::Hover, 1));
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
    for (seed, kind) in (0..).zip([
        Manoeuvre::Crossing,
        Manoeuvre::Hover,
        Manoeuvre::Collision,
        Manoeuvre::Receding,
    ]) {
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
    SimulateArgs { out: out.into(), settings, render: RenderedFlightArgs::default() }
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
    arguments.settings.kind = Manoeuvre::None;
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
    assert_eq!((found.settings.kind, found.settings.frames()), (Manoeuvre::None, 5));
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

/// A folder of one grey picture with a smooth sky.
fn backgrounds() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let grey = |x: u32, y: u32| {
        if y < 200 { 220 } else { (60 + (x * 7 + y * 13) % 97 + (x / 16 + y / 16) % 5 * 12) as u8 }
    };
    let picture = image::GrayImage::from_fn(640, 480, |x, y| image::Luma([grey(x, y)]));
    picture.save(folder.path().join("field.png")).unwrap();
    folder
}

/// Flights before pictures are a split that the evaluation reads, the same bytes each time.
#[test]
fn rendered_flights_are_clips() {
    let (backgrounds, out) = (backgrounds(), tempfile::tempdir().unwrap());
    let shapes = tempfile::tempdir().unwrap();
    let wing = "v 1 0 0\nv -1 1 0\nv -1 -1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";
    fs::write(shapes.path().join("wing.obj"), wing).unwrap();
    let write = |name: &str, empty: bool| {
        let settings = SimulateSettings { seconds: 0.2, ..small(Manoeuvre::Collision, 3) };
        let render = RenderedFlightArgs {
            backgrounds: Some(backgrounds.path().into()),
            shapes: Some(shapes.path().into()),
            flights: 3,
            empty,
            png: true,
            sheet: Some(out.path().join(name.to_string() + ".png")),
            ..RenderedFlightArgs::default()
        };
        run(&SimulateArgs { out: out.path().join(name), settings, render }).unwrap();
        clips(&out.path().join(name)).unwrap()
    };
    let (first, second, empty) = (write("a", false), write("b", false), write("c", true));
    assert_eq!(first.len(), 3);
    let mut boxes = 0;
    for (clip, again) in first.iter().zip(&second) {
        for file in ["gt.txt", "truth.csv", "camera.json", "frames/000006.png"] {
            let bytes = |clip: &crate::shell::formats::clips::Clip| {
                fs::read(clip.directory.join(file)).unwrap()
            };
            assert_eq!(bytes(clip), bytes(again), "{file}");
        }
        let mut source = sources::open(&clip.input).unwrap();
        let mut frame = Frame::default();
        let mut frames = 0;
        while source.next_frame(&mut frame).unwrap() {
            frames += 1;
        }
        assert_eq!((frames, frame.width, frame.height), (6, 320, 240));
        let truth = crate::shell::formats::truth::read(&clip.directory.join("truth.csv")).unwrap();
        assert_eq!(truth.len(), 6);
        boxes += clip.ground_truth.boxes().count();
    }
    assert!(boxes > 5, "{boxes}");
    assert!(empty.iter().all(|clip| clip.ground_truth.last_frame() == 0));
    let sheet = image::open(out.path().join("a.png")).unwrap();
    assert_eq!((sheet.width(), sheet.height()), (5 * 160, 3 * 120));
    let list = fs::read_to_string(out.path().join("a/flights.csv")).unwrap();
    assert_eq!(list.lines().count(), 4, "{list}");
}

#[test]
fn mistakes_of_rendered_flights_are_named() {
    let (backgrounds, out) = (backgrounds(), tempfile::tempdir().unwrap());
    let attempt = |change: &dyn Fn(&mut SimulateArgs)| {
        let settings = SimulateSettings { seconds: 0.1, ..small(Manoeuvre::Collision, 3) };
        let render = RenderedFlightArgs {
            backgrounds: Some(backgrounds.path().into()),
            flights: 1,
            png: true,
            ..RenderedFlightArgs::default()
        };
        let folder = tempfile::tempdir_in(&out).unwrap();
        let mut args = SimulateArgs { out: folder.path().into(), settings, render };
        change(&mut args);
        run(&args).unwrap_err().to_string()
    };
    let settings = out.path().join("ranges.toml");
    fs::write(&settings, "[motion]\nspeed = [3.0, 1.0]\n").unwrap();
    let error = attempt(&|args| args.render.settings_file = Some(settings.clone()));
    assert!(error.contains("ranges.toml: 'motion.speed' is [3, 1]"), "{error}");
    let error = attempt(&|args| args.render.backgrounds = Some(out.path().join("nothing")));
    assert!(error.contains("nothing: cannot be read"), "{error}");
    let shapes = tempfile::tempdir().unwrap();
    fs::write(shapes.path().join("bad.obj"), "v 1 0 0\nf 1 2 9\n").unwrap();
    let error = attempt(&|args| args.render.shapes = Some(shapes.path().into()));
    assert!(error.contains("bad.obj: line 2: '2'"), "{error}");
    let error = attempt(&|args| args.settings.width = 330);
    assert!(error.contains("multiples of 16"), "{error}");
}
