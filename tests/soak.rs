//! Hours in seconds: many small frames at full speed, and the memory stays as it is.
//!
//! `LOOKOUT_SOAK=1000000:64x48,100000:640x480 cargo test --release --test soak -- --nocapture` runs the whole service, with
//! links, recording and event log, for so many frames of each size, one after the other: 300 of 64x48 by default, which is
//! the size where none is given. Alone in its program: the memory of a process is measured.
#![cfg(all(feature = "std", target_os = "linux"))]

#[allow(dead_code, reason = "frames alone are drawn")]
#[path = "common/golden.rs"]
mod golden;
#[allow(dead_code, reason = "every test binary uses a part of it")]
#[path = "common/live.rs"]
mod live;

use live::{Faults, Ground, MODEL, PATIENCE, Run, drawn};
use lookout::mavlink::dialect::MavMessage;
use std::net::TcpListener;
use std::time::{Duration, Instant};
use std::{env, fs, thread};

/// Resident memory of this process in kilobytes.
fn resident() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

/// Open files of this process.
fn files() -> usize {
    fs::read_dir("/proc/self/fd").unwrap().count()
}

#[test]
fn memory_stays_flat() {
    let runs = env::var("LOOKOUT_SOAK").unwrap_or("300".into());
    for run in runs.split(',') {
        let (frames, size) = run.split_once(':').unwrap_or((run, "64x48"));
        let (width, height) = size.split_once('x').unwrap();
        soak(frames.parse().unwrap(), (width.parse().unwrap(), height.parse().unwrap()));
    }
}

/// Runs the service for `wanted` frames of this width and height.
fn soak(wanted: u32, size: (usize, usize)) {
    let folder = tempfile::tempdir().unwrap();
    let mut ground = Ground::default();
    ground.socket.set_nonblocking(true).unwrap();
    let faults = Faults::default();
    // Faster than the detector, so that frames are left out as well.
    let open = drawn(size, Duration::from_millis(1), u32::MAX, &faults);
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let text = format!(
        "links = ['{}', 'udpin:127.0.0.1:{port}', 'tcpin:127.0.0.1:{port}']\nmodel = '{MODEL}'\nthreads = 1\n\
         event_log = '{1}/log'\nevent_log_megabytes = 1\n\
         record = '{1}/record'\nrecord_minutes = 1\nrecord_megabytes = 30\n",
        ground.link(),
        folder.path().display()
    );
    let start = Instant::now();
    let run = Run::start(&text, open, faults);
    // The rates that are sent, each for the time since the one before, add up to the frames processed.
    let (mut frames, mut last) = (0.0, Instant::now());
    let (mut first, mut warm, mut most) = (None, None, 0);
    let (mut warm_files, mut most_files) = (None, 0);
    while frames < f64::from(wanted) {
        while let Some(message) = ground.hear() {
            if let MavMessage::NAMED_VALUE_FLOAT(value) = message
                && value.name.to_str().unwrap() == "LK_FPS"
            {
                frames += f64::from(value.value) * last.elapsed().as_secs_f64();
                last = Instant::now();
            }
        }
        ground.heard.clear();
        assert!(last.elapsed() < PATIENCE, "it is silent after {frames} frames");
        if frames > 0.0 {
            first.get_or_insert_with(resident);
        }
        // Warm after a quarter.
        if frames > f64::from(wanted) / 4.0 {
            warm.get_or_insert_with(resident);
            most = most.max(resident());
            warm_files.get_or_insert_with(files);
            most_files = most_files.max(files());
        }
        thread::sleep(Duration::from_millis(20));
    }
    let (last, summary) = (resident(), run.stop());
    let (first, warm, warm_files) = (first.unwrap(), warm.unwrap(), warm_files.unwrap());
    println!(
        "{}x{}: {} frames looked at, {} left out, {:.1} s; {first} kB at first, {warm} kB after a quarter, {most} kB at most \
         afterwards, {last} kB at last; {warm_files} files after a quarter, {most_files} at most",
        size.0,
        size.1,
        summary.frames,
        summary.dropped,
        start.elapsed().as_secs_f64()
    );
    assert!(summary.frames as f64 > f64::from(wanted) / 2.0, "{} frames", summary.frames);
    // The queue to the disk varies by some frames.
    let frame = (size.0 * size.1 / 1024) as u64;
    assert!(most.saturating_sub(warm) < 1500 + 30 * frame, "{warm} kB grew to {most} kB");
    // The files of a segment that ends and of the one that begins, and a picture.
    assert!(most_files <= warm_files + 8, "{warm_files} files grew to {most_files}");
}
