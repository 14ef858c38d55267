//! The flights that are learned from: sampled frames with what the front end needs before each.

use crate::cube::SLICES;
use crate::detector::Config;
use crate::front::FrontEnd;
use crate::levels::Pyramid;
use crate::shell::clips::{self, GroundTruth};
use crate::shell::error::Error;
use crate::shell::parallel;
use crate::shell::pipeline::Memory;
use crate::shell::source::{self, Frame};
use std::path::PathBuf;
use std::string::ToString;
use std::vec::Vec;

/// Frames before a sampled one that its cubes depend on: those of the oldest slice and of its temporal difference.
const HISTORY: usize = 2 * (SLICES - 1);

/// A clip and those of its frames that are needed.
#[derive(Debug)]
pub struct Footage {
    /// Its boxes.
    pub truth: GroundTruth,
    /// Whether it is kept back to decide when to stop, never trained on.
    pub held_back: bool,
    /// Numbers of the sampled frames, from 1.
    pub samples: Vec<usize>,
    /// By number less 1; empty where not needed.
    frames: Vec<Frame>,
}

/// How deep into the past a sampled frame is computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Depth {
    /// Channels of the sampled frame only.
    Newest,
    /// Tables of all slices too, as the detector has them in flight.
    Cube,
}

/// Reads the clips of `folders` and keeps about `samples` frames of each folder, evenly spread. Every `hold_back`th
/// clip of a folder is held back (0: none).
///
/// # Errors
/// [`Error`] of the first clip that cannot be read.
pub fn load(
    folders: &[PathBuf],
    samples: usize,
    hold_back: usize,
    tick: impl Fn() + Sync,
) -> Result<Vec<Footage>, Error> {
    let mut footage = Vec::new();
    for folder in folders {
        let clips = clips::clips(folder)?;
        let frames: u64 = clips.iter().map(|c| c.ground_truth.last_frame().max(1)).sum();
        let every = (frames as usize / samples.max(1)).max(1);
        let numbered: Vec<_> = clips.into_iter().enumerate().collect();
        let loaded = parallel::map(numbered, |(number, clip)| {
            let held_back = hold_back > 0 && number % hold_back == hold_back - 1;
            let footage = read(clip, every, number, held_back);
            tick();
            footage
        });
        for clip in loaded {
            footage.push(clip?);
        }
    }
    Ok(footage)
}

fn read(clip: clips::Clip, every: usize, number: usize, held_back: bool) -> Result<Footage, Error> {
    let mut source = source::open(&clip.input.display().to_string())?;
    let mut footage =
        Footage { truth: clip.ground_truth, held_back, samples: Vec::new(), frames: Vec::new() };
    let mut frame = Frame::default();
    // Clips start at different phases, so that a folder of short clips is sampled evenly too.
    let first = HISTORY + number % every;
    while source.next_frame(&mut frame)? {
        let index = footage.frames.len();
        let next =
            if index <= first { first } else { first + (index - first).div_ceil(every) * every };
        let needed = next - index <= HISTORY;
        footage.frames.push(if needed { frame.clone() } else { Frame::default() });
        if index == next {
            footage.samples.push(index + 1);
        }
    }
    Ok(footage)
}

/// A sampled frame as the front end shows it.
#[derive(Debug)]
pub struct View<'a> {
    /// The clip.
    pub footage: &'a Footage,
    /// Number of the frame, from 1.
    pub frame: usize,
    /// The front end after the frame.
    pub front: &'a FrontEnd,
}

/// Shows each sampled frame (of clips and frames that `wanted` names) to `work`, clips in parallel; results come in the
/// order of clips and frames, whatever the number of threads.
pub fn visit<T: Send>(
    footage: &[Footage],
    config: impl Fn(usize, usize) -> Config + Sync,
    depth: Depth,
    wanted: impl Fn(&Footage, usize) -> bool + Sync,
    tick: impl Fn() + Sync,
    work: impl Fn(View<'_>, &Pyramid<'_>) -> T + Sync,
) -> Vec<T> {
    let results = parallel::map(footage.iter().collect(), |clip: &Footage| {
        let mut results = Vec::new();
        let samples: Vec<usize> =
            clip.samples.iter().copied().filter(|&frame| wanted(clip, frame)).collect();
        let Some(&first) = samples.first() else { return results };
        let size = &clip.frames[first - 1];
        let config = config(size.width, size.height);
        let mut memory = Memory::new(&config);
        let (bytes, words) = memory.parts();
        let mut front = config.front();
        let mut last = 0;
        for frame in samples {
            let history = if depth == Depth::Cube { HISTORY } else { SLICES - 1 };
            let start = frame.saturating_sub(history).max(1);
            if last == 0 || start > last + 1 {
                front = config.front();
                last = start - 1;
            }
            for number in last + 1..=frame {
                let picture = clip.frames[number - 1].view();
                front.take(picture, bytes);
                if depth == Depth::Newest && number < frame {
                    continue;
                }
                front.build(picture, bytes, &mut || {});
                let mut pyramid = front.pyramid(bytes, words);
                pyramid.iter_mut().filter(|l| l.level.active).for_each(|l| front.fill_tables(l));
                if number == frame {
                    let noise = FrontEnd::noise(&pyramid);
                    for level in pyramid.iter_mut().filter(|l| l.level.active) {
                        front.fill_map(level, &noise);
                    }
                    results.push(work(View { footage: clip, frame, front: &front }, &pyramid));
                }
            }
            last = frame;
            tick();
        }
        results
    });
    results.into_iter().flatten().collect()
}
