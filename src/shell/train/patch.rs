//! Pixels of a frame that pasting changes, as runs.

use std::vec::Vec;

/// Bytes of a run's header: a run goes on over fewer unchanged pixels than that.
const RUN_HEADER: usize = 6;

/// The changes from `before` to `after`, of the same length: runs of start (`u32`), length (`u16`), both little-endian, and
/// pixels.
pub fn difference(before: &[u8], after: &[u8]) -> Vec<u8> {
    let mut patch = Vec::new();
    let mut changed = (0..before.len()).filter(|&i| before[i] != after[i]).peekable();
    while let Some(start) = changed.next() {
        let mut end = start + 1;
        while let Some(&next) = changed.peek() {
            if next - end > RUN_HEADER || next - start >= usize::from(u16::MAX) {
                break;
            }
            end = next + 1;
            changed.next();
        }
        patch.extend((start as u32).to_le_bytes());
        patch.extend(((end - start) as u16).to_le_bytes());
        patch.extend(&after[start..end]);
    }
    patch
}

/// Writes the runs of `patch` over `pixels`.
pub fn apply(mut patch: &[u8], pixels: &mut [u8]) {
    while let [a, b, c, d, e, f, rest @ ..] = patch {
        let start = u32::from_le_bytes([*a, *b, *c, *d]) as usize;
        let (run, next) = rest.split_at(usize::from(u16::from_le_bytes([*e, *f])));
        pixels[start..start + run.len()].copy_from_slice(run);
        patch = next;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn long_runs_are_split() {
        let (before, after) = (std::vec![0; 70_000], std::vec![1; 70_000]);
        let patch = difference(&before, &after);
        assert_eq!(patch.len(), 70_000 + 2 * RUN_HEADER);
        let mut pixels = before.clone();
        apply(&patch, &mut pixels);
        assert_eq!(pixels, after);
    }

    proptest! {
        #[test]
        fn a_patch_makes_the_one_of_the_other(
            pixels in prop::collection::vec((0..3u8, 0..3u8), 0..300),
        ) {
            let (before, after): (Vec<u8>, Vec<u8>) = pixels.into_iter().unzip();
            let patch = difference(&before, &after);
            prop_assert_eq!(patch.is_empty(), before == after);
            let mut patched = before;
            apply(&patch, &mut patched);
            prop_assert_eq!(patched, after);
        }
    }
}
