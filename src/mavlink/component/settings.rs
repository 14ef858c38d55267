//! Settings of the component.

use super::Naming;
use crate::mavlink::messages::status::HeartbeatType;

/// Settings that stay the same while the component runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ComponentConfig {
    /// Our system id. `None`: the autopilot's, from its first heartbeat; 1 until then.
    pub system_id: Option<u8>,
    /// Our component id. Default 196, MAV_COMP_ID_OBSTACLE_AVOIDANCE; 191 is the neutral choice.
    pub component_id: u8,
    /// Behave as a camera too, so that QGroundControl draws a box (off by default).
    pub camera: Option<CameraComponent>,
    /// The camera is on a gimbal, whose own messages give its attitude. Default `false`.
    pub gimbal: bool,
    /// Rate of attitudes requested from the autopilot, Hz. Default 50.
    pub attitude_hz: u16,
    /// Rate of positions requested from the autopilot, Hz. Default 5.
    pub position_hz: u16,
    /// Time without a processed frame after which the state is stalled, in microseconds. Default 700 000.
    pub stall_us: i64,
    /// MAV_TYPE of the heartbeat. Default ONBOARD_CONTROLLER.
    pub heartbeat: HeartbeatType,
    /// Aircraft type that objects are reported as, and callsigns of the own fleet.
    pub naming: Naming,
}

impl ComponentConfig {
    /// Whether the camera is on a gimbal. A board without an operating system has no flash to spare for one.
    pub(super) const fn has_gimbal(&self) -> bool {
        cfg!(feature = "std") && self.gimbal
    }
}

impl Default for ComponentConfig {
    fn default() -> Self {
        Self {
            system_id: None,
            component_id: 196,
            camera: None,
            gimbal: false,
            attitude_hz: 50,
            position_hz: 5,
            stall_us: 700_000,
            heartbeat: HeartbeatType::default(),
            naming: Naming::default(),
        }
    }
}

/// The camera component that CAMERA_TRACKING_IMAGE_STATUS needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CameraComponent {
    /// Its component id: 100, MAV_COMP_ID_CAMERA, unless another program serves that camera.
    pub component_id: u8,
    /// Width of the frames in pixels.
    pub width: u16,
    /// Height of the frames in pixels.
    pub height: u16,
}
