//! Pictures in, boxes out: finds flying objects in a folder of pictures, a video or a `.y4m` file.
//!
//! `cargo run --release --example detect -- INPUT` (without INPUT: a simulated flight)

use lookout::detector::{Buffers, Config, Detections, Detector};
use lookout::model::Model;
use lookout::shell::simulate::SimulateSettings;
use lookout::shell::simulate::source::Simulated;
use lookout::shell::sources::{self, Frame, FrameSource};
use std::error::Error;

fn main() -> Result<(), Box<dyn Error>> {
    let mut source: Box<dyn FrameSource> = match std::env::args().nth(1) {
        Some(input) => sources::open(&input)?,
        None => Box::new(Simulated::new(&SimulateSettings { seconds: 2.0, ..Default::default() })),
    };
    let mut frame = Frame::default();
    if !source.next_frame(&mut frame)? {
        return Err("no frames".into());
    }

    let model = Model::parse(include_bytes!("../models/lookout.lkm"))?;
    // Nine of ten detections of this score or more were right on clips held back.
    let threshold = model.calibration().threshold(58_982).unwrap_or(i32::MIN);
    let config = Config { threshold, ..Config::for_model(&model, frame.width, frame.height) };
    let (mut bytes, mut words) = (vec![0; config.bytes_len()], vec![0; config.words_len()]);
    let buffers = Buffers { bytes: &mut bytes, words: &mut words };
    let mut detector = Detector::new(&model, config, buffers)?;

    let mut detections = Detections::default();
    let mut found = 0;
    for number in 1.. {
        detector.process(frame.view(), frame.time_us, &mut detections)?;
        for detection in &detections.list {
            let rect = detection.rect;
            let score = f64::from(detection.score) / 65536.0;
            println!(
                "frame {number}: {:.1}x{:.1} px at ({:.1}, {:.1}), {score:.2} log-odds",
                rect.width, rect.height, rect.x, rect.y
            );
        }
        found += detections.list.len();
        if !source.next_frame(&mut frame)? {
            println!("{found} detections in {number} frames");
            break;
        }
    }
    Ok(())
}
