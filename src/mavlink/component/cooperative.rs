//! Aircraft that transmit their own position (ADS-B, FLARM, Remote ID), as the autopilot passes them on by ADSB_VEHICLE.
//!
//! One in the direction of a track explains it: the track takes its callsign and gets a bonus on its log-odds. Only
//! directions are compared; ranges of tracks come from an assumed wingspan. Reports of lookouts, which an autopilot passes
//! on as well, are left out by their address: they would confirm themselves.

use super::Component;
use crate::mavlink::dialect::{ADSB_VEHICLE_DATA, AdsbAltitudeType, AdsbFlags};
use crate::mavlink::messages::adsb::{self, Callsign, Identity};
use crate::mavlink::messages::{Vehicle, angle};
use crate::tracking::traffic::{Direction, MAX_TRAFFIC, Traffic};

/// Most aircraft that are remembered.
pub(super) const AIRCRAFT: usize = 16;

/// A report older than this explains nothing, microseconds; ArduPilot forgets traffic after as long.
const STALE_US: i64 = 5_000_000;

/// Largest angle between track and report: 4 degrees for errors of the camera's mounting and the vehicle's attitude, in
/// binary angles (2^32 a turn).
const GATE: i64 = (4 << 32) / 360;

/// Largest gate, for reports near by: 20 degrees.
const MAX_GATE: i64 = (20 << 32) / 360;

/// Error of a reported position, millimetres: satellite navigation of both and a second of delay.
const PLACE_MM: i64 = 25_000;

/// Error of a reported altitude, millimetres: from a satellite fix, and from air pressure on a day whose pressure is
/// 20 hPa off the standard atmosphere.
const ALTITUDE_MM: [i64; 2] = [30_000, 160_000];

/// Farthest report that is compared, millimetres: no camera here sees an aircraft beyond.
const FAR_MM: i64 = 20_000_000;

/// An aircraft that transmits its position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Aircraft {
    /// ICAO address, 24 bits.
    pub address: u32,
    /// Its callsign, where it sends one.
    pub callsign: Option<Callsign>,
    latitude: i32,
    longitude: i32,
    altitude_mm: i32,
    is_pressure: bool,
    /// North and east in cm/s; zero where not known.
    velocity: [i64; 2],
    /// When it was there, in microseconds of our clock.
    time_us: i64,
    /// The track that it explains.
    track: Option<u16>,
}

/// Direction of an aircraft as seen from the vehicle: azimuth and elevation in binary angles, distance over ground in
/// millimetres.
struct Bearing {
    azimuth: i32,
    elevation: i32,
    distance: i64,
}

impl Aircraft {
    fn bearing(&self, own: &Vehicle, now_us: i64) -> Bearing {
        let cos = i64::from(angle::cos_sin(angle::from_degrees_e7(own.latitude)).0);
        let turn = 3_600_000_000i64;
        let wrapped = i64::from(self.longitude) - i64::from(own.longitude);
        let wrapped = (wrapped + turn / 2).rem_euclid(turn) - turn / 2;
        let age_us = now_us.saturating_sub(self.time_us).clamp(0, STALE_US);
        // cm/s times microseconds.
        let [north_moved, east_moved] = self.velocity.map(|v| v * age_us / 100_000);
        let north = adsb::millimetres(i64::from(self.latitude) - i64::from(own.latitude));
        let east = (adsb::millimetres(wrapped) * (cos >> 10)) >> 20;
        let (north, east) = (north + north_moved, east + east_moved);
        let up = i64::from(self.altitude_mm) - i64::from(own.altitude);
        let distance = (north.unsigned_abs().saturating_pow(2))
            .saturating_add(east.unsigned_abs().saturating_pow(2))
            .isqrt() as i64;
        Bearing {
            azimuth: angle::atan2(east, north),
            elevation: angle::atan2(up, distance),
            distance,
        }
    }

    /// Angle between this aircraft and a direction relative to the gate, Q16; `None` outside of the gate.
    fn mismatch(&self, direction: &Direction, own: &Vehicle, now_us: i64) -> Option<i64> {
        let bearing = self.bearing(own, now_us);
        if bearing.distance > FAR_MM {
            return None;
        }
        let [x, y, z] = [direction.x, direction.y, direction.z].map(|v| i64::from(v.to_bits()));
        let level = (x.unsigned_abs().pow(2) + y.unsigned_abs().pow(2)).isqrt() as i64;
        let gate = |error_mm: i64| {
            (GATE + i64::from(angle::atan2(error_mm, bearing.distance.max(1)))).min(MAX_GATE)
        };
        let off = |a: i32, b: i32| i64::from(a.wrapping_sub(b)).abs();
        // Azimuths mean less at steep angles.
        let cos = i64::from(angle::cos_sin(bearing.elevation).0).max(0);
        let aside = (off(angle::atan2(y, x), bearing.azimuth) * (cos >> 10)) >> 20;
        let above = off(angle::atan2(-z, level), bearing.elevation);
        let part = |off: i64, gate: i64| (off << 16) / gate.max(1);
        let (aside, above) = (
            part(aside, gate(PLACE_MM)),
            part(above, gate(ALTITUDE_MM[usize::from(self.is_pressure)])),
        );
        (aside.max(above) <= 1 << 16).then_some(aside.max(above))
    }
}

/// The angle of a heading of ADSB_VEHICLE: hundredths of a degree clockwise from north, at most 35999.
fn course(heading: u16) -> i32 {
    let east = i32::from(heading.min(35_999));
    // Beyond half a turn the other way round: 10^-7 degrees of a whole turn are more than 32 bits hold.
    let turn = if east > 18_000 { east - 36_000 } else { east };
    angle::from_degrees_e7(turn * 100_000)
}

impl Component {
    /// ADSB_VEHICLE that the autopilot passed on.
    pub(super) fn hear_aircraft(&mut self, data: &ADSB_VEHICLE_DATA, now_us: i64) {
        let needed = AdsbFlags::ADSB_FLAGS_VALID_COORDS | AdsbFlags::ADSB_FLAGS_VALID_ALTITUDE;
        let in_range = (-900_000_000..=900_000_000).contains(&data.lat)
            && (-1_800_000_000..=1_800_000_000).contains(&data.lon);
        let simulated = data.flags.contains(AdsbFlags::ADSB_FLAGS_SIMULATED);
        if !data.flags.contains(needed)
            || !in_range
            || simulated
            || Identity::is_synthetic(data.ICAO_address)
        {
            return;
        }
        let has = |flag| data.flags.contains(flag);
        let moving =
            has(AdsbFlags::ADSB_FLAGS_VALID_VELOCITY) && has(AdsbFlags::ADSB_FLAGS_VALID_HEADING);
        let (cos, sin) = angle::cos_sin(course(data.heading));
        let speed = if moving { i64::from(data.hor_velocity) } else { 0 };
        let named = has(AdsbFlags::ADSB_FLAGS_VALID_CALLSIGN);
        let aircraft = Aircraft {
            address: data.ICAO_address,
            callsign: Callsign::new(data.callsign.to_str().unwrap_or_default().as_bytes())
                .filter(|_| named),
            latitude: data.lat,
            longitude: data.lon,
            altitude_mm: data.altitude,
            is_pressure: data.altitude_type == AdsbAltitudeType::ADSB_ALTITUDE_TYPE_PRESSURE_QNH,
            velocity: [cos, sin].map(|part| (speed * i64::from(part)) >> 30),
            time_us: now_us.saturating_sub(i64::from(data.tslc) * 1_000_000),
            track: None,
        };
        match self.aircraft.iter_mut().find(|known| known.address == aircraft.address) {
            Some(known) => *known = Aircraft { track: known.track, ..aircraft },
            None => {
                if self.aircraft.is_full() {
                    let oldest = (0..AIRCRAFT).min_by_key(|&i| self.aircraft[i].time_us);
                    self.aircraft.swap_remove(oldest.unwrap_or(0));
                }
                let _ = self.aircraft.push(aircraft);
            }
        }
    }

    /// Finds which aircraft explains which track, the best pair first.
    pub(super) fn match_aircraft(&mut self, now_us: i64) {
        self.aircraft.retain(|known| now_us.saturating_sub(known.time_us) <= STALE_US);
        self.aircraft.iter_mut().for_each(|known| known.track = None);
        let Some(own) = self.fresh_vehicle(now_us) else { return };
        let mut pairs: heapless::Vec<(i64, usize, u16), { AIRCRAFT * MAX_TRAFFIC }> =
            heapless::Vec::new();
        for object in &self.traffic {
            let Some(ned) = object.ned else { continue };
            for (index, known) in self.aircraft.iter().enumerate() {
                if let Some(mismatch) = known.mismatch(&ned, &own, now_us) {
                    let _ = pairs.push((mismatch, index, object.id));
                }
            }
        }
        pairs.sort_unstable();
        for (_, index, track) in pairs {
            if self.aircraft[index].track.is_none() && self.aircraft_of(track).is_none() {
                self.aircraft[index].track = Some(track);
            }
        }
    }

    /// The aircraft that explains a track.
    pub fn aircraft_of(&self, track: u16) -> Option<&Aircraft> {
        self.aircraft.iter().find(|known| known.track == Some(track))
    }

    /// Tracks that an aircraft explains.
    pub fn explained(&self) -> impl Iterator<Item = u16> {
        self.aircraft.iter().filter_map(|known| known.track)
    }

    /// The object is reported: its track is not explained by an aircraft of the own fleet.
    pub(super) fn is_reported(&self, object: &Traffic) -> bool {
        !self.is_muted(object.id)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headings_to_the_west_are_not_wrapped() {
        for (heading, degrees) in [(0, 0), (9_000, 90), (18_000, 180), (27_000, -90), (35_900, -1)]
        {
            assert_eq!(course(heading), angle::from_degrees_e7(degrees * 10_000_000), "{heading}");
        }
        assert_eq!(course(u16::MAX), course(35_999));
    }
}
