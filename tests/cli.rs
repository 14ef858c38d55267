//! The built program: what it writes, and how it ends on bad input.
#![cfg(feature = "std")]

use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use tempfile::TempDir;

const WIDTH: usize = 40;
const HEIGHT: usize = 30;

fn lookout(args: &[&str], input: &[u8]) -> Output {
    let mut child = Command::new(env!("CARGO_BIN_EXE_lookout"))
        .args(args)
        .env_remove("LOOKOUT_LOG")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // The program may end before it has read everything.
    let _ = child.stdin.take().unwrap().write_all(input);
    child.wait_with_output().unwrap()
}

fn has_ffmpeg() -> bool {
    let found = Command::new("ffmpeg").arg("-version").output().is_ok();
    if !found {
        eprintln!("skipped: no ffmpeg");
    }
    found
}

/// The one line of a failed run, without `lookout: `.
fn complaint(output: &Output) -> String {
    let text = String::from_utf8(output.stderr.clone()).unwrap();
    assert_eq!(output.status.code(), Some(1), "{text}");
    let lines: Vec<&str> = text.lines().filter(|line| line.starts_with("lookout: ")).collect();
    assert_eq!(lines.len(), 1, "{text}");
    assert_eq!(text.lines().count(), 1, "{text}");
    assert!(!text.contains("panicked"), "{text}");
    lines[0]["lookout: ".len()..].to_owned()
}

fn succeeded(output: Output) -> String {
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    String::from_utf8(output.stdout).unwrap()
}

/// Grey pixels of a frame: a gradient with a dark spot that moves.
fn pixels(index: usize) -> Vec<u8> {
    let spot = |x: usize, y: usize| x.abs_diff(8 + index) < 3 && y.abs_diff(15) < 2;
    let grey = |i: usize| {
        let (x, y) = (i % WIDTH, i / WIDTH);
        if spot(x, y) { 20 } else { 150 + (x + 2 * y) as u8 }
    };
    (0..WIDTH * HEIGHT).map(grey).collect()
}

fn y4m(frames: usize) -> Vec<u8> {
    let mut bytes = format!("YUV4MPEG2 W{WIDTH} H{HEIGHT} F25:1 Cmono\n").into_bytes();
    for index in 0..frames {
        bytes.extend(b"FRAME\n");
        bytes.extend(pixels(index));
    }
    bytes
}

fn write_picture(path: &Path, index: usize) {
    image::GrayImage::from_raw(WIDTH as u32, HEIGHT as u32, pixels(index))
        .unwrap()
        .save(path)
        .unwrap();
}

/// A folder of so many pictures.
fn pictures(folder: &Path, frames: usize) {
    fs::create_dir_all(folder).unwrap();
    for index in 0..frames {
        write_picture(&folder.join(format!("{:04}.png", index + 1)), index);
    }
}

/// A path in a temporary folder, as text.
fn path(folder: &TempDir, name: &str) -> String {
    folder.path().join(name).to_str().unwrap().to_owned()
}

fn json_lines(file: &str) -> Vec<serde_json::Value> {
    let text = fs::read_to_string(file).unwrap();
    assert!(text.is_empty() || text.ends_with('\n'), "the last line of {file} is whole");
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn replay_of_standard_input_writes_everything() {
    let folder = tempfile::tempdir().unwrap();
    let [mot, jsonl, drawn] = ["mot.txt", "lines.jsonl", "drawn"].map(|name| path(&folder, name));
    let args =
        ["replay", "-", "--detections", &mot, "--jsonl", &jsonl, "--annotate", &drawn, "--digest"];
    let output = lookout(&args, &y4m(6));
    let summary = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(summary.contains("6 frames, "), "{summary}");
    let digest = succeeded(output);
    assert_eq!(digest.trim_end().len(), 16);
    let lines = json_lines(&jsonl);
    assert_eq!(lines.len(), 6);
    assert_eq!((&lines[5]["frame"], &lines[5]["time_us"]), (&6.into(), &200_000.into()));
    let found: usize = lines.iter().map(|l| l["detections"].as_array().unwrap().len()).sum();
    assert_eq!(fs::read_to_string(&mot).unwrap().lines().count(), found);
    let picture = image::open(Path::new(&drawn).join("000006.png")).unwrap();
    assert_eq!((picture.width(), picture.height()), (WIDTH as u32, HEIGHT as u32));
    assert_eq!(fs::read_dir(&drawn).unwrap().count(), 6);

    // The same pictures from a folder, on one thread: the same detections.
    let frames = path(&folder, "frames");
    pictures(Path::new(&frames), 6);
    assert_eq!(succeeded(lookout(&["replay", &frames, "--digest", "--threads", "1"], b"")), digest);
}

#[test]
fn replay_of_a_simulated_flight() {
    let flight =
        ["replay", "--simulate", "crossing", "--seconds", "0.2", "--width", "96", "--height", "64"];
    let digest =
        |more: &[&str]| succeeded(lookout(&[&flight[..], &["--digest"], more].concat(), b""));
    assert_eq!(digest(&[]), digest(&["--threads", "1"]));
    // Without any output it prints its detections.
    let output = lookout(&[&flight[..], &["--threshold", "-1000"]].concat(), b"");
    let summary = String::from_utf8_lossy(&output.stderr).into_owned();
    let printed = succeeded(output);
    assert!(
        summary.contains(&format!("6 frames, {} detections", printed.lines().count())),
        "{summary}"
    );

    // The same flight as files, found and judged.
    let folder = tempfile::tempdir().unwrap();
    let out = path(&folder, "flights/one");
    let simulate = [&["simulate", "--out", &out, "--kind"], &flight[2..]].concat();
    succeeded(lookout(&simulate, b""));
    assert_eq!(succeeded(lookout(&["replay", &out, "--digest"], b"")), digest(&[]));
    let evaluated = succeeded(lookout(&["eval", &path(&folder, "flights")], b""));
    assert!(evaluated.contains("average precision (AveP)"), "{evaluated}");
    let line = complaint(&lookout(&simulate, b""));
    assert!(line.contains("flights/one"), "{line}");
}

#[test]
fn scaled_frames_are_told_in_their_own_pixels() {
    let folder = tempfile::tempdir().unwrap();
    let jsonl = path(&folder, "lines.jsonl");
    let flight = [
        "replay",
        "--simulate",
        "crossing",
        "--seconds",
        "0.5",
        "--width",
        "320",
        "--height",
        "240",
    ];
    let run = |more: &[&str]| {
        let outputs = ["--threshold", "-1000", "--digest", "--jsonl", &jsonl];
        let digest = succeeded(lookout(&[&flight[..], &outputs, more].concat(), b""));
        (digest, json_lines(&jsonl))
    };
    let (digest, _) = run(&[]);
    assert_eq!(run(&["--frame", "320x240"]).0, digest);
    let (smaller, lines) = run(&["--frame", "160x120"]);
    assert_ne!(smaller, digest);
    let right = lines
        .iter()
        .flat_map(|line| line["detections"].as_array().unwrap())
        .map(|d| d["box"][0].as_f64().unwrap())
        .fold(0.0, f64::max);
    assert!(right > 170.0, "{right}");
}

#[test]
fn replay_draws_a_video() {
    if !has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let video = path(&folder, "drawn.mp4");
    succeeded(lookout(&["replay", "-", "--annotate", &video], &y4m(5)));
    // It can be replayed in its turn.
    let jsonl = path(&folder, "lines.jsonl");
    succeeded(lookout(&["replay", &video, "--jsonl", &jsonl], b""));
    let lines = json_lines(&jsonl);
    assert_eq!((lines.len(), &lines[4]["time_us"]), (5, &160_000.into()));
}

#[test]
fn a_cut_off_video_leaves_what_came_before() {
    let folder = tempfile::tempdir().unwrap();
    let [video, jsonl, drawn] =
        ["flight.y4m", "lines.jsonl", "drawn"].map(|name| path(&folder, name));
    let bytes = y4m(4);
    fs::write(&video, &bytes[..bytes.len() - 5]).unwrap();
    let output = lookout(&["replay", &video, "--jsonl", &jsonl, "--annotate", &drawn], b"");
    let line = complaint(&output);
    assert!(line.contains("flight.y4m") && line.contains("frame 4"), "{line}");
    assert_eq!(json_lines(&jsonl).len(), 3);
    assert_eq!(fs::read_dir(drawn).unwrap().count(), 3);
}

#[test]
fn a_video_without_frames() {
    let folder = tempfile::tempdir().unwrap();
    let [video, empty] = ["flight.y4m", "empty"].map(|name| path(&folder, name));
    fs::write(&video, y4m(0)).unwrap();
    fs::create_dir(&empty).unwrap();
    for (input, named) in [(&video, "flight.y4m"), (&empty, "empty"), (&path(&folder, "no"), "no")]
    {
        for verb in [&["replay", input][..], &["bench", "--input", input]] {
            let line = complaint(&lookout(verb, b""));
            assert!(line.contains(named), "{line}");
        }
    }
}

#[test]
fn a_bad_picture_in_the_middle() {
    let folder = tempfile::tempdir().unwrap();
    let [corrupt, other, jsonl] = ["corrupt", "other", "l.jsonl"].map(|name| path(&folder, name));
    for frames in [&corrupt, &other] {
        pictures(Path::new(frames), 4);
    }
    let third = |frames: &str| Path::new(frames).join("0003.png");
    let whole = fs::read(third(&corrupt)).unwrap();
    fs::write(third(&corrupt), &whole[..whole.len() / 2]).unwrap();
    image::GrayImage::new(9, 7).save(third(&other)).unwrap();
    for frames in [corrupt, other] {
        let line = complaint(&lookout(&["replay", &frames, "--jsonl", &jsonl], b""));
        assert!(line.contains("0003.png"), "{line}");
        assert_eq!(json_lines(&jsonl).len(), 2);
    }
}

/// A split of two clips of six frames, each with a target.
fn split(folder: &TempDir) -> String {
    let data = path(folder, "data");
    for clip in ["east", "west"] {
        pictures(&Path::new(&data).join(clip).join("frames"), 6);
        let truth: String = (1..=6).map(|f| format!("{f},1,{},13,9,4,1,1,1\n", 5 + f)).collect();
        fs::write(Path::new(&data).join(clip).join("gt.txt"), truth).unwrap();
    }
    data
}

#[test]
fn eval_and_score_agree() {
    let folder = tempfile::tempdir().unwrap();
    let (data, out) = (split(&folder), path(&folder, "out"));
    let evaluated = succeeded(lookout(&["eval", &data, "--out", &out], b""));
    assert!(evaluated.contains(": 2 clips, 6 frames (0.0001 hours), 6 targets\n"), "{evaluated}");
    let scored = succeeded(lookout(&["score", &data, &out], b""));
    let rows = |text: &str| {
        let rows = text.lines().skip_while(|line| !line.starts_with("Accuracy"));
        rows.take_while(|line| !line.is_empty()).map(String::from).collect::<Vec<_>>()
    };
    assert!(rows(&scored).len() > 10, "{scored}");
    assert_eq!(rows(&scored), rows(&evaluated));
    assert!(evaluated.contains("Reliability of the model's precisions"), "{evaluated}");
    assert!(evaluated.contains("frames registered, share"), "{evaluated}");
    assert_eq!(succeeded(lookout(&["eval", &data, "--jobs", "1"], b"")), evaluated);

    let one = succeeded(lookout(&["eval", &data, "--clips", "eas", "--json"], b""));
    let one: serde_json::Value = serde_json::from_str(&one).unwrap();
    assert_eq!((&one["reports"][0]["iou"], &one["reports"][1]["iou"]), (&0.5.into(), &0.3.into()));
    assert_eq!(one["reports"][0]["positives"], 3);
    assert_eq!(one["scan"]["frames"], 6);
    let line = complaint(&lookout(&["eval", &data, "--clips", "north"], b""));
    assert!(line.contains("data") && line.contains("'north'"), "{line}");
}

#[test]
fn one_broken_clip_does_not_end_an_evaluation() {
    let folder = tempfile::tempdir().unwrap();
    let (data, out) = (split(&folder), path(&folder, "out"));
    let west = Path::new(&data).join("west");
    fs::write(west.join("frames/0005.png"), "not a picture").unwrap();
    let left_out = |args: &[&str]| {
        let output = lookout(args, b"");
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{text}");
        assert!(text.contains("lookout: 1 of 2 clips left out"), "{text}");
        (String::from_utf8(output.stdout).unwrap(), text)
    };
    let (printed, text) = left_out(&["eval", &data, "--out", &out, "--jobs", "1"]);
    assert!(text.contains("west left out") && text.contains("0005.png"), "{text}");
    assert!(printed.contains("1 clips, 3 frames") && printed.contains("3 targets"), "{printed}");
    assert!(Path::new(&out).join("east.txt").exists());

    fs::write(west.join("gt.txt"), "1,1,5,13,9,4,1,1,1\n2,1,5,x,9,4,1,1,1\n").unwrap();
    let (printed, text) = left_out(&["eval", &data, "--json"]);
    assert!(text.contains("gt.txt:2: field 'top' is 'x'"), "{text}");
    let json: serde_json::Value = serde_json::from_str(&printed).unwrap();
    assert_eq!(json["broken"][0]["clip"], "west");
    assert_eq!(json["reports"][0]["positives"], 3);

    fs::remove_dir_all(Path::new(&data).join("east")).unwrap();
    let line = lookout(&["eval", &data], b"");
    assert_eq!(line.status.code(), Some(1));
    assert!(line.stdout.is_empty(), "no figures of nothing");
}

#[test]
fn clips_without_camera_are_followed_and_no_track_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let data = split(&folder);
    let printed = succeeded(lookout(&["eval", &data, "--tracks", "--threshold", "32000"], b""));
    assert!(printed.contains("No track was confirmed"), "{printed}");
    assert!(printed.contains(
        "2 of 2 clips have no camera.json: a horizontal field of view of 60 degrees is assumed"
    ));
    let bearing = printed.lines().find(|line| line.starts_with("direction error, median"));
    assert!(bearing.unwrap().ends_with(" -"), "{printed}");
}

#[test]
fn several_splits_are_counted_apart_and_together() {
    let folder = tempfile::tempdir().unwrap();
    let (data, out) = (split(&folder), path(&folder, "out"));
    let other = path(&folder, "other/dev");
    pictures(&Path::new(&other).join("quiet/frames"), 6);
    fs::write(Path::new(&other).join("quiet/gt.txt"), "").unwrap();
    let printed = succeeded(lookout(&["eval", &data, &other, "--out", &out, "--json"], b""));
    let json: serde_json::Value = serde_json::from_str(&printed).unwrap();
    assert_eq!(json["clips"], 3);
    assert_eq!((&json["splits"][0]["clips"], &json["splits"][1]["clips"]), (&2.into(), &1.into()));
    let hours = |value: &serde_json::Value| value["hours"].as_f64().unwrap();
    let (all, parts) = (hours(&json), hours(&json["splits"][0]) + hours(&json["splits"][1]));
    assert!((all - parts).abs() < 1e-12 && (all * 3600.0 - 18.0 / 30.0).abs() < 1e-4, "{all}");
    let quiet = &json["without_target"];
    assert_eq!(
        (&quiet["clips"], &quiet["events"][1]["name"]),
        (&1.into(), &"confirmed false tracks".into())
    );
    assert!(hours(quiet) > 0.0 && quiet["events"][3]["all"]["high"].as_f64().unwrap() > 0.0);
    assert!(Path::new(&out).join("other-dev/quiet.txt").exists());
    let scored = succeeded(lookout(&["score", &data, &other, &out, "--json"], b""));
    let scored: serde_json::Value = serde_json::from_str(&scored).unwrap();
    assert_eq!(scored["reports"], json["reports"]);
}

#[test]
fn rows_behind_the_end_are_no_misses() {
    let folder = tempfile::tempdir().unwrap();
    let data = split(&folder);
    let gt = Path::new(&data).join("east/gt.txt");
    let more = fs::read_to_string(&gt).unwrap()
        + "6,2,1,1,20,20,0,1,1\n7,1,1,1,20,20,1,1,1\n9,1,1,1,20,20,1,1,1\n";
    fs::write(&gt, more).unwrap();
    let output = lookout(&["eval", &data, "--json"], b"");
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(
        said.contains("east: labels: 2 rows behind the video's last frame: left out"),
        "{said}"
    );
    assert!(said.contains("east: labels: 1 row with conf 0"), "{said}");
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json["reports"][0]["positives"], 6);
}

#[test]
fn detections_that_cannot_be_scored() {
    let folder = tempfile::tempdir().unwrap();
    let (data, out) = (split(&folder), path(&folder, "out"));
    fs::create_dir(&out).unwrap();
    let line = complaint(&lookout(&["score", &data, &out], b""));
    assert!(line.contains("out: no CLIP.txt in it for any clip"), "{line}");
    fs::write(Path::new(&out).join("east.txt"), "1,-1,0,0,9,9,1\n").unwrap();
    let output = lookout(&["score", &data, &out], b"");
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success() && text.contains("1 of 2 clips have no file"), "{text}");
    fs::write(Path::new(&out).join("west.txt"), "").unwrap();
    fs::write(Path::new(&out).join("east.txt"), "1,-1,0,0,9,9,high\n").unwrap();
    let line = complaint(&lookout(&["score", &data, &out], b""));
    assert!(line.contains("east.txt line 1: 'high'"), "{line}");
}

#[test]
fn places_that_cannot_be_written() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("file"), "").unwrap();
    let below_file = path(&folder, "file/out");
    for option in ["--detections", "--jsonl", "--annotate"] {
        let line = complaint(&lookout(&["replay", "-", option, &below_file], &y4m(2)));
        assert!(line.contains("file/out: cannot write"), "{option}: {line}");
    }
    let video = path(&folder, "no/such/folder.mp4");
    let line = complaint(&lookout(&["replay", "-", "--annotate", &video], &y4m(2)));
    assert!(line.contains("folder.mp4: cannot write"), "{line}");
    let line = complaint(&lookout(&["eval", &split(&folder), "--out", &below_file], b""));
    assert!(line.contains("file/out: cannot write"), "{line}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk() {
    let folder = tempfile::tempdir().unwrap();
    let mot = path(&folder, "mot.txt");
    let args = ["replay", "-", "--detections", &mot, "--jsonl", "/dev/full"];
    let line = complaint(&lookout(&args, &y4m(3)));
    assert!(line.starts_with("/dev/full: cannot write") && line.contains("make room"), "{line}");
    assert!(fs::read_to_string(mot).unwrap().lines().all(|line| line.split(',').count() == 7));
    if !has_ffmpeg() {
        return;
    }
    let video = path(&folder, "full.mp4");
    std::os::unix::fs::symlink("/dev/full", &video).unwrap();
    let line = complaint(&lookout(&["replay", "-", "--annotate", &video], &y4m(3)));
    assert!(line.contains("full.mp4: cannot write") && line.contains("make room"), "{line}");
}

#[cfg(target_os = "linux")]
#[test]
fn an_interrupted_run_leaves_whole_files() {
    let folder = tempfile::tempdir().unwrap();
    let [jsonl, drawn] = ["lines.jsonl", "drawn"].map(|name| path(&folder, name));
    let mut child = Command::new(env!("CARGO_BIN_EXE_lookout"))
        .args(["replay", "-", "--jsonl", &jsonl, "--annotate", &drawn, "--digest"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut input = child.stdin.take().unwrap();
    let bytes = y4m(4);
    let frame = bytes.len() - y4m(3).len();
    let (now, later) = bytes.split_at(bytes.len() - frame);
    input.write_all(now).unwrap();
    // The program waits for the fourth frame once it has written the third.
    let third = Path::new(&drawn).join("000003.png");
    while !third.exists() {
        assert!(child.try_wait().unwrap().is_none(), "it ended too early");
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    let signal = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(signal.success());
    std::thread::sleep(std::time::Duration::from_millis(100));
    input.write_all(later).unwrap();
    drop(input);
    let output = child.wait_with_output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(130), "{text}");
    // On a busy machine the signal may come after the fourth frame.
    let lines = json_lines(&jsonl).len();
    assert!((3..=4).contains(&lines), "{lines} lines");
    assert!(text.contains(&format!("interrupted after frame {lines};")), "{text}");
    assert!(output.stdout.is_empty(), "no digest of half a flight");
    assert_eq!(image::open(third).unwrap().width(), WIDTH as u32);
}

#[test]
fn a_model_that_is_not_there() {
    let line = complaint(&lookout(&["replay", "-", "--model", "/no/such.lkm"], &y4m(1)));
    assert!(line.contains("/no/such.lkm: cannot read"), "{line}");
}

#[test]
fn models_that_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = path(&folder, "bad.lkm");
    let shipped = include_bytes!("../models/lookout.lkm");
    let changed = |place: usize| {
        let mut bytes = shipped.to_vec();
        bytes[place] ^= 0x55;
        bytes
    };
    let noise: Vec<u8> = (0..999u32).map(|i| ((i * i * 31) >> 3) as u8).collect();
    for (bytes, reason) in [
        (noise, "not a Lookout model"),
        (Vec::new(), "not a Lookout model"),
        (changed(8), "this program reads format"),
        (changed(shipped.len() - 1), "checksum"),
        (shipped[..shipped.len() - 1].to_vec(), "bytes instead of"),
    ] {
        fs::write(&file, bytes).unwrap();
        for verb in [&["replay", "-"][..], &["bench"], &["eval", "."]] {
            let line = complaint(&lookout(&[verb, &["--model", &file]].concat(), &y4m(1)));
            assert!(line.contains("bad.lkm") && line.contains(reason), "{line}");
        }
    }
}

#[test]
fn bench_measures() {
    let folder = tempfile::tempdir().unwrap();
    let video = path(&folder, "flight.y4m");
    fs::write(&video, y4m(8)).unwrap();
    let args = ["bench", "--input", &video, "--frames", "6", "--json"];
    let figures: serde_json::Value = serde_json::from_str(&succeeded(lookout(&args, b""))).unwrap();
    assert_eq!((&figures["frames"], &figures["width"]), (&6.into(), &WIDTH.into()));
    assert!(figures["frames_per_second"].as_f64().unwrap() > 0.0);
    assert!(figures["buffer_bytes"].as_u64().unwrap() > 0);
    for stage in ["registration", "channels", "scan", "cubes", "boxes"] {
        assert!(figures["stages_ms"][stage].as_f64().unwrap() >= 0.0, "{stage}");
    }
    let smaller = [&args[..], &["--frame", "20x16"]].concat();
    let figures: serde_json::Value =
        serde_json::from_str(&succeeded(lookout(&smaller, b""))).unwrap();
    assert_eq!((&figures["width"], &figures["height"]), (&20.into(), &16.into()));
    let text = succeeded(lookout(&["bench", "--input", &video], b""));
    assert!(text.starts_with("40x30, 8 frames"), "{text}");
}

#[test]
fn usage_errors() {
    for args in [
        &["replay", "--threshold", "high"][..],
        &["fly"],
        &[],
        &["bench", "--frames", "0"],
        &["replay", "x", "--simulate", "none"],
    ] {
        let output = lookout(args, b"");
        assert_eq!(output.status.code(), Some(2), "{args:?}");
    }
}
