//! How clearly a target stands out from what surrounds it.

use crate::shell::evaluate::matching::Box4;
use crate::shell::sources::Frame;
use std::ops::Range;

/// The ring is at least this wide, pixels.
const MIN_RING: f64 = 3.0;

/// Mean absolute difference, in grey levels, of the pixels in a box to the mean of the ring around it. The ring is half the box's longer
/// side wide. 0 where the frame holds no pixel of the box or of the ring.
pub fn contrast(frame: &Frame, rect: &Box4) -> f64 {
    let [left, top, width, height] = *rect;
    let ring = (width.max(height) / 2.0).max(MIN_RING);
    let columns = |margin: f64| pixels(left - margin, left + width + margin, frame.width);
    let rows = |margin: f64| pixels(top - margin, top + height + margin, frame.height);
    let (inner_columns, inner_rows) = (columns(0.0), rows(0.0));
    let row = |y: usize, columns: &Range<usize>| {
        frame.pixels[y * frame.width..][columns.start..columns.end].iter()
    };
    let sum = |columns: &Range<usize>, rows: Range<usize>| {
        rows.map(|y| row(y, columns).map(|&p| u64::from(p)).sum::<u64>()).sum::<u64>()
    };
    let (outer_columns, outer_rows) = (columns(ring), rows(ring));
    let inside = inner_columns.len() * inner_rows.len();
    let around = outer_columns.len() * outer_rows.len() - inside;
    if inside == 0 || around == 0 {
        return 0.0;
    }
    let ring_sum = sum(&outer_columns, outer_rows) - sum(&inner_columns, inner_rows.clone());
    let mean = ring_sum as f64 / around as f64;
    let differences = inner_rows
        .map(|y| row(y, &inner_columns).map(|&p| (f64::from(p) - mean).abs()).sum::<f64>())
        .sum::<f64>();
    differences / inside as f64
}

/// The pixels whose centres lie in a span, inside 0..`size`.
fn pixels(start: f64, end: f64, size: usize) -> Range<usize> {
    let pixel = |v: f64| (v - 0.5).ceil().clamp(0.0, size as f64) as usize;
    pixel(start)..pixel(end).max(pixel(start))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec;

    #[test]
    fn by_hand() {
        // Background 100, a box of 4 x 2 that is half 130, half 90.
        let mut frame = Frame { pixels: vec![100; 20 * 15], width: 20, height: 15, time_us: 0 };
        for y in 6..8 {
            frame.pixels[y * 20 + 8..][..4].copy_from_slice(&[130, 130, 90, 90]);
        }
        assert_eq!(contrast(&frame, &[8.0, 6.0, 4.0, 2.0]), 20.0);
        // No pixel's centre is in it; it lies outside; nothing is around it.
        for nothing in [[8.6, 6.0, 0.2, 2.0], [40.0, 0.0, 9.0, 9.0], [-9.0, -9.0, 99.0, 99.0]] {
            assert_eq!(contrast(&frame, &nothing), 0.0);
        }
    }

    proptest! {
        #[test]
        fn never_beyond_the_grey_levels(
            pixels in prop::collection::vec(any::<u8>(), 12 * 9),
            rect in [-20.0..30.0, -20.0..30.0, 0.0..40.0, 0.0..40.0f64], huge: [f64; 4],
        ) {
            let frame = Frame { pixels, width: 12, height: 9, time_us: 0 };
            for rect in [rect, huge] {
                prop_assert!((0.0..=255.0).contains(&contrast(&frame, &rect)));
            }
        }
    }
}
