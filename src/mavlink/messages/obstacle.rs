//! Objects as obstacles for an autopilot: OBSTACLE_DISTANCE and OBSTACLE_DISTANCE_3D.
//!
//! Both report near objects only: directions without one stay unknown, never free. A lookout for flying objects sees
//! no trees and no wires.

use super::adsb::offset_q16;
use super::angle;
use crate::mavlink::dialect::{
    MavDistanceSensor, MavFrame, OBSTACLE_DISTANCE_3D_DATA, OBSTACLE_DISTANCE_DATA,
};
use crate::tracking::traffic::Traffic;
use fixed::types::I16F16;

/// Least distance that is reported, in centimetres.
pub const MIN_CM: u16 = 100;

/// Nothing is known of this direction.
pub const UNKNOWN: u16 = u16::MAX;

const BINS: usize = 72;

/// Objects higher or lower than this over the vehicle's plane are no obstacles around it: sine of 45 degrees in Q30.
const STEEP: i64 = 759_250_125;

/// OBSTACLE_DISTANCE (330) of all confirmed objects with a range up to `max_cm`, clockwise from the nose.
///
/// In the one encoding every receiver reads alike: 72 bins of 5 degrees, in both fields of the increment, no offset,
/// body axes. An object covers the bins within two standard deviations of its direction, at most three to each side.
pub fn distances(traffic: &[Traffic], max_cm: u16, time_us: i64) -> OBSTACLE_DISTANCE_DATA {
    let mut distances = [UNKNOWN; BINS];
    // A distance of 65535 would read as unknown.
    let max_cm = max_cm.clamp(MIN_CM, UNKNOWN - 1);
    for object in traffic.iter().filter(|object| object.confirmed) {
        let Some(range) = object.range.filter(|range| range.value > 0) else { continue };
        let centimetres = (i64::from(range.value.to_bits()) * 100) >> 16;
        let up = i64::from(object.body.z.to_bits()).abs();
        if centimetres > i64::from(max_cm) || up > STEEP {
            continue;
        }
        let centimetres = (centimetres as u16).max(MIN_CM);
        let bearing = angle::atan2(object.body.y.to_bits().into(), object.body.x.to_bits().into());
        let sigma = i64::from(object.direction_sigma.to_bits()).clamp(0, 10_000);
        let spread = 2 * i64::from(angle::from_radians(sigma, 16));
        let bin = |angle: i64| (angle * BINS as i64 + (1 << 31)) >> 32;
        let bearing = i64::from(bearing);
        let middle = bin(bearing);
        for bin in bin(bearing - spread).max(middle - 3)..=bin(bearing + spread).min(middle + 3) {
            let distance = &mut distances[bin.rem_euclid(BINS as i64) as usize];
            *distance = centimetres.min(*distance);
        }
    }
    OBSTACLE_DISTANCE_DATA {
        time_usec: time_us.max(0) as u64,
        distances,
        min_distance: MIN_CM,
        max_distance: max_cm,
        sensor_type: MavDistanceSensor::MAV_DISTANCE_SENSOR_UNKNOWN,
        increment: 5,
        increment_f: 5.0,
        angle_offset: 0.0,
        frame: MavFrame::MAV_FRAME_BODY_FRD,
    }
}

/// OBSTACLE_DISTANCE_3D (11037) of one object, in body axes. `None` unless it is confirmed and within `max_cm`.
///
/// `time_boot_ms` is the same for all objects of one picture, and another one for the next.
pub fn point(
    object: &Traffic,
    max_cm: u16,
    time_boot_ms: u32,
) -> Option<OBSTACLE_DISTANCE_3D_DATA> {
    let range = object.range.filter(|range| object.confirmed && range.value > 0)?;
    if (i64::from(range.value.to_bits()) * 100) >> 16 > i64::from(max_cm) {
        return None;
    }
    let [x, y, z] = offset_q16(&object.body, range.value)
        .map(|q16| I16F16::from_bits(q16.clamp(i32::MIN.into(), i32::MAX.into()) as i32).to_num());
    Some(three_d(x, y, z, object.id, max_cm, time_boot_ms))
}

/// OBSTACLE_DISTANCE_3D for "nothing near": a point beyond the largest distance. ArduPilot takes it for a sign of life and
/// clears its picture; the message has no other way to say so.
pub fn nothing(max_cm: u16, time_boot_ms: u32) -> OBSTACLE_DISTANCE_3D_DATA {
    let beyond = I16F16::saturating_from_num(max_cm / 50).to_num();
    three_d(beyond, 0.0, 0.0, UNKNOWN, max_cm, time_boot_ms)
}

fn three_d(
    x: f32,
    y: f32,
    z: f32,
    obstacle_id: u16,
    max_cm: u16,
    time_boot_ms: u32,
) -> OBSTACLE_DISTANCE_3D_DATA {
    let metres = |cm: u16| (I16F16::saturating_from_num(cm) / 100).to_num();
    OBSTACLE_DISTANCE_3D_DATA {
        time_boot_ms,
        x,
        y,
        z,
        min_distance: metres(MIN_CM),
        max_distance: metres(max_cm),
        obstacle_id,
        sensor_type: MavDistanceSensor::MAV_DISTANCE_SENSOR_UNKNOWN,
        frame: MavFrame::MAV_FRAME_BODY_FRD,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mavlink::messages::tests::{any_traffic, direction, metres, traffic};
    use proptest::prelude::*;

    fn at(bearing: f64, elevation: f64, range: i32) -> Traffic {
        Traffic {
            body: direction(bearing, elevation),
            range: Some(metres(range)),
            direction_sigma: I16F16::from_num(0.002),
            ..traffic(1)
        }
    }

    fn filled(data: &OBSTACLE_DISTANCE_DATA) -> std::vec::Vec<(usize, u16)> {
        let known = data.distances.iter().copied().enumerate();
        known.filter(|&(_, d)| d != UNKNOWN).collect()
    }

    #[test]
    fn the_one_encoding_all_receivers_read_alike() {
        let data = distances(&[], 10_000, 5);
        assert_eq!((data.increment, data.increment_f, data.angle_offset), (5, 5.0, 0.0));
        assert_eq!((data.frame as u8, data.min_distance, data.max_distance), (12, 100, 10_000));
        assert_eq!(data.distances, [65535; 72]);
    }

    #[test]
    fn bins_go_clockwise_from_the_nose() {
        for (bearing, bin) in
            [(0.0, 0), (2.0, 0), (5.0, 1), (90.0, 18), (-5.0, 71), (180.0, 36), (-2.0, 0)]
        {
            let data = distances(&[at(bearing, 0.0, 40)], 10_000, 0);
            assert_eq!(filled(&data), [(bin, 4000)], "{bearing}");
        }
        // Between two bins both are taken.
        assert_eq!(filled(&distances(&[at(2.49, 0.0, 40)], 10_000, 0)), [(0, 4000), (1, 4000)]);
        let near = distances(&[at(0.0, 0.0, 40), at(1.0, 10.0, 30), at(0.0, 0.0, 90)], 10_000, 0);
        assert_eq!(filled(&near), [(0, 3000)]);
    }

    #[test]
    fn what_is_too_far_or_overhead_is_left_out() {
        assert!(filled(&distances(&[at(0.0, 0.0, 101)], 10_000, 0)).is_empty());
        assert!(filled(&distances(&[at(0.0, 60.0, 40)], 10_000, 0)).is_empty());
        assert!(
            filled(&distances(&[Traffic { range: None, ..at(0.0, 0.0, 1) }], 10_000, 0)).is_empty()
        );
        assert!(point(&at(0.0, 0.0, 101), 10_000, 0).is_none());
    }

    #[test]
    fn points_are_in_body_axes() {
        let data = point(&at(90.0, 30.0, 50), 10_000, 77).unwrap();
        assert!(
            data.x.abs() < 0.01 && (data.y - 43.3).abs() < 0.01 && (data.z + 25.0).abs() < 0.01,
            "{data:?}"
        );
        assert_eq!((data.time_boot_ms, data.obstacle_id, data.frame as u8), (77, 1, 12));
        assert_eq!((data.min_distance, data.max_distance), (1.0, 100.0));
        assert!(nothing(10_000, 0).x > 100.0);
    }

    proptest! {
        #[test]
        fn never_free_always_in_range(objects in prop::collection::vec(any_traffic(), 0..8), max_cm: u16, time: i64) {
            let data = distances(&objects, max_cm, time);
            prop_assert!(data.distances.iter().all(|&d| d == UNKNOWN || (data.min_distance..=data.max_distance).contains(&d)));
            for object in &objects {
                if let Some(data) = point(object, max_cm, 0) {
                    prop_assert!(data.x.is_finite() && data.y.is_finite() && data.z.is_finite());
                }
            }
        }
    }
}
