//! Rates of rare events with exact Poisson intervals (Garwood 1936).

use serde::Serialize;

/// Probability outside an interval, half of it at each end.
const OUTSIDE: f64 = 0.05;

/// Events, and how many there are in an hour with the 95 % interval of that rate.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct PoissonRate {
    /// Number of events counted.
    pub events: u64,
    /// Events an hour; none without any time.
    pub per_hour: Option<f64>,
    /// Lower end of the interval.
    pub low: Option<f64>,
    /// Upper end of the interval.
    pub high: Option<f64>,
}

impl PoissonRate {
    /// The rate of `events` in `hours`.
    pub fn new(events: u64, hours: f64) -> Self {
        if hours <= 0.0 {
            return Self { events, ..Self::default() };
        }
        let [low, high] = interval(events);
        let rate = |count: f64| Some(count / hours);
        Self { events, per_hour: rate(events as f64), low: rate(low), high: rate(high) }
    }
}

/// The means under which `events` or more, and `events` or fewer, have a probability of 2.5 %.
pub fn interval(events: u64) -> [f64; 2] {
    let low = if events == 0 {
        0.0
    } else {
        // At most `events - 1` has a probability of 97.5 %.
        mean_of(events - 1, 1.0 - OUTSIDE / 2.0)
    };
    [low, mean_of(events, OUTSIDE / 2.0)]
}

/// The mean of the Poisson distribution under which at most `events` has this probability; by bisection, since the
/// probability falls as the mean grows.
fn mean_of(events: u64, probability: f64) -> f64 {
    let (mut low, mut high) = (0.0, 2.0 * events as f64 + 20.0);
    for _ in 0..100 {
        let middle = f64::midpoint(low, high);
        if at_most(events, middle) > probability {
            low = middle;
        } else {
            high = middle;
        }
    }
    f64::midpoint(low, high)
}

/// Probability of at most `events` under this mean, summed by logarithms from the largest term.
fn at_most(events: u64, mean: f64) -> f64 {
    if mean <= 0.0 {
        return 1.0;
    }
    let mut logarithm = -mean;
    let mut sum = logarithm.exp();
    for k in 1..=events {
        logarithm += mean.ln() - (k as f64).ln();
        sum += logarithm.exp();
    }
    sum.min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Garwood's table (as in Johnson, Kotz & Kemp, Univariate Discrete Distributions): counts and ends.
    #[test]
    fn intervals_are_those_of_the_table() {
        for (events, low, high) in [
            (0, 0.0, 3.6889),
            (1, 0.0253, 5.5716),
            (3, 0.6187, 8.7673),
            (10, 4.7954, 18.3904),
            (100, 81.3640, 121.6273),
        ] {
            let [a, b] = interval(events);
            assert!((a - low).abs() < 1e-3 && (b - high).abs() < 1e-3, "{events}: {a} {b}");
        }
        // Far beyond where exp(-mean) is 0 in f64: near the normal approximation.
        let [a, b] = interval(4000);
        assert!((a - 3877.0).abs() < 3.0 && (b - 4126.0).abs() < 3.0, "{a} {b}");
    }

    #[test]
    fn rates_scale_with_time() {
        let rate = PoissonRate::new(0, 0.5);
        assert_eq!((rate.events, rate.per_hour, rate.low), (0, Some(0.0), Some(0.0)));
        assert!((rate.high.unwrap() - 7.3778).abs() < 1e-3);
        assert_eq!(PoissonRate::new(3, 0.0), PoissonRate { events: 3, ..PoissonRate::default() });
    }
}
