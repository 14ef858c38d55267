//! A Motion JPEG picture of a camera: decoded to grey, or refused. The first two bytes are the expected size.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lookout::shell::fuzzing;

fuzz_target!(|data: &[u8]| {
    let [width, height, picture @ ..] = data else { return };
    let size = (usize::from(*width), usize::from(*height));
    if let Some(pixels) = fuzzing::motion_jpeg(picture, size) {
        assert_eq!(pixels.len(), size.0 * size.1);
    }
});
