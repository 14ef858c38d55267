//! Directions and attitudes.
//!
//! Axes: a camera's x is right, y down, z forward; a body's (FRD) x is forward, y right, z down; the world's (NED) x is
//! north, y east, z down.

use crate::math::real::{self, Real, Vector, add, cross, sin_cos, unit};
use fixed::types::I2F30;

/// A unit vector in Q30, along the axes that its user names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Direction {
    /// Forward (body) or north.
    pub x: I2F30,
    /// Right (body) or east.
    pub y: I2F30,
    /// Component downwards.
    pub z: I2F30,
}

impl From<Vector> for Direction {
    /// The vector at length 1.
    fn from(vector: Vector) -> Self {
        let [x, y, z] = unit(vector).map(I2F30::saturating_from_num);
        Self { x, y, z }
    }
}

impl From<Direction> for Vector {
    fn from(Direction { x, y, z }: Direction) -> Self {
        [x, y, z].map(Real::from_num)
    }
}

impl Direction {
    /// Angle to the right of forward (body), or from north to east, in radians, -pi to pi.
    pub fn azimuth(self) -> Real {
        let [x, y, _] = self.into();
        real::atan2(y, x)
    }

    /// Angle above the level plane in radians.
    pub fn elevation(self) -> Real {
        let [x, y, z]: Vector = self.into();
        real::atan2(-z, real::sqrt(x * x + y * y))
    }
}

/// A rotation as a unit quaternion: of a vehicle, from its body to the world (NED).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Attitude {
    /// Real part, cosine of half the angle.
    pub w: I2F30,
    /// Along the first axis.
    pub x: I2F30,
    /// Along the second axis.
    pub y: I2F30,
    /// Along the third axis.
    pub z: I2F30,
}

impl Attitude {
    /// The rotation that changes nothing.
    pub const IDENTITY: Self =
        Self { w: I2F30::ONE, x: I2F30::ZERO, y: I2F30::ZERO, z: I2F30::ZERO };

    /// From a camera that looks forward, its picture upright, to the body.
    pub const FORWARD: Self = {
        let half = I2F30::ONE.strict_shr(1);
        Self { w: half, x: half, y: half, z: half }
    };

    /// The quaternion at length 1; `None` when it has hardly any.
    #[inline(never)]
    pub fn new([w, x, y, z]: [Real; 4]) -> Option<Self> {
        let parts = [w, x, y, z];
        let largest = parts.into_iter().map(Real::saturating_abs).max()?;
        if largest < real::ratio(1, 1000) {
            return None;
        }
        let parts = parts.map(|v| real::divide(v, largest));
        let length = real::sqrt(parts.into_iter().map(|v| v * v).sum());
        let [w, x, y, z] = parts.map(|v| I2F30::saturating_from_num(v / length));
        Some(Self { w, x, y, z })
    }

    /// From angles in radians: yaw about down, then pitch about right, then roll about forward.
    #[inline(never)]
    pub fn from_euler(roll: Real, pitch: Real, yaw: Real) -> Self {
        let [(sr, cr), (sp, cp), (sy, cy)] = [roll, pitch, yaw].map(|a| sin_cos(a / 2));
        Self::new([
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ])
        .unwrap_or(Self::IDENTITY)
    }

    /// The turn about `vector` by its length in radians, for angles well below half a turn.
    pub fn from_small(vector: Vector) -> Self {
        // tan(a/2) is a/2 up to a^3/24: 1e-5 for 0.06 radians.
        Self::new([real::ONE, vector[0] / 2, vector[1] / 2, vector[2] / 2])
            .unwrap_or(Self::IDENTITY)
    }

    fn parts(self) -> [Real; 4] {
        [self.w, self.x, self.y, self.z].map(Real::from_num)
    }

    /// Composition: the rotation `first`, then `self`.
    #[inline(never)]
    pub fn compose(self, first: Self) -> Self {
        let ([aw, ax, ay, az], [bw, bx, by, bz]) = (self.parts(), first.parts());
        Self::new([
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ])
        .unwrap_or(Self::IDENTITY)
    }

    /// The inverse rotation: its transposed matrix, its conjugate quaternion.
    pub fn inverse(self) -> Self {
        Self { w: self.w, x: -self.x, y: -self.y, z: -self.z }
    }

    /// Turns a vector: from body to world.
    #[inline(never)]
    pub fn rotate(self, vector: Vector) -> Vector {
        let [w, x, y, z] = self.parts();
        let axis = [x, y, z];
        let twice = cross(axis, vector).map(|v| v * 2);
        add(add(vector, twice, w), cross(axis, twice), real::ONE)
    }

    /// The angle between two attitudes in radians.
    pub fn angle_to(self, other: Self) -> Real {
        let [w, x, y, z] = self.inverse().compose(other).parts();
        real::atan2(real::norm([x, y, z]), w.saturating_abs()) * 2
    }

    /// Normalised linear interpolation of quaternions on the shorter way: `self` at `part` 0, `other` at 1, extrapolation
    /// beyond; for near attitudes.
    pub fn nlerp(self, other: Self, part: Real) -> Self {
        let (a, b) = (self.parts(), other.parts());
        let cosine: Real = a.iter().zip(b).map(|(a, b)| *a * b).sum();
        let b = if cosine < real::ZERO { b.map(|v| -v) } else { b };
        Self::new(core::array::from_fn(|i| a[i] + (b[i] - a[i]) * part)).unwrap_or(other)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    type Matrix = [[f64; 3]; 3];

    /// Rz(yaw) Ry(pitch) Rx(roll).
    fn matrix([roll, pitch, yaw]: [f64; 3]) -> Matrix {
        let [(sr, cr), (sp, cp), (sy, cy)] = [roll, pitch, yaw].map(f64::sin_cos);
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    }

    fn apply(m: Matrix, v: [f64; 3]) -> [f64; 3] {
        m.map(|row| row.iter().zip(v).map(|(a, b)| a * b).sum())
    }

    fn euler(angles: [f64; 3]) -> Attitude {
        let [roll, pitch, yaw] = angles.map(Real::from_num);
        Attitude::from_euler(roll, pitch, yaw)
    }

    fn apart(a: Vector, b: [f64; 3]) -> f64 {
        let d: [f64; 3] = core::array::from_fn(|i| a[i].to_num::<f64>() - b[i]);
        d.iter().map(|v| v * v).sum::<f64>().sqrt()
    }

    proptest! {
        #[test]
        fn rotations_agree_with_matrices(a in proptest::array::uniform3(-3.0..3.0f64), b in proptest::array::uniform3(-3.0..3.0f64), v in proptest::array::uniform3(-1.0..1.0f64)) {
            let (p, q, vector) = (euler(a), euler(b), v.map(Real::from_num));
            prop_assert!(apart(p.rotate(vector), apply(matrix(a), v)) < 1e-5);
            prop_assert!(apart(p.compose(q).rotate(vector), apply(matrix(a), apply(matrix(b), v))) < 1e-5);
            prop_assert!(apart(p.inverse().rotate(p.rotate(vector)), v) < 1e-6);
        }

        #[test]
        fn angles_of_directions(azimuth in -3.1..3.1f64, elevation in -1.5..1.5f64) {
            let (se, ce) = elevation.sin_cos();
            let v = [azimuth.cos() * ce, azimuth.sin() * ce, -se].map(Real::from_num);
            let direction = Direction::from(v);
            prop_assert!((direction.azimuth().to_num::<f64>() - azimuth).abs() < 1e-5);
            prop_assert!((direction.elevation().to_num::<f64>() - elevation).abs() < 1e-6);
        }

        #[test]
        fn half_way_is_half_the_angle(a in proptest::array::uniform3(-3.0..3.0f64), turn in -0.2..0.2f64) {
            let start = euler(a);
            let end = start.compose(euler([0.0, turn, 0.0]));
            let middle = start.nlerp(end, Real::ONE / 2);
            let want = start.compose(euler([0.0, turn / 2.0, 0.0]));
            prop_assert!(middle.angle_to(want) < Real::from_num(1e-4));
            let whole: f64 = start.angle_to(end).to_num();
            prop_assert!((whole - turn.abs()).abs() < 1e-4);
        }

        #[test]
        fn no_quaternion_panics(q: [i64; 4], v: [i32; 3]) {
            if let Some(attitude) = Attitude::new(q.map(Real::from_bits)) {
                let vector = v.map(|v| Real::from_bits(v.into()));
                let _ = attitude.rotate(vector);
            }
        }
    }

    #[test]
    fn a_forward_camera() {
        let turned = |v: [i32; 3]| Attitude::FORWARD.rotate(v.map(Real::from_num));
        for (camera, body) in [
            ([0, 0, 1], [1.0, 0.0, 0.0]),
            ([1, 0, 0], [0.0, 1.0, 0.0]),
            ([0, 1, 0], [0.0, 0.0, 1.0]),
        ] {
            assert!(apart(turned(camera), body) < 1e-8);
        }
        let small = Attitude::from_small([0, 0, 1].map(|v| Real::from_num(v) / 50));
        assert!(small.angle_to(euler([0.0, 0.0, 0.02])) < Real::from_num(1e-5));
        assert_eq!(Attitude::new([Real::ZERO; 4]), None);
    }
}
