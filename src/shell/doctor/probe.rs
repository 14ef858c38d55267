//! Probe of the way to the autopilot: an obstacle is sent, and the autopilot's telemetry is searched for it.
//!
//! ArduPilot repeats the proximity it took as DISTANCE_SENSOR, one for each octant, and has a bit for it in SYS_STATUS.
//! PX4 sends its fused obstacles as OBSTACLE_DISTANCE.

use super::finding::{Finding, Mark};
use crate::mavlink::dialect::{
    MavAutopilot, MavDistanceSensor, MavFrame, MavMessage, MavSensorOrientation,
    MavSysStatusSensor, OBSTACLE_DISTANCE_DATA,
};
use crate::mavlink::messages::Payload;
use std::format;
use std::string::String;
use std::vec::Vec;

/// Distance of the probe's obstacle, in centimetres ahead.
const AHEAD: u16 = 1234;
/// Tolerance of its distance for rounding in the autopilot.
const ROUNDING: u16 = 2;
/// Microseconds from the start to the first of these messages: armed vehicles must be known by then.
const WAIT_US: i64 = 1_500_000;
/// Microseconds from one to the next.
const INTERVAL_US: i64 = 100_000;

/// State of the probe: messages sent and telemetry that answers them.
#[derive(Debug)]
pub struct Probe {
    due_us: i64,
    sent: u32,
    /// Whether it was left out because the vehicle is armed.
    refused: bool,
    echo: Option<&'static str>,
    healthy: Option<bool>,
}

impl Probe {
    /// A probe that starts at `now_us`, microseconds.
    pub fn new(now_us: i64) -> Self {
        Self { due_us: now_us + WAIT_US, sent: 0, refused: false, echo: None, healthy: None }
    }

    /// The next message. Never to an armed vehicle: it could evade an obstacle that is not there.
    pub fn poll(&mut self, armed: bool, now_us: i64) -> Option<Payload> {
        if now_us < self.due_us {
            return None;
        }
        if armed {
            self.refused = true;
            return None;
        }
        self.due_us = now_us + INTERVAL_US;
        self.sent += 1;
        let mut distances = [u16::MAX; 72];
        distances[0] = AHEAD;
        Some(Payload::new(&OBSTACLE_DISTANCE_DATA {
            time_usec: now_us.unsigned_abs(),
            distances,
            min_distance: 20,
            max_distance: 10_000,
            sensor_type: MavDistanceSensor::MAV_DISTANCE_SENSOR_UNKNOWN,
            increment: 5,
            increment_f: 5.0,
            angle_offset: 0.0,
            frame: MavFrame::MAV_FRAME_BODY_FRD,
        }))
    }

    /// Hears a message of the autopilot.
    pub fn receive(&mut self, message: &MavMessage) {
        if self.sent == 0 {
            return;
        }
        let same = |distance: u16| distance.abs_diff(AHEAD) <= ROUNDING;
        match message {
            MavMessage::DISTANCE_SENSOR(data)
                if data.orientation == MavSensorOrientation::MAV_SENSOR_ROTATION_NONE
                    && same(data.current_distance) =>
            {
                self.echo = Some("DISTANCE_SENSOR");
            }
            MavMessage::OBSTACLE_DISTANCE(data) if data.distances.iter().any(|&d| same(d)) => {
                self.echo = Some("OBSTACLE_DISTANCE");
            }
            MavMessage::SYS_STATUS(data) => {
                let bit = MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_PROXIMITY;
                let present = data.onboard_control_sensors_present.contains(bit);
                let health = data.onboard_control_sensors_health.contains(bit);
                self.healthy = present.then_some(health).or(self.healthy);
            }
            _ => {}
        }
    }

    /// Findings of the probe.
    pub fn findings(&self, armed: bool, kind: MavAutopilot) -> Vec<Finding> {
        let missing = |text: String| Finding { mark: Mark::Missing, text };
        let good = |text: String| Finding { mark: Mark::Good, text };
        if self.refused || armed {
            let text = "probe: the vehicle is armed, nothing was sent; disarm it and try again";
            return Vec::from([missing(text.into())]);
        }
        if self.sent == 0 {
            return Vec::from([missing("probe: too little time; give more --seconds".into())]);
        }
        let mut findings = Vec::new();
        findings.push(match self.echo {
            Some(echo) => good(format!(
                "probe: the autopilot took OBSTACLE_DISTANCE, its {echo} shows our {:.2} m ahead",
                f64::from(AHEAD) / 100.0
            )),
            None => missing(format!(
                "probe: {} OBSTACLE_DISTANCE sent, nothing of it came back; see its parameters above, and whether this \
                 port sends {}",
                self.sent,
                match kind {
                    MavAutopilot::MAV_AUTOPILOT_PX4 => "OBSTACLE_DISTANCE",
                    _ => "DISTANCE_SENSOR (its stream EXTRA3)",
                }
            )),
        });
        match self.healthy {
            Some(true) => findings.push(good("probe: SYS_STATUS says proximity is healthy".into())),
            Some(false) => findings
                .push(missing("probe: SYS_STATUS says proximity is there, but not healthy".into())),
            None => {}
        }
        findings
    }
}
