//! The small model fits a microcontroller: memory known at compile time, the parts that its history has.

mod common;

use common::golden::draw;
use lookout::detector::{Buffers, Config, Detector, History};
use lookout::image::Image;
use lookout::model::{Method, Model};

/// Frames that the model is made for.
const SIZE: (usize, usize) = (320, 240);

const MODEL: &[u8] = include_bytes!("../models/lookout-mini.lkm");

/// All that firmware needs to know.
const CONFIG: Config = match Method::of_header(MODEL) {
    Some(method) => Config::for_method(method, SIZE.0, SIZE.1),
    None => panic!("the header names no method"),
};

/// Of 512 kB, less a frame, the stack and what tracker and messages take.
const MOST_BYTES: usize = 360 * 1000;

/// Of 512 kB, less the program.
const LARGEST_MODEL: usize = 200 * 1000;

const _: () = assert!(CONFIG.bytes_len() + 2 * CONFIG.words_len() <= MOST_BYTES);
const _: () = assert!(MODEL.len() <= LARGEST_MODEL);

#[test]
fn the_model_is_for_small_boards() {
    let model = Model::parse(MODEL).unwrap();
    assert_eq!(Some(model.method()), Method::of_header(MODEL));
    assert_eq!(model.method().history, History::Half);
    let Config { parallel, trace, method, .. } = CONFIG;
    assert_eq!((parallel, trace, method.history), (false, false, History::Half));
}

/// Detections of frames drawn by [`draw`], and windows that the scan kept.
fn watch(config: Config, dirt: u8) -> (Vec<lookout::detector::Detections>, u32) {
    let (mut bytes, mut words) = common::memory(&config, dirt);
    let model = Model::parse(MODEL).unwrap();
    let buffers = Buffers { bytes: &mut bytes, words: &mut words };
    let mut detector = Detector::new(&model, config, buffers).unwrap();
    let mut pixels = vec![0; SIZE.0 * SIZE.1];
    let found: Vec<_> = (0..14)
        .map(|number| {
            draw(number, SIZE.0, &mut pixels);
            let frame = Image::packed(&pixels, SIZE.0, SIZE.1).unwrap();
            let mut detections = lookout::detector::Detections::default();
            detector.process(frame, i64::from(number) * 33_333, &mut detections).unwrap();
            detections
        })
        .collect();
    let kept = found.iter().map(|d| d.kept).sum();
    (found, kept)
}

#[test]
fn one_level_after_the_other_is_as_all_at_once() {
    let (alone, kept) = watch(CONFIG, 0);
    assert!(kept > 0 && alone.iter().any(|d| !d.list.is_empty()), "nothing to compare");
    assert_eq!(watch(CONFIG, 255).0, alone, "memory full of ones");
    assert_eq!(watch(Config { parallel: true, ..CONFIG }, 7).0, alone);
}
