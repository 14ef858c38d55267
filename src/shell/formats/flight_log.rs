//! The vehicle's log of a flight, in any of the three forms: a telemetry log, ArduPilot's DataFlash, PX4's ULog.
//!
//! The form is that of the first bytes. Attitude and position of the autopilots' own logs become the MAVLink messages
//! that a telemetry log would hold, from system 1, with a heartbeat a second, so that all that follows is the same.

use super::flight_sample::{FlightLogError, FlightSample};
use super::timeline::Timeline;
use super::tlog::Reader;
use super::{dataflash, ulog};
use crate::mavlink::dialect::{HEARTBEAT_DATA, MavAutopilot, MavModeFlag, MavState, MavType};
use crate::mavlink::messages::Payload;
use mavlink_core::MAVLinkMessageRaw;
use std::boxed::Box;
use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::vec::Vec;

/// Longest log that is read into memory, bytes.
const LONGEST: u64 = 4 << 30;
/// From one heartbeat to the next, microseconds.
const BEAT_US: i64 = 1_000_000;

/// Messages and the times of their receipt in microseconds, in the log's order.
pub type Messages = Box<dyn Iterator<Item = Result<(i64, MAVLinkMessageRaw), FlightLogError>>>;

/// Opens a log.
///
/// # Errors
/// [`FlightLogError`]; telemetry logs are read on the way, and may fail later.
pub fn open(path: &Path) -> Result<Messages, FlightLogError> {
    let failed = |source| FlightLogError::Read { path: path.into(), source };
    let mut start = Vec::new();
    let mut file = File::open(path).map_err(failed)?;
    file.by_ref().take(ulog::MAGIC.len() as u64).read_to_end(&mut start).map_err(failed)?;
    let read: fn(&Path, &[u8]) -> Result<Vec<FlightSample>, FlightLogError> = match start.as_slice()
    {
        start if start.starts_with(&dataflash::MAGIC) => dataflash::read,
        start if *start == ulog::MAGIC => ulog::read,
        _ => {
            let records = Reader::open(path)?;
            let messages =
                records.map(|record| Ok((record.as_ref().map_or(0, |r| r.time_us), record?.raw())));
            return Ok(Box::new(Timeline::new(messages)));
        }
    };
    file.take(LONGEST).read_to_end(&mut start).map_err(failed)?;
    let autopilot = match start.starts_with(&ulog::MAGIC) {
        true => MavAutopilot::MAV_AUTOPILOT_PX4,
        false => MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA,
    };
    let messages = messages(&read(path, &start)?, autopilot);
    Ok(Box::new(Timeline::new(messages.into_iter().map(Ok))))
}

/// The messages of samples, with heartbeats.
fn messages(samples: &[FlightSample], autopilot: MavAutopilot) -> Vec<(i64, MAVLinkMessageRaw)> {
    let mut all = Vec::new();
    let mut sequence = 0u8;
    let mut beat_us = None;
    let mut add = |time_us: i64, payload: &Payload| {
        all.push((time_us, MAVLinkMessageRaw::V2(payload.frame(1, 1, sequence, false))));
        sequence = sequence.wrapping_add(1);
    };
    let heartbeat = Payload::new(&HEARTBEAT_DATA {
        custom_mode: 0,
        mavtype: MavType::MAV_TYPE_GENERIC,
        autopilot,
        base_mode: MavModeFlag::empty(),
        system_status: MavState::MAV_STATE_ACTIVE,
        mavlink_version: 3,
    });
    for sample in samples {
        let time_us = sample.time_us();
        if beat_us.is_none_or(|last: i64| !(0..BEAT_US).contains(&(time_us - last))) {
            beat_us = Some(time_us);
            add(time_us, &heartbeat);
        }
        add(time_us, &sample.payload());
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mavlink::dialect::MavMessage;
    use mavlink_core::Message;
    use std::fs;
    use std::string::ToString;

    fn of(bytes: &[u8]) -> Vec<(i64, MavMessage)> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        fs::write(&path, bytes).unwrap();
        let messages = open(&path).unwrap().map(Result::unwrap);
        messages
            .map(|(time, raw)| {
                let message = MavMessage::parse(raw.version(), raw.message_id(), raw.payload());
                (time, message.unwrap())
            })
            .collect()
    }

    #[test]
    fn both_autopilots_logs_become_telemetry() {
        let logs = [dataflash::tests::log(), ulog::tests::log()];
        for (bytes, kind) in logs.into_iter().zip([3, 12]) {
            let messages = of(&bytes);
            let count = |id| messages.iter().filter(|(_, m)| m.message_id() == id).count();
            assert_eq!(count(0), 5, "heartbeats");
            assert!(count(31) >= 50 && count(33) == 50);
            let MavMessage::HEARTBEAT(beat) = &messages[0].1 else { panic!("{messages:?}") };
            assert_eq!(beat.autopilot as u8, kind);
            let (time, MavMessage::GLOBAL_POSITION_INT(place)) = &messages[2] else {
                panic!("{messages:?}")
            };
            assert_eq!((*time, place.time_boot_ms), (5_000_000, 5000));
            assert_eq!((place.lat, place.lon, place.alt), (473_769_000, 85_417_000, 512_500));
            assert_eq!((place.vx, place.vy, place.vz), (300, 400, -50));
        }
    }

    #[test]
    fn a_log_that_is_none_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.txt");
        fs::write(&path, "no log at all").unwrap();
        let error = open(&path).unwrap().next().unwrap().err().unwrap().to_string();
        assert!(error.contains("log.txt: bytes 0 to 13: no MAVLink message"), "{error}");
        let error = open(Path::new("/nowhere/x.bin")).err().unwrap().to_string();
        assert!(error.starts_with("/nowhere/x.bin: "), "{error}");
    }
}
