//! Losses, with the derivatives that boosting follows.

/// Loss of boosting; F is the score, y the response or label.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Loss {
    /// (F - y)², for responses.
    Squared,
    /// exp(-y F), for labels -1 and 1: with Newton steps, Gentle AdaBoost (Friedman, Hastie and Tibshirani 2000).
    Exponential,
    /// ln(1 + exp(-y F)), for labels -1 and 1: LogitBoost, the score is the log-odds of 1.
    Logistic,
}

/// Margins beyond this count as this: one mislabelled row shall not silence all others.
const MARGIN: f64 = 15.0;

impl Loss {
    /// Whether a target can be learnt.
    pub(super) fn takes(self, target: f32) -> bool {
        match self {
            Self::Squared => target.is_finite(),
            Self::Exponential | Self::Logistic => target.abs() == 1.0,
        }
    }

    /// The loss of a row.
    pub(super) fn value(self, target: f64, score: f64) -> f64 {
        let margin = (target * score).max(-MARGIN);
        match self {
            Self::Squared => (score - target).powi(2),
            Self::Exponential => (-margin).exp(),
            Self::Logistic => (-margin).exp().ln_1p(),
        }
    }

    /// First and second derivative of the loss by the score (of half the squared loss).
    pub(super) fn derivatives(self, target: f64, score: f64) -> (f64, f64) {
        let odds = (-(target * score).max(-MARGIN)).exp();
        match self {
            Self::Squared => (score - target, 1.0),
            Self::Exponential => (-target * odds, odds),
            Self::Logistic => {
                let wrong = odds / (1.0 + odds);
                (-target * wrong, wrong * (1.0 - wrong))
            }
        }
    }

    /// The best score if it is the same for all rows.
    pub(super) fn constant(self, targets: &[f32], weights: &[f32]) -> f64 {
        let (mut sum, mut total) = (0.0, 0.0);
        for (&target, &weight) in targets.iter().zip(weights) {
            sum += f64::from(target) * f64::from(weight);
            total += f64::from(weight);
        }
        let mean = sum / total;
        // Labels of one kind only have no finite best score.
        let log_odds = ((1.0 + mean) / (1.0 - mean)).ln().clamp(-MARGIN, MARGIN);
        match self {
            Self::Squared => mean,
            Self::Exponential => log_odds / 2.0,
            Self::Logistic => log_odds,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn derivatives_are_difference_quotients(score in -8.0..8.0f64, positive in any::<bool>()) {
            let (y, e) = (if positive { 1.0 } else { -1.0 }, 1e-4);
            for (loss, unit) in [(Loss::Squared, 2.0), (Loss::Exponential, 1.0), (Loss::Logistic, 1.0)] {
                let [low, at, high] = [score - e, score, score + e].map(|f| loss.value(y, f));
                let (gradient, hessian) = loss.derivatives(y, score);
                let size = 1.0 + at.abs();
                prop_assert!(((high - low) / (2.0 * e) - unit * gradient).abs() < 1e-4 * size);
                prop_assert!(((high - 2.0 * at + low) / (e * e) - unit * hessian).abs() < 1e-3 * size);
            }
        }

        #[test]
        fn no_constant_is_better(labels in prop::collection::vec((any::<bool>(), 0.1..3.0f32), 2..20), other in -3.0..3.0f64) {
            let (mut targets, weights): (std::vec::Vec<f32>, std::vec::Vec<f32>) =
                labels.iter().map(|&(positive, weight)| (if positive { 1.0 } else { -1.0 }, weight)).unzip();
            (targets[0], targets[1]) = (1.0, -1.0);
            for loss in [Loss::Squared, Loss::Exponential, Loss::Logistic] {
                let total = |score| -> f64 {
                    targets.iter().zip(&weights)
                        .map(|(&y, &w)| f64::from(w) * loss.value(f64::from(y), score)).sum()
                };
                prop_assert!(total(loss.constant(&targets, &weights)) <= total(other) + 1e-9);
            }
        }
    }
}
