//! The built program's report: the page, the figures, bad input.
#![cfg(feature = "std")]

#[allow(dead_code, reason = "every test binary uses a part of it")]
#[path = "preview/browser.rs"]
mod browser;

use browser::Browser;
use serde_json::{Value, json};
use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;

const WIDTH: usize = 48;
const HEIGHT: usize = 40;
const FRAMES: usize = 8;

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

fn path(folder: &TempDir, name: &str) -> String {
    folder.path().join(name).to_str().unwrap().to_owned()
}

fn write(path: &str, text: &str) {
    fs::create_dir_all(Path::new(path).parent().unwrap()).unwrap();
    fs::write(path, text).unwrap();
}

/// A split of three clips: a dark target of 10 x 8 that moves, a target beside a bird, nothing. Beside it the split's table.
fn split(folder: &TempDir) -> String {
    let data = path(folder, "dev");
    for clip in ["east", "north", "west"] {
        let mut truth = String::new();
        for index in 0..FRAMES {
            let (left, top) = (5 + 2 * index, 12);
            let frame = index + 1;
            if clip != "west" {
                truth += &format!("{frame},1,{left},{top},10,8,1,1,1\n");
            }
            if clip == "north" {
                truth += &format!("{frame},2,30,28,9,9,1,4,1\n");
            }
            let dark = |x: usize, y: usize| {
                clip != "west" && (left..left + 10).contains(&x) && (top..top + 8).contains(&y)
            };
            let grey = |i: usize| if dark(i % WIDTH, i / WIDTH) { 40 } else { 140 + (i % 7) as u8 };
            let pixels = (0..WIDTH * HEIGHT).map(grey).collect();
            let picture = image::GrayImage::from_raw(WIDTH as u32, HEIGHT as u32, pixels).unwrap();
            let file = format!("{data}/{clip}/frames/{frame:04}.png");
            write(&file, "");
            picture.save(file).unwrap();
        }
        write(&format!("{data}/{clip}/gt.txt"), &truth);
    }
    // The last frames of a clip without boxes are not known from its labels: a box on a bird shows it.
    write(&format!("{data}/west/gt.txt"), &format!("{FRAMES},1,30,28,9,9,1,4,1\n"));
    write(&format!("{data}/east/camera.json"), r#"{"fps": 10, "kind": "hover"}"#);
    write(
        &path(folder, "dev.csv"),
        "clip,kind,agitation\neast,collision,0.35\nnorth,crossing,1.8\nwest,none,1.8\n",
    );
    data
}

/// Detections of a method that finds most of the targets, and other things.
fn external(folder: &TempDir) -> String {
    let other = path(folder, "other");
    let mut east = String::new();
    let mut north = String::new();
    for index in 0..FRAMES {
        let (frame, left) = (index + 1, 5 + 2 * index);
        if index != 5 {
            east += &format!("{frame},-1,{left},12,10,8,{}\n", 9 - index);
        }
        north += &format!("{frame},-1,{}.5,14,10,8,{}.25\n", left + 1, index);
        // On the bird, and a false alarm.
        north += &format!("{frame},-1,31,28,8,9,{}\n", 3 + index);
        north += &format!("{frame},-1,2,30,7,7,{}.5\n", index);
    }
    write(&format!("{other}/east.txt"), &east);
    write(&format!("{other}/north.txt"), &north);
    write(&format!("{other}/west.txt"), "5,-1,10,10,12,12,4.5\n");
    other
}

struct Made {
    data: String,
    out: String,
    report: String,
    other: String,
    json: Value,
    html: String,
    /// Keeps the files.
    _folder: TempDir,
}

fn made() -> Made {
    let folder = tempfile::tempdir().unwrap();
    let (data, other) = (split(&folder), external(&folder));
    let (out, report) = (path(&folder, "out"), path(&folder, "new/report"));
    let named = format!("a<b & c={other}");
    succeeded(&["eval", &data, "--out", &out, "--report", &report, "--external", &named]);
    let read = |name: &str| fs::read_to_string(Path::new(&report).join(name)).unwrap();
    let json = serde_json::from_str(&read("report.json")).unwrap();
    let html = read("report.html");
    Made { data, out, report, other, json, html, _folder: folder }
}

#[test]
fn the_report_holds_what_score_prints_and_its_parts_add_up() {
    let made = made();
    let Made { data, out, other, json, .. } = &made;
    assert_eq!(json["methods"][0]["name"], "ours");
    assert_eq!(json["methods"][1]["name"], "a<b & c");
    assert!(json["methods"][0]["median_ms_per_frame"].as_f64().unwrap() > 0.0);
    for (method, detections) in [out, other].into_iter().enumerate() {
        let scored: Value =
            serde_json::from_str(&succeeded(&["score", data, detections, "--json"])).unwrap();
        let method = &json["methods"][method];
        for (i, at) in method["at_iou"].as_array().unwrap().iter().enumerate() {
            assert_eq!(at["score"], scored["reports"][i]);
            let value = at["AveP"]["value"].as_f64().unwrap();
            let printed = at["score"]["AveP"].as_f64().unwrap();
            assert!((value - printed).abs() <= 0.5001e-4, "{value} {printed}");
        }
        let point = &method["operating_points"][1];
        let found = point["recall"].as_f64().unwrap() * 10.0;
        for breakdown in method["breakdowns"].as_array().unwrap() {
            let sum = |key: &str| {
                let groups = breakdown["groups"].as_array().unwrap();
                groups.iter().map(|g| g[key].as_u64().unwrap()).sum::<u64>()
            };
            assert_eq!(sum("targets"), 10, "{}", breakdown["by"]);
            assert_eq!(sum("found"), found.round() as u64, "{}", breakdown["by"]);
            if breakdown["by"] != "class" {
                assert_eq!(sum("false_alarms"), point["false_alarms"].as_u64().unwrap());
            }
        }
    }
}

#[test]
fn the_other_method_by_hand() {
    let json = made().json;
    let flights = &json["flights"];
    assert_eq!((&flights["clips"], &flights["frames"]), (&3.into(), &15.into()));
    assert_eq!((&flights["targets"], &flights["bird_boxes"]), (&10.into(), &6.into()));
    assert_eq!(flights["clips_without_target"], 1);
    // 5 frames at 10 a second, 10 at 30.
    let hours = flights["hours"].as_f64().unwrap();
    assert!((hours * 3600.0 - (0.5 + 10.0 / 30.0)).abs() < 1e-9);

    let other = &json["methods"][1];
    let any = &other["operating_points"][3];
    // East: one of five is missing; north: 1.5 and 2 px beside 10 x 8 is an IoU above 0.3.
    assert_eq!(any["recall"], 0.9);
    assert_eq!(any["false_alarms"], 6);
    assert_eq!(any["bird_detections"], 5);
    assert_eq!(any["bird_detections_per_1000_bird_boxes"].as_f64().unwrap().round(), 833.0);
    assert_eq!(any["false_alarms_without_target"], 1);
    let per_hour = any["false_alarms_without_target_per_hour"].as_f64().unwrap();
    assert_eq!(per_hour.round(), 30.0 * 3600.0 / 5.0);
    let by = |name: &str| {
        let all = other["breakdowns"].as_array().unwrap();
        all.iter().find(|b| b["by"] == name).unwrap()["groups"].as_array().unwrap().clone()
    };
    let kinds: Vec<Value> = by("kind").iter().map(|g| g["name"].clone()).collect();
    assert_eq!(kinds, ["collision", "crossing", "none"]);
    // The four targets found in the east are all that there is in collisions: no false alarm.
    assert_eq!(by("kind")[0]["AveP"][0]["value"], 0.8);
    let collisions = &json["collisions"];
    assert_eq!((&collisions["clips"], &collisions["targets"]), (&1.into(), &5.into()));
    assert_eq!(collisions["methods"][1]["AveP"][0]["value"], 0.8);
    assert!(collisions["methods"][1]["first_less_this"][1]["value"].is_number());
    assert_eq!(by("kind")[2]["AveP"][0]["value"], Value::Null);
    let agitation: Vec<Value> = by("agitation").iter().map(|g| g["name"].clone()).collect();
    assert_eq!(agitation, ["0.35", "1.8"]);
    assert_eq!(by("size")[0]["targets"], 10);
}

/// Start tags without an end tag, in the order of the text; those that have no content are left out.
fn unbalanced(html: &str) -> Vec<&str> {
    let mut open: Vec<&str> = Vec::new();
    for tag in html.split('<').skip(1) {
        let (tag, _) = tag.split_once('>').expect("a tag ends");
        let name = tag.split([' ', '/', '\n']).next().unwrap();
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop(), Some(name), "closes </{name}>");
        } else if !tag.ends_with('/') && !["!DOCTYPE", "meta", "img", "br"].contains(&name) {
            open.push(name);
        }
    }
    open
}

#[test]
fn the_page_stands_alone() {
    let Made { html, json, .. } = made();
    for outside in ["http:", "https:", "url(", "@import", "<link", "<script", "<iframe", "src=\"//"]
    {
        assert!(!html.contains(outside), "{outside}");
    }
    assert!(html.split("src=\"").skip(1).all(|src| src.starts_with("data:image/png;base64,")));
    assert!(unbalanced(&html).is_empty());
    // Two plots each of precision, false alarms, the regressors, and by size, contrast, agitation, kind, class; one of reliability.
    assert_eq!(html.matches("<svg ").count(), 17);
    for section in ["Reliability", "False reports where nothing flies", "Registration"] {
        assert!(html.contains(&format!("<h2>{section}</h2>")), "{section}");
    }
    // A row on a phone names its cells; nothing is said of intervals that are not shown, nor of hours that are none.
    assert!(html.contains("<td class=\"left\" data-head=\"Method\">"));
    assert_eq!(html.contains("<small>"), html.contains("Small: "));
    assert!(
        !html.contains("0.000 hours") && html.contains("Of these, 1 is ("),
        "{}",
        &html[..3000]
    );
    assert!(html.contains("a&lt;b &amp; c") && !html.contains("a<b"));
    let strips = |name: &str| json[name].as_array().unwrap().len();
    assert_eq!(html.matches("<img ").count(), strips("misses") + strips("false_alarms"));
    assert!(!html.contains("NaN") && !html.contains(">inf"));
}

/// On a phone and on a desktop: no cell ends beyond the edge, no heading has five lines.
#[test]
fn the_page_fits_its_screen() {
    let Some(mut browser) = Browser::start() else { return };
    let Made { report, _folder, .. } = made();
    browser.screen(390, 844, true, "light");
    browser.open(&format!("file://{report}/report.html"));
    for (width, height, phone) in [(390, 844, true), (360, 640, true), (1280, 800, false)] {
        browser.screen(width, height, phone, "light");
        browser.until("innerWidth", width);
        let picture = format!("{}/report-{width}.png", env!("CARGO_TARGET_TMPDIR"));
        browser.photograph(Path::new(&picture));
        let wider = "document.documentElement.scrollWidth - document.documentElement.clientWidth";
        assert_eq!(browser.value(wider), 0, "{width}: wider than the screen");
        let cut = r#"[...document.querySelectorAll("td, th, p, h2, h3, figure")]
            .filter((e) => e.getClientRects().length && e.getBoundingClientRect().right > document.documentElement.clientWidth + 1)
            .map((e) => e.outerHTML.slice(0, 200))"#;
        assert_eq!(browser.value(cut), json!([]), "{width}: cut off");
        let high = r#"[...document.querySelectorAll("th, h2, h3")]
            .filter((e) => e.getClientRects().length && e.getBoundingClientRect().height > 4.6 * parseFloat(getComputedStyle(e).lineHeight))
            .map((e) => e.innerText)"#;
        assert_eq!(browser.value(high), json!([]), "{width}: headings of many lines");
        assert!(browser.value("document.querySelectorAll('td').length").as_u64().unwrap() > 50);
    }
}

#[test]
fn algorithm_1_alone() {
    let figures = &made().json["regressors"];
    // Targets are seen in four frames in a row from the fourth frame on: 5 frames of two clips, 4 starts each.
    assert_eq!((&figures["clips"], &figures["cubes"]), (&2.into(), &40.into()));
    let moves: f64 = figures["moves"].as_array().unwrap().iter().map(|m| m.as_f64().unwrap()).sum();
    assert!((moves - 1.0).abs() < 1e-9);
    let breakdowns = figures["breakdowns"].as_array().unwrap();
    for breakdown in breakdowns {
        let groups = breakdown["groups"].as_array().unwrap();
        let slices: u64 = groups.iter().map(|g| g["slices"].as_u64().unwrap()).sum();
        assert_eq!(slices, if breakdown["by"] == "slice" { 160 } else { 120 }, "{breakdown}");
    }
    let ways =
        |breakdown: usize, group: usize| breakdowns[breakdown]["groups"][group]["ways"].clone();
    // The target moves by 2 px a frame, the background stands still.
    assert_eq!(ways(0, 0)[0]["motion_px"]["median"], 4.0);
    assert_eq!(ways(0, 0)[0]["motion_px"]["p90"], 6.0);
    // In the newest frame neither of the others has moved the window.
    let newest = ways(5, 0);
    assert_eq!(newest[0]["centre_px"], newest[2]["centre_px"]);
    assert_ne!(newest[0]["centre_px"], newest[1]["centre_px"]);
}

#[test]
fn flights_without_a_box_last_as_long_as_others() {
    let folder = tempfile::tempdir().unwrap();
    let (data, report) = (split(&folder), path(&folder, "report"));
    write(&format!("{data}/west/gt.txt"), "");
    succeeded(&["eval", &data, "--clips", "west", "--report", &report, "--threshold", "32000"]);
    let json = fs::read_to_string(Path::new(&report).join("report.json")).unwrap();
    let json: Value = serde_json::from_str(&json).unwrap();
    let hours = json["flights"]["hours_without_target"].as_f64().unwrap();
    assert!((hours * 3600.0 - 5.0 / 30.0).abs() < 1e-9, "{hours}");
    assert_eq!((&json["collisions"], &json["regressors"]), (&Value::Null, &Value::Null));
}

#[test]
fn targets_never_found_are_shown() {
    let folder = tempfile::tempdir().unwrap();
    let (data, report) = (split(&folder), path(&folder, "report"));
    // No score is as high: whatever the shipped model, every target is missed.
    succeeded(&["eval", &data, "--report", &report, "--threshold", "32000"]);
    let html = fs::read_to_string(Path::new(&report).join("report.html")).unwrap();
    assert!(html.matches("<img ").count() > 0);
}

#[test]
fn what_is_broken_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let (data, other) = (split(&folder), external(&folder));
    let report = path(&folder, "report");
    let complaint = |external: &[&str]| {
        let mut args = vec!["eval", &data, "--report", &report];
        external.iter().for_each(|e| args.extend(["--external", e]));
        let output = lookout(&args);
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{text}");
        assert_eq!(text.lines().count(), 1, "{text}");
        text
    };
    let text = complaint(&[&format!("acf={other}/missing")]);
    assert!(text.contains("other/missing: cannot read"), "{text}");
    let text = complaint(&[&format!("acf={data}")]);
    assert!(text.contains("dev: no CLIP.txt"), "{text}");
    let named = format!("acf={other}");
    let text = complaint(&[&named, &named]);
    assert!(text.contains("acf: two methods"), "{text}");
    write(&format!("{other}/north.txt"), "1,-1,0,0,9,9,1\n2,-1,0,zero,9,9,1\n");
    let text = complaint(&[&named]);
    assert!(text.contains("north.txt line 2: 'zero'"), "{text}");
    assert!(!Path::new(&report).exists(), "nothing is begun");

    write(&path(&folder, "file"), "");
    let below = path(&folder, "file/report");
    let output = lookout(&["eval", &data, "--report", &below]);
    let text = String::from_utf8(output.stderr).unwrap();
    assert!(text.contains("file/report: cannot write"), "{text}");

    for bad in ["acf", "=x", "acf=", "ours=x"] {
        let output = lookout(&["eval", &data, "--report", &report, "--external", bad]);
        assert_eq!(output.status.code(), Some(2), "{bad}");
    }
    assert_eq!(lookout(&["eval", &data, "--external", "a=b"]).status.code(), Some(2));
}

#[test]
fn the_independent_scorer_says_the_same() {
    const SCORE_PY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/tools/score.py");
    let python = |args: &[&str]| Command::new("python3").args(args).output();
    if !Path::new(SCORE_PY).exists() || !python(&["--version"]).is_ok_and(|o| o.status.success()) {
        eprintln!("skipped: needs python3 and {SCORE_PY}");
        return;
    }
    let made = made();
    for (method, detections) in [&made.out, &made.other].into_iter().enumerate() {
        for at in made.json["methods"][method]["at_iou"].as_array().unwrap() {
            let iou = at["score"]["iou"].to_string();
            let args = [SCORE_PY, &made.data, detections, "--iou", &iou, "--json"];
            let output = python(&args).unwrap();
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
            let theirs: Value = serde_json::from_slice(&output.stdout).unwrap();
            assert_eq!(at["score"], theirs);
            let recall = |n: u64| &theirs[format!("recall_at_{n}_false_alarms_per_1000_frames")];
            let ours = at["recall_at_false_alarms_per_1000_frames"].as_array().unwrap();
            for (ours, n) in ours.iter().zip([1, 10, 100]) {
                let off = ours["value"].as_f64().unwrap() - recall(n).as_f64().unwrap();
                assert!(off.abs() <= 0.5001e-4, "{off} at {n}");
            }
        }
    }
}
