//! Views of grey pictures, and boxes in them.
//!
//! Coordinates are continuous: x right, y down, the picture spans `0..width` by `0..height`, and the
//! centre of pixel (i, j) is at (i + 1/2, j + 1/2).

pub mod gradient;
pub mod gradient_block;
pub mod nms;
pub mod pyramid;

use fixed::types::I28F4;

/// Why pixels do not make an [`Image`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImageError {
    /// A row is longer than the distance between two rows.
    StrideTooSmall {
        /// Pixels in a row.
        width: usize,
        /// Bytes from one row to the next.
        stride: usize,
    },
    /// There are fewer bytes than the rows need.
    TooFewPixels {
        /// Bytes that the rows need; the last row needs no padding behind it.
        needed: usize,
        /// Bytes given.
        given: usize,
    },
}

impl core::fmt::Display for ImageError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::StrideTooSmall { width, stride } => {
                write!(f, "stride {stride} is smaller than the width {width}")
            }
            Self::TooFewPixels { needed, given } => {
                write!(f, "the picture needs {needed} bytes, {given} were given")
            }
        }
    }
}

impl core::error::Error for ImageError {}

/// A grey picture, 8 bits a pixel, rows `stride` bytes apart.
///
/// ```
/// use lookout::image::Image;
///
/// // Two rows of three pixels, each followed by a byte of padding.
/// let pixels = [1, 2, 3, 0, 4, 5, 6, 0];
/// let image = Image::new(&pixels, 3, 2, 4)?;
/// assert_eq!(image.row(1), [4, 5, 6]);
///
/// // A camera that gives too few bytes is an error, not a panic.
/// assert!(Image::packed(&pixels, 3, 3).is_err());
/// # Ok::<(), lookout::image::ImageError>(())
/// ```
#[derive(Debug, Clone, Copy)]
pub struct Image<'a> {
    pixels: &'a [u8],
    width: usize,
    height: usize,
    stride: usize,
}

impl<'a> Image<'a> {
    /// A view of `pixels`: `height` rows of `width` pixels, `stride` bytes from row to row.
    ///
    /// # Errors
    /// [`ImageError`] when a row does not fit its stride or the bytes do not hold all rows.
    pub const fn new(
        pixels: &'a [u8],
        width: usize,
        height: usize,
        stride: usize,
    ) -> Result<Self, ImageError> {
        if stride < width {
            return Err(ImageError::StrideTooSmall { width, stride });
        }
        let needed = if width == 0 || height == 0 {
            0
        } else {
            // Saturates for absurd sizes, which no slice can hold: refused just below.
            (height - 1).saturating_mul(stride).saturating_add(width)
        };
        if pixels.len() < needed {
            return Err(ImageError::TooFewPixels { needed, given: pixels.len() });
        }
        Ok(Self { pixels, width, height, stride })
    }

    /// A picture whose rows follow each other without padding: `pixels.len() == width * height`.
    ///
    /// # Errors
    /// As [`Image::new`].
    pub const fn packed(pixels: &'a [u8], width: usize, height: usize) -> Result<Self, ImageError> {
        Self::new(pixels, width, height, width)
    }

    /// Pixels in a row.
    pub const fn width(&self) -> usize {
        self.width
    }

    /// Number of rows of pixels.
    pub const fn height(&self) -> usize {
        self.height
    }

    /// Row `y`, without its padding. Panics if `y >= height`.
    pub fn row(&self, y: usize) -> &'a [u8] {
        assert!(y < self.height, "row {y} of {}", self.height);
        if self.width == 0 {
            return &[];
        }
        &self.pixels[y * self.stride..y * self.stride + self.width]
    }
}

/// A box in a picture, in sixteenths of a pixel (Q28.4), half-open.
///
/// ```
/// use fixed::types::I28F4;
/// use lookout::image::Rect;
///
/// let [zero, five, ten] = [0, 5, 10].map(I28F4::from_num::<i32>);
/// let left = Rect { x: zero, y: zero, width: ten, height: ten };
/// let right = Rect { x: five, ..left };
/// // 50 of 150 px² are common to both: an IoU of 1/3, 85.3 in Q8.
/// assert_eq!(left.intersection(&right), 50 * 256);
/// assert!(left.overlaps(&right, 85) && !left.overlaps(&right, 86));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Rect {
    /// Left edge, pixels from the left border of the frame.
    pub x: I28F4,
    /// Upper edge, pixels from the upper border of the frame.
    pub y: I28F4,
    /// Extent to the right, 0 or more.
    pub width: I28F4,
    /// Extent downwards, 0 or more.
    pub height: I28F4,
}

impl Rect {
    /// Area in 1/256 px².
    pub fn area(&self) -> i64 {
        i64::from(self.width.to_bits()) * i64::from(self.height.to_bits())
    }

    /// Area shared with `other`, in 1/256 px².
    pub fn intersection(&self, other: &Self) -> i64 {
        let span = |a: I28F4, la: I28F4, b: I28F4, lb: I28F4| {
            let [a, la, b, lb] = [a, la, b, lb].map(|v| i64::from(v.to_bits()));
            ((a + la).min(b + lb) - a.max(b)).max(0)
        };
        span(self.x, self.width, other.x, other.width)
            * span(self.y, self.height, other.y, other.height)
    }

    /// The part within a picture of `width` x `height` pixels; without extent, at its edge, where there is none.
    pub fn within(&self, width: usize, height: usize) -> Self {
        let clipped = |start: I28F4, extent: I28F4, side: usize| {
            let side = I28F4::saturating_from_num(side);
            let end = start.saturating_add(extent).clamp(I28F4::ZERO, side);
            let start = start.clamp(I28F4::ZERO, side);
            (start, (end - start).max(I28F4::ZERO))
        };
        let (x, width) = clipped(self.x, self.width, width);
        let (y, height) = clipped(self.y, self.height, height);
        Self { x, y, width, height }
    }

    /// Whether intersection over union with `other` exceeds `threshold` (Q8: 128 is one half). Exact, without division.
    pub fn overlaps(&self, other: &Self, threshold: u8) -> bool {
        let shared = self.intersection(other);
        if shared == 0 {
            return false;
        }
        let union = self.area() + other.area() - shared;
        shared * 256 > union * i64::from(threshold)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn rect(v: [i32; 4]) -> Rect {
        let [x, y, width, height] = v.map(I28F4::from_bits);
        Rect { x, y, width, height }
    }

    #[test]
    fn stride_and_padding() {
        let pixels: [u8; 10] = core::array::from_fn(|i| i as u8);
        let image = Image::new(&pixels, 3, 2, 7).unwrap();
        assert_eq!(image.row(1), &[7, 8, 9]);
        assert_eq!(
            Image::new(&pixels, 3, 3, 7).unwrap_err(),
            ImageError::TooFewPixels { needed: 17, given: 10 }
        );
        assert!(Image::new(&pixels, 8, 1, 7).is_err());
        assert!(Image::new(&[], 0, 5, 0).is_ok());
        assert!(Image::new(&pixels, usize::MAX, 2, usize::MAX).is_err());
    }

    #[test]
    fn what_is_within_a_picture() {
        // In sixteenths of a pixel; the picture has 100 x 80 of them.
        let rect = |v: [i32; 4]| rect(v.map(|v| 16 * v));
        let inside = rect([5, 6, 20, 10]);
        assert_eq!(inside.within(100, 80), inside);
        assert_eq!(rect([-5, 75, 20, 10]).within(100, 80), rect([0, 75, 15, 5]));
        assert_eq!(rect([-30, 6, 20, 10]).within(100, 80).width, 0);
        assert_eq!(rect([130, 6, 20, 10]).within(100, 80).area(), 0);
        let huge = Rect { x: I28F4::MIN, y: I28F4::MIN, width: I28F4::MAX, height: I28F4::MAX };
        assert_eq!(huge.within(100, 80).area(), 0);
    }

    proptest! {
        #[test]
        fn overlap_agrees_with_f64(a in [0..2000i32, 0..2000, 1..900, 1..900], b in [0..2000i32, 0..2000, 1..900, 1..900], t in 1..255u8) {
            let f = |v: [i32; 4]| v.map(|v| f64::from(v) / 16.0);
            let (p, q) = (f(a), f(b));
            let w = (p[0] + p[2]).min(q[0] + q[2]) - p[0].max(q[0]);
            let h = (p[1] + p[3]).min(q[1] + q[3]) - p[1].max(q[1]);
            let i = w.max(0.0) * h.max(0.0);
            let iou = i / (p[2] * p[3] + q[2] * q[3] - i);
            prop_assume!((iou - f64::from(t) / 256.0).abs() > 1e-9);
            prop_assert_eq!(rect(a).overlaps(&rect(b), t), iou > f64::from(t) / 256.0);
        }
    }
}
