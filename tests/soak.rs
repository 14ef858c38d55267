//! Hours in seconds: many small frames at full speed, and the memory stays as it is.
//!
//! LOOKOUT_SOAK=SECONDS runs longer than by default. Alone in its program: the memory of a process is measured.
#![cfg(all(feature = "std", target_os = "linux"))]

#[allow(dead_code, reason = "frames alone are drawn")]
#[path = "common/golden.rs"]
mod golden;
#[allow(dead_code, reason = "every test binary uses a part of it")]
#[path = "common/live.rs"]
mod live;

use live::{Faults, Ground, MODEL, Run, drawn};
use std::time::{Duration, Instant};
use std::{env, fs, thread};

/// Resident memory of this process in kilobytes.
fn resident() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

#[test]
fn memory_stays_flat() {
    let seconds = env::var("LOOKOUT_SOAK").map_or(5, |text| text.parse().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let mut ground = Ground::default();
    ground.socket.set_nonblocking(true).unwrap();
    let faults = Faults::default();
    let open = drawn((64, 48), Duration::from_micros(100), u32::MAX, &faults);
    let text = format!(
        "links = ['{}']\nmodel = '{MODEL}'\nthreads = 1\nevent_log = '{}'\nevent_log_megabytes = 1\n",
        ground.link(),
        folder.path().display()
    );
    let start = Instant::now();
    let run = Run::start(&text, open, faults);
    let mut series = Vec::new();
    while start.elapsed() < Duration::from_secs(seconds) {
        while ground.hear().is_some() {}
        ground.heard.clear();
        series.push(resident());
        thread::sleep(Duration::from_millis(20));
    }
    let summary = run.stop();
    // Warm after a quarter.
    let (warm, rest) = (series[series.len() / 4], &series[series.len() / 4..]);
    let most = rest.iter().max().unwrap();
    println!(
        "{} frames looked at, {} left out, {:.1} s; {warm} kB after a quarter, {most} kB at most afterwards",
        summary.frames,
        summary.dropped,
        start.elapsed().as_secs_f64()
    );
    assert!(summary.frames > 100, "{} frames", summary.frames);
    assert!(most.saturating_sub(warm) < 1500, "{warm} kB grew to {most} kB");
}
