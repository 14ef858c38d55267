use super::*;
use crate::message::tests::{any_traffic, traffic};
use crate::message::{Blind, payload::Payload};
use crate::traffic::Estimate;
use mavlink::MAVLinkV2MessageRaw;
use mavlink::dialects::ardupilotmega::*;
use mavlink::types::CharArray;
use proptest::prelude::*;
use std::vec::Vec;

const SECOND: i64 = 1_000_000;
const STEP: i64 = 20_000;

fn raw<D: MessageData>(system: u8, component: u8, data: &D) -> MAVLinkMessageRaw {
    MAVLinkMessageRaw::V2(Payload::new(data).frame(system, component, 0, false))
}

fn autopilot_heartbeat() -> HEARTBEAT_DATA {
    HEARTBEAT_DATA {
        custom_mode: 0,
        mavtype: MavType::MAV_TYPE_QUADROTOR,
        autopilot: MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA,
        base_mode: MavModeFlag::empty(),
        system_status: MavState::MAV_STATE_ACTIVE,
        mavlink_version: 3,
    }
}

fn position(boot_ms: u32) -> GLOBAL_POSITION_INT_DATA {
    GLOBAL_POSITION_INT_DATA {
        time_boot_ms: boot_ms,
        lat: 473_769_000,
        lon: 85_417_000,
        alt: 500_000,
        relative_alt: 50_000,
        vx: 1000,
        vy: 0,
        vz: 0,
        hdg: 0,
    }
}

fn attitude(boot_ms: u32) -> ATTITUDE_QUATERNION_DATA {
    ATTITUDE_QUATERNION_DATA {
        time_boot_ms: boot_ms,
        q1: 1.0,
        q2: 0.0,
        q3: 0.0,
        q4: 0.0,
        rollspeed: 0.0,
        pitchspeed: 0.0,
        yawspeed: 0.0,
        repr_offset_q: [0.0; 4],
    }
}

/// A component with an autopilot of system 42 on link 1, which answers as one does.
struct Flight {
    component: Component,
    now: i64,
    /// The autopilot's time since its start minus ours, in milliseconds.
    boot: i64,
    autopilot: Option<u8>,
    frames: bool,
    seen: Vec<Traffic>,
    health: Health,
    sent: Vec<(i64, Outgoing)>,
    events: Vec<Event>,
}

impl Flight {
    fn new(config: Config, parameters: Parameters) -> Self {
        Self {
            component: Component::new(config, parameters, 0),
            now: 0,
            boot: 60_000,
            autopilot: Some(42),
            frames: true,
            seen: Vec::new(),
            health: Health::default(),
            sent: Vec::new(),
            events: Vec::new(),
        }
    }

    fn hear<D: MessageData>(&mut self, system: u8, component: u8, data: &D) {
        self.component.receive(1, &raw(system, component, data), Trust::Open, self.now);
    }

    fn drain(&mut self) {
        while let Some(message) = self.component.poll(self.now) {
            self.sent.push((self.now, message));
        }
        while let Some(event) = self.component.event() {
            self.events.push(event);
        }
    }

    fn fly(&mut self, seconds: f64) {
        let end = self.now + (seconds * 1e6) as i64;
        while self.now < end {
            if let Some(system) = self.autopilot {
                let boot = (self.now / 1000 + self.boot) as u32;
                if self.now % SECOND == 0 {
                    self.hear(system, 1, &autopilot_heartbeat());
                }
                if self.now % (SECOND / 5) == 0 {
                    self.hear(system, 1, &position(boot));
                }
                self.hear(system, 1, &attitude(boot));
            }
            if self.frames && self.now % (2 * STEP) == 0 {
                self.health.frames += 1;
                self.component.observe(&self.seen, self.health, self.now, self.now);
            }
            self.drain();
            self.now += STEP;
        }
    }

    fn of<D: MessageData>(&self) -> Vec<(i64, Outgoing, D)> {
        let of_kind = self.sent.iter().filter(|(_, m)| m.payload.id() == D::ID);
        of_kind
            .map(|&(time, m)| {
                (time, m, D::deser(mavlink::MavlinkVersion::V2, m.payload.bytes()).unwrap())
            })
            .collect()
    }

    /// The acknowledgements since the last call: speaker, command, result, to whom.
    fn acks(&mut self) -> Vec<(u8, u16, u8, u8, u8)> {
        self.drain();
        let all = core::mem::take(&mut self.sent);
        all.iter()
            .filter(|(_, m)| m.payload.id() == 77)
            .map(|(_, m)| {
                let fields = Fields(m.payload.bytes());
                let command = u16::from_le_bytes(fields.bytes(0));
                (m.component_id, command, fields.byte(2), fields.byte(8), fields.byte(9))
            })
            .collect()
    }
}

fn flight() -> Flight {
    Flight::new(Config::default(), Parameters::default())
}

fn with(values: &[(Parameter, f32)]) -> Flight {
    let mut parameters = Parameters::default();
    for &(parameter, value) in values {
        assert!(parameters.set(parameter, value));
    }
    Flight::new(Config::default(), parameters)
}

/// COMMAND_LONG with any number, by hand.
fn command(number: u16, p1: f32, p2: f32, system: u8, component: u8) -> MAVLinkMessageRaw {
    let data = COMMAND_LONG_DATA {
        param1: p1,
        param2: p2,
        param3: 0.0,
        param4: 0.0,
        param5: 0.0,
        param6: 0.0,
        param7: 0.0,
        command: MavCmd::MAV_CMD_NAV_WAYPOINT,
        target_system: system,
        target_component: component,
        confirmation: 1,
    };
    let mut frame = Payload::new(&data).frame(255, 190, 0, false);
    frame.as_mut_slice()[10 + 28..10 + 30].copy_from_slice(&number.to_le_bytes());
    MAVLinkMessageRaw::V2(frame)
}

#[test]
fn the_system_id_is_the_autopilot_s() {
    let mut flight = flight();
    flight.autopilot = None;
    flight.fly(1.0);
    assert!(flight.sent.iter().all(|(_, m)| m.system_id == 1 && m.component_id == 196));
    // A ground station and another component are no autopilots.
    let station =
        HEARTBEAT_DATA { autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID, ..autopilot_heartbeat() };
    flight.hear(255, 190, &station);
    assert_eq!(flight.component.system_id(), 1);
    flight.autopilot = Some(42);
    flight.fly(2.0);
    assert_eq!(flight.component.system_id(), 42);
    assert!(flight.events.contains(&Event::Found { system_id: 42, autopilot: 3 }));
    // A second vehicle in the same air is left alone.
    flight.hear(7, 1, &autopilot_heartbeat());
    assert_eq!(flight.component.system_id(), 42);
}

#[test]
fn the_heartbeat_tells_a_stop_of_frames_within_a_second() {
    let mut flight = flight();
    flight.fly(3.0);
    let statuses: Vec<_> =
        flight.of::<HEARTBEAT_DATA>().iter().map(|h| h.2.system_status as u8).collect();
    assert_eq!(statuses, [4, 4, 4]);
    flight.sent.clear();
    flight.frames = false;
    let stopped = flight.now;
    flight.fly(3.0);
    let first =
        flight.of::<HEARTBEAT_DATA>().into_iter().find(|h| h.2.system_status as u8 == 5).unwrap();
    assert!(first.0 - stopped < SECOND, "{}", first.0 - stopped);
    let texts = flight.of::<STATUSTEXT_DATA>();
    assert!(texts.iter().any(|t| t.2.text.to_str().unwrap().contains("no pictures")), "{texts:?}");
    flight.frames = true;
    flight.health.blind = Blind::GLARE;
    flight.sent.clear();
    flight.fly(1.0);
    let last = flight.of::<HEARTBEAT_DATA>().pop().unwrap().2;
    assert_eq!((last.system_status as u8, last.custom_mode), (3, 2));
}

#[test]
fn traffic_is_told_at_its_rates_and_not_when_stale() {
    let mut flight = with(&[(Parameter::Proximity, 1.0), (Parameter::ProximityMax, 400.0)]);
    flight.seen.push(traffic(3));
    flight.fly(10.0);
    let count =
        |flight: &Flight, id| flight.sent.iter().filter(|(_, m)| m.payload.id() == id).count();
    assert!((19..=21).contains(&count(&flight, 246)), "{}", count(&flight, 246));
    assert!((98..=101).contains(&count(&flight, 330)), "{}", count(&flight, 330));
    assert_eq!(count(&flight, 11037), 0);
    assert_eq!(count(&flight, 247), 0, "no threat yet");
    assert_eq!(count(&flight, 251), 50);
    let obstacle = flight.of::<OBSTACLE_DISTANCE_DATA>().pop().unwrap();
    assert_eq!(obstacle.2.distances[9], 30_000);
    assert_eq!(obstacle.1.to, Destination::Link(1), "for the autopilot alone");
    // Nothing seen: 330 goes on, empty.
    flight.seen.clear();
    flight.sent.clear();
    flight.fly(1.0);
    assert_eq!(count(&flight, 246), 0);
    assert_eq!(flight.of::<OBSTACLE_DISTANCE_DATA>().pop().unwrap().2.distances, [65535; 72]);
    // Frames stop: what was seen is stale.
    flight.seen.push(traffic(3));
    flight.fly(1.0);
    flight.frames = false;
    flight.fly(0.8);
    flight.sent.clear();
    flight.fly(3.0);
    assert_eq!((count(&flight, 246), count(&flight, 330)), (0, 0));
}

#[test]
fn one_kind_of_proximity_and_none_by_default() {
    let mut flight = with(&[(Parameter::Proximity, 2.0)]);
    flight.fly(2.0);
    assert!(flight.of::<OBSTACLE_DISTANCE_DATA>().is_empty());
    let points = flight.of::<OBSTACLE_DISTANCE_3D_DATA>();
    assert!(points.len() >= 19 && points.iter().all(|p| p.2.x > p.2.max_distance));
    let stamps: Vec<_> = points.iter().map(|p| p.2.time_boot_ms).collect();
    assert!(stamps.windows(2).all(|pair| pair[0] < pair[1]));
    let mut plain = self::flight();
    plain.seen.push(traffic(1));
    plain.fly(2.0);
    assert!(plain.sent.iter().all(|(_, m)| ![330, 11037].contains(&m.payload.id())));
}

#[test]
fn collision_yields_to_the_autopilot_s_own() {
    let mut flight = flight();
    let time_to_contact = Some(Estimate { value: I16F16::from_num(9), sigma: I16F16::ONE });
    flight.seen.push(Traffic { level: Level::Warning, time_to_contact, ..traffic(5) });
    flight.fly(5.0);
    let told = flight.of::<COLLISION_DATA>();
    assert!((4..=5).contains(&told.len()) && told[0].2.threat_level as u8 == 2);
    let own = told[0].2.clone();
    assert_eq!(flight.of::<ADSB_VEHICLE_DATA>()[0].2.ICAO_address, own.id);
    assert_eq!(
        flight.of::<STATUSTEXT_DATA>().iter().filter(|t| t.2.severity as u8 == 2).count(),
        1
    );
    flight.sent.clear();
    flight.hear(42, 1, &own);
    flight.fly(9.0);
    assert!(flight.of::<COLLISION_DATA>().is_empty());
    flight.fly(3.0);
    assert!(!flight.of::<COLLISION_DATA>().is_empty());
    // The danger is over: told as such, then no more.
    flight.seen[0].level = Level::None;
    flight.sent.clear();
    flight.fly(10.0);
    let over = flight.of::<COLLISION_DATA>();
    assert!((4..=6).contains(&over.len()) && over.iter().all(|c| c.2.threat_level as u8 == 0));
}

#[test]
fn commands_are_answered_to_their_sender() {
    let mut flight = flight();
    flight.fly(2.0);
    flight.acks();
    for (number, p1, p2, system, component, want) in [
        (512, 148.0, 0.0, 42, 196, Some(0)),
        (512, 300.0, 0.0, 0, 0, Some(0)),
        (512, 396.0, 0.0, 42, 0, Some(0)),
        (512, 397.0, 0.0, 42, 196, Some(3)),
        (512, 259.0, 0.0, 42, 196, Some(3)),
        (512, f32::NAN, 0.0, 42, 196, Some(3)),
        (511, 246.0, 200_000.0, 42, 196, Some(0)),
        (511, 330.0, 100_000.0, 42, 196, Some(2)),
        (511, 0.0, -1.0, 42, 196, Some(2)),
        (511, 24.0, 1.0, 42, 196, Some(3)),
        (511, f32::INFINITY, 1.0, 42, 196, Some(2)),
        (400, 1.0, 0.0, 42, 196, Some(3)),
        (65_000, 0.0, 0.0, 42, 196, Some(3)),
        (400, 1.0, 0.0, 42, 0, None),
        (400, 1.0, 0.0, 42, 1, None),
        (512, 148.0, 0.0, 7, 196, None),
        (512, 148.0, 0.0, 7, 0, None),
    ] {
        flight.component.receive(
            5,
            &command(number, p1, p2, system, component),
            Trust::Open,
            flight.now,
        );
        let acks = flight.acks();
        let want: Vec<_> = want.map(|result| (196, number, result, 255, 190)).into_iter().collect();
        assert_eq!(acks, want, "{number} {p1} to {system}/{component}");
    }
    flight.seen.push(traffic(1));
    flight.fly(10.0);
    let faster = flight.of::<ADSB_VEHICLE_DATA>().len();
    assert!((49..=51).contains(&faster), "five a second: {faster}");
    flight.component.receive(5, &command(512, 148.0, 0.0, 42, 196), Trust::Open, flight.now);
    flight.sent.clear();
    flight.drain();
    let version = flight.of::<AUTOPILOT_VERSION_DATA>().pop().unwrap();
    assert_eq!(version.1.to, Destination::Link(5));
}

#[test]
fn parameters_are_listed_read_and_set() {
    let mut flight = flight();
    flight.fly(1.0);
    flight.sent.clear();
    flight.hear(255, 190, &PARAM_REQUEST_LIST_DATA { target_system: 42, target_component: 196 });
    flight.drain();
    let all = flight.of::<PARAM_VALUE_DATA>();
    assert_eq!(
        all.iter().map(|p| p.2.param_index).collect::<Vec<_>>(),
        (0..12).collect::<Vec<_>>()
    );
    assert!(all.iter().all(|p| p.2.param_count == 12 && p.2.param_type as u8 == 9));
    let set = |value, name: &str, kind, component| PARAM_SET_DATA {
        param_value: value,
        target_system: 42,
        target_component: component,
        param_id: CharArray::from(name),
        param_type: kind,
    };
    let real = MavParamType::MAV_PARAM_TYPE_REAL32;
    for (data, echo, taken) in [
        (set(0.35, "LK_WINGSPAN", real, 196), Some(0.35), true),
        (set(0.35, "LK_WINGSPAN", real, 196), Some(0.35), false),
        (set(900.0, "LK_WINGSPAN", real, 196), Some(0.35), false),
        (set(f32::NAN, "LK_WINGSPAN", real, 196), Some(0.35), false),
        (set(2.0, "LK_WINGSPAN", MavParamType::MAV_PARAM_TYPE_INT32, 196), Some(0.35), false),
        (set(2.0, "LK_WINGSPAN", real, 1), None, false),
        (set(2.0, "WP_SPEED", real, 196), None, false),
    ] {
        flight.sent.clear();
        flight.events.clear();
        flight.hear(255, 190, &data);
        flight.drain();
        let told: Vec<_> =
            flight.of::<PARAM_VALUE_DATA>().iter().map(|p| p.2.param_value).collect();
        assert_eq!(told, echo.into_iter().collect::<Vec<_>>(), "{data:?}");
        assert_eq!(
            flight.events.contains(&Event::Parameter(Parameter::Wingspan)),
            taken,
            "{data:?}"
        );
    }
    for (index, name) in [(-1, "LK_WINGSPAN"), (1, "")] {
        flight.sent.clear();
        flight.hear(
            255,
            190,
            &PARAM_REQUEST_READ_DATA {
                param_index: index,
                target_system: 42,
                target_component: 196,
                param_id: CharArray::from(name),
            },
        );
        flight.drain();
        assert_eq!(flight.of::<PARAM_VALUE_DATA>()[0].2.param_value, 0.35);
    }
}

#[test]
fn without_the_signature_nobody_commands() {
    let mut flight = flight();
    flight.fly(1.0);
    flight.acks();
    let set = PARAM_SET_DATA {
        param_value: 9.0,
        target_system: 42,
        target_component: 196,
        param_id: CharArray::from("LK_WINGSPAN"),
        param_type: MavParamType::MAV_PARAM_TYPE_REAL32,
    };
    for (trust, taken) in [(Trust::Unsigned, false), (Trust::Forged, false), (Trust::Signed, true)]
    {
        flight.component.receive(0, &command(512, 148.0, 0.0, 42, 196), trust, flight.now);
        flight.component.receive(0, &raw(255, 190, &set), trust, flight.now);
        assert_eq!(flight.acks().len(), usize::from(taken), "{trust:?}");
        assert_eq!(flight.component.parameters().wire(Parameter::Wingspan) == 9.0, taken);
    }
    assert_eq!((flight.component.counters().refused, flight.component.counters().forged), (2, 2));
}

#[test]
fn a_lost_autopilot_and_another_one() {
    let mut flight = flight();
    flight.seen.push(traffic(1));
    flight.fly(3.0);
    flight.autopilot = None;
    flight.fly(6.0);
    assert!(flight.events.contains(&Event::Lost));
    flight.sent.clear();
    flight.fly(1.0);
    assert!(flight.of::<ADSB_VEHICLE_DATA>().is_empty(), "no place without a vehicle");
    assert_eq!(flight.component.system_id(), 42, "and still its id");
    flight.autopilot = Some(43);
    flight.sent.clear();
    flight.fly(2.0);
    assert_eq!(flight.component.system_id(), 43);
    assert!(!flight.of::<ADSB_VEHICLE_DATA>().is_empty());
    assert!(flight.sent.iter().skip(5).all(|(_, m)| m.system_id == 43));
}

#[test]
fn a_restarted_autopilot_is_asked_again() {
    let mut flight = flight();
    flight.fly(5.0);
    flight.sent.clear();
    flight.fly(5.0);
    assert!(flight.of::<COMMAND_LONG_DATA>().is_empty(), "what comes is not asked for");
    flight.boot = -flight.now / 1000;
    flight.hear(42, 1, &SYSTEM_TIME_DATA { time_unix_usec: 0, time_boot_ms: 1 });
    flight.drain();
    assert!(flight.events.contains(&Event::Restarted));
    let asked: Vec<_> = flight
        .of::<COMMAND_LONG_DATA>()
        .iter()
        .map(|c| (c.2.command as u32, c.2.param1, c.2.target_system))
        .collect();
    assert_eq!(asked, [(511, 31.0, 42), (511, 33.0, 42), (511, 2.0, 42)]);
}

#[test]
fn attitudes_bear_our_time() {
    let mut flight = flight();
    flight.fly(3.0);
    flight.events.clear();
    // Measured 100 ms before it is heard; the clocks are known by now.
    let boot = (flight.now / 1000 + flight.boot - 100) as u32;
    flight.hear(42, 1, &attitude(boot));
    flight.drain();
    assert_eq!(
        flight.events,
        [Event::Attitude { time_us: flight.now - 100_000, quaternion: [1 << 30, 0, 0, 0] }]
    );
    // Euler angles give the same rotation; they count only where there is nothing better.
    flight.now += 3 * SECOND;
    flight.events.clear();
    let euler = ATTITUDE_DATA {
        time_boot_ms: boot + 3000,
        roll: 0.3,
        pitch: -0.2,
        yaw: 2.5,
        rollspeed: 0.0,
        pitchspeed: 0.0,
        yawspeed: 0.0,
    };
    flight.hear(42, 1, &euler);
    flight.drain();
    let Some(&Event::Attitude { quaternion, .. }) = flight.events.first() else {
        panic!("{:?}", flight.events)
    };
    let half = |angle: f64| ((angle / 2.0).cos(), (angle / 2.0).sin());
    let ((cr, sr), (cp, sp), (cy, sy)) = (half(0.3), half(-0.2), half(2.5));
    let want = [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ];
    for (bits, want) in quaternion.iter().zip(want) {
        assert!((f64::from(*bits) / f64::from(1 << 30) - want).abs() < 1e-6, "{quaternion:?}");
    }
    let nan = ATTITUDE_DATA { roll: f32::NAN, ..euler };
    flight.hear(42, 1, &nan);
    assert_eq!(flight.component.counters().malformed, 1);
}

#[test]
fn time_is_synchronised_both_ways() {
    let mut flight = flight();
    flight.fly(1.0);
    // A question from another component, as the autopilot asks.
    flight.sent.clear();
    flight.hear(42, 1, &TIMESYNC_DATA { tc1: 0, ts1: 777, target_system: 0, target_component: 0 });
    flight.hear(42, 1, &TIMESYNC_DATA { tc1: 0, ts1: 778, target_system: 42, target_component: 1 });
    flight.drain();
    let answers: Vec<_> =
        flight.of::<TIMESYNC_DATA>().into_iter().filter(|t| t.2.tc1 != 0).collect();
    assert_eq!(answers.len(), 1);
    assert_eq!(
        (answers[0].2.ts1, answers[0].2.tc1, answers[0].2.target_system),
        (777, flight.now * 1000, 42)
    );
    for _ in 0..40 {
        flight.sent.clear();
        flight.fly(1.0);
        for (sent_us, _, question) in flight.of::<TIMESYNC_DATA>() {
            assert_eq!(question.ts1, sent_us * 1000);
            let theirs = (sent_us + flight.boot * 1000) * 1000;
            flight.hear(
                42,
                1,
                &TIMESYNC_DATA {
                    tc1: theirs,
                    ts1: question.ts1,
                    target_system: 0,
                    target_component: 0,
                },
            );
        }
    }
    // Answers came up to 200 ms late, because they were given after the loop; the quickest ones count.
    let (offset, error) = flight.component.clock().offset_us().unwrap();
    assert!((offset - flight.boot * 1000).abs() <= error + STEP, "{offset} {error}");
}

#[test]
fn the_camera_draws_a_box_that_can_be_turned_off() {
    let camera = Some(Camera { component_id: 100, width: 640, height: 480 });
    let mut flight = Flight::new(Config { camera, ..Config::default() }, Parameters::default());
    flight.seen.extend([traffic(1), Traffic { level: Level::Warning, ..traffic(2) }]);
    flight.fly(2.0);
    let boxes = flight.of::<CAMERA_TRACKING_IMAGE_STATUS_DATA>();
    assert!(boxes.len() >= 9 && boxes.iter().all(|b| b.1.component_id == 100));
    let beats = flight.of::<HEARTBEAT_DATA>();
    assert!(beats.iter().any(|h| h.1.component_id == 100 && h.2.mavtype as u8 == 30));
    flight.acks();
    for (number, p1, ack) in [(512, 259.0, 0), (2010, 0.0, 0), (2004, 0.5, 0), (2010, 0.0, 0)] {
        flight.component.receive(0, &command(number, p1, 0.5, 42, 100), Trust::Open, flight.now);
        assert_eq!(flight.acks(), [(100, number, ack, 255, 190)]);
    }
    flight.fly(1.0);
    assert!(flight.of::<CAMERA_TRACKING_IMAGE_STATUS_DATA>().is_empty());
}

#[test]
fn a_flood_is_bounded() {
    let mut flight = flight();
    flight.fly(1.0);
    for _ in 0..10_000 {
        flight.component.receive(0, &command(512, 148.0, 0.0, 42, 196), Trust::Open, flight.now);
        flight.hear(
            255,
            190,
            &PARAM_REQUEST_LIST_DATA { target_system: 42, target_component: 196 },
        );
    }
    let mut answers = 0;
    while flight.component.poll(flight.now).is_some() {
        answers += 1;
    }
    assert!(answers <= 2 * OUTBOX, "{answers}");
    assert!(flight.component.counters().overflow > 9_000);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    /// Frames of every kind we read with any payload, and any traffic, never panic; the outbox always runs dry.
    #[test]
    fn anything_heard_or_seen(
        frames in prop::collection::vec((0usize..16, any::<u32>(), prop::collection::vec(any::<u8>(), 0..255), any::<[u8; 3]>()), 0..40),
        objects in prop::collection::vec(any_traffic(), 0..20),
        times in prop::collection::vec(any::<i64>(), 1..8),
    ) {
        const KINDS: [u32; 15] = [0, 2, 20, 21, 23, 30, 31, 33, 75, 76, 77, 111, 247, 246, 330];
        let camera = Some(Camera { component_id: 100, width: 0, height: 65535 });
        let mut parameters = Parameters::default();
        parameters.set(Parameter::Proximity, 2.0);
        let mut component = Component::new(Config { camera, ..Config::default() }, parameters, times[0]);
        component.receive(0, &raw(1, 1, &autopilot_heartbeat()), Trust::Open, times[0]);
        for &now in &times {
            for (kind, id, payload, [system, sender, link]) in &frames {
                let id = KINDS.get(*kind).copied().unwrap_or(*id);
                let [low, middle, high, _] = id.to_le_bytes();
                let mut bytes = [0; mavlink::consts::MAX_FRAME_SIZE];
                let length = payload.len() as u8;
                bytes[..10].copy_from_slice(&[0xFD, length, 0, 0, 0, system % 3, sender % 3, low, middle, high]);
                bytes[10..10 + payload.len()].copy_from_slice(payload);
                let frame = MAVLinkMessageRaw::V2(MAVLinkV2MessageRaw::from_bytes_unparsed(bytes));
                component.receive(*link, &frame, Trust::Open, now);
            }
            component.observe(&objects, Health::default(), now, now);
            let mut sent = 0;
            while component.poll(now).is_some() {
                sent += 1;
                prop_assert!(sent < 1000);
            }
            while component.event().is_some() {}
        }
    }
}
