//! One number for all detections of a flight, to compare machines by.

use crate::detector::detection::Detection;
use crc::{CRC_64_XZ, Crc, Table};

static CRC: Crc<u64, Table<1>> = Crc::<u64, Table<1>>::new(&CRC_64_XZ);

/// CRC-64/XZ of the detections of one frame after another.
///
/// A frame is the number of its detections (`u32`), then for each x, y, width, height (Q28.4), score (Q16)
/// and the shifts x, y from newest to oldest (Q28.4), all `i32` little-endian.
pub struct Digest(crc::Digest<'static, u64, Table<1>>);

impl core::fmt::Debug for Digest {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "Digest({:016x})", self.value())
    }
}

impl Default for Digest {
    fn default() -> Self {
        Self(CRC.digest())
    }
}

impl Digest {
    /// Takes in the detections of the next frame.
    pub fn update(&mut self, detections: &[Detection]) {
        self.0.update(&(detections.len() as u32).to_le_bytes());
        for d in detections {
            let rect = [d.rect.x, d.rect.y, d.rect.width, d.rect.height].map(|v| v.to_bits());
            let shifts = d.shifts.iter().flat_map(|s| [s.x.to_bits(), s.y.to_bits()]);
            for v in rect.into_iter().chain([d.score]).chain(shifts) {
                self.0.update(&v.to_le_bytes());
            }
        }
    }

    /// The digest of all frames since the start.
    pub fn value(&self) -> u64 {
        self.0.clone().finalize()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn equals_the_crc_of_the_bytes_and_sees_frame_borders() {
        let detection = Detection {
            rect: Default::default(),
            score: -2,
            frame_score: -2,
            shifts: Default::default(),
        };
        let mut bytes = Vec::new();
        bytes.extend(1u32.to_le_bytes());
        bytes.extend([0; 16]);
        bytes.extend((-2i32).to_le_bytes());
        bytes.extend([0; 24]);
        bytes.extend(0u32.to_le_bytes());

        let mut first = Digest::default();
        first.update(&[detection]);
        first.update(&[]);
        assert_eq!(first.value(), CRC.checksum(&bytes));

        let mut second = Digest::default();
        second.update(&[]);
        second.update(&[detection]);
        assert_ne!(first.value(), second.value());
    }
}
