//! Blocks of neighbouring windows, in the operations of any instruction set.

/// Defines `rows`, which sends blocks of windows through the trees in the lanes of the instruction set that the module
/// around it describes by its operations.
macro_rules! in_lanes {
    ($feature:literal) => {
        /// Sends all windows through the trees.
        #[target_feature(enable = $feature)]
        pub fn rows(cascade: &Cascade<'_>, windows: &Windows<'_>, survivors: Survivors<'_>) {
            let (columns, rows) = windows.count;
            if columns < LANES {
                return scalar(cascade, windows, survivors);
            }
            for row in 0..rows {
                // The last block of a row begins so that it ends with the row: its first windows were in the one before.
                let mut known = 0;
                while known < columns {
                    let column = known.min(columns - LANES);
                    block(
                        cascade,
                        windows.from(column, row),
                        known - column,
                        &mut |lane, tree, score| {
                            survivors(column + lane, row, tree, score);
                        },
                    );
                    known = column + LANES;
                }
            }
        }

        /// Sends the windows from lane `first` on through the trees.
        #[inline]
        #[target_feature(enable = $feature)]
        fn block(
            cascade: &Cascade<'_>,
            bytes: &[u8],
            first: usize,
            survivors: &mut impl FnMut(usize, usize, i16),
        ) {
            // No load is behind this; the compiler knows then that all of it is there.
            let Some(last) = bytes.len().checked_sub(LANES) else { return };
            let mut alive = lanes_from(first);
            let mut sums = splat_sums(cascade.bias());
            let mut mask = 0;
            let mut tree = 0;
            let trees = cascade.trees();
            for pair in trees.chunks(2) {
                for prepared in pair {
                    // Where to go on to the left.
                    let left = |node: usize| {
                        let at = prepared.offsets[node] as usize;
                        assert!(at <= last, "a window ends within the map");
                        step(load(&bytes[at..at + LANES]), prepared, node)
                    };
                    let (a, b, c) = (left(0), left(1), left(2));
                    let (d, e, f, g) = (left(3), left(4), left(5), left(6));
                    let second = pick(a, b, c);
                    let third = pick(a, pick(b, d, e), pick(c, f, g));
                    let (low, high) = leaves(prepared, a, second, third);
                    sums = add(sums, low, high);
                    alive = and_not_below(alive, sums, prepared.reject);
                }
                tree += pair.len();
                mask = to_mask(alive);
                if mask & mask.wrapping_sub(1) == 0 {
                    break;
                }
            }
            if trees.is_empty() {
                mask = to_mask(alive);
            }
            if mask == 0 {
                return;
            }
            let sums = to_array(sums);
            while mask != 0 {
                let lane = mask.trailing_zeros() as usize;
                survivors(lane, tree, sums[lane % LANES]);
                mask &= mask - 1;
            }
        }
    };
}

pub(super) use in_lanes;
