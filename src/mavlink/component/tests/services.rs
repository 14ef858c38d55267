//! Commands, parameters, the camera, and anything at all.

use super::*;
use crate::mavlink::messages::tests::any_traffic;
use mavlink_core::MAVLinkV2MessageRaw;
use mavlink_core::types::CharArray;
use proptest::prelude::*;

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
        let echoed: Vec<_> =
            flight.of::<PARAM_VALUE_DATA>().iter().map(|p| p.2.param_value).collect();
        assert_eq!(echoed, echo.into_iter().collect::<Vec<_>>(), "{data:?}");
        assert_eq!(
            flight.events.contains(&ComponentEvent::Parameter(Parameter::Wingspan)),
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
fn the_camera_draws_a_box_that_can_be_turned_off() {
    let camera = Some(CameraComponent { component_id: 100, width: 640, height: 480 });
    let mut flight = TestFlight::new(
        ComponentConfig { camera, ..ComponentConfig::default() },
        Parameters::default(),
    );
    flight.seen.extend([traffic(1), Traffic { level: AlertLevel::Warning, ..traffic(2) }]);
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
    assert!(answers <= OUTBOX + ANSWERS, "{answers}");
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
        let camera = Some(CameraComponent { component_id: 100, width: 0, height: 65535 });
        let mut parameters = Parameters::default();
        parameters.set(Parameter::Proximity, 2.0);
        let mut component = Component::new(ComponentConfig { camera, ..ComponentConfig::default() }, parameters, times[0]);
        component.receive(0, &raw(1, 1, &autopilot_heartbeat()), Trust::Open, times[0]);
        for &now in &times {
            for (kind, id, payload, [system, sender, link]) in &frames {
                let id = KINDS.get(*kind).copied().unwrap_or(*id);
                let [low, middle, high, _] = id.to_le_bytes();
                let mut bytes = [0; mavlink_core::consts::MAX_FRAME_SIZE];
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
