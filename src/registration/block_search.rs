//! The shift of a whole small picture against an older one by exhaustive search.
//!
//! For frames that moved farther than tracking reaches: a camera that yaws fast. The mean absolute difference of the parts
//! that overlap is compared for every whole shift within a range; brightness may change by a constant.

use crate::image::Image;

/// Farthest shift across and down, in pixels: at an eighth of the frame, 128 pixels of the frame.
const RANGE: i32 = 16;

/// Pixels from one compared pixel to the next, across and down.
const STEP: usize = 2;

/// Fewest pixels compared for one shift.
const MIN_COMPARED: i64 = 64;

/// Largest ratio of the best mean difference to that of no shift, Q8: what is hardly better than none is none.
const MAX_RATIO: i64 = 230;

/// Where `new` lies in `old`: the whole shift (right, down) in pixels towards `old` at which they differ least. At most
/// half of either side leaves the picture. `None` where no shift is clearly better than none.
pub fn shift(new: Image<'_>, old: Image<'_>) -> Option<(i32, i32)> {
    let brighter = mean(old) - mean(new);
    let range = |length: usize| RANGE.min(length as i32 / 2);
    let (across, down) = (range(new.width()), range(new.height()));
    let still = difference(new, old, (0, 0), brighter)?;
    let mut best = (still, (0, 0));
    for y in -down..=down {
        for x in -across..=across {
            let Some(found) = difference(new, old, (x, y), brighter) else { continue };
            if found < best.0 {
                best = (found, (x, y));
            }
        }
    }
    (best.0 * 256 <= still * MAX_RATIO).then_some(best.1)
}

/// Mean grey level, rounded down; 0 of an empty picture.
fn mean(image: Image<'_>) -> i32 {
    let row = |y| image.row(y).iter().map(|&p| u64::from(p)).sum::<u64>();
    let sum: u64 = (0..image.height()).map(row).sum();
    (sum / (image.width() * image.height()).max(1) as u64) as i32
}

/// Mean absolute difference of the pixels of `new` to those of `old` a shift away, less `brighter`, Q8; `None` where too
/// few overlap.
fn difference(new: Image<'_>, old: Image<'_>, (x, y): (i32, i32), brighter: i32) -> Option<i64> {
    // First compared pixel in both, and how many pixels from there both have.
    let overlap = |length: usize, shift: i32| {
        let away = shift.unsigned_abs() as usize;
        let (own, other) = if shift < 0 { (away, 0) } else { (0, away) };
        (own, other, length.saturating_sub(away))
    };
    let (left, old_left, width) = overlap(new.width().min(old.width()), x);
    let (top, old_top, height) = overlap(new.height().min(old.height()), y);
    let (mut sum, mut count) = (0i64, 0i64);
    for row in (0..height).step_by(STEP) {
        let own = new.row(top + row).get(left..left + width).unwrap_or(&[]);
        let other = old.row(old_top + row).get(old_left..old_left + width).unwrap_or(&[]);
        let mut row_sum = 0i32;
        for (&own, &other) in own.iter().step_by(STEP).zip(other.iter().step_by(STEP)) {
            row_sum += (i32::from(other) - i32::from(own) - brighter).abs();
        }
        sum += i64::from(row_sum);
        count += width.div_ceil(STEP) as i64;
    }
    (count >= MIN_COMPARED).then(|| (sum << 8) / count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::lucas_kanade::tests::{render, texture};
    use proptest::prelude::*;
    use std::vec::Vec;

    #[test]
    fn plain_pictures_have_no_shift() {
        let (grey, darker) = ([90; 80 * 60], [70; 80 * 60]);
        let [grey, darker] = [&grey, &darker].map(|p| Image::packed(p, 80, 60).unwrap());
        assert_eq!(shift(grey, darker), Some((0, 0)), "the same but for its brightness");
        let noise: Vec<u8> =
            (0..80 * 60u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        assert_eq!(shift(Image::packed(&noise, 80, 60).unwrap(), grey), None);
        let nothing = Image::packed(&[], 0, 0).unwrap();
        assert_eq!(shift(nothing, nothing), None);
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 32, ..ProptestConfig::default() })]

        #[test]
        fn a_shift_is_found(x in -16..=16i32, y in -16..=16i32, brighter in -20..20i32, w in 60..90usize, h in 48..70usize) {
            let old = render(w, h, |x, y| texture(8.0 * x, 8.0 * y));
            let new = render(w, h, |px, py| {
                texture(8.0 * (px + f64::from(x)), 8.0 * (py + f64::from(y)))
            });
            let new: Vec<u8> = new.iter().map(|p| p.saturating_add_signed(brighter as i8)).collect();
            let [new, old] = [&new, &old].map(|p| Image::packed(p, w, h).unwrap());
            prop_assert_eq!(shift(new, old), Some((x, y)));
        }
    }
}
