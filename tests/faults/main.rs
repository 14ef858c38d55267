//! Faults of the running service: what it survives, and what it says of it. SECURITY.md has the table.
#![cfg(all(feature = "std", target_os = "linux"))]

#[allow(dead_code, reason = "frames alone are drawn")]
#[path = "../common/golden.rs"]
mod golden;
#[allow(dead_code, reason = "every test binary uses a part of it")]
#[path = "../common/live.rs"]
mod live;
#[allow(dead_code, reason = "every test binary uses a part of it")]
#[path = "../common/service.rs"]
mod service;

mod disk;
mod links;
mod page;
mod process;
mod signing;
mod system;

use live::{Ground, PATIENCE};
use std::net::TcpListener;
use std::time::{Duration, Instant};

/// Hears heartbeats without a gap: one a second, on a machine that is busy with other tests. Nothing that comes meanwhile
/// is out of date.
fn steady(ground: &mut Ground, seconds: u64) {
    // Messages that came while the test did something else have waited here, not there.
    ground.drain();
    let before = ground.heard.len();
    let (count, longest) = ground.beats(Duration::from_secs(seconds));
    let spread = ground.spread(before);
    assert!(spread < Duration::from_millis(1500), "messages that waited for {spread:?}");
    assert!(count as u64 + 1 >= seconds, "{count} heartbeats in {seconds} s");
    assert!(longest < Duration::from_secs(2), "{longest:?} without a heartbeat");
}

/// Sends bytes to the service: it listens where it speaks from.
fn link_to(ground: &mut Ground, bytes: &[u8]) {
    // One that ran before may have left messages.
    ground.drain();
    let start = Instant::now();
    while ground.hear().is_none() {
        assert!(start.elapsed() < PATIENCE, "it is silent");
    }
    ground.socket.send_to(bytes, ground.from.unwrap()).unwrap();
}

/// A port that nobody has; another may take it before we do, which the test then shows.
fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}
