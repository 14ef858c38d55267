//! Training in two steps on many machines: `lookout mine --shard`, `lookout fit`; scans from LightGBM.
#![cfg(feature = "std")]

use lookout::model::Model;
use std::fs;
use std::process::{Command, Output};
use tempfile::TempDir;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// Settings with which a training takes seconds.
const SMALL: [&str; 10] = [
    "data",
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

fn run(folder: &TempDir, verb: &str, args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lookout"));
    command.arg(verb).args(SMALL).args(args).current_dir(folder.path()).env_remove("LOOKOUT_LOG");
    command.output().unwrap()
}

/// Standard error of a run that must succeed.
fn said(folder: &TempDir, verb: &str, args: &[&str]) -> String {
    let output = run(folder, verb, args);
    let text = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{verb} {args:?}: {text}");
    text
}

/// The last line of a run that ends with this status.
fn complaint(folder: &TempDir, verb: &str, args: &[&str], status: i32) -> String {
    let output = run(folder, verb, args);
    let text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(status), "{verb} {args:?}: {text}");
    text
}

/// Three flights with a target.
fn flights() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for seed in ["1", "2", "3"] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_lookout"));
        command.args(["simulate", "--kind=crossing", "--width=256", "--height=192", "--fps=10"]);
        command.args(["--seconds=2.4", "--seed", seed, "--out", &format!("data/{seed}")]);
        assert!(command.current_dir(folder.path()).status().unwrap().success());
    }
    folder
}

fn names(folder: &TempDir) -> Vec<String> {
    let entries = fs::read_dir(folder.path()).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn shards_give_the_model_of_one_machine() {
    let folder = flights();
    said(&folder, "train", &["--out=one.lkm"]);
    let out = "--out=many.lkm";
    let text = said(&folder, "fit", &[out]);
    assert!(text.contains("pass 0 of 2 is to be mined"), "{text}");
    let text = said(&folder, "mine", &[out, "--shard=1/2"]);
    assert!(text.contains("pass 0 of 2, shard 1/2") && text.contains("of 1 clips"), "{text}");
    let text = complaint(&folder, "fit", &[out], 1);
    assert!(text.contains("pass 0: shard 0 of 2 was not mined yet"), "{text}");
    said(&folder, "mine", &[out, "--shard=0/2"]);
    // Other settings are not mixed with these.
    let text = complaint(&folder, "fit", &[out, "--seed=2"], 1);
    assert!(text.contains("mined with other settings"), "{text}");
    let text = said(&folder, "fit", &[out]);
    assert!(text.contains("round 1 of 2") && text.contains("pass 1 of 2 is to be mined"), "{text}");
    // Nothing is done twice.
    let text = said(&folder, "fit", &[out]);
    assert!(!text.contains("round 1 of 2") && text.contains("pass 1 of 2"), "{text}");
    for index in 0..3 {
        said(&folder, "mine", &[out, &format!("--shard={index}/3")]);
    }
    let text = said(&folder, "mine", &[out, "--shard=2/3"]);
    assert!(text.contains("pass 1, shard 2/3: mined before"), "{text}");
    let text = said(&folder, "fit", &[out]);
    assert!(text.contains("round 2 of 2") && !text.contains("round 1 of 2"), "{text}");
    let read = |name: &str| fs::read(folder.path().join(name)).unwrap();
    assert!(read("many.lkm") == read("one.lkm"), "the same bytes");
    assert_eq!(names(&folder), ["data", "many.jsonl", "many.lkm", "one.jsonl", "one.lkm"]);
    let text = complaint(&folder, "mine", &[out, "--from=one.lkm"], 1);
    assert!(text.contains("run lookout train"), "{text}");
}

#[test]
fn lightgbm_scores_are_ours_on_the_same_bytes() {
    let folder = flights();
    let path = |name: &str| format!("{ROOT}/tests/lightgbm/{name}");
    let from = format!("--scan-from={}", path("model.txt"));
    said(&folder, "train", &["--out=m.lkm", &from, "--no-stcube"]);
    let bytes = fs::read(folder.path().join("m.lkm")).unwrap();
    let model = Model::parse(&bytes).unwrap();
    let text = fs::read_to_string(path("model.txt")).unwrap();
    let leaves: Vec<Vec<f64>> = text
        .lines()
        .filter_map(|line| line.strip_prefix("leaf_value="))
        .map(|line| line.split(' ').map(|value| value.parse().unwrap()).collect())
        .collect();
    let rows = fs::read_to_string(path("rows.csv")).unwrap();
    for row in rows.lines() {
        let mut cells = row.split(',');
        let score: f64 = cells.next().unwrap().parse().unwrap();
        let reached: Vec<usize> =
            cells.by_ref().take(leaves.len()).map(|cell| cell.parse().unwrap()).collect();
        let mut values = [0u8; 1600];
        for cell in cells {
            let (feature, value) = cell.split_once('=').unwrap();
            values[feature.parse::<usize>().unwrap()] = value.parse().unwrap();
        }
        // Thresholds are exact; leaves are rounded, each by half a unit of 1/256 at most.
        let expected: f64 =
            reached.iter().zip(&leaves).map(|(&leaf, leaves)| (leaves[leaf] * 256.0).round()).sum();
        let found = model.scan().score(|f, t| u16::from(values[usize::from(f)]) > t);
        assert_eq!(f64::from(found), expected, "{row}");
        assert!((f64::from(found) / 256.0 - score).abs() <= leaves.len() as f64 / 512.0, "{row}");
    }
    assert!(rows.lines().count() == 40 && leaves.len() == 8);
}

#[test]
fn windows_go_to_lightgbm_and_its_faults_are_named() {
    let folder = flights();
    said(&folder, "mine", &["--out=m.lkm", "--csv=windows.csv"]);
    let text = fs::read_to_string(folder.path().join("windows.csv")).unwrap();
    let first = |label: &str| text.lines().filter(|line| line.starts_with(label)).count();
    assert!(
        first("1,") > 0 && first("0,") > 0 && first("1,") + first("0,") == text.lines().count()
    );
    assert!(text.lines().all(|line| line.split(',').count() == 1601));
    let model = fs::read_to_string(format!("{ROOT}/tests/lightgbm/model.txt")).unwrap();
    fs::write(folder.path().join("m.txt"), model.replacen("num_cat=0", "num_cat=1", 1)).unwrap();
    let text = complaint(&folder, "train", &["--out=n.lkm", "--scan-from=m.txt"], 1);
    assert!(text.contains("m.txt: tree 0: num_cat is '1', expected 0"), "{text}");
    let text = complaint(&folder, "train", &["--out=n.lkm", "--scan-from=none.txt"], 2);
    assert!(text.contains("none.txt") && text.contains("cannot read"), "{text}");
}
