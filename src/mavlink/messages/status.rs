//! The lookout about itself: HEARTBEAT, health, versions, and the box on the video.

use super::{Blind, Health};
use crate::mavlink::dialect::{
    AUTOPILOT_VERSION_DATA, CAMERA_INFORMATION_DATA, CAMERA_TRACKING_IMAGE_STATUS_DATA,
    COMPONENT_INFORMATION_BASIC_DATA, CameraCapFlags, CameraTrackingMode,
    CameraTrackingStatusFlags, CameraTrackingTargetData, HEARTBEAT_DATA, MavAutopilot, MavModeFlag,
    MavProtocolCapability, MavState, MavType, NAMED_VALUE_FLOAT_DATA,
};
use crate::tracking::traffic::Traffic;
use fixed::types::I16F16;
use mavlink_core::types::CharArray;

/// MAV_TYPE of the lookout's heartbeat.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum HeartbeatType {
    /// MAV_TYPE_ONBOARD_CONTROLLER (18).
    #[default]
    OnboardController,
    /// MAV_TYPE_ADSB (27): PX4's check for a traffic receiver (COM_ARM_TRAFF, COM_TRAFF_AVOID) then takes the lookout for
    /// one, which sees no traffic beyond the camera's view.
    Adsb,
    /// MAV_TYPE_FLARM (32): likewise.
    Flarm,
}

/// Bit of the heartbeat's custom_mode while the autopilot that was served is gone; lower bits are those of [`Blind`].
pub const NO_AUTOPILOT_BIT: u32 = 16;

/// Bit of the heartbeat's custom_mode while the detector is too slow.
pub const SLOW_BIT: u32 = 32;

/// State of the lookout.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LookoutState {
    /// No frame was finished yet.
    #[default]
    Starting,
    /// Frames are finished, and something could be seen in them.
    Watching,
    /// Frames are finished, but nothing can be seen in them.
    Blind(Blind),
    /// No frame was finished of late.
    Stalled,
    /// Frames come, but the detector takes too long for one to follow objects.
    Slow,
    /// Frames show something, but the autopilot that was served is gone: nothing has a place on the map.
    NoAutopilot,
    /// The lookout ends.
    Ending,
}

impl LookoutState {
    /// As system_status of HEARTBEAT: BOOT, ACTIVE, CRITICAL, POWEROFF. ACTIVE only while frames are really finished and something
    /// could be seen in them.
    pub fn status(self) -> MavState {
        match self {
            Self::Starting => MavState::MAV_STATE_BOOT,
            Self::Watching => MavState::MAV_STATE_ACTIVE,
            Self::Blind(_) | Self::Stalled | Self::Slow | Self::NoAutopilot => {
                MavState::MAV_STATE_CRITICAL
            }
            Self::Ending => MavState::MAV_STATE_POWEROFF,
        }
    }
}

/// HEARTBEAT (0) of the lookout; custom_mode holds the bits of [`Blind`], [`NO_AUTOPILOT_BIT`] and
/// [`SLOW_BIT`].
pub fn heartbeat(state: LookoutState, kind: HeartbeatType) -> HEARTBEAT_DATA {
    let custom_mode = match state {
        LookoutState::Blind(reasons) => reasons.bits().into(),
        LookoutState::NoAutopilot => NO_AUTOPILOT_BIT,
        LookoutState::Slow => SLOW_BIT,
        _ => 0,
    };
    HEARTBEAT_DATA {
        custom_mode,
        mavtype: match kind {
            HeartbeatType::OnboardController => MavType::MAV_TYPE_ONBOARD_CONTROLLER,
            HeartbeatType::Adsb => MavType::MAV_TYPE_ADSB,
            HeartbeatType::Flarm => MavType::MAV_TYPE_FLARM,
        },
        autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
        base_mode: MavModeFlag::empty(),
        system_status: state.status(),
        mavlink_version: 3,
    }
}

/// HEARTBEAT (0) of the camera component.
pub fn camera_heartbeat(state: LookoutState) -> HEARTBEAT_DATA {
    let heartbeat = heartbeat(state, HeartbeatType::default());
    HEARTBEAT_DATA { mavtype: MavType::MAV_TYPE_CAMERA, ..heartbeat }
}

/// NAMED_VALUE_FLOAT (251), five of them: `LK_FPS` frames a second, `LK_DROP` frames left out since the start, `LK_DELAY`
/// milliseconds from frame to detections, `LK_TRACKS` confirmed objects, `LK_BLIND` bits of [`Blind`].
pub fn health(
    health: &Health,
    frames_a_second: I16F16,
    tracks: usize,
    time_boot_ms: u32,
) -> [NAMED_VALUE_FLOAT_DATA; 5] {
    let small = |value: u32| I16F16::saturating_from_num(value);
    [
        ("LK_FPS", frames_a_second),
        ("LK_DROP", small(health.dropped)),
        ("LK_DELAY", small(health.latency_us / 1000)),
        ("LK_TRACKS", small(tracks as u32)),
        ("LK_BLIND", small(health.blind.bits().into())),
    ]
    .map(|(name, value)| NAMED_VALUE_FLOAT_DATA {
        time_boot_ms,
        value: value.to_num(),
        name: CharArray::from(name),
    })
}

/// The version as FIRMWARE_VERSION: major, minor, patch, and 0 for "under development".
pub const VERSION: u32 = u32::from_be_bytes([
    number(env!("CARGO_PKG_VERSION_MAJOR")),
    number(env!("CARGO_PKG_VERSION_MINOR")),
    number(env!("CARGO_PKG_VERSION_PATCH")),
    0,
]);

const fn number(digits: &str) -> u8 {
    let mut value = 0;
    let mut at = 0;
    while at < digits.len() {
        value = value * 10 + (digits.as_bytes()[at] - b'0');
        at += 1;
    }
    value
}

fn capabilities() -> MavProtocolCapability {
    MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MAVLINK2
        | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        // All our parameters are REAL32, for which this is the C-cast too.
        | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
}

/// AUTOPILOT_VERSION (148): what this component can do, and its version.
pub fn version() -> AUTOPILOT_VERSION_DATA {
    AUTOPILOT_VERSION_DATA {
        capabilities: capabilities(),
        uid: 0,
        flight_sw_version: VERSION,
        middleware_sw_version: 0,
        os_sw_version: 0,
        board_version: 0,
        vendor_id: 0,
        product_id: 0,
        flight_custom_version: [0; 8],
        middleware_custom_version: [0; 8],
        os_custom_version: [0; 8],
        uid2: [0; 18],
    }
}

/// PROTOCOL_VERSION (300): MAVLink 2 and nothing else.
pub fn protocol() -> crate::mavlink::dialect::PROTOCOL_VERSION_DATA {
    crate::mavlink::dialect::PROTOCOL_VERSION_DATA {
        version: 200,
        min_version: 200,
        max_version: 200,
        spec_version_hash: [0; 8],
        library_version_hash: [0; 8],
    }
}

/// COMPONENT_INFORMATION_BASIC (396): the answer to a request for it.
pub fn component(time_boot_ms: u32) -> COMPONENT_INFORMATION_BASIC_DATA {
    COMPONENT_INFORMATION_BASIC_DATA {
        capabilities: capabilities(),
        time_boot_ms,
        time_manufacture_s: 0,
        vendor_name: CharArray::from("Lookout"),
        model_name: CharArray::from("Lookout"),
        software_version: CharArray::from(env!("CARGO_PKG_VERSION")),
        hardware_version: CharArray::from(""),
        serial_number: CharArray::from(""),
    }
}

/// CAMERA_INFORMATION (259): a camera that tracks, of `width` x `height` pixels, and does nothing else.
pub fn camera(width: u16, height: u16, time_boot_ms: u32) -> CAMERA_INFORMATION_DATA {
    let mut name = [0; 32];
    name[..7].copy_from_slice(b"Lookout");
    CAMERA_INFORMATION_DATA {
        time_boot_ms,
        firmware_version: VERSION,
        focal_length: f32::NAN,
        sensor_size_h: f32::NAN,
        sensor_size_v: f32::NAN,
        flags: CameraCapFlags::CAMERA_CAP_FLAGS_HAS_TRACKING_POINT
            | CameraCapFlags::CAMERA_CAP_FLAGS_HAS_TRACKING_RECTANGLE,
        resolution_h: width,
        resolution_v: height,
        cam_definition_version: 0,
        vendor_name: name,
        model_name: name,
        lens_id: 0,
        cam_definition_uri: CharArray::from(""),
        gimbal_device_id: 0,
        camera_device_id: 0,
    }
}

/// CAMERA_TRACKING_IMAGE_STATUS (275) of the one object that matters most, or of none, in a frame of `width` x `height`
/// pixels.
pub fn image(
    target: Option<&Traffic>,
    width: u16,
    height: u16,
) -> CAMERA_TRACKING_IMAGE_STATUS_DATA {
    let mut data = CAMERA_TRACKING_IMAGE_STATUS_DATA {
        point_x: f32::NAN,
        point_y: f32::NAN,
        radius: f32::NAN,
        rec_top_x: f32::NAN,
        rec_top_y: f32::NAN,
        rec_bottom_x: f32::NAN,
        rec_bottom_y: f32::NAN,
        tracking_status: CameraTrackingStatusFlags::CAMERA_TRACKING_STATUS_FLAGS_IDLE,
        tracking_mode: CameraTrackingMode::CAMERA_TRACKING_MODE_NONE,
        target_data: CameraTrackingTargetData::CAMERA_TRACKING_TARGET_DATA_IN_STATUS,
        camera_device_id: 0,
    };
    let Some(target) = target.filter(|_| width > 0 && height > 0) else { return data };
    // Parts of the frame, 0 to 1. The edges are Q28.4.
    let part = |start: i32, extent: i32, whole: u16| {
        let q16 = ((i64::from(start) + i64::from(extent)) << 12) / i64::from(whole);
        I16F16::from_bits(q16.clamp(0, 1 << 16) as i32).to_num()
    };
    let [x, y, w, h] =
        [target.rect.x, target.rect.y, target.rect.width, target.rect.height].map(|v| v.to_bits());
    data.rec_top_x = part(x, 0, width);
    data.rec_top_y = part(y, 0, height);
    data.rec_bottom_x = part(x, w, width);
    data.rec_bottom_y = part(y, h, height);
    data.tracking_mode = CameraTrackingMode::CAMERA_TRACKING_MODE_RECTANGLE;
    data.tracking_status = CameraTrackingStatusFlags::CAMERA_TRACKING_STATUS_FLAGS_ACTIVE
        | CameraTrackingStatusFlags::CAMERA_TRACKING_STATUS_FLAGS_MTI;
    if target.coasting {
        data.tracking_status |= CameraTrackingStatusFlags::CAMERA_TRACKING_STATUS_FLAGS_COASTING;
    }
    data
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mavlink::messages::tests::{any_traffic, traffic};
    use proptest::prelude::*;

    #[test]
    fn active_only_while_it_sees() {
        let heartbeat = |state| super::heartbeat(state, HeartbeatType::default());
        let data = heartbeat(LookoutState::Watching);
        assert_eq!((data.mavtype as u8, data.autopilot as u8, data.base_mode.bits()), (18, 8, 0));
        assert_eq!(data.system_status as u8, 4);
        let others = [
            LookoutState::Starting,
            LookoutState::Stalled,
            LookoutState::Slow,
            LookoutState::NoAutopilot,
            LookoutState::Blind(Blind::DARK),
            LookoutState::Ending,
        ];
        for state in others {
            assert_ne!(heartbeat(state).system_status as u8, 4);
        }
        assert_eq!(heartbeat(LookoutState::Blind(Blind::DARK.and(Blind::BLUR))).custom_mode, 5);
        assert_eq!(heartbeat(LookoutState::NoAutopilot).custom_mode, 16);
        assert_eq!(camera_heartbeat(LookoutState::Watching).mavtype as u8, 30);
        let kinds = [HeartbeatType::Adsb, HeartbeatType::Flarm];
        let numbers =
            kinds.map(|kind| super::heartbeat(LookoutState::Watching, kind).mavtype as u8);
        assert_eq!(numbers, [27, 32]);
    }

    #[test]
    fn the_box_is_in_parts_of_the_frame() {
        let data = image(Some(&traffic(1)), 640, 480);
        // 100, 50, 20 x 10 pixels
        assert!((data.rec_top_x - 100.0 / 640.0).abs() < 1e-4);
        assert!((data.rec_bottom_y - 60.0 / 480.0).abs() < 1e-4);
        assert_eq!((data.tracking_status.bits(), data.tracking_mode as u8), (5, 2));
        assert!(image(None, 640, 480).rec_top_x.is_nan());
        assert_eq!(image(None, 640, 480).tracking_status.bits(), 0);
    }

    #[test]
    fn health_has_names_of_ten_letters() {
        let values =
            health(&Health { dropped: 7, ..Health::default() }, I16F16::from_num(26.5), 2, 9);
        assert_eq!(values.each_ref().map(|v| v.value), [26.5, 7.0, 0.0, 2.0, 0.0]);
        assert!(values.iter().all(|v| v.name.to_str().unwrap().len() < 10));
    }

    #[test]
    fn the_version_is_the_package_s() {
        assert_eq!(number("120"), 120);
        assert_eq!(VERSION & 0xFF, 0);
        assert_eq!(camera(640, 480, 0).flags.bits(), 512 + 1024);
    }

    proptest! {
        #[test]
        fn any_box_in_any_frame(traffic in any_traffic(), width: u16, height: u16) {
            let data = image(Some(&traffic), width, height);
            prop_assert!(data.rec_top_x.is_nan() || (0.0..=1.0).contains(&data.rec_top_x));
        }
    }
}
