//! All training clips, and copies of some with objects pasted in.

use super::footage::{Footage, is_held_back, read};
use super::listing::{self, FolderRole};
use super::paste::{self, PastedRun, Scenery};
use super::patch::difference;
use super::playback::Playback;
use super::{TrainArgs, TrainError};
use crate::shell::error::Error;
use crate::shell::evaluate::fleet::shard::Shard;
use crate::shell::sources::Frame;
use crate::shell::support::parallel;
use crate::shell::support::random::Random;
use crate::shell::support::spool::Spool;
use std::sync::Arc;
use std::vec::Vec;

/// Frames that objects are pasted into at once: those in memory meanwhile, and the longest that an object is in sight.
const SECTION: usize = 150;

/// Objects pasted into a clip without targets where `--paste` does not say how many.
const INTO_EMPTY: usize = 3;

/// Looks through the clips of all folders and samples about `--samples` frames of each folder, evenly spread; gives those of
/// `shard`. Others are looked through only where their objects are pasted into these.
///
/// # Errors
/// [`Error`] of the first clip that cannot be read.
pub fn load(
    args: &TrainArgs,
    shard: Option<Shard>,
    tick: impl Fn() + Sync,
) -> Result<Vec<Footage>, Error> {
    let own = |number: usize| shard.is_none_or(|shard| shard.holds(number));
    let pastes = args.paste > 0 || !args.empty.is_empty();
    let mut all = 0;
    let mut footage: Vec<Footage> = Vec::new();
    let mut library: Vec<Vec<PastedRun>> = Vec::new();
    for (folder, kind) in listing::folders(args) {
        let clips = listing::clips(&folder, kind)?;
        let frames = match kind {
            FolderRole::Empty => listing::frames(&clips)?,
            _ => clips.iter().map(|c| c.ground_truth.last_frame().max(1)).sum(),
        };
        let every = (frames as usize / args.samples.max(1)).max(1);
        let before = all;
        all += clips.len();
        let numbered = clips.into_iter().enumerate();
        let numbered: Vec<_> =
            numbered.filter(|(place, _)| pastes || own(before + place)).collect();
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
    let pasted = pasted(&footage, &library, args, &own)?;
    if args.paste > 0
        && shard.is_none()
        && pasted.iter().all(|clip| clip.boxes.iter().flatten().all(|b| b.id < paste::FIRST_ID))
    {
        return Err(TrainError::NothingToPaste.into());
    }
    footage.retain(|clip| own(clip.number));
    footage.extend(pasted);
    Ok(footage)
}

/// Copies of the clips that have an anchor, with objects of other clips pasted in; those of which `own` is true of the
/// number. A section's frames are in memory while
/// objects are pasted into them.
fn pasted(
    footage: &[Footage],
    library: &[Vec<PastedRun>],
    args: &TrainArgs,
    own: &dyn Fn(usize) -> bool,
) -> Result<Vec<Footage>, Error> {
    if library.is_empty() {
        return Ok(Vec::new());
    }
    let spool = Arc::new(Spool::create(&args.out)?);
    let count = if args.paste > 0 { args.paste } else { INTO_EMPTY };
    let anchored = footage.iter().filter(|clip| own(footage.len() + clip.number));
    let anchored = anchored.filter_map(|clip| Some((clip, clip.anchor.as_ref()?)));
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
