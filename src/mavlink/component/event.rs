//! Changes that the component reports to its owner.

use super::parameters::Parameter;
use crate::mavlink::placing::News;
use fixed::types::I16F16;

/// A change that the component's owner handles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ComponentEvent {
    /// The first heartbeat of an autopilot, or of another one after ours was lost.
    Found {
        /// Its system id.
        system_id: u8,
        /// Its MAV_AUTOPILOT: 3 ArduPilot, 12 PX4.
        autopilot: u8,
    },
    /// Nothing was heard of the autopilot for 2.5 seconds.
    Lost,
    /// The autopilot that was served before is heard again.
    Returned {
        /// Its system id.
        system_id: u8,
    },
    /// The autopilot's time since boot fell: attitudes from before are of another flight.
    Restarted,
    /// Attitude of the vehicle: rotation from body (forward, right, down) to north, east, down.
    Attitude {
        /// When it was measured, in microseconds of our clock.
        time_us: i64,
        /// Quaternion w, x, y, z of unit length in Q30.
        quaternion: [i32; 4],
    },
    /// Angular velocity about the vehicle's axes (forward, right, down).
    Rates {
        /// When it was measured, in microseconds of our clock.
        time_us: i64,
        /// Radians a second.
        rates: [I16F16; 3],
    },
    /// Attitude of the gimbal that carries the camera: rotation from its axes (forward, right, down) to north, east, down,
    /// or to these turned by the vehicle's heading.
    Gimbal {
        /// When it was measured, in microseconds of our clock.
        time_us: i64,
        /// Quaternion w, x, y, z of unit length in Q30.
        quaternion: [i32; 4],
        /// Whether yaw counts from north; from the vehicle's heading otherwise.
        from_north: bool,
    },
    /// The camera's horizontal field of view, as it says itself.
    FieldOfView {
        /// 1 to 170 degrees.
        degrees: I16F16,
    },
    /// Objects are not put on the map any more, or again.
    Map(News),
    /// A parameter was set to another value, which its owner keeps over a restart.
    Parameter(Parameter),
}
