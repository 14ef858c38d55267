//! `lookout train` as its users meet it: few clips, footage without targets, a model that is adapted, a run that was ended.
#![cfg(feature = "std")]

use lookout::model::{Model, Section};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Settings with which a training takes seconds.
const SMALL: [&str; 9] = [
    "--samples=24",
    "--mining=1",
    "--scan-trees=16",
    "--regressor-trees=4",
    "--cube-trees=10",
    "--features=60",
    "--candidates=12",
    "--scan-keep=1",
    "--plain",
];

fn command(folder: &TempDir, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lookout"));
    command.args(args).current_dir(folder.path()).env_remove("LOOKOUT_LOG");
    command
}

/// Standard error of a run that must succeed.
fn train(folder: &TempDir, args: &[&str]) -> String {
    let output = run(folder, args);
    let text = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{args:?}: {text}");
    assert!(!text.contains("NaN"), "{text}");
    text
}

fn run(folder: &TempDir, args: &[&str]) -> Output {
    command(folder, &[&["train"], args, &SMALL].concat()).output().unwrap()
}

/// The last line of a failed run.
fn complaint(folder: &TempDir, args: &[&str]) -> String {
    let output = run(folder, args);
    assert_eq!(output.status.code(), Some(1), "{args:?}");
    let text = String::from_utf8(output.stderr).unwrap();
    assert!(!text.contains("panicked"), "{text}");
    text.lines().last().unwrap().to_owned()
}

fn simulate(folder: &TempDir, clip: &str, kind: &str, seed: &str) {
    let size = ["--width", "256", "--height", "192", "--fps", "10", "--seconds", "2.4"];
    let which = ["simulate", "--out", clip, "--kind", kind, "--seed", seed];
    let output = command(folder, &[&which[..], &size].concat()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Two flights with a target.
fn flights(folder: &TempDir) {
    for seed in ["1", "2"] {
        simulate(folder, &format!("data/{seed}"), "crossing", seed);
    }
}

/// A clip of a dark bar before a bright sky, which can be cut out.
fn bar(folder: &TempDir, clip: &str) {
    let frames = folder.path().join(clip).join("frames");
    fs::create_dir_all(&frames).unwrap();
    let mut boxes = String::new();
    for frame in 0..24 {
        let (left, top, width, height) = (40 + 3 * frame, 60, 24, 9);
        let bar = |x, y| (left..left + width).contains(&x) && (top..top + height).contains(&y);
        let grey = |x, y| if bar(x, y) { 50 } else { 190 };
        let picture = image::GrayImage::from_fn(256, 192, |x, y| image::Luma([grey(x, y)]));
        picture.save(frames.join(format!("{frame:03}.png"))).unwrap();
        boxes += &format!("{},1,{left},{top},{width},{height},1,2,1\n", frame + 1);
    }
    fs::write(folder.path().join(clip).join("gt.txt"), boxes).unwrap();
}

/// Footage without a target, of a camera that turns: no ground truth, no attitude.
fn empty(folder: &TempDir, clip: &str) {
    simulate(folder, clip, "crossing", "9");
    for name in ["gt.txt", "truth.csv", "camera.json", "flight.tlog"] {
        fs::remove_file(folder.path().join(clip).join(name)).unwrap();
    }
}

fn read(folder: &TempDir, name: &str) -> Vec<u8> {
    fs::read(folder.path().join(name)).unwrap()
}

#[test]
fn two_clips_are_enough_and_one_is_said_to_be_too_few() {
    let folder = tempfile::tempdir().unwrap();
    flights(&folder);
    let said = train(&folder, &["data", "--out=m.lkm"]);
    assert!(said.contains("the last clip of the largest folder is held back"), "{said}");
    assert!(said.contains(" on held-back clips"), "{said}");
    assert!(said.contains("stage 2 of 4: the regressors that follow an object"), "{said}");
    assert!(
        said.lines().any(|line| line.contains("stage 4 of 4") && line.contains(" left")),
        "{said}"
    );
    let bytes = read(&folder, "m.lkm");
    let model = Model::parse(&bytes).unwrap();
    let settings: Value = serde_json::from_str(model.provenance()).unwrap();
    assert_eq!(settings["hold_back"], 2);
    assert!(model.calibration().knots().next().is_some(), "the second clip is measured");

    // A training writes the model and its log; no text of the user's is written or changed.
    let names = |folder: &Path| {
        let mut names: Vec<String> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    };
    assert_eq!(names(folder.path()), ["data", "m.jsonl", "m.lkm"]);

    // The same training is skipped without `--again`, and with it gives the same model.
    let again = train(&folder, &["data", "--out=m.lkm"]);
    assert!(
        again.contains("m.lkm: trained with these settings already; --again trains"),
        "{again}"
    );
    assert_eq!(again.lines().count(), 1, "{again}");
    let readme = folder.path().join("README.md");
    fs::write(&readme, "Mine.\n").unwrap();
    train(&folder, &["data", "--out=m.lkm", "--again"]);
    assert_eq!(read(&folder, "m.lkm"), bytes);
    assert_eq!(fs::read_to_string(&readme).unwrap(), "Mine.\n");

    let said = train(&folder, &["data/1", "--out=one.lkm", "--card=one.md"]);
    assert!(said.contains("a single clip: none can be held back"), "{said}");
    assert!(!said.contains("held-back clips"), "{said}");
    let card = fs::read_to_string(folder.path().join("one.md")).unwrap();
    assert!(card.starts_with("# one.lkm\n") && card.contains("not measured"), "{card}");
}

#[test]
fn a_card_that_is_no_text_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    bar(&folder, "data/bar");
    fs::write(folder.path().join("card.md"), [0xff, 0xfe, 0x00]).unwrap();
    let error = complaint(&folder, &["data", "--out=m.lkm", "--card=card.md", "--no-stcube"]);
    assert!(error.contains("card.md: cannot be read as a model card"), "{error}");
    assert_eq!(read(&folder, "card.md"), [0xff, 0xfe, 0x00]);
    assert!(folder.path().join("m.lkm").is_file(), "the model itself is there");
}

#[test]
fn what_cannot_be_learned_from_is_refused_with_advice() {
    let folder = tempfile::tempdir().unwrap();
    bar(&folder, "data/bar");
    empty(&folder, "mine/flight");
    // Nothing but the bar before a plain sky: no window looks like it.
    let error = complaint(&folder, &["data", "--out=m.lkm", "--hold-back=0"]);
    assert!(error.contains("--empty DIR") && error.contains("--no-stcube"), "{error}");
    let error = complaint(&folder, &["mine/flight", "--out=m.lkm"]);
    assert!(error.contains("no clip in it"), "{error}");
    for from in [None, Some("--from=m.lkm")] {
        let args = ["--empty=mine", "--out=n.lkm"];
        let error = complaint(&folder, &[&args[..], from.as_slice()].concat());
        assert!(error.contains("--empty alone") && error.contains("as DATA"), "{error}");
        assert_eq!(error.contains("would forget"), from.is_some(), "{error}");
    }
    let error = complaint(&folder, &["data", "--empty=data", "--out=m.lkm"]);
    assert!(error.contains("24 boxes in gt.txt; --empty takes footage without targets"), "{error}");
    let error = complaint(&folder, &["data", "--render=2", "--out=m.lkm"]);
    assert!(error.contains("--backgrounds DIR"), "{error}");
}

#[test]
fn a_model_is_adapted_to_footage_without_targets() {
    let folder = tempfile::tempdir().unwrap();
    flights(&folder);
    bar(&folder, "data/bar");
    train(&folder, &["data", "--out=m.lkm"]);
    empty(&folder, "mine/flight");
    let from = ["data", "--empty=mine", "--from=m.lkm", "--out=mine.lkm"];
    let said = train(&folder, &from);
    assert!(said.contains("stage 1 of 1: more trees for the classifier of the model"), "{said}");
    let (old, new) = (read(&folder, "m.lkm"), read(&folder, "mine.lkm"));
    let (old, new) = (Model::parse(&old).unwrap(), Model::parse(&new).unwrap());
    for section in Section::ALL {
        use Section::{Calibration, Cube, CubeFeatures, Provenance};
        let changes = [Provenance, CubeFeatures, Cube, Calibration].contains(&section);
        assert!(changes || old.section(section) == new.section(section), "{section:?}");
    }
    // The trees that were there stay as they were, in front; so do the features.
    let (before, after) = (old.section(Section::CubeFeatures), new.section(Section::CubeFeatures));
    assert!(after.starts_with(before));
    let trees: Vec<Vec<i16>> = new.cube().trees().map(|tree| tree.leaves().collect()).collect();
    let first: Vec<Vec<i16>> = old.cube().trees().map(|tree| tree.leaves().collect()).collect();
    assert!(trees.starts_with(&first), "{} {}", trees.len(), first.len());
}

#[test]
fn footage_without_targets_is_pasted_into() {
    let folder = tempfile::tempdir().unwrap();
    flights(&folder);
    bar(&folder, "data/bar");
    empty(&folder, "mine/flight");
    train(&folder, &["data", "--empty=mine", "--hold-back=0", "--out=m.lkm", "--card=m.md"]);
    let card = fs::read_to_string(folder.path().join("m.md")).unwrap();
    assert!(card.contains("frames of 4 clips (1 without targets, 1 shown again with"), "{card}");
}

#[cfg(unix)]
#[test]
fn a_run_that_was_killed_in_its_first_stage_goes_on_and_gives_the_same() {
    let folder = tempfile::tempdir().unwrap();
    flights(&folder);
    let args = ["train", "data", "--out=m.lkm"];
    let log = fs::File::create(folder.path().join("said")).unwrap();
    let mut child =
        command(&folder, &[&args[..], &SMALL].concat()).stderr(Stdio::from(log)).spawn().unwrap();
    // As soon as the windows of the second round are there.
    let second = folder.path().join("m.windows-1");
    let started = Instant::now();
    while !second.is_file() {
        assert!(child.try_wait().unwrap().is_none(), "ended before it was killed");
        assert!(started.elapsed() < Duration::from_secs(240));
        std::thread::sleep(Duration::from_millis(1));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(!folder.path().join("m.lkm").exists());
    let said = train(&folder, &["data", "--out=m.lkm"]);
    assert!(said.contains("round 2 of 2") && !said.contains("round 1 of 2"), "{said}");
    assert!(!second.exists(), "nothing is left over");
    let resumed = read(&folder, "m.lkm");
    train(&folder, &["data", "--out=m.lkm", "--again"]);
    assert_eq!(read(&folder, "m.lkm"), resumed);
}
