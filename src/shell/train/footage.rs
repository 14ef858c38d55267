//! The flights that are learned from: sampled frames with what the front end needs before each.

use super::TrainArgs;
use super::look::Look;
use super::paste::{self, Run, Turning};
use crate::channels::front_end::{FrontEnd, REACH};
use crate::channels::scale_space::Pyramid;
use crate::channels::window::SLICES;
use crate::detector::Config;
use crate::shell::error::Error;
use crate::shell::formats::clips::{self, TruthBox};
use crate::shell::pipeline::Memory;
use crate::shell::pipeline::scaled::Scaling;
use crate::shell::sources::{self, Frame};
use crate::shell::support::parallel;
use crate::shell::support::random::Random;
use crate::shell::train::TrainError;
use std::string::ToString;
use std::vec::Vec;

/// Frames before a sampled one that its cubes depend on: those of the oldest slice and of its temporal differences.
const HISTORY: usize = SLICES - 1 + REACH;

/// Sampled frames in a row that are shown with the same look.
const SEGMENT: usize = 6;

/// A clip and those of its frames that are needed.
#[derive(Debug)]
pub struct Footage {
    /// Number among all clips.
    pub number: usize,
    /// Whether it is a copy of another one with objects pasted in.
    pub pasted: bool,
    /// Whether it is kept back to decide when to stop, never trained on.
    pub held_back: bool,
    /// Numbers of the sampled frames, from 1.
    pub samples: Vec<usize>,
    /// By number less 1; empty where not needed.
    frames: Vec<Frame>,
    /// The boxes of each frame, in its pixels.
    boxes: Vec<Vec<TruthBox>>,
    /// How its camera was turned, where that is known and objects are to be pasted in.
    turning: Option<Turning>,
}

/// How deep into the past a sampled frame is computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Depth {
    /// Channels of the sampled frame only.
    Newest,
    /// Tables of all slices too, as the detector has them in flight.
    Cube,
}

/// Reads the clips of all folders and keeps about so many frames of each folder as asked for, evenly spread.
///
/// # Errors
/// [`Error`] of the first clip that cannot be read.
pub fn load(args: &TrainArgs, tick: impl Fn() + Sync) -> Result<Vec<Footage>, Error> {
    let &TrainArgs { samples, hold_back, paste, seed, .. } = args;
    let mut footage: Vec<Footage> = Vec::new();
    for folder in &args.data {
        let clips = clips::clips(folder)?;
        let frames: u64 = clips.iter().map(|c| c.ground_truth.last_frame().max(1)).sum();
        let every = (frames as usize / samples.max(1)).max(1);
        let before = footage.len();
        let numbered: Vec<_> = clips.into_iter().enumerate().collect();
        let loaded = parallel::map(numbered, |(place, clip)| {
            let held_back = is_held_back(place, hold_back);
            let footage = read(clip, every, args, before + place, held_back);
            tick();
            footage
        });
        for clip in loaded {
            footage.push(clip?);
        }
    }
    if paste > 0 {
        let pasted = pasted(&footage, paste, seed);
        if pasted.iter().all(|clip| clip.boxes.iter().flatten().all(|b| b.id < paste::FIRST_ID)) {
            let reason = "--paste needs clips with truth.csv and camera.json to paste into, and \
                 others with objects before a plain sky, of 18 pixels at least";
            return Err(TrainError::Training { reason: reason.to_string() }.into());
        }
        footage.extend(pasted);
    }
    Ok(footage)
}

/// Copies of the clips whose camera's attitude is known, with so many objects of other clips pasted in; none of those
/// held back, and nothing of them.
fn pasted(footage: &[Footage], count: usize, seed: u64) -> Vec<Footage> {
    let learned = || footage.iter().filter(|clip| !clip.held_back);
    let library = parallel::map(learned().collect(), |clip| {
        if clip.turning.is_some() { Vec::new() } else { paste::runs(&clip.frames, &clip.boxes) }
    });
    let library: Vec<Vec<Run>> = library.into_iter().filter(|runs| !runs.is_empty()).collect();
    let turned = learned().filter_map(|clip| Some((clip, clip.turning.as_ref()?)));
    parallel::map(turned.collect(), |(clip, turning)| {
        let number = footage.len() + clip.number;
        let mut random = Random::new(seed ^ (number as u64).rotate_left(24));
        let (mut frames, mut boxes) = (clip.frames.clone(), clip.boxes.clone());
        paste::paste(&mut frames, &mut boxes, turning, &library, count, &mut random);
        let samples = clip.samples.clone();
        Footage { number, pasted: true, held_back: false, samples, frames, boxes, turning: None }
    })
}

/// Whether the clip at `place` of a folder is held back: every `hold_back`th (0: none).
pub fn is_held_back(place: usize, hold_back: usize) -> bool {
    hold_back > 0 && place % hold_back == hold_back - 1
}

fn read(
    clip: clips::Clip,
    every: usize,
    args: &TrainArgs,
    number: usize,
    held_back: bool,
) -> Result<Footage, Error> {
    let mut source = sources::open(&clip.input.display().to_string())?;
    let mut footage = Footage {
        number,
        pasted: false,
        held_back,
        samples: Vec::new(),
        frames: Vec::new(),
        boxes: Vec::new(),
        turning: None,
    };
    let mut scaling = Scaling::new(args.frame, 0, 0);
    let mut frame = Frame::default();
    // Clips start at different phases, so that a folder of short clips is sampled evenly too.
    let first = HISTORY + number % every;
    while source.next_frame(&mut frame)? {
        let index = footage.frames.len();
        let next =
            if index <= first { first } else { first + (index - first).div_ceil(every) * every };
        let needed = next - index <= HISTORY;
        scaling = Scaling::new(args.frame, frame.width, frame.height);
        let mut seen = Frame::default();
        if needed {
            scaling.apply(&frame, &mut seen);
        }
        footage.frames.push(seen);
        let boxes = clip.ground_truth.frame(index as u64 + 1);
        footage.boxes.push(boxes.iter().map(|truth| scaling.truth(truth)).collect());
        if index == next {
            footage.samples.push(index + 1);
        }
    }
    if args.paste > 0 {
        footage.turning = Turning::of(&clip.directory, scaling.seen())?;
    }
    Ok(footage)
}

/// A sampled frame as the front end shows it.
#[derive(Debug)]
pub struct View<'a> {
    /// A number unlike that of every other sampled frame.
    pub number: u32,
    /// The boxes of the frame as it looks.
    pub boxes: Vec<TruthBox>,
    /// Whether objects were pasted into it.
    pub pasted: bool,
    /// Whether it is of a clip that is held back.
    pub held_back: bool,
    /// The front end after the frame.
    pub front: &'a FrontEnd,
}

/// What to show of the flights.
#[derive(Debug, Clone, Copy)]
pub struct Selection {
    /// How deep into the past to compute.
    pub depth: Depth,
    /// Every `part.1`th sampled frame of a clip, beginning with the `part.0`th.
    pub part: (usize, usize),
    /// Seed of the looks; none shows the frames as they are. Held-back clips are always shown as they are.
    pub looks: Option<u64>,
}

impl Selection {
    /// The frames of a clip that are shown.
    pub fn frames(&self, clip: &Footage) -> Vec<usize> {
        clip.samples.iter().copied().skip(self.part.0 % self.part.1).step_by(self.part.1).collect()
    }
}

/// Shows the selected frames to `work`, clips in parallel; results come in the order of clips and frames, whatever the
/// number of threads.
pub fn visit<T: Send>(
    footage: &[Footage],
    config: impl Fn(usize, usize) -> Config + Sync,
    selection: &Selection,
    tick: impl Fn() + Sync,
    work: impl Fn(&View<'_>, &Pyramid<'_>) -> Vec<T> + Sync,
) -> Vec<T> {
    let results = parallel::map(footage.iter().collect(), |clip: &Footage| {
        let mut results = Vec::new();
        for (segment, frames) in selection.frames(clip).chunks(SEGMENT).enumerate() {
            let mut look = Look::PLAIN;
            if let Some(seed) = selection.looks.filter(|_| !clip.held_back) {
                let key = (clip.number * 1024 + segment) as u64;
                look = Look::draw(&mut Random::new(seed ^ key.rotate_left(32)));
            }
            let size = &clip.frames[frames[0] - 1];
            let (width, height) = look.size(size.width, size.height);
            let config = config(width, height);
            let mut memory = Memory::new(&config);
            let bytes = memory.bytes();
            let mut front = config.front();
            let mut last = 0;
            let mut picture = Frame::default();
            for &frame in frames {
                let slices = if selection.depth == Depth::Cube { SLICES } else { 1 };
                let history = slices - 1 + REACH;
                let start = frame.saturating_sub(history).max(1);
                if last == 0 || start > last + 1 {
                    front = config.front();
                    last = start - 1;
                }
                for number in last + 1..=frame {
                    look.apply(&clip.frames[number - 1], &mut picture);
                    front.take(picture.view(), bytes);
                    // Older frames are only there to be compared with.
                    if number + slices <= frame {
                        continue;
                    }
                    front.build(picture.view(), bytes, &mut || {});
                    if number == frame {
                        let (pyramid, _) = front.pyramid(picture.view(), bytes);
                        let view = View {
                            number: (clip.number * 4096 + frame) as u32,
                            boxes: clip.boxes[frame - 1]
                                .iter()
                                .map(|truth| look.truth(truth, size.width))
                                .collect(),
                            pasted: clip.pasted,
                            held_back: clip.held_back,
                            front: &front,
                        };
                        results.extend(work(&view, &pyramid));
                    }
                }
                last = frame;
                tick();
            }
        }
        results
    });
    results.into_iter().flatten().collect()
}
