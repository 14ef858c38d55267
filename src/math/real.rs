//! Functions of numbers and angles in fixed point: roots, logarithms, sines, and vectors of three numbers.
//!
//! Everything is a [`Real`], Q32.32. Series are short because their argument is brought near 0 first; errors are below
//! 1e-7 unless said otherwise. Results saturate where they do not fit.
//!
//! Nothing here is inlined: on a processor of 32 bits each product of 64 is dozens of instructions, and written out wherever
//! geometry and tracks multiply they were a third of a board's flash. A frame has few of them.

use fixed::types::I32F32;

/// Working number of geometry and tracks: Q32.32, -2^31 to 2^31, steps of 2.3e-10.
pub type Real = I32F32;

/// Three numbers along three axes.
pub type Vector = [Real; 3];

/// Half a turn in radians.
pub const PI: Real = Real::PI;

/// One, in the format of [`Real`].
pub const ONE: Real = Real::ONE;

/// Zero, in the format of [`Real`].
pub const ZERO: Real = Real::ZERO;

/// `numerator` / `denominator` at compile time, for constants.
pub const fn ratio(numerator: i32, denominator: i32) -> Real {
    Real::from_bits(((numerator as i64) << 32) / denominator as i64)
}

/// Square root, rounded down; 0 for negative numbers.
#[inline(never)]
pub fn sqrt(value: Real) -> Real {
    let bits = u128::try_from(value.to_bits()).unwrap_or(0) << 32;
    Real::from_bits(bits.isqrt() as i64)
}

/// Quotient, saturated; 0 divided by 0 is 0.
#[inline(never)]
pub fn divide(a: Real, b: Real) -> Real {
    if b == ZERO {
        return if a == ZERO { ZERO } else { extreme(a < ZERO) };
    }
    a.saturating_div(b)
}

fn extreme(negative: bool) -> Real {
    if negative { Real::MIN } else { Real::MAX }
}

/// Sine and cosine of an angle in radians, which is clamped to 2^20 in magnitude; error below 1e-6 within some turns.
#[inline(never)]
pub fn sin_cos(angle: Real) -> (Real, Real) {
    let angle = angle.clamp(Real::from_num(-(1 << 20)), Real::from_num(1 << 20));
    let quarters = (angle * Real::FRAC_2_PI).round();
    let x = angle - quarters * Real::FRAC_PI_2;
    let square = x * x;
    // Taylor series to x^11 and x^12 in nested form.
    let (mut sine, mut cosine) = (ONE, ONE);
    for n in [5, 4, 3, 2, 1] {
        sine = ONE - sine * square / (2 * n * (2 * n + 1));
    }
    for n in [6, 5, 4, 3, 2, 1] {
        cosine = ONE - cosine * square / (2 * n * (2 * n - 1));
    }
    let sine = sine * x;
    match quarters.to_num::<i64>().rem_euclid(4) {
        0 => (sine, cosine),
        1 => (cosine, -sine),
        2 => (-sine, -cosine),
        _ => (-cosine, sine),
    }
}

/// Angle of the point (x, y) to the x axis in radians, -pi to pi; 0 for the origin.
#[inline(never)]
pub fn atan2(y: Real, x: Real) -> Real {
    let (rise, run) = (y.saturating_abs(), x.saturating_abs());
    if rise == ZERO && run == ZERO {
        return ZERO;
    }
    let steep = rise > run;
    let mut t = if steep { divide(run, rise) } else { divide(rise, run) };
    // atan(t) = 2 atan(t / (1 + sqrt(1 + t^2))), twice: t is at most 0.2 then.
    for _ in 0..2 {
        t /= ONE + sqrt(ONE + t * t);
    }
    let square = t * t;
    let mut sum = ZERO;
    for n in (0..7).rev() {
        let term = ONE / (2 * n + 1);
        sum = if n % 2 == 0 { term } else { -term } + sum * square;
    }
    let acute = t * sum * 4;
    let acute = if steep { Real::FRAC_PI_2 - acute } else { acute };
    let angle = if x < ZERO { PI - acute } else { acute };
    if y < ZERO { -angle } else { angle }
}

/// Natural logarithm; that of the smallest positive number (-22.2) for 0 and below.
#[inline(never)]
pub fn ln(value: Real) -> Real {
    let bits = value.to_bits().max(1) as u64;
    let log2 = 31 - bits.leading_zeros() as i32;
    // Mantissa in 1..2, Q32; then about the root of 2.
    let (mut m, mut e) = (Real::from_bits((bits << bits.leading_zeros() >> 31) as i64), log2);
    if m > Real::SQRT_2 {
        (m, e) = (m / 2, e + 1);
    }
    // ln m = 2 atanh((m - 1) / (m + 1)), the argument at most 0.18.
    let z = (m - ONE) / (m + ONE);
    let square = z * z;
    let mut sum = ZERO;
    for n in (0..7).rev() {
        sum = ONE / (2 * n + 1) + sum * square;
    }
    z * sum * 2 + Real::LN_2 * i64::from(e)
}

/// Exponential function; the argument is clamped to -20..=20. Relative error below 1e-7 above 1.
#[inline(never)]
pub fn exp(value: Real) -> Real {
    let value = value.clamp(Real::from_num(-20), Real::from_num(20));
    let whole = (value / Real::LN_2).round();
    let x = value - whole * Real::LN_2;
    let mut sum = ONE;
    for n in (1..=9).rev() {
        sum = ONE + sum * x / n;
    }
    let whole = whole.to_num::<i32>();
    if whole >= 0 { sum << whole as u32 } else { sum >> -whole as u32 }
}

/// Sum of products; for vectors whose products fit.
#[inline(never)]
pub fn dot(a: Vector, b: Vector) -> Real {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Cross product a × b.
#[inline(never)]
pub fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// `a + b * scale`.
#[inline(never)]
pub fn add(a: Vector, b: Vector, scale: Real) -> Vector {
    core::array::from_fn(|i| a[i] + b[i] * scale)
}

/// Length of a vector; for vectors below 2^15.
#[inline(never)]
pub fn norm(a: Vector) -> Real {
    sqrt(dot(a, a))
}

/// The vector at length 1; forward (x) where it has no length. For vectors below 2^15.
#[inline(never)]
pub fn unit(a: Vector) -> Vector {
    // A short vector would lose its bits in the squares.
    let largest = a.into_iter().map(Real::saturating_abs).max().unwrap_or(ZERO);
    if largest == ZERO {
        return [ONE, ZERO, ZERO];
    }
    let a = a.map(|v| divide(v, largest));
    let length = norm(a);
    a.map(|v| v / length)
}

/// Rejection: the component of `a` perpendicular to the unit vector `axis`.
#[inline(never)]
pub fn reject(a: Vector, axis: Vector) -> Vector {
    add(a, axis, -dot(a, axis))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn f(value: Real) -> f64 {
        value.to_num()
    }

    proptest! {
        #[test]
        fn functions_agree_with_f64(a in -30.0..30.0f64, b in -1000.0..1000.0f64, c in 1e-4..1e6f64) {
            let [x, y, z] = [a, b, c].map(Real::from_num);
            let (sine, cosine) = sin_cos(x);
            prop_assert!((f(sine) - f(x).sin()).abs() < 1e-6 && (f(cosine) - f(x).cos()).abs() < 1e-6);
            prop_assert!((f(atan2(y, x)) - f(y).atan2(f(x))).abs() < 1e-7);
            prop_assert!((f(ln(z)) - f(z).ln()).abs() < 1e-7);
            prop_assert!((f(sqrt(z)) - f(z).sqrt()).abs() < 1e-6);
            let clamped = f(x).clamp(-20.0, 20.0);
            prop_assert!((f(exp(x)) - clamped.exp()).abs() < 1e-7 * clamped.exp().max(1.0));
        }

        #[test]
        fn nothing_panics(a: i64, b: i64) {
            let [a, b] = [a, b].map(Real::from_bits);
            let _ = (sin_cos(a), atan2(a, b), ln(a), exp(a), sqrt(a), divide(a, b));
        }

        #[test]
        fn units_have_length_one(v: [i32; 3]) {
            let v = v.map(|v| Real::from_bits(v.into()));
            prop_assert!((f(norm(unit(v))) - 1.0).abs() < 1e-8);
        }
    }

    #[test]
    fn edges() {
        assert_eq!(atan2(ZERO, ZERO), ZERO);
        assert!((f(atan2(ZERO, -ONE)) - core::f64::consts::PI).abs() < 1e-9);
        assert!((f(atan2(-ONE, ZERO)) + core::f64::consts::FRAC_PI_2).abs() < 1e-9);
        assert_eq!(sqrt(Real::from_num(-4)), ZERO);
        assert_eq!((divide(ONE, ZERO), divide(-ONE, ZERO)), (Real::MAX, Real::MIN));
        assert_eq!(ratio(-3, 4), Real::from_num(-0.75));
    }
}
