//! Runs of Algorithm 1 from starts that are off by a known way.

use super::flow::{FlowPyramid, follow};
use crate::channels::front_end::{self, FrameChannels, REACH as BACK};
use crate::channels::scale_space::PyramidLevel;
use crate::channels::window::{Position, SLICES, WINDOW};
use crate::image::gradient::CELL;
use crate::model::Model;
use crate::registration::GlobalMotion;
use crate::shell::error::Error;
use crate::shell::evaluate::contrast::contrast;
use crate::shell::evaluate::matching::{must_be_found, rect};
use crate::shell::formats::clips::{Clip, GroundTruth, TruthBox};
use crate::shell::pipeline::on_clips;
use crate::shell::pipeline::{DetectorArgs, Memory, PipelineError};
use crate::shell::sources::Frame;
use crate::shell::support::interrupt;
use crate::shell::support::random::Random;
use crate::stcube::compensation;
use crate::stcube::cube::Cube;
use std::collections::VecDeque;
use std::vec::Vec;

/// Frames drawn in all, about.
const FRAMES: usize = 240;

/// Frames drawn of a clip.
const PER_CLIP: [usize; 2] = [2, 12];

/// Starts for each target of a frame.
const STARTS: usize = 4;

/// Seed of all draws.
pub const SEED: u64 = 1;

/// Farthest start from the target's centre, in cells either way: what the regressors are trained for.
const REACH: f64 = WINDOW as f64 / 4.0;

/// Frames before a drawn one that its slices depend on.
const HISTORY: u64 = (SLICES - 1 + BACK) as u64;

/// Ways to place the older slices: along the background's motion alone, Algorithm 1, Lucas-Kanade flow.
pub const WAYS: [&str; 3] = ["background alone", "ours", "LK"];

/// A vector in pixels of the frame.
pub type PixelVector = [f64; 2];

/// A window that started off the target's centre, by each of [`WAYS`].
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Trial {
    /// Position of the clip in the evaluated list, from 0.
    pub clip: usize,
    /// Longer side of the target, pixels.
    pub size: f64,
    /// Contrast of the target, grey levels.
    pub contrast: f64,
    /// Whether the background's motion could be measured.
    pub registered: bool,
    /// Where each way put each slice, from the target's centre in it, newest first.
    pub off: [[PixelVector; SLICES]; WAYS.len()],
    /// Moves of Algorithm 1 in each slice.
    pub moves: [u8; SLICES],
    /// Whether it came to rest there.
    pub settled: [bool; SLICES],
    /// Whether the flow was found in each slice; where not, it stays on the background.
    pub followed: [bool; SLICES],
}

/// Runs them on frames of `clips`; none after Ctrl-C. No trials for a model without regressors.
///
/// # Errors
/// Those of the sources, and of [`DetectorArgs::config`].
pub fn run(
    clips: &[Clip],
    model: &Model<'_>,
    args: &DetectorArgs,
    jobs: usize,
) -> Result<Option<Vec<Trial>>, Error> {
    if model.regressors().horizontal.trees().len() == 0 {
        return Ok(Some(Vec::new()));
    }
    let [fewest, most] = PER_CLIP;
    let count = (FRAMES / clips.len().max(1)).clamp(fewest, most);
    let work = |index: usize, clip: &Clip| {
        let mut random = Random::new(SEED ^ (index as u64 + 1).rotate_left(32));
        let frames = draw(&clip.ground_truth, count, &mut random);
        let mut trials = run_clip(clip, &frames, model, args, &mut random)?;
        trials.iter_mut().for_each(|trial| trial.clip = index);
        Ok(trials)
    };
    Ok(on_clips::<_, Error, _>(clips, jobs, &work)?.map(|trials| trials.concat()))
}

/// The target in the frames of all slices, newest first; none unless it is wholly seen in each of them.
fn track(truth: &GroundTruth, frame: u64, target: &TruthBox) -> Option<[TruthBox; SLICES]> {
    let mut track = [*target; SLICES];
    for (age, place) in track.iter_mut().enumerate() {
        let same = |t: &&TruthBox| t.id == target.id && must_be_found(t);
        *place = *truth.frame(frame.checked_sub(age as u64)?).iter().find(same)?;
    }
    Some(track)
}

/// Some frames that have such targets, in order.
fn draw(truth: &GroundTruth, count: usize, random: &mut Random) -> Vec<u64> {
    let mut frames: Vec<u64> = (1..=truth.last_frame())
        .filter(|&n| truth.frame(n).iter().any(|t| track(truth, n, t).is_some()))
        .collect();
    let count = count.min(frames.len());
    for place in 0..count {
        let other = place + random.below(frames.len() - place);
        frames.swap(place, other);
    }
    frames.truncate(count);
    frames.sort_unstable();
    frames
}

fn run_clip(
    clip: &Clip,
    drawn: &[u64],
    model: &Model<'_>,
    args: &DetectorArgs,
    random: &mut Random,
) -> Result<Vec<Trial>, Error> {
    let mut trials = Vec::new();
    let Some(&last) = drawn.last() else { return Ok(trials) };
    let mut source = clip.open()?;
    let mut first = Frame::default();
    if !source.next_frame(&mut first)? {
        return Ok(trials);
    }
    let config = args.config(model, first.width, first.height)?;
    let refused = |frame, source| PipelineError::Detector {
        input: clip.input.to_string_lossy().into_owned(),
        frame,
        source,
    };
    let mut memory = Memory::new(&config);
    let mut front_end = config.front_end(memory.bytes()).map_err(|source| refused(1, source))?;
    let mut first = Some(first);
    let mut recent: VecDeque<Frame> = VecDeque::new();
    for number in 1..=last {
        let oldest = if recent.len() == SLICES { recent.pop_back() } else { None };
        let mut frame = first.take().or(oldest).unwrap_or_default();
        if number > 1 && !source.next_frame(&mut frame)? || interrupt::requested() {
            break;
        }
        recent.push_front(frame);
        let frame = &recent[0];
        let next = drawn[drawn.partition_point(|&n| n < number)];
        if next - number > HISTORY {
            front_end.restart();
            continue;
        }
        let refused = |error: front_end::RegistrationError| refused(number, error.into());
        if next - number >= SLICES as u64 {
            front_end.skip(frame.view()).map_err(refused)?;
            continue;
        }
        let (channels, _) = front_end.process(frame.view(), &mut || {}).map_err(refused)?;
        if number == next {
            let pictures: Vec<FlowPyramid> = recent.iter().map(FlowPyramid::new).collect();
            let scene = DrawnScene { model, channels, pictures: &pictures };
            for target in clip.ground_truth.frame(number) {
                let Some(track) = track(&clip.ground_truth, number, target) else { continue };
                let contrast = contrast(frame, &rect(target));
                for _ in 0..STARTS {
                    let trial = scene.trial(&track, random);
                    trials.extend(trial.map(|trial| Trial { contrast, ..trial }));
                }
            }
        }
    }
    Ok(trials)
}

/// A drawn frame and the ones before it.
struct DrawnScene<'a> {
    model: &'a Model<'a>,
    channels: FrameChannels<'a>,
    /// Newest first.
    pictures: &'a [FlowPyramid],
}

impl DrawnScene<'_> {
    /// One start, drawn at random around the target; none if no level is searched.
    fn trial(&self, track: &[TruthBox; SLICES], random: &mut Random) -> Option<Trial> {
        let size = track[0].width.max(track[0].height);
        let level = self.channels.pyramid.level(self.level_of(size)?);
        let scale = level.level.scale;
        let cell = CELL as f64 * f64::from(scale) / 65536.0;
        let truth = track.map(|t| [t.left + t.width / 2.0, t.top + t.height / 2.0]);
        let away = [random.symmetric(), random.symmetric()].map(|v| v * REACH * cell);
        let q8 = |axis: usize| ((truth[0][axis] + away[axis]) * 256.0).round() as i32;
        let start = Position::centred((q8(0), q8(1)), scale);
        let slices = self.channels.slices(&level);
        let mut cube = Cube::EMPTY;
        let alone = compensation::compensate(&slices, None, start, &mut cube);
        let ours =
            compensation::compensate(&slices, Some(self.model.regressors()), start, &mut cube);
        let centres = |path: &compensation::Trajectory| path.positions.map(|p| p.centre(scale));
        let (followed, flow) = self.flow(&slices.motions, start.centre(scale), size);
        let places = [centres(&alone), centres(&ours), flow];
        let off = places.map(|places| {
            core::array::from_fn(|k| {
                let (x, y) = places[k];
                [f64::from(x) / 256.0 - truth[k][0], f64::from(y) / 256.0 - truth[k][1]]
            })
        });
        Some(Trial {
            size,
            registered: self.channels.registered(),
            off,
            moves: ours.slice_moves,
            settled: ours.settled,
            followed,
            ..Trial::default()
        })
    }

    /// Where the flow puts a point in each slice (Q8 pixels), and whether it was found there. From the background's
    /// motion since the slice before.
    fn flow(
        &self,
        motions: &[GlobalMotion; SLICES - 1],
        point: (i32, i32),
        size: f64,
    ) -> ([bool; SLICES], [(i32, i32); SLICES]) {
        let (mut followed, mut places) = ([true; SLICES], [point; SLICES]);
        for age in 1..SLICES {
            let (x, y) = places[age - 1];
            let (x, y) = motions[age - 1].map(x, y);
            places[age] = (x, y);
            let guess = (x - point.0, y - point.1);
            let older = self.pictures.get(age).unwrap_or(&self.pictures[self.pictures.len() - 1]);
            let found = follow(&self.pictures[0], older, point, guess, size);
            followed[age] = found.is_some();
            if let Some((dx, dy)) = found {
                places[age] = (point.0 + dx, point.1 + dy);
            }
        }
        (followed, places)
    }

    /// The searched level whose nominal target is nearest to the target in length.
    fn level_of(&self, size: f64) -> Option<usize> {
        let distance = |l: &PyramidLevel| (size / (f64::from(l.target_q4()) / 16.0)).log2().abs();
        let levels = self.channels.pyramid.levels().iter().enumerate().filter(|(_, l)| l.active);
        levels.min_by(|a, b| distance(a.1).total_cmp(&distance(b.1))).map(|(number, _)| number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::format;
    use std::path::Path;

    #[test]
    fn targets_that_are_seen_in_every_slice_are_drawn() {
        let mut text = std::string::String::new();
        for frame in (1..=9).filter(|&n| n != 5) {
            text += &format!("{frame},1,{frame},2,10,10,1,1,1\n{frame},2,50,50,10,10,1,4,1\n");
        }
        let truth = GroundTruth::parse(&text, Path::new("gt.txt")).unwrap();
        let mut random = Random::new(1);
        assert_eq!(draw(&truth, 9, &mut random), [4, 9]);
        assert!((0..9).all(|_| [[4], [9]].contains(&[draw(&truth, 1, &mut random)[0]])));
        let found = track(&truth, 9, &truth.frame(9)[0]).unwrap();
        assert_eq!(found.map(|t| t.left), [9.0, 8.0, 7.0, 6.0]);
    }
}
