//! Frames of another size than they were recorded in: what a board with a small camera would see of a flight.

use super::Frame;
use crate::detector::{Detections, Shift};
use crate::image::Rect;
use crate::image::pyramid;
use crate::registration::GlobalMotion;
use crate::shell::formats::clips::TruthBox;
use core::fmt;
use core::str::FromStr;
use fixed::types::I28F4;
use std::format;
use std::string::String;
use std::vec;

/// A size of frames: `320x240` on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameSize {
    width: usize,
    height: usize,
}

/// Largest side of `--frame`.
const MAX_SIDE: usize = 8192;

impl FromStr for FrameSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let side = |text: &str| text.parse().ok().filter(|side| (16..=MAX_SIDE).contains(side));
        let sides = text.split_once('x').and_then(|(w, h)| Some((side(w)?, side(h)?)));
        let (width, height) =
            sides.ok_or_else(|| format!("'{text}' is not WIDTHxHEIGHT, 16 to {MAX_SIDE} each"))?;
        Ok(Self { width, height })
    }
}

impl fmt::Display for FrameSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

impl serde::Serialize for FrameSize {
    fn serialize<S: serde::Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.collect_str(self)
    }
}

/// The way from recorded frames to those that the detector sees, and back.
#[derive(Debug, Clone, Copy)]
pub struct Scaling {
    recorded: (usize, usize),
    seen: (usize, usize),
}

impl Scaling {
    /// From frames of `width` x `height` to those of `size`; none: as they are.
    pub fn new(size: Option<FrameSize>, width: usize, height: usize) -> Self {
        let seen = size.map_or((width, height), |size| (size.width, size.height));
        Self { recorded: (width, height), seen }
    }

    /// Width and height of the frames that the detector sees.
    pub fn seen(&self) -> (usize, usize) {
        self.seen
    }

    /// Whether the detector sees the frames as they are.
    pub fn is_none(&self) -> bool {
        self.recorded == self.seen
    }

    /// Writes `frame` as seen to `out`: halved while it is twice as large, then bilinear.
    pub fn apply(&self, frame: &Frame, out: &mut Frame) {
        out.clone_from(frame);
        let mut other = vec![];
        while out.width >= 2 * self.seen.0 && out.height >= 2 * self.seen.1 {
            other.resize((out.width / 2) * (out.height / 2), 0);
            (out.width, out.height) = pyramid::halve(out.view(), &mut other);
            std::mem::swap(&mut out.pixels, &mut other);
        }
        if (out.width, out.height) != self.seen {
            let step = |from: usize, to: usize| ((from << 16) / to.max(1)) as u32;
            let steps = (step(out.width, self.seen.0), step(out.height, self.seen.1));
            let (width, height) =
                (pyramid::resized(out.width, steps.0), pyramid::resized(out.height, steps.1));
            other.resize(width * height, 0);
            pyramid::resize(out.view(), steps, &mut other);
            // A step that was rounded down may give a pixel too many.
            out.pixels.clear();
            for row in other.chunks_exact(width).take(self.seen.1) {
                out.pixels.extend_from_slice(&row[..self.seen.0]);
            }
            (out.width, out.height) = self.seen;
        }
    }

    /// Brings what was found in the frames as seen back to pixels of the recorded ones.
    pub fn restore(&self, found: &mut Detections) {
        if self.is_none() {
            return;
        }
        let scale = |value: I28F4, seen: usize, recorded: usize| {
            I28F4::from_bits((i64::from(value.to_bits()) * recorded as i64 / seen as i64) as i32)
        };
        let across = |value| scale(value, self.seen.0, self.recorded.0);
        let down = |value| scale(value, self.seen.1, self.recorded.1);
        let rect = |rect: Rect| Rect {
            x: across(rect.x),
            y: down(rect.y),
            width: across(rect.width),
            height: down(rect.height),
        };
        for detection in &mut found.list {
            detection.rect = rect(detection.rect);
            detection.shifts = detection.shifts.map(|s| Shift { x: across(s.x), y: down(s.y) });
        }
        found.proposals.iter_mut().for_each(|proposal| *proposal = rect(*proposal));
        found.motion = self.motion(&found.motion);
    }

    /// A motion of the frames as seen in pixels of the recorded ones.
    fn motion(&self, motion: &GlobalMotion) -> GlobalMotion {
        if !motion.is_valid() {
            return GlobalMotion::IDENTITY;
        }
        // The polynomials' arguments are lengths over a power of two that follows the frame's size: see `GlobalMotion`.
        let unit = |(width, height): (usize, usize)| width.max(height).next_power_of_two() as f64;
        let units = unit(self.recorded) / unit(self.seen);
        let across = self.recorded.0 as f64 / self.seen.0 as f64;
        let down = self.recorded.1 as f64 / self.seen.1 as f64;
        let factors = [
            across,
            down,
            units,
            across * units / down,
            down * units / across,
            units,
            units * units / across,
            units * units / down,
        ];
        let mut parameters = motion.parameters();
        for (parameter, factor) in parameters.iter_mut().zip(factors) {
            *parameter = (f64::from(*parameter) * factor).round() as i32;
        }
        GlobalMotion::new(self.recorded.0, self.recorded.1, parameters)
    }

    /// A box of a recorded frame where it is in the frame as seen.
    pub fn truth(&self, truth: &TruthBox) -> TruthBox {
        let across = self.seen.0 as f64 / self.recorded.0.max(1) as f64;
        let down = self.seen.1 as f64 / self.recorded.1.max(1) as f64;
        truth.scaled(across, down)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detector::Detection;
    use proptest::prelude::*;
    use std::string::ToString;

    #[test]
    fn sizes_of_the_command_line() {
        let size: FrameSize = "320x240".parse().unwrap();
        assert_eq!((size.width, size.height, size.to_string().as_str()), (320, 240, "320x240"));
        for bad in ["", "320", "320x", "x240", "320x240x1", "15x20", "320x9000", "-20x20"] {
            assert!(bad.parse::<FrameSize>().is_err(), "{bad}");
        }
    }

    #[test]
    fn an_object_is_where_it_was() {
        for (width, height, size) in [(640, 512, "320x240"), (100, 90, "91x40"), (64, 48, "64x48")]
        {
            let scaling = Scaling::new(Some(size.parse().unwrap()), width, height);
            let mut frame = Frame { pixels: vec![20; width * height], width, height, time_us: 7 };
            for y in 20..40 {
                frame.pixels[y * width + 30..y * width + 50].fill(220);
            }
            let mut seen = Frame::default();
            scaling.apply(&frame, &mut seen);
            assert_eq!((seen.width, seen.height), scaling.seen());
            let truth = TruthBox {
                id: 1,
                left: 30.0,
                top: 20.0,
                width: 20.0,
                height: 20.0,
                class: crate::shell::formats::class::Class::Drone,
                visibility: 1.0,
            };
            let TruthBox { left, top, width, height, .. } = scaling.truth(&truth);
            // A pixel at the edge is grey: the sum over the picture is what the box covers.
            let sum: f64 = seen.pixels.iter().map(|&p| f64::from(p - 20) / 200.0).sum();
            assert!((sum / (width * height) - 1.0).abs() < 0.02, "{size}: {sum}");
            let middle =
                ((top + height / 2.0) as usize) * seen.width + (left + width / 2.0) as usize;
            assert_eq!(seen.pixels[middle], 220, "{size}");
            let bits = |value: f64| I28F4::from_num(value);
            let (x, y) = (bits(left), bits(top));
            let rect = Rect { x, y, width: bits(width), height: bits(height) };
            let shifts = [Shift { x, y }; 3];
            let mut found = Detections::default();
            found.list.push(Detection { rect, score: 5, frame_score: 5, shifts }).unwrap();
            scaling.restore(&mut found);
            let Detection { rect, shifts, .. } = found.list[0];
            for (got, want) in [
                (rect.x, 30),
                (rect.y, 20),
                (rect.width, 20),
                (rect.height, 20),
                (shifts[2].x, 30),
                (shifts[0].y, 20),
            ] {
                assert!((got.to_num::<f64>() - f64::from(want)).abs() < 0.2, "{size}: {got}");
            }
        }
    }

    proptest! {
        #[test]
        fn motions_agree_in_both_sizes(
            parameters in prop::array::uniform8(-300_000..300_000i32), x in 0..640i32, y in 0..512i32,
        ) {
            let scaling = Scaling::new(Some("300x240".parse().unwrap()), 640, 512);
            let seen = GlobalMotion::new(300, 240, parameters);
            let recorded = scaling.motion(&seen);
            let (across, down) = (640.0 / 300.0, 512.0 / 240.0);
            let q8 = |v: f64| (v * 256.0).round() as i32;
            let (want_x, want_y) = seen.map(q8(f64::from(x) / across), q8(f64::from(y) / down));
            let (got_x, got_y) = recorded.map(x << 8, y << 8);
            prop_assert!((f64::from(got_x) - f64::from(want_x) * across).abs() < 12.0);
            prop_assert!((f64::from(got_y) - f64::from(want_y) * down).abs() < 12.0);
        }
    }
}
