//! Greedy non-maximum suppression.

use crate::image::Rect;

/// Most items that can be kept.
pub const MAX_KEPT: usize = 64;

/// Keeps of `items`, which come best first, those whose box overlaps none of the kept ones by more than
/// `overlap` (intersection over union, Q8), in their order at the start of the slice. At most `most` and [`MAX_KEPT`] are kept;
/// returns how many are, and how many more there would have been.
pub fn suppress<T>(
    items: &mut [T],
    rect: impl Fn(&T) -> Rect,
    overlap: u8,
    most: usize,
) -> (usize, u32) {
    let most = most.min(MAX_KEPT);
    let mut dropped = 0;
    let mut boxes: heapless::Vec<Rect, MAX_KEPT> = heapless::Vec::new();
    for i in 0..items.len() {
        let candidate = rect(&items[i]);
        if boxes.iter().any(|other| other.overlaps(&candidate, overlap)) {
            continue;
        }
        let kept = boxes.len();
        if kept < most && boxes.push(candidate).is_ok() {
            items.swap(kept, i);
        } else {
            dropped += 1;
        }
    }
    (boxes.len(), dropped)
}

#[cfg(test)]
mod tests {
    use super::*;
    use fixed::types::I28F4;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn square(x: i32, y: i32, side: i32) -> Rect {
        let [x, y, width, height] = [x, y, side, side].map(I28F4::from_num::<i32>);
        Rect { x, y, width, height }
    }

    proptest! {
        #[test]
        fn agrees_with_naive(boxes in prop::collection::vec((0..60i32, 0..60i32, 4..30i32), 0..40), most in 0..40usize) {
            let boxes: Vec<Rect> = boxes.into_iter().map(|(x, y, s)| square(x, y, s)).collect();
            let mut naive: Vec<Rect> = Vec::new();
            for candidate in &boxes {
                if naive.iter().take(most).all(|k| !k.overlaps(candidate, 128)) {
                    naive.push(*candidate);
                }
            }
            let mut fast = boxes.clone();
            let (kept, dropped) = suppress(&mut fast, |r| *r, 128, most);
            fast.truncate(kept);
            prop_assert_eq!(dropped as usize, naive.len().saturating_sub(most));
            naive.truncate(most);
            prop_assert_eq!(fast.as_slice(), naive.as_slice());
        }
    }
}
