//! The worst mistakes as pictures: the window around the box in the frames of its st-cube.

use super::breakdown::ClipTruth;
use super::methods::Detected;
use crate::channels::window::SLICES;
use crate::shell::error::Error;
use crate::shell::evaluate::matching::{self, Box4, ClipMatches, Match};
use crate::shell::formats::clips::Clip;
use crate::shell::pictures::strip as crop;
use crate::shell::pipeline::on_clips;
use crate::shell::sources::Frame;
use crate::shell::support::interrupt;
use serde::Serialize;
use std::collections::VecDeque;
use std::string::String;
use std::vec::Vec;

/// Pictures of each kind.
pub const COUNT: usize = 24;
/// Largest number of pictures of one clip, and least distance between them in frames.
pub const PER_CLIP: usize = 2;
const APART: u64 = 15;
/// A mistake and its picture.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Mistake {
    /// Name of the clip.
    pub clip: String,
    /// Its number.
    #[serde(skip)]
    pub index: usize,
    /// The frame, from 1.
    pub frame: u64,
    /// Left, top, width, height in pixels.
    pub r#box: Box4,
    /// Class of the missed target; `None` where the mistake is a false alarm.
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
pub fn misses(clips: &[Clip], matches: &[ClipMatches], truth: &[ClipTruth<'_>]) -> Vec<Mistake> {
    let mut all = Vec::new();
    for (index, (clip, (matches, truth))) in clips.iter().zip(matches.iter().zip(truth)).enumerate()
    {
        let mut missed = std::vec![true; matches.targets.len()];
        for detection in &matches.detections {
            if let Match::TruePositive(target) = detection.kind {
                missed[target] = false;
            }
        }
        let targets = matches.targets.iter().zip(truth.contrast).zip(missed);
        all.extend(targets.filter(|t| t.1).map(|((target, &contrast), _)| {
            let rect = matching::rect(&target.truth);
            let class = Some(target.truth.class.name());
            let strip = Mistake { class, ..strip(clip, index, target.frame, rect, contrast) };
            (rect[2].max(rect[3]) * contrast, strip)
        }));
    }
    worst(all)
}

/// False alarms, highest score first.
pub fn false_alarms(
    clips: &[Clip],
    matches: &[ClipMatches],
    detected: &[Detected],
) -> Vec<Mistake> {
    let mut all = Vec::new();
    for (index, (clip, (matches, detected))) in
        clips.iter().zip(matches.iter().zip(detected)).enumerate()
    {
        let alarms = matches.detections.iter().filter(|d| d.kind == Match::FalsePositive);
        all.extend(alarms.map(|alarm| {
            let found = &detected.found[alarm.index];
            let contrast = detected.contrast[alarm.index];
            let strip = strip(clip, index, found.frame, found.rect, contrast);
            (alarm.score, Mistake { score: Some(alarm.score), ..strip })
        }));
    }
    worst(all)
}

fn strip(clip: &Clip, index: usize, frame: u64, rect: Box4, contrast: f64) -> Mistake {
    Mistake {
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
fn worst(mut all: Vec<(f64, Mistake)>) -> Vec<Mistake> {
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut kept: Vec<Mistake> = Vec::new();
    for (_, strip) in all {
        if kept.len() == COUNT {
            break;
        }
        let same: Vec<&Mistake> = kept.iter().filter(|k| k.index == strip.index).collect();
        if same.len() < PER_CLIP && same.iter().all(|k| k.frame.abs_diff(strip.frame) >= APART) {
            kept.push(strip);
        }
    }
    kept
}

/// Cuts the pictures out of the clips, which are read once more up to the last frame needed; strips whose frame is behind
/// the last one go. None after Ctrl-C.
///
/// # Errors
/// Those of the sources.
pub fn cut(
    clips: &[Clip],
    jobs: usize,
    strips: Vec<Mistake>,
) -> Result<Option<Vec<Mistake>>, Error> {
    let wanted = |index: usize| strips.iter().any(|strip| strip.index == index);
    let needed: Vec<usize> = (0..clips.len()).filter(|&index| wanted(index)).collect();
    if needed.is_empty() {
        return Ok(Some(strips));
    }
    let sources: Vec<Clip> = needed.iter().map(|&index| clips[index].clone()).collect();
    let work = |i: usize, clip: &Clip| {
        let mut mine: Vec<(usize, Mistake)> =
            strips.iter().cloned().enumerate().filter(|(_, s)| s.index == needed[i]).collect();
        cut_clip(clip, &mut mine)?;
        Ok(mine)
    };
    let Some(cut) = on_clips::<_, Error, _>(&sources, jobs, &work)? else { return Ok(None) };
    let mut cut = cut.concat();
    cut.sort_by_key(|(place, _)| *place);
    Ok(Some(cut.into_iter().map(|c| c.1).filter(|strip| !strip.png.is_empty()).collect()))
}

fn cut_clip(clip: &Clip, strips: &mut [(usize, Mistake)]) -> Result<(), Error> {
    let last = strips.iter().map(|(_, strip)| strip.frame).max().unwrap_or(0);
    let mut source = clip.open()?;
    let mut frames: VecDeque<Frame> = VecDeque::new();
    for number in 1..=last {
        // The oldest frame's memory takes the new one.
        let oldest = if frames.len() == SLICES { frames.pop_front() } else { None };
        let mut frame = oldest.unwrap_or_default();
        if !source.next_frame(&mut frame)? || interrupt::requested() {
            break;
        }
        frames.push_back(frame);
        let slices: Vec<_> = frames.iter().map(|frame| (frame, [0.0; 2])).collect();
        for (_, strip) in strips.iter_mut().filter(|(_, strip)| strip.frame == number) {
            (strip.png, strip.mark) = crop::picture(&slices, &strip.r#box);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;

    #[test]
    fn few_of_a_clip_and_apart() {
        let make = |index, frame, weight: f64| {
            let strip = Mistake {
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
}
