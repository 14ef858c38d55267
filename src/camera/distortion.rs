//! Lens models: where a ray meets the picture of a camera of focal length 1, and back.
//!
//! Both are OpenCV's ("Camera Calibration and 3D Reconstruction" and "Fisheye camera model", module calib3d), under which
//! most calibrations are made: Kalibr's `radtan` and `equidistant`, ROS's `plumb_bob`, `rational_polynomial` and
//! `equidistant` are the same formulas.

use crate::math::real::{self, ONE, Real, Vector, ZERO, divide, ratio, sin_cos, sqrt, unit};

/// Points further than this from the axis are brought nearer, in focal lengths.
pub const MAX_RATIO: Real = Real::lit("8");

/// Rounds of the fixed-point iteration that takes polynomial distortion out; OpenCV uses 5.
const ROUNDS: usize = 12;

/// Rounds of Newton's method for the fisheye's angle, as in OpenCV.
const NEWTON_ROUNDS: usize = 10;

/// Least cosine between a projected direction and the axis of a polynomial lens: 84 degrees.
const MIN_COSINE: Real = ratio(1, 10);

/// The lens of a camera; coefficients in OpenCV's order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lens {
    /// k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tau_x, tau_y: with r the distance from the axis of the point (x, y),
    ///
    /// x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2) + s1 r^2 + s2 r^4,
    /// y' = y (...) + p1 (r^2 + 2 y^2) + 2 p2 x y + s3 r^2 + s4 r^4,
    ///
    /// then a sensor tilted by tau_x and tau_y radians. Zeros: a pinhole camera.
    Polynomial([Real; 14]),
    /// k1 to k4: a ray at the angle t to the axis is at the distance t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8).
    Fisheye([Real; 4]),
}

/// A 3x3 matrix, row by row.
type Matrix = [Vector; 3];

impl Lens {
    /// An ideal pinhole: all coefficients 0.
    pub const PINHOLE: Self = Self::Polynomial([ZERO; 14]);

    /// Largest magnitude of a coefficient.
    pub(super) fn largest(&self) -> Real {
        let coefficients: &[Real] = match self {
            Self::Polynomial(k) => k,
            Self::Fisheye(k) => k,
        };
        coefficients.iter().map(|k| k.saturating_abs()).max().unwrap_or(ZERO)
    }

    /// Where the direction (a unit vector, z along the axis) is seen, in focal lengths from the axis; at most
    /// `MAX_RATIO` before distortion. `None` beyond the lens' view: 84 degrees from the axis, 140 of a fisheye.
    pub fn project(&self, [x, y, z]: Vector) -> Option<[Real; 2]> {
        match self {
            Self::Polynomial(k) => {
                let point = [x, y].map(|v| (v / z.max(MIN_COSINE)).clamp(-MAX_RATIO, MAX_RATIO));
                (z >= MIN_COSINE).then(|| tilt(k, distort(k, point)))
            }
            Self::Fisheye(k) => {
                let sine = sqrt(x * x + y * y);
                let angle = real::atan2(sine, z);
                if angle > real::PI * 7 / 9 {
                    return None;
                }
                if sine < ratio(1, 1 << 20) {
                    // Ahead: the angle is its sine.
                    return Some([x, y]);
                }
                let (distance, _) = fisheye(k, angle);
                Some([x, y].map(|v| divide(v, sine).saturating_mul(distance)))
            }
        }
    }

    /// The unit vector of the ray that is seen at `point`, in focal lengths from the axis.
    pub fn ray(&self, point: [Real; 2]) -> Vector {
        match self {
            Self::Polynomial(k) => {
                let [x, y] = undistort(k, untilt(k, point));
                unit([x, y, ONE])
            }
            Self::Fisheye(k) => {
                let distance = sqrt(point[0] * point[0] + point[1] * point[1]);
                if distance < ratio(1, 1 << 20) {
                    return unit([point[0], point[1], ONE]);
                }
                let angle = fisheye_angle(k, distance);
                let (sine, cosine) = sin_cos(angle);
                unit([point[0] / distance * sine, point[1] / distance * sine, cosine])
            }
        }
    }
}

/// Distorts a point, less the tilt.
fn distort(k: &[Real; 14], [x, y]: [Real; 2]) -> [Real; 2] {
    let (radial, [dx, dy]) = terms(k, [x, y]);
    [x.saturating_mul(radial).saturating_add(dx), y.saturating_mul(radial).saturating_add(dy)]
}

/// 1 + a r^2 + b r^4 + c r^6, saturated.
#[inline(never)]
fn polynomial([a, b, c]: [Real; 3], r2: Real) -> Real {
    [c, b, a]
        .into_iter()
        .fold(ZERO, |sum, k| sum.saturating_add(k).saturating_mul(r2))
        .saturating_add(ONE)
}

/// The radial factor and the shift (tangential, thin prism) at an undistorted point.
#[inline(never)]
fn terms(k: &[Real; 14], [x, y]: [Real; 2]) -> (Real, [Real; 2]) {
    let &[k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, _, _] = k;
    let r2 = x * x + y * y;
    let mut radial = polynomial([k1, k2, k3], r2);
    if [k4, k5, k6] != [ZERO; 3] {
        // A pole within the picture makes no lens: the quotient saturates there.
        radial = divide(radial, polynomial([k4, k5, k6], r2));
    }
    let dx = p1 * x * y * 2 + p2 * (r2 + x * x * 2);
    let dy = p1 * (r2 + y * y * 2) + p2 * x * y * 2;
    if [s1, s2, s3, s4] == [ZERO; 4] {
        return (radial, [dx, dy]);
    }
    let prism = |a: Real, b: Real| {
        a.saturating_mul(r2).saturating_add(b.saturating_mul(r2.saturating_mul(r2)))
    };
    (radial, [dx.saturating_add(prism(s1, s2)), dy.saturating_add(prism(s3, s4))])
}

/// Takes the distortion out by fixed-point iteration, as OpenCV does.
fn undistort(k: &[Real; 14], distorted: [Real; 2]) -> [Real; 2] {
    if *k == [ZERO; 14] {
        return distorted;
    }
    let mut point = distorted;
    for _ in 0..ROUNDS {
        let (radial, shift) = terms(k, point);
        // Beyond where the polynomial means anything: the last point is as good.
        if radial < ratio(1, 10) {
            break;
        }
        point = core::array::from_fn(|i| {
            divide(distorted[i].saturating_sub(shift[i]), radial).clamp(-MAX_RATIO, MAX_RATIO)
        });
    }
    point
}

/// The tilted sensor's homography, as in OpenCV's `computeTiltProjectionMatrix`; `None` for an upright one.
fn tilt_matrix(k: &[Real; 14]) -> Option<Matrix> {
    let [tau_x, tau_y] = [k[12], k[13]];
    if [tau_x, tau_y] == [ZERO; 2] {
        return None;
    }
    let ((sx, cx), (sy, cy)) = (sin_cos(tau_x), sin_cos(tau_y));
    // R = Ry(tau_y) Rx(tau_x)
    let r: Matrix = [[cy, sy * sx, -sy * cx], [ZERO, cx, sx], [sy, -cy * sx, cy * cx]];
    let r33 = r[2][2];
    let row = |i: usize| core::array::from_fn(|j| r33 * r[i][j] - r[i][2] * r[2][j]);
    Some([row(0), row(1), r[2]])
}

/// Applies a homography to a point.
#[inline(never)]
fn apply(matrix: &Matrix, [x, y]: [Real; 2]) -> [Real; 2] {
    let [u, v, w] = matrix.map(|row| {
        row[0].saturating_mul(x).saturating_add(row[1].saturating_mul(y)).saturating_add(row[2])
    });
    [u, v].map(|v| divide(v, w).clamp(-MAX_RATIO, MAX_RATIO))
}

fn tilt(k: &[Real; 14], point: [Real; 2]) -> [Real; 2] {
    tilt_matrix(k).map_or(point, |matrix| apply(&matrix, point))
}

fn untilt(k: &[Real; 14], point: [Real; 2]) -> [Real; 2] {
    let Some([a, b, c]) = tilt_matrix(k) else { return point };
    // The adjugate is the inverse up to a factor, which a homography does not see.
    let rows = [real::cross(b, c), real::cross(c, a), real::cross(a, b)];
    let inverse = core::array::from_fn(|i| rows.map(|row| row[i]));
    apply(&inverse, point)
}

/// Distance from the axis of a ray at the angle `t`, and its derivative.
#[inline(never)]
fn fisheye(k: &[Real; 4], t: Real) -> (Real, Real) {
    let t2 = t * t;
    let (mut value, mut slope) = (ZERO, ZERO);
    for (n, k) in [1, 2, 3, 4i32].into_iter().zip(k).rev() {
        value = value.saturating_add(*k).saturating_mul(t2);
        slope =
            slope.saturating_add(k.saturating_mul(Real::from_num(2 * n + 1))).saturating_mul(t2);
    }
    (t.saturating_mul(value.saturating_add(ONE)), slope.saturating_add(ONE))
}

/// The angle to the axis of what is seen at `distance`, by Newton's method; at most half a turn.
fn fisheye_angle(k: &[Real; 4], distance: Real) -> Real {
    let mut angle = distance.min(Real::FRAC_PI_2);
    for _ in 0..NEWTON_ROUNDS {
        let (value, slope) = fisheye(k, angle);
        if slope < ratio(1, 100) {
            // The picture is folded there: nothing is seen so far out.
            break;
        }
        angle = (angle - divide(value.saturating_sub(distance), slope).clamp(-ONE, ONE))
            .clamp(ZERO, real::PI);
    }
    angle
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn real<const N: usize>(values: [f64; N]) -> [Real; N] {
        values.map(Real::from_num)
    }

    fn apart(a: [Real; 2], b: [Real; 2]) -> f64 {
        (a[0] - b[0]).to_num::<f64>().hypot((a[1] - b[1]).to_num())
    }

    proptest! {
        #[test]
        fn a_ray_comes_back(x in -0.6..0.6f64, y in -0.5..0.5f64, k in prop::array::uniform4(-0.03..0.03f64)) {
            let [k1, k2, k3, k4] = k;
            for lens in [
                Lens::Fisheye(real(k)),
                Lens::Polynomial(real([k1 * 5.0, k2 * 2.0, k3 / 10.0, k4 / 10.0, k3, k2 * 5.0, k1, k4, k1 / 5.0, k2 / 5.0, k3 / 5.0, k4 / 5.0, k1, k2])),
            ] {
                let ray = unit(real([x, y, 1.0]));
                let point = lens.project(ray).unwrap();
                let back = lens.ray(point);
                let error = (0..3).map(|i| (back[i] - ray[i]).to_num::<f64>().abs()).fold(0.0, f64::max);
                prop_assert!(error < 2e-6, "{lens:?}: {error}");
            }
        }

        #[test]
        fn no_numbers_panic(k: [i64; 14], point: [i64; 2], ray: [i32; 3]) {
            let k = k.map(|k| Real::from_bits(k % (1 << 42)));
            let point = point.map(|v| Real::from_bits(v).clamp(-MAX_RATIO, MAX_RATIO));
            for lens in [Lens::Polynomial(k), Lens::Fisheye([k[0], k[1], k[2], k[3]])] {
                prop_assert!((real::norm(lens.ray(point)) - ONE).saturating_abs() < Real::from_num(1e-6));
                let _ = lens.project(unit(ray.map(|v| Real::from_bits(v.into()))));
            }
        }
    }

    #[test]
    fn a_fisheye_sees_beyond_a_right_angle() {
        let lens = Lens::Fisheye([ZERO; 4]);
        let point = lens.project(unit(real([1.0, 0.0, -0.2]))).unwrap();
        let angle = core::f64::consts::FRAC_PI_2 + 0.2f64.atan();
        assert!(apart(point, real([angle, 0.0])) < 1e-6);
        assert!(lens.ray(point)[2] < ZERO);
        assert!(lens.project(real([0.0, 0.0, -1.0])).is_none());
        assert!(Lens::PINHOLE.project(real([1.0, 0.0, 0.0])).is_none());
        assert_eq!(lens.project(real([0.0, 0.0, 1.0])), Some([ZERO; 2]));
    }
}
