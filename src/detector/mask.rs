//! Parts of the frame that show the own craft, or text burnt into the picture: nothing is reported there.

use crate::image::{Image, Rect};

/// A picture of any size that is laid over the whole frame: pixels that are 0 are not looked at.
#[derive(Debug, Clone, Copy)]
pub struct Mask<'m> {
    picture: Image<'m>,
    /// Width and height of the frame, pixels.
    frame: (usize, usize),
}

impl<'m> Mask<'m> {
    /// For frames of `frame.0` x `frame.1` pixels. An empty picture hides nothing.
    pub const fn new(picture: Image<'m>, frame: (usize, usize)) -> Self {
        Self { picture, frame }
    }

    /// Whether more than half of a box within the frame is hidden; a box outside is not.
    pub fn hides(&self, rect: &Rect) -> bool {
        let (width, height) = (self.picture.width(), self.picture.height());
        // The pixels of the mask whose middle lies in the box, at least one where it is within the frame.
        let range = |start: i32, length: i32, pixels: usize, frame: usize| {
            let (start, end) = (i64::from(start), i64::from(start) + i64::from(length));
            let place = |at: i64| (at * pixels as i64).div_euclid(16 * frame.max(1) as i64);
            let first = place(start.max(0)).min(pixels as i64);
            let last = place(end.max(0) - 1).min(pixels as i64 - 1);
            (first as usize)..(last + 1).max(0) as usize
        };
        let across = range(rect.x.to_bits(), rect.width.to_bits(), width, self.frame.0);
        let down = range(rect.y.to_bits(), rect.height.to_bits(), height, self.frame.1);
        let (mut hidden, mut all) = (0usize, 0usize);
        for y in down {
            let row = self.picture.row(y).get(across.clone()).unwrap_or(&[]);
            hidden += row.iter().filter(|&&pixel| pixel == 0).count();
            all += row.len();
        }
        2 * hidden > all
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fixed::types::I28F4;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn rect([x, y, width, height]: [i32; 4]) -> Rect {
        let [x, y, width, height] = [x, y, width, height].map(I28F4::from_bits);
        Rect { x, y, width, height }
    }

    #[test]
    fn more_than_half() {
        // The left half of a frame of 64x48 is hidden.
        let pixels: Vec<u8> = (0..64 * 48).map(|i| u8::from(i % 64 >= 32)).collect();
        let mask = Mask::new(Image::packed(&pixels, 64, 48).unwrap(), (64, 48));
        for (x, hidden) in
            [(0, true), (24, true), (26, true), (28, false), (40, false), (200, false)]
        {
            assert_eq!(mask.hides(&rect([x * 16, 160, 160, 160])), hidden, "{x}");
        }
        assert!(mask.hides(&rect([-80, -80, 160, 160])), "what of it is in the frame");
        assert!(!mask.hides(&rect([-800, 0, 160, 160])), "outside");
        // The same mask in a quarter of the pixels.
        let small: Vec<u8> = (0..4 * 3).map(|i| u8::from(i % 4 >= 2)).collect();
        let mask = Mask::new(Image::packed(&small, 4, 3).unwrap(), (64, 48));
        assert!(mask.hides(&rect([160, 160, 80, 80])) && !mask.hides(&rect([640, 160, 80, 80])));
        let none = Mask::new(Image::packed(&[], 0, 0).unwrap(), (64, 48));
        assert!(!none.hides(&rect([160, 160, 80, 80])));
    }

    proptest! {
        #[test]
        fn any_box_will_do(v: [i32; 4], w in 0..9usize, h in 0..9usize, frame in (0..70usize, 0..70usize)) {
            let pixels = [0u8; 81];
            let mask = Mask::new(Image::packed(&pixels, w, h).unwrap(), frame);
            let _ = mask.hides(&rect(v));
        }
    }
}
