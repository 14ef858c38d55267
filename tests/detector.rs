//! The detector's promises: buffers, frames of any size, one result whatever lies around the data.

mod common;

use common::golden::{CONFIG, draw};
use common::{METHOD, keen_model, look, memory, model, trained_with, watch};
use lookout::detector::{
    Buffers, Config, Detections, Detector, Error, History, MAX_CANDIDATES, MAX_DETECTIONS,
    MAX_GAP_US, MAX_SIDE,
};
use lookout::image::Image;
use lookout::model::{Method, Model};
use lookout::stcube::compensation::Alignment;
use proptest::prelude::*;

#[test]
fn too_small_buffers_say_what_is_needed() {
    let file = model();
    let model = Model::parse(&file).unwrap();
    let (mut bytes, mut words) = memory(&CONFIG, 0);
    let (all_bytes, all_words) = (bytes.len(), words.len());
    for (less_bytes, less_words, needed) in
        [(1, 0, all_bytes), (0, 1, all_words), (1, 1, all_bytes)]
    {
        let buffers = Buffers {
            bytes: &mut bytes[..all_bytes - less_bytes],
            words: &mut words[..all_words - less_words],
        };
        let error = Detector::new(&model, CONFIG, buffers).unwrap_err();
        assert_eq!(error, Error::BufferTooSmall { needed });
        assert!(error.to_string().contains(&needed.to_string()));
    }
}

#[test]
fn a_frame_of_another_size_changes_nothing() {
    let file = model();
    let parsed = Model::parse(&file).unwrap();
    let (mut bytes, mut words) = memory(&CONFIG, 0);
    let buffers = Buffers { bytes: &mut bytes, words: &mut words };
    let mut detector = Detector::new(&parsed, CONFIG, buffers).unwrap();
    let mut found = look(&mut detector, CONFIG, 0, 4);
    let pixels = vec![77; CONFIG.width * CONFIG.height];
    for (width, height) in [(CONFIG.height, CONFIG.width), (CONFIG.width, 1), (0, 0)] {
        let frame = Image::packed(&pixels, width, height).unwrap();
        let mut untouched = found[0].clone();
        let error = detector.process(frame, 0, &mut untouched).unwrap_err();
        assert_eq!(untouched, found[0]);
        assert_eq!(error, Error::FrameSize { width, height });
    }
    found.extend(look(&mut detector, CONFIG, 4, 5));
    assert_eq!(found, watch(&file, CONFIG, 0, 9));
}

#[test]
fn padding_does_not_matter() {
    let file = model();
    let parsed = Model::parse(&file).unwrap();
    let (width, height) = (CONFIG.width, CONFIG.height);
    let padded = |stride: usize, padding: u8| -> Vec<Detections> {
        let (mut bytes, mut words) = memory(&CONFIG, 0);
        let buffers = Buffers { bytes: &mut bytes, words: &mut words };
        let mut detector = Detector::new(&parsed, CONFIG, buffers).unwrap();
        let mut packed = vec![0; width * height];
        (0..6)
            .map(|number| {
                draw(number, width, &mut packed);
                let mut pixels = vec![padding; stride * (height - 1) + width];
                for (row, packed) in pixels.chunks_mut(stride).zip(packed.chunks(width)) {
                    row[..width].copy_from_slice(packed);
                }
                let frame = Image::new(&pixels, width, height, stride).unwrap();
                let mut detections = Detections::default();
                detector.process(frame, i64::from(number) * 33_333, &mut detections).unwrap();
                detections
            })
            .collect()
    };
    let expected = watch(&file, CONFIG, 0, 6);
    assert!(expected.iter().any(|d| !d.list.is_empty()));
    assert_eq!(padded(width + 1, 0), expected);
    assert_eq!(padded(width + 37, 255), expected);
}

#[test]
fn memory_comes_back_and_may_be_dirty() {
    let file = model();
    let parsed = Model::parse(&file).unwrap();
    let expected = watch(&file, CONFIG, 0, 6);
    assert_eq!(watch(&file, CONFIG, 0, 6), expected, "two runs");
    assert_eq!(watch(&file, CONFIG, 255, 6), expected, "memory full of ones");
    let (mut bytes, mut words) = memory(&CONFIG, 3);
    let buffers = Buffers { bytes: &mut bytes, words: &mut words };
    let mut detector = Detector::new(&parsed, CONFIG, buffers).unwrap();
    look(&mut detector, CONFIG, 40, 5);
    let buffers = detector.release();
    assert_eq!(
        (buffers.bytes.len(), buffers.words.len()),
        (CONFIG.bytes_len(), CONFIG.words_len())
    );
    let mut second = Detector::new(&parsed, CONFIG, buffers).unwrap();
    assert_eq!(look(&mut second, CONFIG, 0, 6), expected, "memory of another detector");
}

#[test]
fn frames_too_large_for_the_arithmetic_are_refused() {
    let file = model();
    let parsed = Model::parse(&file).unwrap();
    for (width, height) in [(MAX_SIDE + 1, 8), (8, usize::MAX)] {
        let config = Config { width, height, ..CONFIG };
        let buffers = Buffers { bytes: &mut [], words: &mut [] };
        let refused = Detector::new(&parsed, config, buffers).map(drop);
        assert_eq!(refused, Err(Error::UnsupportedSize { width, height }));
    }
    assert_eq!(Config { width: MAX_SIDE, height: 1, ..CONFIG }.check(), Ok(()));
}

#[test]
fn what_finds_no_room_is_counted() {
    let config = Config { candidates: usize::MAX, ..Config::for_method(METHOD, 320, 240) };
    for detections in watch(&keen_model(), config, 0, 2) {
        assert_eq!(detections.kept, detections.windows, "the scan keeps every window");
        assert_eq!(detections.proposals.len(), MAX_CANDIDATES);
        // Boxes that came to lie on each other in the second look are gone, not dropped.
        assert!((2..=MAX_DETECTIONS).contains(&detections.list.len()));
        assert!(detections.dropped > 256, "{} dropped", detections.dropped);
        assert!(detections.list.is_sorted_by(|a, b| a.score >= b.score));
    }
    // Fewer are classified if the configuration says so.
    let config = Config { candidates: 2, ..CONFIG };
    let detections = watch(&keen_model(), config, 0, 1).remove(0);
    assert_eq!(detections.proposals.len(), 2);
    assert!(detections.dropped > 0);
    let none = Config { candidates: 0, ..CONFIG };
    let detections = watch(&keen_model(), none, 0, 1).remove(0);
    assert!(detections.list.is_empty() && detections.dropped > 0);
}

#[test]
fn room_for_levels_in_parallel_changes_nothing() {
    for history in [History::Full, History::Half] {
        let method = Method { history, ..METHOD };
        let config = Config { method, ..CONFIG };
        let model = trained_with(model(), method);
        let alone = Config { parallel: false, ..config };
        assert!(alone.bytes_len() < config.bytes_len() && alone.words_len() < config.words_len());
        assert_eq!(watch(&model, alone, 9, 6), watch(&model, config, 0, 6));
    }
}

#[test]
fn half_a_history_finds_what_moves() {
    let method = Method { history: History::Half, ..METHOD };
    let config = Config { method, ..CONFIG };
    assert!(3 * config.bytes_len() < CONFIG.bytes_len());
    let model = trained_with(model(), method);
    let found = watch(&model, config, 0, 12);
    assert!(found.iter().any(|d| !d.list.is_empty()), "nothing was found");
    let still = Config { method: Method { temporal: false, ..method }, ..config };
    assert_ne!(watch(&model, still, 0, 12), found, "no difference was seen");
}

#[test]
fn a_model_and_a_configuration_that_disagree_are_refused() {
    let mini = include_bytes!("../models/lookout-mini.lkm");
    let mini = Model::parse(mini).unwrap();
    let file = model();
    let own = Model::parse(&file).unwrap();
    let less = Method { registration: false, temporal: false, stcube: false, ..METHOD };
    let poor = trained_with(model(), less);
    let poor = Model::parse(&poor).unwrap();
    for (model, method, fits) in [
        (&own, METHOD, true),
        (&own, less, true),
        (&own, Method { alignment: Alignment::Background, ..METHOD }, true),
        (&own, Method { alignment: Alignment::Flow, ..METHOD }, false),
        (&own, Method { scales_per_octave: 1, ..METHOD }, false),
        (&own, Method { history: History::Half, ..METHOD }, false),
        (&mini, METHOD, false),
        (&mini, mini.method(), true),
        (&poor, METHOD, false),
        (&poor, less, true),
    ] {
        let config = Config { method, ..CONFIG };
        let (mut bytes, mut words) = memory(&config, 0);
        let made = Detector::new(model, config, Buffers { bytes: &mut bytes, words: &mut words });
        assert_eq!(made.err(), (!fits).then_some(Error::ModelMismatch), "{method:?}");
    }
}

#[test]
fn a_gap_or_a_step_backwards_starts_anew() {
    let file = model();
    let parsed = Model::parse(&file).unwrap();
    let fresh = watch(&file, CONFIG, 0, 6);
    assert!(fresh[0].restarted && fresh[1..].iter().all(|d| !d.restarted));
    assert!(fresh.iter().any(|d| !d.list.is_empty()), "nothing to compare");
    for start in [-1, i64::MIN, 5 * 33_333 + MAX_GAP_US + 1, i64::MAX - 200_000] {
        let (mut bytes, mut words) = memory(&CONFIG, 0);
        let buffers = Buffers { bytes: &mut bytes, words: &mut words };
        let mut detector = Detector::new(&parsed, CONFIG, buffers).unwrap();
        look(&mut detector, CONFIG, 0, 6);
        let mut pixels = vec![0; CONFIG.width * CONFIG.height];
        let mut detections = Detections::default();
        for (number, expected) in fresh.iter().enumerate() {
            draw(number as u32, CONFIG.width, &mut pixels);
            let frame = Image::packed(&pixels, CONFIG.width, CONFIG.height).unwrap();
            let time = start.saturating_add(33_333 * number as i64);
            detector.process(frame, time, &mut detections).unwrap();
            assert_eq!(&detections, expected, "frame {number} from {start}");
        }
    }
    // The longest gap, and a time that stands still, go on.
    let (mut bytes, mut words) = memory(&CONFIG, 0);
    let buffers = Buffers { bytes: &mut bytes, words: &mut words };
    let mut detector = Detector::new(&parsed, CONFIG, buffers).unwrap();
    let pixels = vec![9; CONFIG.width * CONFIG.height];
    let mut restarted = |time| {
        let frame = Image::packed(&pixels, CONFIG.width, CONFIG.height).unwrap();
        let mut detections = Detections::default();
        detector.process(frame, time, &mut detections).unwrap();
        detections.restarted
    };
    let times = [0, 0, MAX_GAP_US, 2 * MAX_GAP_US + 1, 2 * MAX_GAP_US];
    assert_eq!(times.map(&mut restarted), [true, false, false, true, true]);
}

#[test]
fn the_threshold_cuts_the_list() {
    let all = watch(&model(), CONFIG, 0, 8);
    let scores: Vec<i32> = all.iter().flat_map(|d| &d.list).map(|d| d.score).collect();
    let threshold = scores[scores.len() / 2];
    let sure = watch(&model(), Config { threshold, ..CONFIG }, 0, 8);
    let left: Vec<i32> = sure.iter().flat_map(|d| &d.list).map(|d| d.score).collect();
    assert!(!left.is_empty() && left.len() < scores.len());
    assert!(left.iter().all(|&score| score >= threshold));
}

/// Frames of noise, of black and white, of few white pixels, of white alone.
fn noise(len: usize, seed: u32, kind: u8) -> Vec<u8> {
    let mut numbers = common::Numbers(seed | 1);
    (0..len)
        .map(|_| {
            let value = numbers.below(256) as u8;
            match kind {
                0 => value,
                1 => u8::from(value > 127) * 255,
                2 => u8::from(value > 250) * 255,
                _ => 255,
            }
        })
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, ..ProptestConfig::default() })]

    #[test]
    fn nothing_panics(
        (width, height) in prop_oneof![
            (0..90usize, 0..90usize),
            prop::sample::select(vec![(0, 0), (0, 9), (9, 0), (1, 1), (7, 5), (8, 8), (20, 20), (41, 33), (257, 9), (9, 257), (129, 97)]),
        ],
        (min_target, max_target) in (
            prop_oneof![0..60usize, Just(usize::MAX >> 17), Just(1 << 20), Just(usize::MAX)],
            prop_oneof![0..200usize, Just(1 << 20), Just(usize::MAX)],
        ),
        scales_per_octave in 1..=4u8,
        candidates in prop_oneof![0..64usize, Just(usize::MAX)],
        threshold in prop_oneof![Just(i32::MIN), any::<i32>(), Just(i32::MAX)],
        [registration, temporal, trace, fit, stcube, persistence, keen, parallel] in any::<[bool; 8]>(),
        history in prop_oneof![Just(History::Full), Just(History::Half)],
        alignment in prop_oneof![Just(Alignment::Background), Just(Alignment::Regressors), Just(Alignment::Flow)],
        kinds in any::<[u8; 4]>(),
        seed: u32,
    ) {
        let method = Method {
            registration, temporal, alignment, stcube, persistence, scales_per_octave, history,
        };
        let config = Config {
            width, height, min_target, max_target, threshold, candidates, parallel, method, trace, fit,
        };
        let file = trained_with(if keen { keen_model() } else { model() }, method);
        let parsed = Model::parse(&file).unwrap();
        let (mut bytes, mut words) = memory(&config, 7);
        let buffers = Buffers { bytes: &mut bytes, words: &mut words };
        let mut detector = Detector::new(&parsed, config, buffers).unwrap();
        let mut detections = Detections::default();
        for (number, kind) in kinds.into_iter().enumerate() {
            let pixels = noise(width * height, seed.wrapping_add(number as u32), kind % 4);
            let frame = Image::packed(&pixels, width, height).unwrap();
            let time = if number == 2 { i64::MIN } else { i64::MAX };
            detector.process(frame, time, &mut detections).unwrap();
            prop_assert!(detections.kept <= detections.windows);
            prop_assert!(detections.list.iter().all(|d| d.score >= threshold));
        }
    }
}
