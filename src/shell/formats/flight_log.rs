//! The vehicle's log of a flight, in any of the three forms: a telemetry log, ArduPilot's DataFlash, PX4's ULog.
//!
//! The form is that of the first bytes. Attitude and position of the autopilots' own logs become the MAVLink messages
//! that a telemetry log would hold, from system 1, with a heartbeat a second, so that all that follows is the same.

use super::timeline::Timeline;
use super::tlog::{Reader, TlogError};
use super::{dataflash, ulog};
use crate::mavlink::dialect::{
    ATTITUDE_QUATERNION_DATA, GLOBAL_POSITION_INT_DATA, HEARTBEAT_DATA, MavAutopilot, MavModeFlag,
    MavState, MavType,
};
use crate::mavlink::messages::Payload;
use mavlink_core::MAVLinkMessageRaw;
use std::boxed::Box;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::vec::Vec;

/// Longest log that is read into memory, bytes.
const LONGEST: u64 = 4 << 30;
/// From one heartbeat to the next, microseconds.
const BEAT_US: i64 = 1_000_000;

/// Why a log cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum FlightLogError {
    /// A telemetry log.
    #[error(transparent)]
    Tlog(#[from] TlogError),
    /// The file cannot be read.
    #[error("{}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// An autopilot's log that holds nothing of the flight.
    #[error("{}: no {wanted} in this log; give a log of a flight", path.display())]
    Nothing {
        /// The file.
        path: PathBuf,
        /// The records that were looked for.
        wanted: &'static str,
    },
}

/// Attitude or position of the vehicle at one time of the autopilot's clock, microseconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sample {
    /// Rotation from body (forward, right, down) to north, east, down: unit quaternion w, x, y, z.
    Attitude {
        /// When.
        time_us: i64,
        /// The quaternion.
        quaternion: [f64; 4],
    },
    /// Place and velocity.
    Position {
        /// When.
        time_us: i64,
        /// Latitude and longitude in degrees, altitude above mean sea level in metres.
        place: [f64; 3],
        /// North, east, down in m/s.
        velocity: [f64; 3],
    },
}

impl Sample {
    /// From roll, pitch and yaw in radians, applied in the order yaw, pitch, roll.
    pub fn from_euler(time_us: i64, [roll, pitch, yaw]: [f64; 3]) -> Self {
        let ((sr, cr), (sp, cp), (sy, cy)) =
            ((roll / 2.0).sin_cos(), (pitch / 2.0).sin_cos(), (yaw / 2.0).sin_cos());
        let quaternion = [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ];
        Self::Attitude { time_us, quaternion }
    }

    /// When it was measured.
    pub fn time_us(&self) -> i64 {
        match self {
            Self::Attitude { time_us, .. } | Self::Position { time_us, .. } => *time_us,
        }
    }

    fn payload(&self) -> Payload {
        let boot_ms = |us: i64| (us / 1000).clamp(0, u32::MAX.into()) as u32;
        match *self {
            Self::Attitude { time_us, quaternion } => {
                let [q1, q2, q3, q4] = quaternion.map(|v| v as f32);
                let time_boot_ms = boot_ms(time_us);
                let rest = ATTITUDE_QUATERNION_DATA::default();
                Payload::new(&ATTITUDE_QUATERNION_DATA { time_boot_ms, q1, q2, q3, q4, ..rest })
            }
            Self::Position { time_us, place, velocity } => {
                let [lat, lon] = [place[0], place[1]].map(|degrees| (degrees * 1e7).round() as i32);
                let [vx, vy, vz] = velocity.map(|v| (v * 100.0).round() as i16);
                Payload::new(&GLOBAL_POSITION_INT_DATA {
                    time_boot_ms: boot_ms(time_us),
                    lat,
                    lon,
                    alt: (place[2] * 1000.0).round() as i32,
                    vx,
                    vy,
                    vz,
                    hdg: u16::MAX,
                    ..GLOBAL_POSITION_INT_DATA::default()
                })
            }
        }
    }
}

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
    let read: fn(&Path, &[u8]) -> Result<Vec<Sample>, FlightLogError> = match &start[..] {
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
fn messages(samples: &[Sample], autopilot: MavAutopilot) -> Vec<(i64, MAVLinkMessageRaw)> {
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
