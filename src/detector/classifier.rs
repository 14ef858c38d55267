//! Second stage: the st-cube of a proposal is scored, and its box predicted and refined.

use crate::boxes::Fit;
use crate::channels::front_end::FrameChannels;
use crate::channels::window::Position;
use crate::channels::window::boxed;
use crate::channels::window::{SLICES, WINDOW, centre};
use crate::detector::detection::{Detection, SHIFTS, Shift};
use crate::image::Rect;
use crate::image::gradient::CELL;
use crate::math::fixed::exp2_q16;
use crate::model::{Method, Model};
use crate::scan::cascade::Candidate;
use crate::scan::window;
use crate::stcube::compensation::{self, Alignment, Trajectory};
use crate::stcube::cube::{Cube, SCALARS, Scalar};
use crate::stcube::spans::{Ready, Spans};
#[cfg(feature = "std")]
use crate::stcube::window_flow;
use core::cmp::Reverse;
use fixed::types::I28F4;

const _: () = assert!(SHIFTS == SLICES - 1);

/// Farthest that a box's centre may be from its window's, in cells, Q8.
const FARTHEST_CENTRE: i32 = (WINDOW as i32) << 8;

/// Level offsets at which a detection is re-evaluated; score and box are the mean over them. Windows to the side as well
/// gained nothing at twice the time; nor did refining the box before (AveP at IoU 0.5 / 0.3 on held-back airborne flights
/// 0.599 / 0.732 instead of 0.597 / 0.730).
const REFINE_LEVELS: [isize; 3] = [0, -1, 1];

/// A proposal and its detection.
#[derive(Debug, Clone, Copy)]
pub struct Scored {
    /// Window of the scan that the detection comes from.
    pub candidate: Candidate,
    /// Its box and score.
    pub detection: Detection,
}

impl Scored {
    /// Sort key: highest score first; ties by position, so that the order is the same on every machine.
    pub fn rank(&self) -> impl Ord + use<> {
        let Detection { rect, score, .. } = self.detection;
        (Reverse(score), rect.x, rect.y, rect.width, rect.height)
    }
}

/// Memory for one cube at a time.
#[derive(Debug)]
pub struct Workspace {
    /// St-cube of the candidate in hand; overwritten by the next one.
    pub cube: Cube,
    spans: Spans,
}

impl Workspace {
    /// A workspace that no cube was cut into yet.
    pub const fn empty() -> Self {
        Self { cube: Cube::EMPTY, spans: Spans::empty() }
    }
}

/// The classifier of st-cubes on the newest frame.
#[derive(Debug, Clone, Copy)]
pub struct CubeClassifier<'a> {
    /// Trees of the classifier and of the regressors.
    pub model: &'a Model<'a>,
    /// Parts of the method in use.
    pub method: Method,
    /// Whether Algorithm 1 follows a detection through the slices where the cube's own slices do not.
    pub trace: bool,
    /// Whether boxes are refined, where the model can.
    pub fit: bool,
    /// Channels of the newest frame.
    pub channels: FrameChannels<'a>,
}

impl CubeClassifier<'_> {
    /// Scores a proposal by its cube and predicts its box; `None` if the cascade rejects it.
    #[inline(never)]
    pub fn classify(&self, candidate: &Candidate, workspace: &mut Workspace) -> Option<Scored> {
        let Workspace { cube, spans } = workspace;
        let path = self.cut(candidate, window(candidate), cube);
        let cube = &spans.ready(cube, self.model.features());
        let test = |feature, threshold| cube.exceeds(feature, threshold);
        let score =
            if self.method.stcube { self.model.cube().cascade(test)? } else { candidate.score };
        let detection = self.detection(candidate, &path, cube, score);
        Some(Scored { candidate: *candidate, detection })
    }

    /// Re-evaluates a detection centred on its box, on the level nearest to its size and on its neighbours. Boxes are most
    /// exact for centred targets; score and box become means over the levels, then the box is refined ([`Fit::fit`]).
    #[inline(never)]
    pub fn refine(&self, judged: &mut Scored, workspace: &mut Workspace) {
        let Scored { candidate, detection } = *judged;
        let Some(level) = self.level_of(&detection.rect) else { return };
        let centred = self.reevaluate(&candidate, &detection.rect, level, workspace);
        let Some(level) = self.level_of(&centred.rect) else { return };
        let mut score = i64::from(detection.score);
        let (mut sums, mut looks) = ([0i64; 4], 0u32);
        for step in REFINE_LEVELS {
            let Some(level) = level.checked_add_signed(step) else { continue };
            if !self.channels.pyramid.levels().get(level).is_some_and(|l| l.active) {
                continue;
            }
            let again = self.reevaluate(&candidate, &centred.rect, level, workspace);
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
        let rect = self.fit().map_or(rect, |fit| fit.fit(rect, &self.channels.pyramid));
        let score = score.div_euclid(i64::from(looks) + 1) as i32;
        judged.detection = Detection { rect, score, frame_score: score, ..centred };
        if self.trace && self.method.alignment != Alignment::Regressors {
            self.trace(&mut judged.detection, &mut workspace.cube);
        }
    }

    /// The box refinement, if it is on and the model has one.
    fn fit(&self) -> Option<&Fit<'_>> {
        self.model.fit().filter(|_| self.fit)
    }

    /// Follows the object in a detection's box back through the slices by Algorithm 1: its shifts.
    fn trace(&self, detection: &mut Detection, cube: &mut Cube) {
        let Some(level) = self.level_of(&detection.rect) else { return };
        let level = &self.channels.pyramid.level(level);
        let start = Position::centred(centre(&detection.rect), level.level.scale);
        let slices = self.channels.slices(level);
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
        let levels = self.channels.pyramid.levels().iter().enumerate().filter(|(_, l)| l.active);
        levels.min_by_key(|(_, l)| distance(l.target_q4())).map(|(number, _)| number)
    }

    /// Evaluates the window at the centre of `rect` on a level.
    fn reevaluate(
        &self,
        candidate: &Candidate,
        rect: &Rect,
        level: usize,
        workspace: &mut Workspace,
    ) -> Detection {
        let at =
            Position::centred(centre(rect), self.channels.pyramid.geometry().level(level).scale);
        let candidate = Candidate { level: level as u8, ..*candidate };
        let Workspace { cube, spans } = workspace;
        let path = self.cut(&candidate, at, cube);
        let cube = &spans.ready(cube, self.model.features());
        let test = |feature, threshold| cube.exceeds(feature, threshold);
        let score =
            if self.method.stcube { self.model.cube().score(test) } else { candidate.score };
        self.detection(&candidate, &path, cube, score)
    }

    /// Cuts the cube of a candidate from the window at `start` of its level: slices aligned by [`Method::alignment`], and the
    /// scalars.
    pub fn cut(&self, candidate: &Candidate, start: Position, cube: &mut Cube) -> Trajectory {
        let level = &self.channels.pyramid.level(usize::from(candidate.level));
        cube.scalars = [0; SCALARS];
        let score = candidate.score.saturating_add(32768).clamp(0, 65535) as u16;
        cube.set(Scalar::SCAN_SCORE, score);
        cube.set(Scalar::TARGET_LENGTH, (level.level.target_q4() >> 4) as u16);
        cube.set(Scalar::REGISTERED, u16::from(self.channels.registered()));
        let slices = self.channels.slices(level);
        match self.method.alignment {
            Alignment::Background => compensation::compensate(&slices, None, start, cube),
            Alignment::Regressors => {
                compensation::compensate(&slices, Some(self.model.regressors()), start, cube)
            }
            #[cfg(feature = "std")]
            Alignment::Flow => {
                window_flow::follow(&slices, &self.channels.pyramid.frames(), start, cube)
            }
            // `Detector::new` refuses it: the comparison is no part of the firmware.
            #[cfg(not(feature = "std"))]
            Alignment::Flow => compensation::compensate(&slices, None, start, cube),
        }
    }

    /// The detection of a cube at the end of `path`; `score` in Q8.
    fn detection(
        &self,
        candidate: &Candidate,
        path: &Trajectory,
        cube: &Ready<'_>,
        score: i32,
    ) -> Detection {
        let level = self.channels.pyramid.geometry().level(usize::from(candidate.level));
        let test = |feature, threshold| cube.exceeds(feature, threshold);
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
            frame_score: score.saturating_mul(256),
            shifts: shifts(path, level.scale),
        }
    }
}

/// Positions of the older slices relative to the newest, pixels of the frame.
fn shifts(path: &Trajectory, scale: u32) -> [Shift; SHIFTS] {
    let [(x, y), older @ ..] = path.positions.map(|position| position.centre(scale));
    older.map(|at| Shift {
        x: I28F4::from_bits((at.0 - x) >> 4),
        y: I28F4::from_bits((at.1 - y) >> 4),
    })
}
