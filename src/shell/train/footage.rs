//! The clips that are learned from: sampled frames, ground truth, pasted objects. Frames stay in their files.

use super::listing::{self, Kind};
use super::paste::{self, Anchor, Run, Runs, Scenery, Turning};
use super::playback::{Playback, difference};
use super::spool::Spool;
use super::{TrainArgs, TrainError};
use crate::channels::front_end::REACH;
use crate::channels::window::SLICES;
use crate::registration::{Motion, Registration};
use crate::shell::error::Error;
use crate::shell::formats::clips::{self, TruthBox};
use crate::shell::pipeline::scaled::{FrameSize, Scaling};
use crate::shell::sources::{self, Frame};
use crate::shell::support::parallel;
use crate::shell::support::random::Random;
use std::ops::Range;
use std::string::{String, ToString};
use std::sync::Arc;
use std::vec::Vec;

/// Frames before a sampled one that its cubes depend on: those of the oldest slice and of its temporal differences.
pub const HISTORY: usize = SLICES - 1 + REACH;

/// A clip and which of its frames are sampled. Frames stay in their file.
#[derive(Debug)]
pub struct Footage {
    /// Number among all clips.
    pub number: usize,
    /// Of which folder it is.
    pub kind: Kind,
    /// Whether it is a copy of another one with objects pasted in.
    pub pasted: bool,
    /// Whether it is kept back to decide when to stop, never trained on.
    pub held_back: bool,
    /// Numbers of the sampled frames, from 1.
    pub samples: Vec<usize>,
    /// The boxes of each frame, in its pixels.
    pub boxes: Vec<Vec<TruthBox>>,
    /// Width and height of the frames as the detector sees them.
    pub size: (usize, usize),
    /// For [`sources::open`].
    pub input: String,
    /// Size that frames are scaled to.
    pub frame: Option<FrameSize>,
    /// Index of the first sampled frame, and frames from one to the next.
    sampling: (usize, usize),
    /// Anchor of objects to be pasted in; none where none are.
    anchor: Option<Anchor>,
    /// Place of the patch of each frame: the pixels that pasting changes.
    patches: Vec<Range<u64>>,
    spool: Option<Arc<Spool>>,
}

impl Footage {
    /// Whether a sampled frame depends on the frame at `index`, from 0.
    pub fn needs(&self, index: usize) -> bool {
        next_sample(index, self.sampling) - index <= HISTORY
    }

    /// Reads the patch of the frame at `index` (from 0), for [`super::playback::apply`]; empty without one.
    ///
    /// # Errors
    /// [`Error::Write`] when the file of patches cannot be read.
    pub fn read_patch(&self, index: usize, into: &mut Vec<u8>) -> Result<(), Error> {
        into.clear();
        match (&self.spool, self.patches.get(index)) {
            (Some(spool), Some(place)) if !place.is_empty() => spool.read(place.clone(), into),
            _ => Ok(()),
        }
    }
}

/// The index of the first sampled frame at or after `index`.
fn next_sample(index: usize, (first, every): (usize, usize)) -> usize {
    if index <= first { first } else { first + (index - first).div_ceil(every) * every }
}

/// Frames that objects are pasted into at once: those in memory meanwhile, and the longest that an object is in sight.
const SECTION: usize = 150;

/// Objects pasted into a clip without targets where `--paste` does not say how many.
const INTO_EMPTY: usize = 3;

/// Looks through the clips of all folders and samples about `--samples` frames of each folder, evenly spread.
///
/// # Errors
/// [`Error`] of the first clip that cannot be read.
pub fn load(args: &TrainArgs, tick: impl Fn() + Sync) -> Result<Vec<Footage>, Error> {
    let mut footage: Vec<Footage> = Vec::new();
    let mut library: Vec<Vec<Run>> = Vec::new();
    for (folder, kind) in listing::folders(args) {
        let clips = listing::clips(&folder, kind)?;
        let frames = match kind {
            Kind::Empty => listing::frames(&clips)?,
            _ => clips.iter().map(|c| c.ground_truth.last_frame().max(1)).sum(),
        };
        let every = (frames as usize / args.samples.max(1)).max(1);
        let before = footage.len();
        let numbered: Vec<_> = clips.into_iter().enumerate().collect();
        let loaded = parallel::map(numbered, |(place, clip)| {
            let held_back = is_held_back(place, args.hold_back);
            let footage = read(clip, every, args, (before + place, held_back, kind));
            tick();
            footage
        });
        for clip in loaded {
            let (clip, runs) = clip?;
            footage.push(clip);
            library.extend((!runs.is_empty()).then_some(runs));
        }
    }
    let pasted = pasted(&footage, &library, args)?;
    if args.paste > 0
        && pasted.iter().all(|clip| clip.boxes.iter().flatten().all(|b| b.id < paste::FIRST_ID))
    {
        return Err(TrainError::NothingToPaste.into());
    }
    footage.extend(pasted);
    Ok(footage)
}

/// Copies of the clips that have an anchor, with objects of other clips pasted in. A section's frames are in memory while
/// objects are pasted into them.
fn pasted(
    footage: &[Footage],
    library: &[Vec<Run>],
    args: &TrainArgs,
) -> Result<Vec<Footage>, Error> {
    if library.is_empty() {
        return Ok(Vec::new());
    }
    let spool = Arc::new(Spool::create(&args.out)?);
    let count = if args.paste > 0 { args.paste } else { INTO_EMPTY };
    let anchored = footage.iter().filter_map(|clip| Some((clip, clip.anchor.as_ref()?)));
    let pasted = parallel::map(anchored.collect(), |(clip, anchor)| {
        let number = footage.len() + clip.number;
        let mut random = Random::new(args.seed ^ (number as u64).rotate_left(24));
        let mut playback = Playback::open(clip)?;
        let mut boxes = clip.boxes.clone();
        let mut patches = Vec::new();
        for (section, boxes) in boxes.chunks_mut(SECTION).enumerate() {
            let first = section * SECTION;
            let frames: Result<Vec<Frame>, Error> = (first..first + boxes.len())
                .map(|index| playback.frame(index + 1).cloned())
                .collect();
            let frames = frames?;
            let mut changed = frames.clone();
            let scenery = Scenery { anchor, first, frames: &mut changed, boxes };
            paste::paste(scenery, library, count, &mut random);
            for (before, after) in frames.iter().zip(&changed) {
                patches.push(spool.append(&difference(&before.pixels, &after.pixels))?);
            }
        }
        Ok(Footage {
            number,
            kind: clip.kind,
            pasted: true,
            held_back: false,
            samples: clip.samples.clone(),
            boxes,
            size: clip.size,
            input: clip.input.clone(),
            frame: clip.frame,
            sampling: clip.sampling,
            anchor: None,
            patches,
            spool: Some(Arc::clone(&spool)),
        })
    });
    pasted.into_iter().collect()
}

/// Whether the clip at `place` of a folder is held back: every `hold_back`th (0: none).
pub fn is_held_back(place: usize, hold_back: usize) -> bool {
    hold_back > 0 && place % hold_back == hold_back - 1
}

/// Looks through a clip; also gives objects that can be pasted into others, if these are asked for.
fn read(
    clip: clips::Clip,
    every: usize,
    args: &TrainArgs,
    (number, held_back, kind): (usize, bool, Kind),
) -> Result<(Footage, Vec<Run>), Error> {
    let input = clip.input.display().to_string();
    let mut source = sources::open(&clip.input)?;
    let mut footage = Footage {
        number,
        kind,
        pasted: false,
        held_back,
        samples: Vec::new(),
        boxes: Vec::new(),
        size: (0, 0),
        input,
        frame: args.frame,
        // Clips start at different phases, so that a folder of short clips is sampled evenly too.
        sampling: (HISTORY + number % every, every),
        anchor: None,
        patches: Vec::new(),
        spool: None,
    };
    let mut decoded = Frame::default();
    let mut frame = Frame::default();
    let mut runs = Runs::default();
    let turned = Turning::is_known(&clip.directory)?;
    let none = clip.ground_truth.boxes().next().is_none();
    let pastes = !held_back && kind != Kind::Rendered && (args.paste > 0 || !args.empty.is_empty());
    let (cuts, follows) = (pastes && !turned && !none, pastes && !turned && none);
    let mut motions = Vec::new();
    let mut registration = None;
    while source.next_frame(&mut decoded)? {
        let index = footage.boxes.len();
        let scaling = Scaling::new(args.frame, decoded.width, decoded.height);
        footage.size = scaling.seen();
        let boxes = clip.ground_truth.frame(index as u64 + 1);
        let boxes: Vec<TruthBox> = boxes.iter().map(|truth| scaling.truth(truth)).collect();
        let needed = (cuts || follows) && footage.needs(index);
        if needed {
            scaling.apply(&decoded, &mut frame);
        }
        if cuts {
            runs.push(needed.then_some(&frame), &boxes);
        }
        if follows {
            motions.push(follow(&mut registration, needed.then_some(&frame)));
        }
        footage.boxes.push(boxes);
        if index == next_sample(index, footage.sampling) {
            footage.samples.push(index + 1);
        }
    }
    if follows {
        footage.anchor = Some(Anchor::Motion(Arc::new(motions)));
    } else if args.paste > 0 && pastes {
        let turning = Turning::of(&clip.directory, footage.size)?;
        footage.anchor = turning.map(|turning| Anchor::Attitude(Arc::new(turning)));
    }
    Ok((footage, runs.finish()))
}

/// The background's motion to the frame before; the identity where one of both is not needed.
fn follow(registration: &mut Option<(Registration, Vec<u8>)>, frame: Option<&Frame>) -> Motion {
    let Some(frame) = frame else {
        *registration = None;
        return Motion::IDENTITY;
    };
    let new = || {
        let bytes = std::vec![0; Registration::buffer_len(frame.width, frame.height)];
        (Registration::new(frame.width, frame.height), bytes)
    };
    let (registration, bytes) = registration.get_or_insert_with(new);
    registration.register(frame.view(), bytes)
}
