//! A live lookout in this process: what goes wrong with a camera, and what is kept.
#![cfg(feature = "std")]

#[allow(dead_code, reason = "frames alone are drawn")]
#[path = "common/golden.rs"]
mod golden;
#[allow(dead_code, reason = "every test binary uses a part of it")]
#[path = "common/live.rs"]
mod live;

use live::{ACTIVE, CRITICAL, Fault, Faults, Ground, MODEL, PATIENCE, Run, drawn, listed};
use lookout::mavlink::dialect::MavMessage;
use lookout::shell::live::source::{CaptureInfo, LiveError, LiveSource, OpenSource};
use lookout::shell::sources::Frame;
use serde_json::Value;
use std::fs;
use std::net::{TcpListener, UdpSocket};
use std::process::Command;
use std::time::{Duration, Instant};

const SIZE: (usize, usize) = (160, 120);
const PERIOD: Duration = Duration::from_millis(33);

/// Starts a lookout on drawn frames that speaks to `ground`.
fn start(ground: &Ground, more: &str) -> Run {
    let faults = Faults::default();
    let open = drawn(SIZE, PERIOD, u32::MAX, &faults);
    Run::start(&settings(ground, more), open, faults)
}

fn settings(ground: &Ground, more: &str) -> String {
    format!("links = ['{}']\nmodel = '{MODEL}'\nthreads = 1\n{more}", ground.link())
}

#[test]
fn a_covered_lens_is_told_and_so_is_its_end() {
    let mut ground = Ground::default();
    let run = start(&ground, "");
    ground.wait_state(ACTIVE, 0);
    run.faults.set(Fault::Dark);
    ground.wait_state(CRITICAL, 1);
    ground.wait_text("too dark");
    run.faults.set(Fault::None);
    ground.wait_state(ACTIVE, 0);
    ground.wait_text("watching");
    for (fault, bits) in [(Fault::White, 2), (Fault::Blurred, 4)] {
        run.faults.set(fault);
        ground.wait_state(CRITICAL, bits);
        run.faults.set(Fault::None);
        ground.wait_state(ACTIVE, 0);
    }
    assert_eq!(run.stop().opened, 1);
}

#[test]
fn a_frozen_picture_is_told() {
    let mut ground = Ground::default();
    let run = start(&ground, "");
    ground.wait_state(ACTIVE, 0);
    run.faults.set(Fault::Frozen);
    ground.wait_state(CRITICAL, 8);
    ground.wait_text("frozen");
    run.faults.set(Fault::None);
    ground.wait_state(ACTIVE, 0);
    run.stop();
}

/// Whether a message is about traffic.
fn warns(message: &MavMessage) -> bool {
    match message {
        MavMessage::STATUSTEXT(text) => text.text.to_str().unwrap().contains("VIS"),
        MavMessage::ADSB_VEHICLE(_) | MavMessage::COLLISION(_) => true,
        _ => false,
    }
}

#[test]
fn a_camera_that_is_gone_is_waited_for() {
    let mut ground = Ground::default();
    let faults = Faults::default();
    // Not even there at the start.
    faults.set(Fault::Unplugged);
    let open = drawn(SIZE, PERIOD, u32::MAX, &faults);
    let run = Run::start(&settings(&ground, ""), open, faults);
    ground.wait("boot", |m| matches!(m, MavMessage::HEARTBEAT(h) if h.system_status as u8 == 1));
    run.faults.set(Fault::None);
    ground.wait_state(ACTIVE, 0);
    run.faults.set(Fault::Unplugged);
    ground.wait_state(CRITICAL, 0);
    ground.wait_text("no pictures");
    // Gone so long that the pauses between two attempts are the longest; nobody is warned of what was seen before.
    let gone = ground.heard.len();
    ground.beats(Duration::from_secs(4));
    assert!(!ground.heard[gone..].iter().any(|(_, _, message)| warns(message)), "a stale warning");
    run.faults.set(Fault::None);
    let back = Instant::now();
    ground.wait_state(ACTIVE, 0);
    println!("camera back, watching {} ms later", back.elapsed().as_millis());
    assert!(back.elapsed() < Duration::from_secs(3), "{:?}", back.elapsed());
    // There, but silent: opened again by itself.
    run.faults.set(Fault::Silent);
    ground.wait_state(CRITICAL, 0);
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(4) {
        ground.hear();
    }
    run.faults.set(Fault::None);
    ground.wait_state(ACTIVE, 0);
    let summary = run.stop();
    assert!(summary.opened >= 3, "{}", summary.opened);
    // Heartbeats came all the while.
    let beats = ground.heard.iter().filter(|(_, _, m)| matches!(m, MavMessage::HEARTBEAT(_)));
    let times: Vec<Instant> = beats.map(|(time, ..)| *time).collect();
    let longest = times.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap();
    assert!(longest < Duration::from_secs(3), "{longest:?} without a heartbeat");
}

#[test]
fn links_that_hang_hold_nobody_up() {
    let mut ground = Ground::default();
    // One who takes the connection and reads nothing, one who is never there.
    let deaf = TcpListener::bind("127.0.0.1:0").unwrap();
    let more = format!("'tcpout:{}', 'tcpout:192.0.2.1:9'", deaf.local_addr().unwrap());
    let text = settings(&ground, "").replacen("']", &format!("', {more}]"), 1);
    let faults = Faults::default();
    let run = Run::start(&text, drawn(SIZE, PERIOD, u32::MAX, &faults), faults);
    ground.wait_state(ACTIVE, 0);
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(4) {
        ground.hear();
    }
    let summary = run.stop();
    // One attempt to connect takes two seconds.
    assert!(summary.frames > 20, "{} frames", summary.frames);
    let (_, _, p99) = *summary
        .stages
        .percentiles(&summary.sent)
        .iter()
        .find(|s| s.0.contains("tracks and"))
        .unwrap();
    assert!(p99 < 100_000, "{p99} us from detections to tracks");
}

/// `lookout replay` as a recording says.
fn replay(segment: &std::path::Path, more: &[&str]) -> String {
    let text = fs::read_to_string(segment.join("replay.txt")).unwrap();
    let words: Vec<String> =
        text.split_whitespace().skip(1).map(|word| word.trim_matches('\'').to_owned()).collect();
    let mut command = Command::new(env!("CARGO_BIN_EXE_lookout"));
    let output = command.args(words).args(more).current_dir(segment).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn json_lines(path: &std::path::Path) -> Vec<Value> {
    let text = fs::read_to_string(path).unwrap();
    assert!(text.ends_with('\n'), "{} is not whole", path.display());
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// The lines of a segment's frames as recorded and as replayed, in which the same is found, and what the replay printed.
fn replayed(segment: &std::path::Path) -> (Vec<Value>, Vec<Value>, String) {
    let digest = replay(segment, &["--jsonl", "again.jsonl"]);
    let [live, again] = ["detections.jsonl", "again.jsonl"].map(|name| {
        let path = segment.join(name);
        // A segment may end before there is any event.
        if fs::metadata(&path).unwrap().len() == 0 { vec![] } else { json_lines(&path) }
    });
    assert_eq!(live.len(), again.len(), "{}", segment.display());
    for (live, again) in live.iter().zip(&again) {
        assert_eq!(live["detections"], again["detections"], "{}", segment.display());
    }
    (live, again, digest)
}

/// Detections in these lines.
fn count(lines: &[Value]) -> usize {
    lines.iter().map(|line| line["detections"].as_array().unwrap().len()).sum()
}

#[test]
fn a_recording_replays_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let record = folder.path().join("record");
    let ground = Ground::default();
    let faults = Faults::default();
    let open = drawn(SIZE, PERIOD, 60, &faults);
    let more = format!("record = '{}'\n", record.display());
    let summary = Run::start(&settings(&ground, &more), open, faults).ended();
    let segments = listed(&record);
    assert_eq!(segments.len(), 1);
    let (live, again, digest) = replayed(&segments[0]);
    assert_eq!(digest.trim(), format!("{:016x}", summary.digest.value()));
    assert_eq!(live.len() as u64, summary.frames);
    let found = count(&live);
    assert!(found > 20, "{found} detections are too few to compare");
    let confirmed = |line: &Value| line["tracks"].to_string().contains("\"confirmed\":true");
    assert!(live.iter().any(confirmed), "no track to compare");
    let time = |line: &Value| line["time_us"].as_i64().unwrap();
    let start = time(&live[0]);
    for (live, again) in live.iter().zip(&again) {
        assert_eq!(live["tracks"], again["tracks"]);
        assert_eq!(time(live) - start, time(again));
    }
}

/// Frames that say that they are far apart, so that a recording has several segments.
struct Stretched {
    source: Box<dyn LiveSource>,
    frames: i64,
}

impl LiveSource for Stretched {
    fn next(&mut self, frame: &mut Frame, timeout: Duration) -> Result<CaptureInfo, LiveError> {
        let taken = self.source.next(frame, timeout)?;
        self.frames += 1;
        frame.time_us = self.frames * 300_000;
        Ok(taken)
    }
}

#[test]
fn later_segments_replay_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let record = folder.path().join("record");
    let ground = Ground::default();
    let faults = Faults::default();
    let open = drawn(SIZE, Duration::from_millis(20), 300, &faults);
    let stretched: Box<OpenSource> = Box::new(move |config, heard| {
        Ok(Box::new(Stretched { source: open(config, heard)?, frames: 0 }))
    });
    let more = format!("record = '{}'\nrecord_minutes = 60\n", record.display());
    let summary = Run::start(&settings(&ground, &more), stretched, faults).ended();
    let segments = listed(&record);
    assert!(segments.len() > 1, "{segments:?}");
    let (mut reported, mut found) = (0, 0);
    for (place, segment) in segments.iter().enumerate() {
        let (live, ..) = replayed(segment);
        found += count(&live);
        let pictures = listed(&segment.join("frames")).len() - 1;
        let command = fs::read_to_string(segment.join("replay.txt")).unwrap();
        let lead = command.split("--lead ").nth(1).map_or(0, |lead| lead.trim().parse().unwrap());
        assert_eq!(lead > 0, place > 0, "{command}");
        // Where the disk is too slow a segment begins after a gap.
        assert!(pictures == live.len() + lead || live.is_empty(), "{pictures} {}", live.len());
        reported += live.len() as u64;
    }
    assert!(reported > summary.frames / 2, "{reported} of {}", summary.frames);
    assert!(found > 100, "{found} detections are too few to compare");
}

#[test]
fn every_frame_goes_out_as_a_line_of_json() {
    let listener = UdpSocket::bind("127.0.0.1:0").unwrap();
    listener.set_read_timeout(Some(PATIENCE)).unwrap();
    let ground = Ground::default();
    let run = start(&ground, &format!("json = 'udp:{}'\n", listener.local_addr().unwrap()));
    let mut bytes = vec![0; 65_536];
    let mut last = 0;
    loop {
        let length = listener.recv(&mut bytes).expect("a datagram a frame");
        let line: Value = serde_json::from_slice(&bytes[..length]).unwrap();
        assert!(line["frame"].as_u64().unwrap() > last, "{line}");
        last = line["frame"].as_u64().unwrap();
        assert!(line["time_us"].as_i64().unwrap() > 1_600_000_000_000_000, "since 1970: {line}");
        assert!(line["tracks"].is_array(), "{line}");
        if line["detections"].as_array().is_some_and(|found| !found.is_empty()) {
            assert_eq!(line["detections"][0]["box"].as_array().unwrap().len(), 4, "{line}");
            break;
        }
    }
    run.stop();
}

#[test]
fn every_alert_is_explained() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("events");
    let mut ground = Ground::default();
    let run = start(&ground, &format!("event_log = '{}'\n", log.display()));
    let text = ground.wait_text("VIS");
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(2) {
        ground.hear();
    }
    run.stop();
    let folders = listed(&log);
    assert_eq!(folders.len(), 1);
    let events = json_lines(&folders[0].join("events.jsonl"));
    let number: u64 = text.split("VIS").nth(1).unwrap()[..4].parse().unwrap();
    let event = events.iter().find(|event| event["track"] == number).expect("the alert is there");
    assert!(event["words"].as_str().unwrap().starts_with(&format!("track {number} is ")));
    assert!(!event["frame"]["detections"].as_array().unwrap().is_empty());
    // The bytes are those that came.
    let sent: Vec<&Value> = event["sent"].as_array().unwrap().iter().collect();
    let of = |name: &str| sent.iter().find(|sent| sent["message"] == name);
    let bytes = of("STATUSTEXT").expect("it was sent")["bytes"].as_str().unwrap();
    let hex = |bytes: &[u8]| bytes.iter().map(|b| format!("{b:02x}")).collect::<String>();
    assert!(ground.heard.iter().any(|(_, heard, _)| hex(heard) == bytes), "{bytes}");
    let picture = image::open(folders[0].join(event["picture"].as_str().unwrap())).unwrap();
    assert!(picture.width() > picture.height(), "slices side by side");
    // A restart begins a new folder and leaves the old one.
    let run = self::start(&ground, &format!("event_log = '{}'\n", log.display()));
    ground.wait_state(ACTIVE, 0);
    run.stop();
    assert_eq!(listed(&log).len(), 2);
}

#[test]
fn a_flight_that_ends_ends_the_run() {
    let ground = Ground::default();
    let faults = Faults::default();
    let open = drawn(SIZE, Duration::from_millis(5), 100, &faults);
    let start = Instant::now();
    let summary = Run::start(&settings(&ground, ""), open, faults).ended();
    assert!(start.elapsed() < PATIENCE);
    assert_eq!(summary.frames + u64::from(summary.dropped), 100);
    assert!(summary.stages.percentiles(&summary.sent).len() >= 8);
}
