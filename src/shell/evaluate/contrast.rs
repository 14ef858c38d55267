//! Contrast of a target to its surroundings, and texture of these.

use crate::shell::evaluate::matching::Box4;
use crate::shell::sources::Frame;
use std::ops::Range;

/// The ring is at least this wide, pixels.
const MIN_RING: f64 = 3.0;

/// Pixels of a box and of the ring around it.
struct Regions<'f> {
    frame: &'f Frame,
    /// Columns and rows of the box.
    inner: [Range<usize>; 2],
    /// Columns and rows of box and ring together.
    outer: [Range<usize>; 2],
}

impl<'f> Regions<'f> {
    /// The ring is half the box's longer side wide. None where the frame holds no pixel of the box or of the ring.
    fn new(frame: &'f Frame, rect: &Box4) -> Option<Self> {
        let [left, top, width, height] = *rect;
        let ring = (width.max(height) / 2.0).max(MIN_RING);
        let columns = |margin: f64| pixels(left - margin, left + width + margin, frame.width);
        let rows = |margin: f64| pixels(top - margin, top + height + margin, frame.height);
        let inner = [columns(0.0), rows(0.0)];
        let outer = [columns(ring), rows(ring)];
        let area = |[columns, rows]: &[Range<usize>; 2]| columns.len() * rows.len();
        let seen = area(&inner) > 0 && area(&outer) > area(&inner);
        seen.then_some(Self { frame, inner, outer })
    }

    fn pixels_in(&self, [columns, rows]: &[Range<usize>; 2]) -> impl Iterator<Item = f64> {
        let columns = columns.clone();
        let (pixels, width) = (&self.frame.pixels, self.frame.width);
        rows.clone().flat_map(move |y| {
            pixels[y * width..][columns.start..columns.end].iter().map(|&p| f64::from(p))
        })
    }

    fn ring(&self) -> impl Iterator<Item = f64> {
        let [columns, rows] = self.outer.clone();
        let (pixels, width) = (&self.frame.pixels, self.frame.width);
        let inside = |x: usize, y: usize| self.inner[0].contains(&x) && self.inner[1].contains(&y);
        rows.flat_map(move |y| columns.clone().map(move |x| (x, y)))
            .filter(move |&(x, y)| !inside(x, y))
            .map(move |(x, y)| f64::from(pixels[y * width + x]))
    }

    fn ring_mean(&self) -> f64 {
        let (sum, count) = self.ring().fold((0.0, 0.0), |(sum, count), p| (sum + p, count + 1.0));
        sum / count
    }
}

/// Mean absolute difference of the pixels to `mean`, grey levels.
fn deviation(pixels: impl Iterator<Item = f64>, mean: f64) -> f64 {
    let add = |(sum, count), p: f64| (sum + (p - mean).abs(), count + 1.0);
    let (sum, count) = pixels.fold((0.0, 0.0), add);
    sum / count
}

/// Mean absolute difference, in grey levels, of the pixels in a box to the mean of the ring around it. The ring is half the
/// box's longer side wide. 0 where the frame holds no pixel of the box or of the ring.
pub fn contrast(frame: &Frame, rect: &Box4) -> f64 {
    let regions = Regions::new(frame, rect);
    regions.map_or(0.0, |r| deviation(r.pixels_in(&r.inner), r.ring_mean()))
}

/// Texture around a box: mean absolute difference, in grey levels, of the ring's pixels to their mean. 0 as for [`contrast`].
pub fn texture(frame: &Frame, rect: &Box4) -> f64 {
    Regions::new(frame, rect).map_or(0.0, |r| deviation(r.ring(), r.ring_mean()))
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
        assert_eq!(texture(&frame, &[8.0, 6.0, 4.0, 2.0]), 0.0);
        // A ring of 10 x 8 less the box, of which the upper half is 20 brighter.
        let mut rough = frame.clone();
        rough.pixels[..7 * 20].iter_mut().for_each(|p| *p += 20);
        assert_eq!(texture(&rough, &[8.0, 6.0, 4.0, 2.0]), 10.0);
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
                prop_assert!((0.0..=255.0).contains(&texture(&frame, &rect)));
            }
        }
    }
}
