//! The detector as firmware would call it, in memory that is given to it.
#![no_std]

use lookout::channels::method::{Alignment, Method};
use lookout::detector::{Buffers, Config, Detections, Detector, History};
use lookout::image::Image;
use lookout::model::Model;

/// As the shipped model is trained; another is refused.
const METHOD: Method = Method {
    registration: true,
    temporal: true,
    alignment: Alignment::Background,
    stcube: true,
    persistence: true,
    scales_per_octave: 2,
    history: History::Full,
};

const CONFIG: Config = Config::for_method(METHOD, 160, 120);

/// Largest model taken.
const MODEL: usize = 1 << 20;

/// Detections in a frame, or a negative number where the model or the frame was refused.
// The arrays come from outside, so that the compiler cannot do the work beforehand.
#[unsafe(no_mangle)]
pub extern "C" fn lookout_check(
    model: &[u8; MODEL],
    model_length: usize,
    pixels: &[u8; CONFIG.width * CONFIG.height],
    bytes: &mut [u8; CONFIG.bytes_len()],
    words: &mut [u16; CONFIG.words_len()],
) -> i32 {
    let Some(Ok(model)) = model.get(..model_length).map(Model::parse) else {
        return -1;
    };
    let Ok(mut detector) = Detector::new(&model, CONFIG, Buffers { bytes, words }) else {
        return -2;
    };
    let Ok(frame) = Image::packed(pixels, CONFIG.width, CONFIG.height) else {
        return -3;
    };
    let mut found = Detections::default();
    match detector.process(frame, 0, &mut found) {
        Ok(()) => found.list.len() as i32,
        Err(_) => -4,
    }
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}
