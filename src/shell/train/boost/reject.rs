//! Rejection thresholds of a soft cascade.

use crate::trees::NEVER_REJECT;
use std::collections::BTreeMap;
use std::vec;
use std::vec::Vec;

/// The reject threshold of each tree that loses at most a share `1 - keep` of the targets.
///
/// `running[i][t]` is the score of positive window `i` after tree `t`; `bags[i]` names the target it shows.
/// A target is found while one of its windows is. The targets of lowest final score are given up until a
/// share `keep` (0 to 1, rounded up to whole targets) remains; a remaining target's windows of final score at
/// least that of the worst remaining target compete, and each threshold is the highest one which leaves every
/// remaining target a window (multiple-instance pruning, Zhang and Viola, NIPS 2007; with one window a target
/// it is their direct backward pruning). Without positives nothing is rejected.
///
/// # Panics
/// If `running` and `bags` differ in length, or the scores of two windows do.
pub fn reject_thresholds(running: &[Vec<i32>], bags: &[u32], keep: f64) -> Vec<i32> {
    assert_eq!(running.len(), bags.len(), "one bag a window");
    let trees = running.first().map_or(0, Vec::len);
    assert!(running.iter().all(|scores| scores.len() == trees), "one score a tree and window");
    if trees == 0 {
        return vec![];
    }
    let mut by_bag: BTreeMap<u32, Vec<&[i32]>> = BTreeMap::new();
    for (scores, &bag) in running.iter().zip(bags) {
        by_bag.entry(bag).or_default().push(scores);
    }
    let last = |scores: &&[i32]| scores[trees - 1];
    let final_score = |windows: &Vec<&[i32]>| windows.iter().map(last).max();
    let mut bags: Vec<Vec<&[i32]>> = by_bag.into_values().collect();
    bags.sort_by_key(|windows| std::cmp::Reverse(final_score(windows)));
    bags.truncate((bags.len() as f64 * keep.clamp(0.0, 1.0)).ceil() as usize);
    let Some(lowest) = bags.last().and_then(final_score) else {
        return vec![NEVER_REJECT; trees];
    };
    for windows in &mut bags {
        windows.retain(|scores| last(scores) >= lowest);
    }
    (0..trees)
        .map(|tree| {
            let best = |windows: &Vec<&[i32]>| windows.iter().map(|scores| scores[tree]).max();
            let threshold = bags.iter().filter_map(best).min().unwrap_or(NEVER_REJECT);
            for windows in &mut bags {
                windows.retain(|scores| scores[tree] >= threshold);
            }
            threshold
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn direct_backward_pruning_by_hand() {
        let running = [vec![5, -2, 9], vec![-3, 4, 8], vec![-9, -9, 1]];
        assert_eq!(reject_thresholds(&running, &[0, 1, 2], 1.0), [-9, -9, 1]);
        assert_eq!(reject_thresholds(&running, &[0, 1, 2], 0.6), [-3, -2, 8]);
        assert_eq!(reject_thresholds(&running, &[0, 1, 2], 0.0), [NEVER_REJECT; 3]);
        assert!(reject_thresholds(&[], &[], 1.0).is_empty());
    }

    #[test]
    fn a_target_needs_one_window() {
        // The second window of target 7 carries it past the first tree, and stands alone afterwards.
        let running = [vec![-8, 9], vec![3, 6], vec![4, 5]];
        assert_eq!(reject_thresholds(&running, &[7, 7, 8], 1.0), [3, 5]);
        // A window that ends below the worst target's best does not compete.
        let running = [vec![-8, 9], vec![3, 2], vec![4, 5]];
        assert_eq!(reject_thresholds(&running, &[7, 7, 8], 1.0), [-8, 5]);
    }

    proptest! {
        #[test]
        fn keeps_the_share_and_no_threshold_can_rise(
            windows in prop::collection::vec((prop::array::uniform4(-50..50i32), 0..6u32), 1..20),
            keep in 0.0..1.0f64,
        ) {
            let (running, bags): (Vec<_>, Vec<_>) =
                windows.into_iter().map(|(scores, bag)| (scores.to_vec(), bag)).unzip();
            let found = |thresholds: &[i32]| {
                let survives = |scores: &[i32]| scores.iter().zip(thresholds).all(|(s, t)| s >= t);
                let mut found: Vec<u32> =
                    running.iter().zip(&bags).filter(|(s, _)| survives(s)).map(|(_, &b)| b).collect();
                found.sort_unstable();
                found.dedup();
                found.len()
            };
            let targets = found(&[NEVER_REJECT; 4]);
            let wanted = (targets as f64 * keep).ceil() as usize;
            let thresholds = reject_thresholds(&running, &bags, keep);
            prop_assert!(found(&thresholds) >= wanted);
            for tree in 0..4 {
                let mut raised = thresholds.clone();
                raised[tree] = raised[tree].saturating_add(1);
                prop_assert!(wanted == 0 || found(&raised) < found(&thresholds));
            }
        }
    }
}
