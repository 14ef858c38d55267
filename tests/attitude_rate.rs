//! Attitudes that come rarely: traffic is still put on the map.
#![cfg(feature = "std")]

use lookout::detector::Detections;
use lookout::mavlink::component::Trust;
use lookout::mavlink::dialect::MavMessage;
use lookout::mavlink::lookout::Onboard;
use lookout::shell::pipeline::{DetectorArgs, Memory, ModelFile};
use lookout::shell::simulate::source::Simulated;
use lookout::shell::simulate::{Kind, SimulateSettings, Simulator, Telemetry};
use lookout::shell::sources::{Frame, FrameSource};
use lookout::tracking::tracker;
use mavlink_core::MAVLinkMessageRaw;

/// From a frame to its detections, microseconds.
const LATENCY_US: i64 = 40_000;
const ATTITUDE: u32 = 30;
const ATTITUDE_QUATERNION: u32 = 31;

/// Reports of traffic with a position, where of the attitudes at most one in `every_us` arrives.
fn reports(
    settings: &SimulateSettings,
    tracks: tracker::Settings,
    frames: &[(i64, Detections)],
    every_us: i64,
) -> usize {
    let camera = Simulator::new(settings).camera().camera().unwrap();
    let mut onboard = Onboard::new(camera, tracks, Default::default(), Default::default(), 0);
    let mut telemetry = Telemetry::of(settings).peekable();
    let (mut now, mut next_us, mut count) = (0, 0, 0);
    for (time_us, found) in frames {
        while now < time_us + LATENCY_US {
            now = (now + 10_000).min(time_us + LATENCY_US);
            while let Some((time, frame)) = telemetry.next_if(|(time, _)| *time <= now) {
                let attitude = [ATTITUDE, ATTITUDE_QUATERNION].contains(&frame.message_id());
                if attitude && time < next_us {
                    continue;
                }
                if attitude {
                    next_us = time + every_us;
                }
                onboard.hear(0, &MAVLinkMessageRaw::V2(frame), Trust::Open, time);
            }
            while let Some(message) = onboard.poll(now) {
                count += usize::from(matches!(
                    message.payload.parse(),
                    Some(MavMessage::ADSB_VEHICLE(_))
                ));
            }
        }
        onboard.see(found, *time_us, now);
    }
    count
}

#[test]
fn traffic_is_reported_at_every_rate_of_attitudes() {
    let settings = SimulateSettings { kind: Kind::Collision, ..SimulateSettings::default() };
    let file = ModelFile::load(None).unwrap();
    let model = file.parse().unwrap();
    let tracks = tracker::Settings::calibrated(model.calibration());
    let args = DetectorArgs { threshold: Some(tracks.keep_score), ..DetectorArgs::default() };
    let config = args.config(&model, settings.width as usize, settings.height as usize).unwrap();
    let mut memory = Memory::new(&config);
    let mut detector = memory.detector(&model, config).unwrap();
    let (mut source, mut frame) = (Simulated::new(&settings), Frame::default());
    let mut frames = Vec::new();
    while source.next_frame(&mut frame).unwrap() {
        let mut found = Detections::default();
        detector.process(frame.view(), frame.time_us, &mut found).unwrap();
        frames.push((frame.time_us, found));
    }
    let often = reports(&settings, tracks, &frames, 0);
    assert!(often >= 3, "{often} reports with every attitude");
    for rate in [10, 4, 3, 2] {
        let rare = reports(&settings, tracks, &frames, 1_000_000 / rate);
        assert!(
            rare * 10 >= often * 8,
            "{rare} reports at {rate} attitudes a second, {often} with all"
        );
    }
    // Attitudes that are seconds old are none.
    let none = reports(&settings, tracks, &frames, 60_000_000);
    assert!(none * 2 < often, "{none} reports with one attitude in all, {often} with all");
}
