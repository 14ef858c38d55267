//! Recursive averaging of detection scores and sizes over frames.
//!
//! Targets persist from frame to frame along their motion, false alarms often do not. A detection's score becomes the mean
//! of its own score and that of the previous frame's detection at the position that Algorithm 1 gives, which is such a mean
//! itself: weights halve with each frame. Sizes, which change slowly, are averaged alike.

use crate::image::Rect;

/// Overlap (IoU, Q8) from which on a box of the last frame is taken for the same object.
const OVERLAP: u8 = 77;

/// Prior log-odds (Q16) where no box of the previous frame matches.
const UNSEEN: i32 = -3 << 16;

/// The boxes and scores of the last frame.
#[derive(Debug, Clone, Default)]
pub struct Persistence<const N: usize> {
    last: heapless::Vec<(Rect, i32), N>,
}

impl<const N: usize> Persistence<N> {
    /// Without a previous frame.
    pub const fn new() -> Self {
        Self { last: heapless::Vec::new() }
    }

    /// Forgets the last frame.
    pub fn clear(&mut self) {
        self.last.clear();
    }

    /// The box and score averaged with the previous frame's detection that overlaps `before`, or with a prior if none does.
    pub fn weigh(&self, rect: Rect, score: i32, before: Rect) -> (Rect, i32) {
        let same = self.last.iter().filter(|(last, _)| last.overlaps(&before, OVERLAP));
        let Some((last, past)) = same.max_by_key(|(_, past)| *past) else {
            return (rect, midpoint(score, UNSEEN));
        };
        let (width, height) = ((rect.width + last.width) / 2, (rect.height + last.height) / 2);
        let rect = Rect {
            x: rect.x + (rect.width - width) / 2,
            y: rect.y + (rect.height - height) / 2,
            width,
            height,
        };
        (rect, midpoint(score, (*past).max(UNSEEN)))
    }

    /// Stores the averaged detections of a frame for the next one, at most `N`.
    pub fn remember(&mut self, detections: impl Iterator<Item = (Rect, i32)>) {
        self.last = detections.take(N).collect();
    }
}

/// The mean, rounded down.
fn midpoint(a: i32, b: i32) -> i32 {
    ((i64::from(a) + i64::from(b)) >> 1) as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use fixed::types::I28F4;

    fn square(x: i32, side: i32) -> Rect {
        let [x, y, width, height] = [x, 50, side, side].map(I28F4::from_num::<i32>);
        Rect { x, y, width, height }
    }

    #[test]
    fn the_seen_gain_and_the_unseen_lose() {
        let mut persistence = Persistence::<4>::new();
        let one = 1 << 16;
        assert_eq!(persistence.weigh(square(0, 20), one, square(0, 20)), (square(0, 20), -one));
        persistence.remember([(square(0, 20), 3 * one), (square(2, 20), one)].into_iter());
        // It moved by 30 to the right and grew from 20 to 24: the best of the two was there.
        let (rect, score) = persistence.weigh(square(28, 24), one, square(-2, 24));
        assert_eq!((rect.width.to_num::<i32>(), score), (22, 2 * one));
        assert_eq!(rect.x.to_num::<i32>(), 29);
        // Not where it was.
        assert_eq!(persistence.weigh(square(28, 24), one, square(28, 24)).1, -one);
        let (_, score) = persistence.weigh(square(0, 20), i32::MAX, square(0, 20));
        assert!(score > 0);
    }

    #[test]
    fn more_than_there_is_room_for() {
        let mut persistence = Persistence::<2>::new();
        persistence.remember((0..5).map(|i| (square(40 * i, 20), 0)));
        assert_eq!(persistence.last.len(), 2);
    }
}
