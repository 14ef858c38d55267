//! Live frames from programs and over the network: what arrives, what is thrown away, what ends and comes back.
#![cfg(all(feature = "std", target_os = "linux"))]

#[allow(dead_code, reason = "frames alone are drawn")]
#[path = "common/golden.rs"]
mod golden;
#[allow(dead_code, reason = "every test binary uses a part of it")]
#[path = "common/live.rs"]
mod live;
#[allow(dead_code, reason = "every test binary uses a part of it")]
#[path = "common/service.rs"]
mod service;

use live::{ACTIVE, CRITICAL, Ground, MODEL, PATIENCE, listed};
use lookout::mavlink::dialect::MavMessage;
use service::{Service, lookout};
use std::fs;
use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// A moving picture of 160x120 by `ffmpeg`, 20 frames a second under a header that says 15.
const PRODUCER: &str = "'ffmpeg', '-nostdin', '-v', 'error', '-re', '-f', 'lavfi', '-i', 'testsrc=size=160x120:rate=20', \
                        '-vf', 'setpts=N/15/TB,format=gray', '-r', '15', '-f', 'yuv4mpegpipe', '-strict', '-1', '-'";

fn has(program: &str) -> bool {
    let mut found = Command::new(program);
    let found = found.arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok();
    if !found {
        eprintln!("skipped: {program} is not installed");
    }
    found
}

fn settings(ground: &Ground, source: &str, more: &str) -> String {
    format!(
        "source = {source}\nlinks = ['{}']\nmodel = '{MODEL}'\nthreads = 1\n{more}",
        ground.link()
    )
}

/// A script that a shell runs, which the settings name like any other program.
fn shell(script: &str) -> String {
    format!("{{ exec = ['sh', '-c', '''{script}'''] }}")
}

fn runs(process: &str) -> bool {
    // A process that nobody has waited for yet is a zombie, Z.
    let stat = fs::read_to_string(format!("/proc/{}/stat", process.trim())).unwrap_or_default();
    stat.rsplit(") ").next().is_some_and(|rest| !rest.is_empty() && !rest.starts_with('Z'))
}

fn wait(what: &str, mut done: impl FnMut() -> bool) {
    let start = Instant::now();
    while !done() {
        assert!(start.elapsed() < PATIENCE, "{what}");
        thread::sleep(Duration::from_millis(20));
    }
}

/// The middle of a stage in milliseconds, from the table that a run ends with.
fn median(out: &str, stage: &str) -> f64 {
    let line = out.lines().find(|line| line.starts_with(stage)).unwrap_or_else(|| panic!("{out}"));
    line[stage.len()..].split_whitespace().next().unwrap().parse().unwrap()
}

#[test]
fn a_live_program_is_not_paced_by_its_header() {
    if !has("ffmpeg") {
        return;
    }
    let mut ground = Ground::default();
    let more = "stream.latency_ms = 80\n";
    let service =
        Service::start(&settings(&ground, &format!("{{ exec = [{PRODUCER}] }}"), more), |_, _| {});
    ground.wait_state(ACTIVE, 0);
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(8) {
        ground.hear();
    }
    service.signal("TERM");
    let (status, out, err, _) = service.ended();
    assert_eq!(status, Some(0), "{err}");
    let frames: f64 = out.split(' ').next().unwrap().parse().unwrap();
    let left_out: f64 =
        out.split(" left out").next().unwrap().rsplit(' ').next().unwrap().parse().unwrap();
    // All that were made in these seconds and since the first heartbeat: 20 a second, where the header says 15.
    assert!(frames + left_out > 8.0 * 17.5, "{out}");
    // Their age holds the latency that was given, and nothing piles up.
    let age = median(&out, "exposure to detector");
    assert!((80.0..300.0).contains(&age), "{out}");
}

#[test]
fn a_stream_that_stalls_is_ended_and_started_again() {
    if !has("ffmpeg") {
        return;
    }
    let mut ground = Ground::default();
    let folder = tempfile::tempdir().unwrap();
    let children = folder.path().join("children");
    let made = "ffmpeg -nostdin -v error -re -f lavfi -i testsrc=size=160x120:rate=20:duration=2 -pix_fmt gray \
                -f yuv4mpegpipe -strict -1 -";
    // Its child holds the pipe open and writes nothing more.
    let script = format!(
        "sleep 1000 & echo $! >> {}; {made}; echo out of frames >&2; wait",
        children.display()
    );
    let more = "stream.latency_ms = 0\nstream.timeout_ms = 500\n";
    let service = Service::start(&settings(&ground, &shell(&script), more), |_, _| {});
    ground.wait_state(ACTIVE, 0);
    ground.wait_state(CRITICAL, 0);
    service.wait_log("sh sent no frame for 500 ms; it said: out of frames");
    service.wait_log("sh: out of frames");
    let begun = || fs::read_to_string(&children).unwrap().lines().count();
    wait("it is started again", || begun() >= 2);
    ground.wait_state(ACTIVE, 0);
    // The one that was given up is gone with all that it started.
    let started = fs::read_to_string(&children).unwrap();
    assert!(!runs(started.lines().next().unwrap()));
    service.signal("TERM");
    let start = Instant::now();
    let (status, out, err, _) = service.ended();
    assert_eq!(status, Some(0), "{err}");
    assert!(start.elapsed() < Duration::from_secs(8), "{:?} to its end", start.elapsed());
    assert!(out.contains("source opened"), "{out}");
    let started = fs::read_to_string(&children).unwrap();
    wait("a child outlives the service", || !started.lines().any(runs));
    // Heartbeats came all the while.
    let beats = ground.heard.iter().filter(|(_, _, m)| matches!(m, MavMessage::HEARTBEAT(_)));
    let times: Vec<Instant> = beats.map(|(time, ..)| *time).collect();
    let longest = times.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap();
    assert!(longest < Duration::from_secs(3), "{longest:?} without a heartbeat");
}

#[test]
fn a_program_does_not_outlive_a_killed_service() {
    let ground = Ground::default();
    let script = "echo $$ > FOLDER/leader; sleep 1000 & echo $! > FOLDER/child; wait";
    let more = "stream.latency_ms = 0\n";
    let mut service = Service::start(&settings(&ground, &shell(script), more), |_, _| {});
    let path = service.folder.path().to_path_buf();
    let number = |name: &str| fs::read_to_string(path.join(name)).unwrap_or_default();
    wait("the program starts", || !number("child").trim().is_empty());
    let started = [number("leader"), number("child")];
    assert!(started.iter().all(|process| runs(process)));
    service.child.kill().unwrap();
    wait("a child outlives its parent", || !started.iter().any(|process| runs(process)));
}

#[test]
fn a_decoder_does_not_outlive_a_killed_replay() {
    if !has("ffmpeg") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    // A pipe that nobody writes: the decoder waits for ever.
    let pipe = folder.path().join("video.mkv");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let mut replay = lookout(&["replay", pipe.to_str().unwrap()]).spawn().unwrap();
    let waits = || {
        let list = Command::new("pgrep").args(["-f", pipe.to_str().unwrap()]).output().unwrap();
        String::from_utf8(list.stdout).unwrap().lines().map(str::to_owned).collect::<Vec<_>>()
    };
    // The program, its supervisor and the decoder.
    wait("the decoder starts", || waits().len() >= 3);
    replay.kill().unwrap();
    replay.wait().unwrap();
    wait("the decoder outlives its parent", || waits().is_empty());
}

#[test]
fn a_pipe_is_live_and_never_holds_up_the_end() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe.y4m");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let ground = Ground::default();
    let source = format!("'file:{}'", pipe.display());
    let service = Service::start(&settings(&ground, &source, ""), |_, _| {});
    service.wait_log("is a pipe, live: give stream.latency_ms");
    drop(service);
    if !has("ffmpeg") {
        return;
    }
    let service =
        Service::start(&settings(&ground, &source, "stream.latency_ms = 10\n"), |_, _| {});
    thread::sleep(Duration::from_secs(1));
    let start = Instant::now();
    service.signal("TERM");
    let (status, _, err, _) = service.ended();
    assert_eq!(status, Some(0), "{err}");
    assert!(start.elapsed() < Duration::from_secs(5), "{:?}", start.elapsed());
}

/// A real RTSP server; killed with the test.
struct Server(Child);

impl Server {
    /// `None` where what it needs is not installed.
    fn start(port: u16) -> Option<Self> {
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/rtsp/server.py");
        // Debian's own Python: it has Debian's bindings.
        let child = Command::new("/usr/bin/python3")
            .args([script, &port.to_string()])
            .stdout(Stdio::piped())
            .spawn();
        let Ok(mut child) = child else {
            eprintln!("skipped: no /usr/bin/python3");
            return None;
        };
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let server = Self(child);
        if line.trim() == "ready" {
            return Some(server);
        }
        assert!(line.starts_with("missing"), "{line}");
        eprintln!("skipped: no RTSP server, {}", line.trim());
        None
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn an_rtsp_camera_that_goes_comes_back() {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let Some(server) = Server::start(port) else { return };
    if !has("ffmpeg") {
        return;
    }
    let address = format!("rtsp://me:secret@127.0.0.1:{port}/cam");
    let mut ground = Ground::default();
    let more =
        "stream.latency_ms = 150\nstream.timeout_ms = 1500\n[camera]\nwidth = 320\nheight = 240\n";
    let service = Service::start(&settings(&ground, &format!("'{address}'"), more), |_, _| {});
    // Scaled in the child, in its own shape: 640x360 fits as 320x180.
    service.wait_log("width=320 height=180");
    ground.wait_state(ACTIVE, 0);
    drop(server);
    ground.wait_state(CRITICAL, 0);
    service.wait_log("rtsp://***@127.0.0.1");
    let server = Server::start(port).expect("it was there before");
    ground.wait_state(ACTIVE, 0);
    // Somebody looks what is wrong with it, with the same picture and its true rate.
    let doctor = lookout(&["doctor", "--source", &address, "--seconds", "3"]).output().unwrap();
    let text = String::from_utf8(doctor.stdout).unwrap();
    assert!(doctor.status.success(), "{text}{}", String::from_utf8_lossy(&doctor.stderr));
    assert!(text.contains("640x360") && text.contains("frames a second"), "{text}");
    let rate: f64 =
        text.split(" frames a second").next().unwrap().rsplit(' ').next().unwrap().parse().unwrap();
    assert!((17.0..23.0).contains(&rate), "{text}");
    service.signal("TERM");
    let (status, out, err, _) = service.ended();
    assert_eq!(status, Some(0), "{err}");
    assert!(!err.contains("secret"), "{err}");
    assert!(median(&out, "exposure to detector") >= 150.0, "{out}");
    drop(server);
    // And why there is none.
    let doctor = lookout(&["doctor", "--source", &address, "--seconds", "3"]).output().unwrap();
    let text = String::from_utf8(doctor.stderr).unwrap();
    assert!(!doctor.status.success() && text.contains("Connection refused"), "{text}");
    assert!(!text.contains("secret"), "{text}");
}

fn examples() -> Vec<PathBuf> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/boards/linux/cameras");
    let is_settings = |path: &PathBuf| path.extension().is_some_and(|e| e == "toml");
    listed(Path::new(folder)).into_iter().filter(is_settings).collect()
}

fn example(file: &str) -> String {
    fs::read_to_string(examples().into_iter().find(|path| path.ends_with(file)).unwrap()).unwrap()
}

#[test]
fn the_examples_are_valid_and_explained() {
    let readme = concat!(env!("CARGO_MANIFEST_DIR"), "/boards/linux/cameras/README.md");
    let readme = fs::read_to_string(readme).unwrap();
    assert!(examples().len() >= 8);
    for file in examples() {
        let output = lookout(&["run", "--config", file.to_str().unwrap(), "--print-config"]);
        let output = { output }.output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let name = file.file_name().unwrap().to_str().unwrap();
        assert!(readme.contains(&format!("`{name}`")), "{name} is not in the table");
    }
}

/// The pipelines of the examples run, with a test picture in the place of the camera that is not here.
#[test]
fn the_pipelines_of_the_examples_run() {
    if !has("gst-launch-1.0") {
        return;
    }
    let mut count = 0;
    for (file, camera, other) in [
        ("pi-csi-gstreamer.toml", "libcamerasrc", vec![]),
        // NVIDIA's memory and converter are on its boards alone.
        (
            "jetson-csi.toml",
            "nvarguscamerasrc",
            vec![("(memory:NVMM)", ""), ("nvvidconv", "videoconvertscale")],
        ),
    ] {
        let mut ground = Ground::default();
        let mut text = example(file);
        text = text.replace(&format!("\"{camera}\""), "\"videotestsrc\", \"is-live=true\"");
        for (from, to) in other {
            assert!(text.contains(from), "{from}");
            text = text.replace(from, to);
        }
        text = text.replace("serial:/dev/lookout-autopilot:921600", &ground.link());
        let text = format!("model = '{MODEL}'\nthreads = 1\n{text}");
        let service = Service::start(&text, |_, _| {});
        service.wait_log("frames come");
        service.wait_log(if file.starts_with("pi") { "height=480" } else { "height=360" });
        ground.wait(
            "a frame was looked at",
            |m| matches!(m, MavMessage::HEARTBEAT(h) if h.system_status as u8 >= ACTIVE),
        );
        service.signal("TERM");
        assert_eq!(service.ended().0, Some(0));
        count += 1;
    }
    assert_eq!(count, 2);
}

/// The examples of network cameras, with the address of a real server in the place of the camera's.
#[test]
fn the_network_cameras_of_the_examples_run() {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let Some(_server) = Server::start(port) else { return };
    if !has("ffmpeg") {
        return;
    }
    for (file, address, size) in [
        ("siyi.toml", "192.168.144.25:8554/main.264", "width=640 height=360"),
        ("herelink.toml", "192.168.43.1:8554/fpv_stream", "width=640 height=360"),
        ("mavlink-camera-manager.toml", "127.0.0.1:8554/video_stream_0", "width=640 height=360"),
        ("mediamtx.toml", "127.0.0.1:8554/cam", "width=640 height=360"),
    ] {
        let mut text = example(file);
        let mut ground = Ground::default();
        for (from, to) in [
            (format!("rtsp://{address}"), format!("rtsp://127.0.0.1:{port}/cam")),
            ("serial:/dev/lookout-autopilot:921600".into(), ground.link()),
            ("udpout:127.0.0.1:14550".into(), ground.link()),
        ] {
            text = text.replace(&from, &to);
        }
        assert!(text.contains(&format!(":{port}/cam")), "{file}: {text}");
        let service = Service::start(&format!("model = '{MODEL}'\nthreads = 1\n{text}"), |_, _| {});
        service.wait_log(size);
        ground.wait(
            "a frame was looked at",
            |m| matches!(m, MavMessage::HEARTBEAT(h) if h.system_status as u8 >= ACTIVE),
        );
        service.signal("TERM");
        let (status, out, err, _) = service.ended();
        assert_eq!(status, Some(0), "{file}: {err}");
        // The latency that the example gives is in the age of its frames.
        let given = text.split("latency_ms = ").nth(1).unwrap();
        let given: f64 = given.lines().next().unwrap().parse().unwrap();
        assert!(median(&out, "exposure to detector") >= given, "{file}: {out}");
    }
}

/// Debian's own `libcamerasrc`, unchanged, where no camera is: what it says is the reason that is given.
#[test]
fn libcamera_without_a_camera_says_so() {
    let found = Command::new("gst-inspect-1.0").arg("libcamerasrc").stdout(Stdio::null()).status();
    if !found.is_ok_and(|status| status.success()) {
        eprintln!("skipped: gstreamer1.0-libcamera is not installed");
        return;
    }
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/boards/linux/cameras/pi-csi-gstreamer.toml");
    let output = lookout(&["doctor", "--config", path, "--seconds", "1"]).output().unwrap();
    if output.status.success() {
        // There is one.
        return;
    }
    let text = String::from_utf8(output.stderr).unwrap();
    let last = text.lines().last().unwrap_or_default();
    assert!(last.contains("it said: ERROR") && last.contains("supported camera"), "{text}");
}

/// The program of Raspberry Pi's camera, as far as lookout sees of it: bare frames, here by another program.
#[test]
fn bare_frames_are_taken_as_the_settings_say() {
    if !has("ffmpeg") {
        return;
    }
    let text = example("pi-csi.toml");
    let (head, rest) = text.split_once("source = ").unwrap();
    let (_, rest) = rest.split_once("], raw").unwrap();
    let producer = "\"ffmpeg\", \"-nostdin\", \"-v\", \"error\", \"-re\", \"-f\", \"lavfi\", \"-i\", \
                    \"testsrc=size=640x480:rate=15\", \"-pix_fmt\", \"yuv420p\", \"-f\", \"rawvideo\", \"-\"";
    let mut ground = Ground::default();
    let text = format!("{head}source = {{ exec = [{producer}], raw{rest}")
        .replace("serial:/dev/lookout-autopilot:921600", &ground.link());
    let service = Service::start(&format!("model = '{MODEL}'\n{text}"), |_, _| {});
    service.wait_log("width=640 height=480");
    ground.wait(
        "a frame was looked at",
        |m| matches!(m, MavMessage::HEARTBEAT(h) if h.system_status as u8 >= ACTIVE),
    );
    service.signal("TERM");
    assert_eq!(service.ended().0, Some(0));
}
