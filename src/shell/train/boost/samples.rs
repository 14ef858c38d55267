//! Training rows, each feature's values sorted into bins.

use std::vec::Vec;

/// Most edges of a feature: a bin's number is a byte.
pub const MAX_EDGES: usize = 255;

/// Why data do not make [`BinnedSamples`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SamplesError {
    /// More features than their ids can name.
    #[error("{features} features, at most 65535 can be named")]
    TooManyFeatures {
        /// Features given.
        features: usize,
    },
    /// A feature's column has another number of rows than the rest.
    #[error("feature {feature} has {given} rows, {rows} are expected")]
    Rows {
        /// Number of the feature, from 0.
        feature: usize,
        /// Rows expected.
        rows: usize,
        /// Rows given.
        given: usize,
    },
    /// A feature's edges are not strictly ascending, or more than [`MAX_EDGES`].
    #[error("feature {feature}: edges must ascend and be at most 255")]
    Edges {
        /// Number of the feature, from 0.
        feature: usize,
    },
    /// The edges of two sets differ, so that their bins mean different values.
    #[error("the two sets of samples do not share their edges")]
    OtherEdges,
}

/// Rows of binned features, stored feature by feature.
///
/// Bin `b` of a value is the number of its feature's edges below the value, so that
/// `value > edges[k]` is the same as `bin > k`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BinnedSamples {
    rows: usize,
    edges: Vec<Vec<u16>>,
    bins: Vec<u8>,
}

impl BinnedSamples {
    /// Bins the features' columns by quantile edges of their own, at most `max_edges` (of [`MAX_EDGES`]) each.
    ///
    /// # Errors
    /// [`SamplesError`] when the columns differ in length or are too many.
    pub fn from_columns(
        columns: impl IntoIterator<Item = Vec<u16>>,
        max_edges: usize,
    ) -> Result<Self, SamplesError> {
        let mut columns = columns.into_iter().peekable();
        let mut builder = Self::builder(columns.peek().map_or(0, Vec::len), max_edges);
        columns.try_for_each(|column| builder.push(column, &[]))?;
        builder.finish()
    }

    /// Samples of `rows` rows that are binned column by column, as by [`BinnedSamples::from_columns`].
    pub fn builder(rows: usize, max_edges: usize) -> SamplesBuilder {
        let samples = Self { rows, edges: Vec::new(), bins: Vec::new() };
        SamplesBuilder { samples, max_edges }
    }

    /// Bins the features' columns of `rows` rows by given edges, one set for each column.
    ///
    /// # Errors
    /// [`SamplesError`] when the edges are not edges, or the columns are not as many or as long as they should be.
    pub fn with_edges(
        edges: Vec<Vec<u16>>,
        rows: usize,
        columns: impl IntoIterator<Item = Vec<u16>>,
    ) -> Result<Self, SamplesError> {
        let mut bins = Vec::new();
        for (feature, column) in columns.into_iter().enumerate() {
            let edges = edges.get(feature).ok_or(SamplesError::OtherEdges)?;
            push_column(&mut bins, feature, rows, &column, edges)?;
        }
        Self { rows, edges, bins }.checked()
    }

    fn checked(self) -> Result<Self, SamplesError> {
        if self.edges.len() > usize::from(u16::MAX) {
            return Err(SamplesError::TooManyFeatures { features: self.edges.len() });
        }
        let ascending = |edges: &[u16]| edges.windows(2).all(|pair| pair[0] < pair[1]);
        if let Some(feature) =
            self.edges.iter().position(|edges| edges.len() > MAX_EDGES || !ascending(edges))
        {
            return Err(SamplesError::Edges { feature });
        }
        if self.bins.len() != self.rows * self.edges.len() {
            return Err(SamplesError::OtherEdges);
        }
        Ok(self)
    }

    /// These rows followed by those of `more`.
    ///
    /// # Errors
    /// [`SamplesError::OtherEdges`] when the edges differ.
    pub fn append(&mut self, more: &Self) -> Result<(), SamplesError> {
        if self.edges != more.edges {
            return Err(SamplesError::OtherEdges);
        }
        let mut bins = Vec::with_capacity(self.bins.len() + more.bins.len());
        for feature in 0..self.features() {
            bins.extend_from_slice(self.column(feature));
            bins.extend_from_slice(more.column(feature));
        }
        (self.rows, self.bins) = (self.rows + more.rows, bins);
        Ok(())
    }

    /// Number of samples, one a row.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Features, at most 65535.
    pub fn features(&self) -> u16 {
        self.edges.len() as u16
    }

    /// The edges of each feature, ascending.
    pub fn edges(&self) -> &[Vec<u16>] {
        &self.edges
    }

    /// The bins of a feature, row by row. Panics if there is no such feature.
    pub fn column(&self, feature: u16) -> &[u8] {
        &self.bins[usize::from(feature) * self.rows..][..self.rows]
    }
}

/// Builder of [`BinnedSamples`], feature by feature.
#[derive(Debug)]
pub struct SamplesBuilder {
    samples: BinnedSamples,
    max_edges: usize,
}

impl SamplesBuilder {
    /// Adds a feature's column, with `fixed` among its edges.
    ///
    /// # Errors
    /// [`SamplesError::Rows`]; [`SamplesError::Edges`] for more fixed edges than there can be.
    pub fn push(&mut self, column: Vec<u16>, fixed: &[u16]) -> Result<(), SamplesError> {
        let BinnedSamples { rows, edges: all, bins } = &mut self.samples;
        let room = self.max_edges.min(MAX_EDGES.saturating_sub(fixed.len()));
        let mut edges = edges(&mut column.clone(), room);
        edges.extend(fixed);
        edges.sort_unstable();
        edges.dedup();
        push_column(bins, all.len(), *rows, &column, &edges)?;
        all.push(edges);
        Ok(())
    }

    /// The samples.
    ///
    /// # Errors
    /// [`SamplesError::TooManyFeatures`].
    pub fn finish(self) -> Result<BinnedSamples, SamplesError> {
        self.samples.checked()
    }
}

fn push_column(
    bins: &mut Vec<u8>,
    feature: usize,
    rows: usize,
    column: &[u16],
    edges: &[u16],
) -> Result<(), SamplesError> {
    if column.len() != rows {
        return Err(SamplesError::Rows { feature, rows, given: column.len() });
    }
    if edges.len() > MAX_EDGES {
        return Err(SamplesError::Edges { feature });
    }
    bins.extend(column.iter().map(|&value| bin(value, edges)));
    Ok(())
}

/// At most `max` (of [`MAX_EDGES`]) edges between distinct values, as near to evenly spaced quantiles as they go; sorts
/// `values`.
pub fn edges(values: &mut [u16], max: usize) -> Vec<u16> {
    values.sort_unstable();
    let max = max.min(MAX_EDGES);
    let distinct: Vec<u16> = values.chunk_by(|a, b| a == b).map(|run| run[0]).collect();
    // Half-way between neighbours, not on one of them: unseen values fall to the nearer side.
    let edge = |below: u16, above: u16| below + (above - below) / 2;
    if distinct.len() <= max + 1 {
        return distinct.windows(2).map(|pair| edge(pair[0], pair[1])).collect();
    }
    let mut edges: Vec<u16> = (1..=max)
        .map(|k| values[k * values.len() / (max + 1) - 1])
        .filter_map(|below| {
            let above = distinct.get(distinct.partition_point(|&value| value <= below))?;
            Some(edge(below, *above))
        })
        .collect();
    edges.dedup();
    edges
}

/// The number of `edges` (ascending, at most [`MAX_EDGES`]) below `value`.
pub fn bin(value: u16, edges: &[u16]) -> u8 {
    edges.partition_point(|&edge| edge < value) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec;

    #[test]
    fn edges_by_hand() {
        assert_eq!(edges(&mut [7, 1, 3, 3, 1], 4), [2, 5]);
        assert!(edges(&mut [5, 5], 4).is_empty());
        assert!(edges(&mut [], 4).is_empty());
        let mut ramp: Vec<u16> = (0..100).collect();
        assert_eq!(edges(&mut ramp, 3), [24, 49, 74]);
        assert_eq!(edges(&mut [0, u16::MAX], 9), [32767]);
    }

    #[test]
    fn mismatches_are_refused() {
        let rows = |given| SamplesError::Rows { feature: 1, rows: 2, given };
        assert_eq!(BinnedSamples::from_columns([vec![1, 2], vec![1]], 9).unwrap_err(), rows(1));
        let two = BinnedSamples::from_columns([vec![1, 2], vec![4, 9]], 9).unwrap();
        let mut one = BinnedSamples::from_columns([vec![1, 2]], 9).unwrap();
        assert_eq!(one.append(&two), Err(SamplesError::OtherEdges));
        let unsorted = BinnedSamples::with_edges(vec![vec![3, 3]], 1, [vec![1]]);
        assert_eq!(unsorted.unwrap_err(), SamplesError::Edges { feature: 0 });
        let missing = BinnedSamples::with_edges(vec![vec![3], vec![3]], 1, [vec![1]]);
        assert_eq!(missing.unwrap_err(), SamplesError::OtherEdges);
    }

    #[test]
    fn appended_rows_follow() {
        let edges = vec![vec![2, 5], vec![7]];
        let make = |a: Vec<u16>, b| {
            BinnedSamples::with_edges(edges.clone(), a.len(), [a.clone(), b]).unwrap()
        };
        let mut samples = make(vec![1, 9], vec![8, 7]);
        samples.append(&make(vec![3], vec![65535])).unwrap();
        assert_eq!(samples, make(vec![1, 9, 3], vec![8, 7, 65535]));
        assert_eq!((samples.column(0), samples.column(1)), (&[0, 2, 1][..], &[1, 0, 1][..]));
    }

    proptest! {
        #[test]
        fn bins_answer_as_values_do(
            mut values in prop::collection::vec(any::<u16>(), 0..600),
            max in 0..300usize,
            value in any::<u16>(),
        ) {
            let edges = edges(&mut values, max);
            prop_assert!(edges.len() <= max.min(MAX_EDGES));
            prop_assert!(edges.windows(2).all(|pair| pair[0] < pair[1]));
            for (k, &edge) in edges.iter().enumerate() {
                prop_assert_eq!(value > edge, usize::from(bin(value, &edges)) > k);
                prop_assert!(values[0] <= edge && edge < values[values.len() - 1]);
            }
        }
    }
}
