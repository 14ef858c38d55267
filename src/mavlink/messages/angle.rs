//! Angles as 32-bit fractions of a turn, and their functions by CORDIC.
//!
//! An [`Angle`] of 2^32 is a full turn, so sums wrap as angles do.
//! Source: J. Volder, "The CORDIC Trigonometric Computing Technique", 1959.

/// An angle in units of 2^-32 turns: -2^31..2^31 is -180..180 degrees.
pub type Angle = i32;

/// `atan(2^-i)` as an [`Angle`].
static ARCTANGENTS: [i32; 30] = [
    536870912, 316933406, 167458907, 85004756, 42667331, 21354465, 10679838, 5340245, 2670163,
    1335087, 667544, 333772, 166886, 83443, 41722, 20861, 10430, 5215, 2608, 1304, 652, 326, 163,
    81, 41, 20, 10, 5, 3, 1,
];

/// Inverse of the gain of 30 iterations of CORDIC, Q30.
const GAIN: i64 = 652_032_874;

const QUARTER: i32 = 1 << 30;

/// An angle of degrees times 10^7, as MAVLink has latitudes.
pub fn from_degrees_e7(degrees: i32) -> Angle {
    ((i64::from(degrees) << 32) / 3_600_000_000) as i32
}

/// An angle of radians with `places` fraction bits.
pub fn from_radians(radians: i64, places: u32) -> Angle {
    // 2^32 / (2 pi) = 683 565 275.6
    ((i128::from(radians) * 683_565_276) >> places) as i32
}

/// Hundredths of a degree, 0..36000, rounded.
pub fn centidegrees(angle: Angle) -> u16 {
    let turns = u64::from(angle as u32);
    (((turns * 36_000 + (1 << 31)) >> 32) % 36_000) as u16
}

/// Cosine and sine in Q30; error below 2^-24.
pub fn cos_sin(angle: Angle) -> (i32, i32) {
    // CORDIC turns by up to 99 degrees: the other half circle is its mirror image.
    let back = !(-QUARTER..=QUARTER).contains(&angle);
    let mut rest = i64::from(if back { angle.wrapping_add(i32::MIN) } else { angle });
    // Ten more places, for what the shifts cut off.
    let (mut x, mut y) = (GAIN << 10, 0);
    for (i, &step) in ARCTANGENTS.iter().enumerate() {
        let sign = if rest < 0 { -1 } else { 1 };
        (x, y) = (x - sign * (y >> i), y + sign * (x >> i));
        rest -= sign * i64::from(step);
    }
    let one = 1 << 30;
    let round = |v: i64| ((v + 512) >> 10).clamp(-one, one) as i32;
    let (x, y) = (round(x), round(y));
    if back { (-x, -y) } else { (x, y) }
}

/// The angle from the x axis towards the y axis; 0 for no direction at all. Error below 10^-6 degrees.
pub fn atan2(y: i64, x: i64) -> Angle {
    let largest = x.unsigned_abs().max(y.unsigned_abs());
    if largest == 0 {
        return 0;
    }
    // To 60 bits: what is smaller keeps its digits, and the gain of 1.65 has room.
    let shift = 4 - largest.leading_zeros() as i32;
    let scale = |v: i64| if shift > 0 { v >> shift } else { v << -shift };
    let (mut x, mut y) = (scale(x), scale(y));
    let mut angle = 0i32;
    if x < 0 {
        (x, y) = (-x, -y);
        angle = i32::MIN;
    }
    for (i, &step) in ARCTANGENTS.iter().enumerate() {
        let sign = if y > 0 { 1 } else { -1 };
        (x, y) = (x + sign * (y >> i), y - sign * (x >> i));
        angle = angle.wrapping_add(sign as i32 * step);
    }
    angle
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::TAU;
    use proptest::prelude::*;

    fn radians(angle: Angle) -> f64 {
        f64::from(angle) / 2f64.powi(32) * TAU
    }

    proptest! {
        #[test]
        fn cos_sin_agree_with_f64(angle: i32) {
            let (cos, sin) = cos_sin(angle);
            let error = 2f64.powi(-24);
            prop_assert!((f64::from(cos) / 2f64.powi(30) - radians(angle).cos()).abs() < error);
            prop_assert!((f64::from(sin) / 2f64.powi(30) - radians(angle).sin()).abs() < error);
        }

        #[test]
        fn atan2_agrees_with_f64(x: i64, y: i64, shift in 0..60) {
            let (x, y) = (x >> shift, y);
            let want = (y as f64).atan2(x as f64);
            let error = (radians(atan2(y, x)) - want).rem_euclid(TAU);
            prop_assert!(error.min(TAU - error) < 2e-8, "{error}");
        }
    }

    #[test]
    fn the_corners() {
        assert_eq!(atan2(0, 0), 0);
        for (y, x, centi) in [(0, 1, 0), (1, 1, 4500), (1, 0, 9000), (0, -1, 18000), (-1, 0, 27000)]
        {
            assert_eq!(centidegrees(atan2(y, x)), centi);
        }
        for extreme in [i64::MIN, i64::MAX] {
            atan2(extreme, extreme);
            atan2(1, extreme);
        }
        assert_eq!(centidegrees(-1), 0);
        assert_eq!(centidegrees(from_degrees_e7(-900_000_000)), 27_000);
        assert_eq!(centidegrees(from_radians(102_944, 16)), 9_000);
        assert_eq!(cos_sin(i32::MIN).0, -(1 << 30));
    }
}
