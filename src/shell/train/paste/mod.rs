//! Objects of other clips pasted into recorded flights.
//!
//! A recorded flight shows one or two objects, always against the same background: trees can overfit to the pair. Objects
//! cut out of a plain sky and drawn into the flight on courses of their own break these pairs (Dwibedi, Misra and Hebert,
//! "Cut, Paste and Learn", ICCV 2017). They move before the world, not the frame: by the camera's attitude where it is
//! known, else by the background's measured motion ([`Anchor`]).

mod anchor;
mod course;

mod turning;

use crate::shell::formats::class::Class;
use crate::shell::formats::clips::TruthBox;
use crate::shell::render::Cutout;
use crate::shell::sources::Frame;
use crate::shell::support::random::Random;
pub use anchor::Anchor;
use course::PasteCourse;
use std::vec::Vec;
pub use turning::Turning;

/// The number of the first pasted object among those of a clip; the others' come after it.
pub const FIRST_ID: i64 = 1_000_000;

/// Seconds of a frame.
const FRAME: f64 = 1.0 / 30.0;

/// Courses drawn for an object before it is given up: many leave the frame, or cross another object.
const TRIES: usize = 24;

/// Most frames of a cut-out object in a row, and most such rows of a clip.
const MOST: (usize, usize) = (32, 6);

/// Fewest frames of a cut-out object in a row.
const FEWEST: usize = 8;

/// Most steps along the way that an object moves while the shutter is open, and most parts of a pixel each way.
const MOST_STEPS: f64 = 12.0;
const MOST_PARTS: f64 = 5.0;

/// Pixels of a cut-out around its solid part that are drawn too.
const HALO: f64 = 8.0;

/// Most times that an object is enlarged.
const LARGEST: f64 = 1.6;

/// Smallest contrast of a pasted object, grey levels.
const FAINT: f64 = 12.0;

/// A point of the frame: pixels to the right and down.
type FramePoint = [f64; 2];

/// An object in successive frames.
pub type PastedRun = Vec<Cutout>;

/// The objects of a clip that stand before a plain sky, in runs of successive frames.
#[derive(Debug, Default)]
pub struct Runs {
    ended: Vec<PastedRun>,
    run: PastedRun,
}

impl Runs {
    /// Looks at the next frame; none where it is not known.
    pub fn push(&mut self, frame: Option<&Frame>, boxes: &[TruthBox]) {
        let object = match (frame, boxes) {
            (Some(frame), [one]) if one.class != Class::Bird => Cutout::cut(frame, one),
            _ => None,
        };
        let ended = object.is_none();
        self.run.extend(object);
        if self.run.len() == MOST.0 || ended {
            self.end();
        }
    }

    fn end(&mut self) {
        let run = core::mem::take(&mut self.run);
        if run.len() >= FEWEST && self.ended.len() < MOST.1 {
            self.ended.push(run);
        }
    }

    /// The changed runs of pixels.
    pub fn finish(mut self) -> Vec<PastedRun> {
        self.end();
        self.ended
    }
}

/// An object with its course through the frames of a clip.
struct Pasted<'a> {
    run: &'a PastedRun,
    course: PasteCourse,
    /// Its centre in each frame; none behind the camera.
    places: Vec<Option<FramePoint>>,
    /// Frame of the run in the first frame.
    phase: usize,
    mirrored: bool,
    /// Width against height, of that in the run.
    stretch: f64,
    /// Share of a frame's time that the shutter is open.
    exposure: f64,
    /// Contrast, brightness, and whether light and dark change places.
    tone: (f64, f64, bool),
    /// Sensor noise, standard deviation in grey levels.
    noise: f64,
}

impl<'a> Pasted<'a> {
    fn draw(library: &'a [Vec<PastedRun>], random: &mut Random) -> Self {
        let clip = &library[random.below(library.len())];
        let run = &clip[random.below(clip.len())];
        Self {
            run,
            course: PasteCourse::draw(random),
            places: Vec::new(),
            phase: random.below(run.len()),
            mirrored: random.below(2) == 0,
            stretch: (0.6 * random.symmetric()).exp(),
            exposure: 0.35 + 0.15 * random.symmetric(),
            tone: (0.8 + 0.3 * random.symmetric(), 30.0 * random.symmetric(), random.below(7) == 0),
            noise: 2.0 + random.symmetric(),
        }
    }

    /// The object in the frame at `index`: forth and back through its run.
    fn cutout(&self, index: usize) -> &'a Cutout {
        let length = self.run.len();
        let at = (self.phase + index) % (2 * length);
        &self.run[at.min(2 * length - 1 - at)]
    }

    /// Its box in the frame at `index`, whether or not inside of the frame.
    fn rect(&self, index: usize) -> Option<[f64; 4]> {
        let time = index as f64 * FRAME;
        let [x, y] = self.places[index]?;
        let [_, _, width, height] = self.cutout(index).bounds;
        let (width, length) = (width * self.stretch, self.course.length(time));
        let scale = length / width.max(height);
        let (width, height) = (width * scale, height * scale);
        (length > 0.0).then_some([x - width / 2.0, y - height / 2.0, width, height])
    }
}

/// Successive frames to paste into.
#[derive(Debug)]
pub struct Scenery<'a> {
    /// Source of the objects' motion before the world.
    pub anchor: &'a Anchor,
    /// Index of the first frame in its clip.
    pub first: usize,
    /// The frames; those that are empty stay so.
    pub frames: &'a mut [Frame],
    /// The boxes of each frame.
    pub boxes: &'a mut [Vec<TruthBox>],
}

/// Pastes up to `count` objects of `library` (clips of runs) into frames; adds their boxes to those of the frames.
pub fn paste(scenery: Scenery<'_>, library: &[Vec<PastedRun>], count: usize, random: &mut Random) {
    let Scenery { anchor, first, frames, boxes } = scenery;
    let Some(size) = frames.iter().find(|f| !f.pixels.is_empty()).map(|f| (f.width, f.height))
    else {
        return;
    };
    if library.is_empty() {
        return;
    }
    for number in 0..count {
        let fits = |pasted: &Pasted<'_>| fits(pasted, boxes, size);
        let mut tries = (0..TRIES).filter_map(|_| {
            let pasted = Pasted::draw(library, random);
            let index = random.below(frames.len());
            let place =
                [size.0, size.1].map(|side| side as f64 * (0.5 + 0.47 * random.symmetric()));
            let there = (first + index, place);
            let places = anchor.places(pasted.course, (first, frames.len()), there, size)?;
            Some(Pasted { places, ..pasted }).filter(fits)
        });
        let Some(pasted) = tries.next() else { continue };
        drop(tries);
        for index in 0..frames.len() {
            let Some(rect) = pasted.rect(index) else { continue };
            let at = |index: usize| pasted.rect(index).unwrap_or(rect);
            let (before, after) =
                (at(index.saturating_sub(1)), at((index + 1).min(frames.len() - 1)));
            let centre = |rect: [f64; 4], i: usize| rect[i] + rect[i + 2] / 2.0;
            let blur =
                [0, 1].map(|i| (centre(after, i) - centre(before, i)) / 2.0 * pasted.exposure);
            let mut contrast = 0.0;
            if !frames[index].pixels.is_empty() {
                contrast =
                    render(&mut frames[index], &pasted, pasted.cutout(index), rect, blur, random);
            }
            let seen = seen(rect, size, &pasted, FIRST_ID + number as i64, index);
            // Hardly visible objects count neither as targets nor as background.
            let shown = |b: TruthBox| if contrast < FAINT { 0.5 } else { b.visibility };
            boxes[index].extend(seen.map(|b| TruthBox { visibility: shown(b), ..b }));
        }
    }
}

/// Whether an object is in sight half of the time, never close to another one and never too much enlarged.
fn fits(pasted: &Pasted<'_>, boxes: &[Vec<TruthBox>], size: (usize, usize)) -> bool {
    let mut inside = 0;
    for (index, others) in boxes.iter().enumerate() {
        let Some([left, top, width, height]) = pasted.rect(index) else { continue };
        let (x, y) = (left + width / 2.0, top + height / 2.0);
        inside +=
            usize::from((0.0..size.0 as f64).contains(&x) && (0.0..size.1 as f64).contains(&y));
        let length = width.max(height);
        let close = |other: &TruthBox| {
            (other.left + other.width / 2.0 - x).abs() < 0.75 * (other.width + length)
                && (other.top + other.height / 2.0 - y).abs() < 0.75 * (other.height + length)
        };
        let [_, _, across, down] = pasted.cutout(index).bounds;
        if length > LARGEST * across.max(down) || others.iter().any(close) {
            return false;
        }
    }
    2 * inside > boxes.len()
}

/// The part of a box that is in the frame.
fn seen(
    [left, top, width, height]: [f64; 4],
    size: (usize, usize),
    pasted: &Pasted<'_>,
    id: i64,
    index: usize,
) -> Option<TruthBox> {
    let (right, bottom) = ((left + width).min(size.0 as f64), (top + height).min(size.1 as f64));
    let (x, y) = (left.max(0.0), top.max(0.0));
    let whole = (x, y) == (left, top) && right == left + width && bottom == top + height;
    (right - x >= 1.0 && bottom - y >= 1.0).then(|| TruthBox {
        id,
        left: x,
        top: y,
        width: right - x,
        height: bottom - y,
        class: pasted.cutout(index).class,
        visibility: if whole { 1.0 } else { 0.5 },
    })
}

/// Draws an object so that its bounds fill `rect`, moved by `blur` while the shutter was open: each pixel is the mean
/// over its area and that time. Returns its contrast: the mean change of its pixels in grey levels.
fn render(
    frame: &mut Frame,
    pasted: &Pasted<'_>,
    cutout: &Cutout,
    rect: [f64; 4],
    blur: [f64; 2],
    random: &mut Random,
) -> f64 {
    let [left, top, width, height] = cutout.bounds;
    // Pixels of the cut-out for one of the frame.
    let steps = [width / rect[2], height / rect[3]];
    let parts = steps[0].max(steps[1]).ceil().clamp(1.0, MOST_PARTS);
    let times = blur[0].hypot(blur[1]).ceil().clamp(1.0, MOST_STEPS);
    let span = |i: usize, end: usize| {
        let reach = HALO / steps[i] + blur[i].abs() / 2.0 + 1.0;
        let first = (rect[i] - reach).floor().clamp(0.0, end as f64);
        let last = (rect[i] + rect[i + 2] + reach).ceil().clamp(0.0, end as f64);
        first as usize..last as usize
    };
    let (gain, offset, inverted) = pasted.tone;
    let (mut changes, mut weight) = (0.0, 1.0);
    let reach = cutout.reach();
    // Whether a row or column of the frame sees any of the object while the shutter is open; a little more is harmless.
    let sees = |i: usize, at: usize| {
        let from = |v: f64| (v - rect[i]) * steps[i];
        let (first, last) = (
            from(at as f64 - blur[i].abs() / 2.0) - 0.01,
            from(at as f64 + 1.0 + blur[i].abs() / 2.0) + 0.01,
        );
        let (first, last) =
            if i == 0 && pasted.mirrored { (width - last, width - first) } else { (first, last) };
        cutout.bounds[i] + last >= reach[i] && cutout.bounds[i] + first <= reach[i + 2]
    };
    for y in span(1, frame.height).filter(|&y| sees(1, y)) {
        for x in span(0, frame.width).filter(|&x| sees(0, x)) {
            let [mut opacity, mut light] = [0.0; 2];
            let middles = |count: f64| (0..count as usize).map(move |i| (i as f64 + 0.5) / count);
            for time in middles(times) {
                for (j, i) in middles(parts).flat_map(|j| middles(parts).map(move |i| (j, i))) {
                    let u = (x as f64 + i - rect[0] - blur[0] * (time - 0.5)) * steps[0];
                    let v = (y as f64 + j - rect[1] - blur[1] * (time - 0.5)) * steps[1];
                    let u = if pasted.mirrored { width - u } else { u };
                    let [o, l] = cutout.at(left + u, top + v);
                    opacity += o;
                    light += l;
                }
            }
            let count = parts * parts * times;
            (opacity, light) = (opacity / count, light / count);
            if opacity == 0.0 {
                continue;
            }
            let toned = gain * light + offset * opacity;
            let toned = if inverted { 255.0 * opacity - toned } else { toned };
            // Uniform noise of that standard deviation.
            let noise = pasted.noise * 3f64.sqrt() * random.symmetric() * opacity;
            let pixel = &mut frame.pixels[y * frame.width + x];
            let behind = f64::from(*pixel) * opacity;
            changes += (toned - behind).abs();
            weight += opacity;
            let shown = f64::from(*pixel) - behind + toned + noise;
            *pixel = shown.round().clamp(0.0, 255.0) as u8;
        }
    }
    changes / weight
}

#[cfg(test)]
mod tests {
    use super::turning::tests::{SIZE, turning};
    use super::*;
    use std::sync::Arc;
    use std::vec;

    /// Frames of one grey level; every third one is not needed.
    fn frames(grey: u8) -> Vec<Frame> {
        let (width, height) = SIZE;
        let frame = |i: usize| match i % 3 {
            2 => Frame::default(),
            _ => Frame { pixels: vec![grey; width * height], width, height, time_us: i as i64 },
        };
        (0..90).map(frame).collect()
    }

    /// A clip whose object, a dark bar, grows slowly before a bright sky.
    fn library() -> Vec<Vec<PastedRun>> {
        let mut frames: Vec<Frame> = frames(200);
        let mut boxes = vec![Vec::new(); frames.len()];
        for i in 0..20 {
            frames[i] = Frame {
                pixels: vec![200; SIZE.0 * SIZE.1],
                width: SIZE.0,
                height: SIZE.1,
                time_us: 0,
            };
            let (width, height) = (30 + i, 12);
            for y in 50..50 + height {
                frames[i].pixels[y * SIZE.0 + 40..y * SIZE.0 + 40 + width].fill(60);
            }
            let (width, height) = (width as f64, height as f64);
            boxes[i].push(TruthBox {
                id: 1,
                left: 40.0,
                top: 50.0,
                width,
                height,
                class: Class::Airplane,
                visibility: 1.0,
            });
        }
        let mut found = Runs::default();
        for (frame, boxes) in frames.iter().zip(&boxes) {
            found.push(Some(frame).filter(|f| !f.pixels.is_empty()), boxes);
        }
        let runs = found.finish();
        assert_eq!(runs.iter().map(Vec::len).collect::<Vec<_>>(), [20]);
        vec![runs]
    }

    fn scenery<'a>(
        anchor: &'a Anchor,
        frames: &'a mut [Frame],
        boxes: &'a mut [Vec<TruthBox>],
    ) -> Scenery<'a> {
        Scenery { anchor, first: 0, frames, boxes }
    }

    #[test]
    fn pasted_objects_are_in_their_boxes_and_nowhere_else() {
        let (anchor, library) = (Anchor::Attitude(Arc::new(turning())), library());
        let mut pasted = 0;
        for seed in 0..12 {
            let mut shown = frames(120);
            let mut boxes = vec![Vec::new(); shown.len()];
            paste(scenery(&anchor, &mut shown, &mut boxes), &library, 2, &mut Random::new(seed));
            for (frame, boxes) in shown.iter().zip(&boxes) {
                assert_eq!(frame.pixels.is_empty(), frame.width == 0);
                for (i, &pixel) in frame.pixels.iter().enumerate() {
                    let (x, y) = ((i % SIZE.0) as f64 + 0.5, (i / SIZE.0) as f64 + 0.5);
                    // An object's edge is not sharp, and the camera moves a few pixels while the shutter is open.
                    let near = |b: &TruthBox| {
                        (b.left - 6.0..b.left + b.width + 6.0).contains(&x)
                            && (b.top - 6.0..b.top + b.height + 6.0).contains(&y)
                    };
                    // Less than a pixel of it at the frame's edge: no box.
                    let middle = |v: f64, side: usize| (4.0..side as f64 - 4.0).contains(&v);
                    let edge = !middle(x, SIZE.0) || !middle(y, SIZE.1);
                    let allowed = pixel == 120 || edge || boxes.iter().any(near);
                    assert!(allowed, "{seed}: {x} {y} {boxes:?}");
                }
                for b in boxes.iter().filter(|b| b.visibility == 1.0 && !frame.pixels.is_empty()) {
                    assert_eq!(b.class, Class::Airplane);
                    let (x, y) = (b.left + b.width / 2.0, b.top + b.height / 2.0);
                    let middle = frame.pixels[y as usize * SIZE.0 + x as usize];
                    // A tone may bring an object near to what is behind it.
                    pasted += usize::from(middle.abs_diff(120) > 12);
                }
            }
        }
        assert!(pasted > 200, "{pasted}");
    }

    #[test]
    fn the_same_seed_pastes_the_same() {
        let (anchor, library) = (Anchor::Attitude(Arc::new(turning())), library());
        let show = |seed| {
            let mut shown = frames(120);
            let mut boxes = vec![Vec::new(); shown.len()];
            paste(scenery(&anchor, &mut shown, &mut boxes), &library, 2, &mut Random::new(seed));
            (shown.into_iter().map(|f| f.pixels).collect::<Vec<_>>(), boxes)
        };
        assert_eq!(show(1), show(1));
        assert_ne!(show(1).1, show(2).1);
        let mut empty = frames(120);
        let mut boxes = vec![Vec::new(); empty.len()];
        paste(scenery(&anchor, &mut empty, &mut boxes), &[], 2, &mut Random::new(1));
        assert!(boxes.iter().all(Vec::is_empty));
    }
}
