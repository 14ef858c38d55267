//! Whole encounters as on board: telemetry and frames in, MAVLink out, with what goes wrong in flight.

use lookout::detector::Detections;
use lookout::detector::detection::{Detection, SHIFTS, Shift};
use lookout::image::Rect;
use lookout::mavlink::component::{Outgoing, Trust};
use lookout::mavlink::dialect::*;
use lookout::mavlink::lookout::Lookout;
use lookout::shell::formats::camera_file::CameraFile;
use lookout::shell::link::Links;
use lookout::shell::pipeline::{DetectorArgs, Memory, ModelFile};
use lookout::shell::simulate::source::Simulated;
use lookout::shell::simulate::{FlightTelemetry, Manoeuvre, SimulateSettings, Simulator};
use lookout::shell::sources::{Frame, FrameSource};
use lookout::tracking::tracker;
use lookout::tracking::traffic::{AlertLevel, Traffic};
use mavlink_core::{MAVLinkMessageRaw, MAVLinkV2MessageRaw, MavHeader, MavlinkVersion, Message};
use std::net::UdpSocket;
use std::time::Duration;

const FRAME_US: i64 = 33_333;
const TICK_US: i64 = 10_000;
/// From a frame to its detections.
const LATENCY_US: i64 = 40_000;
const SECOND: i64 = 1_000_000;

fn parse(bytes: &[u8]) -> (MavHeader, MavMessage) {
    let mut raw = MAVLinkV2MessageRaw::new();
    raw.as_mut_slice()[..bytes.len()].copy_from_slice(bytes);
    assert_eq!(raw.raw_bytes(), bytes, "a datagram is one frame");
    assert!(raw.has_valid_crc::<MavMessage>());
    let header = MavHeader {
        system_id: raw.system_id(),
        component_id: raw.component_id(),
        sequence: raw.sequence(),
    };
    (header, MavMessage::parse(MavlinkVersion::V2, raw.message_id(), raw.payload()).unwrap())
}

fn raw(system: u8, message: &MavMessage) -> MAVLinkMessageRaw {
    let mut raw = MAVLinkV2MessageRaw::new();
    let header = MavHeader { system_id: system.into(), component_id: 1, sequence: 0 };
    raw.serialize_message(header, message);
    MAVLinkMessageRaw::V2(raw)
}

fn heartbeats<'a>(said: impl IntoIterator<Item = &'a (i64, MavMessage)>) -> Vec<(i64, MavState)> {
    let beat = |(time, message): &(i64, MavMessage)| match message {
        MavMessage::HEARTBEAT(data) => Some((*time, data.system_status)),
        _ => None,
    };
    said.into_iter().filter_map(beat).collect()
}

/// The shipped detector on a simulated collision, its messages through a real socket.
#[test]
fn a_collision_from_pixels_to_datagrams() {
    let settings = SimulateSettings { kind: Manoeuvre::Collision, ..SimulateSettings::default() };
    let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
    receiver.set_read_timeout(Some(Duration::from_millis(300))).unwrap();
    let spec = format!("udpout:{}", receiver.local_addr().unwrap());
    let mut links = Links::open(&[spec.parse().unwrap()]);
    let collector = std::thread::spawn(move || {
        let (mut frames, mut buffer, mut silent) = (Vec::new(), [0; 300], 0);
        // Frames are rendered first: the wait for the next datagram may be long.
        while silent < 40 {
            match receiver.recv(&mut buffer) {
                Ok(length) if &buffer[..length] == b"end" => break,
                Ok(length) => {
                    silent = 0;
                    frames.push(parse(&buffer[..length]));
                }
                Err(_) => silent += 1,
            }
        }
        frames
    });

    let camera = Simulator::new(&settings).camera().camera().unwrap();
    let mut telemetry = FlightTelemetry::of(&settings).peekable();
    let file = ModelFile::load(None).unwrap();
    let model = file.parse().unwrap();
    let tracks = tracker::TrackerSettings::calibrated(model.calibration());
    let mut onboard = Lookout::new(camera, tracks, Default::default(), Default::default(), 0);
    let args = DetectorArgs { threshold: Some(tracks.keep_score), ..DetectorArgs::default() };
    let config = args.config(&model, settings.width as usize, settings.height as usize).unwrap();
    let mut memory = Memory::new(&config);
    let mut detector = memory.detector(&model, config).unwrap();
    let (mut source, mut frame) = (Simulated::new(&settings), Frame::default());
    let (mut now, mut said, mut levels) = (0, Vec::new(), Vec::new());
    let mut until = |now: &mut i64, end: i64, onboard: &mut Lookout| {
        while *now < end {
            *now = (*now + TICK_US).min(end);
            while let Some((time, frame)) = telemetry.next_if(|(time, _)| time <= now) {
                onboard.receive(0, &MAVLinkMessageRaw::V2(frame), Trust::Open, time);
            }
            while let Some(message) = onboard.poll(*now) {
                links.send(&message, *now);
                said.push((*now, message.payload.parse().unwrap()));
            }
        }
    };
    let mut found = Detections::default();
    while source.next_frame(&mut frame).unwrap() {
        detector.process(frame.view(), frame.time_us, &mut found).unwrap();
        until(&mut now, frame.time_us + LATENCY_US, &mut onboard);
        let traffic = onboard.process(&found, frame.time_us, now);
        levels.push(traffic.iter().map(|traffic| traffic.level).max().unwrap_or_default());
    }
    // The frames stop; time does not.
    let stopped = now;
    until(&mut now, stopped + 3 * SECOND, &mut onboard);
    let received = collector.join().unwrap();

    // The messages sent are those that arrived, byte for byte in order; from system 1, component 196, without a gap.
    let arrived: Vec<&MavMessage> = received.iter().map(|(_, message)| message).collect();
    assert_eq!(arrived, said.iter().map(|(_, message)| message).collect::<Vec<_>>());
    for (number, (header, _)) in received.iter().enumerate() {
        assert_eq!((header.system_id, header.component_id), (1, 196));
        assert_eq!(header.sequence, number as u8);
    }
    // How far it rises is the model's; that it only rises is not.
    let highest = levels.iter().max().copied().unwrap_or_default();
    assert!(highest >= AlertLevel::Caution, "{highest:?} in {} frames", levels.len());
    let severities: Vec<u8> = said
        .iter()
        .filter_map(|(_, message)| match message {
            MavMessage::STATUSTEXT(data) if data.text.to_str().unwrap().contains("VIS") => {
                Some(data.severity as u8)
            }
            _ => None,
        })
        .collect();
    assert!(severities.is_sorted_by(|a, b| a > b), "only rising: {severities:?}");
    assert!(severities.last().is_some_and(|&s| s <= MavSeverity::MAV_SEVERITY_WARNING as u8));
    println!("{} messages, highest level {highest:?}", said.len());

    let beats = heartbeats(&said);
    assert!(
        beats.windows(2).all(|pair| pair[1].0 - pair[0].0 <= SECOND + 2 * TICK_US),
        "{beats:?}"
    );
    let stalled =
        beats.iter().find(|(time, state)| *time > stopped && *state != MavState::MAV_STATE_ACTIVE);
    let stalled = stalled.expect("the heartbeat reports it").0 - stopped;
    assert!(stalled <= SECOND, "after {stalled} us");
    println!("frames stopped, heartbeat CRITICAL {} ms later", stalled / 1000);
    let late = said.iter().filter(|(time, _)| *time > stopped + SECOND);
    for (_, message) in late {
        let old = matches!(message, MavMessage::ADSB_VEHICLE(_) | MavMessage::COLLISION(_));
        assert!(!old, "stale: {message:?}");
    }
}

/// A vehicle and another one on its way, without pictures: level flight to the north, the other straight ahead.
struct World {
    onboard: Lookout,
    now: i64,
    next_frame: i64,
    said: Vec<(i64, u8, MavMessage)>,
    seen: Vec<(i64, heapless::Vec<Traffic, 16>)>,
    system: u8,
    /// Autopilot's clock minus ours, microseconds.
    clock: i64,
    /// Microseconds that attitudes take to arrive.
    late: i64,
    waiting: Vec<(i64, MavMessage)>,
    /// Everything comes again after so many microseconds, over another link.
    doubled: Option<i64>,
    again: Vec<(i64, MavMessage)>,
    frames: bool,
    telemetry: bool,
    attitude: bool,
    /// Metres at time 0, metres a second.
    range: f64,
    closing: f64,
}

impl World {
    fn new() -> Self {
        let camera = CameraFile {
            width: 640,
            height: 480,
            fx: 560.0,
            fy: 560.0,
            cx: 319.5,
            cy: 239.5,
            kind: None,
        };
        let camera = camera.camera().unwrap();
        let tracks = tracker::TrackerSettings::default();
        Self {
            onboard: Lookout::new(camera, tracks, Default::default(), Default::default(), 0),
            now: 0,
            next_frame: 0,
            said: Vec::new(),
            seen: Vec::new(),
            system: 1,
            clock: 60 * SECOND,
            late: 5_000,
            waiting: Vec::new(),
            doubled: None,
            again: Vec::new(),
            frames: true,
            telemetry: true,
            attitude: true,
            range: 40.0,
            closing: 0.0,
        }
    }

    fn telemetry(&mut self) {
        let boot = ((self.now + self.clock) / 1000) as u32;
        let mut send = |every: i64, message: MavMessage| {
            if self.now % every == 0 {
                self.waiting.push((self.now + self.late, message));
            }
        };
        send(
            SECOND,
            MavMessage::HEARTBEAT(HEARTBEAT_DATA {
                mavtype: MavType::MAV_TYPE_QUADROTOR,
                autopilot: MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA,
                ..Default::default()
            }),
        );
        send(
            200_000,
            MavMessage::GLOBAL_POSITION_INT(GLOBAL_POSITION_INT_DATA {
                time_boot_ms: boot,
                lat: 470_000_000,
                lon: 80_000_000,
                alt: 550_000,
                relative_alt: 50_000,
                ..Default::default()
            }),
        );
        if self.attitude {
            send(
                20_000,
                MavMessage::ATTITUDE_QUATERNION(ATTITUDE_QUATERNION_DATA {
                    time_boot_ms: boot,
                    q1: 1.0,
                    ..Default::default()
                }),
            );
        }
    }

    /// Detections of the present frame.
    fn detections(&self) -> Detections {
        let range = self.range - self.closing * self.now as f64 / 1e6;
        let size = 560.0 / range.max(1.0);
        let number = |value: f64| fixed::types::I28F4::from_num(value);
        let rect = Rect {
            x: number(320.0 - size / 2.0),
            y: number(240.0 - size / 2.0),
            width: number(size),
            height: number(size),
        };
        let mut found = Detections::default();
        let one = Detection {
            rect,
            score: 5 << 16,
            frame_score: 5 << 16,
            shifts: [Shift::default(); SHIFTS],
        };
        assert!(found.list.push(one).is_ok());
        found
    }

    fn fly(&mut self, seconds: f64) {
        let end = self.now + (seconds * 1e6) as i64;
        while self.now < end {
            self.now += TICK_US;
            if self.telemetry {
                self.telemetry();
            }
            for (_, message) in self.again.extract_if(.., |(due, _)| *due <= self.now) {
                self.onboard.receive(1, &raw(self.system, &message), Trust::Open, self.now);
            }
            for (due, message) in self.waiting.extract_if(.., |(due, _)| *due <= self.now) {
                self.onboard.receive(0, &raw(self.system, &message), Trust::Open, self.now);
                self.again.extend(self.doubled.map(|delay| (due + delay, message)));
            }
            if self.now >= self.next_frame + LATENCY_US {
                if self.frames {
                    let traffic =
                        self.onboard.process(&self.detections(), self.next_frame, self.now);
                    self.seen.push((self.now, traffic));
                }
                self.next_frame += FRAME_US;
            }
            while let Some(Outgoing { payload, system_id, .. }) = self.onboard.poll(self.now) {
                self.said.push((self.now, system_id, payload.parse().unwrap()));
            }
        }
    }

    /// When the first message after `since` came that `is` one; microseconds from `since`.
    fn after(&self, since: i64, is: impl Fn(u8, &MavMessage) -> bool) -> Option<i64> {
        let mut said = self.said.iter();
        said.find(|(time, id, m)| *time > since && is(*id, m)).map(|(time, ..)| time - since)
    }

    fn adsb(&self, since: i64) -> Option<i64> {
        self.after(since, |_, message| matches!(message, MavMessage::ADSB_VEHICLE(_)))
    }

    /// Whether the last frame's object has a direction in the world.
    fn in_world(&self) -> bool {
        self.seen.last().is_some_and(|(_, t)| t.first().is_some_and(|t| t.ned.is_some()))
    }
}

#[test]
fn a_link_cut_for_ten_seconds() {
    let mut world = World::new();
    world.fly(3.0);
    assert!(world.in_world() && world.adsb(0).is_some());
    world.telemetry = false;
    let cut = world.now;
    world.fly(10.0);
    // No direction from an old attitude, no place from an old position.
    assert!(!world.in_world());
    assert_eq!(world.adsb(cut + 3 * SECOND), None);
    assert!(world.onboard.component().autopilot().is_none());
    world.telemetry = true;
    let back = world.now;
    world.fly(3.0);
    let recovered = world.adsb(back).expect("traffic is reported again");
    assert!(world.in_world() && recovered <= 2 * SECOND, "{recovered}");
    println!("link back, traffic reported {} ms later", recovered / 1000);
}

#[test]
fn an_autopilot_that_restarts_with_another_system_id() {
    let mut world = World::new();
    world.fly(3.0);
    (world.system, world.clock) = (42, 2 * SECOND - world.now);
    let change = world.now;
    world.fly(8.0);
    let recovered = world.after(change, |id, m| id == 42 && matches!(m, MavMessage::HEARTBEAT(_)));
    let recovered = recovered.expect("our heartbeat follows");
    assert!(recovered <= 5 * SECOND, "{recovered}");
    assert!(world.in_world());
    println!("other system id, followed {} ms later", recovered / 1000);
}

/// One that was away for longer than it takes to be called lost: whatever answers then is followed at once.
#[test]
fn an_autopilot_that_comes_back_under_another_id() {
    let mut world = World::new();
    world.fly(3.0);
    world.telemetry = false;
    world.fly(5.0);
    assert!(world.onboard.component().autopilot().is_none() && !world.in_world());
    (world.system, world.clock, world.telemetry) = (42, 2 * SECOND - world.now, true);
    let back = world.now;
    world.fly(4.0);
    let followed = world.after(back, |id, m| id == 42 && matches!(m, MavMessage::HEARTBEAT(_)));
    let followed = followed.expect("our heartbeat follows");
    let reported = world.adsb(back).expect("traffic is reported again");
    assert!(world.in_world() && followed.max(reported) <= 2 * SECOND, "{followed} {reported}");
    println!("another system id after 5 s, followed {} ms later", followed / 1000);
}

/// Every message comes twice, over another link and later: as if it came once.
#[test]
fn doubled_streams() {
    let count = |world: &World| {
        let adsb = |(_, _, m): &&(i64, u8, MavMessage)| matches!(m, MavMessage::ADSB_VEHICLE(_));
        world.said.iter().filter(adsb).count()
    };
    let mut once = World::new();
    once.fly(10.0);
    for delay in [0, 30_000, 400_000] {
        let mut twice = World::new();
        twice.doubled = Some(delay);
        twice.fly(10.0);
        assert!(twice.in_world());
        let (one, two) = (count(&once), count(&twice));
        assert!(one > 5 && one.abs_diff(two) <= 1, "{one} reports, {two} of doubled streams");
        let north = |t: &[Traffic]| t[0].ned.is_none_or(|ned| ned.x.to_num::<f64>() > 0.999);
        let there = twice.seen.iter().filter(|(_, traffic)| !traffic.is_empty());
        assert!(there.clone().all(|(_, traffic)| north(traffic)), "wrong directions");
        let warned = there.clone().any(|(_, t)| t.iter().any(|t| t.level > AlertLevel::Traffic));
        assert!(!warned, "the other one keeps its distance");
    }
}

#[test]
fn an_autopilot_whose_clock_jumps() {
    for jump in [-59 * SECOND, 3600 * SECOND] {
        let mut world = World::new();
        world.fly(3.0);
        world.clock += jump;
        let changed = world.now;
        world.fly(2.0);
        let north = |traffic: &[Traffic]| {
            traffic.first().and_then(|t| t.ned).is_some_and(|ned| ned.x.to_num::<f64>() > 0.999)
        };
        let wrong = world.seen.iter().rfind(|(time, t)| *time > changed && !north(t));
        let recovered = wrong.map_or(0, |(time, _)| time - changed);
        assert!(recovered <= SECOND, "jump {jump}: {recovered}");
        assert!(world.seen.iter().filter(|(time, _)| *time > changed + SECOND).count() > 20);
        println!(
            "clock jumped by {} s, directions right after {} ms",
            jump / SECOND,
            recovered / 1000
        );
    }
}

#[test]
fn attitudes_that_are_late_or_missing() {
    // On a collision course, contact at 8 s.
    for (late, attitude) in [(5_000, true), (150_000, true), (400_000, true), (5_000, false)] {
        let mut world = World::new();
        (world.late, world.attitude, world.closing) = (late, attitude, 5.0);
        world.fly(7.0);
        let warned =
            world.seen.iter().find(|(_, t)| t.iter().any(|t| t.level == AlertLevel::Warning));
        let (time, _) =
            warned.unwrap_or_else(|| panic!("late {late}, there {attitude}: no warning"));
        let before = 8.0 - *time as f64 / 1e6;
        assert!(before >= 2.0, "late {late}, there {attitude}: {before}");
        assert!(attitude || !world.in_world());
        println!("attitude {late} us late, there: {attitude}: warned {before:.1} s before contact");
    }
}

/// Random bytes under right checksums among good telemetry: the lookout goes on as before.
#[test]
fn strange_frames_among_the_good_ones() {
    let mut world = World::new();
    world.fly(2.0);
    let mut state = 1u64;
    for step in 0..500 {
        for _ in 0..5 {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            let bits = (state >> 20) as u32;
            let length = bits as usize % 200;
            let mut frame = MAVLinkV2MessageRaw::new();
            let id = bits >> 8 & 0x1ff;
            let bytes = frame.as_mut_slice();
            bytes[..10].copy_from_slice(&[
                0xfd,
                length as u8,
                0,
                0,
                step as u8,
                9,
                1,
                id as u8,
                (id >> 8) as u8,
                0,
            ]);
            for (at, byte) in bytes[10..10 + length].iter_mut().enumerate() {
                *byte = (state >> (at % 48)) as u8;
            }
            let crc =
                mavlink_core::calculate_crc(&bytes[1..10 + length], MavMessage::extra_crc(id));
            bytes[10 + length..12 + length].copy_from_slice(&crc.to_le_bytes());
            world.onboard.receive(1, &MAVLinkMessageRaw::V2(frame), Trust::Open, world.now);
        }
        world.fly(0.01);
    }
    assert!(world.in_world());
    assert_eq!(world.onboard.component().autopilot().map(|own| own.system_id), Some(1));
    let warned = world.seen.iter().any(|(_, t)| t.iter().any(|t| t.level > AlertLevel::Traffic));
    assert!(!warned, "the other one keeps its distance");
    assert!(world.adsb(6 * SECOND).is_some());
    println!("500 strange frames a second for 5 s: {:?}", world.onboard.component().counters());
}
