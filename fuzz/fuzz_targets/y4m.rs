//! A YUV4MPEG2 stream: every frame has the same size, or reading ends with an error.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lookout::shell::sources::{self, Frame};

fuzz_target!(|data: &[u8]| {
    // Sizes of four digits and more are memory, not faults.
    let line = data.split(|&byte| byte == b'\n').next().unwrap_or_default();
    if line.split(|&byte| byte == b' ').any(|field| field.len() > 4 && b"WH".contains(&field[0])) {
        return;
    }
    let path = lookout_fuzz::file("stream.y4m", data);
    let Ok(mut source) = sources::open(path.to_str().expect("the path is text")) else { return };
    let (mut frame, mut size) = (Frame::default(), None);
    while let Ok(true) = source.next_frame(&mut frame) {
        assert_eq!(frame.pixels.len(), frame.width * frame.height);
        assert_eq!(*size.get_or_insert((frame.width, frame.height)), (frame.width, frame.height));
    }
});
