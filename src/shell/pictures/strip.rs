//! The slices of a detection's st-cube, side by side.

use crate::shell::formats::detections::Box4;
use crate::shell::sources::Frame;
use image::codecs::png::PngEncoder;
use image::imageops::{self, FilterType};
use image::{ExtendedColorType, GrayImage, ImageEncoder, Luma};
use std::vec::Vec;

/// The window is this many times the longer side of the box.
const WINDOW: f64 = 2.0;
/// Its side in pixels of the frame.
const WINDOW_SIDES: [f64; 2] = [24.0, 1024.0];
/// Larger windows are shrunk to this many pixels.
const MOST_PIXELS: u32 = 96;
/// Pixels between two slices.
const GAP: u32 = 1;

/// The window around `rect` in each frame, oldest first, side by side as PNG, and where the box is in the last one, in
/// shares of the picture. With each frame stands by how many pixels the window is moved right and down there.
#[allow(clippy::expect_used, reason = "a picture in memory meets no fault")]
pub fn picture(frames: &[(&Frame, [f64; 2])], rect: &Box4) -> (Vec<u8>, Box4) {
    let [left, top, width, height] = *rect;
    let side = (width.max(height) * WINDOW).ceil().clamp(WINDOW_SIDES[0], WINDOW_SIDES[1]);
    let origin = |start: f64, length: f64| (start + (length - side) / 2.0).round();
    let (x, y) = (origin(left, width), origin(top, height));
    let moved = |(frame, [right, down]): &(&Frame, [f64; 2])| {
        window(frame, (x + right).round(), (y + down).round(), side as u32)
    };
    let slices: Vec<GrayImage> = frames.iter().map(moved).collect();
    let pixels = slices.first().map_or(1, GrayImage::width);
    let count = slices.len().max(1) as u32;
    let strip_width = count * (pixels + GAP) - GAP;
    let mut strip = GrayImage::from_pixel(strip_width, pixels, Luma([255]));
    for (slice, place) in slices.iter().zip(0..) {
        imageops::replace(&mut strip, slice, place * i64::from(pixels + GAP), 0);
    }
    let mut png = Vec::new();
    PngEncoder::new(&mut png)
        .write_image(&strip, strip_width, pixels, ExtendedColorType::L8)
        .expect("a picture in memory meets no fault");
    // Pixels of the frame to shares of the strip.
    let scale = f64::from(pixels) / side;
    let last = f64::from((count - 1) * (pixels + GAP));
    let across = |v: f64| v / f64::from(strip_width);
    let mark =
        [across(last + (left - x) * scale), (top - y) / side, across(width * scale), height / side];
    (png, mark)
}

/// A square of the frame, black outside of it.
fn window(frame: &Frame, x: f64, y: f64, side: u32) -> GrayImage {
    let pixel = |column: u32, row: u32| {
        let (px, py) = (x + f64::from(column), y + f64::from(row));
        let inside =
            (0.0..frame.width as f64).contains(&px) && (0.0..frame.height as f64).contains(&py);
        Luma([if inside { frame.pixels[py as usize * frame.width + px as usize] } else { 0 }])
    };
    let full = GrayImage::from_fn(side, side, pixel);
    if side <= MOST_PIXELS {
        return full;
    }
    imageops::resize(&full, MOST_PIXELS, MOST_PIXELS, FilterType::Triangle)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec;

    fn frame(grey: u8) -> Frame {
        let mut frame = Frame { pixels: vec![grey; 64 * 48], width: 64, height: 48, time_us: 0 };
        frame.pixels[20 * 64 + 30] = 250;
        frame
    }

    #[test]
    fn slices_stand_side_by_side() {
        let frames: Vec<Frame> = (1..=4).map(|i| frame(i * 10)).collect();
        let still: Vec<_> = frames.iter().map(|frame| (frame, [0.0; 2])).collect();
        let (png, mark) = picture(&still, &[26.0, 16.0, 8.0, 8.0]);
        let strip = image::load_from_memory(&png).unwrap().into_luma8();
        assert_eq!(strip.dimensions(), (4 * 24 + 3, 24));
        // The window's corner is at (18, 8): the bright pixel is at (12, 12) of each slice.
        for slice in 0..4u32 {
            assert_eq!(strip.get_pixel(slice * 25 + 12, 12).0, [250]);
            assert_eq!(strip.get_pixel(slice * 25, 0).0, [slice as u8 * 10 + 10]);
        }
        assert_eq!(mark, [83.0 / 99.0, 8.0 / 24.0, 8.0 / 99.0, 8.0 / 24.0]);
        // A window that was three pixels to the left a frame ago sees the bright pixel further right.
        let moved = [(&frames[0], [-3.0, 1.0]), (&frames[1], [0.0; 2])];
        let strip = image::load_from_memory(&picture(&moved, &[26.0, 16.0, 8.0, 8.0]).0).unwrap();
        assert_eq!(strip.into_luma8().get_pixel(15, 11).0, [250]);
        let (png, _) = picture(&still, &[0.0, 0.0, 64.0, 48.0]);
        assert_eq!(image::load_from_memory(&png).unwrap().height(), MOST_PIXELS);
    }

    proptest! {
        #[test]
        fn every_box_gives_a_picture(rect in [-90.0..90.0, -90.0..90.0, 0.0..99.0, 0.0..99.0f64], huge: [f64; 4]) {
            for rect in [rect, huge] {
                prop_assert!(image::load_from_memory(&picture(&[(&frame(9), [0.0; 2])], &rect).0).is_ok());
            }
        }
    }
}
