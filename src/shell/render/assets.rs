//! Pictures, cut-outs and solid models that flights are rendered from.

use super::cutout::Cutout;
use super::error::RenderError;
use super::picture::{BackgroundPicture, PictureKind};
use super::solid::Solid;
use crate::shell::formats::class::Class;
use crate::shell::formats::clips::{self, Clip};
use crate::shell::sources::{self, Frame};
use crate::shell::support::parallel;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;

/// Most frames of a cut-out object in a row.
const LONGEST: usize = 32;
/// Fewest frames of a cut-out target in a row, and of a bird.
const SHORTEST: [usize; 2] = [8, 4];
/// Most runs of a clip.
const RUNS: usize = 6;
/// Most frames of a clip that are searched for objects.
const SEARCHED: usize = 260;
/// Frames that are left out after a run, so that the next one shows the object otherwise.
const PAUSE: usize = 12;

/// An object in successive frames.
pub type CutoutRun = Vec<Cutout>;

/// Photographs, cutouts and solid models that flights are rendered from.
#[derive(Debug, Clone, Default)]
pub struct Assets {
    pub(super) pictures: Vec<BackgroundPicture>,
    /// The folder of each picture: those of one scene stand in one.
    pub(super) scenes: Vec<PathBuf>,
    /// Runs of each clip.
    pub(super) targets: Vec<Vec<CutoutRun>>,
    pub(super) birds: Vec<CutoutRun>,
    pub(super) solids: Vec<Solid>,
}

impl Assets {
    /// Reads every JPEG and PNG picture below `backgrounds` (`index.csv` there gives their kinds, where it is), cuts
    /// flying objects out of the clips of the splits `cutouts`, and reads the OBJ models of `shapes`.
    ///
    /// # Errors
    /// [`RenderError`] naming the file that cannot be read, or the folder without any picture.
    pub fn load(
        backgrounds: &Path,
        cutouts: &[PathBuf],
        shapes: Option<&Path>,
    ) -> Result<Self, RenderError> {
        let (pictures, scenes) = pictures(backgrounds)?.into_iter().unzip();
        let mut targets = Vec::new();
        let mut birds = Vec::new();
        for folder in cutouts {
            let clips = clips::clips(folder)?;
            for runs in parallel::map(clips, |clip| runs(&clip)) {
                let (flying, other): (Vec<CutoutRun>, Vec<CutoutRun>) =
                    runs?.into_iter().partition(|run| run[0].class != Class::Bird);
                if !flying.is_empty() {
                    targets.push(flying);
                }
                birds.extend(other);
            }
        }
        let solids = shapes.map_or(Ok(Vec::new()), solids)?;
        Ok(Self { pictures, scenes, targets, birds, solids })
    }

    /// The pictures of every `every`th scene and those of the others; both with all that flies. Where either would have no
    /// picture both have all.
    pub fn split(self, every: usize) -> [Self; 2] {
        let (mut number, mut last) = (0, None);
        let held_back: Vec<bool> = (self.scenes.iter())
            .map(|scene| {
                number += usize::from(last.replace(scene).is_some_and(|last| last != scene));
                every > 0 && number % every == every - 1
            })
            .collect();
        let mixed = held_back.contains(&true) && held_back.contains(&false);
        [true, false].map(|side| {
            let mut half = self.clone();
            let mut keep = held_back.iter().map(|&held_back| held_back == side || !mixed);
            half.pictures.retain(|_| keep.next().unwrap_or(true));
            half
        })
    }

    /// Number of pictures, clips with cut-out targets, runs of birds, solid models.
    pub fn counts(&self) -> [usize; 4] {
        [self.pictures.len(), self.targets.len(), self.birds.len(), self.solids.len()]
    }
}

/// All pictures below a folder and the folders they lie in, in the order of their paths.
fn pictures(folder: &Path) -> Result<Vec<(BackgroundPicture, PathBuf)>, RenderError> {
    let kinds = kinds(&folder.join("index.csv"))?;
    let mut paths = Vec::new();
    let mut open = Vec::from([folder.to_path_buf()]);
    while let Some(folder) = open.pop() {
        let failed = |source| RenderError::Read { path: folder.clone(), source };
        for entry in fs::read_dir(&folder).map_err(failed)? {
            let path = entry.map_err(failed)?.path();
            if path.is_dir() {
                open.push(path);
            } else if sources::is_picture(&path) {
                paths.push(path);
            }
        }
    }
    paths.sort();
    if paths.is_empty() {
        return Err(RenderError::NoPictures { path: folder.into() });
    }
    let read = |path: PathBuf| {
        let name = path.strip_prefix(folder).unwrap_or(&path).to_string_lossy().to_string();
        let failed = |source| RenderError::Picture { path: path.clone(), source };
        let picture = image::open(&path).map_err(failed)?.into_luma8();
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        if width < 64 || height < 64 {
            return Err(RenderError::SmallPicture { path, width, height });
        }
        let scene = path.parent().unwrap_or(folder).to_path_buf();
        Ok((
            BackgroundPicture::new(picture.into_raw(), width, height, kinds.get(&name).copied()),
            scene,
        ))
    };
    parallel::map(paths, read).into_iter().collect()
}

/// Kinds of view by file: columns `file` and `kind` of an index, where there is one.
fn kinds(index: &Path) -> Result<BTreeMap<String, PictureKind>, RenderError> {
    if !index.is_file() {
        return Ok(BTreeMap::new());
    }
    let failed = |source| RenderError::Read { path: index.into(), source };
    let text = fs::read_to_string(index).map_err(failed)?;
    let kind = |line: &str| {
        let mut fields = line.split(',');
        let (file, kind) = (fields.next()?, fields.nth(1)?);
        let kind = match kind {
            "nadir" => PictureKind::Nadir,
            "photo oblique" => PictureKind::Oblique,
            kind if kind.starts_with("pano") => PictureKind::Panorama,
            _ => PictureKind::Level,
        };
        Some((file.to_string(), kind))
    };
    Ok(text.lines().skip(1).filter_map(kind).collect())
}

/// The objects of a clip that stand before a plain sky, in runs of successive frames.
fn runs(clip: &Clip) -> Result<Vec<CutoutRun>, RenderError> {
    let mut source = sources::open(&clip.input)?;
    let mut frame = Frame::default();
    let mut runs = Vec::new();
    let is_long = |run: &CutoutRun| {
        let bird = run.first().is_some_and(|first| first.class == Class::Bird);
        run.len() >= SHORTEST[usize::from(bird)]
    };
    let mut run = CutoutRun::new();
    let (mut number, mut next) = (0, 0);
    while runs.len() < RUNS && number < SEARCHED && source.next_frame(&mut frame)? {
        number += 1;
        let object = match clip.ground_truth.frame(number as u64) {
            [one] if number >= next => Cutout::cut(&frame, one),
            _ => None,
        };
        let ended = object.is_none();
        run.extend(object);
        if run.len() == LONGEST || ended {
            let run = core::mem::take(&mut run);
            if is_long(&run) {
                next = number + PAUSE;
                runs.push(run);
            }
        }
    }
    if is_long(&run) {
        runs.push(run);
    }
    Ok(runs)
}

/// The OBJ models of a folder; class by the words of `index.csv`, drone without it.
fn solids(folder: &Path) -> Result<Vec<Solid>, RenderError> {
    let failed = |path: &Path| {
        let path = path.to_path_buf();
        move |source| RenderError::Read { path, source }
    };
    let index = fs::read_to_string(folder.join("index.csv")).unwrap_or_default();
    let class = |name: &str| {
        let line = index.lines().find(|line| line.split(',').next() == Some(name));
        let words = line.and_then(|line| line.split(',').nth(1)).unwrap_or("drone");
        if words.contains("helicopter") {
            Class::Helicopter
        } else if ["air", "glider", "ultralight", "blimp"].iter().any(|w| words.contains(w)) {
            Class::Airplane
        } else {
            Class::Drone
        }
    };
    let mut paths = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed(folder))? {
        let path = entry.map_err(failed(folder))?.path();
        if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("obj")) {
            paths.push(path);
        }
    }
    paths.sort();
    let mut solids = Vec::new();
    for path in paths {
        let text = fs::read_to_string(&path).map_err(failed(&path))?;
        let name = path.file_stem().unwrap_or_default().to_string_lossy().to_string();
        // Nothing that drifts is a target that flies.
        if name.contains("parachute") {
            continue;
        }
        let solid = Solid::parse(&text, class(&name));
        solids.push(solid.map_err(|reason| RenderError::Shape { path, reason })?);
    }
    Ok(solids)
}
