//! Running means of detection scores over frames.
//!
//! An aircraft is where it was, give or take its motion, and looks like one in most frames; a false alarm often does not. A
//! detection's score becomes the mean of its own and of what was found, frame by frame, where Algorithm 1 shows that the
//! object was, over the last looks, with a prior as one look more while they are few. An object that is not found for a few
//! frames is kept where the background's motion takes it, each miss a look with the prior's score. Sizes, which change
//! slowly, are averaged over two looks.
//!
//! A bird beats its wings, an aircraft does not: where a box turns from wide to high and back within a few frames, up to 3
//! log-odds are taken away. The root mean square of second differences of ln(width / height), by which that is seen, is 0.05 to
//! 0.11 for nine of ten targets of airborne2/dev, and 0.18 to 0.26 for birds. Birds that glide stay.
//!
//! Frames older than [`MEMORY`] have no influence, so that a replay that begins later finds the same, bit for bit: a
//! detection belongs to the box that was found last, of several in one frame to the nearest, by boxes as the frames gave
//! them. Choosing the box with the best mean instead would let a mean reach back through all means before.
//!
//! Chosen on flights held back from training (24 rendered, 8 of `airborne/train`): AveP at IoU 0.3 and recall at 10 false
//! alarms in 1000 frames are 0.402, 0.083 for each frame by itself, 0.445, 0.092 for the mean with the frame before that
//! was used until 2026-11-30, 0.481, 0.134 for means over 20 frames, 0.483, 0.134 over 32, and 0.490, 0.123 over 32 with
//! up to 8 misses. Those were means whose weights fade; these have an end. Over 16, 32, 64 and 96 looks AveP at IoU 0.3 on
//! moving/dev is 0.250, 0.290, 0.330 and 0.348, on airborne2/dev over 32 and 64 0.723 and 0.731; 48 are as many as a Cortex-M7
//! has memory for. Weights that fade over 24 of 64 looks, 0.300 on moving/dev, are no better than fewer looks.
//! Sums of log-odds instead of means found less.

use crate::detector::classifier::Scored;
use crate::detector::detection::{Detection, Shift};
use crate::image::Rect;
use crate::math::real::{Real, ln};
use crate::registration::GlobalMotion;
use fixed::types::I28F4;

/// Overlap (IoU, Q8) from which on a box of the last frame is taken for the same object.
const OVERLAP: u8 = 77;

/// Prior log-odds (Q16): the first look at every object, and each look that finds nothing.
const PRIOR: i32 = -3 << 16;

/// Looks that a mean is taken over at most, the last ones.
const LOOKS: usize = 48;

/// Frames in a row without a detection after which an object is forgotten.
const MISSES: u8 = 8;

/// Looks of which the shapes are kept, the last ones; [`LOOKS`] is a multiple.
const SHAPES: usize = 24;

/// Least triples of looks in a row that wing beats are read from.
const TRIPLES: i32 = 10;

/// Mean square of second differences of ln(width / height), Q12, above which there are wing beats: 0.15 squared. Of 20 flights
/// of `airborne/train`, where aircraft turn fast, AveP at IoU 0.3 goes from 0.809 to 0.803, on airborne2/dev from 0.731 to 0.757,
/// with 204 instead of 509 false detections in its flights without targets (means over 64 looks). From 0.14 squared on it is
/// 0.802 and 0.758 with 196; over 16 looks instead of 24, from 0.13 squared on, 0.792 and 0.753 with 229.
const RIGID: i32 = 92;

/// Log-odds (Q16) that are taken away for each step of the mean square beyond [`RIGID`], 160 for 1, and steps at most: 3.
const WING_BEAT: i32 = 160 << 4;
const WING_BEATS: i32 = (3 << 16) / WING_BEAT;

/// The shape of a look that found nothing.
const NO_SHAPE: i8 = i8::MIN;

/// Frames, the newest among them, that a mean depends on: its looks, one a frame, and those over which the object of the
/// oldest was distinguished from others that were missed.
pub const MEMORY: usize = LOOKS + MISSES as usize + 1;

/// An object of the last frames.
#[derive(Debug, Clone, Copy)]
struct PastObject {
    /// Its box as found last, moved with the background since then.
    rect: Rect,
    /// The last looks' log-odds, Q4, from the place of the next one on in the order of their times.
    scores: [i8; LOOKS],
    /// Of the last looks ln(width / height), Q6, or [`NO_SHAPE`]; places as above, modulo their number.
    shapes: [i8; SHAPES],
    /// Number of looks, at most [`LOOKS`], and the place of the next.
    looks: u8,
    next: u8,
    /// Frames in a row without a detection.
    missed: u8,
}

/// Log-odds of Q16 in Q4, within ±8: of a byte, since a Cortex-M7 has no memory for more.
fn kept(score: i32) -> i8 {
    (score.saturating_add(1 << 11) >> 12).clamp(i8::MIN.into(), i8::MAX.into()) as i8
}

impl PastObject {
    /// Not looked at yet.
    const fn new(rect: Rect) -> Self {
        Self { rect, scores: [0; LOOKS], shapes: [NO_SHAPE; SHAPES], looks: 0, next: 0, missed: 0 }
    }

    /// After one look more, of log-odds in Q16 and a shape.
    fn looked(mut self, score: i32, shape: i8) -> Self {
        let place = usize::from(self.next) % LOOKS;
        self.scores[place] = kept(score);
        self.shapes[place % SHAPES] = shape;
        self.next = ((place + 1) % LOOKS) as u8;
        self.looks = self.looks.saturating_add(1).min(LOOKS as u8);
        self
    }

    /// Mean log-odds of the looks, Q16; with the prior as one look more until there are [`LOOKS`].
    fn score(&self) -> i32 {
        let looks = i32::from(self.looks);
        let sum: i32 = self.scores.iter().map(|&score| i32::from(score)).sum();
        let prior = i32::from(usize::from(self.looks) < LOOKS);
        ((sum + prior * i32::from(kept(PRIOR))) << 12).div_euclid((looks + prior).max(1))
    }

    /// Log-odds (Q16) to take away for wing beats: from none, for a rigid object, to 3.
    fn wing_beats(&self) -> i32 {
        let shape = |i: usize| self.shapes.get((usize::from(self.next) + i) % SHAPES).copied();
        let triple = |i: usize| [shape(i), shape(i + 1), shape(i + 2)];
        let mut triples = 0;
        let squares = (0..SHAPES - 2).map(triple).filter_map(|triple| {
            let [Some(a), Some(b), Some(c)] = triple.map(|s| s.filter(|&s| s != NO_SHAPE)) else {
                return None;
            };
            triples += 1;
            let bend = i32::from(a) - 2 * i32::from(b) + i32::from(c);
            Some(bend * bend)
        });
        let sum: i32 = squares.sum();
        if triples < TRIPLES {
            return 0;
        }
        (sum / triples.max(1) - RIGID).clamp(0, WING_BEATS) * WING_BEAT
    }

    /// In the next frame, in which it was not found; `motion` leads from there back.
    fn missed(self, motion: &GlobalMotion) -> Self {
        let centre =
            |start: I28F4, length: I28F4| (start + length / 2).to_bits().saturating_mul(16);
        let (x, y) = (centre(self.rect.x, self.rect.width), centre(self.rect.y, self.rect.height));
        let (before_x, before_y) = motion.map(x, y);
        // Nearly the same as the shift there, which is what has to be taken back.
        let back = |at: i32, before: i32| I28F4::from_bits(at.saturating_sub(before) >> 4);
        let rect = Rect {
            x: self.rect.x.saturating_add(back(x, before_x)),
            y: self.rect.y.saturating_add(back(y, before_y)),
            ..self.rect
        };
        Self { rect, missed: self.missed + 1, ..self.looked(PRIOR, NO_SHAPE) }
    }
}

/// The objects of the last frames, those that were found last first.
#[derive(Debug, Clone, Default)]
pub struct Persistence<const N: usize> {
    last: heapless::Vec<PastObject, N>,
}

impl<const N: usize> Persistence<N> {
    /// Without a previous frame.
    pub const fn new() -> Self {
        Self { last: heapless::Vec::new() }
    }

    /// Forgets all objects and their scores.
    pub fn clear(&mut self) {
        self.last.clear();
    }

    /// Weighs scores and sizes of a frame's detections by the frames before, and takes them for the next; those beyond the
    /// room for them are forgotten. `motion` leads back to the frame before.
    pub fn weigh(&mut self, found: &mut [Scored], motion: &GlobalMotion) {
        let mut again = [false; N];
        let mut new: heapless::Vec<PastObject, N> = heapless::Vec::new();
        for Scored { detection, .. } in found.iter_mut() {
            let Detection { rect, score, shifts: [Shift { x, y }, ..], .. } = *detection;
            let before = Rect { x: rect.x + x, y: rect.y + y, ..rect };
            let same = self.last.iter().enumerate();
            let same = same.filter(|(_, last)| last.rect.overlaps(&before, OVERLAP));
            // Of equals the first.
            let same = same.min_by_key(|(_, last)| (last.missed, distance(&last.rect, &before)));
            let last = same.map(|(place, last)| {
                if let Some(again) = again.get_mut(place) {
                    *again = true;
                }
                *last
            });
            detection.rect = last.map_or(rect, |last| half_way(rect, last.rect));
            let seen = PastObject { rect, missed: 0, ..last.unwrap_or(PastObject::new(rect)) }
                .looked(score, shape(&detection.rect));
            let wing_beats = seen.wing_beats();
            detection.score = seen.score() - wing_beats;
            detection.frame_score = detection.frame_score.saturating_sub(wing_beats);
            // Those beyond the room are forgotten.
            let _ = new.push(seen);
        }
        let mut again = again.iter();
        self.last.retain(|last| again.next() != Some(&true) && last.missed < MISSES);
        self.last.truncate(N - new.len());
        self.last.iter_mut().for_each(|last| *last = last.missed(motion));
        new.extend(self.last.iter().copied());
        self.last = new;
    }
}

/// ln(width / height) of a box, Q6, within ±127.
fn shape(rect: &Rect) -> i8 {
    let log = |side: I28F4| ln(Real::from_num(side));
    let shape = (log(rect.width) - log(rect.height)) * 64;
    shape.round().clamp(Real::from_num(-127), Real::from_num(127)).to_num()
}

/// Sum of the distances of the middles along both axes.
fn distance(a: &Rect, b: &Rect) -> I28F4 {
    let apart = |start: I28F4, length: I28F4, other: I28F4, other_length: I28F4| {
        let middle = start.saturating_add(length / 2);
        middle.saturating_sub(other.saturating_add(other_length / 2)).saturating_abs()
    };
    let x = apart(a.x, a.width, b.x, b.width);
    x.saturating_add(apart(a.y, a.height, b.y, b.height))
}

/// `rect` with sizes half way to those of `last`, about the same middle.
fn half_way(rect: Rect, last: Rect) -> Rect {
    let (width, height) = ((rect.width + last.width) / 2, (rect.height + last.height) / 2);
    Rect {
        x: rect.x + (rect.width - width) / 2,
        y: rect.y + (rect.height - height) / 2,
        width,
        height,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detector::detection::SHIFTS;
    use crate::scan::cascade::Candidate;
    use proptest::prelude::*;
    use std::vec::Vec;

    const ONE: i32 = 1 << 16;

    fn square(x: i32, side: i32) -> Rect {
        let [x, y, width, height] = [x, 50, side, side].map(I28F4::from_num::<i32>);
        Rect { x, y, width, height }
    }

    /// A detection whose object was `shift` further right in the frame before.
    fn scored(rect: Rect, score: i32, shift: i32) -> Scored {
        let shifts = [Shift { x: I28F4::from_num(shift), y: I28F4::ZERO }; SHIFTS];
        let candidate = Candidate { level: 0, x: 0, y: 0, score: 0 };
        Scored { candidate, detection: Detection { rect, score, frame_score: score, shifts } }
    }

    /// Weighs detections with nothing moving; their boxes and scores.
    fn weigh<const N: usize>(seen: &mut Persistence<N>, found: &[Scored]) -> Vec<(Rect, i32)> {
        let mut found = found.to_vec();
        seen.weigh(&mut found, &GlobalMotion::IDENTITY);
        found.iter().map(|s| (s.detection.rect, s.detection.score)).collect()
    }

    #[test]
    fn the_seen_gain_and_the_unseen_lose() {
        let mut seen = Persistence::<4>::new();
        let found = weigh(&mut seen, &[scored(square(0, 20), ONE, 0)]);
        assert_eq!(found, [(square(0, 20), -ONE)]);
        // It moved by 30 to the right and grew from 20 to 24.
        let found = weigh(&mut seen, &[scored(square(28, 24), 5 * ONE, -30)]);
        assert_eq!((found[0].0.width.to_num::<i32>(), found[0].1), (22, ONE), "of -3, 1 and 5");
        assert_eq!(found[0].0.x.to_num::<i32>(), 29);
        // Not where it was.
        assert_eq!(weigh(&mut seen, &[scored(square(90, 24), ONE, 0)])[0].1, -ONE);
        let found = weigh(&mut seen, &[scored(square(190, 20), i32::MAX, 0)]);
        assert!(found[0].1 > 0);
    }

    #[test]
    fn means_of_many_looks() {
        let mut seen = Persistence::<4>::new();
        let mut looks = Vec::from([-3.0]);
        for look in 2..150 {
            let score = f64::from(look % 7);
            looks.push(score);
            // Of as many looks as are kept the prior is left out.
            let last = &looks[looks.len().saturating_sub(LOOKS)..];
            let mean = last.iter().sum::<f64>() / last.len() as f64;
            let found = weigh(&mut seen, &[scored(square(0, 20), (score * 65536.0) as i32, 0)]);
            assert!((f64::from(found[0].1) / 65536.0 - mean).abs() < 1e-3, "{look}");
        }
    }

    #[test]
    fn the_missed_are_kept_for_a_while_and_move_with_the_background() {
        for (misses, found_again) in [(3, true), (6, true), (9, false)] {
            let mut seen = Persistence::<4>::new();
            for _ in 0..20 {
                weigh(&mut seen, &[scored(square(0, 20), 4 * ONE, 0)]);
            }
            // The background goes 10 pixels to the right each frame: back to the frame before it is -10.
            let motion = GlobalMotion::new(640, 480, [-10 << 16, 0, 0, 0, 0, 0, 0, 0]);
            for _ in 0..misses {
                seen.weigh(&mut [], &motion);
            }
            let mut found = [scored(square(10 * misses, 20), 4 * ONE, 0)];
            seen.weigh(&mut found, &GlobalMotion::IDENTITY);
            assert_eq!(found[0].detection.score > ONE, found_again, "{misses} {found:?}");
        }
    }

    #[test]
    fn wing_beats_cost_log_odds() {
        /// Width and height of a box after a number of frames.
        type Sides = fn(f64) -> (f64, f64);
        let cases: [(&str, Sides, bool); 4] = [
            ("rigid", |_| (30.0, 12.0), false),
            ("turns in two seconds", |t| (30.0 + 10.0 * (t / 10.0).sin(), 12.0), false),
            ("comes near", |t| (30.0 * 1.03_f64.powf(t), 12.0 * 1.03_f64.powf(t)), false),
            ("beats wings", |t| (30.0, 16.0 + 9.0 * (t * 1.5).sin()), true),
        ];
        for (name, sides, beats) in cases {
            let mut seen = Persistence::<4>::new();
            let mut last = (0, 0);
            for t in 0..40 {
                let (width, height) = sides(f64::from(t));
                let [x, y] = [50.0 - width / 2.0, 50.0 - height / 2.0].map(I28F4::from_num::<f64>);
                let [width, height] = [width, height].map(I28F4::from_num::<f64>);
                let mut found = [scored(Rect { x, y, width, height }, 4 * ONE, 0)];
                seen.weigh(&mut found, &GlobalMotion::IDENTITY);
                last = (found[0].detection.score, found[0].detection.frame_score);
                // Too few looks say nothing.
                assert!(t > 10 || last.1 == 4 * ONE, "{name} {t}");
            }
            let taken = if beats { 2 * ONE..=3 * ONE } else { 0..=0 };
            assert!(taken.contains(&(4 * ONE - last.1)), "{name} {last:?}");
            assert!(beats == (last.0 < 3 * ONE), "{name} {last:?}");
        }
    }

    #[test]
    fn more_than_there_is_room_for() {
        let mut seen = Persistence::<2>::new();
        let many: Vec<Scored> = (0..5).map(|i| scored(square(40 * i, 20), 0, 0)).collect();
        assert_eq!(weigh(&mut seen, &many).len(), 5);
        assert_eq!(seen.last.len(), 2);
        // What was found goes before what was missed.
        weigh(&mut seen, &[scored(square(400, 20), 0, 0)]);
        assert_eq!(seen.last.len(), 2);
        assert!(seen.last.iter().any(|seen| seen.rect == square(400, 20)));
    }

    /// A frame's detections, boxes and shifts of which are close to each other.
    fn frame() -> impl Strategy<Value = Vec<Scored>> {
        let detection =
            (0..6_i32, 0..3_i32, any::<i16>(), -1..2_i32).prop_map(|(x, side, score, shift)| {
                scored(square(6 * x, 18 + side), i32::from(score) << 4, 3 * shift)
            });
        prop::collection::vec(detection, 0..4)
    }

    proptest! {
        #[test]
        fn what_is_older_than_its_memory_has_no_influence(
            before in prop::collection::vec(frame(), 1..40),
            since in prop::collection::vec(frame(), MEMORY..MEMORY + 20),
        ) {
            let (mut always, mut later) = (Persistence::<8>::new(), Persistence::<8>::new());
            before.iter().for_each(|frame| _ = weigh(&mut always, frame));
            for (number, frame) in since.iter().enumerate() {
                let (found, again) = (weigh(&mut always, frame), weigh(&mut later, frame));
                prop_assert!(number + 1 < MEMORY || found == again, "frame {number}: {found:?} {again:?}");
            }
        }

        #[test]
        fn any_detections_will_do(frames in prop::collection::vec(prop::collection::vec((any::<[i16; 4]>(), any::<i32>(), any::<i16>()), 0..6), 1..12)) {
            let mut seen = Persistence::<4>::new();
            let mut all = Vec::from([PRIOR]);
            for frame in frames {
                let found = frame.iter().map(|&(rect, score, shift)| {
                    let [x, y, width, height] = rect.map(|v| I28F4::from_bits(i32::from(v)));
                    scored(Rect { x, y, width, height }, score, i32::from(shift))
                });
                let mut found: Vec<Scored> = found.collect();
                seen.weigh(&mut found, &GlobalMotion::new(640, 480, [i32::MAX, i32::MIN, 7, 7, 7, 7, 7, 7]));
                prop_assert!(seen.last.len() <= 4);
                // Means lie between the lowest and the highest look so far, as they are kept.
                let kept = |score: i32| i32::from(kept(score)) << 12;
                all.extend(frame.iter().map(|look| kept(look.1)));
                let (low, high) = (*all.iter().min().unwrap(), *all.iter().max().unwrap());
                for Scored { detection, .. } in &found {
                    // Wing beats take away 3 at most.
                    prop_assert!((low - 3 * ONE..=high).contains(&detection.score));
                }
            }
        }
    }
}
