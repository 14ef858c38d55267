//! `lookout run` as a service: settings, signals, its manager.
#![cfg(all(feature = "std", unix))]

#[allow(dead_code, reason = "frames alone are drawn")]
#[path = "common/golden.rs"]
mod golden;
#[allow(dead_code, reason = "every test binary uses a part of it")]
#[path = "common/live.rs"]
mod live;
#[allow(dead_code, reason = "every test binary uses a part of it")]
#[path = "common/service.rs"]
mod service;

use live::{ACTIVE, Ground, PATIENCE, listed};
use lookout::mavlink::dialect::MavMessage;
use service::{Service, lookout, settings};
use std::fs;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::Output;
use std::time::{Duration, Instant};

fn errors(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(1));
    let text = String::from_utf8(output.stderr.clone()).unwrap();
    assert_eq!(text.lines().count(), 1, "{text}");
    text
}

#[test]
fn settings_are_refused_by_name_and_line() {
    let folder = tempfile::tempdir().unwrap();
    let file = Service::config(&folder);
    let run = || lookout(&["run", "--config", file.to_str().unwrap()]).output().unwrap();
    assert!(errors(&run()).contains("lookout.toml: cannot read"));
    for (text, wanted) in [
        ("source = 'simulate:hover'\nlinkz = []\n", "line 2: unknown key linkz; is links meant?"),
        ("source = 'simulate:hover'\n\n[camera]\nrate = 0\n", "line 4: camera.rate: expected"),
        ("source = 'file:/nowhere'\n", "/nowhere: cannot open"),
        ("source = 'simulate:hover'\nmodel = '/nowhere'\n", "/nowhere: cannot read"),
        ("source = 'v4l2:/dev/video9'\ncamera.calibration = '/nowhere.yaml'\n", "/nowhere.yaml: "),
        ("source = 'simulate:hover'\npreview = '0.0.0.0:0'\n", "line 2: preview: others can reach"),
    ] {
        fs::write(&file, text).unwrap();
        let output = run();
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        let last = text.lines().last().unwrap_or_default();
        assert!(last.starts_with("lookout: ") && last.contains(wanted), "{wanted}: {text}");
        assert_eq!(output.status.code(), Some(1), "{text}");
    }
    // One line, where nothing was begun yet.
    fs::write(&file, "source = 3\n").unwrap();
    assert!(errors(&run()).contains("line 1: source: expected"));
}

#[test]
fn the_boards_settings_are_valid_and_explained() {
    let boards = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/boards/linux"));
    let files = listed(boards).into_iter().filter(|f| f.extension().is_some_and(|e| e == "toml"));
    let mut count = 0;
    for file in files {
        let output = lookout(&["run", "--config", file.to_str().unwrap(), "--print-config"]);
        let output = { output }.output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let text = String::from_utf8(output.stdout).unwrap();
        assert!(text.contains("Default: ") && text.contains("field_of_view = 62"), "{text}");
        count += 1;
    }
    assert!(count >= 4, "{count} boards");
    assert!(lookout(&["run", "--print-config"]).output().unwrap().status.success());
    assert_eq!(lookout(&["run"]).output().unwrap().status.code(), Some(2));
}

/// Two commands for each of five kinds of cameras and three stations; every one is understood, every file is there.
#[test]
fn the_commands_of_the_readme_are_understood() {
    let readme = include_str!("../README.md");
    let section = readme.split("### Connect your camera").nth(1).unwrap();
    let section = section.split("\n## ").next().unwrap();
    let mut counts = std::collections::BTreeMap::new();
    for line in section.lines().filter(|line| line.starts_with("lookout ")) {
        let line = line.split('#').next().unwrap().replace("BOARD", "127.0.0.1");
        let line = line.replace(" lookout.toml", " boards/linux/companion.toml");
        let mut words: Vec<&str> = line.split_whitespace().skip(1).collect();
        let verb = words[0];
        *counts.entry(verb.to_owned()).or_insert(0) += 1;
        let wanted = match verb {
            "run" => {
                words.push("--print-config");
                0
            }
            // Nobody is there: that is the answer, after a second.
            "params" => {
                words.extend(["--seconds", "1"]);
                1
            }
            "doctor" => match words.iter().position(|word| *word == "--config") {
                // Some of these wait for an address that is not in this network: the settings are enough.
                Some(at) => {
                    words = vec!["run", "--config", words[at + 1], "--print-config"];
                    0
                }
                None => continue,
            },
            _ => panic!("{line}"),
        };
        let output = { lookout(&words) }.current_dir(env!("CARGO_MANIFEST_DIR")).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(wanted), "{line}: {said}");
    }
    let counts: Vec<_> = counts.iter().map(|(verb, count)| (verb.as_str(), *count)).collect();
    assert_eq!(counts, [("doctor", 5), ("params", 2), ("run", 8)]);
    assert!(section.contains("\nmavproxy.py --master=udpin:"));
}

#[test]
fn it_ends_by_sigterm_with_everything_whole() {
    let mut ground = Ground::default();
    let text =
        format!("record = 'FOLDER/record'\nevent_log = 'FOLDER/events'\n{}", settings(&ground));
    let service = Service::start(&text, |_, _| {});
    ground.wait_state(ACTIVE, 0);
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(2) {
        ground.hear();
    }
    // As `timeout` does it: to the program, and to its group.
    service.signal("TERM");
    service.signal("TERM");
    let (status, out, err, folder) = service.ended();
    assert_eq!(status, Some(0), "{err}");
    assert!(
        out.contains("frames looked at") && out.contains("exposure to last byte sent"),
        "{out}"
    );
    let segment = listed(&folder.path().join("record")).swap_remove(0);
    let replay = fs::read_to_string(segment.join("replay.txt")).unwrap();
    let words: Vec<&str> = replay.split_whitespace().skip(1).collect();
    let output = lookout(&words).current_dir(&segment).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let digest = String::from_utf8(output.stdout).unwrap();
    assert!(out.contains(&format!("digest {}", digest.trim())), "{digest} in {out}");
    for entry in fs::read_dir(segment.join("frames")).unwrap() {
        let name = entry.unwrap().file_name();
        assert!(!name.to_str().unwrap().starts_with('.'), "{name:?} is half");
    }
}

#[test]
fn sighup_takes_what_can_change() {
    let (mut first, mut second) = (Ground::default(), Ground::default());
    let service = Service::start(&settings(&first), |_, _| {});
    let file = Service::config(&service.folder);
    first.wait_state(ACTIVE, 0);
    // A mistake changes nothing.
    fs::write(&file, "source = 'simulate:hover'\nbad = 1\n").unwrap();
    service.signal("HUP");
    service.wait_log("settings stay as they are");
    fs::write(&file, format!("component_id = 191\n{}", settings(&second))).unwrap();
    service.signal("HUP");
    second.wait_state(ACTIVE, 0);
    // Frames go on, and the flight may be another.
    let other = settings(&second).replace("hover", "crossing").replace("160", "192");
    fs::write(&file, other).unwrap();
    service.signal("HUP");
    service.wait_log("width=192");
    second.wait("frames", |m| matches!(m, MavMessage::NAMED_VALUE_FLOAT(v) if v.value > 1.0));
    second.wait_state(ACTIVE, 0);
    service.signal("INT");
    let (status, _, err, _) = service.ended();
    assert_eq!(status, Some(0), "{err}");
    assert!(err.contains("settings stay as they are") && err.contains("line 2"), "{err}");
    assert!(err.contains("component_id changes with the next start only"), "{err}");
    assert!(err.contains("links changes") && err.contains("width=192"), "{err}");
}

#[test]
fn the_manager_hears_how_it_is() {
    let ground = Ground::default();
    let sockets = tempfile::tempdir().unwrap();
    let path = sockets.path().join("notify");
    let manager = UnixDatagram::bind(&path).unwrap();
    manager.set_read_timeout(Some(PATIENCE)).unwrap();
    let hear = || {
        let mut buffer = [0; 500];
        let length = manager.recv(&mut buffer).expect("the manager hears something");
        String::from_utf8(buffer[..length].to_vec()).unwrap()
    };
    let until = |wanted: &str| {
        let mut all = Vec::new();
        while !all.iter().any(|text: &String| text.starts_with(wanted)) {
            assert!(all.len() < 500, "no {wanted} in {all:?}");
            all.push(hear());
        }
        all
    };
    let service = Service::start(&settings(&ground), |command, _| {
        command.env("NOTIFY_SOCKET", &path).env("WATCHDOG_USEC", "600000");
    });
    assert_eq!(until("READY=1"), ["READY=1"]);
    until("STATUS=watching");
    for _ in 0..3 {
        until("WATCHDOG=1");
    }
    service.signal("HUP");
    until("RELOADING=1\nMONOTONIC_USEC=");
    until("READY=1");
    service.signal("TERM");
    until("STOPPING=1");
    assert_eq!(service.ended().0, Some(0));
}
