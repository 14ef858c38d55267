//! Bytes of a link into the lookout, detections between them, and what it sends: every frame out is a message of the
//! dialect with its checksum.
//!
//! Input: commands of one byte each with what they need; see `step`.
#![no_main]

use fixed::types::I28F4;
use libfuzzer_sys::fuzz_target;
use lookout::camera::Camera;
use lookout::detector::Detections;
use lookout::detector::detection::Detection;
use lookout::image::Rect;
use lookout::math::real::Real;
use lookout::mavlink::component::parameters::Parameters;
use lookout::mavlink::component::{ComponentConfig, Trust};
use lookout::mavlink::dialect::{ArduPilotFrames, MavMessage};
use lookout::mavlink::lookout::Lookout;
use lookout::tracking::tracker::TrackerSettings;
use lookout_fuzz::Input;
use mavlink_core::{Dialect, MAV_STX_V2, MAVLinkMessageRaw, MavlinkReader};

fuzz_target!(|data: &[u8]| {
    let mut input = Input(data);
    let camera = Camera::from_field_of_view(640, 480, Real::from_num(1))
        .expect("a radian is a field of view");
    let mut lookout = Lookout::new(
        camera,
        TrackerSettings::default(),
        ComponentConfig::default(),
        Parameters::default(),
        0,
    );
    let (mut now_us, mut stream) = (1_000_000i64, Vec::new());
    while !input.is_empty() {
        step(&mut input, &mut stream, &mut lookout, &mut now_us);
    }
});

fn step(input: &mut Input<'_>, stream: &mut Vec<u8>, lookout: &mut Lookout, now_us: &mut i64) {
    let command = input.byte();
    match command >> 5 {
        // A frame with its checksum.
        0..=3 => stream.extend(frame(input)),
        // Anything.
        4 => stream.extend(input.bytes((command & 31).into())),
        // The stream arrives.
        5 => {
            let trust = [Trust::Open, Trust::Signed, Trust::Unsigned, Trust::Forged]
                [usize::from(command & 3)];
            let mut reader = MavlinkReader::new(stream.as_slice());
            while let Ok(frame) = reader.read_any_raw_message_with_dialect(&ArduPilotFrames) {
                lookout.receive(command >> 2 & 3, &frame, trust, *now_us);
            }
            stream.clear();
        }
        // Something is seen.
        6 => {
            let found = detections(input, command & 31);
            let age = i64::from(input.word()) * 16;
            lookout.process(&found, *now_us - age, *now_us);
        }
        // Time passes.
        _ => *now_us += i64::from(input.word()) << (command & 15),
    }
    while let Some(message) = lookout.poll(*now_us) {
        let frame = message.payload.frame(message.system_id, message.component_id, 0, false);
        assert!(ArduPilotFrames::has_valid_crc(&MAVLinkMessageRaw::V2(frame)), "{message:?}");
    }
}

/// A MAVLink 2 frame: number, sender and payload of the input.
fn frame(input: &mut Input<'_>) -> Vec<u8> {
    let ids = MavMessage::all_ids();
    let id = ids[usize::from(input.byte()) % ids.len()];
    let (system, component, length) = (input.byte(), input.byte(), input.byte());
    let payload = input.bytes(length.into());
    let mut frame = vec![MAV_STX_V2, payload.len() as u8, 0, 0, 0, system, component];
    frame.extend(&id.to_le_bytes()[..3]);
    frame.extend(payload);
    let extra = ArduPilotFrames.extra_crc(id).expect("messages of the dialect are known");
    let checksum = mavlink_core::calculate_crc(&frame[1..], extra);
    frame.extend(checksum.to_le_bytes());
    frame
}

fn detections(input: &mut Input<'_>, count: u8) -> Detections {
    let mut found = Detections::default();
    for _ in 0..count {
        let [x, y, width, height] = std::array::from_fn(|_| I28F4::from_bits(input.word().into()));
        let rect = Rect { x, y, width, height };
        let score = i32::from(input.word()) << 4;
        let detection = Detection { rect, score, frame_score: score, shifts: Default::default() };
        if found.list.push(detection).is_err() {
            break;
        }
    }
    found
}
