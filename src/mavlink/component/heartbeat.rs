//! Which heartbeats come from the autopilot of a vehicle.
//!
//! MAV_TYPE decides: cameras, gimbals, ground stations, receivers and onboard computers send heartbeats too, and some of
//! them put MAV_AUTOPILOT_GENERIC (0) where MAV_AUTOPILOT_INVALID (8) belongs. Numbers are those of MAVLink's `common`
//! dialect; a heartbeat is read by number, because it may hold one that is younger than this program.
//! Source: <https://mavlink.io/en/messages/common.html#MAV_TYPE>.

/// MAV_AUTOPILOT of a component that is no autopilot.
const INVALID: u8 = 8;
/// MAV_AUTOPILOT_ARDUPILOTMEGA and MAV_AUTOPILOT_PX4.
const FLIGHT_STACKS: [u8; 2] = [3, 12];
/// MAV_COMP_ID_AUTOPILOT1.
const AUTOPILOT1: u8 = 1;
/// First number of MAV_TYPE that this table does not know.
const UNKNOWN: u8 = 50;

/// Whether a heartbeat of `component` with these fields is that of a vehicle's autopilot: `mav_type` names a vehicle (in
/// the air, on the ground or on water) and `autopilot` is not MAV_AUTOPILOT_INVALID.
///
/// A type that is not in the table counts as a vehicle only from component 1 of ArduPilot or PX4.
pub const fn is_vehicle(mav_type: u8, autopilot: u8, component: u8) -> bool {
    if autopilot == INVALID {
        return false;
    }
    match mav_type {
        // Generic, fixed wing, multirotors, helicopter.
        0..=4
        // Airship, balloon, rocket, rover, boat, submarine, multirotors, flapping wing, kite.
        | 7..=17
        // VTOL.
        | 19..=25
        // Parafoil, dodecarotor, decarotor, generic multirotor.
        | 28 | 29 | 35 | 43
        // Orbiter, walking robot, gyrodyne.
        | 45..=47 => true,
        // Antenna tracker, ground station, onboard computer, gimbal, ADS-B and FLARM receivers, camera, charging station
        // and the parts of a vehicle.
        5 | 6 | 18 | 26 | 27 | 30..=34 | 36..=42 | 44 | 48 | 49 => false,
        UNKNOWN.. => {
            component == AUTOPILOT1
                && (autopilot == FLIGHT_STACKS[0] || autopilot == FLIGHT_STACKS[1])
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// MAV_TYPE of `common.xml` as of 2025-10, in order: true for vehicles.
    const TYPES: [(&str, bool); 50] = [
        ("GENERIC", true),
        ("FIXED_WING", true),
        ("QUADROTOR", true),
        ("COAXIAL", true),
        ("HELICOPTER", true),
        ("ANTENNA_TRACKER", false),
        ("GCS", false),
        ("AIRSHIP", true),
        ("FREE_BALLOON", true),
        ("ROCKET", true),
        ("GROUND_ROVER", true),
        ("SURFACE_BOAT", true),
        ("SUBMARINE", true),
        ("HEXAROTOR", true),
        ("OCTOROTOR", true),
        ("TRICOPTER", true),
        ("FLAPPING_WING", true),
        ("KITE", true),
        ("ONBOARD_CONTROLLER", false),
        ("VTOL_TAILSITTER_DUOROTOR", true),
        ("VTOL_TAILSITTER_QUADROTOR", true),
        ("VTOL_TILTROTOR", true),
        ("VTOL_FIXEDROTOR", true),
        ("VTOL_TAILSITTER", true),
        ("VTOL_TILTWING", true),
        ("VTOL_RESERVED5", true),
        ("GIMBAL", false),
        ("ADSB", false),
        ("PARAFOIL", true),
        ("DODECAROTOR", true),
        ("CAMERA", false),
        ("CHARGING_STATION", false),
        ("FLARM", false),
        ("SERVO", false),
        ("ODID", false),
        ("DECAROTOR", true),
        ("BATTERY", false),
        ("PARACHUTE", false),
        ("LOG", false),
        ("OSD", false),
        ("IMU", false),
        ("GPS", false),
        ("WINCH", false),
        ("GENERIC_MULTIROTOR", true),
        ("ILLUMINATOR", false),
        ("SPACECRAFT_ORBITER", true),
        ("GROUND_QUADRUPED", true),
        ("VTOL_GYRODYNE", true),
        ("GRIPPER", false),
        ("RADIO", false),
    ];

    #[test]
    fn vehicles_by_type_and_autopilot() {
        for (number, (name, vehicle)) in (0..).zip(TYPES) {
            // Every MAV_AUTOPILOT, and numbers to come.
            for autopilot in 0..=30 {
                for component in [1, 2, 100, 154, 156, 190, 191, 196] {
                    let want = vehicle && autopilot != INVALID;
                    let found = is_vehicle(number, autopilot, component);
                    assert_eq!(found, want, "{name}, autopilot {autopilot}, component {component}");
                }
            }
        }
    }

    #[test]
    fn types_to_come() {
        for number in UNKNOWN..=u8::MAX {
            assert!(is_vehicle(number, 3, 1) && is_vehicle(number, 12, 1));
            assert!(!is_vehicle(number, 0, 1) && !is_vehicle(number, 3, 100));
        }
    }
}
