//! Boosting as a whole.

use super::*;
use crate::trees::Forest;
use proptest::prelude::*;

/// Seeded columns of values below `limit`.
fn columns(rows: usize, features: usize, limit: u64, seed: u64) -> Vec<Vec<u16>> {
    let mut random = SplitMix64(seed);
    (0..features).map(|_| (0..rows).map(|_| (random.next() % limit) as u16).collect()).collect()
}

/// Labels of a noisy exclusive or of the first two features: no single feature separates them.
fn labels(columns: &[Vec<u16>], limit: u64) -> Vec<f32> {
    let mut random = SplitMix64(5);
    let half = (limit / 2) as u16;
    (columns[0].iter().zip(&columns[1]))
        .map(|(&a, &b)| ((a > half) != (b > half)) ^ random.next().is_multiple_of(20))
        .map(|positive| if positive { 1.0 } else { -1.0 })
        .collect()
}

fn core_scores(forest: &TrainedForest, columns: &[Vec<u16>]) -> Vec<i32> {
    let bytes = forest.encode();
    let (forest, _) = Forest::parse(&bytes).unwrap();
    (0..columns[0].len())
        .map(|row| {
            forest.score(|feature, threshold| columns[usize::from(feature)][row] > threshold)
        })
        .collect()
}

#[test]
fn recovers_a_step_function() {
    // Fewer values than edges: one edge is the step itself.
    let columns = columns(500, 3, 100, 1);
    let targets: Vec<f32> = columns[1].iter().map(|&v| if v > 30 { 4.0 } else { -2.0 }).collect();
    let samples = BinnedSamples::from_columns(columns.clone(), 128).unwrap();
    let data = Data { samples: &samples, targets: &targets, weights: &[1.0; 500] };
    let options = Options { rounds: 40, depth: 2, shrinkage: 0.3, ..Options::new(Loss::Squared) };
    let (forest, round) =
        Booster::new(options, data, None).unwrap().run(|_| ControlFlow::Continue(()));
    assert_eq!(round.trees, 40);
    assert_eq!(forest.trees()[0].nodes()[0], Node { feature: 1, threshold: 30 });
    for (score, target) in core_scores(&forest, &columns).into_iter().zip(targets) {
        assert!((f64::from(score) / 256.0 - f64::from(target)).abs() < 0.05, "{score} {target}");
    }
}

#[test]
fn learns_exclusive_or_by_both_losses() {
    let (train, other) = (columns(2000, 5, 200, 1), columns(1000, 5, 200, 9));
    let (targets, truth) = (labels(&train, 200), labels(&other, 200));
    let samples = BinnedSamples::from_columns(train, 64).unwrap();
    let data = Data { samples: &samples, targets: &targets, weights: &[1.0; 2000] };
    for loss in [Loss::Exponential, Loss::Logistic] {
        let options = Options {
            rounds: 50,
            depth: 3,
            shrinkage: 0.5,
            leaf_scale: 1024.0,
            ..Options::new(loss)
        };
        let (forest, _) =
            Booster::new(options, data, None).unwrap().run(|_| ControlFlow::Continue(()));
        let scores = core_scores(&forest, &other);
        let right = scores.iter().zip(&truth).filter(|(s, t)| (**s > 0) == (**t > 0.0)).count();
        assert!(right > 900, "{loss:?}: {right} of 1000 right, of which 5 % cannot be");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    #[test]
    fn scores_are_the_cores_and_losses_fall(
        seed in any::<u64>(),
        (limit, depth, max_edges) in (2..3000u64, 1..5u8, 1..256usize),
        loss in prop::sample::select(vec![Loss::Squared, Loss::Exponential, Loss::Logistic]),
        (row_fraction, feature_fraction, trim) in (0.5..1.0f64, 0.3..1.0f64, 0.0..0.2f64),
        full in any::<bool>(),
    ) {
        let columns = columns(200, 4, limit, seed);
        let targets = labels(&columns, limit);
        let weights: Vec<f32> = (0..200).map(|row| (row % 4) as f32).collect();
        let samples = BinnedSamples::from_columns(columns.clone(), max_edges).unwrap();
        let data = Data { samples: &samples, targets: &targets, weights: &weights };
        let mut options = Options { depth, seed, leaf_scale: 4096.0, ..Options::new(loss) };
        if !full {
            options = Options { row_fraction, feature_fraction, trim, ..options };
        }
        let mut booster = Booster::new(options, data, None).unwrap();
        let mut before = f64::INFINITY;
        for trees in 1..12 {
            let round = booster.round();
            prop_assert_eq!(round.trees, trees);
            // On all rows each step is downhill, but for the rounding of the leaves.
            prop_assert!(!full || round.train_loss <= before + 1e-4);
            before = round.train_loss;
        }
        prop_assert_eq!(booster.scores(), core_scores(booster.forest(), &columns));
        let running = booster.forest().running_scores(&samples, &[7, 3]).unwrap();
        prop_assert_eq!(running.iter().map(|s| s[10]).collect::<Vec<_>>(), [7, 3].map(|row| booster.scores()[row]));
    }
}

#[test]
fn stops_early_and_resumes_as_if_never_stopped() {
    let (a, b) = (columns(300, 6, 500, 3), columns(200, 6, 500, 4));
    let (train_targets, test_targets) = (labels(&a, 500), labels(&b, 500));
    let train = BinnedSamples::from_columns(a, 64).unwrap();
    let test = BinnedSamples::with_edges(train.edges().to_vec(), 200, b).unwrap();
    let data = Data { samples: &train, targets: &train_targets, weights: &[1.0; 300] };
    let validation = Data { samples: &test, targets: &test_targets, weights: &[1.0; 200] };
    let options = Options {
        rounds: 400,
        patience: 10,
        shrinkage: 0.5,
        row_fraction: 0.7,
        feature_fraction: 0.8,
        ..Options::new(Loss::Logistic)
    };
    let mut rounds = vec![];
    let whole = Booster::new(options, data, Some(validation)).unwrap();
    let (forest, best) = whole.run(|round| {
        rounds.push(*round);
        ControlFlow::Continue(())
    });
    assert!(rounds.len() < 400 && rounds.len() == best.trees + 10, "{} {best:?}", rounds.len());
    assert_eq!(forest.trees().len(), best.trees);
    let least =
        rounds.iter().map(|round| round.validation_loss.unwrap()).fold(f64::INFINITY, f64::min);
    assert_eq!(best.validation_loss, Some(least));

    let mut first = Booster::new(options, data, Some(validation)).unwrap();
    for _ in 0..7 {
        first.round();
    }
    let resumed = Booster::resume(options, data, Some(validation), first.forest()).unwrap();
    assert_eq!(resumed.run(|_| ControlFlow::Continue(())), (forest, best));
}

#[cfg(feature = "rayon")]
#[test]
fn any_number_of_threads_grows_the_same_forest() {
    let columns = columns(3000, 20, 900, 6);
    let targets = labels(&columns, 900);
    let samples = BinnedSamples::from_columns(columns, 128).unwrap();
    let data = Data { samples: &samples, targets: &targets, weights: &[1.0; 3000] };
    let options = Options { rounds: 8, depth: 4, ..Options::new(Loss::Exponential) };
    let forest = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let booster = Booster::new(options, data, None).unwrap();
        pool.install(|| booster.run(|_| ControlFlow::Continue(()))).0
    };
    assert_eq!(forest(1), forest(2));
    assert_eq!(forest(1), forest(5));
}

#[test]
fn a_row_of_weight_zero_takes_no_part() {
    let all = columns(400, 3, 100, 8);
    let half: Vec<Vec<u16>> = all.iter().map(|column| column[..200].to_vec()).collect();
    let targets = labels(&all, 100);
    let edges: Vec<Vec<u16>> = vec![(0..99).collect(); 3];
    let wide = BinnedSamples::with_edges(edges.clone(), 400, all).unwrap();
    let narrow = BinnedSamples::with_edges(edges, 200, half).unwrap();
    let weights: Vec<f32> = (0..400).map(|row| if row < 200 { 1.0 } else { 0.0 }).collect();
    let options = Options { rounds: 5, ..Options::new(Loss::Logistic) };
    let run = |samples, rows: usize| {
        let data = Data { samples, targets: &targets[..rows], weights: &weights[..rows] };
        Booster::new(options, data, None).unwrap().run(|_| ControlFlow::Continue(()))
    };
    assert_eq!(run(&wide, 400), run(&narrow, 200));
}

#[test]
fn constant_features_and_labels_end_in_equal_leaves() {
    let samples = BinnedSamples::from_columns([vec![7; 30]], 16).unwrap();
    let data = Data { samples: &samples, targets: &[1.0; 30], weights: &[1.0; 30] };
    for loss in [Loss::Squared, Loss::Exponential, Loss::Logistic] {
        let options = Options { rounds: 2, lambda: 0.0, ..Options::new(loss) };
        let (forest, _) =
            Booster::new(options, data, None).unwrap().run(|_| ControlFlow::Continue(()));
        for tree in forest.trees() {
            assert!(tree.nodes().iter().all(|node| *node == Node::LEFT));
            assert!(tree.leaves().iter().all(|leaf| *leaf == tree.leaves()[0]));
        }
    }
}

#[test]
fn what_cannot_be_learnt_is_refused() {
    let samples = BinnedSamples::from_columns([vec![1, 2, 3]], 16).unwrap();
    let try_new = |loss, targets: &[f32], weights: &[f32]| {
        let data = Data { samples: &samples, targets, weights };
        Booster::new(Options::new(loss), data, None).map(|_| ()).unwrap_err()
    };
    let shape = BoostError::Shape { rows: 3, features: 1, targets: 2, weights: 3 };
    assert_eq!(try_new(Loss::Squared, &[1.0; 2], &[1.0; 3]), shape);
    let target = BoostError::Target { row: 2, target: 0.5 };
    assert_eq!(try_new(Loss::Logistic, &[1.0, -1.0, 0.5], &[1.0; 3]), target);
    let weight = BoostError::Weight { row: 1, weight: -1.0 };
    assert_eq!(try_new(Loss::Squared, &[1.0; 3], &[1.0, -1.0, 1.0]), weight);
    assert_eq!(try_new(Loss::Squared, &[1.0; 3], &[0.0; 3]), BoostError::NoWeight);

    let data = Data { samples: &samples, targets: &[1.0; 3], weights: &[1.0; 3] };
    let options = Options { trim: 1.0, ..Options::new(Loss::Squared) };
    let error = Booster::new(options, data, None).unwrap_err();
    assert_eq!(error, BoostError::Option { field: "trim" });

    let other = BinnedSamples::from_columns([vec![1, 9, 30]], 16).unwrap();
    let validation = Data { samples: &other, ..data };
    let error = Booster::new(Options::new(Loss::Squared), data, Some(validation)).unwrap_err();
    assert_eq!(error, BoostError::OtherEdges);
    let options = Options {
        depth: 1,
        min_rows: 1,
        min_hessian: 0.0,
        rounds: 1,
        ..Options::new(Loss::Squared)
    };
    let rising = Data { targets: &[1.0, 2.0, 3.0], ..data };
    let (forest, _) =
        Booster::new(options, rising, None).unwrap().run(|_| ControlFlow::Continue(()));
    let error = Booster::resume(options, validation, None, &forest).unwrap_err();
    assert_eq!(error, BoostError::Forest { tree: 0, node: 0 });
}
