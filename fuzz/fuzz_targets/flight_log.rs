//! Logs of autopilots, by their first bytes: DataFlash, ULog, else a telemetry log. What is read are messages of the
//! dialect.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lookout::mavlink::dialect::ArduPilotFrames;
use lookout::shell::formats::flight_log;

fuzz_target!(|data: &[u8]| {
    let Ok(messages) = flight_log::open(&lookout_fuzz::file("flight.log", data)) else { return };
    for message in messages {
        let Ok((_, frame)) = message else { return };
        assert!(ArduPilotFrames::has_valid_crc(&frame));
    }
});
