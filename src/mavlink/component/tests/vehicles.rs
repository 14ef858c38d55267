//! Which vehicle is served, and aircraft that report their own position.

use super::*;
use crate::mavlink::messages::adsb::Callsign;
use crate::mavlink::messages::status::HeartbeatType;
use crate::mavlink::messages::tests::{direction, own};
use mavlink_core::types::CharArray;
use std::string::ToString;

fn heartbeat(mav_type: MavType, autopilot: MavAutopilot) -> HEARTBEAT_DATA {
    HEARTBEAT_DATA { mavtype: mav_type, autopilot, ..autopilot_heartbeat() }
}

fn texts(flight: &TestFlight) -> Vec<std::string::String> {
    let texts = flight.of::<STATUSTEXT_DATA>();
    texts.iter().map(|t| t.2.text.to_str().unwrap().into()).collect()
}

/// A gimbal, a station and others that put GENERIC where INVALID belongs, heard before the vehicle.
#[test]
fn only_a_vehicle_is_served() {
    let mut flight = flight();
    for (component, mav_type) in [
        (154, MavType::MAV_TYPE_GIMBAL),
        (190, MavType::MAV_TYPE_GCS),
        (100, MavType::MAV_TYPE_CAMERA),
        (156, MavType::MAV_TYPE_ADSB),
        (191, MavType::MAV_TYPE_ONBOARD_CONTROLLER),
        (2, MavType::MAV_TYPE_FLARM),
        (3, MavType::MAV_TYPE_ANTENNA_TRACKER),
    ] {
        let generic = heartbeat(mav_type, MavAutopilot::MAV_AUTOPILOT_GENERIC);
        flight.hear(7, component, &generic);
        assert!(flight.component.autopilot().is_none(), "{mav_type:?}");
    }
    let mut generic = heartbeat(MavType::MAV_TYPE_FIXED_WING, MavAutopilot::MAV_AUTOPILOT_GENERIC);
    flight.hear(9, 1, &generic);
    assert_eq!(flight.component.system_id(), 9);
    generic.mavtype = MavType::MAV_TYPE_GENERIC;
    let mut other = self::flight();
    other.hear(10, 1, &generic);
    assert_eq!(other.component.system_id(), 10);
}

#[test]
fn the_vehicle_beside_ours_is_never_served() {
    let mut flight = flight();
    flight.autopilot = Some(2);
    flight.fly(3.0);
    // Both are heard, then ours is silent for 6 s.
    for step in 0..12 {
        if step % 2 == 0 {
            flight.hear(1, 1, &autopilot_heartbeat());
        }
        flight.fly(0.5);
    }
    flight.autopilot = None;
    flight.sent.clear();
    for _ in 0..6 {
        flight.hear(1, 1, &autopilot_heartbeat());
        flight.hear(1, 1, &position(1000));
        flight.fly(1.0);
    }
    assert!(flight.component.autopilot().is_none() && flight.component.vehicle().is_none());
    assert!(flight.sent.iter().all(|(_, m)| m.system_id == 2));
    flight.autopilot = Some(2);
    flight.fly(1.0);
    assert_eq!(flight.component.autopilot().unwrap().system_id, 2);
    assert!(flight.events.contains(&ComponentEvent::Returned { system_id: 2 }));
}

/// Ours is silent, and a vehicle appears that was never heard beside it: served until ours comes back.
#[test]
fn the_vehicle_that_was_served_first_comes_back() {
    let mut flight = flight();
    flight.fly(3.0);
    flight.autopilot = Some(43);
    flight.fly(4.5);
    assert_eq!(flight.component.system_id(), 43);
    // Both fly: ours is home.
    flight.hear(42, 1, &autopilot_heartbeat());
    assert_eq!(flight.component.system_id(), 42);
    for _ in 0..5 {
        flight.hear(42, 1, &autopilot_heartbeat());
        flight.fly(1.0);
    }
    assert_eq!(flight.component.system_id(), 42);
    let said = texts(&flight);
    assert!(said.iter().any(|text| text == "Lookout: serves system 43 now"), "{said:?}");
    assert!(said.iter().any(|text| text == "Lookout: serves system 42 now"), "{said:?}");
}

#[test]
fn a_lost_autopilot_is_reported_within_three_seconds() {
    let mut flight = flight();
    flight.seen.push(traffic(1));
    flight.fly(5.0);
    flight.sent.clear();
    flight.events.clear();
    flight.autopilot = None;
    let gone = flight.now;
    flight.fly(3.0);
    let text = flight.of::<STATUSTEXT_DATA>().pop().unwrap();
    assert_eq!(text.2.text.to_str(), Ok("Lookout: autopilot lost, no traffic on the map"));
    assert!(text.0 - gone <= 3 * SECOND && text.1.priority == Priority::Urgent);
    let beat = flight.of::<HEARTBEAT_DATA>().pop().unwrap();
    assert_eq!((beat.2.system_status as u8, beat.2.custom_mode), (5, 16));
    assert_eq!(flight.events, [ComponentEvent::Lost]);
    assert_eq!(flight.component.state(), LookoutState::NoAutopilot);
    flight.sent.clear();
    flight.autopilot = Some(42);
    flight.fly(2.0);
    assert_eq!(texts(&flight), ["Lookout: autopilot is back"]);
    assert_eq!(flight.of::<HEARTBEAT_DATA>().pop().unwrap().2.system_status as u8, 4);
    assert!(flight.events.contains(&ComponentEvent::Returned { system_id: 42 }));
}

/// Telemetry without heartbeats is no loss; a restart during silence is noticed; a bad link does not fill the screen.
#[test]
fn restarts_and_flapping_links() {
    let mut flight = flight();
    flight.fly(5.0);
    for _ in 0..500 {
        flight.hear(42, 1, &attitude((flight.now / 1000 + flight.boot) as u32));
        flight.now += STEP;
        flight.drain();
    }
    assert!(!flight.events.contains(&ComponentEvent::Lost));
    flight.autopilot = None;
    flight.fly(3.0);
    flight.boot = 500 - flight.now / 1000;
    flight.autopilot = Some(42);
    flight.fly(2.0);
    assert!(flight.events.contains(&ComponentEvent::Restarted));
    let said = texts(&flight);
    assert!(said.iter().any(|text| text == "Lookout: autopilot restarted"), "{said:?}");
    flight.sent.clear();
    for _ in 0..10 {
        flight.autopilot = None;
        flight.fly(3.0);
        flight.autopilot = Some(42);
        flight.fly(1.0);
    }
    let lost = texts(&flight).iter().filter(|text| text.contains("lost")).count();
    assert!((2..=5).contains(&lost), "{lost}");
}

/// Requests that clients send to every component are answered at once, unless they were broadcast.
#[test]
fn files_missions_and_unknown_parameters_are_answered() {
    let mut flight = flight();
    flight.fly(1.0);
    let ask = |flight: &mut TestFlight, frame: &MAVLinkMessageRaw| {
        flight.drain();
        flight.sent.clear();
        flight.component.receive(5, frame, Trust::Open, flight.now);
        flight.drain();
        assert!(flight.sent.iter().all(|(_, m)| m.to == Destination::Link(5)));
    };
    for (opcode, answer, error) in [(4, 129, 10), (3, 129, 10), (6, 129, 7), (2, 128, 0)] {
        let mut payload = [0; 251];
        (payload[0], payload[2], payload[3]) = (9, 1, opcode);
        let mut file = FILE_TRANSFER_PROTOCOL_DATA {
            target_network: 0,
            target_system: 42,
            target_component: 196,
            payload,
        };
        ask(&mut flight, &raw(255, 190, &file));
        let data = flight.of::<FILE_TRANSFER_PROTOCOL_DATA>().pop().unwrap().2;
        assert_eq!((data.target_system, data.target_component), (255, 190));
        let p = data.payload;
        assert_eq!((p[0], p[2], p[3], p[5], p[12]), (10, 1, answer, opcode, error));
        file.target_component = 1;
        ask(&mut flight, &raw(255, 190, &file));
        assert!(flight.sent.is_empty());
    }
    let mission_type = MavMissionType::MAV_MISSION_TYPE_FENCE;
    let mut list =
        MISSION_REQUEST_LIST_DATA { target_system: 42, target_component: 196, mission_type };
    ask(&mut flight, &raw(255, 190, &list));
    let count = flight.of::<MISSION_COUNT_DATA>().pop().unwrap().2;
    assert_eq!((count.count, count.mission_type, count.target_system), (0, mission_type, 255));
    list.target_component = 0;
    ask(&mut flight, &raw(255, 190, &list));
    assert!(flight.sent.is_empty(), "the autopilot has the mission");
    let upload = MISSION_COUNT_DATA {
        count: 3,
        target_system: 42,
        target_component: 196,
        mission_type,
        opaque_id: 0,
    };
    ask(&mut flight, &raw(255, 190, &upload));
    let (_, message) = flight.sent[0];
    assert_eq!((message.payload.id(), message.payload.bytes()), (47, &[255, 190, 3, 1][..]));

    let read = |index: i16, name: &str| PARAM_REQUEST_READ_DATA {
        param_index: index,
        target_system: 42,
        target_component: 196,
        param_id: CharArray::from(name),
    };
    for (index, name) in [(-1, "WPNAV_SPEED"), (12, ""), (-1, "")] {
        ask(&mut flight, &raw(255, 190, &read(index, name)));
        let error = flight.of::<PARAM_ERROR_DATA>().pop().unwrap().2;
        assert_eq!((error.error as u8, error.param_index), (1, index));
        assert_eq!(error.param_id.to_str(), Ok(name));
    }
    let set = |value, name: &str| PARAM_SET_DATA {
        param_value: value,
        target_system: 42,
        target_component: 196,
        param_id: CharArray::from(name),
        param_type: MavParamType::MAV_PARAM_TYPE_REAL32,
    };
    for (value, name, error) in [(1.0, "WPNAV_SPEED", 1), (900.0, "LK_WINGSPAN", 2)] {
        flight.sent.clear();
        flight.hear(255, 190, &set(value, name));
        flight.drain();
        assert_eq!(flight.of::<PARAM_ERROR_DATA>().pop().unwrap().2.error as u8, error);
    }
}

fn cooperative(callsign: &str, address: u32, metres: (f64, f64)) -> ADSB_VEHICLE_DATA {
    let degree = 6_378_137.0 * core::f64::consts::PI / 180.0;
    let cos = 47.3769f64.to_radians().cos();
    ADSB_VEHICLE_DATA {
        ICAO_address: address,
        lat: 473_769_000 + (metres.0 / degree * 1e7) as i32,
        lon: 85_417_000 + (metres.1 / degree / cos * 1e7) as i32,
        altitude: 500_000,
        heading: 9000,
        hor_velocity: 2000,
        ver_velocity: 0,
        flags: AdsbFlags::all() - AdsbFlags::ADSB_FLAGS_SIMULATED,
        squawk: 0,
        altitude_type: AdsbAltitudeType::ADSB_ALTITUDE_TYPE_GEOMETRIC,
        callsign: CharArray::from(callsign),
        emitter_type: AdsbEmitterType::ADSB_EMITTER_TYPE_LIGHT,
        tslc: 0,
    }
}

#[test]
fn a_track_takes_the_callsign_of_the_aircraft_in_its_direction() {
    let mut flight = flight();
    // 300 m to the north-east, and another far aside.
    flight.seen.push(traffic(3));
    flight.seen.push(Traffic { ned: Some(direction(-80.0, 0.0)), ..traffic(4) });
    flight.fly(2.0);
    flight.sent.clear();
    assert_eq!(own().latitude, 473_769_000);
    flight.hear(42, 1, &cooperative("SWR12", 0x4B1A2C, (2000.0, 2000.0)));
    // From a component that is not the autopilot, and one that a lookout made: not heard.
    flight.hear(42, 9, &cooperative("OTHER", 0x4B1A2D, (2000.0, 2000.0)));
    flight.hear(42, 1, &cooperative("VIS0009", 0x3190, (2000.0, 2000.0)));
    flight.fly(1.0);
    let names: Vec<_> = flight
        .of::<ADSB_VEHICLE_DATA>()
        .iter()
        .map(|m| m.2.callsign.to_str().unwrap().to_string())
        .collect();
    assert!(names.contains(&"SWR12".into()) && names.contains(&"VIS0004".into()), "{names:?}");
    assert_eq!(flight.component.explained().collect::<Vec<_>>(), [3]);
    assert_eq!(flight.component.callsign(3).as_str(), "SWR12");
    // It flew on: 20 m/s to the east for 3 s.
    flight.fly(3.0);
    assert_eq!(flight.component.explained().count(), 1);
    flight.fly(3.0);
    assert_eq!(flight.component.explained().count(), 0, "its report is too old");
    assert_eq!(flight.component.callsign(3).as_str(), "VIS0003");
}

#[test]
fn the_own_fleet_is_not_reported() {
    let mut config = ComponentConfig::default();
    config.naming.fleet[0] = Callsign::new(b"FLEET1");
    let mut flight = TestFlight::new(config, Parameters::default());
    flight.fly(1.0);
    flight.hear(42, 1, &cooperative("FLEET1", 0x4B1A2C, (212.0, 212.0)));
    flight.seen.push(Traffic { level: AlertLevel::Warning, ..traffic(3) });
    flight.seen.push(Traffic { ned: Some(direction(-80.0, 0.0)), ..traffic(4) });
    flight.sent.clear();
    flight.fly(2.0);
    let names: Vec<_> = flight.of::<ADSB_VEHICLE_DATA>().iter().map(|m| m.2.callsign).collect();
    assert!(!names.is_empty() && names.iter().all(|name| name.to_str() == Ok("VIS0004")));
    assert!(flight.of::<COLLISION_DATA>().is_empty());
    assert_eq!(texts(&flight).iter().filter(|text| text.contains("VIS0003")).count(), 0);
    assert_eq!(texts(&flight).iter().filter(|text| text.contains("FLEET1")).count(), 0);
}

#[test]
fn two_lookouts_on_one_vehicle_differ() {
    let sent = [196, 197].map(|component_id| {
        let mut flight = TestFlight::new(
            ComponentConfig { component_id, ..ComponentConfig::default() },
            Parameters::default(),
        );
        flight.seen.push(traffic(1));
        flight.fly(2.0);
        let last = flight.of::<ADSB_VEHICLE_DATA>().pop().unwrap().2;
        (last.ICAO_address, last.callsign.to_str().unwrap().to_string())
    });
    assert_ne!(sent[0].0, sent[1].0);
    assert_ne!(sent[0].1, sent[1].1);
}

#[test]
fn the_heartbeat_is_of_the_type_that_was_set() {
    for (heartbeat, number) in [
        (HeartbeatType::OnboardController, 18),
        (HeartbeatType::Adsb, 27),
        (HeartbeatType::Flarm, 32),
    ] {
        let mut flight = TestFlight::new(
            ComponentConfig { heartbeat, ..ComponentConfig::default() },
            Parameters::default(),
        );
        flight.fly(1.0);
        assert_eq!(flight.of::<HEARTBEAT_DATA>()[0].2.mavtype as u8, number);
    }
}
