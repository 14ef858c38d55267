//! Our scorer against the independent one, and by hand.
#![cfg(feature = "std")]

use lookout::shell::evaluate::score::{AccuracyReport, DetectionRecord, Scorer, WARMUP};
use lookout::shell::formats::clips::GroundTruth;
use lookout::shell::formats::detections::read_mot;
use serde_json::Value;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::Command;

const SCORE_PY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/tools/score.py");

fn truth(text: &str) -> GroundTruth {
    GroundTruth::parse(text, Path::new("gt.txt")).unwrap()
}

fn found(frame: u64, rect: [f64; 4], score: f64) -> DetectionRecord {
    DetectionRecord { frame, rect, score }
}

fn report(truth: &GroundTruth, found: &[DetectionRecord]) -> AccuracyReport {
    let mut scorer = Scorer::new(0.5, 0);
    scorer.add_clip(truth, found);
    scorer.report()
}

#[test]
fn average_precision_by_hand() {
    // Scores 4 right, 3 wrong, 2 right, 1 wrong; three targets.
    // Curve: (1/3, 1), (1/3, 1/2), (2/3, 2/3), (2/3, 1/2): area 1/3 + 1/3 * 2/3.
    let truth = truth("1,1,0,0,20,20\n2,1,0,0,20,20\n3,1,0,0,20,20\n");
    let away = [100.0, 100.0, 20.0, 20.0];
    let here = [0.0, 0.0, 20.0, 20.0];
    let report = report(
        &truth,
        &[found(1, away, 1.0), found(1, here, 4.0), found(2, away, 3.0), found(2, here, 2.0)],
    );
    assert!((report.average_precision - 5.0 / 9.0).abs() < 1e-12);
    assert_eq!(report.recall_at_precision, [2.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0]);
    // 3 frames: 1 and 10 false alarms in 1000 frames allow none, 100 neither.
    assert_eq!(report.recall_at_false_alarms, [1.0 / 3.0; 3]);
    assert_eq!((report.frames, report.positives, report.detections), (3, 3, 4));
}

#[test]
fn equal_scores_are_one_point_of_the_curve() {
    let truth = truth("1,1,0,0,20,20\n");
    let right = found(1, [0.0, 0.0, 20.0, 20.0], 1.0);
    let wrong = found(1, [50.0, 0.0, 20.0, 20.0], 1.0);
    for order in [[right, wrong], [wrong, right]] {
        assert_eq!(report(&truth, &order).average_precision, 0.5);
    }
}

#[test]
fn a_target_is_found_once_and_the_surest_chooses_first() {
    // Two targets side by side; the surest lies between them, nearer to the second one.
    let truth = truth("1,1,0,0,20,20\n1,2,8,0,20,20\n");
    let one = report(
        &truth,
        &[found(1, [6.0, 0.0, 20.0, 20.0], 2.0), found(1, [8.0, 0.0, 20.0, 20.0], 1.0)],
    );
    // The second detection falls back on the first target: intersection 12 of 28, too little.
    assert_eq!((one.positives, one.detections), (2, 2));
    assert_eq!(one.average_precision, 0.5);
    let two = report(
        &truth,
        &[found(1, [6.0, 0.0, 20.0, 20.0], 2.0), found(1, [2.0, 0.0, 20.0, 20.0], 1.0)],
    );
    assert_eq!(two.average_precision, 1.0);
}

#[test]
fn birds_cut_and_small_targets_count_neither_way() {
    let truth = truth("1,1,0,0,20,20,1,4,1\n1,2,50,0,20,20,1,1,0.5\n1,3,100,0,7,7,1,1,1\n");
    let on_them = [[0.0, 0.0, 20.0, 20.0], [50.0, 10.0, 20.0, 20.0], [100.0, 0.0, 7.0, 14.0]];
    let counted = report(&truth, &on_them.map(|rect| found(1, rect, 1.0)));
    assert_eq!((counted.positives, counted.detections), (0, 0));
    // Less than half of the detection on the bird: a false alarm.
    let beside = report(&truth, &[found(1, [0.0, 11.0, 20.0, 20.0], 1.0)]);
    assert_eq!((beside.positives, beside.detections), (0, 1));
    assert_eq!(beside.average_precision, 0.0);
}

#[test]
fn the_first_frames_are_left_out() {
    let mut scorer = Scorer::new(0.5, WARMUP);
    scorer.add_clip(
        &truth("3,1,0,0,20,20\n4,1,0,0,20,20\n"),
        &[found(3, [0.0, 0.0, 20.0, 20.0], 1.0)],
    );
    scorer.add_clip(&truth("2,1,0,0,20,20\n"), &[found(9, [0.0, 0.0, 20.0, 20.0], 1.0)]);
    let report = scorer.report();
    assert_eq!((report.frames, report.positives, report.detections), (1 + 6, 1, 1));
}

/// Small random numbers by xorshift64*.
struct Dice(u64);

impl Dice {
    /// 0 up to `sides - 1`.
    fn throw(&mut self, sides: u32) -> u32 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        let high = (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 32) as u32;
        high % sides
    }
}

/// A clip's ground truth and detections as text: near misses, ties in score and place, birds, cut and small targets.
fn random_clip(dice: &mut Dice) -> (String, String) {
    let (mut gt, mut mot) = (String::new(), String::new());
    for frame in 1..=dice.throw(30) {
        for id in 0..dice.throw(4) {
            let (left, top) = (dice.throw(60), dice.throw(60));
            let (width, height) = (3 + dice.throw(50), 2 + dice.throw(50));
            let class = 1 + dice.throw(4);
            let visibility = if dice.throw(5) == 0 { "0.5" } else { "1" };
            writeln!(
                gt,
                "{frame},{id},{left}.{},{top},{width},{height},1,{class},{visibility}",
                dice.throw(10)
            )
            .unwrap();
            for _ in 0..dice.throw(3) {
                let mut near = |v: u32| f64::from(v) + f64::from(dice.throw(9)) - 4.0;
                let rect = [near(left), near(top), near(width).max(1.0), near(height).max(1.0)];
                let [l, t, w, h] = rect;
                let score = f64::from(dice.throw(40)) / 8.0 - 1.0;
                writeln!(mot, "{frame},-1,{l},{t},{w},{h},{score:.6}").unwrap();
            }
        }
        if dice.throw(3) == 0 {
            writeln!(
                mot,
                "{frame},-1,{},{},20,20,{}.5",
                dice.throw(90),
                dice.throw(90),
                dice.throw(4)
            )
            .unwrap();
        }
    }
    (gt, mot)
}

#[test]
fn the_independent_scorer_prints_the_same() {
    let python = |args: &[&str]| Command::new("python3").args(args).output();
    if !Path::new(SCORE_PY).exists() || !python(&["--version"]).is_ok_and(|o| o.status.success()) {
        eprintln!("skipped: needs python3 and {SCORE_PY}");
        return;
    }
    let mut positives = 0;
    for seed in 1..=4 {
        let mut dice = Dice(seed);
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let mut clips = Vec::new();
        for clip in 0..3 + dice.throw(6) {
            let (gt, mot) = random_clip(&mut dice);
            let name = format!("clip_{clip}");
            fs::create_dir_all(path("data").join(&name)).unwrap();
            fs::create_dir_all(path("found")).unwrap();
            fs::write(path("data").join(&name).join("gt.txt"), &gt).unwrap();
            let file = path("found").join(format!("{name}.txt"));
            fs::write(&file, &mot).unwrap();
            clips.push((truth(&gt), read_mot(&file).unwrap()));
        }
        let judged = |iou| {
            let mut scorer = Scorer::new(iou, WARMUP);
            for (truth, found) in &clips {
                scorer.add_clip(truth, found);
            }
            scorer.report()
        };
        let theirs = |more: &[&str]| {
            let (data, found) = (path("data"), path("found"));
            let [data, found] = [&data, &found].map(|p| p.to_str().unwrap());
            let output = python(&[&[SCORE_PY, data, found], more].concat()).unwrap();
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
            String::from_utf8(output.stdout).unwrap()
        };
        for iou in ["0.5", "0.3"] {
            let json: Value = serde_json::from_str(&theirs(&["--iou", iou, "--json"])).unwrap();
            let ours = serde_json::to_value(judged(iou.parse().unwrap())).unwrap();
            assert_eq!(ours, json, "seed {seed}");
        }
        positives += judged(0.5).positives;
    }
    assert!(positives > 200, "the clips hold {positives} targets");
}
