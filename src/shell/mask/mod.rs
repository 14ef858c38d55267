//! `lookout mask`: finds the own craft's parts, and text burnt into the picture, in a recorded flight.
//!
//! In: any source of frames in which the camera moves. Out: a picture for `camera.mask`: black where something stands still
//! against the frame while the background moves (`still.rs`).

mod still;

use super::error::Error;
use super::sources::{self, Frame};
use super::support::atomic_file;
use super::support::interrupt::{self, Ended};
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use std::path::PathBuf;
use std::string::{String, ToString};
use std::vec::Vec;
use std::{eprintln, io};
use still::Still;

/// Command-line arguments of `lookout mask`.
#[derive(Debug, Clone, clap::Args)]
pub struct MaskArgs {
    /// A recorded flight of this camera as it is mounted, a minute or more with turns: a video, a folder of pictures, a clip
    #[arg(value_name = "VIDEO")]
    input: PathBuf,
    /// Picture to write (PNG) of the frames' size: black where nothing is looked at, white elsewhere. It can be painted over
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Why a flight gives no mask.
#[derive(Debug, thiserror::Error)]
pub enum MaskError {
    /// The camera moved in too few frames.
    #[error(
        "{input}: the camera moved against the background in {moved} of {frames} frames, {needed} are needed; give a longer flight with turns"
    )]
    Still {
        /// Input with the recorded flight.
        input: String,
        /// Frames in which it moved.
        moved: u64,
        /// All frames.
        frames: u64,
        /// Frames needed.
        needed: u64,
    },
    /// More than half of the picture would be hidden.
    #[error(
        "{input}: {percent:.0} % of the picture stands still against the frame: no mask was written; give a flight in which the camera moves"
    )]
    Most {
        /// Input with the recorded flight.
        input: String,
        /// Share of the picture, percent.
        percent: f64,
    },
}

/// Runs the verb.
///
/// # Errors
/// Those of the source and of the file written; [`MaskError`].
pub fn run(args: &MaskArgs) -> Result<Ended, Error> {
    let input = || args.input.display().to_string();
    let mut source = sources::open(&args.input)?;
    let mut frame = Frame::default();
    let mut still: Option<Still> = None;
    while source.next_frame(&mut frame)? {
        if interrupt::requested() {
            return Ok(Ended::Interrupted);
        }
        still.get_or_insert_with(|| Still::new(frame.width, frame.height)).frame(frame.view());
    }
    let still = still.unwrap_or_else(|| Still::new(0, 0));
    let (frames, moved, needed) = (still.frames(), still.moved(), still::MIN_MOVED);
    if moved < needed {
        return Err(Error::verb(MaskError::Still { input: input(), moved, frames, needed }));
    }
    let (pixels, width, height) = still.mask();
    let hidden = pixels.iter().filter(|&&pixel| pixel == 0).count();
    let percent = 100.0 * hidden as f64 / pixels.len().max(1) as f64;
    if percent > 50.0 {
        return Err(Error::verb(MaskError::Most { input: input(), percent }));
    }
    let mut png = Vec::new();
    PngEncoder::new(&mut png)
        .write_image(&pixels, width as u32, height as u32, ExtendedColorType::L8)
        .map_err(io::Error::other)
        .and_then(|()| atomic_file::write(&args.out, &png))
        .map_err(Error::write(&args.out))?;
    eprintln!("{moved} of {frames} frames used; {percent:.1} % of the picture hidden");
    Ok(Ended::Complete)
}
