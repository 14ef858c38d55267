//! Signed frames: only what was signed with the key, unchanged and not yet heard, is trusted.
//!
//! Input: for each frame its flags, then a place and a mask that change one of its bytes.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lookout::mavlink::component::Trust;
use lookout::mavlink::dialect::SYSTEM_TIME_DATA;
use lookout::mavlink::messages::Payload;
use lookout::shell::link::signing::Signing;
use lookout_fuzz::Input;
use mavlink_core::MAVLinkMessageRaw;

const KEY: [u8; 32] = [7; 32];
const START: u64 = 1 << 40;

fuzz_target!(|data: &[u8]| {
    let mut input = Input(data);
    let signing = |key| Signing::new(key, None, START).expect("no file is kept");
    let (mut ours, mut peer, mut stranger) = (signing(KEY), signing(KEY), signing([8; 32]));
    let mut clock = START;
    while !input.is_empty() {
        let flags = input.byte();
        clock += u64::from(input.word()) << (flags & 7);
        let payload = Payload::new(&SYSTEM_TIME_DATA {
            time_unix_usec: clock,
            time_boot_ms: input.word().into(),
        });
        let mut frame = payload.frame(flags >> 6, 1, 0, true);
        let signer = if flags & 8 == 0 { &mut peer } else { &mut stranger };
        signer.sign(&mut frame, flags >> 4 & 1, clock);
        let (place, mask) = (usize::from(input.byte()), input.byte());
        // The first byte is only the mark of a frame.
        let place = 1 + place % (frame.raw_bytes().len() - 1);
        frame.as_mut_slice()[place] ^= mask;
        let trust = ours.verify(&MAVLinkMessageRaw::V2(frame), clock);
        let genuine = flags & 8 == 0 && mask == 0;
        assert_eq!(trust == Trust::Signed, genuine, "{trust:?}");
        if genuine {
            assert_eq!(ours.verify(&MAVLinkMessageRaw::V2(frame), clock), Trust::Forged);
        }
    }
});
