//! The verdict on a candidate: its st-cube, a score, a box (level 7).

use crate::boxes::Fit;
use crate::channels::front_end::FrontEnd;
use crate::channels::scale_space::Pyramid;
use crate::channels::window::Position;
use crate::channels::window::boxed;
use crate::channels::window::{SLICES, WINDOW, centre};
use crate::detector::detection::{Detection, SHIFTS, Shift};
use crate::image::Rect;
use crate::image::gradient::CELL;
use crate::math::fixed::exp2_q16;
use crate::model::Model;
use crate::scan::cascade::Candidate;
use crate::scan::window;
use crate::stcube::compensation::{self, Alignment, Path};
use crate::stcube::cube::{Cube, SCALARS};
use crate::stcube::spans::{Ready, Spans};
use crate::stcube::window_flow;
use core::cmp::Reverse;
use fixed::types::I28F4;

const _: () = assert!(SHIFTS == SLICES - 1);

/// Farthest that a box's centre may be from its window's, in cells, Q8.
const FARTHEST_CENTRE: i32 = (WINDOW as i32) << 8;

/// Looks that a detection's score and box are the means of: so many levels coarser. Looks to the side as well gained
/// nothing that could be told from chance, at twice the time; nor did fitting the box before these looks too (AveP at IoU
/// 0.5 / 0.3 on airborne flights held back 0.599 / 0.732 instead of 0.597 / 0.730).
const LOOKS: [isize; 3] = [0, -1, 1];

/// A candidate with its verdict.
#[derive(Debug, Clone, Copy)]
pub struct Judged {
    /// The candidate.
    pub candidate: Candidate,
    /// What was made of it.
    pub detection: Detection,
}

impl Judged {
    /// Surest first; ties by place, so that the order is the same on every machine.
    pub fn rank(&self) -> impl Ord + use<> {
        let Detection { rect, score, .. } = self.detection;
        (Reverse(score), rect.x, rect.y, rect.width, rect.height)
    }
}

/// What candidates are judged by.
#[derive(Debug, Clone, Copy)]
pub struct Judge<'a> {
    /// The model.
    pub model: &'a Model<'a>,
    /// What the older slices of a cube follow.
    pub alignment: Alignment,
    /// Whether Algorithm 1 follows a detection through the slices where the cube's own slices do not.
    pub trace: bool,
    /// What fits boxes to objects, where boxes are to be fitted.
    pub fit: Option<&'a Fit<'a>>,
    /// Whether the cube gives the score; otherwise the scan's own stands.
    pub stcube: bool,
    /// The front end after the newest frame.
    pub front: &'a FrontEnd,
    /// The levels.
    pub pyramid: Pyramid<'a>,
}

impl Judge<'_> {
    /// Judges a candidate by its cube and gives it a box; `None` if it is rejected.
    #[inline(never)]
    pub fn candidate(&self, candidate: &Candidate, cube: &mut Cube) -> Option<Judged> {
        let path = self.cut(candidate, window(candidate), cube);
        let mut spans = Spans::EMPTY;
        let cube = &spans.ready(cube);
        let test = |feature, threshold| self.test(feature, threshold, cube);
        let score = if self.stcube { self.model.cube().cascade(test)? } else { candidate.score };
        let detection = self.detection(candidate, &path, cube, score);
        Some(Judged { candidate: *candidate, detection })
    }

    /// Looks again where the box is, on the level that suits its size, then around that place: boxes are most exact for
    /// centred targets, and the mean of several looks is surer than any of them. Score and box become the means; the
    /// box is then fitted.
    #[inline(never)]
    pub fn refine(&self, judged: &mut Judged, cube: &mut Cube) {
        let Judged { candidate, detection } = *judged;
        let Some(level) = self.level_of(&detection.rect) else { return };
        let centred = self.look(&candidate, &detection.rect, level, cube);
        let Some(level) = self.level_of(&centred.rect) else { return };
        let mut score = i64::from(detection.score);
        let (mut sums, mut looks) = ([0i64; 4], 0u32);
        for step in LOOKS {
            let Some(level) = level.checked_add_signed(step) else { continue };
            if !self.pyramid.levels().get(level).is_some_and(|l| l.active) {
                continue;
            }
            let again = self.look(&candidate, &centred.rect, level, cube);
            score += i64::from(again.score);
            let Rect { x, y, width, height } = again.rect;
            for (sum, value) in sums.iter_mut().zip([x + width / 2, y + height / 2, width, height])
            {
                *sum += i64::from(value.to_bits());
            }
            looks += 1;
        }
        let [x, y, width, height] =
            sums.map(|sum| I28F4::from_bits(sum.div_euclid(i64::from(looks.max(1))) as i32));
        let rect = Rect { x: x - width / 2, y: y - height / 2, width, height };
        let rect = self.fit.map_or(rect, |fit| fit.fit(rect, &self.pyramid, cube));
        let score = score.div_euclid(i64::from(looks) + 1) as i32;
        judged.detection = Detection { rect, score, ..centred };
        if self.trace && self.alignment != Alignment::Regressors {
            self.trace(&mut judged.detection, cube);
        }
    }

    /// Follows the object in a detection's box back through the slices by Algorithm 1: its shifts.
    fn trace(&self, detection: &mut Detection, cube: &mut Cube) {
        let Some(level) = self.level_of(&detection.rect) else { return };
        let level = &self.pyramid.level(level);
        let start = Position::centred(centre(&detection.rect), level.level.scale);
        let slices = self.front.slices(level);
        let path = compensation::compensate(&slices, Some(self.model.regressors()), start, cube);
        detection.shifts = shifts(&path, level.level.scale);
    }

    /// The searched level whose nominal target is nearest to the longer side of a box.
    fn level_of(&self, rect: &Rect) -> Option<usize> {
        let length = rect.width.max(rect.height).to_bits();
        let distance = |target: i32| {
            // Ratio of the larger to the smaller length, Q8.
            i64::from(length.max(target)) * 256 / i64::from(length.min(target).max(1))
        };
        let levels = self.pyramid.levels().iter().enumerate().filter(|(_, l)| l.active);
        levels.min_by_key(|(_, l)| distance(l.target_q4())).map(|(number, _)| number)
    }

    /// Looks at the middle of `rect` on another level.
    fn look(&self, candidate: &Candidate, rect: &Rect, level: usize, cube: &mut Cube) -> Detection {
        let at = Position::centred(centre(rect), self.pyramid.levels()[level].scale);
        let candidate = Candidate { level: level as u8, ..*candidate };
        let path = self.cut(&candidate, at, cube);
        let mut spans = Spans::EMPTY;
        let cube = &spans.ready(cube);
        let test = |feature, threshold| self.test(feature, threshold, cube);
        let score = if self.stcube { self.model.cube().score(test) } else { candidate.score };
        self.detection(&candidate, &path, cube, score)
    }

    /// Whether a feature of a cube is above a threshold.
    #[inline]
    fn test(&self, feature: u16, threshold: u16, cube: &Ready<'_>) -> bool {
        cube.exceeds(self.model.features(), feature, threshold)
    }

    /// Cuts the cube of a candidate from the window at `start` of its level: Algorithm 1, and what is known beside the
    /// channels.
    pub fn cut(&self, candidate: &Candidate, start: Position, cube: &mut Cube) -> Path {
        let level = &self.pyramid.level(usize::from(candidate.level));
        cube.scalars = [0; SCALARS];
        cube.scalars[0] = candidate.score.saturating_add(32768).clamp(0, 65535) as u16;
        cube.scalars[1] = (level.level.target_q4() >> 4) as u16;
        cube.scalars[2] = u16::from(self.front.registered());
        let slices = self.front.slices(level);
        match self.alignment {
            Alignment::Background => compensation::compensate(&slices, None, start, cube),
            Alignment::Regressors => {
                compensation::compensate(&slices, Some(self.model.regressors()), start, cube)
            }
            Alignment::Flow => window_flow::follow(&slices, &self.pyramid.frames(), start, cube),
        }
    }

    /// The detection of a cube at the end of `path`; `score` in Q8.
    fn detection(
        &self,
        candidate: &Candidate,
        path: &Path,
        cube: &Ready<'_>,
        score: i32,
    ) -> Detection {
        let level = &self.pyramid.levels()[usize::from(candidate.level)];
        let test = |feature, threshold| self.test(feature, threshold, cube);
        let [x, y, width, height] = self.model.boxes().each_ref().map(|forest| forest.score(test));
        // Q8 cells to Q8 pixels of the frame. A centre farther than a window away is none of this window's.
        let pixels = |cells: i32| {
            let cells = i64::from(cells.clamp(-FARTHEST_CENTRE, FARTHEST_CENTRE));
            ((cells * CELL as i64 * i64::from(level.scale)) >> 16) as i32
        };
        let size = |log: i32| {
            ((i64::from(level.target_q4()) * i64::from(exp2_q16(log)) + 32768) >> 16) as i32
        };
        let (cx, cy) = path.positions[0].centre(level.scale);
        Detection {
            rect: boxed((cx + pixels(x), cy + pixels(y)), size(width), size(height)),
            score: score.saturating_mul(256),
            shifts: shifts(path, level.scale),
        }
    }
}

/// Where the slices of a path are, relative to the newest.
fn shifts(path: &Path, scale: u32) -> [Shift; SHIFTS] {
    let [(x, y), older @ ..] = path.positions.map(|position| position.centre(scale));
    older.map(|at| Shift {
        x: I28F4::from_bits((at.0 - x) >> 4),
        y: I28F4::from_bits((at.1 - y) >> 4),
    })
}
