//! Independent pieces of work, on several threads where the feature `rayon` and the pool that calls allow it. The results
//! are those of one thread.

/// Whether work is divided: there are several threads.
pub fn several() -> bool {
    #[cfg(feature = "rayon")]
    return rayon::current_num_threads() > 1;
    #[cfg(not(feature = "rayon"))]
    false
}

/// Calls `work` with the number and the items of each piece of `items`, of `length` items but for the last; at the same
/// time if `parallel`. A length of 0 counts as 1.
pub fn pieces<T: Send>(
    items: &mut [T],
    length: usize,
    parallel: bool,
    work: impl Fn(usize, &mut [T]) + Sync,
) {
    #[cfg(feature = "rayon")]
    if parallel && several() {
        use rayon::prelude::*;
        let pieces = items.par_chunks_mut(length.max(1)).enumerate();
        pieces.for_each(|(number, piece)| work(number, piece));
        return;
    }
    let _ = parallel;
    for (number, piece) in items.chunks_mut(length.max(1)).enumerate() {
        work(number, piece);
    }
}

/// Does both pieces of work, at the same time if `parallel`.
pub fn both(parallel: bool, first: impl FnOnce() + Send, second: impl FnOnce() + Send) {
    #[cfg(feature = "rayon")]
    if parallel && several() {
        rayon::join(first, second);
        return;
    }
    let _ = parallel;
    first();
    second();
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;
    use std::vec::Vec;

    #[test]
    fn every_item_belongs_to_one_piece() {
        for (count, length) in [(0, 1), (1, 4), (8, 4), (10, 4), (257, 3)] {
            for parallel in [false, true] {
                let mut items = vec![0; count];
                pieces(&mut items, length, parallel, |number, piece| {
                    piece.iter_mut().enumerate().for_each(|(i, item)| *item += number * length + i);
                });
                assert_eq!(items, (0..count).collect::<Vec<_>>());
            }
        }
    }
    #[test]
    fn both_are_done() {
        for parallel in [false, true] {
            let (mut first, mut second) = (0, 0);
            both(parallel, || first = 1, || second = 2);
            assert_eq!((first, second), (1, 2));
        }
    }
}
