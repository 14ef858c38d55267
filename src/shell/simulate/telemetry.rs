//! Telemetry of the simulated vehicle, as a multirotor with ArduPilot sends it.
//!
//! The camera looks straight ahead: its z is the body's forward, its x the body's right, its y down. The simulated
//! world has the camera's axes at rest: z north, x east, y down. Both change axes in the same cyclic way, so that
//! `Ry(yaw) Rx(pitch) Rz(roll)` of the camera is `Rz(yaw) Ry(pitch) Rx(roll)` of the body: the three angles of MAVLink's
//! ATTITUDE, unchanged.

use super::attitude::CameraPath;
use super::encounter::encounter;
use super::{FOCAL, SimulateSettings};
use crate::mavlink::dialect::{
    ATTITUDE_DATA, ATTITUDE_QUATERNION_DATA, GLOBAL_POSITION_INT_DATA, HEARTBEAT_DATA,
    MavAutopilot, MavMessage, MavModeFlag, MavState, MavType, SYSTEM_TIME_DATA,
};
use crate::shell::sources::frame_time_us;
use crate::shell::support::random::Random;
use crate::shell::support::vectors::{WorldVector, sin_cos};
use mavlink_core::{MAVLinkV2MessageRaw, MavHeader};

/// When the first frame of a simulated flight is taken, microseconds since 1970: the first moment of 2026, UTC.
pub const START_US: i64 = 1_767_225_600_000_000;
/// Time from the autopilot's start to the first frame, milliseconds.
const UPTIME_MS: u32 = 60_000;
/// Where the flight begins, degrees.
const LATITUDE: f64 = 47.0;
const LONGITUDE: f64 = 8.0;
/// The ground above the sea, metres.
const GROUND: f64 = 500.0;
/// Metres a degree of latitude on a sphere with the equator's radius of WGS 84.
const DEGREE: f64 = 111_319.490_793;
/// Microseconds from one attitude to the next: 50 a second.
const TICK_US: i64 = 20_000;
/// In how many ticks heartbeat and time, position, and ATTITUDE beside the quaternion are sent once.
const SECOND: u64 = 50;
const POSITION: u64 = 10;
const ANGLES: u64 = 5;
/// Telemetry after the last frame, microseconds.
const AFTER_US: i64 = 100_000;

/// The messages of a flight in order, from the first frame to shortly after the last, each as a frame of system 1,
/// component 1, with its time in microseconds since the first video frame.
#[derive(Debug, Clone)]
pub struct FlightTelemetry {
    camera: CameraPath,
    end_us: i64,
    tick: u64,
    /// Which of the tick's messages is next.
    slot: usize,
    sequence: u8,
}

impl FlightTelemetry {
    /// The telemetry of the flight that `settings` describe.
    pub fn of(settings: &SimulateSettings) -> Self {
        let settings = settings.limited();
        let focal = f64::from(settings.width) * FOCAL;
        let (camera, _, _) = encounter(&settings, focal, &mut Random::stream(settings.seed, 0));
        Self::new(&camera, &settings)
    }

    /// The telemetry of a camera's flight.
    fn new(camera: &CameraPath, settings: &SimulateSettings) -> Self {
        let last = frame_time_us(settings.frames() - 1, (settings.fps, 1));
        let end_us = last.saturating_add(AFTER_US);
        Self { camera: camera.clone(), end_us, tick: 0, slot: 0, sequence: 0 }
    }
}

impl Iterator for FlightTelemetry {
    type Item = (i64, MAVLinkV2MessageRaw);

    fn next(&mut self) -> Option<Self::Item> {
        type Build = fn(&CameraPath, f64, u32) -> MavMessage;
        const SLOTS: [(u64, Build); 5] = [
            (SECOND, |_, _, _| heartbeat()),
            (SECOND, |_, time, boot| system_time(time, boot)),
            (POSITION, position),
            (1, quaternion),
            (ANGLES, angles),
        ];
        loop {
            let time_us = i64::try_from(self.tick).ok()?.checked_mul(TICK_US)?;
            if time_us > self.end_us {
                return None;
            }
            let Some((every, build)) = SLOTS.get(self.slot) else {
                self.slot = 0;
                self.tick += 1;
                continue;
            };
            self.slot += 1;
            if self.tick.is_multiple_of(*every) {
                let boot = UPTIME_MS.wrapping_add((time_us / 1000) as u32);
                let message = build(&self.camera, time_us as f64 / 1e6, boot);
                let header = MavHeader { system_id: 1, component_id: 1, sequence: self.sequence };
                self.sequence = self.sequence.wrapping_add(1);
                let mut raw = MAVLinkV2MessageRaw::new();
                raw.serialize_message(header, &message);
                return Some((time_us, raw));
            }
        }
    }
}

fn heartbeat() -> MavMessage {
    MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        // Loiter, mode 5 of ArduCopter.
        custom_mode: 5,
        mavtype: MavType::MAV_TYPE_QUADROTOR,
        autopilot: MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA,
        base_mode: MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            | MavModeFlag::MAV_MODE_FLAG_STABILIZE_ENABLED
            | MavModeFlag::MAV_MODE_FLAG_GUIDED_ENABLED
            | MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED,
        system_status: MavState::MAV_STATE_ACTIVE,
        mavlink_version: 3,
    })
}

fn system_time(time: f64, time_boot_ms: u32) -> MavMessage {
    let time_unix_usec = START_US as u64 + (time * 1e6).round() as u64;
    MavMessage::SYSTEM_TIME(SYSTEM_TIME_DATA { time_unix_usec, time_boot_ms })
}

/// Change a second of what `value` gives, at `time`.
fn slope(time: f64, value: impl Fn(f64) -> WorldVector) -> WorldVector {
    let step = 0.001;
    let (before, after) = (value(time - step), value(time + step));
    [0, 1, 2].map(|axis: usize| (after[axis] - before[axis]) / (2.0 * step))
}

/// Angular velocity about the body's axes, radians a second.
/// Source: Diebel 2006, "Representing Attitude", section 5.6.3 (1, 2, 3 sequence).
fn rates(camera: &CameraPath, time: f64) -> [f32; 3] {
    let [_, pitch, roll] = camera.attitude(time);
    let [yaw_rate, pitch_rate, roll_rate] = slope(time, |time| camera.attitude(time));
    let (sp, cp) = sin_cos(pitch);
    let (sr, cr) = sin_cos(roll);
    [
        roll_rate - yaw_rate * sp,
        pitch_rate * cr + yaw_rate * cp * sr,
        yaw_rate * cp * cr - pitch_rate * sr,
    ]
    .map(|rate| rate as f32)
}

fn quaternion(camera: &CameraPath, time: f64, time_boot_ms: u32) -> MavMessage {
    let [(sy, cy), (sp, cp), (sr, cr)] = camera.attitude(time).map(|angle| sin_cos(angle / 2.0));
    let [rollspeed, pitchspeed, yawspeed] = rates(camera, time);
    MavMessage::ATTITUDE_QUATERNION(ATTITUDE_QUATERNION_DATA {
        time_boot_ms,
        q1: (cr * cp * cy + sr * sp * sy) as f32,
        q2: (sr * cp * cy - cr * sp * sy) as f32,
        q3: (cr * sp * cy + sr * cp * sy) as f32,
        q4: (cr * cp * sy - sr * sp * cy) as f32,
        rollspeed,
        pitchspeed,
        yawspeed,
        repr_offset_q: [0.0; 4],
    })
}

fn angles(camera: &CameraPath, time: f64, time_boot_ms: u32) -> MavMessage {
    let [yaw, pitch, roll] = camera.attitude(time).map(|angle| angle as f32);
    let [rollspeed, pitchspeed, yawspeed] = rates(camera, time);
    MavMessage::ATTITUDE(ATTITUDE_DATA {
        time_boot_ms,
        roll,
        pitch,
        yaw,
        rollspeed,
        pitchspeed,
        yawspeed,
    })
}

fn position(camera: &CameraPath, time: f64, time_boot_ms: u32) -> MavMessage {
    let [east, down, north] = camera.position(time);
    let velocity = slope(time, |time| camera.position(time));
    let [vy, vz, vx] = velocity.map(|speed| (speed * 100.0).round() as i16);
    let degrees = |degrees: f64| (degrees * 1e7).round() as i32;
    let narrowing = sin_cos(LATITUDE.to_radians()).1;
    let turn = core::f64::consts::TAU;
    let yaw = camera.attitude(time)[0];
    let heading = (if yaw < 0.0 { yaw + turn } else { yaw }).to_degrees();
    MavMessage::GLOBAL_POSITION_INT(GLOBAL_POSITION_INT_DATA {
        time_boot_ms,
        lat: degrees(LATITUDE + north / DEGREE),
        lon: degrees(LONGITUDE + east / (DEGREE * narrowing)),
        alt: ((GROUND - down) * 1000.0).round() as i32,
        relative_alt: (-down * 1000.0).round() as i32,
        vx,
        vy,
        vz,
        hdg: (heading * 100.0).round() as u16 % 36_000,
    })
}

#[cfg(test)]
mod tests {
    use super::super::Manoeuvre;
    use super::*;
    use crate::shell::support::vectors::Rotation;
    use mavlink_core::{MavlinkVersion, Message};
    use std::vec::Vec;

    fn camera(settings: &SimulateSettings) -> CameraPath {
        encounter(settings, 560.0, &mut Random::stream(settings.seed, 0)).0
    }

    fn messages(settings: &SimulateSettings) -> Vec<(i64, MavMessage)> {
        let parse = |(time, raw): (i64, MAVLinkV2MessageRaw)| {
            let id = raw.message_id();
            (time, MavMessage::parse(MavlinkVersion::V2, id, raw.payload()).unwrap())
        };
        FlightTelemetry::new(&camera(settings), settings).map(parse).collect()
    }

    #[test]
    fn rates_order_and_times() {
        let settings = SimulateSettings { seconds: 2.0, ..SimulateSettings::default() };
        let messages = messages(&settings);
        assert!(messages.is_sorted_by_key(|&(time, _)| time));
        // The last frame is taken at 1.967 s, attitudes end 100 ms later.
        let count = |id| messages.iter().filter(|(_, message)| message.message_id() == id).count();
        assert_eq!([0, 2, 33, 31, 30].map(count), [3, 3, 11, 104, 21]);
        for (time, message) in &messages {
            let boot = 60_000 + (time / 1000) as u32;
            match message {
                MavMessage::SYSTEM_TIME(data) => {
                    assert_eq!(data.time_unix_usec as i64, START_US + time);
                    assert_eq!(data.time_boot_ms, boot);
                }
                MavMessage::ATTITUDE_QUATERNION(data) => assert_eq!(data.time_boot_ms, boot),
                _ => {}
            }
        }
        let sequence: Vec<u8> = FlightTelemetry::new(&camera(&settings), &settings)
            .map(|(_, raw)| raw.sequence())
            .collect();
        assert!(sequence.windows(2).all(|pair| pair[1] == pair[0].wrapping_add(1)));
    }

    /// Turns a vector of the body to north, east, down.
    fn turned(data: &ATTITUDE_QUATERNION_DATA, v: WorldVector) -> WorldVector {
        let [w, x, y, z] = [data.q1, data.q2, data.q3, data.q4].map(f64::from);
        [
            (1.0 - 2.0 * (y * y + z * z)) * v[0]
                + 2.0 * (x * y - w * z) * v[1]
                + 2.0 * (x * z + w * y) * v[2],
            2.0 * (x * y + w * z) * v[0]
                + (1.0 - 2.0 * (x * x + z * z)) * v[1]
                + 2.0 * (y * z - w * x) * v[2],
            2.0 * (x * z - w * y) * v[0]
                + 2.0 * (y * z + w * x) * v[1]
                + (1.0 - 2.0 * (x * x + y * y)) * v[2],
        ]
    }

    #[test]
    fn body_and_camera_see_the_same() {
        for seed in 0..20 {
            let settings = SimulateSettings { seed, seconds: 1.0, ..SimulateSettings::default() };
            let camera = camera(&settings);
            for (time, message) in messages(&settings) {
                let seconds = time as f64 / 1e6;
                let [yaw, pitch, roll] = camera.attitude(seconds);
                match message {
                    MavMessage::ATTITUDE_QUATERNION(data) => {
                        let view = Rotation::new(yaw, pitch, roll);
                        for [x, y, z] in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.3, -0.5, 0.7]] {
                            // Right, down, forward of the camera is forward, right, down of the body.
                            let [east, down, north] = view.apply([x, y, z]);
                            let found = turned(&data, [z, x, y]);
                            for (found, wanted) in found.iter().zip([north, east, down]) {
                                assert!((found - wanted).abs() < 1e-6, "seed {seed}, {time}");
                            }
                        }
                        // A turn by the rates for a millisecond is the attitude a millisecond later.
                        let later = camera.attitude(seconds + 0.001);
                        let later = Rotation::new(later[0], later[1], later[2]);
                        let [p, q, r] = [data.rollspeed, data.pitchspeed, data.yawspeed]
                            .map(|rate| f64::from(rate) * 0.001);
                        let ahead = turned(&data, [1.0, r, -q]);
                        let right = turned(&data, [-r, 1.0, p]);
                        let [forward, side] =
                            [later.apply([0.0, 0.0, 1.0]), later.apply([1.0, 0.0, 0.0])];
                        for (found, wanted) in [(ahead, forward), (right, side)] {
                            let wanted = [wanted[2], wanted[0], wanted[1]];
                            for axis in 0..3 {
                                assert!((found[axis] - wanted[axis]).abs() < 1e-5, "seed {seed}");
                            }
                        }
                    }
                    MavMessage::ATTITUDE(data) => {
                        for (found, wanted) in
                            [(data.yaw, yaw), (data.pitch, pitch), (data.roll, roll)]
                        {
                            assert!((f64::from(found) - wanted).abs() < 1e-6);
                        }
                    }
                    _ => {}
                }
            }
        }
    }

    #[test]
    fn position_moves_with_its_velocity() {
        let settings =
            SimulateSettings { kind: Manoeuvre::None, seconds: 8.0, ..SimulateSettings::default() };
        let positions: Vec<_> = messages(&settings)
            .into_iter()
            .filter_map(|(_, message)| match message {
                MavMessage::GLOBAL_POSITION_INT(data) => Some(data),
                _ => None,
            })
            .collect();
        for pair in positions.windows(2) {
            let [a, b] = pair else { unreachable!() };
            let metres = [
                f64::from(b.lat - a.lat) * 1e-7 * DEGREE,
                f64::from(b.lon - a.lon) * 1e-7 * DEGREE * LATITUDE.to_radians().cos(),
                f64::from(a.alt - b.alt) / 1000.0,
            ];
            let seconds = f64::from(b.time_boot_ms - a.time_boot_ms) / 1000.0;
            for (metres, (before, after)) in
                metres.iter().zip([(a.vx, b.vx), (a.vy, b.vy), (a.vz, b.vz)])
            {
                let mean = f64::from(before + after) / 200.0;
                assert!((metres / seconds - mean).abs() < 0.12, "{metres} {mean}");
            }
            assert_eq!(a.alt - a.relative_alt, 500_000);
            assert!(a.hdg < 36_000 && a.relative_alt > 20_000);
        }
        assert!(positions.len() > 40);
    }
}
