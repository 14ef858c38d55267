//! The gimbal that carries the camera: where it points, and the camera's field of view.
//!
//! GIMBAL_DEVICE_ATTITUDE_STATUS turns a gimbal's axes to the earth's. By its flags yaw counts from north, or from the
//! vehicle's heading; roll and pitch count from the horizon in both. The messages are read by hand, for they may hold flags
//! that are younger than this program.
//! Source: <https://mavlink.io/en/messages/common.html#GIMBAL_DEVICE_ATTITUDE_STATUS>.

use super::cadence::Cadence;
use super::clock::ClockOffset;
use super::commands::PayloadFields;
use super::rotation::{quaternion, turned_by_yaw};
use super::{Component, ComponentEvent, Sender};
use crate::mavlink::dialect::{CAMERA_FOV_STATUS_DATA, GIMBAL_DEVICE_ATTITUDE_STATUS_DATA};
use fixed::types::I16F16;
use mavlink_core::MessageData;

/// GIMBAL_DEVICE_FLAGS_YAW_LOCK, _YAW_IN_VEHICLE_FRAME and _YAW_IN_EARTH_FRAME.
const YAW_LOCK: u16 = 16;
const YAW_IN_VEHICLE_FRAME: u16 = 32;
const YAW_IN_EARTH_FRAME: u16 = 64;

/// A gimbal's attitude older than this says nothing about where the camera looks, microseconds.
pub const STALE_US: i64 = 300_000;

/// How often the gimbal's attitude is asked for, a second, and the time between two from which on it comes too rarely.
const HERTZ: u32 = 20;
const SLOW_US: i64 = 120_000;

/// How often the field of view is asked for, a second.
const VIEW_HERTZ: u32 = 1;

/// The gimbal and the camera on it.
#[derive(Debug, Clone, Copy, Default)]
pub struct Gimbal {
    /// Component and device id of the gimbal that was heard first; no other one is listened to.
    device: Option<(u8, u8)>,
    link: u8,
    clock: ClockOffset,
    attitude: Cadence,
    /// The component that sent the first field of view.
    camera: Option<u8>,
    view: Cadence,
}

impl Gimbal {
    /// Component and device id, once it was heard.
    pub fn device(&self) -> Option<(u8, u8)> {
        self.device
    }

    /// When its attitude was last heard, microseconds.
    pub fn heard_us(&self) -> Option<i64> {
        self.attitude.last_us
    }

    /// Forgets its times, for those of another clock or vehicle.
    pub(super) fn forget(&mut self) {
        self.clock = ClockOffset::default();
        self.attitude = Cadence::default();
    }
}

impl Component {
    /// The gimbal, where the settings say that the camera is on one.
    pub fn gimbal(&self) -> Option<&Gimbal> {
        self.config.has_gimbal().then_some(&self.gimbal)
    }

    /// Whether a message of `from` may be one of our vehicle's gimbal or camera.
    pub(super) fn is_on_vehicle(&self, from: Sender) -> bool {
        self.config.has_gimbal() && self.autopilot.is_some_and(|own| own.system_id == from.system)
    }

    /// GIMBAL_DEVICE_ATTITUDE_STATUS. `false` where it holds no attitude.
    pub(super) fn hear_gimbal(&mut self, from: Sender, payload: &[u8], now_us: i64) -> bool {
        let fields = PayloadFields(payload);
        let Some(wire) = quaternion([4, 8, 12, 16].map(|at| fields.float(at))) else {
            return false;
        };
        let flags = u16::from_le_bytes(fields.bytes(36));
        let explicit = flags & (YAW_IN_VEHICLE_FRAME | YAW_IN_EARTH_FRAME);
        let from_north = match explicit {
            0 => flags & YAW_LOCK != 0,
            YAW_IN_VEHICLE_FRAME => false,
            YAW_IN_EARTH_FRAME => true,
            _ => return false,
        };
        let device = (from.component, fields.byte(48));
        if *self.gimbal.device.get_or_insert(device) != device {
            return true;
        }
        if !self.gimbal.attitude.is_silent(now_us, STALE_US) && self.gimbal.link != from.link {
            // Heard over several links: the first one, while it works.
            return true;
        }
        self.gimbal.link = from.link;
        self.gimbal.attitude.heard(now_us);
        let time_us = match u32::from_le_bytes(fields.bytes(0)) {
            // A gimbal without a clock.
            0 => now_us,
            boot_ms if self.is_autopilot(from) => self.clock.local_us(boot_ms, now_us),
            boot_ms => self.gimbal.clock.local_us(boot_ms, now_us),
        };
        // The gimbal itself may know the vehicle's heading; a message without the field, or with zeros cut off, does not.
        let delta = (payload.len() > 40 && explicit != 0).then(|| fields.float(40));
        let turned = delta.filter(|_| !from_north).and_then(|yaw| turned_by_yaw(yaw, wire));
        self.happened(ComponentEvent::Gimbal {
            time_us,
            quaternion: turned.unwrap_or(wire),
            from_north: from_north || turned.is_some(),
        });
        true
    }

    /// CAMERA_FOV_STATUS: the horizontal field of view, where it is known.
    pub(super) fn hear_view(&mut self, from: Sender, payload: &[u8], now_us: i64) {
        let degrees = I16F16::checked_from_num(PayloadFields(payload).float(44));
        let Some(degrees) = degrees.filter(|d| (1..=170).contains(&d.to_num::<i32>())) else {
            return;
        };
        if *self.gimbal.camera.get_or_insert(from.component) == from.component {
            self.gimbal.view.heard(now_us);
            self.happened(ComponentEvent::FieldOfView { degrees });
        }
    }

    /// Asks for what is missing of the gimbal: itself once it was heard, the autopilot until then.
    pub(super) fn keep_gimbal(&mut self, now_us: i64) {
        let Some(own) = self.autopilot.filter(|_| self.config.has_gimbal()) else { return };
        let gimbal = &mut self.gimbal;
        let slow = gimbal.attitude.is_silent(now_us, STALE_US) || gimbal.attitude.is_slow(SLOW_US);
        let ask = gimbal.attitude.ask(slow, now_us);
        let (at, camera) = (*gimbal, gimbal.camera);
        // Once answered it is not asked for again: it comes when the view changes, or regularly, as the camera likes.
        let view = gimbal.view.ask(gimbal.view.last_us.is_none(), now_us);
        if ask {
            let to = at.device.map_or(own.component_id, |(component, _)| component);
            let link = if at.device.is_some() { at.link } else { own.link };
            let id = GIMBAL_DEVICE_ATTITUDE_STATUS_DATA::ID;
            self.ask_for((own.system_id, to, link), id, HERTZ);
        }
        if view {
            let to = camera.unwrap_or(own.component_id);
            let id = CAMERA_FOV_STATUS_DATA::ID;
            self.ask_for((own.system_id, to, own.link), id, VIEW_HERTZ);
        }
    }
}
