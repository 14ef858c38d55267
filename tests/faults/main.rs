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
mod process;
mod signing;

use live::Ground;
use std::time::Duration;

/// Hears heartbeats without a gap: one a second, on a machine that is busy with other tests.
fn steady(ground: &mut Ground, seconds: u64) {
    let (count, longest) = ground.beats(Duration::from_secs(seconds));
    assert!(count as u64 + 1 >= seconds, "{count} heartbeats in {seconds} s");
    assert!(longest < Duration::from_secs(2), "{longest:?} without a heartbeat");
}
