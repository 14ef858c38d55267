//! Gimbals: the rate of their attitudes, and the reference of their yaw.

use super::finding::{Finding, Mark, good, note};
use super::request::{RepeatedRequest, command_long};
use super::timing::MessageRate;
use crate::mavlink::dialect::{GimbalDeviceFlags, MavCmd, MavMessage};
use crate::mavlink::messages::Payload;
use std::collections::BTreeMap;
use std::format;
use std::vec::Vec;

/// GIMBAL_DEVICE_ATTITUDE_STATUS, and how often it is asked for, microseconds.
const STATUS: f32 = 285.0;
const INTERVAL_US: f32 = 50_000.0;
/// CAMERA_FOV_STATUS, likewise.
const VIEW: f32 = 271.0;
const VIEW_US: f32 = 1_000_000.0;
/// Attitudes a second below which a gimbal counts as silent between two.
const LEAST: f64 = 4.0;

/// The gimbals of the vehicle.
#[derive(Debug, Default)]
pub struct Gimbals {
    /// Whether the camera is on one.
    pub wanted: bool,
    requests: [RepeatedRequest; 2],
    /// By component.
    heard: BTreeMap<u8, (MessageRate, bool)>,
    /// Horizontal field of view, degrees.
    view: Option<f32>,
}

impl Gimbals {
    /// Hears a message of the vehicle's system.
    pub fn receive(&mut self, component: u8, message: &MavMessage, now_us: i64) {
        match message {
            MavMessage::GIMBAL_DEVICE_ATTITUDE_STATUS(data) => {
                let has = |flag| data.flags.contains(flag);
                let explicit = has(GimbalDeviceFlags::GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME);
                let north = has(GimbalDeviceFlags::GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME)
                    || (!explicit && has(GimbalDeviceFlags::GIMBAL_DEVICE_FLAGS_YAW_LOCK));
                let (rate, from_north) = self.heard.entry(component).or_default();
                rate.add(now_us);
                *from_north = north;
            }
            MavMessage::CAMERA_FOV_STATUS(data) if (1.0..=170.0).contains(&data.hfov) => {
                self.view = Some(data.hfov);
            }
            _ => {}
        }
    }

    /// The next request to the autopilot of `system` and `component`, or to the gimbal that was heard.
    pub fn poll(&mut self, (system, component): (u8, u8), now_us: i64) -> Option<Payload> {
        if !self.wanted {
            return None;
        }
        let best = self.heard.values().map(|(rate, _)| rate.hertz()).fold(0.0, f64::max);
        let gimbal = self.heard.keys().next().copied().unwrap_or(component);
        let command = MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL;
        let [status, view] = &mut self.requests;
        if best < 2.0 * LEAST && status.ask(now_us) {
            return Some(command_long((system, gimbal), command, [STATUS, INTERVAL_US]));
        }
        (self.view.is_none() && view.ask(now_us))
            .then(|| command_long((system, component), command, [VIEW, VIEW_US]))
    }

    /// Findings about each gimbal that was heard; none without any.
    pub fn findings(&self) -> Vec<Finding> {
        let mut findings = Vec::new();
        for (component, (rate, from_north)) in &self.heard {
            let yaw = if *from_north { "north" } else { "the vehicle's nose" };
            let hertz = rate.hertz();
            let text = format!(
                "gimbal: component {component} sends its attitude {hertz:.0} times a second, yaw from {yaw}"
            );
            findings.push(match self.wanted {
                true if hertz >= LEAST => good(text),
                true => note(format!(
                    "{text}; after 0.3 s without one no position of traffic is sent, raise its rate"
                )),
                false => note(format!("{text}; set camera.gimbal = true if the camera is on it")),
            });
        }
        if self.wanted && self.heard.is_empty() {
            findings.push(Finding {
                mark: Mark::Missing,
                text: "gimbal: GIMBAL_DEVICE_ATTITUDE_STATUS does not come, also not when asked for; no traffic is put \
                       on the map without it"
                    .into(),
            });
        }
        findings.extend(self.wanted.then_some(match self.view {
            Some(view) => good(format!("field of view: CAMERA_FOV_STATUS says {view:.1} degrees")),
            None => note(
                "field of view: CAMERA_FOV_STATUS does not come; the one in the settings is used, also while the camera \
                 zooms"
                    .into(),
            ),
        }));
        findings
    }
}
