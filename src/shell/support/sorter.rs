//! Sorting of more numbers than memory should hold: sorted runs in a temporary file, merged as they are read.

use super::file_error::FileError;
use super::spool::Spool;
use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::mem;
use std::ops::{ControlFlow, Range};
use std::vec::Vec;

/// Numbers that are kept in memory; more go to the file as a sorted run.
const CAPACITY: usize = 1 << 13;

/// Runs that are merged into one as soon as there are so many: bounds those that are read at a time.
const FAN: usize = 32;

/// Numbers of a run that are read at a time.
const READ: usize = 256;

/// Bytes of a number in the file.
const BYTES: usize = 9;

/// Order of two numbers.
pub type Order = fn(f64, f64) -> Ordering;

/// A number and a mark that goes with it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Marked {
    /// Number that is sorted by.
    pub value: f64,
    /// Mark of the number.
    pub mark: bool,
}

/// Takes numbers in any order.
#[derive(Debug)]
pub struct Sorter {
    order: Order,
    memory: Vec<Marked>,
    /// Runs by the number of times that they were merged; in each the older first. Those of a higher level are older.
    levels: Vec<Vec<Range<u64>>>,
    spool: Option<Spool>,
    count: u64,
}

impl Sorter {
    /// Without numbers.
    pub const fn new(order: Order) -> Self {
        Self { order, memory: Vec::new(), levels: Vec::new(), spool: None, count: 0 }
    }

    /// Adds a number.
    ///
    /// # Errors
    /// [`FileError::Write`] of the temporary file.
    pub fn push(&mut self, value: f64, mark: bool) -> Result<(), FileError> {
        self.memory.push(Marked { value, mark });
        self.count += 1;
        if self.memory.len() < CAPACITY {
            return Ok(());
        }
        let order = self.order;
        self.memory.sort_by(|a, b| order(a.value, b.value));
        let spool = match &mut self.spool {
            Some(spool) => spool,
            none => none.insert(Spool::create(&std::env::temp_dir().join("lookout-sort"))?),
        };
        let mut run = write(spool, &self.memory)?;
        self.memory.clear();
        for level in 0.. {
            if self.levels.len() == level {
                self.levels.push(Vec::new());
            }
            let Some(runs) = self.levels.get_mut(level) else { break };
            runs.push(run);
            if runs.len() < FAN {
                break;
            }
            run = merge_into_one(spool, mem::take(runs), order)?;
        }
        Ok(())
    }

    /// All numbers in their order; equal ones in the order in which they came.
    pub fn finish(mut self) -> Sorted {
        let order = self.order;
        self.memory.sort_by(|a, b| order(a.value, b.value));
        let runs = self.levels.into_iter().rev().flatten().collect();
        Sorted { order, runs, memory: self.memory, spool: self.spool, count: self.count }
    }
}

/// Sorted numbers, to be read any number of times.
#[derive(Debug)]
pub struct Sorted {
    order: Order,
    runs: Vec<Range<u64>>,
    memory: Vec<Marked>,
    spool: Option<Spool>,
    count: u64,
}

impl Sorted {
    /// How many there are.
    pub const fn len(&self) -> u64 {
        self.count
    }

    /// Whether there is none.
    pub const fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Shows the numbers in their order until `item` ends it.
    ///
    /// # Errors
    /// [`FileError::Write`] where the temporary file cannot be read.
    pub fn each(&self, item: impl FnMut(Marked) -> ControlFlow<()>) -> Result<(), FileError> {
        let mut cursors: Vec<Cursor<'_>> = Vec::new();
        if let Some(spool) = &self.spool {
            cursors.extend(self.runs.iter().map(|run| Cursor::new(spool, run.clone())));
        }
        merge(cursors, &self.memory, self.order, item)
    }

    /// The number below which this share (0 to 1) of all lies; none of none.
    ///
    /// # Errors
    /// As [`Sorted::each`].
    pub fn quantile(&self, share: f64) -> Result<Option<f64>, FileError> {
        let mut left = (self.count.saturating_sub(1) as f64 * share).round() as u64;
        let mut found = None;
        self.each(|item| {
            if left == 0 {
                found = Some(item.value);
                return ControlFlow::Break(());
            }
            left -= 1;
            ControlFlow::Continue(())
        })?;
        Ok(found)
    }
}

/// A run as it is read.
struct Cursor<'a> {
    spool: Option<&'a Spool>,
    rest: Range<u64>,
    bytes: Vec<u8>,
    next: usize,
}

impl<'a> Cursor<'a> {
    const fn new(spool: &'a Spool, rest: Range<u64>) -> Self {
        Self { spool: Some(spool), rest, bytes: Vec::new(), next: 0 }
    }

    fn next(&mut self) -> Result<Option<Marked>, FileError> {
        if self.next == self.bytes.len() {
            let Some(spool) = self.spool.filter(|_| !self.rest.is_empty()) else {
                return Ok(None);
            };
            let end = self.rest.end.min(self.rest.start + (READ * BYTES) as u64);
            spool.read(self.rest.start..end, &mut self.bytes)?;
            (self.rest.start, self.next) = (end, 0);
        }
        let item = self.bytes.get(self.next..).and_then(<[u8]>::first_chunk::<BYTES>);
        self.next += BYTES;
        Ok(item.map(|[v @ .., mark]| Marked { value: f64::from_le_bytes(*v), mark: *mark != 0 }))
    }
}

/// The first number of a run that is not yet read; the heap gives the least, of equal ones that of the oldest run.
struct Head {
    item: Marked,
    run: usize,
    order: Order,
}

impl Ord for Head {
    fn cmp(&self, other: &Self) -> Ordering {
        (self.order)(other.item.value, self.item.value).then(other.run.cmp(&self.run))
    }
}

impl PartialOrd for Head {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Head {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Head {}

/// Shows the numbers of the runs, oldest first, and of `memory`, the youngest.
fn merge(
    mut cursors: Vec<Cursor<'_>>,
    memory: &[Marked],
    order: Order,
    mut item: impl FnMut(Marked) -> ControlFlow<()>,
) -> Result<(), FileError> {
    let mut memory = memory.iter().copied();
    let last = cursors.len();
    let mut next = |run: usize| match cursors.get_mut(run) {
        Some(cursor) => cursor.next(),
        None => Ok(memory.next()),
    };
    let mut heads = BinaryHeap::new();
    for run in 0..=last {
        heads.extend(next(run)?.map(|item| Head { item, run, order }));
    }
    while let Some(head) = heads.pop() {
        if item(head.item).is_break() {
            break;
        }
        heads.extend(next(head.run)?.map(|item| Head { item, ..head }));
    }
    Ok(())
}

fn write(spool: &Spool, items: &[Marked]) -> Result<Range<u64>, FileError> {
    let mut bytes = Vec::with_capacity(items.len() * BYTES);
    for item in items {
        bytes.extend(item.value.to_le_bytes());
        bytes.push(item.mark.into());
    }
    spool.append(&bytes)
}

/// Merges runs that follow each other into one.
fn merge_into_one(
    spool: &Spool,
    runs: Vec<Range<u64>>,
    order: Order,
) -> Result<Range<u64>, FileError> {
    let cursors = runs.into_iter().map(|run| Cursor::new(spool, run)).collect();
    let mut pieces: Option<Range<u64>> = None;
    let mut buffer = Vec::with_capacity(CAPACITY);
    let mut failed = None;
    let mut flush = |buffer: &mut Vec<Marked>| {
        let piece = write(spool, buffer)?;
        buffer.clear();
        // Nothing else is appended meanwhile: the pieces lie behind each other.
        let start = pieces.as_ref().map_or(piece.start, |pieces| pieces.start);
        pieces = Some(start..piece.end);
        Ok(())
    };
    merge(cursors, &[], order, |item| {
        buffer.push(item);
        if buffer.len() == CAPACITY
            && let Err(error) = flush(&mut buffer)
        {
            failed = Some(error);
            return ControlFlow::Break(());
        }
        ControlFlow::Continue(())
    })?;
    if let Some(error) = failed {
        return Err(error);
    }
    flush(&mut buffer)?;
    Ok(pieces.unwrap_or(0..0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shell::support::random::Random;

    /// Sorting in memory is the oracle: stable, by the order alone.
    #[test]
    fn more_than_memory_holds_is_sorted_as_in_memory() {
        let descending: Order = |a, b| b.partial_cmp(&a).unwrap_or(Ordering::Equal);
        for (count, values) in [(0, 5), (1, 5), (100, 7), (CAPACITY, 50), (70_000, 40)] {
            let mut random = Random::new(count as u64);
            let mut sorter = Sorter::new(descending);
            let mut expected = Vec::new();
            for _ in 0..count {
                let item =
                    Marked { value: random.below(values) as f64 / 8.0, mark: random.chance(0.5) };
                sorter.push(item.value, item.mark).unwrap();
                expected.push(item);
            }
            expected.sort_by(|a, b| descending(a.value, b.value));
            let sorted = sorter.finish();
            for _ in 0..2 {
                let mut found = Vec::new();
                sorted
                    .each(|item| {
                        found.push(item);
                        ControlFlow::Continue(())
                    })
                    .unwrap();
                assert_eq!(found, expected);
            }
            let at = (count.saturating_sub(1) as f64 * 0.95).round() as usize;
            assert_eq!(sorted.quantile(0.95).unwrap(), expected.get(at).map(|item| item.value));
            assert_eq!(sorted.len(), count as u64);
        }
    }

    #[test]
    fn runs_are_merged_on_several_levels() {
        let mut sorter = Sorter::new(|a, b| a.total_cmp(&b));
        let count = CAPACITY * (FAN + 3) + 5;
        for i in 0..count {
            // Every number once, in an order that is none.
            sorter.push((i * 7919 % count) as f64, false).unwrap();
        }
        assert_eq!(sorter.levels.iter().map(Vec::len).collect::<Vec<_>>(), [3, 1]);
        let mut next = 0;
        let sorted = sorter.finish();
        sorted
            .each(|item| {
                assert_eq!(item.value, f64::from(next));
                next += 1;
                ControlFlow::Continue(())
            })
            .unwrap();
        assert_eq!(next as usize, count);
    }
}
