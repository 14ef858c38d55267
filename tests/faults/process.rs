//! Logs that cannot be written, threads that panic, signals, sources that hang.

use crate::live::{ACTIVE, Faults, Ground, MODEL, PATIENCE, Run};
use crate::service::{Service, lookout, settings};
use crate::steady;
use lookout::mavlink::dialect::MavMessage;
use lookout::shell::live::source::{CaptureInfo, LiveError, LiveSource};
use lookout::shell::sources::Frame;
use std::fs::{self, File};
use std::io;
use std::os::unix::fs::FileExt;
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// Ends a service by SIGTERM; it does so by itself, at once and well.
fn terminated(service: Service) {
    service.signal("TERM");
    let start = Instant::now();
    let (status, _, err, _) = service.ended();
    assert_eq!(status, Some(0), "{err}");
    assert!(start.elapsed() < Duration::from_secs(4), "{:?}", start.elapsed());
}

/// Has it log a line in its main loop.
fn provoke(service: &Service, ground: &Ground) {
    let file = Service::config(&service.folder);
    fs::write(&file, settings(ground).replace("rate = 15", "rate = 14")).unwrap();
    service.signal("HUP");
    thread::sleep(Duration::from_millis(500));
}

#[test]
fn a_log_on_a_full_disk() {
    let mut ground = Ground::default();
    let service = Service::start(&settings(&ground), |command, _| {
        command.stderr(File::options().write(true).open("/dev/full").unwrap());
    });
    ground.wait_state(ACTIVE, 0);
    provoke(&service, &ground);
    steady(&mut ground, 4);
    terminated(service);
}

#[test]
fn a_log_whose_reader_left() {
    let mut ground = Ground::default();
    let service = Service::start(&settings(&ground), |command, _| {
        let (reader, writer) = io::pipe().unwrap();
        command.stderr(writer);
        drop(reader);
    });
    ground.wait_state(ACTIVE, 0);
    provoke(&service, &ground);
    steady(&mut ground, 4);
    terminated(service);
}

#[test]
fn a_log_whose_reader_stopped() {
    let mut ground = Ground::default();
    let (reader, writer) = io::pipe().unwrap();
    let service = Service::start(&settings(&ground), |command, _| {
        command.stderr(writer);
    });
    ground.wait_state(ACTIVE, 0);
    // More than a pipe holds: a broken file is a line, however often.
    let file = Service::config(&service.folder);
    fs::write(&file, format!("{} = 1\n", "x".repeat(20_000))).unwrap();
    for _ in 0..12 {
        service.signal("HUP");
        thread::sleep(Duration::from_millis(60));
    }
    steady(&mut ground, 4);
    terminated(service);
    drop(reader);
}

/// A source that panics after some frames.
struct Panics(u32);

impl LiveSource for Panics {
    fn next(&mut self, frame: &mut Frame, _: Duration) -> Result<CaptureInfo, LiveError> {
        thread::sleep(Duration::from_millis(20));
        self.0 += 1;
        assert!(self.0 < 20, "as meant");
        (frame.width, frame.height) = (64, 48);
        frame.pixels.resize(64 * 48, 0);
        Ok(CaptureInfo::default())
    }
}

#[test]
fn a_panic_of_a_thread_ends_all() {
    let ground = Ground::default();
    let text = format!("links = ['{}']\nmodel = '{MODEL}'\nthreads = 1\n", ground.link());
    let run = Run::start(&text, Box::new(|_, _| Ok(Box::new(Panics(0)))), Faults::default());
    let start = Instant::now();
    while !run.is_finished() {
        assert!(start.elapsed() < PATIENCE, "the others go on");
        thread::sleep(Duration::from_millis(20));
    }
    assert!(run.panicked());
}

#[test]
fn a_source_that_hangs_can_be_ended() {
    let mut ground = Ground::default();
    let text = settings(&ground).replace("simulate:hover", "file:FOLDER/pipe.y4m");
    let service = Service::start(&text, |_, folder| {
        assert!(Command::new("mkfifo").arg(folder.join("pipe.y4m")).status().unwrap().success());
    });
    // It is alive, and says that there are no frames yet.
    ground.wait_state(1, 0);
    service.signal("TERM");
    let start = Instant::now();
    service.ended();
    assert!(start.elapsed() < Duration::from_secs(8), "{:?}", start.elapsed());
}

/// A file that is broken in the middle ends the program with a status; the ground is told of it, as of SIGTERM.
#[test]
fn the_end_is_announced() {
    for broken in [true, false] {
        let mut ground = Ground::default();
        let text = settings(&ground);
        let text =
            if broken { text.replace("simulate:hover", "file:FOLDER/cut.y4m") } else { text };
        let service = Service::start(&text, |_, folder| {
            let frame = [&b"FRAME\n"[..], &[90; 160 * 120]].concat();
            let stream = [b"YUV4MPEG2 W160 H120 F15:1 Cmono\n", &frame.repeat(30)[..]].concat();
            fs::write(folder.join("cut.y4m"), &stream[..stream.len() - 99]).unwrap();
        });
        if !broken {
            ground.wait_state(ACTIVE, 0);
            service.signal("TERM");
        }
        ground.wait_text("ended, traffic is not watched");
        let mut states = ground.heard.iter().filter_map(|(_, _, message)| match message {
            MavMessage::HEARTBEAT(data) => Some(data.system_status as u8),
            _ => None,
        });
        const POWEROFF: u8 = 7;
        assert_eq!(states.next_back(), Some(POWEROFF));
        assert_eq!(service.ended().0, Some(i32::from(broken)));
    }
}

/// Where the service manager gives 512 MB, more would end and restart it for ever.
#[test]
fn frames_too_large_for_the_memory_are_refused() {
    let ground = Ground::default();
    let text = settings(&ground).replace("simulate:hover", "file:FOLDER/large.y4m");
    let service = Service::start(&text, |_, folder| {
        let file = File::create_new(folder.join("large.y4m")).unwrap();
        let head = b"YUV4MPEG2 W8000 H6000 F5:1 Cmono\nFRAME\n";
        file.write_all_at(head, 0).unwrap();
        file.set_len(head.len() as u64 + 8000 * 6000).unwrap();
    });
    let (status, _, err, _) = service.ended();
    assert_eq!(status, Some(1), "{err}");
    assert!(err.contains("8000x6000: the detector would take 13"), "{err}");
}

#[test]
fn a_hundred_reloads_good_and_bad() {
    let mut ground = Ground::default();
    let good = settings(&ground);
    let service = Service::start(&good, |_, _| {});
    ground.wait_state(ACTIVE, 0);
    let file = Service::config(&service.folder);
    for round in 0..100 {
        let text = match round % 4 {
            0 => "source =".into(),
            1 => good.replace("rate = 15", "rate = 0"),
            2 => good.replace("hover", "crossing"),
            _ => good.clone(),
        };
        fs::write(&file, text).unwrap();
        service.signal("HUP");
        thread::sleep(Duration::from_millis(20));
    }
    ground.wait_state(ACTIVE, 0);
    steady(&mut ground, 3);
    terminated(service);
}

#[test]
fn settings_that_never_end_are_refused() {
    for device in ["/dev/full", "/dev/zero", "/dev"] {
        let output = lookout(&["run", "--config", device]).stdin(Stdio::null()).output().unwrap();
        assert_eq!(output.status.code(), Some(1));
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(text.contains("not a regular file"), "{text}");
    }
}
