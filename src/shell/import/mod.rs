//! `lookout import`: labels in other forms, written as a folder of clips with `gt.txt`.
//!
//! In: a data set of YOLO, COCO, MOTChallenge, CVAT, Pascal VOC or Airborne Object Tracking. Each reader gives
//! [`Sequence`]s with the class names of the data set; [`ClassMap`] turns the names into ours; [`write`] links pictures
//! and videos and writes the labels. Out: `DIR/CLIP/` with `gt.txt`, the video or `frames/`, and `seqinfo.ini` where
//! rate or size are known.

mod aot;
mod classes;
mod coco;
mod cvat;
mod error;
mod mot;
mod pictures;
mod voc;
mod write;
mod xml;
mod yolo;

pub use classes::ClassMap;
pub use error::ImportError;

use super::error::Error;
use super::support::interrupt::Ended;
use clap::ValueEnum;
use std::path::{Path, PathBuf};
use std::string::String;
use std::vec::Vec;
use std::{eprintln, format};

/// Command-line arguments of `lookout import`.
#[derive(Debug, Clone, clap::Args)]
pub struct ImportArgs {
    /// Form of the labels
    #[arg(value_name = "FORM", value_enum)]
    form: LabelFormat,
    /// The data set: its top folder, or the file with the labels
    #[arg(value_name = "SRC")]
    source: PathBuf,
    /// Folder for the clips; must not hold clips of these names yet
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Table of class names: lines `NAME = drone|airplane|helicopter|bird|ignore|skip`; ignore: neither target nor false
    /// alarm, skip: as if not labelled
    #[arg(long, value_name = "MAP")]
    classes: Option<PathBuf>,
    /// Frames a second if the data set does not specify them
    #[arg(long, value_name = "FPS", value_parser = parse_rate)]
    fps: Option<f64>,
    /// Copy videos and pictures instead of linking them
    #[arg(long)]
    copy: bool,
}

/// Forms of labels that are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LabelFormat {
    /// A text file per picture with `class x y width height` relative to the picture (Ultralytics, Darknet)
    Yolo,
    /// JSON with images, annotations and categories; with `video_id` and `frame_id` (CocoVID) by video
    Coco,
    /// MOTChallenge sequences with gt/gt.txt; `lookout eval` reads them in place where the classes are ours
    Mot,
    /// XML of CVAT for video 1.1 or for images 1.1
    Cvat,
    /// Pascal VOC: an XML file per picture
    Voc,
    /// Airborne Object Tracking: ImageSets/groundtruth.json and Images/FLIGHT
    Aot,
}

/// One sequence of frames with its labels, as a data set has them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Sequence {
    /// Name, made fit for a folder when written.
    pub name: String,
    /// Where its frames are.
    pub frames: SequenceFrames,
    /// Frames a second, where known.
    pub rate: Option<f64>,
    /// Number of frames, where known.
    pub length: Option<u64>,
    /// Size of the frames in pixels, where known.
    pub size: Option<(u32, u32)>,
    /// The labels, in the order of the file.
    pub labels: Vec<LabelledBox>,
}

/// Where the frames of a sequence are.
#[derive(Debug, Clone, Default, PartialEq)]
pub enum SequenceFrames {
    /// Nowhere that was found: the clip is written with labels alone.
    #[default]
    Missing,
    /// A video.
    Video(PathBuf),
    /// Pictures in the order of frames.
    Pictures(Vec<PathBuf>),
}

/// One labelled box.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelledBox {
    /// The frame, from 1.
    pub frame: u64,
    /// Number of the object within the sequence; none where the data set follows no objects.
    pub id: Option<i64>,
    /// Left, top, width, height in pixels.
    pub rect: [f64; 4],
    /// Name of the class in the data set.
    pub class: String,
    /// Share that is seen, 0 to 1; 0: not to be evaluated.
    pub visibility: f64,
}

/// Sequences of a JSON file, or of every JSON below a folder that has the form which `of_file` reads. `of_file` gets the
/// file and the folder that pictures are relative to: for one in a folder named `labels` the folder above that, for
/// others beside them, and below a folder what `root` says.
fn of_json(
    source: &Path,
    labels: &str,
    root: impl Fn(&Path) -> PathBuf,
    of_file: impl Fn(&Path, &Path) -> Result<Vec<Sequence>, ImportError>,
) -> Result<Vec<Sequence>, ImportError> {
    if !source.is_dir() {
        let beside = source.parent().unwrap_or(Path::new(""));
        let above = beside.ends_with(labels).then(|| beside.parent()).flatten();
        return of_file(source, above.unwrap_or(beside));
    }
    let mut sequences = Vec::new();
    for path in pictures::files(source, &["json"])? {
        match of_file(&path, &root(&path)) {
            Ok(found) => sequences.extend(found),
            // JSON of another form is left out, damaged JSON is an error.
            Err(ImportError::Json { source, .. }) if source.is_data() => {}
            Err(error) => return Err(error),
        }
    }
    Ok(sequences)
}

fn parse_rate(text: &str) -> Result<f64, String> {
    let rate = text.parse::<f64>().ok().filter(|rate| (1e-3..=1e6).contains(rate));
    rate.ok_or_else(|| format!("'{text}' is not a number of frames a second"))
}

impl From<ImportError> for Error {
    fn from(error: ImportError) -> Self {
        Self::verb(error)
    }
}

/// Reads the data set and writes the clips.
///
/// # Errors
/// [`ImportError`]; nothing is written when a label cannot be read or a class is not known.
pub fn run(args: &ImportArgs) -> Result<Ended, ImportError> {
    let mut sequences = read(args.form, &args.source)?;
    if sequences.is_empty() {
        return Err(ImportError::Nothing { path: args.source.clone() });
    }
    let map = match &args.classes {
        Some(path) => ClassMap::read(path)?,
        None => ClassMap::default(),
    };
    for sequence in &mut sequences {
        sequence.rate = sequence.rate.or(args.fps);
    }
    let written = write::clips(&sequences, &map, &args.out, args.copy)?;
    for name in &written.without_frames {
        eprintln!("lookout: {name}: no frames found for it; put its video or frames/ there");
    }
    eprintln!(
        "{} clips, {} boxes ({} ignored, {} skipped) in {}",
        written.clips,
        written.boxes,
        written.ignored,
        written.skipped,
        args.out.display()
    );
    Ok(Ended::Complete)
}

/// The sequences of a data set, by name.
///
/// # Errors
/// [`ImportError`] naming the file and what is wrong in it.
pub fn read(form: LabelFormat, source: &Path) -> Result<Vec<Sequence>, ImportError> {
    let mut sequences = match form {
        LabelFormat::Yolo => yolo::read(source),
        LabelFormat::Coco => coco::read(source),
        LabelFormat::Mot => mot::read(source),
        LabelFormat::Cvat => cvat::read(source),
        LabelFormat::Voc => voc::read(source),
        LabelFormat::Aot => aot::read(source),
    }?;
    sequences.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(sequences)
}
