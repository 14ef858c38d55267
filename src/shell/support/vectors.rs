//! Numbers that are the same on every processor: only IEEE-exact operations, nothing of a libm.

/// A vector; x right, y down, z forward.
pub type WorldVector = [f64; 3];

const FRAC_PI_2: f64 = core::f64::consts::FRAC_PI_2;

/// Sine and cosine of an angle of some turns at most, radians; within 1e-13.
pub fn sin_cos(angle: f64) -> (f64, f64) {
    let quarter = angle / FRAC_PI_2;
    let quarter = (if quarter < 0.0 { quarter - 0.5 } else { quarter + 0.5 }) as i64;
    let x = angle - quarter as f64 * FRAC_PI_2;
    let square = x * x;
    // Taylor series to x^15 and x^16 in nested form: enough below pi / 4.
    let (mut sine, mut cosine) = (1.0, 1.0);
    for n in [7.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0] {
        sine = 1.0 - sine * square / ((2.0 * n) * (2.0 * n + 1.0));
    }
    for n in [8.0, 7.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0] {
        cosine = 1.0 - cosine * square / ((2.0 * n - 1.0) * (2.0 * n));
    }
    let sine = sine * x;
    match quarter.rem_euclid(4) {
        0 => (sine, cosine),
        1 => (cosine, -sine),
        2 => (-sine, -cosine),
        _ => (-cosine, sine),
    }
}

/// Angle of the point (x, y) to the x axis, radians in -pi..=pi; within 1e-13.
pub fn atan2(y: f64, x: f64) -> f64 {
    let length = (x * x + y * y).sqrt();
    if length == 0.0 {
        return 0.0;
    }
    // Halving the angle three times brings its tangent below 0.42, where the series is short.
    let (mut c, mut s) = (x / length, y / length);
    for _ in 0..3 {
        let half = if c >= 0.0 {
            let c2 = ((1.0 + c) / 2.0).sqrt();
            (c2, s / (2.0 * c2))
        } else {
            let s2 = ((1.0 - c) / 2.0).sqrt();
            let s2 = if s < 0.0 { -s2 } else { s2 };
            (s / (2.0 * s2), s2)
        };
        (c, s) = half;
    }
    let tangent = s / c;
    let square = tangent * tangent;
    let mut sum = 0.0;
    for n in (0..20).rev() {
        let term = 1.0 / f64::from(2 * n + 1);
        sum = (if n % 2 == 0 { term } else { -term }) + sum * square;
    }
    8.0 * tangent * sum
}

/// Dot product a · b.
pub fn dot(a: WorldVector, b: WorldVector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// `a + b * scale`.
pub fn add(a: WorldVector, b: WorldVector, scale: f64) -> WorldVector {
    [a[0] + b[0] * scale, a[1] + b[1] * scale, a[2] + b[2] * scale]
}

/// The direction with this azimuth (right) and elevation (down), radians.
pub fn direction(azimuth: f64, elevation: f64) -> WorldVector {
    let (sa, ca) = sin_cos(azimuth);
    let (se, ce) = sin_cos(elevation);
    [sa * ce, se, ca * ce]
}

/// A rotation matrix, row by row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rotation([WorldVector; 3]);

impl Rotation {
    /// `Ry(yaw) Rx(pitch) Rz(roll)`: from the turned frame to the world, radians.
    pub fn new(yaw: f64, pitch: f64, roll: f64) -> Self {
        let (sy, cy) = sin_cos(yaw);
        let (sp, cp) = sin_cos(pitch);
        let (sr, cr) = sin_cos(roll);
        Self([
            [cy * cr + sy * sp * sr, -cy * sr + sy * sp * cr, sy * cp],
            [cp * sr, cp * cr, -sp],
            [-sy * cr + cy * sp * sr, sy * sr + cy * sp * cr, cy * cp],
        ])
    }

    /// `v` rotated; [`invert`](Self::invert) turns it back.
    pub fn apply(&self, v: WorldVector) -> WorldVector {
        [dot(self.0[0], v), dot(self.0[1], v), dot(self.0[2], v)]
    }

    /// Turns a vector back.
    pub fn invert(&self, v: WorldVector) -> WorldVector {
        let [[a, b, c], [d, e, f], [g, h, i]] = self.0;
        [dot([a, d, g], v), dot([b, e, h], v), dot([c, f, i], v)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_agree_with_the_standard_library() {
        for step in -4000..4000 {
            let angle = f64::from(step) * 0.00517;
            let (sine, cosine) = sin_cos(angle);
            assert!((sine - angle.sin()).abs() < 1e-13, "{angle}");
            assert!((cosine - angle.cos()).abs() < 1e-13, "{angle}");
            let found = atan2(3.0 * sine, 3.0 * cosine);
            assert!((found - angle.sin().atan2(angle.cos())).abs() < 1e-13, "{angle}");
        }
        assert_eq!(atan2(0.0, 0.0), 0.0);
        assert!((atan2(0.0, -1.0).abs() - core::f64::consts::PI).abs() < 1e-13);
    }

    #[test]
    fn rotations_are_the_product_of_their_axes() {
        let vector = [0.3, -0.7, 1.9];
        let (yaw, pitch, roll) = (0.4, -0.9, 0.2);
        let whole = Rotation::new(yaw, pitch, roll);
        let parts = Rotation::new(yaw, 0.0, 0.0).apply(
            Rotation::new(0.0, pitch, 0.0).apply(Rotation::new(0.0, 0.0, roll).apply(vector)),
        );
        let back = whole.invert(whole.apply(vector));
        for axis in 0..3 {
            assert!((whole.apply(vector)[axis] - parts[axis]).abs() < 1e-12);
            assert!((back[axis] - vector[axis]).abs() < 1e-12);
        }
        // Positive yaw looks right, negative pitch looks down (y is down).
        assert!(Rotation::new(0.1, 0.0, 0.0).apply([0.0, 0.0, 1.0])[0] > 0.0);
        assert!(Rotation::new(0.0, -0.1, 0.0).apply([0.0, 0.0, 1.0])[1] > 0.0);
    }
}
