//! Score calibration: measured for an existing model, and used.
#![cfg(feature = "std")]

mod common;

use lookout::model::{Model, Section};
use std::fs;
use std::process::{Command, Output};
use tempfile::TempDir;

fn lookout(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_lookout"))
        .args(args)
        .env_remove("LOOKOUT_LOG")
        .output()
        .unwrap()
}

fn succeeded(args: &[&str]) -> String {
    let output = lookout(args);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// The one line of a failed run.
fn complaint(args: &[&str]) -> String {
    let output = lookout(args);
    let text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert_eq!(text.lines().count(), 1, "{text}");
    text
}

fn path(folder: &TempDir, name: &str) -> String {
    folder.path().join(name).to_str().unwrap().to_owned()
}

/// Two short flights.
fn flights(folder: &TempDir) -> String {
    for seed in ["1", "2"] {
        let out = path(folder, &format!("flights/{seed}"));
        let size = ["--width", "160", "--height", "120", "--seconds", "0.7"];
        let args = ["simulate", "--out", &out, "--seed", seed, "--kind", "crossing"];
        succeeded(&[&args[..], &size].concat());
    }
    path(folder, "flights")
}

/// Scores in a file of detections.
fn scores(file: &str) -> Vec<f64> {
    let text = fs::read_to_string(file).unwrap();
    text.lines().map(|line| line.rsplit(',').next().unwrap().parse().unwrap()).collect()
}

#[test]
fn measured_for_a_model_and_used() {
    let folder = tempfile::tempdir().unwrap();
    let data = flights(&folder);
    let mut sections = common::sections();
    sections[Section::Calibration as usize].clear();
    let (bare, out) = (path(&folder, "bare.lkm"), path(&folder, "out.lkm"));
    fs::write(&bare, common::assemble(&sections)).unwrap();
    let train = ["train", &data, "--calibrate", &bare, "--out", &out];
    succeeded(&[&train[..], &["--hold-back", "1"]].concat());
    let bytes = fs::read(&out).unwrap();
    let model = Model::parse(&bytes).unwrap();
    for section in Section::ALL.into_iter().filter(|&s| s != Section::Calibration) {
        assert_eq!(model.section(section), sections[section as usize], "{section:?}");
    }

    // The lowest knot stands for all detections: the precision that `eval` sees.
    let found = path(&folder, "found");
    succeeded(&["eval", &data, "--model", &out, "--out", &found]);
    let scored = |clip: &str| scores(&format!("{found}/{clip}.txt"));
    let all = [scored("1"), scored("2")].concat();
    let knots: Vec<_> = model.calibration().knots().collect();
    let score = |k: &lookout::model::calibration::Knot| f64::from(k.score) / 65536.0;
    assert!(!knots.is_empty());
    assert!(knots.iter().all(|k| all.iter().any(|s| (s - score(k)).abs() < 1e-5)), "{knots:?}");

    let (best, few) = (knots[knots.len() - 1], path(&folder, "few.txt"));
    let wanted = format!("{}", f64::from(best.precision) / 65536.0);
    if best.precision > 0 {
        let pictures = format!("{data}/1");
        let input = fs::read_dir(&pictures).unwrap().map(|e| e.unwrap().path());
        let input = input.filter(|p| p.is_dir()).map(|p| p.display().to_string()).next();
        let input = input.unwrap_or(pictures);
        let args = ["replay", &input, "--model", &out, "--detections", &few];
        succeeded(&[&args[..], &["--min-precision", &wanted]].concat());
        assert!(scores(&few).iter().all(|&s| s > score(&best) - 1e-5));
    }

    // None is held back: no table, and no precision to be had.
    succeeded(&[&train[..], &["--hold-back", "0"]].concat());
    assert_eq!(fs::read(&out).unwrap(), fs::read(&bare).unwrap());
    for verb in [&["replay"][..], &["eval", &data], &["bench", "--frames", "1"]] {
        let text = complaint(&[verb, &["--model", &bare, "--min-precision", "0.9"]].concat());
        assert!(text.contains("no table of precisions; give --threshold"), "{text}");
    }
    let knot = lookout::model::calibration::Knot { score: 0, precision: 1 << 15 };
    sections[Section::Calibration as usize] = knot.encode().to_vec();
    fs::write(&bare, common::assemble(&sections)).unwrap();
    let text = complaint(&["replay", "--model", &bare, "--min-precision", "0.9"]);
    assert!(text.contains("no score of this model reached more than 0.500"), "{text}");
    let both = lookout(&["replay", "--min-precision", "0.9", "--threshold", "1"]);
    assert_eq!(both.status.code(), Some(2));
}
