//! Ground truth and detections in MOTChallenge form, detections as JSON lines, and `truth.csv` of a rendered flight.
//! The first byte selects the reader.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lookout::shell::formats::{clips::GroundTruth, detections, truth};
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let Some((&form, text)) = data.split_first() else { return };
    match form % 4 {
        0 => {
            let Ok(text) = std::str::from_utf8(text) else { return };
            let Ok(truth) = GroundTruth::parse(text, Path::new("gt.txt")) else { return };
            for (frame, _) in truth.boxes() {
                assert!(frame <= truth.last_frame() && !truth.frame(frame).is_empty());
            }
        }
        1 => {
            let found = detections::read_mot(&lookout_fuzz::file("found.txt", text));
            for found in found.unwrap_or_default() {
                assert!(found.score.is_finite());
            }
        }
        2 => {
            let frames =
                detections::read_json(&lookout_fuzz::file("found.jsonl", text), (640, 480));
            for (number, (_, found)) in (1..).zip(frames.unwrap_or_default()) {
                let _ = detections::mot_lines(number, &found);
            }
        }
        _ => {
            let _ = truth::read(&lookout_fuzz::file("truth.csv", text));
        }
    }
});
