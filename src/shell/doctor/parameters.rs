//! Parameters of the autopilot that decide whether it uses the lookout's messages.
//!
//! Sources: ArduPilot `AP_ADSB`, `AP_Avoidance`, `AP_Proximity`, `AC_Avoid`, PX4 `CollisionPrevention`, `navigator` and
//! the parameter references of both, <https://ardupilot.org/copter/docs/parameters.html> and
//! <https://docs.px4.io/main/en/advanced_config/parameter_reference.html>.

use super::finding::{Finding, Mark};
use crate::mavlink::dialect::{MavAutopilot, MavParamType};
use std::format;
use std::string::String;

/// Purpose of the lookout's messages on the autopilot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
pub enum Purpose {
    /// Traffic is sent to the autopilot: ADSB_VEHICLE
    Traffic,
    /// Obstacles are sent to the autopilot: OBSTACLE_DISTANCE, OBSTACLE_DISTANCE_3D
    Proximity,
}

impl Purpose {
    /// Name of the MAVLink message.
    pub fn message(self) -> &'static str {
        match self {
            Self::Traffic => "ADSB_VEHICLE",
            Self::Proximity => "OBSTACLE_DISTANCE",
        }
    }
}

/// A parameter and what its value means.
#[derive(Debug, Clone, Copy)]
pub struct Check {
    /// Its name, as sent.
    pub name: &'static str,
    /// Its name in older firmware.
    pub old_name: Option<&'static str>,
    /// For which message it counts.
    pub purpose: Purpose,
    /// Whether every firmware of this kind has it.
    pub always: bool,
    meaning: fn(f64) -> (Mark, &'static str),
}

const RESTART: &str =
    "the autopilot takes no traffic from MAVLink; set it to 1 and restart the autopilot";

/// A distance of ArduPlane's detect-and-avoid script, metres.
const fn script_distance(name: &'static str, meaning: fn(f64) -> (Mark, &'static str)) -> Check {
    Check { name, old_name: None, purpose: Purpose::Traffic, always: false, meaning }
}

static ARDUPILOT: [Check; 10] = [
    Check {
        name: "ADSB_TYPE",
        old_name: Some("ADSB_ENABLE"),
        purpose: Purpose::Traffic,
        always: true,
        meaning: |value| match value {
            0.0 => (Mark::Missing, RESTART),
            _ => (Mark::Good, "the autopilot takes traffic"),
        },
    },
    Check {
        name: "AVD_ENABLE",
        old_name: None,
        purpose: Purpose::Traffic,
        always: true,
        meaning: |value| match value {
            0.0 => (
                Mark::Note,
                "traffic is shown, the vehicle does not evade; 1 would let it, see AVD_F_ACTION",
            ),
            _ => (Mark::Good, "the vehicle reacts to traffic as AVD_F_ACTION says"),
        },
    },
    Check {
        name: "SCR_ENABLE",
        old_name: None,
        purpose: Purpose::Traffic,
        always: false,
        meaning: |value| match value {
            0.0 => (
                Mark::Note,
                "scripts are off; ArduPlane's detect-and-avoid script needs 1 and a restart",
            ),
            _ => (Mark::Good, "scripts are on"),
        },
    },
    script_distance("AVD_WCLR_XY", |_| {
        (
            Mark::Good,
            "the detect-and-avoid script keeps well clear of aircraft by this, metres aside",
        )
    }),
    script_distance("AVD_WCLR_Z", |_| {
        (
            Mark::Good,
            "the detect-and-avoid script keeps well clear of aircraft by this, metres in height",
        )
    }),
    script_distance("AVD_NMAC_XY", |_| {
        (
            Mark::Good,
            "the detect-and-avoid script takes less than this for a near miss, metres aside",
        )
    }),
    script_distance("AVD_NMAC_Z", |_| {
        (
            Mark::Good,
            "the detect-and-avoid script takes less than this for a near miss, metres in height",
        )
    }),
    Check {
        name: "PRX1_TYPE",
        old_name: Some("PRX_TYPE"),
        purpose: Purpose::Proximity,
        always: true,
        meaning: |value| match value {
            2.0 => (Mark::Good, "proximity comes from MAVLink"),
            0.0 => (
                Mark::Missing,
                "no proximity sensor; set it to 2 (MAVLink) and restart the autopilot",
            ),
            _ => (
                Mark::Missing,
                "proximity comes from another sensor; use an instance of its own (PRX2_TYPE 2)",
            ),
        },
    },
    Check {
        name: "AVOID_ENABLE",
        old_name: None,
        purpose: Purpose::Proximity,
        always: false,
        meaning: |value| match bits(value) & 2 {
            0 => (Mark::Missing, "Loiter and AltHold do not use proximity; add 2 to it"),
            _ => (Mark::Good, "Loiter and AltHold use proximity"),
        },
    },
    Check {
        name: "OA_TYPE",
        old_name: None,
        purpose: Purpose::Proximity,
        always: false,
        meaning: |value| match value {
            0.0 => (Mark::Note, "Auto and Guided do not fly round obstacles"),
            _ => (Mark::Good, "Auto and Guided fly round obstacles"),
        },
    },
];

static PX4: [Check; 4] = [
    Check {
        name: "COM_TRAFF_AVOID",
        old_name: Some("COM_ARM_TRAFF"),
        purpose: Purpose::Traffic,
        always: false,
        meaning: |value| match value {
            0.0 => (Mark::Good, "no traffic receiver is needed to arm"),
            _ => (
                Mark::Note,
                "arming wants the heartbeat of a traffic receiver; heartbeat_type = \"adsb\" makes the lookout's count",
            ),
        },
    },
    Check {
        name: "NAV_TRAFF_AVOID",
        old_name: None,
        purpose: Purpose::Traffic,
        always: true,
        meaning: |value| match value {
            0.0 => (
                Mark::Missing,
                "traffic is ignored; set it to 1 to be warned, to 2 or more to react",
            ),
            1.0 => (Mark::Good, "the autopilot warns of traffic"),
            _ => (Mark::Good, "the autopilot reacts to traffic"),
        },
    },
    Check {
        name: "CP_DIST",
        old_name: None,
        purpose: Purpose::Proximity,
        always: true,
        meaning: |value| match value {
            v if v > 0.0 => (
                Mark::Good,
                "collision prevention is on; it slows the vehicle towards every side that no sensor sees",
            ),
            _ => {
                (Mark::Missing, "collision prevention is off; set the distance to keep, in metres")
            }
        },
    },
    Check {
        name: "CP_GO_NO_DATA",
        old_name: None,
        purpose: Purpose::Proximity,
        always: false,
        meaning: |value| match value {
            0.0 => (Mark::Note, "the vehicle does not move to a side that no sensor sees"),
            _ => (Mark::Good, "the vehicle may move to a side that no sensor sees"),
        },
    },
];

/// The parameters of a kind of autopilot; none where they are not known.
pub fn checks(kind: MavAutopilot) -> &'static [Check] {
    match kind {
        MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA => &ARDUPILOT,
        MavAutopilot::MAV_AUTOPILOT_PX4 => &PX4,
        _ => &[],
    }
}

impl Check {
    /// Finding for the autopilot's answer. `value` is `None` without an answer; `wanted`: whether the user sends messages
    /// for this purpose.
    pub fn find(&self, name: &str, value: Option<f64>, wanted: bool) -> Finding {
        let (mark, text) = match value {
            Some(value) => {
                let (mark, meaning) = (self.meaning)(value);
                (mark, format!("{name} is {}: {meaning}", shortest(value)))
            }
            None if self.always => (
                Mark::Missing,
                format!(
                    "{name}: no answer; this firmware may be built without it, or the link lets no requests through"
                ),
            ),
            None => (Mark::Note, format!("{name}: no answer; this firmware may not have it")),
        };
        let unwanted = mark == Mark::Missing && !wanted;
        let mark = if unwanted { Mark::Note } else { mark };
        let message = self.purpose.message();
        let text: String = if unwanted {
            format!("{message} (not asked for): {text}")
        } else {
            format!("{message}: {text}")
        };
        Finding { mark, text }
    }
}

/// The bits of a parameter that is a set of flags.
#[expect(clippy::cast_possible_truncation, reason = "saturates, and parameters hold 24 bits")]
fn bits(value: f64) -> i64 {
    value as i64
}

/// A value in the fewest digits that give the same `f32`, as it was on the wire.
#[expect(clippy::cast_possible_truncation, reason = "rounds; compared just below")]
fn shortest(value: f64) -> String {
    let single = value as f32;
    if f64::from(single) == value { format!("{single}") } else { format!("{value}") }
}

/// The value of PARAM_VALUE: ArduPilot casts whole numbers to the float on the wire, PX4 puts their bytes there.
/// Source: <https://mavlink.io/en/services/parameter.html#parameter-encoding>.
pub fn value(kind: MavAutopilot, wire: f32, of: MavParamType) -> f64 {
    let bytes = wire.to_le_bytes();
    if kind != MavAutopilot::MAV_AUTOPILOT_PX4 {
        return wire.into();
    }
    match of {
        MavParamType::MAV_PARAM_TYPE_INT8 => i8::from_le_bytes([bytes[0]]).into(),
        MavParamType::MAV_PARAM_TYPE_UINT8 => bytes[0].into(),
        MavParamType::MAV_PARAM_TYPE_INT16 => i16::from_le_bytes([bytes[0], bytes[1]]).into(),
        MavParamType::MAV_PARAM_TYPE_UINT16 => u16::from_le_bytes([bytes[0], bytes[1]]).into(),
        MavParamType::MAV_PARAM_TYPE_INT32 => i32::from_le_bytes(bytes).into(),
        MavParamType::MAV_PARAM_TYPE_UINT32 => u32::from_le_bytes(bytes).into(),
        _ => wire.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(kind: MavAutopilot, name: &str, value: Option<f64>, wanted: bool) -> (Mark, String) {
        let check = checks(kind).iter().find(|check| check.name == name).unwrap();
        let finding = check.find(name, value, wanted);
        (finding.mark, finding.text)
    }

    #[test]
    fn values_have_meanings() {
        let ardupilot = MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA;
        let px4 = MavAutopilot::MAV_AUTOPILOT_PX4;
        for (kind, name, value, mark) in [
            (ardupilot, "ADSB_TYPE", 0.0, Mark::Missing),
            (ardupilot, "ADSB_TYPE", 1.0, Mark::Good),
            (ardupilot, "AVD_ENABLE", 0.0, Mark::Note),
            (ardupilot, "SCR_ENABLE", 0.0, Mark::Note),
            (ardupilot, "SCR_ENABLE", 1.0, Mark::Good),
            (ardupilot, "AVD_WCLR_XY", 609.6, Mark::Good),
            (ardupilot, "AVD_WCLR_Z", 76.2, Mark::Good),
            (ardupilot, "AVD_NMAC_XY", 152.4, Mark::Good),
            (ardupilot, "AVD_NMAC_Z", 30.48, Mark::Good),
            (px4, "COM_TRAFF_AVOID", 0.0, Mark::Good),
            (px4, "COM_TRAFF_AVOID", 1.0, Mark::Note),
            (ardupilot, "PRX1_TYPE", 2.0, Mark::Good),
            (ardupilot, "PRX1_TYPE", 4.0, Mark::Missing),
            (ardupilot, "AVOID_ENABLE", 5.0, Mark::Missing),
            (ardupilot, "AVOID_ENABLE", 7.0, Mark::Good),
            (ardupilot, "OA_TYPE", 0.0, Mark::Note),
            (px4, "NAV_TRAFF_AVOID", 0.0, Mark::Missing),
            (px4, "NAV_TRAFF_AVOID", 1.0, Mark::Good),
            (px4, "CP_DIST", -1.0, Mark::Missing),
            (px4, "CP_DIST", 6.0, Mark::Good),
            (px4, "CP_GO_NO_DATA", 0.0, Mark::Note),
        ] {
            assert_eq!(found(kind, name, Some(value), true).0, mark, "{name} {value}");
        }
        let (mark, text) = found(ardupilot, "PRX1_TYPE", Some(0.0), false);
        assert_eq!(mark, Mark::Note);
        assert!(text.starts_with("OBSTACLE_DISTANCE (not asked for): PRX1_TYPE is 0: "), "{text}");
        assert_eq!(found(ardupilot, "ADSB_TYPE", None, true).0, Mark::Missing);
        assert_eq!(found(px4, "CP_GO_NO_DATA", None, true).0, Mark::Note);
        assert!(checks(MavAutopilot::MAV_AUTOPILOT_GENERIC).is_empty());
    }

    #[test]
    fn both_encodings_of_whole_numbers() {
        let px4 = MavAutopilot::MAV_AUTOPILOT_PX4;
        let ardupilot = MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA;
        let int = MavParamType::MAV_PARAM_TYPE_INT32;
        assert_eq!(value(px4, f32::from_bits(2), int), 2.0);
        assert_eq!(value(px4, f32::from_bits(-1i32 as u32), int), -1.0);
        assert_eq!(value(px4, 1.5, MavParamType::MAV_PARAM_TYPE_REAL32), 1.5);
        assert_eq!(value(ardupilot, 2.0, MavParamType::MAV_PARAM_TYPE_INT8), 2.0);
    }
}
