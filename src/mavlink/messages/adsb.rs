//! Aircraft on the map: ADSB_VEHICLE, and COLLISION, which colours them.
//!
//! Synthetic traffic: the ids lie below 0x004000, where no real aircraft has its own and MAVProxy draws a drone. Nothing
//! is sent without a range, since both messages speak of places.

use super::{Vehicle, angle};
use crate::mavlink::dialect::{
    ADSB_VEHICLE_DATA, AdsbAltitudeType, AdsbEmitterType, AdsbFlags, COLLISION_DATA,
    MavCollisionAction, MavCollisionSrc, MavCollisionThreatLevel,
};
use crate::tracking::traffic::{Level, Traffic};
use core::fmt::Write;
use fixed::types::I16F16;
use mavlink_core::types::CharArray;

/// The first of the synthetic ids; those below 256 could be system ids.
pub const FIRST_ID: u32 = 0x000100;
/// The last of them.
pub const LAST_ID: u32 = 0x003FFF;

/// Degrees times 10^7 in a millimetre of the equator, Q32: 10^7 * 2^32 / (pi / 180 * 6 378 137 000).
const DEGREES_E7_A_MM: i64 = 385_823_477;

/// The id of a track on the map; the same for as long as the track lives.
pub fn address(track: u16) -> u32 {
    FIRST_ID + u32::from(track.wrapping_sub(1)) % (LAST_ID + 1 - FIRST_ID)
}

/// The name of a track on the map: `VIS0001`.
pub fn callsign(track: u16) -> heapless::String<8> {
    let mut name = heapless::String::new();
    // Seven letters have room in eight.
    let _ = write!(name, "VIS{:04}", track % 10_000);
    name
}

/// Metres in Q16 along north, east, down (or body axes), of a direction and a distance.
pub(super) fn offset_q16(
    direction: &crate::tracking::traffic::Direction,
    range: I16F16,
) -> [i64; 3] {
    let range = i64::from(range.to_bits());
    [direction.x, direction.y, direction.z].map(|d| (range * i64::from(d.to_bits())) >> 30)
}

/// Length of a vector of two, in its own unit.
fn length(a: i64, b: i64) -> u64 {
    (a.unsigned_abs().pow(2) + b.unsigned_abs().pow(2)).isqrt()
}

/// ADSB_VEHICLE (246) of an object last seen `seconds` ago. `None` unless it is confirmed, its distance and direction in
/// the world are known, and its place is on the map.
pub fn vehicle(traffic: &Traffic, own: &Vehicle, seconds: u8) -> Option<ADSB_VEHICLE_DATA> {
    let range = traffic.range.filter(|range| traffic.confirmed && range.value > 0)?;
    let [north, east, down] =
        offset_q16(&traffic.ned?, range.value).map(|metres| (metres * 1000) >> 16);
    let latitude = i64::from(own.latitude) + ((north * DEGREES_E7_A_MM) >> 32);
    let cos = i64::from(angle::cos_sin(angle::from_degrees_e7(own.latitude)).0);
    // Within 60 km of a pole degrees of longitude say nothing.
    if cos < 1 << 23 || latitude.abs() > 900_000_000 {
        return None;
    }
    let turn = 3_600_000_000;
    let longitude = i64::from(own.longitude) + (((east * DEGREES_E7_A_MM) >> 32) << 30) / cos;
    let longitude = (longitude + turn / 2).rem_euclid(turn) - turn / 2;

    let mut data = ADSB_VEHICLE_DATA {
        ICAO_address: address(traffic.id),
        lat: latitude as i32,
        lon: longitude as i32,
        altitude: (i64::from(own.altitude) - down).clamp(i32::MIN.into(), i32::MAX.into()) as i32,
        heading: 0,
        hor_velocity: 0,
        ver_velocity: 0,
        flags: AdsbFlags::ADSB_FLAGS_VALID_COORDS
            | AdsbFlags::ADSB_FLAGS_VALID_ALTITUDE
            | AdsbFlags::ADSB_FLAGS_VALID_CALLSIGN,
        squawk: 0,
        altitude_type: AdsbAltitudeType::ADSB_ALTITUDE_TYPE_GEOMETRIC,
        callsign: CharArray::from(callsign(traffic.id).as_str()),
        emitter_type: AdsbEmitterType::ADSB_EMITTER_TYPE_NO_INFO,
        tslc: seconds,
    };
    if let Some(relative) = traffic.velocity {
        let mut velocity = [0i64; 3];
        for (v, (own, relative)) in velocity.iter_mut().zip(own.velocity.iter().zip(relative)) {
            *v = i64::from(*own) + ((i64::from(relative.to_bits()) * 100) >> 16);
        }
        let [north, east, down] = velocity;
        data.heading = angle::centidegrees(angle::atan2(east, north));
        data.hor_velocity = length(north, east).min(u16::MAX.into()) as u16;
        data.ver_velocity = (-down).clamp(i16::MIN.into(), i16::MAX.into()) as i16;
        data.flags |= AdsbFlags::ADSB_FLAGS_VALID_HEADING
            | AdsbFlags::ADSB_FLAGS_VALID_VELOCITY
            | AdsbFlags::ADSB_FLAGS_VERTICAL_VELOCITY_VALID;
    }
    Some(data)
}

/// COLLISION (247) of an object on the map, its threat by its level. What is not known is NaN. `None` under the same
/// conditions as [`vehicle`], but for our own place.
pub fn collision(traffic: &Traffic) -> Option<COLLISION_DATA> {
    let range = traffic.range.filter(|range| traffic.confirmed && range.value > 0)?;
    let ned = traffic.ned?;
    let mut altitude = f32::NAN;
    let mut horizontal = traffic.closest.map_or(f32::NAN, |closest| closest.value.to_num());
    if let (Some(velocity), Some(time)) = (traffic.velocity, traffic.time_to_contact) {
        let mut at = offset_q16(&ned, range.value);
        for (at, velocity) in at.iter_mut().zip(velocity) {
            let moved = (i64::from(velocity.to_bits()) * i64::from(time.value.to_bits())) >> 16;
            // 32 km are as far as these numbers go.
            *at = (*at + moved).clamp(-i64::from(i32::MAX), i32::MAX.into());
        }
        let metres = |q16: u64| I16F16::from_bits(q16.min(i32::MAX as u64) as i32).to_num();
        altitude = metres(at[2].unsigned_abs());
        horizontal = metres(length(at[0], at[1]));
    }
    Some(COLLISION_DATA {
        id: address(traffic.id),
        time_to_minimum_delta: traffic.time_to_contact.map_or(f32::NAN, |t| t.value.to_num()),
        altitude_minimum_delta: altitude,
        horizontal_minimum_delta: horizontal,
        // Mission Planner believes this source only.
        src: MavCollisionSrc::MAV_COLLISION_SRC_ADSB,
        action: MavCollisionAction::MAV_COLLISION_ACTION_NONE,
        threat_level: match traffic.level {
            Level::None | Level::Traffic => {
                MavCollisionThreatLevel::MAV_COLLISION_THREAT_LEVEL_NONE
            }
            Level::Caution => MavCollisionThreatLevel::MAV_COLLISION_THREAT_LEVEL_LOW,
            Level::Warning => MavCollisionThreatLevel::MAV_COLLISION_THREAT_LEVEL_HIGH,
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mavlink::messages::tests::{any_traffic, own, traffic};
    use crate::tracking::traffic::Estimate;
    use proptest::prelude::*;

    #[test]
    fn ids_are_stable_and_in_their_band() {
        assert_eq!(address(1), FIRST_ID);
        assert_eq!(callsign(1), "VIS0001");
        for track in 0..=u16::MAX {
            assert!((FIRST_ID..=LAST_ID).contains(&address(track)));
            assert_ne!(address(track), address(track.wrapping_add(1)));
        }
    }

    /// 300 m to the north-east and level, seen from Zurich, against the plain formula in f64.
    #[test]
    fn places_agree_with_f64() {
        let data = vehicle(&traffic(7), &own(), 0).unwrap();
        let metres = 300.0 / 2f64.sqrt();
        let degree = 6_378_137.0 * core::f64::consts::PI / 180.0;
        let latitude = 47.3769 + metres / degree;
        let longitude = 8.5417 + metres / degree / 47.3769f64.to_radians().cos();
        assert!((f64::from(data.lat) / 1e7 - latitude).abs() < 3e-7, "{}", data.lat);
        assert!((f64::from(data.lon) / 1e7 - longitude).abs() < 3e-7, "{}", data.lon);
        assert_eq!(data.altitude, 500_000);
        // Own velocity 10 m/s north; relative 20 m/s south, 1 m/s up.
        assert_eq!((data.heading, data.hor_velocity, data.ver_velocity), (18_000, 1000, 100));
        assert_eq!(data.ICAO_address, 0x106);
        assert_eq!(data.callsign.to_str(), Ok("VIS0007"));
        assert_eq!(data.flags.bits(), 1 + 2 + 4 + 8 + 16 + 128);
        assert_eq!(data.altitude_type, AdsbAltitudeType::ADSB_ALTITUDE_TYPE_GEOMETRIC);
    }

    #[test]
    fn nothing_is_claimed_that_is_not_known() {
        let known = traffic(1);
        assert!(vehicle(&Traffic { confirmed: false, ..known }, &own(), 0).is_none());
        assert!(vehicle(&Traffic { range: None, ..known }, &own(), 0).is_none());
        assert!(vehicle(&Traffic { ned: None, ..known }, &own(), 0).is_none());
        let data = vehicle(&Traffic { velocity: None, ..known }, &own(), 3).unwrap();
        assert_eq!((data.flags.bits(), data.tslc), (1 + 2 + 16, 3));
        assert!(collision(&Traffic { range: None, ..known }).is_none());
        let unknown = Traffic { velocity: None, closest: None, time_to_contact: None, ..known };
        let data = collision(&unknown).unwrap();
        assert!(data.time_to_minimum_delta.is_nan() && data.horizontal_minimum_delta.is_nan());
    }

    #[test]
    fn collision_tells_the_closest_approach() {
        let near = Traffic {
            level: Level::Warning,
            time_to_contact: Some(Estimate { value: I16F16::from_num(10), sigma: I16F16::ONE }),
            ..traffic(2)
        };
        let data = collision(&near).unwrap();
        // (212.1, 212.1, 0) + 10 s * (-20, 0, -1) m/s
        assert!((data.horizontal_minimum_delta - 212.5).abs() < 0.1, "{data:?}");
        assert!((data.altitude_minimum_delta - 10.0).abs() < 0.01);
        assert_eq!(data.time_to_minimum_delta, 10.0);
        assert_eq!(data.threat_level as u8, 2);
        assert_eq!((data.src as u8, data.id), (0, address(2)));
    }

    proptest! {
        #[test]
        fn any_traffic_anywhere(
            traffic in any_traffic(), latitude in -900_000_000..=900_000_000, longitude in -1_800_000_000..=1_800_000_000,
            altitude: i32, velocity: [i16; 3], seconds: u8,
        ) {
            let own = Vehicle { latitude, longitude, altitude, velocity, time_us: 0 };
            if let Some(data) = vehicle(&traffic, &own, seconds) {
                prop_assert!((-900_000_000..=900_000_000).contains(&data.lat));
                prop_assert!((-1_800_000_000..=1_800_000_000).contains(&data.lon));
                prop_assert!(data.heading < 36_000);
            }
            collision(&traffic);
        }
    }
}
