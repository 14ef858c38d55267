//! The switches of the method, as a model file stores them.

use crate::channels::history::History;

/// Parts of the detector that a model is trained with; stored in the model file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Method {
    /// Older frames are aligned to the newest one by the background's motion.
    pub registration: bool,
    /// The temporal-difference channels are filled; they are 0 otherwise.
    pub temporal: bool,
    /// Alignment of the older slices of a st-cube.
    pub alignment: Alignment,
    /// Proposals are classified by their st-cube; without it the score of the scan is kept.
    pub stcube: bool,
    /// Scores are averaged with those of the previous frame ([`crate::detector::temporal_score`]).
    pub persistence: bool,
    /// Pyramid levels per octave, 1 to 4.
    pub scales_per_octave: u8,
    /// Frames that are kept.
    pub history: History,
}

impl Method {
    /// The bytes in the file: from the lowest bit registration, temporal, alignment (2 bits), and a bit each for a cube
    /// and a persistence that are *not* there; scales per octave; history.
    pub const fn encode(&self) -> [u8; 3] {
        let parts = self.registration as u8
            | (self.temporal as u8) << 1
            | (self.alignment as u8) << 2
            | (!self.stcube as u8) << 4
            | (!self.persistence as u8) << 5;
        [parts, self.scales_per_octave, self.history as u8]
    }

    /// Reads what [`Method::encode`] gives.
    pub const fn decode(bytes: [u8; 3]) -> Option<Self> {
        let [parts, scales_per_octave, history] = bytes;
        if parts > 63 || scales_per_octave == 0 || scales_per_octave > 4 {
            return None;
        }
        let Some(alignment) = Alignment::decode(parts >> 2 & 3) else { return None };
        let Some(history) = History::decode(history) else { return None };
        Some(Self {
            registration: parts & 1 != 0,
            temporal: parts & 2 != 0,
            alignment,
            stcube: parts & 16 == 0,
            persistence: parts & 32 == 0,
            scales_per_octave,
            history,
        })
    }

    /// Reads the header of a model file; `None` if it has none. Usable in constants, where the size of static memory
    /// depends on it; the whole file is checked by [`crate::model::Model::parse`].
    pub const fn of_header(file: &[u8]) -> Option<Self> {
        if file.len() < 28 { None } else { Self::decode([file[25], file[26], file[27]]) }
    }

    /// Whether a model trained with `self` can run with `other`. Parts may be switched off, never on, and slices may stay
    /// with the background; history and scales must be the same.
    pub const fn allows(&self, other: &Self) -> bool {
        let aligned = matches!(other.alignment, Alignment::Background)
            || self.alignment as u8 == other.alignment as u8;
        aligned
            && self.history as u8 == other.history as u8
            && self.scales_per_octave == other.scales_per_octave
            && (self.registration || !other.registration)
            && (self.temporal || !other.temporal)
            && (self.stcube || !other.stcube)
            && (self.persistence || !other.persistence)
    }
}

/// Alignment of the older slices of a st-cube to the newest one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Alignment {
    /// By the background's motion: every slice shows the same place of the scene.
    Background = 0,
    /// By Algorithm 1 of the paper: every slice shows the object in its middle.
    Regressors = 1,
    /// By the optical flow of the window (feature `std` only): the paper's comparison in section 4.2.
    Flow = 2,
}

impl Alignment {
    /// Reads the number that stands in a model file.
    pub const fn decode(number: u8) -> Option<Self> {
        match number {
            0 => Some(Self::Background),
            1 => Some(Self::Regressors),
            2 => Some(Self::Flow),
            _ => None,
        }
    }
}
