//! A value and its rate by a Kalman filter with a random acceleration: how wrong they are, and what a measurement changes
//!.
//!
//! The state itself is the caller's: one spread serves a vector whose axes are alike. Source: Bar-Shalom, Li, Kirubarajan,
//! "Estimation with Applications to Tracking and Navigation", 2001, section 6.2.2.

use crate::math::real::{Real, ZERO, divide, ratio, sqrt};

/// Variances are of thousandths (milliradians, or thousandths of a size), to keep their bits.
pub const MILLI: Real = Real::lit("1000");

/// Largest variance of a value and of a rate, in thousandths squared.
pub const MAX_VARIANCE: Real = Real::lit("100000000");

/// Variances of a value and its rate, and their covariance, in thousandths squared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Covariance {
    /// Variance of the value.
    pub value: Real,
    /// Covariance of value and rate.
    pub both: Real,
    /// Variance of the rate.
    pub rate: Real,
}

impl Covariance {
    /// Of standard deviations in thousandths, independent of each other; at most 10 000 each.
    #[inline(never)]
    pub fn new(value: Real, rate: Real) -> Self {
        Self { value: value * value, both: ZERO, rate: rate * rate }
    }

    /// `dt` (0 to 1) seconds later; the rate's error grows by the factor `bend` (1/2 to 2), `noise` (0 to 10) is the
    /// rate's standard deviation after a second, by a random acceleration.
    #[inline(never)]
    pub fn predict(&mut self, dt: Real, bend: Real, noise: Real) {
        let Self { value, both, rate } = *self;
        let noise = (noise * MILLI) * (noise * MILLI) * dt;
        self.value = value + both * dt * 2 + rate * dt * dt + noise * dt * dt / 3;
        self.both = (both + rate * dt) * bend + noise * dt / 2;
        self.rate = rate * bend * bend + noise;
        self.limit();
    }

    #[inline(never)]
    fn limit(&mut self) {
        self.value = self.value.clamp(ratio(1, 1000), MAX_VARIANCE);
        self.rate = self.rate.clamp(ratio(1, 1000), MAX_VARIANCE);
        let most = sqrt(self.value) * sqrt(self.rate);
        self.both = self.both.clamp(-most, most);
    }

    /// Gains of value and rate for a measurement of the value with this variance.
    #[inline(never)]
    pub fn update(&mut self, variance: Real) -> [Real; 2] {
        let sum = self.value + variance.min(MAX_VARIANCE);
        let gains = [divide(self.value, sum), divide(self.both, sum)];
        let both = self.both;
        self.value -= self.value * gains[0];
        self.both -= both * gains[0];
        self.rate -= both * gains[1];
        self.limit();
        gains
    }

    /// As [`Covariance::update`] for a measurement of the rate.
    #[inline(never)]
    pub fn update_rate(&mut self, variance: Real) -> [Real; 2] {
        let sum = self.rate + variance.min(MAX_VARIANCE);
        let gains = [divide(self.both, sum), divide(self.rate, sum)];
        let both = self.both;
        self.value -= both * gains[0];
        self.both -= both * gains[1];
        self.rate -= self.rate * gains[1];
        self.limit();
        gains
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn f(value: Real) -> f64 {
        value.to_num()
    }

    /// F P F' + Q, then (I - K H) P, in the form of the book.
    fn naive(
        p: [[f64; 2]; 2],
        dt: f64,
        noise: f64,
        measured: usize,
        variance: f64,
    ) -> [[f64; 2]; 2] {
        let q = (noise * 1000.0).powi(2) * dt;
        let p = [
            [
                p[0][0] + dt * (p[0][1] + p[1][0]) + dt * dt * p[1][1] + q * dt * dt / 3.0,
                p[0][1] + dt * p[1][1] + q * dt / 2.0,
            ],
            [p[1][0] + dt * p[1][1] + q * dt / 2.0, p[1][1] + q],
        ];
        let gain = [0, 1].map(|i: usize| p[i][measured] / (p[measured][measured] + variance));
        [0, 1].map(|i: usize| [0, 1].map(|j: usize| p[i][j] - gain[i] * p[measured][j]))
    }

    proptest! {
        #[test]
        fn agrees_with_matrices_in_f64(
            steps in prop::collection::vec((0.01..0.2f64, 0.5..100.0f64, any::<bool>()), 1..40),
            noise in 0.001..1.0f64,
        ) {
            let mut spread = Covariance::new(MILLI / 100, MILLI / 4);
            let mut p = [[100.0, 0.0], [0.0, 62_500.0]];
            for (dt, sigma, of_rate) in steps {
                let variance = Real::from_num(sigma * sigma);
                let [dt, noise] = [dt, noise].map(Real::from_num);
                spread.predict(dt, crate::math::real::ONE, noise);
                let _ = if of_rate { spread.update_rate(variance) } else { spread.update(variance) };
                p = naive(p, f(dt), f(noise), usize::from(of_rate), f(variance));
                let near = |a: Real, b: f64| (f(a) - b).abs() <= 1e-3 * b.abs() + 0.01;
                prop_assert!(near(spread.value, p[0][0]) && near(spread.rate, p[1][1]), "{spread:?} {p:?}");
                prop_assert!(near(spread.both, p[0][1]), "{spread:?} {p:?}");
            }
        }

        #[test]
        fn nothing_panics(start: [u16; 2], steps in prop::collection::vec((any::<u32>(), any::<i64>(), 0..=10u8, any::<bool>()), 1..60)) {
            let [value, rate] = start.map(|v| Real::from_num(v.min(10_000)));
            let mut spread = Covariance::new(value, rate);
            for (dt, variance, noise, of_rate) in steps {
                let bend = Real::from_num(1 + dt % 4) / 2;
                spread.predict(Real::from_bits(dt.into()), bend, Real::from_num(noise));
                let variance = Real::from_bits(variance.max(0));
                let _ = if of_rate { spread.update_rate(variance) } else { spread.update(variance) };
                prop_assert!(spread.value > 0 && spread.rate > 0);
            }
        }
    }
}
