//! The worst mistakes as pictures: the window around the box in the frames of its st-cube.

use super::breakdown::ClipTruth;
use super::methods::Detected;
use crate::cube::SLICES;
use crate::shell::clips::Clip;
use crate::shell::error::Error;
use crate::shell::judge::{self, Box4, CLASSES, Judged, Verdict};
use crate::shell::source::{self, Frame};
use crate::shell::{interrupt, parallel};
use image::codecs::png::PngEncoder;
use image::imageops::{self, FilterType};
use image::{ExtendedColorType, GrayImage, ImageEncoder, Luma};
use serde::Serialize;
use std::collections::VecDeque;
use std::format;
use std::string::String;
use std::vec::Vec;

/// Pictures of each kind.
pub const COUNT: usize = 24;
/// Of one clip at most, and so many frames apart.
pub const PER_CLIP: usize = 2;
const APART: u64 = 15;
/// The window is this many times the longer side of the box.
const WINDOW: f64 = 2.0;
/// Its side in pixels of the frame.
const WINDOW_SIDES: [f64; 2] = [24.0, 1024.0];
/// Larger windows are shrunk to this many pixels.
const MOST_PIXELS: u32 = 96;
/// Pixels between two slices.
const GAP: u32 = 1;

/// A mistake and its picture.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Strip {
    /// The clip.
    pub clip: String,
    /// Its number.
    #[serde(skip)]
    pub index: usize,
    /// The frame, from 1.
    pub frame: u64,
    /// Left, top, width, height in pixels.
    pub r#box: Box4,
    /// What was missed.
    pub class: Option<&'static str>,
    /// Score of the false alarm.
    pub score: Option<f64>,
    /// Contrast to the surroundings, grey levels.
    pub contrast: f64,
    /// The slices side by side, oldest first, as PNG.
    #[serde(skip)]
    pub png: Vec<u8>,
    /// Where the box is in the picture, in shares of its width and height.
    #[serde(skip)]
    pub mark: Box4,
}

/// Targets that were found at no score: large and clear ones first.
pub fn misses(clips: &[Clip], judged: &[Judged], truth: &[ClipTruth<'_>]) -> Vec<Strip> {
    let mut all = Vec::new();
    for (index, (clip, (judged, truth))) in clips.iter().zip(judged.iter().zip(truth)).enumerate() {
        let mut missed = std::vec![true; judged.targets.len()];
        for detection in &judged.detections {
            if let Verdict::Target(target) = detection.verdict {
                missed[target] = false;
            }
        }
        let targets = judged.targets.iter().zip(truth.contrast).zip(missed);
        all.extend(targets.filter(|t| t.1).map(|((target, &contrast), _)| {
            let rect = judge::rect(&target.truth);
            let class = Some(CLASSES[judge::class(&target.truth)].1);
            let strip = Strip { class, ..strip(clip, index, target.frame, rect, contrast) };
            (rect[2].max(rect[3]) * contrast, strip)
        }));
    }
    worst(all)
}

/// False alarms: the surest first.
pub fn false_alarms(clips: &[Clip], judged: &[Judged], detected: &[Detected]) -> Vec<Strip> {
    let mut all = Vec::new();
    for (index, (clip, (judged, detected))) in
        clips.iter().zip(judged.iter().zip(detected)).enumerate()
    {
        let alarms = judged.detections.iter().filter(|d| d.verdict == Verdict::Alarm);
        all.extend(alarms.map(|alarm| {
            let found = &detected.found[alarm.index];
            let contrast = detected.contrast[alarm.index];
            let strip = strip(clip, index, found.frame, found.rect, contrast);
            (alarm.score, Strip { score: Some(alarm.score), ..strip })
        }));
    }
    worst(all)
}

fn strip(clip: &Clip, index: usize, frame: u64, rect: Box4, contrast: f64) -> Strip {
    Strip {
        clip: clip.name.clone(),
        index,
        frame,
        r#box: rect,
        class: None,
        score: None,
        contrast,
        png: Vec::new(),
        mark: Box4::default(),
    }
}

/// The heaviest, few of them from one clip and these some frames apart.
fn worst(mut all: Vec<(f64, Strip)>) -> Vec<Strip> {
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut kept: Vec<Strip> = Vec::new();
    for (_, strip) in all {
        if kept.len() == COUNT {
            break;
        }
        let same: Vec<&Strip> = kept.iter().filter(|k| k.index == strip.index).collect();
        if same.len() < PER_CLIP && same.iter().all(|k| k.frame.abs_diff(strip.frame) >= APART) {
            kept.push(strip);
        }
    }
    kept
}

/// Cuts the pictures out of the clips, which are read once more up to the last frame needed; strips whose frame is behind the last one
/// go. None after Ctrl-C.
///
/// # Errors
/// Those of the sources.
pub fn cut(clips: &[Clip], jobs: usize, strips: Vec<Strip>) -> Result<Option<Vec<Strip>>, Error> {
    let wanted = |index: usize| strips.iter().any(|strip| strip.index == index);
    let needed: Vec<usize> = (0..clips.len()).filter(|&index| wanted(index)).collect();
    if needed.is_empty() {
        return Ok(Some(strips));
    }
    let sources: Vec<Clip> = needed.iter().map(|&index| clips[index].clone()).collect();
    let work = |i: usize, clip: &Clip| {
        let mut mine: Vec<(usize, Strip)> =
            strips.iter().cloned().enumerate().filter(|(_, s)| s.index == needed[i]).collect();
        cut_clip(clip, &mut mine)?;
        Ok(mine)
    };
    let Some(cut) = parallel::clips(&sources, jobs, &work)? else { return Ok(None) };
    let mut cut = cut.concat();
    cut.sort_by_key(|(place, _)| *place);
    Ok(Some(cut.into_iter().map(|c| c.1).filter(|strip| !strip.png.is_empty()).collect()))
}

fn cut_clip(clip: &Clip, strips: &mut [(usize, Strip)]) -> Result<(), Error> {
    let last = strips.iter().map(|(_, strip)| strip.frame).max().unwrap_or(0);
    let mut source = source::open(&format!("{}", clip.input.display()))?;
    let mut frames: VecDeque<Frame> = VecDeque::new();
    for number in 1..=last {
        // The oldest frame's memory takes the new one.
        let oldest = if frames.len() == SLICES { frames.pop_front() } else { None };
        let mut frame = oldest.unwrap_or_default();
        if !source.next_frame(&mut frame)? || interrupt::requested() {
            break;
        }
        frames.push_back(frame);
        for (_, strip) in strips.iter_mut().filter(|(_, strip)| strip.frame == number) {
            (strip.png, strip.mark) = picture(frames.make_contiguous(), &strip.r#box);
        }
    }
    Ok(())
}

/// The window around `rect` in each frame side by side as PNG, and where the box is in the last one.
fn picture(frames: &[Frame], rect: &Box4) -> (Vec<u8>, Box4) {
    let [left, top, width, height] = *rect;
    let side = (width.max(height) * WINDOW).ceil().clamp(WINDOW_SIDES[0], WINDOW_SIDES[1]);
    let origin = |start: f64, length: f64| (start + (length - side) / 2.0).round();
    let (x, y) = (origin(left, width), origin(top, height));
    let slices: Vec<GrayImage> = frames.iter().map(|f| window(f, x, y, side as u32)).collect();
    let pixels = slices[0].width();
    let count = slices.len() as u32;
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
        let (png, mark) = picture(&frames, &[26.0, 16.0, 8.0, 8.0]);
        let strip = image::load_from_memory(&png).unwrap().into_luma8();
        assert_eq!(strip.dimensions(), (4 * 24 + 3, 24));
        // The window's corner is at (18, 8): the bright pixel is at (12, 12) of each slice.
        for slice in 0..4u32 {
            assert_eq!(strip.get_pixel(slice * 25 + 12, 12).0, [250]);
            assert_eq!(strip.get_pixel(slice * 25, 0).0, [slice as u8 * 10 + 10]);
        }
        assert_eq!(mark, [83.0 / 99.0, 8.0 / 24.0, 8.0 / 99.0, 8.0 / 24.0]);
        let (png, _) = picture(&frames, &[0.0, 0.0, 64.0, 48.0]);
        assert_eq!(image::load_from_memory(&png).unwrap().height(), MOST_PIXELS);
    }

    #[test]
    fn few_of_a_clip_and_apart() {
        let make = |index, frame, weight: f64| {
            let strip = Strip {
                clip: String::new(),
                index,
                frame,
                r#box: [0.0; 4],
                class: None,
                score: None,
                contrast: 0.0,
                png: vec![],
                mark: [0.0; 4],
            };
            (weight, strip)
        };
        let all = vec![
            make(0, 10, 9.0),
            make(0, 12, 8.0),
            make(1, 12, 3.0),
            make(0, 30, 7.0),
            make(0, 90, 6.0),
        ];
        let kept: Vec<(usize, u64)> = worst(all).iter().map(|s| (s.index, s.frame)).collect();
        assert_eq!(kept, [(0, 10), (0, 30), (1, 12)]);
    }

    proptest! {
        #[test]
        fn every_box_gives_a_picture(rect in [-90.0..90.0, -90.0..90.0, 0.0..99.0, 0.0..99.0f64], huge: [f64; 4]) {
            for rect in [rect, huge] {
                prop_assert!(image::load_from_memory(&picture(&[frame(9)], &rect).0).is_ok());
            }
        }
    }
}
