//! Values drawn from the ranges of the settings.

use crate::shell::support::random::Random;

/// Evenly from a range.
pub(super) fn even(random: &mut Random, [low, high]: [f64; 2]) -> f64 {
    random.within(low, high)
}

/// Evenly in the logarithm from a range of positive numbers: `low (high / low)^u` for u in 0..1, by square roots alone,
/// which are exact on every processor.
pub(super) fn by_ratio(random: &mut Random, [low, high]: [f64; 2]) -> f64 {
    let mut bits = random.bits();
    let (mut value, mut step) = (low, high / low);
    for _ in 0..20 {
        step = step.sqrt();
        if bits & 1 == 1 {
            value *= step;
        }
        bits >>= 1;
    }
    value
}

/// The index of a weight, drawn in proportion to the weights; 0 if all are 0.
pub(super) fn weighted(random: &mut Random, weights: &[f64]) -> usize {
    let total: f64 = weights.iter().sum();
    let mut place = random.within(0.0, 1.0) * total;
    for (index, weight) in weights.iter().enumerate() {
        if place < *weight {
            return index;
        }
        place -= weight;
    }
    0
}
