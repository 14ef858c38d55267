//! Interlaced frames: every second row belongs to another time.
//!
//! Of each frame the earlier field is kept and the rows between are interpolated. A combed picture would show every moving
//! thing twice, which the differences of frames take for motion.

/// Which rows are the earlier field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FieldOrder {
    /// Rows 0, 2, 4...
    Top,
    /// Rows 1, 3, 5...
    Bottom,
}

/// Replaces the rows of the later field by the mean (rounded up) of the rows above and below; at the edge by the one
/// neighbour. `pixels` are rows of `width` without padding.
pub fn keep_earlier(pixels: &mut [u8], width: usize, earlier: FieldOrder) {
    let rows = pixels.len() / width.max(1);
    let first = match earlier {
        FieldOrder::Top => 1,
        FieldOrder::Bottom => 0,
    };
    for y in (first..rows).step_by(2) {
        let (before, rest) = pixels.split_at_mut(y * width);
        let (row, after) = rest.split_at_mut(width);
        let above = y.checked_sub(1).and_then(|above| before.get(above * width..));
        let below = after.get(..width);
        match (above, below) {
            (Some(above), Some(below)) => {
                for ((pixel, &a), &b) in row.iter_mut().zip(above).zip(below) {
                    *pixel = a.midpoint(b) + ((a ^ b) & 1);
                }
            }
            (Some(only), None) | (None, Some(only)) => row.copy_from_slice(only),
            // A picture of one row has one field.
            (None, None) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn rows_of_the_earlier_field_stay(pixels in prop::collection::vec(any::<u8>(), 3..60), bottom: bool) {
            let pixels = &pixels[..pixels.len() / 3 * 3];
            let rows = pixels.len() / 3;
            let (earlier, kept) = if bottom { (FieldOrder::Bottom, 1) } else { (FieldOrder::Top, 0) };
            let mut out = pixels.to_vec();
            keep_earlier(&mut out, 3, earlier);
            for y in 0..rows {
                for x in 0..3 {
                    let at = |y: usize| u32::from(pixels[y * 3 + x]);
                    let wanted = match (y % 2 == kept || rows == 1, y) {
                        (true, _) => at(y),
                        (false, 0) => at(1),
                        (false, y) if y + 1 == rows => at(y - 1),
                        (false, y) => (at(y - 1) + at(y + 1)).div_ceil(2),
                    };
                    prop_assert_eq!(u32::from(out[y * 3 + x]), wanted, "row {}", y);
                }
            }
        }
    }
}
