//! Training clips: sampled frames, ground truth, pasted objects. Frames stay in their files.

use super::TrainArgs;
use super::listing::FolderRole;
use super::paste::{Anchor, PastedRun, Runs, Turning};
use crate::channels::front_end::REACH;
use crate::channels::window::SLICES;
use crate::registration::{GlobalMotion, Registration, buffer_len};
use crate::shell::error::Error;
use crate::shell::formats::clips::{self, TruthBox};
use crate::shell::pipeline::scaled::{FrameSize, Scaling};
use crate::shell::sources::{self, Frame};
use crate::shell::support::spool::Spool;
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
    pub kind: FolderRole,
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
    /// File, folder or device that [`sources::open`] takes.
    pub input: String,
    /// Size that frames are scaled to.
    pub frame: Option<FrameSize>,
    /// Index of the first sampled frame, and frames from one to the next.
    pub(super) sampling: (usize, usize),
    /// Anchor of objects to be pasted in; none where none are.
    pub(super) anchor: Option<Anchor>,
    /// Place of the patch of each frame: the pixels that pasting changes.
    pub(super) patches: Vec<Range<u64>>,
    pub(super) spool: Option<Arc<Spool>>,
}

impl Footage {
    /// Whether a sampled frame depends on the frame at `index`, from 0.
    pub fn needs(&self, index: usize) -> bool {
        next_sample(index, self.sampling) - index <= HISTORY
    }

    /// Reads the patch of the frame at `index` (from 0), for [`super::patch::apply`]; empty without one.
    ///
    /// # Errors
    /// [`Error::Write`] when the file of patches cannot be read.
    pub fn read_patch(&self, index: usize, into: &mut Vec<u8>) -> Result<(), Error> {
        into.clear();
        match (&self.spool, self.patches.get(index)) {
            (Some(spool), Some(place)) if !place.is_empty() => Ok(spool.read(place.clone(), into)?),
            _ => Ok(()),
        }
    }
}

/// The index of the first sampled frame at or after `index`.
fn next_sample(index: usize, (first, every): (usize, usize)) -> usize {
    if index <= first { first } else { first + (index - first).div_ceil(every) * every }
}

/// Whether the clip at `place` of a folder is held back: every `hold_back`th (0: none).
pub fn is_held_back(place: usize, hold_back: usize) -> bool {
    hold_back > 0 && place % hold_back == hold_back - 1
}

/// Reads a clip once; also returns objects that can be pasted into others, if `--paste` needs them.
pub(super) fn read(
    clip: clips::Clip,
    every: usize,
    args: &TrainArgs,
    (number, held_back, kind): (usize, bool, FolderRole),
) -> Result<(Footage, Vec<PastedRun>), Error> {
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
    let pastes =
        !held_back && kind != FolderRole::Rendered && (args.paste > 0 || !args.empty.is_empty());
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
fn follow(registration: &mut Option<Registration<Vec<u8>>>, frame: Option<&Frame>) -> GlobalMotion {
    let registered = frame.and_then(|frame| {
        let Frame { width, height, .. } = *frame;
        if registration.is_none() {
            let buffer = std::vec![0; buffer_len(width, height)];
            *registration = Registration::new(width, height, buffer).ok();
        }
        registration.as_mut()?.register(frame.view()).ok()
    });
    if registered.is_none() {
        *registration = None;
    }
    registered.unwrap_or(GlobalMotion::IDENTITY)
}
