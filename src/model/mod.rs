//! The model file: one checked, zero-copy view of bytes.
//!
//! Little-endian. `LOOKOUT\0`, format version (`u16`), two bytes of 0, length of the file (`u32`), CRC-32 of all that
//! follows (ISO-HDLC, `u32`), the geometry that the trees were trained on (8 bytes), the lengths of the sections (`u32`
//! each), the sections. Files of another version or geometry are refused. Version 1 ended before [`Section::Calibration`],
//! version 2 before [`Section::FitFeatures`]: missing sections are read as empty.

pub mod calibration;

use crate::boxes::Fit;
pub use crate::channels::method::Method;
use crate::channels::window::{SLICES, WINDOW};
use crate::image::gradient::{CELL, ORIENTATIONS};
use crate::scan::aggregate::MAP_CHANNELS;
use crate::scan::cascade;
use crate::stcube::compensation::Regressors;
use crate::stcube::feature::Features;
use crate::trees::{Forest, ForestError};
use calibration::Calibration;

/// First bytes of a model file.
pub const MAGIC: [u8; 8] = *b"LOOKOUT\0";

/// Format version that is written. All from 1 to this one are read.
pub const VERSION: u16 = 3;

/// Sections in the order of the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Section {
    /// UTF-8 text: where the model comes from.
    Provenance,
    /// Trees of the scan.
    Scan,
    /// Features of a patch for φ_h and φ_v.
    PatchFeatures,
    /// Trees of φ_h, the horizontal shift regressor.
    Horizontal,
    /// Trees of φ_v, the vertical shift regressor.
    Vertical,
    /// Features of a cube for the trees below.
    CubeFeatures,
    /// The classifier of cubes.
    Cube,
    /// Centre of the box, horizontally.
    BoxX,
    /// Centre of the box, vertically.
    BoxY,
    /// Width of the box.
    BoxWidth,
    /// Height of the box.
    BoxHeight,
    /// Table from scores to precisions ([`calibration`]); may be empty.
    Calibration,
    /// Features of a window that is stretched to a box, for the trees below.
    FitFeatures,
    /// Centre of the object in it, horizontally.
    FitX,
    /// Centre of the object in it, vertically.
    FitY,
    /// Width of the object in it.
    FitWidth,
    /// Height of the object in it.
    FitHeight,
}

impl Section {
    /// All sections in the order of the file.
    pub const ALL: [Self; 17] = [
        Self::Provenance,
        Self::Scan,
        Self::PatchFeatures,
        Self::Horizontal,
        Self::Vertical,
        Self::CubeFeatures,
        Self::Cube,
        Self::BoxX,
        Self::BoxY,
        Self::BoxWidth,
        Self::BoxHeight,
        Self::Calibration,
        Self::FitFeatures,
        Self::FitX,
        Self::FitY,
        Self::FitWidth,
        Self::FitHeight,
    ];

    /// Sections of the box refinement: all of them are there, or all are empty.
    pub const FIT: [Self; 5] =
        [Self::FitFeatures, Self::FitX, Self::FitY, Self::FitWidth, Self::FitHeight];

    /// Sections in a file of a version.
    const fn count(version: u16) -> usize {
        match version {
            1 => Self::Calibration as usize,
            2 => Self::FitFeatures as usize,
            _ => Self::ALL.len(),
        }
    }

    const fn name(self) -> &'static str {
        match self {
            Self::Provenance => "provenance",
            Self::Scan => "scan trees",
            Self::PatchFeatures => "patch features",
            Self::Horizontal => "horizontal regressor",
            Self::Vertical => "vertical regressor",
            Self::CubeFeatures => "cube features",
            Self::Cube => "cube classifier",
            Self::BoxX => "box x regressor",
            Self::BoxY => "box y regressor",
            Self::BoxWidth => "box width regressor",
            Self::BoxHeight => "box height regressor",
            Self::Calibration => "precisions",
            Self::FitFeatures => "fit features",
            Self::FitX => "fit x regressor",
            Self::FitY => "fit y regressor",
            Self::FitWidth => "fit width regressor",
            Self::FitHeight => "fit height regressor",
        }
    }
}

/// Bytes before the sections.
pub const HEADER: usize = header(VERSION);

const fn header(version: u16) -> usize {
    28 + 4 * Section::count(version)
}

/// Compile-time geometry that a model must match: window, cell, orientations, slices, channels of the map. The [`Method`]
/// (3 bytes) follows it in the file.
pub const GEOMETRY: [u8; 5] =
    [byte(WINDOW), byte(CELL), byte(ORIENTATIONS), byte(SLICES), byte(MAP_CHANNELS)];

const fn byte(number: usize) -> u8 {
    let [low, ..] = number.to_le_bytes();
    assert!(low as usize == number);
    low
}

/// Why bytes are not a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ModelError {
    /// The first bytes are not those of a model file.
    NotAModel,
    /// The file is of another format version.
    Version {
        /// Version of the file.
        found: u16,
    },
    /// The file ends too early or has bytes behind its end.
    Length {
        /// Bytes that it should have.
        expected: usize,
        /// Bytes that it has.
        found: usize,
    },
    /// The bytes were changed since they were written.
    Checksum,
    /// The trees were trained for other windows, cells or channels.
    Geometry,
    /// The trees of a section are not valid.
    Trees {
        /// Section of the model file at fault.
        section: Section,
        /// Fault of its trees.
        error: ForestError,
    },
    /// A section's content is not valid.
    Content {
        /// Section of the model file at fault.
        section: Section,
    },
}

impl core::fmt::Display for ModelError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NotAModel => f.write_str("not a Lookout model (no LOOKOUT mark at its start)"),
            Self::Version { found } => write!(
                f,
                "model format {found}, this program reads formats 1 to {VERSION}: train anew or take a matching release"
            ),
            Self::Length { expected, found } => {
                write!(
                    f,
                    "the model has {found} bytes instead of {expected}: cut off or badly copied"
                )
            }
            Self::Checksum => f.write_str("the model's checksum is wrong: a damaged copy"),
            Self::Geometry => f.write_str(
                "the model was trained for other windows or channels than this program's",
            ),
            Self::Trees { section, error } => write!(f, "the model's {}: {error}", section.name()),
            Self::Content { section } => write!(f, "the model's {} are not valid", section.name()),
        }
    }
}

impl core::error::Error for ModelError {}

/// A checked model: evaluating it cannot fail.
///
/// ```
/// use lookout::model::{Model, ModelError};
///
/// let mut file = include_bytes!("../../models/lookout-mini.lkm").to_vec();
/// let model = Model::parse(&file)?;
/// assert!(model.scan().trees().len() > 0);
/// assert!(model.provenance().starts_with('{'));
///
/// file[1000] ^= 1;
/// assert_eq!(Model::parse(&file).unwrap_err(), ModelError::Checksum);
/// # Ok::<(), ModelError>(())
/// ```
#[derive(Debug, Clone, Copy)]
pub struct Model<'m> {
    bytes: &'m [u8],
    method: Method,
    provenance: &'m str,
    scan: Forest<'m>,
    regressors: Regressors<'m>,
    features: Features<'m>,
    cube: Forest<'m>,
    boxes: [Forest<'m>; 4],
    calibration: Calibration<'m>,
    fit: Option<Fit<'m>>,
}

/// CRC-32 of a model's bytes behind its checksum.
pub fn checksum(bytes: &[u8]) -> u32 {
    crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(bytes)
}

fn word(bytes: &[u8], at: usize) -> u32 {
    let mut word = [0; 4];
    word.copy_from_slice(&bytes[at..at + 4]);
    u32::from_le_bytes(word)
}

impl<'m> Model<'m> {
    /// Checks `bytes` once; afterwards evaluation cannot fail.
    ///
    /// # Errors
    /// [`ModelError`] with the reason.
    pub fn parse(bytes: &'m [u8]) -> Result<Self, ModelError> {
        if bytes.len() < 10 || bytes[..8] != MAGIC {
            return Err(ModelError::NotAModel);
        }
        let version = u16::from_le_bytes([bytes[8], bytes[9]]);
        if !(1..=VERSION).contains(&version) {
            return Err(ModelError::Version { found: version });
        }
        let (found, header) = (bytes.len(), header(version));
        if found < header {
            return Err(ModelError::Length { expected: header, found });
        }
        let expected = word(bytes, 12) as usize;
        if found != expected {
            return Err(ModelError::Length { expected, found });
        }
        if word(bytes, 16) != checksum(&bytes[20..]) {
            return Err(ModelError::Checksum);
        }
        let Some(method) = Method::of_header(bytes).filter(|_| bytes[20..25] == GEOMETRY) else {
            return Err(ModelError::Geometry);
        };
        let mut sections = [&[][..]; Section::ALL.len()];
        let mut rest = &bytes[header..];
        for (i, section) in sections.iter_mut().take(Section::count(version)).enumerate() {
            let length = word(bytes, 28 + 4 * i) as usize;
            let Some((head, tail)) = rest.split_at_checked(length) else {
                return Err(ModelError::Length { expected: found + length - rest.len(), found });
            };
            (*section, rest) = (head, tail);
        }
        if !rest.is_empty() {
            return Err(ModelError::Length { expected: found - rest.len(), found });
        }
        let section = |section: Section| sections[section as usize];
        let features_of =
            |of: Section| Features::parse(section(of)).ok_or(ModelError::Content { section: of });
        let forest = |of: Section, features: usize| {
            let (forest, rest) = Forest::parse(section(of))
                .map_err(|error| ModelError::Trees { section: of, error })?;
            let valid = rest.is_empty() && usize::from(forest.features()) <= features;
            if valid { Ok(forest) } else { Err(ModelError::Content { section: of }) }
        };
        let provenance = core::str::from_utf8(section(Section::Provenance))
            .map_err(|_| ModelError::Content { section: Section::Provenance })?;
        let scan = forest(Section::Scan, cascade::FEATURES)?;
        let patch = features_of(Section::PatchFeatures)?;
        if !patch.of_patch_only() {
            return Err(ModelError::Content { section: Section::PatchFeatures });
        }
        let regressors = Regressors {
            features: patch,
            horizontal: forest(Section::Horizontal, patch.len())?,
            vertical: forest(Section::Vertical, patch.len())?,
        };
        let four = |[a, b, c, d]: [Section; 4], features: usize| {
            Ok([
                forest(a, features)?,
                forest(b, features)?,
                forest(c, features)?,
                forest(d, features)?,
            ])
        };
        let features = features_of(Section::CubeFeatures)?;
        let boxes = [Section::BoxX, Section::BoxY, Section::BoxWidth, Section::BoxHeight];
        let boxes = four(boxes, features.len())?;
        let cube = forest(Section::Cube, features.len())?;
        let calibration = Calibration::parse(section(Section::Calibration))
            .ok_or(ModelError::Content { section: Section::Calibration })?;
        // Older models and those for small boards have none of these.
        let fit = if Section::FIT.iter().all(|&of| section(of).is_empty()) {
            None
        } else {
            let [of, sides @ ..] = Section::FIT;
            let features = features_of(of)?;
            if !features.of_newest_only() {
                return Err(ModelError::Content { section: of });
            }
            Some(Fit { features, sides: four(sides, features.len())? })
        };
        Ok(Self {
            bytes,
            method,
            provenance,
            scan,
            regressors,
            features,
            cube,
            boxes,
            calibration,
            fit,
        })
    }

    /// The parts of the method that it was trained with.
    pub const fn method(&self) -> Method {
        self.method
    }

    /// Bytes of the whole file, header and checksum included.
    pub fn bytes(&self) -> &'m [u8] {
        self.bytes
    }

    /// The bytes of one section.
    pub fn section(&self, section: Section) -> &'m [u8] {
        let version = u16::from_le_bytes([self.bytes[8], self.bytes[9]]);
        if section as usize >= Section::count(version) {
            return &[];
        }
        let length = |i: usize| word(self.bytes, 28 + 4 * i) as usize;
        let start = header(version) + (0..section as usize).map(length).sum::<usize>();
        &self.bytes[start..start + length(section as usize)]
    }

    /// Where the model comes from, as its trainer wrote it (JSON).
    pub fn provenance(&self) -> &'m str {
        self.provenance
    }

    /// The scan's soft cascade, over the features of [`crate::scan::cascade`].
    pub fn scan(&self) -> &Forest<'m> {
        &self.scan
    }

    /// Shift regressors φ_h and φ_v of Algorithm 1.
    pub fn regressors(&self) -> &Regressors<'m> {
        &self.regressors
    }

    /// Features of a cube.
    pub fn features(&self) -> &Features<'m> {
        &self.features
    }

    /// The classifier of cubes, over [`Model::features`].
    pub fn cube(&self) -> &Forest<'m> {
        &self.cube
    }

    /// Regressors of the box over [`Model::features`]: centre right of and below the window's in Q8 cells, binary
    /// logarithms of width and height over the nominal target's in Q8.
    pub fn boxes(&self) -> &[Forest<'m>; 4] {
        &self.boxes
    }

    /// Table from scores to precisions; without knots where none was measured.
    pub fn calibration(&self) -> &Calibration<'m> {
        &self.calibration
    }

    /// Regressors of the box from windows that are stretched to it, if there are any.
    pub fn fit(&self) -> Option<&Fit<'m>> {
        self.fit.as_ref()
    }
}
