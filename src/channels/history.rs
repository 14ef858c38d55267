//! Number and size of the frames that the front end keeps.

/// Frames that the front end keeps, and the lags of its differences.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[repr(u8)]
pub enum History {
    /// Whole frames: differences at the frame's resolution, cubes of all slices.
    #[default]
    Full = 0,
    /// Frames at half their size, for small boards: a difference for each cell of the finest level, cubes of the newest
    /// slice alone. Half the width and height are a quarter of the memory, and the newest frame itself is the caller's.
    Half = 1,
}

/// Longest lag of a difference image, in frames.
pub const FARTHEST: usize = 10;

impl History {
    /// Reads the number that stands in a model file.
    pub const fn decode(number: u8) -> Option<Self> {
        match number {
            0 => Some(Self::Full),
            1 => Some(Self::Half),
            _ => None,
        }
    }

    /// Frames back to which differences are taken: far back for objects that move slowly against the background, and a few
    /// frames, to the oldest slice of a full cube, for what moves fast.
    pub const fn lags(self) -> [usize; 2] {
        match self {
            Self::Full => [FARTHEST, 3],
            Self::Half => [8, 3],
        }
    }

    /// Halvings of a frame before its differences are taken.
    pub const fn octave(self) -> u32 {
        self as u32
    }

    /// Cells from one window of the scan to the next, across and down: every second of them on a small board.
    pub const fn stride(self) -> usize {
        match self {
            Self::Full => 1,
            Self::Half => 2,
        }
    }

    /// Whether the scan looks at the orientations of gradients. They take half of the work on its map, so that a small
    /// board leaves them to the cubes.
    pub const fn oriented(self) -> bool {
        matches!(self, Self::Full)
    }

    /// Slices of a cube that are there: the newest and older ones, of 4.
    pub const fn slices(self) -> usize {
        match self {
            Self::Full => 4,
            Self::Half => 1,
        }
    }

    /// Whole frames kept, the newest among them.
    pub const fn frames(self) -> usize {
        match self {
            Self::Full => self.lags()[0] + 1,
            Self::Half => 0,
        }
    }

    /// Halves of frames kept, the newest among them.
    pub const fn halves(self) -> usize {
        match self {
            Self::Full => self.slices(),
            Self::Half => self.lags()[0] + 1,
        }
    }

    /// Frames halved more than once that are kept, the newest among them; registration needs the last two.
    pub const fn coarse(self) -> usize {
        match self {
            Self::Full => self.slices(),
            Self::Half => 2,
        }
    }
}

/// Positions of the last frames in a ring buffer.
#[derive(Debug, Clone, Copy)]
pub struct FrameRing {
    length: usize,
    newest: usize,
}

impl FrameRing {
    /// A ring of `length` places.
    pub const fn new(length: usize) -> Self {
        Self { length, newest: 0 }
    }

    /// Makes the slot of the oldest frame that of the newest.
    pub const fn advance(&mut self) {
        self.newest = if self.newest + 1 < self.length { self.newest + 1 } else { 0 };
    }

    /// Slot of the frame `age` frames ago, 0 to `length` - 1. Panics if the ring is not that long.
    pub const fn slot(&self, age: usize) -> usize {
        assert!(age < self.length, "older than the ring is long");
        (self.newest + self.length - age) % self.length
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ring_holds_the_last_ones() {
        let mut ring = FrameRing::new(3);
        let mut kept = [0; 3];
        for number in 1..20 {
            ring.advance();
            kept[ring.slot(0)] = number;
            for age in 0..3.min(number) {
                assert_eq!(kept[ring.slot(age)], number - age);
            }
        }
    }

    #[test]
    fn every_difference_finds_its_frame() {
        for history in [History::Full, History::Half] {
            assert_eq!(History::decode(history as u8), Some(history));
            let kept = [history.frames(), history.halves()][history.octave() as usize];
            assert_eq!(kept, history.lags()[0] + 1);
            assert!(history.lags()[0] <= FARTHEST && history.halves() >= history.coarse());
            assert!(history.coarse() >= history.slices().max(2));
        }
        assert_eq!(History::decode(2), None);
    }
}
