//! Detections drawn on a frame: box, score (log-odds), motion vector.

use crate::detector::{Detection, Detections};
use crate::image::Rect;
use crate::shell::formats::detections::Decimal;
use crate::shell::sources::Frame;
use crate::tracking::traffic::{AlertLevel, Traffic};
use fixed::types::I28F4;
use std::format;
use std::vec::Vec;

const BOX: [u8; 3] = [64, 255, 64];
const MOTION: [u8; 3] = [255, 64, 64];

/// The motion vector is drawn this many times as long as the object's way over the st-cube.
const MOTION_SCALE: i32 = 4;

/// A colour picture: rows of `width` pixels, red green blue.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ColourPicture {
    /// The bytes, three a pixel.
    pub rgb: Vec<u8>,
    /// Pixels in a row.
    pub width: usize,
    /// Number of rows of pixels.
    pub height: usize,
}

impl ColourPicture {
    /// The frame in grey, written over what this picture was (its memory is used again).
    pub fn grey(&mut self, frame: &Frame) {
        self.rgb.clear();
        self.rgb.extend(frame.pixels.iter().flat_map(|&grey| [grey; 3]));
        (self.width, self.height) = (frame.width, frame.height);
    }

    /// Draws boxes and scores, then the motion vectors, which nothing covers.
    pub fn detections(&mut self, detections: &Detections) {
        for detection in &detections.list {
            self.box_and_score(detection);
        }
        for detection in &detections.list {
            if let Some((start, vector)) = motion(detection) {
                self.line(start, vector, MOTION);
            }
        }
    }

    /// Objects that are followed, on top: a box in the colour of the level, the track's number below.
    pub fn tracks(&mut self, traffic: &[Traffic]) {
        for track in traffic.iter().filter(|track| track.confirmed) {
            let colour = match track.level {
                AlertLevel::None | AlertLevel::Traffic => [255, 255, 255],
                AlertLevel::Caution => [255, 200, 0],
                AlertLevel::Warning => [255, 0, 0],
            };
            let [left, top, _, bottom] = self.outline(track.rect, 3, colour);
            let id = format!("{}", track.id);
            let below = bottom + 2;
            let fits = below + GLYPH_HEIGHT <= self.height as i32;
            self.text(left, if fits { below } else { top - GLYPH_HEIGHT - 1 }, &id, colour);
        }
    }

    /// Draws the outline of a box at a distance in pixels; returns its left, top, right, bottom.
    fn outline(&mut self, rect: Rect, around: i32, colour: [u8; 3]) -> [i32; 4] {
        let left = pixel(rect.x) - around;
        let top = pixel(rect.y) - around;
        let right = last_pixel(rect.x, rect.width) + around;
        let bottom = last_pixel(rect.y, rect.height) + around;
        let (width, height) = (self.width as i32, self.height as i32);
        for x in left.max(0)..=right.min(width - 1) {
            self.plot(x, top, colour);
            self.plot(x, bottom, colour);
        }
        for y in top.max(0)..=bottom.min(height - 1) {
            self.plot(left, y, colour);
            self.plot(right, y, colour);
        }
        [left, top, right, bottom]
    }

    /// The score stands above the box, else below it, to the right or to the left: where it meets neither the motion vector
    /// nor the picture's edge.
    fn box_and_score(&mut self, detection: &Detection) {
        // The outline lies around the box: on the pixels just outside.
        let [left, top, right, bottom] = self.outline(detection.rect, 1, BOX);
        let score = format!("{:.2}", Decimal::score(detection.score).to_f64());
        let width = score.len() as i32 * GLYPH_ADVANCE;
        let places = [
            (left, top - GLYPH_HEIGHT - 1),
            (left, bottom + 2),
            (right + 2, top),
            (left - width - 1, top),
        ];
        let vector = motion(detection);
        let is_free = |&&(x, y): &&(i32, i32)| {
            let inside = x >= 0
                && y >= 0
                && x + width <= self.width as i32
                && y + GLYPH_HEIGHT <= self.height as i32;
            inside
                && vector.is_none_or(|vector| !meets(vector, [x, y, x + width, y + GLYPH_HEIGHT]))
        };
        let inside = |&&(_, y): &&(i32, i32)| y >= 0;
        let place = places.iter().find(is_free).or_else(|| places.iter().find(inside));
        let (x, y) = place.copied().unwrap_or(places[1]);
        self.text(x, y, &score, BOX);
    }

    /// Colours a pixel; nothing happens outside the picture.
    fn plot(&mut self, x: i32, y: i32, colour: [u8; 3]) {
        let inside = |v: i32, size: usize| usize::try_from(v).ok().filter(|&v| v < size);
        if let (Some(x), Some(y)) = (inside(x, self.width), inside(y, self.height)) {
            self.rgb[(y * self.width + x) * 3..][..3].copy_from_slice(&colour);
        }
    }

    /// A straight line from `start` along `vector`, no longer than the picture is wide and high together.
    fn line(&mut self, start: (i32, i32), vector: (i32, i32), colour: [u8; 3]) {
        let [dx, dy] = [vector.0, vector.1].map(i64::from);
        let steps = dx.abs().max(dy.abs());
        for step in 0..=steps.min((self.width + self.height) as i64) {
            let at = |start: i32, d: i64| start.saturating_add((d * step / steps.max(1)) as i32);
            self.plot(at(start.0, dx), at(start.1, dy), colour);
        }
    }

    /// Digits, points and minus signs, the upper left corner at (x, y).
    fn text(&mut self, x: i32, y: i32, text: &str, colour: [u8; 3]) {
        for (index, glyph) in text.chars().map(glyph).enumerate() {
            let x = x.saturating_add(index as i32 * GLYPH_ADVANCE);
            for (row, bits) in glyph.iter().enumerate() {
                for column in
                    (0..GLYPH_COLUMNS).filter(|c| bits >> (GLYPH_COLUMNS - 1 - c) & 1 == 1)
                {
                    for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                        let px = x.saturating_add(column * GLYPH_SCALE + dx);
                        let py = y.saturating_add(row as i32 * GLYPH_SCALE + dy);
                        self.plot(px, py, colour);
                    }
                }
            }
        }
    }
}

/// Start and vector of the line that shows where a detection goes: its way over the st-cube, turned round.
fn motion(detection: &Detection) -> Option<((i32, i32), (i32, i32))> {
    let oldest = detection.shifts.last()?;
    let rect = detection.rect;
    let middle =
        |start: I28F4, length: I28F4| (pixel(start) - 1).midpoint(last_pixel(start, length) + 1);
    let ahead = |shift: I28F4| pixel(shift.saturating_mul_int(-MOTION_SCALE));
    let start = (middle(rect.x, rect.width), middle(rect.y, rect.height));
    Some((start, (ahead(oldest.x), ahead(oldest.y))))
}

/// Whether the line from a start along a vector meets the rectangle of left, top, right, bottom (Liang & Barsky 1984).
fn meets(
    ((x, y), (dx, dy)): ((i32, i32), (i32, i32)),
    [left, top, right, bottom]: [i32; 4],
) -> bool {
    let (mut enter, mut leave) = (0.0f64, 1.0f64);
    for (start, step, low, high) in [(x, dx, left, right), (y, dy, top, bottom)] {
        let [start, step, low, high] = [start, step, low, high].map(f64::from);
        if step == 0.0 {
            if start < low || start > high {
                return false;
            }
            continue;
        }
        let (a, b) = ((low - start) / step, (high - start) / step);
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    enter <= leave
}

/// The pixel in which a coordinate lies; far away ones are brought near, they are not drawn anyway.
fn pixel(coordinate: I28F4) -> i32 {
    (coordinate.to_bits() >> 4).clamp(-FAR, FAR)
}

/// The last pixel that a span touches.
fn last_pixel(start: I28F4, length: I28F4) -> i32 {
    pixel(start.saturating_add(length).saturating_sub(I28F4::DELTA))
}

/// Beyond every picture, and still safe to calculate with.
const FAR: i32 = 1 << 24;

const GLYPH_SCALE: i32 = 2;
const GLYPH_COLUMNS: i32 = 3;
const GLYPH_ROWS: usize = 5;
const GLYPH_HEIGHT: i32 = GLYPH_ROWS as i32 * GLYPH_SCALE;
const GLYPH_ADVANCE: i32 = (GLYPH_COLUMNS + 1) * GLYPH_SCALE;

/// The rows of a character, the left column in the highest of three bits; other characters are blank.
fn glyph(character: char) -> [u8; GLYPH_ROWS] {
    match character {
        '0' => [0b111, 0b101, 0b101, 0b101, 0b111],
        '1' => [0b010, 0b110, 0b010, 0b010, 0b111],
        '2' => [0b111, 0b001, 0b111, 0b100, 0b111],
        '3' => [0b111, 0b001, 0b011, 0b001, 0b111],
        '4' => [0b101, 0b101, 0b111, 0b001, 0b001],
        '5' => [0b111, 0b100, 0b111, 0b001, 0b111],
        '6' => [0b111, 0b100, 0b111, 0b101, 0b111],
        '7' => [0b111, 0b001, 0b010, 0b010, 0b010],
        '8' => [0b111, 0b101, 0b111, 0b101, 0b111],
        '9' => [0b111, 0b101, 0b111, 0b001, 0b111],
        '-' => [0b000, 0b000, 0b111, 0b000, 0b000],
        '.' => [0b000, 0b000, 0b000, 0b000, 0b010],
        _ => [0; GLYPH_ROWS],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detector::Shift;
    use proptest::prelude::*;
    use std::vec;

    fn annotated(
        size: (usize, usize),
        rect: [i32; 4],
        shift: [i32; 2],
        score: i32,
    ) -> ColourPicture {
        let frame =
            Frame { pixels: vec![9; size.0 * size.1], width: size.0, height: size.1, time_us: 0 };
        let [x, y, width, height] = rect.map(I28F4::from_bits);
        let [sx, sy] = shift.map(I28F4::from_bits);
        let detection = Detection {
            rect: Rect { x, y, width, height },
            score,
            frame_score: score,
            shifts: [Shift { x: sx, y: sy }; 3],
        };
        let mut detections = Detections::default();
        detections.list.push(detection).unwrap();
        let mut picture = ColourPicture::default();
        picture.grey(&frame);
        picture.detections(&detections);
        picture
    }

    /// The picture as text: grey '.', box '#', motion '*'.
    fn drawn(picture: &ColourPicture) -> Vec<std::string::String> {
        let mark = |p: &[u8]| match p {
            p if p == BOX => '#',
            p if p == MOTION => '*',
            _ => '.',
        };
        picture.rgb.chunks(picture.width * 3).map(|row| row.chunks(3).map(mark).collect()).collect()
    }

    #[test]
    fn the_outline_goes_round_the_box_and_the_vector_points_ahead() {
        // Box of pixels 2..=6 by 14..=16; the object was half a pixel further right: it goes left by two.
        let picture = annotated((10, 19), [32, 14 * 16, 80, 48], [8, 0], 0);
        let rows = drawn(&picture);
        assert_eq!(rows[12], "..........");
        assert_eq!(rows[13], ".#######..");
        assert_eq!(rows[14], ".#.....#..");
        assert_eq!(rows[15], ".#***..#..");
        assert_eq!(rows[17], ".#######..");
        // The first digit of 0.00 in double size just above.
        assert_eq!(rows[2], ".######...");
        assert_eq!(rows[5], ".##..##...");
        assert_eq!(rows[11], ".######...");
    }

    #[test]
    fn the_score_is_never_on_the_motion_vector() {
        // An object in the middle that goes up, down, left, right: the vector is as long when a score is drawn as without.
        for shift in [[0, 160], [0, -160], [160, 0], [-160, 0], [96, 96]] {
            let rect = [60 * 16, 60 * 16, 12 * 16, 12 * 16];
            let rows = drawn(&annotated((130, 130), rect, shift, -(99 << 16)));
            let vector = rows.iter().flat_map(|row| row.chars()).filter(|c| *c == '*').count();
            let longest = (shift[0].abs().max(shift[1].abs()) * MOTION_SCALE / 16) as usize;
            assert_eq!(vector, longest + 1, "{shift:?}");
            // All glyphs of -99.00 are there: none was drawn over.
            let digits = rows.iter().flat_map(|row| row.chars()).filter(|c| *c == '#').count();
            let outline = 4 * 13;
            let strokes = 4 * (3 + 12 + 12 + 1 + 12 + 12);
            let over_outline = digits as i64 - (outline + strokes) as i64;
            assert!((-2..=0).contains(&over_outline), "{shift:?}: {digits}");
        }
    }

    proptest! {
        #[test]
        fn nothing_drawn_leaves_the_picture(w in 0..9usize, h in 0..9usize, rect: [i32; 4], near in [-99..99i32, -99..99, 0..99, 0..99], shift: [i32; 2], score: i32) {
            for rect in [rect, near] {
                prop_assert_eq!(annotated((w, h), rect, shift, score).rgb.len(), w * h * 3);
            }
        }
    }
}
