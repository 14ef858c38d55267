//! Signed frames that are played back, reordered, or not signed at all.

use crate::link_to;
use crate::live::{ACTIVE, Ground};
use crate::service::{Service, settings};
use lookout::mavlink::dialect::{MavMessage, MavParamType, PARAM_SET_DATA};
use lookout::mavlink::messages::Payload;
use lookout::shell::link::signing::{self, Signing};
use mavlink_core::types::CharArray;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::{Duration, Instant};

pub const KEY: [u8; 32] = [0x5a; 32];

/// Puts the key into a folder.
pub fn prepare(folder: &Path) {
    let key = folder.join("key");
    fs::write(&key, "5a".repeat(32)).unwrap();
    fs::set_permissions(&key, fs::Permissions::from_mode(0o600)).unwrap();
}

/// PARAM_SET of the wingspan to the lookout, signed as over this link where there is a signature.
pub fn set(value: f32, signing: Option<(&mut Signing, u8)>) -> Vec<u8> {
    let data = PARAM_SET_DATA {
        param_value: value,
        target_system: 1,
        target_component: 196,
        param_id: CharArray::from("LK_WINGSPAN"),
        param_type: MavParamType::MAV_PARAM_TYPE_REAL32,
    };
    let mut frame = Payload::new(&data).frame(255, 190, 0, signing.is_some());
    if let Some((signing, link)) = signing {
        signing.sign(&mut frame, link, signing::clock());
    }
    frame.raw_bytes().into()
}

/// Time of the signature at the end of a frame, tens of microseconds since 2015.
pub fn time(frame: &[u8]) -> u64 {
    let mut stamp = [0; 8];
    stamp[..6].copy_from_slice(&frame[frame.len() - 12..frame.len() - 6]);
    u64::from_le_bytes(stamp)
}

/// Waits for the echo of a value.
pub fn echoed(ground: &mut Ground, value: f32) {
    ground.wait(
        &format!("wingspan {value}"),
        |m| matches!(m, MavMessage::PARAM_VALUE(p) if p.param_value == value),
    );
}

/// Sends frames that must be refused, then a new one that sets `value`.
fn only_the_last_is_taken(
    ground: &mut Ground,
    refused: &[&Vec<u8>],
    value: f32,
    peer: &mut Signing,
) {
    for frame in refused {
        link_to(ground, frame);
    }
    let heard = ground.heard.len();
    link_to(ground, &set(value, Some((peer, 1))));
    echoed(ground, value);
    let echoes = ground.heard[heard..].iter().filter(|h| matches!(h.2, MavMessage::PARAM_VALUE(_)));
    assert_eq!(echoes.count(), 1, "only the new one was taken");
}

#[test]
fn a_restart_makes_no_old_command_valid() {
    let mut ground = Ground::default();
    let text = format!(
        "system_id = 1\nsigning_key = 'FOLDER/key'\nparameters = 'FOLDER/parameters'\n{}",
        // Nothing else is received: the commands alone show how far the times have come.
        settings(&ground).replace("simulate:hover", "simulate:none")
    );
    let service = Service::start(&text, |_, folder| prepare(folder));
    ground.wait_state(ACTIVE, 0);
    let mut theirs = Signing::new(KEY, None, signing::clock()).unwrap();
    let frames = [3.0, 2.0].map(|value| (value, set(value, Some((&mut theirs, 1)))));
    for (value, frame) in &frames {
        link_to(&mut ground, frame);
        echoed(&mut ground, *value);
    }
    let unsigned = set(9.0, None);
    // Repeated, and in another order.
    only_the_last_is_taken(&mut ground, &[&frames[1].1, &frames[0].1, &unsigned], 2.5, &mut theirs);
    // Kept within moments, by a thread.
    let file = service.folder.path().join("parameters");
    let kept = |file: &Path| fs::read_to_string(file).unwrap_or_default();
    let start = Instant::now();
    while !kept(&file).contains("LK_WINGSPAN 2.5\n") {
        assert!(start.elapsed() < Duration::from_secs(10), "{}", kept(&file));
    }
    let newest = time(&frames[1].1);
    let is_known = |line: &str| {
        let time = line.strip_prefix("255 190 1 ").and_then(|time| time.parse::<u64>().ok());
        time.is_some_and(|time| time > newest)
    };
    while !kept(&service.folder.path().join("key.time")).lines().any(is_known) {
        assert!(start.elapsed() < Duration::from_secs(10));
    }
    let folder = service.kill();
    let service = Service::start_in(folder, &text, |_, _| {});
    ground.wait_state(ACTIVE, 0);
    only_the_last_is_taken(&mut ground, &[&frames[0].1, &frames[1].1, &unsigned], 4.0, &mut theirs);
    drop(service);
}

#[test]
fn a_key_that_everybody_can_read_is_refused() {
    let ground = Ground::default();
    let text = format!("signing_key = 'FOLDER/key'\n{}", settings(&ground));
    let service = Service::start(&text, |_, folder| {
        prepare(folder);
        fs::set_permissions(folder.join("key"), fs::Permissions::from_mode(0o644)).unwrap();
    });
    let (status, _, err, _) = service.ended();
    assert_eq!(status, Some(1));
    assert!(err.contains("every user of this machine can read the key"), "{err}");
}
