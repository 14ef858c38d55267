//! The competitors: trained and compared by the built program, on simulated flights.
#![cfg(feature = "std")]

use lookout::model::Model;
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;

/// The methods that are trained beside ours.
const TRAINED: [&str; 7] = ["paper", "stcube", "stcube-flow", "park", "acf", "forest", "hog3d"];

fn lookout(folder: &TempDir, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_lookout"))
        .args(args)
        .current_dir(folder.path())
        .env_remove("LOOKOUT_LOG")
        .output()
        .unwrap()
}

fn succeeded(folder: &TempDir, args: &[&str]) -> String {
    let output = lookout(folder, args);
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// The last line of a failed run.
fn complaint(folder: &TempDir, args: &[&str]) -> String {
    let output = lookout(folder, args);
    assert_eq!(output.status.code(), Some(1), "{args:?}");
    let text = String::from_utf8(output.stderr).unwrap();
    assert!(!text.contains("panicked"), "{text}");
    text.lines().last().unwrap().to_owned()
}

/// A split of two short flights.
fn split(folder: &TempDir) {
    for seed in ["1", "2"] {
        let clip = format!("data/flight{seed}");
        let size = ["--width", "256", "--height", "192", "--fps", "10", "--seconds", "2.4"];
        let which = ["simulate", "--out", &clip, "--kind", "crossing", "--seed", seed];
        succeeded(folder, &[&which[..], &size].concat());
    }
}

/// Trains so little that nothing is learned well.
fn train(folder: &TempDir, method: &str) {
    let out = format!("methods/{method}.lkm");
    let settings = [
        "--samples=16",
        "--hold-back=0",
        "--plain",
        "--mining=1",
        "--scan-trees=16",
        "--regressor-trees=6",
        "--cube-trees=20",
        "--features=80",
    ];
    let which = ["train", "data", "--method", method, "--out", &out];
    succeeded(folder, &[&which[..], &settings].concat());
}

#[test]
fn every_method_is_trained_and_stands_in_the_report() {
    let folder = tempfile::tempdir().unwrap();
    split(&folder);
    fs::create_dir(folder.path().join("methods")).unwrap();
    TRAINED.iter().for_each(|method| train(&folder, method));

    let methods = format!("{},difference", TRAINED.join(","));
    let printed = succeeded(
        &folder,
        &["eval", "data", "--method", &methods, "--report", "report", "--out", "out", "--json"],
    );
    let lines: Vec<Value> = printed.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    let names: Vec<&str> = lines.iter().map(|line| line["method"].as_str().unwrap()).collect();
    let mut expected = TRAINED.to_vec();
    expected.extend(["difference", "ours"]);
    assert_eq!(names, expected);
    // Only methods with a scan report it.
    assert!(lines.iter().all(|line| line["scan"].is_null() == (line["method"] == "difference")));

    let json = fs::read(folder.path().join("report/report.json")).unwrap();
    let json: Value = serde_json::from_slice(&json).unwrap();
    let reported = json["methods"].as_array().unwrap();
    assert_eq!(reported.len(), expected.len());
    for line in &lines {
        let name = &line["method"];
        let report = reported.iter().find(|r| r["name"] == *name).unwrap();
        assert!(report["median_ms_per_frame"].as_f64().unwrap() > 0.0, "{report}");
        // The detections written are those scored.
        let out = match name.as_str().unwrap() {
            "ours" => "out".to_owned(),
            other => format!("out/{other}"),
        };
        let score = succeeded(&folder, &["score", "data", &out, "--json"]);
        let score: Value = serde_json::from_str(&score).unwrap();
        assert_eq!(score["reports"], line["reports"], "{name}");
    }

    // A model's own parts are run by every verb.
    let acf =
        ["replay", "data/flight1", "--model", "methods/acf.lkm", "--threshold=-32768", "--digest"];
    let digest = succeeded(&folder, &acf);
    for part in
        ["--no-stcube", "--no-persistence", "--no-temporal", "--no-registration", "--no-fit"]
    {
        assert_eq!(succeeded(&folder, &[&acf[..], &[part]].concat()), digest, "{part}");
    }

    fs::copy(folder.path().join("methods/acf.lkm"), folder.path().join("methods/park.lkm"))
        .unwrap();
    let mixed = complaint(&folder, &["eval", "data", "--method", "park"]);
    assert!(mixed.contains("park.lkm: a model of the method acf; make it with"), "{mixed}");
}

/// A clip of a dark bar that crosses a bright sky, nothing being known of its camera.
fn bar(folder: &TempDir) {
    let frames = folder.path().join("data/bar/frames");
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
    fs::write(folder.path().join("data/bar/gt.txt"), boxes).unwrap();
}

#[test]
fn objects_are_pasted_where_the_attitude_is_known() {
    let folder = tempfile::tempdir().unwrap();
    split(&folder);
    let settings = ["--scan-trees=8", "--regressor-trees=4", "--cube-trees=8", "--features=60"];
    let which = ["train", "data", "--samples=16", "--mining=1", "--hold-back=0", "--out", "x.lkm"];
    let train = [&which[..], &settings, &["--paste=1", "--card=README.md"]].concat();
    let error = complaint(&folder, &train);
    assert!(error.contains("--paste: needs clips to paste into (with truth.csv"), "{error}");
    bar(&folder);
    succeeded(&folder, &train);
    let model = fs::read(folder.path().join("x.lkm")).unwrap();
    assert!(Model::parse(&model).unwrap().fit().is_some(), "ours fits boxes");
    let card = fs::read_to_string(folder.path().join("README.md")).unwrap();
    assert!(card.contains("frames of 3 clips (2 shown again with objects of others"), "{card}");
}

/// The simulator's aircraft are of shapes that the shipped model was not trained on.
#[test]
fn fitted_boxes_of_unseen_shapes_are_better() {
    let folder = tempfile::tempdir().unwrap();
    for (kind, seed) in [("collision", "1"), ("collision", "2"), ("crossing", "1")] {
        let clip = format!("data/{kind}{seed}");
        let which = ["simulate", "--out", &clip, "--kind", kind, "--seed", seed, "--seconds", "2"];
        succeeded(&folder, &which);
    }
    let average_precision = |switch: &[&str]| {
        let printed = succeeded(&folder, &[&["eval", "data", "--json"], switch].concat());
        let scores: Value = serde_json::from_str(&printed).unwrap();
        let at_half = &scores["reports"][0];
        assert_eq!(at_half["iou"], 0.5);
        at_half["AveP"].as_f64().unwrap()
    };
    let (fitted, without) = (average_precision(&[]), average_precision(&["--no-fit"]));
    assert!(fitted > without + 0.03, "{fitted} with fitted boxes, {without} without");
}

#[test]
fn what_is_missing_is_named() {
    let folder = tempfile::tempdir().unwrap();
    split(&folder);
    let missing = complaint(&folder, &["eval", "data", "--method", "acf", "--models", "models"]);
    let command = "make it with `lookout train DATA... --method acf --out models/acf.lkm`";
    assert!(missing.contains(command), "{missing}");
    let nothing =
        complaint(&folder, &["train", "data", "--method", "difference", "--out", "x.lkm"]);
    assert!(nothing.contains("`lookout eval DATA_SPLIT --method difference`"), "{nothing}");
    assert!(!Path::new(&folder.path().join("x.jsonl")).exists());
    let alone = succeeded(&folder, &["eval", "data", "--method", "difference"]);
    assert!(
        alone.starts_with("Method difference, data") && !alone.contains("windows scanned"),
        "{alone}"
    );
}
