//! A model file, then frames: what [`Model::parse`] accepts runs on any pixels.
//!
//! Length and checksum are made right, so that changes get past them. Input: length of the model (2 bytes) and the model,
//! or 0 for the one of `tests/common`; number of changes to it, each a place (2 bytes) and a byte; pixels of 64x48 frames.
#![no_main]

#[path = "../../tests/common/mod.rs"]
mod common;

use libfuzzer_sys::fuzz_target;
use lookout::detector::{Buffers, Config, Detections, Detector};
use lookout::image::Image;
use lookout::model::Model;
use lookout_fuzz::Input;

const SIZE: (usize, usize) = (64, 48);

fuzz_target!(|data: &[u8]| {
    let mut input = Input(data);
    let length = input.word();
    let mut bytes = match length {
        0 => common::model(),
        _ => input.bytes(length.into()).to_vec(),
    };
    for _ in 0..input.byte() % 32 {
        let (place, value) = (usize::from(input.word()), input.byte());
        if let Some(byte) = bytes.get_mut(place) {
            *byte = value;
        }
    }
    common::repair(&mut bytes);
    let Ok(model) = Model::parse(&bytes) else { return };
    let base = Config::for_model(&model, SIZE.0, SIZE.1);
    let config = Config { min_target: 10, max_target: 20, parallel: false, ..base };
    let (mut bytes, mut words) = common::memory(&config, 0);
    let buffers = Buffers { bytes: &mut bytes, words: &mut words };
    let mut detector =
        Detector::new(&model, config, buffers).expect("the buffers are as long as asked");
    let mut found = Detections::default();
    for number in 0..3 {
        let taken = input.bytes(SIZE.0 * SIZE.1);
        let mut pixels = vec![128; SIZE.0 * SIZE.1];
        pixels[..taken.len()].copy_from_slice(taken);
        let frame = Image::packed(&pixels, SIZE.0, SIZE.1).expect("the picture is packed");
        detector.process(frame, number * 33_333, &mut found).expect("the frame has its size");
        assert!(found.list.windows(2).all(|pair| pair[0].score >= pair[1].score));
    }
});
