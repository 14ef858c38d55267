//! Feature values of many windows, kept in a file until they are binned.
//!
//! 10,000 frames give about half a million cubes of 2,500 values: 2.6 GB as they are, half of that as bins. Each clip's
//! values go to the file feature by feature, in groups, and are read back group by group.

use super::TrainError;
use super::boost::BinnedSamples;
use super::cubes::TrainingRow;
use crate::shell::error::Error;
use crate::shell::support::spool::Spool;
use std::ops::Range;
use std::path::Path;
use std::vec::Vec;

/// Features that are read back together.
const GROUP: usize = 64;

/// The file that rows are packed into.
#[derive(Debug)]
pub struct RowFile {
    spool: Spool,
    features: usize,
}

/// The rows of a clip without their values, and the place of the values of each group of features.
#[derive(Debug)]
pub struct Packed {
    rows: Vec<TrainingRow>,
    groups: Vec<Range<u64>>,
}

impl RowFile {
    /// For rows of `features` values, in the folder of `beside`.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn create(beside: &Path, features: usize) -> Result<Self, Error> {
        Ok(Self { spool: Spool::create(beside)?, features })
    }

    /// Moves the values of `rows` into the file.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn pack(&self, mut rows: Vec<TrainingRow>) -> Result<Packed, Error> {
        let mut groups = Vec::new();
        let mut bytes = Vec::new();
        for first in (0..self.features).step_by(GROUP) {
            bytes.clear();
            for feature in first..self.features.min(first + GROUP) {
                bytes.extend(rows.iter().flat_map(|row| row.values[feature].to_le_bytes()));
            }
            groups.push(self.spool.append(&bytes)?);
        }
        rows.iter_mut().for_each(|row| row.values = Vec::new());
        Ok(Packed { rows, groups })
    }

    /// All rows, without their values, in the order of the clips, and their values in at most `edges` + 1 bins; the first
    /// features' bins also end at the thresholds `fixed`.
    ///
    /// # Errors
    /// [`Error::Write`] when the file cannot be read, [`TrainError::Samples`] when there are too many features.
    pub fn unpack(
        &self,
        packed: Vec<Packed>,
        edges: usize,
        fixed: &[Vec<u16>],
    ) -> Result<(Vec<TrainingRow>, BinnedSamples), Error> {
        let total: usize = packed.iter().map(|clip| clip.rows.len()).sum();
        let mut samples = BinnedSamples::builder(total, edges);
        let mut bytes: Vec<Vec<u8>> = packed.iter().map(|_| Vec::new()).collect();
        for feature in 0..self.features {
            if feature % GROUP == 0 {
                for (clip, bytes) in packed.iter().zip(&mut bytes) {
                    self.spool.read(clip.groups[feature / GROUP].clone(), bytes)?;
                }
            }
            let mut column = Vec::with_capacity(total);
            for (clip, bytes) in packed.iter().zip(&bytes) {
                let length = 2 * clip.rows.len();
                let values = &bytes[feature % GROUP * length..][..length];
                let value = |pair: &[u8]| u16::from_le_bytes([pair[0], pair[1]]);
                column.extend(values.chunks_exact(2).map(value));
            }
            samples
                .push(column, fixed.get(feature).map_or(&[], Vec::as_slice))
                .map_err(TrainError::Samples)?;
        }
        let samples = samples.finish().map_err(TrainError::Samples)?;
        Ok((packed.into_iter().flat_map(|clip| clip.rows).collect(), samples))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shell::support::random::Random;
    use std::vec;

    #[test]
    fn rows_from_the_file_are_those_from_memory() {
        let folder = tempfile::tempdir().unwrap();
        let mut random = Random::new(3);
        // More than one group, a group that is not full, and a clip without rows.
        let features = 2 * GROUP + 5;
        let clips: Vec<Vec<TrainingRow>> = [3, 0, 7]
            .iter()
            .map(|&rows| {
                let row = |number| TrainingRow {
                    values: (0..features).map(|_| random.bits() as u16).collect(),
                    label: 1.0,
                    offset: None,
                    target: number,
                    pasted: false,
                    held_back: number.is_multiple_of(2),
                };
                (0..rows).map(row).collect()
            })
            .collect();
        let all: Vec<TrainingRow> = clips.iter().flatten().cloned().collect();
        let column = |i: usize| all.iter().map(|row| row.values[i]).collect();
        let expected = BinnedSamples::from_columns((0..features).map(column), 6).unwrap();
        let file = RowFile::create(&folder.path().join("x"), features).unwrap();
        let packed: Result<Vec<Packed>, Error> = clips.into_iter().map(|r| file.pack(r)).collect();
        let (rows, samples) = file.unpack(packed.unwrap(), 6, &[]).unwrap();
        assert_eq!(samples, expected);
        let facts = |rows: &[TrainingRow]| -> Vec<(u32, bool)> {
            rows.iter().map(|row| (row.target, row.held_back)).collect()
        };
        assert_eq!(facts(&rows), facts(&all));
        let (rows, samples) = file.unpack(vec![], 6, &[]).unwrap();
        assert_eq!((rows.len(), samples.rows(), samples.features()), (0, 0, features as u16));
    }
}
