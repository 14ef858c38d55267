//! Aircraft on the map: ADSB_VEHICLE, and COLLISION, which colours them.
//!
//! Synthetic traffic: an object that is taken for a drone has an id below 0x004000, where no real aircraft has its own
//! and MAVProxy draws a drone; one that is taken for an aircraft has an id in a block that ICAO gave to no state. Nothing
//! is sent without a range, since both messages speak of places.

use super::{Vehicle, angle};
use crate::mavlink::dialect::{
    ADSB_VEHICLE_DATA, AdsbAltitudeType, AdsbEmitterType, AdsbFlags, COLLISION_DATA,
    MavCollisionAction, MavCollisionSrc, MavCollisionThreatLevel,
};
use crate::tracking::traffic::{AlertLevel, Traffic};
use core::fmt::Write;
use fixed::types::I16F16;
use mavlink_core::types::CharArray;

/// First id of objects that are taken for drones; those below 256 could be system ids.
pub const FIRST_DRONE: u32 = 0x000100;
/// First id of objects that are taken for aircraft: ICAO Annex 10 Volume III table 9-1 leaves 0xDxxxxx unassigned, and
/// ArduPlane's rule takes ids up to 0x00BFFF for drones and 0xB0xxxx for weather and birds.
pub const FIRST_AIRCRAFT: u32 = 0xD00000;
/// Ids of one lookout; those of another component on the same vehicle begin after them.
pub const IDS: u32 = 63;

/// Degrees times 10^7 in a millimetre of the equator, Q32: 10^7 * 2^32 / (pi / 180 * 6 378 137 000).
const DEGREES_E7_A_MM: i64 = 385_823_477;

/// Aircraft type that objects are reported as, since the detector has one class for all of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Assume {
    /// Drones: emitter type UAV (14), ids in the low band. ArduPlane's avoidance keeps 50 m from them.
    #[default]
    Drone,
    /// Aircraft with people in them: emitter type LIGHT (1), ids outside the bands of drones, weather and birds.
    /// ArduPlane's avoidance keeps its large margins from them.
    Aircraft,
}

/// Name of an aircraft: up to 8 letters and digits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Callsign([u8; 8]);

impl Callsign {
    /// The name of track number `track` of a lookout with this component id: `VIS0001` for the default component 196,
    /// `VC50001` for 197 (0xC5).
    pub fn of_track(component: u8, track: u16) -> Self {
        let mut name = heapless::String::<8>::new();
        let number = track % 10_000;
        // Seven letters have room in eight.
        let _ = match component {
            196 => write!(name, "VIS{number:04}"),
            _ => write!(name, "V{component:02X}{number:04}"),
        };
        Self::new(name.as_bytes()).unwrap_or_default()
    }

    /// A name from its letters, up to a NUL or space; `None` for one that is empty, longer than 8, or holds other bytes than
    /// printable ASCII.
    pub fn new(letters: &[u8]) -> Option<Self> {
        let end = letters.iter().position(|&c| c == 0 || c == b' ').unwrap_or(letters.len());
        let letters = &letters[..end];
        if letters.is_empty() || letters.len() > 8 || !letters.iter().all(u8::is_ascii_graphic) {
            return None;
        }
        let mut name = [0; 8];
        name[..letters.len()].copy_from_slice(letters);
        Some(Self(name))
    }

    /// Letters and digits without the padding, at most 8.
    pub fn as_str(&self) -> &str {
        let end = self.0.iter().position(|&c| c == 0).unwrap_or(self.0.len());
        core::str::from_utf8(&self.0[..end]).unwrap_or_default()
    }
}

impl core::fmt::Display for Callsign {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.as_str())
    }
}

/// Address, callsign and type of an object on the map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Identity {
    /// ICAO address, 24 bits: its key for every receiver.
    pub address: u32,
    /// Callsign of the object in ADSB_VEHICLE and in texts.
    pub callsign: Callsign,
    /// Aircraft type that it is reported as.
    pub assume: Assume,
}

impl Identity {
    /// The identity of an object by its slot (0 to [`IDS`] - 1) among those of a lookout of this component id.
    pub fn new(component: u8, slot: u32, callsign: Callsign, assume: Assume) -> Self {
        let first = match assume {
            Assume::Drone => FIRST_DRONE,
            Assume::Aircraft => FIRST_AIRCRAFT,
        };
        let address = first + u32::from(component) * IDS + slot % IDS;
        Self { address, callsign, assume }
    }

    /// Whether an address is in the bands of [`Identity::new`]: a lookout's own, or that of another one.
    pub fn is_synthetic(address: u32) -> bool {
        let ids = 256 * IDS;
        (FIRST_DRONE..FIRST_DRONE + ids).contains(&address)
            || (FIRST_AIRCRAFT..FIRST_AIRCRAFT + ids).contains(&address)
    }
}

/// Metres in Q16 along north, east, down (or body axes), of a direction and a distance.
pub(super) fn offset_q16(
    direction: &crate::tracking::traffic::Direction,
    range: I16F16,
) -> [i64; 3] {
    let range = i64::from(range.to_bits());
    [direction.x, direction.y, direction.z].map(|d| (range * i64::from(d.to_bits())) >> 30)
}

/// Millimetres along a meridian of `degrees_e7`, a difference of latitude in degrees times 10^7.
pub(crate) fn millimetres(degrees_e7: i64) -> i64 {
    ((degrees_e7 << 32) / DEGREES_E7_A_MM).clamp(-i64::from(i32::MAX), i64::from(i32::MAX))
}

/// Length of a vector of two, in its own unit.
fn length(a: i64, b: i64) -> u64 {
    (a.unsigned_abs().pow(2) + b.unsigned_abs().pow(2)).isqrt()
}

/// ADSB_VEHICLE (246) of an object last seen `seconds` ago. `None` unless it is confirmed, its distance and direction in
/// the world are known, and its place is on the map.
pub fn vehicle(
    traffic: &Traffic,
    own: &Vehicle,
    identity: &Identity,
    seconds: u8,
) -> Option<ADSB_VEHICLE_DATA> {
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
        ICAO_address: identity.address,
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
        callsign: CharArray::from(identity.callsign.as_str()),
        emitter_type: match identity.assume {
            Assume::Drone => AdsbEmitterType::ADSB_EMITTER_TYPE_UAV,
            Assume::Aircraft => AdsbEmitterType::ADSB_EMITTER_TYPE_LIGHT,
        },
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

/// COLLISION (247) of an object on the map, its threat by its level. Unknown values are NaN. `None` under the same
/// conditions as [`vehicle`], but for our own place.
pub fn collision(traffic: &Traffic, identity: &Identity) -> Option<COLLISION_DATA> {
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
        id: identity.address,
        time_to_minimum_delta: traffic.time_to_contact.map_or(f32::NAN, |t| t.value.to_num()),
        altitude_minimum_delta: altitude,
        horizontal_minimum_delta: horizontal,
        // Mission Planner believes this source only.
        src: MavCollisionSrc::MAV_COLLISION_SRC_ADSB,
        action: MavCollisionAction::MAV_COLLISION_ACTION_NONE,
        threat_level: match traffic.level {
            AlertLevel::None | AlertLevel::Traffic => {
                MavCollisionThreatLevel::MAV_COLLISION_THREAT_LEVEL_NONE
            }
            AlertLevel::Caution => MavCollisionThreatLevel::MAV_COLLISION_THREAT_LEVEL_LOW,
            AlertLevel::Warning => MavCollisionThreatLevel::MAV_COLLISION_THREAT_LEVEL_HIGH,
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mavlink::messages::tests::{any_traffic, own, traffic};
    use crate::tracking::traffic::Estimate;
    use proptest::prelude::*;

    fn identity(track: u16) -> Identity {
        Identity::new(196, track.into(), Callsign::of_track(196, track), Assume::Drone)
    }

    fn vehicle(traffic: &Traffic, own: &Vehicle, seconds: u8) -> Option<ADSB_VEHICLE_DATA> {
        super::vehicle(traffic, own, &identity(traffic.id), seconds)
    }

    fn collision(traffic: &Traffic) -> Option<COLLISION_DATA> {
        super::collision(traffic, &identity(traffic.id))
    }

    #[test]
    fn ids_and_names_of_two_lookouts_differ() {
        let mut seen = std::collections::BTreeSet::new();
        let mut names = std::collections::BTreeSet::new();
        for component in 1..=u8::MAX {
            for slot in 0..IDS {
                for assume in [Assume::Drone, Assume::Aircraft] {
                    let callsign = Callsign::of_track(component, slot as u16);
                    let identity = Identity::new(component, slot, callsign, assume);
                    assert!(seen.insert(identity.address), "{component} {slot}");
                    assert!(Identity::is_synthetic(identity.address));
                    // MAVProxy draws a drone up to 0x3FFF; ArduPlane's rule ends at 0xBFFF.
                    match assume {
                        Assume::Drone => assert!((0x100..=0x3FFF).contains(&identity.address)),
                        Assume::Aircraft => {
                            assert!((0xD00000..=0xD03FFF).contains(&identity.address));
                        }
                    }
                }
                assert!(
                    names.insert(std::format!("{}", Callsign::of_track(component, slot as u16)))
                );
            }
        }
        assert_eq!(Callsign::of_track(196, 1).as_str(), "VIS0001");
        assert_eq!(Callsign::of_track(197, 1).as_str(), "VC50001");
        assert!(!Identity::is_synthetic(0x4B1A2C) && !Identity::is_synthetic(0));
    }

    #[test]
    fn callsigns_from_messages() {
        for (letters, name) in [
            (&b"SWR12\0\0\0\0"[..], Some("SWR12")),
            (b"HBABC   \0", Some("HBABC")),
            (b"ABCDEFGH\0", Some("ABCDEFGH")),
            (b"ABCDEFGHI", None),
            (b"\0ABC", None),
            (b"A\xffB", None),
        ] {
            assert_eq!(Callsign::new(letters).map(|c| std::format!("{c}")).as_deref(), name);
        }
    }

    #[test]
    fn the_emitter_is_what_objects_are_taken_for() {
        for (assume, emitter) in [(Assume::Drone, 14), (Assume::Aircraft, 1)] {
            let identity = Identity { assume, ..identity(1) };
            let data = super::vehicle(&traffic(1), &own(), &identity, 0).unwrap();
            assert_eq!(data.emitter_type as u8, emitter);
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
        assert_eq!(data.ICAO_address, 0x100 + 196 * 63 + 7);
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
            level: AlertLevel::Warning,
            time_to_contact: Some(Estimate { value: I16F16::from_num(10), sigma: I16F16::ONE }),
            ..traffic(2)
        };
        let data = collision(&near).unwrap();
        // (212.1, 212.1, 0) + 10 s * (-20, 0, -1) m/s
        assert!((data.horizontal_minimum_delta - 212.5).abs() < 0.1, "{data:?}");
        assert!((data.altitude_minimum_delta - 10.0).abs() < 0.01);
        assert_eq!(data.time_to_minimum_delta, 10.0);
        assert_eq!(data.threat_level as u8, 2);
        assert_eq!((data.src as u8, data.id), (0, identity(2).address));
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
