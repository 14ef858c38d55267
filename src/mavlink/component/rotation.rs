//! Rotations as messages have them, in integers.

use crate::mavlink::messages::angle;
use fixed::types::{I2F30, I8F24};

/// A unit quaternion in Q30; `None` for one that is far from unit length.
pub fn quaternion(wire: [f32; 4]) -> Option<[i32; 4]> {
    let mut bits = [0i64; 4];
    for (bits, &value) in bits.iter_mut().zip(&wire) {
        *bits = I2F30::checked_from_num(value)?.to_bits().into();
    }
    unit(bits)
}

/// Source: Euler angles yaw, pitch, roll in this order, as ATTITUDE has them.
pub fn from_euler(wire: [f32; 3]) -> Option<[i32; 4]> {
    let mut halves = [(0i64, 0i64); 3];
    for (half, &value) in halves.iter_mut().zip(&wire) {
        let radians = i64::from(I8F24::checked_from_num(value)?.to_bits());
        // Nine places further: eight from Q24 to Q16, one for half of the angle.
        let (cos, sin) = angle::cos_sin(angle::from_radians(radians, 25));
        *half = (cos.into(), sin.into());
    }
    let [(cr, sr), (cp, sp), (cy, sy)] = halves;
    let product = |a: i64, b: i64, c: i64| (((a * b) >> 30) * c) >> 30;
    unit([
        product(cr, cp, cy) + product(sr, sp, sy),
        product(sr, cp, cy) - product(cr, sp, sy),
        product(cr, sp, cy) + product(sr, cp, sy),
        product(cr, cp, sy) - product(sr, sp, cy),
    ])
}

/// `turned` (Q30) turned about down by `yaw` radians; `None` for no number.
pub fn turned_by_yaw(yaw: f32, turned: [i32; 4]) -> Option<[i32; 4]> {
    let [cosine, _, _, sine] = from_euler([0.0, 0.0, yaw])?.map(i64::from);
    let [w, x, y, z] = turned.map(i64::from);
    unit([
        (cosine * w - sine * z) >> 30,
        (cosine * x - sine * y) >> 30,
        (cosine * y + sine * x) >> 30,
        (cosine * z + sine * w) >> 30,
    ])
}

/// A Q30 quaternion brought to unit length.
fn unit(bits: [i64; 4]) -> Option<[i32; 4]> {
    let length: u128 = bits.iter().map(|b| u128::from(b.unsigned_abs()).pow(2)).sum();
    let length = length.isqrt() as i64;
    let one = 1i64 << 30;
    if !(one * 9 / 10..=one * 11 / 10).contains(&length) {
        return None;
    }
    Some(bits.map(|b| ((b << 30) / length) as i32))
}
