//! Score calibration: a table of the precision at each score.
//!
//! Little-endian knots of 8 bytes: score (`i32`, Q16), precision (`u32`, Q16, at most 1). Scores rise strictly,
//! precisions never fall. Measured by the trainer on clips held back; a model may have none.

/// Largest number of knots.
pub const MAX_KNOTS: usize = 32;

/// Bytes of a knot.
const KNOT: usize = 8;

/// A precision of 1.
pub const ONE: u32 = 1 << 16;

/// A score and the precision from it on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Knot {
    /// Log-odds, Q16, as [`crate::detector::detection::Detection::score`].
    pub score: i32,
    /// Share of detections of this score or more that are right, Q16, 0 to [`ONE`].
    pub precision: u32,
}

impl Knot {
    /// The bytes in the file.
    pub fn encode(self) -> [u8; KNOT] {
        let ([a, b, c, d], [e, f, g, h]) = (self.score.to_le_bytes(), self.precision.to_le_bytes());
        [a, b, c, d, e, f, g, h]
    }

    /// Reads what [`Knot::encode`] gives.
    fn decode([a, b, c, d, e, f, g, h]: [u8; KNOT]) -> Self {
        Self {
            score: i32::from_le_bytes([a, b, c, d]),
            precision: u32::from_le_bytes([e, f, g, h]),
        }
    }
}

/// A checked table of knots, a view of the bytes of a model.
///
/// ```
/// use lookout::model::calibration::{Calibration, Knot, ONE};
///
/// let knots = [Knot { score: 0, precision: ONE / 2 }, Knot { score: 2 << 16, precision: ONE }];
/// let bytes = knots.map(Knot::encode);
/// let table = Calibration::parse(bytes.as_flattened()).unwrap();
/// // The least score in the table from which on at least three quarters are right.
/// assert_eq!(table.threshold(ONE / 4 * 3), Some(2 << 16));
///
/// // Scores must rise.
/// let bytes = [knots[1], knots[0]].map(Knot::encode);
/// assert!(Calibration::parse(bytes.as_flattened()).is_none());
/// ```
#[derive(Debug, Clone, Copy)]
pub struct Calibration<'m> {
    knots: &'m [[u8; KNOT]],
}

impl<'m> Calibration<'m> {
    /// Checks the knots; `None` if there are too many, one is cut off, scores do not rise, precisions fall or pass 1.
    pub fn parse(bytes: &'m [u8]) -> Option<Self> {
        let (knots, rest) = bytes.as_chunks();
        let table = Self { knots };
        let rises = |(a, b): (Knot, Knot)| a.score < b.score && a.precision <= b.precision;
        let valid = rest.is_empty()
            && knots.len() <= MAX_KNOTS
            && table.knots().zip(table.knots().skip(1)).all(rises)
            && table.knots().all(|knot| knot.precision <= ONE);
        valid.then_some(table)
    }

    /// The knots, scores rising.
    pub fn knots(&self) -> impl ExactSizeIterator<Item = Knot> + use<'m> {
        self.knots.iter().map(|&knot| Knot::decode(knot))
    }

    /// The lowest score of a knot of at least this precision (Q16); `None` if there is none.
    pub fn threshold(&self, precision: u32) -> Option<i32> {
        self.knots().find(|knot| knot.precision >= precision).map(|knot| knot.score)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn encode(knots: &[(i32, u32)]) -> Vec<u8> {
        knots.iter().flat_map(|&(score, precision)| Knot { score, precision }.encode()).collect()
    }

    #[test]
    fn what_is_not_a_table_is_refused() {
        for bad in [
            &[(5, 9), (5, 10)][..],
            &[(6, 9), (5, 10)],
            &[(5, 9), (6, 8)],
            &[(i32::MIN, 0), (i32::MAX, ONE + 1)],
            &(0..33).map(|i| (i, 7)).collect::<Vec<_>>(),
        ] {
            assert!(Calibration::parse(&encode(bad)).is_none(), "{bad:?}");
        }
        assert!(Calibration::parse(&encode(&[(5, 9)])[..7]).is_none());
    }

    proptest! {
        #[test]
        fn the_lowest_score_that_is_good_enough(
            scores in prop::collection::btree_set(any::<i32>(), 0..=MAX_KNOTS),
            mut precisions in prop::collection::vec(0..=ONE, MAX_KNOTS),
            wanted in 0..=ONE,
        ) {
            precisions.sort_unstable();
            let knots: Vec<(i32, u32)> = scores.into_iter().zip(precisions).collect();
            let bytes = encode(&knots);
            let table = Calibration::parse(&bytes).unwrap();
            let good = knots.iter().filter(|k| k.1 >= wanted).map(|k| k.0);
            prop_assert_eq!(table.threshold(wanted), good.min());
        }
    }
}
