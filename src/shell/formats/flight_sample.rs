//! Attitude and position of the vehicle from an autopilot's log, and why a log cannot be read.

use super::tlog::TlogError;
use crate::mavlink::dialect::{ATTITUDE_QUATERNION_DATA, GLOBAL_POSITION_INT_DATA};
use crate::mavlink::messages::Payload;
use std::io;
use std::path::PathBuf;

/// Why a log cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum FlightLogError {
    /// A telemetry log.
    #[error(transparent)]
    Tlog(#[from] TlogError),
    /// The file cannot be read.
    #[error("{}: {source}", path.display())]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// An autopilot's log that holds nothing of the flight.
    #[error("{}: no {wanted} in this log; give a log of a flight", path.display())]
    Nothing {
        /// Path of the file.
        path: PathBuf,
        /// The records that were looked for.
        wanted: &'static str,
    },
}

/// Attitude or position of the vehicle at one time of the autopilot's clock, microseconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FlightSample {
    /// Rotation from body (forward, right, down) to north, east, down: unit quaternion w, x, y, z.
    Attitude {
        /// Time of measurement.
        time_us: i64,
        /// Rotation from body to north, east, down: w, x, y, z.
        quaternion: [f64; 4],
    },
    /// Position and velocity.
    Position {
        /// Time of measurement.
        time_us: i64,
        /// Latitude and longitude in degrees, altitude above mean sea level in metres.
        place: [f64; 3],
        /// North, east, down in m/s.
        velocity: [f64; 3],
    },
}

/// Latest time of a log, microseconds: 285 years, up to which an f64 holds every whole number.
const LATEST_US: f64 = (1u64 << 53) as f64;

impl FlightSample {
    /// A time as it stands in a log, in microseconds; none where it is no time.
    pub fn time(us: f64) -> Option<i64> {
        (0.0..LATEST_US).contains(&us).then_some(us as i64)
    }

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

    /// The message that a telemetry log would hold.
    pub fn payload(&self) -> Payload {
        let boot_ms = |us: i64| (us / 1000).clamp(0, u32::MAX.into()) as u32;
        match *self {
            Self::Attitude { time_us, quaternion } => {
                let [q1, q2, q3, q4] = quaternion.map(|v| v as f32);
                let time_boot_ms = boot_ms(time_us);
                let rest = ATTITUDE_QUATERNION_DATA::default();
                Payload::new(&ATTITUDE_QUATERNION_DATA { time_boot_ms, q1, q2, q3, q4, ..rest })
            }
            Self::Position { time_us, place, velocity } => {
                let [lat, lon, alt] = place;
                let [lat, lon] = [lat, lon].map(|degrees| (degrees * 1e7).round() as i32);
                let [vx, vy, vz] = velocity.map(|v| (v * 100.0).round() as i16);
                Payload::new(&GLOBAL_POSITION_INT_DATA {
                    time_boot_ms: boot_ms(time_us),
                    lat,
                    lon,
                    alt: (alt * 1000.0).round() as i32,
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
