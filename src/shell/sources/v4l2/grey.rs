//! From the pictures of a camera to full-range grey, as everywhere in Lookout.

use super::PixelFormat;
use super::error::Damaged;
use super::mjpeg;
use crate::shell::sources::interlaced::{FieldOrder, keep_earlier};
use crate::shell::sources::{Frame, expand};

/// Layout of a stream's pictures in its buffers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BufferLayout {
    pub format: PixelFormat,
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Bytes from row to row; meaningless for MJPEG.
    pub stride: usize,
    /// Whether black is 16 and white 235.
    ///
    /// A driver that does not say so leaves the format's default. That is limited for YUYV, UYVY and NV12, full for
    /// MJPEG and GREY.
    pub limited_range: bool,
    /// The earlier field, where a picture holds two.
    pub interlaced: Option<FieldOrder>,
}

/// Turns buffers to frames.
#[derive(Debug)]
pub struct Converter {
    pub layout: BufferLayout,
    jpeg: mjpeg::MjpegDecoder,
}

impl Converter {
    pub fn new(layout: BufferLayout) -> Self {
        Self { layout, jpeg: mjpeg::MjpegDecoder::default() }
    }

    /// Writes picture and size to `frame`, reusing its memory, and leaves its time as it is.
    ///
    /// A frame from a damaged buffer has the right size and no meaningful pixels.
    pub fn convert(&mut self, bytes: &[u8], frame: &mut Frame) -> Result<(), Damaged> {
        let BufferLayout { format, width, height, .. } = self.layout;
        (frame.width, frame.height) = (width, height);
        frame.pixels.resize(width * height, 0);
        match format {
            PixelFormat::Grey | PixelFormat::Nv12 => self.luma::<1>(bytes, 0, &mut frame.pixels)?,
            PixelFormat::Yuyv => self.luma::<2>(bytes, 0, &mut frame.pixels)?,
            PixelFormat::Uyvy => self.luma::<2>(bytes, 1, &mut frame.pixels)?,
            PixelFormat::Mjpeg => self.jpeg.decode(bytes, (width, height), &mut frame.pixels)?,
        }
        if self.layout.limited_range {
            frame.pixels.iter_mut().for_each(|pixel| *pixel = expand(*pixel));
        }
        if let Some(earlier) = self.layout.interlaced {
            keep_earlier(&mut frame.pixels, width, earlier);
        }
        Ok(())
    }

    /// The luma of pixels of `N` bytes, of which byte `at` is the luma.
    fn luma<const N: usize>(
        &self,
        bytes: &[u8],
        at: usize,
        pixels: &mut [u8],
    ) -> Result<(), Damaged> {
        let BufferLayout { width, height, stride, .. } = self.layout;
        if bytes.len() < stride * (height - 1) + width * N {
            return Err(Damaged);
        }
        for (to, from) in pixels.chunks_exact_mut(width).zip(bytes.chunks(stride)) {
            for (pixel, from) in to.iter_mut().zip(from.chunks_exact(N)) {
                *pixel = from.get(at).copied().unwrap_or_default();
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    /// Luma of the pixel at (x, y), from the formats' definition.
    fn naive(layout: &BufferLayout, bytes: &[u8], x: usize, y: usize) -> u8 {
        let row = y * layout.stride;
        let luma = match layout.format {
            PixelFormat::Yuyv => bytes[row + 4 * (x / 2) + [0, 2][x % 2]],
            PixelFormat::Uyvy => bytes[row + 4 * (x / 2) + [1, 3][x % 2]],
            _ => bytes[row + x],
        };
        if layout.limited_range {
            ((f64::from(luma) - 16.0) * 255.0 / 219.0).round().clamp(0.0, 255.0) as u8
        } else {
            luma
        }
    }

    fn layouts() -> impl Strategy<Value = BufferLayout> {
        let formats: &[PixelFormat] =
            &[PixelFormat::Grey, PixelFormat::Nv12, PixelFormat::Yuyv, PixelFormat::Uyvy];
        let format = prop::sample::select(formats);
        (format, 1usize..20, 1usize..12, 0usize..9, any::<bool>()).prop_map(
            |(format, half, height, padding, limited_range)| {
                let width = 2 * half;
                let stride = width * format.bytes_per_pixel() + padding;
                BufferLayout { format, width, height, stride, limited_range, interlaced: None }
            },
        )
    }

    proptest! {
            #![proptest_config(ProptestConfig::with_cases(64))]

            #[test]
            fn every_pixel_is_the_luma_of_its_place(
                layout in layouts(),
                seed in prop::collection::vec(any::<u8>(), 997),
                missing in 0usize..40,
            ) {
                // The last row may lack its padding.
                let row = layout.width * layout.format.bytes_per_pixel();
                let whole = layout.stride * (layout.height - 1) + row;
                let bytes: Vec<u8> = seed.iter().copied().cycle().take(whole).collect();
                let mut converter = Converter::new(layout);
                let mut frame = Frame { time_us: 7, ..Frame::default() };
                prop_assert_eq!(converter.convert(&bytes, &mut frame), Ok(()));
                prop_assert_eq!((frame.width, frame.height), (layout.width, layout.height));
                prop_assert_eq!(frame.time_us, 7);
                for (y, row) in frame.pixels.chunks(layout.width).enumerate() {
                    for (x, &pixel) in row.iter().enumerate() {
                        prop_assert_eq!(pixel, naive(&layout, &bytes, x, y));
                    }
                }
                let cut = &bytes[..whole.saturating_sub(missing)];
                let expected = if missing == 0 { Ok(()) } else { Err(Damaged) };
                prop_assert_eq!(converter.convert(cut, &mut frame), expected);
    // A damaged picture still fills its size.
                prop_assert_eq!(frame.view().width(), layout.width);
            }
        }
}
