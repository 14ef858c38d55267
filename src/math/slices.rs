//! Parts of memory that was divided by calculation, and copies between them. All that may panic here does so for a length
//! that was calculated wrongly, in one place each.

use core::ops::Range;

/// `length` items from item `start` on. Panics if there are fewer.
#[inline(always)]
pub fn part<T>(items: &[T], start: usize, length: usize) -> &[T] {
    &items[start..][..length]
}

/// As [`part`], to write.
#[inline(always)]
pub fn part_mut<T>(items: &mut [T], start: usize, length: usize) -> &mut [T] {
    &mut items[start..][..length]
}

/// The items of a range. Panics if there are fewer.
#[inline(always)]
pub fn of<T>(items: &[T], range: Range<usize>) -> &[T] {
    part(items, range.start, range.len())
}

/// As [`of`], to write.
#[inline(always)]
pub fn of_mut<T>(items: &mut [T], range: Range<usize>) -> &mut [T] {
    part_mut(items, range.start, range.len())
}

/// The first `length` items and the rest. Panics if there are fewer.
#[inline(always)]
pub fn split<T>(items: &[T], length: usize) -> (&[T], &[T]) {
    items.split_at(length)
}

/// As [`split`], to write.
#[inline(always)]
pub fn split_mut<T>(items: &mut [T], length: usize) -> (&mut [T], &mut [T]) {
    items.split_at_mut(length)
}

/// Rows of `width` items; those of a width of 0 are of one item.
#[inline(always)]
pub fn rows<T>(items: &[T], width: usize) -> core::slice::ChunksExact<'_, T> {
    items.chunks_exact(width.max(1))
}

/// As [`rows`], to write.
#[inline(always)]
pub fn rows_mut<T>(items: &mut [T], width: usize) -> core::slice::ChunksExactMut<'_, T> {
    items.chunks_exact_mut(width.max(1))
}

/// Copies as many items as both have.
#[inline(always)]
pub fn copy<T: Copy>(from: &[T], to: &mut [T]) {
    let length = from.len().min(to.len());
    to[..length].copy_from_slice(&from[..length]);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_those_of_ranges() {
        let mut items = [0, 1, 2, 3, 4, 5, 6];
        assert_eq!((part(&items, 2, 3), of(&items, 2..5)), (&[2, 3, 4][..], &[2, 3, 4][..]));
        assert_eq!(split(&items, 1), (&[0][..], &[1, 2, 3, 4, 5, 6][..]));
        part_mut(&mut items, 1, 2).fill(9);
        of_mut(&mut items, 6..7).fill(8);
        assert_eq!(items, [0, 9, 9, 3, 4, 5, 8]);
        copy(&[7, 7], split_mut(&mut items, 6).1);
        assert_eq!(items, [0, 9, 9, 3, 4, 5, 7]);
    }

    #[test]
    fn rows_without_a_width_do_not_panic() {
        let mut items = [1, 2, 3, 4, 5];
        assert_eq!(rows(&items, 2).count(), 2);
        rows_mut(&mut items, 0).for_each(|row| row.fill(0));
        assert_eq!((items, rows(&items, 0).count()), ([0; 5], 5));
    }
}
