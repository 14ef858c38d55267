//! The detector in static memory, as firmware uses it: its size is a constant of the model's header, and too little
//! memory is an error of the linker instead of one in the air.
//!
//! `cargo run --release --example static_memory`

use lookout::detector::{Buffers, Config, Detections, Detector};
use lookout::image::Image;
use lookout::model::{Method, Model};
use std::error::Error;
use std::sync::Mutex;

const MODEL: &[u8] = include_bytes!("../models/lookout-mini.lkm");

const CONFIG: Config = match Method::of_header(MODEL) {
    Some(method) => Config::for_method(method, 320, 240),
    None => panic!("the file is no model"),
};

const _: () = assert!(CONFIG.check().is_ok());

/// Firmware takes it once from a `static_cell::ConstStaticCell`; a lock does here.
static MEMORY: Mutex<([u8; CONFIG.bytes_len()], [u16; CONFIG.words_len()])> =
    Mutex::new(([0; CONFIG.bytes_len()], [0; CONFIG.words_len()]));

fn main() -> Result<(), Box<dyn Error>> {
    let mut memory = MEMORY.lock()?;
    let (bytes, words) = &mut *memory;
    println!("{} bytes of static memory", bytes.len() + 2 * words.len());

    let model = Model::parse(MODEL)?;
    let mut detector = Detector::new(&model, CONFIG, Buffers { bytes, words })?;
    let mut detections = Detections::default();
    let mut pixels = vec![0; CONFIG.width * CONFIG.height];
    for number in 0..12 {
        // Ground that moves one pixel a frame, and a dark square that moves against it.
        for (place, pixel) in pixels.iter_mut().enumerate() {
            let (x, y) = (place % CONFIG.width, place / CONFIG.width);
            let ground = ((x + number) / 7 * 31 + y / 5 * 17) % 97 + 80;
            let square =
                (100 + 4 * number..118 + 4 * number).contains(&x) && (90..104).contains(&y);
            *pixel = if square { 20 } else { ground as u8 };
        }
        let frame = Image::packed(&pixels, CONFIG.width, CONFIG.height)?;
        detector.process(frame, number as i64 * 33_333, &mut detections)?;
        println!("frame {number}: {} detections", detections.list.len());
    }
    Ok(())
}
