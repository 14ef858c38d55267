//! Tests: messages of the vehicle in, reports of traffic out.

mod gimbal;
mod services;
mod vehicles;

use super::*;
use crate::mavlink::dialect::*;
use crate::mavlink::messages::payload::Payload;
use crate::mavlink::messages::tests::traffic;
use crate::mavlink::messages::{Blind, adsb};
use crate::tracking::traffic::Estimate;
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
struct TestFlight {
    component: Component,
    now: i64,
    /// The autopilot's time since its start minus ours, in milliseconds.
    boot: i64,
    autopilot: Option<u8>,
    frames: bool,
    seen: Vec<Traffic>,
    health: Health,
    sent: Vec<(i64, Outgoing)>,
    events: Vec<ComponentEvent>,
}

impl TestFlight {
    fn new(config: ComponentConfig, parameters: Parameters) -> Self {
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
                (time, m, D::deser(mavlink_core::MavlinkVersion::V2, m.payload.bytes()).unwrap())
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
                let fields = PayloadFields(m.payload.bytes());
                let command = u16::from_le_bytes(fields.bytes(0));
                (m.component_id, command, fields.byte(2), fields.byte(8), fields.byte(9))
            })
            .collect()
    }
}

fn flight() -> TestFlight {
    TestFlight::new(ComponentConfig::default(), Parameters::default())
}

fn with(values: &[(Parameter, f32)]) -> TestFlight {
    let mut parameters = Parameters::default();
    for &(parameter, value) in values {
        assert!(parameters.set(parameter, value));
    }
    TestFlight::new(ComponentConfig::default(), parameters)
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
    assert!(flight.events.contains(&ComponentEvent::Found { system_id: 42, autopilot: 3 }));
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
    assert_eq!((last.system_status as u8, last.custom_mode), (5, 2));
}

#[test]
fn traffic_is_told_at_its_rates_and_not_when_stale() {
    let mut flight = with(&[(Parameter::Proximity, 1.0), (Parameter::ProximityMax, 400.0)]);
    flight.seen.push(traffic(3));
    flight.fly(10.0);
    let count =
        |flight: &TestFlight, id| flight.sent.iter().filter(|(_, m)| m.payload.id() == id).count();
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
    flight.seen.push(Traffic { level: AlertLevel::Warning, time_to_contact, ..traffic(5) });
    flight.fly(5.0);
    let reported = flight.of::<COLLISION_DATA>();
    assert!((4..=5).contains(&reported.len()) && reported[0].2.threat_level as u8 == 2);
    let own = reported[0].2.clone();
    assert_eq!(flight.of::<ADSB_VEHICLE_DATA>()[0].2.ICAO_address, own.id);
    assert_eq!(
        flight.of::<STATUSTEXT_DATA>().iter().filter(|t| t.2.severity as u8 == 2).count(),
        1
    );
    flight.sent.clear();
    // About another object, and about ours that it is none: both leave our own.
    flight.hear(42, 1, &COLLISION_DATA { id: own.id + 1, ..own.clone() });
    let none = MavCollisionThreatLevel::MAV_COLLISION_THREAT_LEVEL_NONE;
    flight.hear(42, 1, &COLLISION_DATA { threat_level: none, ..own.clone() });
    flight.fly(3.0);
    assert_eq!(flight.of::<COLLISION_DATA>().len(), 3);
    flight.sent.clear();
    flight.hear(42, 1, &own);
    flight.fly(2.9);
    assert!(flight.of::<COLLISION_DATA>().is_empty());
    flight.fly(2.0);
    assert!(!flight.of::<COLLISION_DATA>().is_empty());
    // The danger is over: reported once as such, then no more.
    flight.seen[0].level = AlertLevel::None;
    flight.sent.clear();
    flight.fly(10.0);
    let over = flight.of::<COLLISION_DATA>();
    assert!((4..=6).contains(&over.len()) && over.iter().all(|c| c.2.threat_level as u8 == 0));
}

/// With a key, nothing that is not signed changes what is sent.
#[test]
fn what_is_signed_derives_from_what_is_signed() {
    let messages = |forge: bool| {
        let mut flight = flight();
        let time_to_contact = Some(Estimate { value: I16F16::from_num(9), sigma: I16F16::ONE });
        flight.seen.push(Traffic { level: AlertLevel::Warning, time_to_contact, ..traffic(5) });
        for step in 0..500u32 {
            if forge {
                let sydney = GLOBAL_POSITION_INT_DATA {
                    lat: -338_700_000,
                    lon: 1_512_000_000,
                    ..position(1)
                };
                let callsign = adsb::Callsign::of_track(196, 5);
                let identity = adsb::Identity::new(196, 0, callsign, adsb::Assume::default());
                let threat = adsb::collision(&flight.seen[0], &identity).unwrap();
                let restart = SYSTEM_TIME_DATA { time_unix_usec: 1, time_boot_ms: step % 2 };
                let question =
                    TIMESYNC_DATA { tc1: 0, ts1: 7, target_system: 0, target_component: 0 };
                let nowhere = GLOBAL_POSITION_INT_DATA { lat: 0, lon: 0, ..position(1) };
                let frames = [
                    raw(42, 1, &sydney),
                    raw(42, 1, &nowhere),
                    raw(42, 1, &threat),
                    raw(42, 1, &restart),
                    raw(42, 1, &attitude(1)),
                    raw(43, 1, &autopilot_heartbeat()),
                    raw(42, 1, &question),
                ];
                for frame in frames {
                    flight.component.receive(1, &frame, Trust::Unsigned, flight.now);
                }
            }
            flight.fly(0.04);
        }
        assert_eq!(flight.component.counters().refused, if forge { 3500 } else { 0 });
        (flight.sent, flight.events)
    };
    assert_eq!(messages(false), messages(true));
}

/// Others may ask as much as they like: what is sent of traffic stays the same, in number and order.
#[test]
fn questions_cost_no_report() {
    let reports = |questions: usize| {
        let mut flight = flight();
        let time_to_contact = Some(Estimate { value: I16F16::from_num(9), sigma: I16F16::ONE });
        flight.seen.push(Traffic { level: AlertLevel::Warning, time_to_contact, ..traffic(5) });
        for _ in 0..200 {
            let list = PARAM_REQUEST_LIST_DATA { target_system: 0, target_component: 0 };
            let time = TIMESYNC_DATA { tc1: 0, ts1: 7, target_system: 0, target_component: 0 };
            for _ in 0..questions {
                flight.hear(255, 190, &time);
                flight.hear(255, 190, &list);
            }
            flight.fly(0.1);
        }
        flight.sent.retain(|(_, message)| message.priority != Priority::Answer);
        flight.sent
    };
    let asked = reports(300);
    assert!(asked.len() > 100);
    assert_eq!(asked, reports(0));
}

#[test]
fn a_lost_autopilot_and_another_one() {
    let mut flight = flight();
    flight.seen.push(traffic(1));
    flight.fly(3.0);
    flight.autopilot = None;
    flight.fly(6.0);
    assert!(flight.events.contains(&ComponentEvent::Lost));
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
    assert!(flight.events.contains(&ComponentEvent::Restarted));
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
    let time_us = flight.now - 100_000;
    assert_eq!(
        flight.events,
        [
            ComponentEvent::Attitude { time_us, quaternion: [1 << 30, 0, 0, 0] },
            ComponentEvent::Rates { time_us, rates: [I16F16::ZERO; 3] },
        ]
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
    let Some(&ComponentEvent::Attitude { quaternion, .. }) = flight.events.first() else {
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
