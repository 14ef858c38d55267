//! Bytes of a link as they come, in pieces: every frame found has its checksum, every byte is looked at, and a good frame
//! after them is found.
//!
//! Input: pieces, each a length and so many bytes; 255 is a heartbeat.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lookout::mavlink::dialect::{ArduPilotFrames, SYSTEM_TIME_DATA};
use lookout::mavlink::messages::Payload;
use lookout::shell::fuzzing::LinkBytes;
use lookout_fuzz::Input;

/// More bytes than a frame takes, signed and with a long system id.
const LONGEST: usize = 300;

fn frame(number: u32) -> Vec<u8> {
    let data = SYSTEM_TIME_DATA { time_unix_usec: 1, time_boot_ms: number };
    Payload::new(&data).frame(1, 1, 0, false).raw_bytes().to_vec()
}

fuzz_target!(|data: &[u8]| {
    let mut input = Input(data);
    let mut link = LinkBytes::default();
    let mut count = 0;
    while !input.is_empty() {
        let frames = match input.byte() {
            255 => link.receive(&frame(count)),
            length => link.receive(input.bytes(length.into())),
        };
        count += 1;
        assert!(frames.iter().all(ArduPilotFrames::has_valid_crc));
        assert_eq!(link.kept(), 0);
    }
    // Whatever began before them ends within the zeros.
    let after = [&[0; LONGEST], &frame(u32::MAX)[..]].concat();
    let frames = link.receive(&after);
    let good = |frame: &mavlink_core::MAVLinkMessageRaw| frame.payload().ends_with(&[255; 4]);
    assert!(frames.iter().any(good), "the good frame is lost");
});
