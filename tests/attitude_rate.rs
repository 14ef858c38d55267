//! Attitudes that come rarely: traffic is still put on the map.
#![cfg(feature = "std")]

use fixed::types::I28F4;
use lookout::detector::Detections;
use lookout::detector::detection::{Detection, SHIFTS, Shift};
use lookout::image::Rect;
use lookout::mavlink::component::Trust;
use lookout::mavlink::dialect::{HIGHRES_IMU_DATA, HighresImuUpdatedFlags, MavMessage};
use lookout::mavlink::lookout::Lookout;
use lookout::shell::pipeline::{DetectorArgs, Memory, ModelFile};
use lookout::shell::replay::telemetry::unplaced;
use lookout::shell::simulate::source::Simulated;
use lookout::shell::simulate::{FlightTelemetry, Manoeuvre, SimulateSettings, Simulator};
use lookout::shell::sources::{Frame, FrameSource};
use lookout::tracking::tracker;
use mavlink_core::{MAVLinkMessageRaw, MAVLinkV2MessageRaw, MavHeader, MavlinkVersion, Message};

/// From a frame to its detections, microseconds.
const LATENCY_US: i64 = 40_000;
const ATTITUDE: u32 = 30;
const ATTITUDE_QUATERNION: u32 = 31;

/// What of a vehicle's telemetry arrives, and what the pictures show.
#[derive(Clone, Copy)]
struct Link {
    /// At most one attitude in this time, microseconds.
    attitude_us: i64,
    /// Angular velocities in HIGHRES_IMU at the rate of the attitudes that do not arrive.
    gyroscope: bool,
    /// Whether the pictures show ground that can be followed.
    ground: bool,
}

/// Reports of traffic with a position over such a link, and the lookout at the end.
fn reports(
    settings: &SimulateSettings,
    tracks: tracker::TrackerSettings,
    frames: &[(i64, Detections)],
    link: Link,
) -> (usize, Lookout) {
    let camera = Simulator::new(settings).camera().camera().unwrap();
    let mut onboard = Lookout::new(camera, tracks, Default::default(), Default::default(), 0);
    let mut telemetry = FlightTelemetry::of(settings).peekable();
    let (mut now, mut next_us, mut count) = (0, 0, 0);
    for (time_us, found) in frames {
        while now < time_us + LATENCY_US {
            now = (now + 10_000).min(time_us + LATENCY_US);
            while let Some((time, frame)) = telemetry.next_if(|(time, _)| *time <= now) {
                if let Some(rates) = rates(&frame).filter(|_| link.gyroscope) {
                    onboard.receive(0, &MAVLinkMessageRaw::V2(rates), Trust::Open, time);
                }
                if [ATTITUDE, ATTITUDE_QUATERNION].contains(&frame.message_id()) {
                    // The angles would come where the quaternion does not.
                    if time < next_us || frame.message_id() == ATTITUDE {
                        continue;
                    }
                    next_us = time + link.attitude_us;
                }
                onboard.receive(0, &MAVLinkMessageRaw::V2(frame), Trust::Open, time);
            }
            while let Some(message) = onboard.poll(now) {
                count += usize::from(matches!(
                    message.payload.parse(),
                    Some(MavMessage::ADSB_VEHICLE(_))
                ));
            }
        }
        let motion = if link.ground { found.motion } else { Default::default() };
        onboard.process(&Detections { motion, ..found.clone() }, *time_us, now);
    }
    (count, onboard)
}

/// The angular velocities of an attitude, as PX4 sends them beside it.
fn rates(frame: &MAVLinkV2MessageRaw) -> Option<MAVLinkV2MessageRaw> {
    let parsed = MavMessage::parse(MavlinkVersion::V2, frame.message_id(), frame.payload());
    let Ok(MavMessage::ATTITUDE_QUATERNION(data)) = parsed else { return None };
    let message = MavMessage::HIGHRES_IMU(HIGHRES_IMU_DATA {
        time_usec: u64::from(data.time_boot_ms) * 1000,
        xgyro: data.rollspeed,
        ygyro: data.pitchspeed,
        zgyro: data.yawspeed,
        fields_updated: HighresImuUpdatedFlags::from_bits_retain(63),
        ..HIGHRES_IMU_DATA::default()
    });
    let mut raw = MAVLinkV2MessageRaw::new();
    raw.serialize_message(MavHeader { system_id: 1, component_id: 1, sequence: 0 }, &message);
    Some(raw)
}

const ALL: Link = Link { attitude_us: 0, gyroscope: false, ground: true };

#[test]
fn the_pictures_motion_carries_rare_attitudes() {
    let settings = SimulateSettings { kind: Manoeuvre::Collision, ..SimulateSettings::default() };
    let file = ModelFile::load(None).unwrap();
    let model = file.parse().unwrap();
    let tracks = tracker::TrackerSettings::calibrated(model.calibration());
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
    let flown = |link| reports(&settings, tracks, &frames, link);
    let (often, onboard) = flown(ALL);
    assert!(often >= 3, "{often} reports with every attitude");
    let counts = onboard.placing().counts();
    assert!(counts.placed > 0 && counts.worst().is_none(), "{counts:?}");
    for rate in [10, 4, 3, 2] {
        let (rare, _) = flown(Link { attitude_us: 1_000_000 / rate, ..ALL });
        assert!(
            rare * 10 >= often * 8,
            "{rare} reports at {rate} attitudes a second, {often} with all"
        );
    }
    // Attitudes that are seconds old are none.
    let (none, onboard) = flown(Link { attitude_us: 60_000_000, ..ALL });
    assert!(none * 2 < often, "{none} reports with one attitude in all, {often} with all");
    let words = unplaced(&onboard).unwrap_or_default();
    assert!(words.contains("no ATTITUDE or ATTITUDE_QUATERNION came"), "{words}");
    println!("{often} reports with all attitudes; {words}");
}

/// What a perfect detector finds, without ground to go by.
fn ideal(settings: &SimulateSettings) -> Vec<(i64, Detections)> {
    let (mut source, mut frame) = (Simulated::new(settings), Frame::default());
    let mut frames = Vec::new();
    while source.next_frame(&mut frame).unwrap() {
        let mut found = Detections::default();
        let target = source.truth().and_then(|truth| truth.target);
        if let Some(seen) = target.and_then(|target| target.seen) {
            let sides = [seen.left, seen.top, seen.width, seen.height];
            let [x, y, width, height] = sides.map(I28F4::from_num);
            let shifts = [Shift::default(); SHIFTS];
            let rect = Rect { x, y, width, height };
            found
                .list
                .push(Detection { rect, score: 6 << 16, frame_score: 6 << 16, shifts })
                .unwrap();
        }
        frames.push((frame.time_us, found));
    }
    frames
}

#[test]
fn angular_velocities_carry_rare_attitudes_and_what_is_lost_is_said() {
    let settings = SimulateSettings {
        kind: Manoeuvre::Hover,
        width: 320,
        height: 240,
        seconds: 8.0,
        ..SimulateSettings::default()
    };
    let frames = ideal(&settings);
    let flown = |link| reports(&settings, tracker::TrackerSettings::default(), &frames, link);
    let (often, onboard) = flown(Link { ground: false, ..ALL });
    assert!(often >= 10, "{often} reports with every attitude");
    assert_eq!(unplaced(&onboard), None);
    let sky = |rate: i64, gyroscope| {
        flown(Link { attitude_us: 1_000_000 / rate, gyroscope, ground: false })
    };
    for rate in [10, 4, 3, 2] {
        let (rare, onboard) = sky(rate, true);
        let counts = onboard.placing().counts();
        assert!(counts.placed * 10 >= counts.all() * 9, "{rate} attitudes a second: {counts:?}");
        assert!(
            rare * 10 >= often * 8,
            "{rare} reports at {rate} attitudes a second with HIGHRES_IMU, {often} with all"
        );
    }
    // With neither, what is lost is said, and why.
    let (rare, onboard) = sky(2, false);
    let words = unplaced(&onboard).unwrap_or_default();
    assert!(words.contains("attitudes came too rarely"), "{rare} of {often} reports: {words}");
    assert!(words.contains("; 2.0 attitudes a second"), "{words}");
    let counts = onboard.placing().counts();
    assert!(counts.placed * 2 < counts.all(), "{counts:?}");
    println!("{often} reports with all attitudes, {rare} with 2 a second alone; {words}");
}
