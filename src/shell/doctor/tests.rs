//! Examinations of simulated autopilots.

use super::*;
use crate::mavlink::dialect::*;
use crate::mavlink::messages::Payload;
use mavlink_core::{MAVLinkMessageRaw, MavHeader};
use std::collections::BTreeMap;
use std::string::String;
use std::vec;

/// An autopilot that answers.
struct FakeAutopilot {
    kind: MavAutopilot,
    armed: bool,
    /// As sent on the wire.
    parameters: BTreeMap<&'static str, (f32, MavParamType)>,
    /// Numbers of the messages it sends, and how many microseconds apart.
    streams: BTreeMap<u32, i64>,
    /// Microseconds of its clock at our 0.
    clock: i64,
    obstacle: Option<u16>,
    asked: u32,
}

const INT: MavParamType = MavParamType::MAV_PARAM_TYPE_INT8;

impl FakeAutopilot {
    fn ardupilot() -> Self {
        Self {
            kind: MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA,
            armed: false,
            parameters: [
                ("ADSB_TYPE", (1.0, INT)),
                ("AVD_ENABLE", (1.0, INT)),
                ("SCR_ENABLE", (1.0, INT)),
                ("AVD_WCLR_XY", (609.6, MavParamType::MAV_PARAM_TYPE_REAL32)),
                ("AVD_WCLR_Z", (76.2, MavParamType::MAV_PARAM_TYPE_REAL32)),
                ("AVD_NMAC_XY", (152.4, MavParamType::MAV_PARAM_TYPE_REAL32)),
                ("AVD_NMAC_Z", (30.48, MavParamType::MAV_PARAM_TYPE_REAL32)),
                ("PRX1_TYPE", (2.0, INT)),
                ("AVOID_ENABLE", (7.0, INT)),
                ("OA_TYPE", (0.0, INT)),
            ]
            .into(),
            streams: BTreeMap::new(),
            clock: 77_000_000,
            obstacle: None,
            asked: 0,
        }
    }

    fn stream(&self, id: u32, now_us: i64) -> Option<MavMessage> {
        let proximity = MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_PROXIMITY;
        Some(match id {
            2 => MavMessage::SYSTEM_TIME(SYSTEM_TIME_DATA {
                time_unix_usec: 1_767_225_600_000_000,
                time_boot_ms: 1,
            }),
            31 => MavMessage::ATTITUDE_QUATERNION(ATTITUDE_QUATERNION_DATA {
                q1: 1.0,
                ..Default::default()
            }),
            33 => MavMessage::GLOBAL_POSITION_INT(Default::default()),
            1 => MavMessage::SYS_STATUS(SYS_STATUS_DATA {
                onboard_control_sensors_present: proximity,
                onboard_control_sensors_health: match self.obstacle {
                    Some(_) => proximity,
                    None => MavSysStatusSensor::empty(),
                },
                ..Default::default()
            }),
            132 => MavMessage::DISTANCE_SENSOR(DISTANCE_SENSOR_DATA {
                id: 10,
                current_distance: self.obstacle?,
                ..Default::default()
            }),
            _ => panic!("no stream {id} at {now_us}"),
        })
    }

    fn answer(&mut self, message: &MavMessage, now_us: i64) -> Option<MavMessage> {
        match message {
            MavMessage::COMMAND_LONG(data) => {
                assert_eq!((data.target_system, data.target_component), (7, 1));
                if data.command == MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL {
                    self.streams.insert(data.param1 as u32, data.param2 as i64);
                    return None;
                }
                assert_eq!((data.command, data.param1), (MavCmd::MAV_CMD_REQUEST_MESSAGE, 148.0));
                Some(MavMessage::AUTOPILOT_VERSION(AUTOPILOT_VERSION_DATA {
                    flight_sw_version: 0x0406_01ff,
                    flight_custom_version: *b"3fc7011a",
                    ..Default::default()
                }))
            }
            MavMessage::PARAM_REQUEST_READ(data) => {
                self.asked += 1;
                let name = data.param_id.to_str().unwrap();
                let &(param_value, param_type) = self.parameters.get(name)?;
                let param_id = data.param_id;
                let (param_count, param_index) = (900, 5);
                Some(MavMessage::PARAM_VALUE(PARAM_VALUE_DATA {
                    param_value,
                    param_count,
                    param_index,
                    param_id,
                    param_type,
                }))
            }
            MavMessage::TIMESYNC(data) => Some(MavMessage::TIMESYNC(TIMESYNC_DATA {
                tc1: (now_us + self.clock) * 1000,
                ..*data
            })),
            MavMessage::OBSTACLE_DISTANCE(data) => {
                assert_eq!(data.frame, crate::mavlink::dialect::MavFrame::MAV_FRAME_BODY_FRD);
                // ArduPilot's parameter decides whether it looks at it.
                if self.parameters.get("PRX1_TYPE").is_some_and(|&(value, _)| value == 2.0) {
                    self.obstacle = data.distances.iter().copied().min();
                }
                None
            }
            MavMessage::HEARTBEAT(data) => {
                assert_eq!(data.autopilot, MavAutopilot::MAV_AUTOPILOT_INVALID);
                assert_eq!(data.system_status, MavState::MAV_STATE_STANDBY);
                None
            }
            other => panic!("{other:?}"),
        }
    }
}

fn raw(system: u8, component: u8, message: &MavMessage) -> MAVLinkMessageRaw {
    let mut raw = mavlink_core::MAVLinkV2MessageRaw::new();
    let header = MavHeader { system_id: system.into(), component_id: component, sequence: 0 };
    raw.serialize_message(header, message);
    MAVLinkMessageRaw::V2(raw)
}

/// Six seconds with an autopilot that answers after 4 ms; what was found, marked as the command marks it.
fn examine(
    autopilot: &mut FakeAutopilot,
    purposes: &[Purpose],
    probe: bool,
) -> (Vec<Finding>, i64) {
    let mut examination = Examination::new(purposes, probe, 0);
    let mut pending: Vec<(i64, MavMessage)> = vec![];
    let mut sent = 0;
    for now in (0..6_000_000i64).step_by(2_000) {
        while let Some(payload) = examination.poll(now) {
            sent += 1;
            let message = Payload::parse(&payload).unwrap();
            pending.extend(
                autopilot.answer(&message, now + 2_000).map(|answer| (now + 4_000, answer)),
            );
        }
        if now % 1_000_000 == 0 {
            let mut base_mode = MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED;
            base_mode.set(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED, autopilot.armed);
            let heartbeat = HEARTBEAT_DATA {
                mavtype: MavType::MAV_TYPE_QUADROTOR,
                autopilot: autopilot.kind,
                base_mode,
                ..Default::default()
            };
            pending.push((now, MavMessage::HEARTBEAT(heartbeat)));
        }
        for (&id, &interval) in &autopilot.streams {
            if now % interval == 0 {
                pending.extend(autopilot.stream(id, now).map(|message| (now, message)));
            }
        }
        for (_, message) in pending.extract_if(.., |(due, _)| *due <= now) {
            examination.receive(&raw(7, 1, &message), now);
        }
    }
    assert!(sent < 180, "{sent} messages in six seconds");
    (examination.findings(), sent)
}

fn line<'a>(findings: &'a [Finding], part: &str) -> &'a Finding {
    let found = findings.iter().find(|finding| finding.text.contains(part));
    found.unwrap_or_else(|| panic!("no {part} in {findings:#?}"))
}

#[test]
fn a_vehicle_that_is_set_up() {
    let mut autopilot = FakeAutopilot::ardupilot();
    autopilot.streams = [(132, 100_000), (1, 500_000)].into();
    let purposes = [Purpose::Traffic, Purpose::Proximity];
    let (findings, _) = examine(&mut autopilot, &purposes, true);
    assert!(findings.iter().all(|f| f.mark != Mark::Missing), "{findings:#?}");
    let words = "autopilot: ArduPilot 4.6.1 (official, 3fc7011a); quadrotor, system 7, component 1, not armed, \
        1.0 heartbeats a second";
    assert_eq!(findings[0].text, words);
    assert_eq!(
        line(&findings, "attitude").text,
        "attitude: ATTITUDE_QUATERNION comes 50 times a second"
    );
    assert_eq!(line(&findings, "time sync").mark, Mark::Good);
    assert!(line(&findings, "time sync").text.contains("known to 2.0 ms"));
    assert!(line(&findings, "our 12.34 m ahead").text.contains("its DISTANCE_SENSOR shows"));
    assert_eq!(line(&findings, "SYS_STATUS").mark, Mark::Good);
}

#[test]
fn a_gimbal_or_station_is_no_autopilot() {
    let mut examination = Examination::new(&[Purpose::Traffic], false, 0);
    for (component, mavtype) in [
        (154, MavType::MAV_TYPE_GIMBAL),
        (190, MavType::MAV_TYPE_GCS),
        (156, MavType::MAV_TYPE_ADSB),
    ] {
        let autopilot = MavAutopilot::MAV_AUTOPILOT_GENERIC;
        let heartbeat = HEARTBEAT_DATA { mavtype, autopilot, ..Default::default() };
        examination.receive(&raw(9, component, &MavMessage::HEARTBEAT(heartbeat)), 0);
    }
    let findings = examination.findings();
    assert_eq!(line(&findings, "no heartbeat of an autopilot").mark, Mark::Missing);
    let heartbeat = HEARTBEAT_DATA {
        mavtype: MavType::MAV_TYPE_FIXED_WING,
        autopilot: MavAutopilot::MAV_AUTOPILOT_GENERIC,
        ..Default::default()
    };
    examination.receive(&raw(7, 1, &MavMessage::HEARTBEAT(heartbeat)), 0);
    assert_eq!(examination.system(), 7);
}

/// 19.9 attitudes a second are 20: no text calls them less.
#[test]
fn a_rate_is_judged_as_it_is_printed() {
    for (interval_us, mark) in [(50_300, Mark::Good), (52_000, Mark::Note)] {
        let mut examination = with_autopilot();
        for i in 0..100 {
            let attitude = MavMessage::ATTITUDE_QUATERNION(Default::default());
            examination.receive(&raw(7, 1, &attitude), i * interval_us);
        }
        let findings = examination.findings();
        assert_eq!(line(&findings, "attitude").mark, mark, "{findings:#?}");
    }
}

/// After the heartbeat of a PX4 multirotor at time 0.
fn with_autopilot() -> Examination {
    let mut examination = Examination::new(&[], false, 0);
    let heartbeat = HEARTBEAT_DATA {
        mavtype: MavType::MAV_TYPE_QUADROTOR,
        autopilot: MavAutopilot::MAV_AUTOPILOT_PX4,
        ..Default::default()
    };
    examination.receive(&raw(7, 1, &MavMessage::HEARTBEAT(heartbeat)), 0);
    examination
}

/// Findings about an autopilot that sends attitudes and another message at these intervals.
fn with_rates(attitude_us: i64, other: Option<(u8, MavMessage, i64)>) -> Examination {
    let mut examination = with_autopilot();
    for now in (0..6_000_000).step_by(10_000) {
        if now % attitude_us == 0 {
            examination.receive(&raw(7, 1, &MavMessage::ATTITUDE(Default::default())), now);
        }
        if let Some((component, message, every_us)) = &other
            && now % every_us == 0
        {
            examination.receive(&raw(7, *component, message), now);
        }
    }
    examination
}

#[test]
fn rare_attitudes_and_what_bridges_them() {
    let text = |examination: &Examination| line(&examination.findings(), "attitude").text.clone();
    let alone = text(&with_rates(500_000, None));
    assert!(alone.contains("ATTITUDE comes 2 times a second; below 8 traffic"), "{alone}");
    assert!(alone.contains("HIGHRES_IMU or SCALED_IMU"), "{alone}");
    let imu = MavMessage::HIGHRES_IMU(Default::default());
    let carried = text(&with_rates(500_000, Some((1, imu, 20_000))));
    assert!(carried.contains("HIGHRES_IMU, which comes 50 times a second"), "{carried}");
    let rough = text(&with_rates(100_000, None));
    assert!(rough.contains("10 times a second; below 20 directions are rough"), "{rough}");
}

#[test]
fn a_gimbal_that_speaks_and_one_that_does_not() {
    let flags = GimbalDeviceFlags::GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME;
    let status = MavMessage::GIMBAL_DEVICE_ATTITUDE_STATUS(GIMBAL_DEVICE_ATTITUDE_STATUS_DATA {
        flags,
        ..Default::default()
    });
    let mut examination = with_rates(20_000, Some((154, status.clone(), 100_000)));
    let findings = examination.findings();
    let told = line(&findings, "gimbal");
    assert_eq!(told.mark, Mark::Note);
    assert!(
        told.text.contains("component 154 sends its attitude 10 times a second, yaw from north")
    );
    assert!(told.text.contains("camera.gimbal = true"), "{}", told.text);
    examination.expect_gimbal();
    let findings = examination.findings();
    assert_eq!(line(&findings, "gimbal").mark, Mark::Good);
    assert_eq!(line(&findings, "field of view").mark, Mark::Note);
    let mut slow = with_rates(20_000, Some((154, status, 500_000)));
    slow.expect_gimbal();
    assert!(line(&slow.findings(), "gimbal").text.contains("after 0.3 s without one"));
    let mut silent = with_rates(20_000, None);
    silent.expect_gimbal();
    assert_eq!(line(&silent.findings(), "gimbal").mark, Mark::Missing);
    let asked = |payload: Payload| match Payload::parse(&payload) {
        Some(MavMessage::COMMAND_LONG(data)) => Some(data.param1 as u32),
        _ => None,
    };
    let mut numbers: Vec<u32> = (0..3_000_000i64)
        .step_by(10_000)
        .filter_map(|now| silent.poll(6_000_000 + now))
        .filter_map(asked)
        .collect();
    numbers.sort_unstable();
    numbers.dedup();
    assert!(numbers.contains(&285) && numbers.contains(&271), "{numbers:?}");
}

#[test]
fn what_is_off_is_named() {
    let mut autopilot = FakeAutopilot::ardupilot();
    autopilot.parameters.insert("ADSB_TYPE", (0.0, INT));
    autopilot.parameters.insert("PRX1_TYPE", (0.0, INT));
    autopilot.parameters.remove("AVD_ENABLE");
    let (findings, _) = examine(&mut autopilot, &[Purpose::Traffic], false);
    let missing: Vec<&str> =
        findings.iter().filter(|f| f.mark == Mark::Missing).map(|f| f.text.as_str()).collect();
    assert_eq!(missing.len(), 2, "{missing:?}");
    assert!(missing[0].starts_with("ADSB_VEHICLE: ADSB_TYPE is 0: "), "{missing:?}");
    assert!(missing[1].starts_with("ADSB_VEHICLE: AVD_ENABLE: no answer"), "{missing:?}");
    // Not wanted, so only reported.
    assert_eq!(line(&findings, "PRX1_TYPE is 0").mark, Mark::Note);
    // The probe requests it, and no answer comes.
    let (findings, _) = examine(&mut autopilot, &[Purpose::Traffic], true);
    assert_eq!(line(&findings, "PRX1_TYPE is 0").mark, Mark::Missing);
    assert_eq!(line(&findings, "nothing of it came back").mark, Mark::Missing);
}

#[test]
fn older_names_are_tried() {
    let mut autopilot = FakeAutopilot::ardupilot();
    let value = autopilot.parameters.remove("PRX1_TYPE").unwrap();
    autopilot.parameters.insert("PRX_TYPE", value);
    let (findings, _) = examine(&mut autopilot, &[Purpose::Proximity], false);
    assert_eq!(line(&findings, "PRX_TYPE is 2").mark, Mark::Good);
    // An unanswered name is requested four times, the others once.
    assert_eq!(autopilot.asked, 2 * 4 + 10);
}

#[test]
fn an_armed_vehicle_is_not_probed() {
    let mut autopilot = FakeAutopilot::ardupilot();
    autopilot.armed = true;
    let (findings, _) = examine(&mut autopilot, &[Purpose::Traffic], true);
    assert_eq!(autopilot.obstacle, None);
    assert!(line(&findings, "probe").text.contains("the vehicle is armed, nothing was sent"));
}

#[test]
fn px4_has_its_own_parameters() {
    let mut autopilot = FakeAutopilot::ardupilot();
    autopilot.kind = MavAutopilot::MAV_AUTOPILOT_PX4;
    let int = MavParamType::MAV_PARAM_TYPE_INT32;
    autopilot.parameters = [
        ("NAV_TRAFF_AVOID", (f32::from_bits(1), int)),
        ("CP_DIST", (-1.0, MavParamType::MAV_PARAM_TYPE_REAL32)),
    ]
    .into();
    let (findings, _) = examine(&mut autopilot, &[Purpose::Traffic], false);
    assert_eq!(line(&findings, "NAV_TRAFF_AVOID is 1").mark, Mark::Good);
    assert_eq!(line(&findings, "CP_DIST is -1").mark, Mark::Note);
    assert!(findings[0].text.starts_with("autopilot: PX4 4.6.1 ("));
}

#[test]
fn silence_and_links_that_lead_elsewhere() {
    let mut examination = Examination::new(&[Purpose::Traffic], false, 0);
    assert!(!examination.heard());
    assert_eq!(
        examination.findings(),
        [Finding { mark: Mark::Missing, text: "nothing was heard".into() }]
    );
    let station = HEARTBEAT_DATA {
        mavtype: MavType::MAV_TYPE_GCS,
        autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
        ..Default::default()
    };
    examination.receive(&raw(255, 190, &MavMessage::HEARTBEAT(station)), 10);
    let findings = examination.findings();
    assert!(findings[0].text.contains("no heartbeat of an autopilot"), "{findings:?}");
    assert_eq!(findings[1].text, "also heard: gcs, system 255, component 190");
    // Only heartbeats are sent while there is nobody to ask.
    let sent: Vec<u32> = (0..3_000_000)
        .step_by(10_000)
        .filter_map(|now| examination.poll(now))
        .map(|payload| payload.id())
        .collect();
    assert_eq!(sent, [0, 0, 0]);
}

#[test]
fn versions_in_words() {
    for (version, hash, wanted) in [
        (0x0406_01ff, *b"3fc7011a", "4.6.1 (official, 3fc7011a)"),
        (0x0407_0000, [0; 8], "4.7.0 (in development, 0000000000000000)"),
        (0x010f_0480, [1, 2, 3, 4, 5, 6, 7, 0xfe], "1.15.4 (beta, fe07060504030201)"),
    ] {
        let mut examination = Examination::new(&[], false, 0);
        let heartbeat =
            HEARTBEAT_DATA { autopilot: MavAutopilot::MAV_AUTOPILOT_PX4, ..Default::default() };
        examination.receive(&raw(1, 1, &MavMessage::HEARTBEAT(heartbeat)), 0);
        let data = AUTOPILOT_VERSION_DATA {
            flight_sw_version: version,
            flight_custom_version: hash,
            ..Default::default()
        };
        examination.receive(&raw(1, 1, &MavMessage::AUTOPILOT_VERSION(data)), 0);
        let text: String = examination.findings()[0].text.clone();
        assert!(text.starts_with(&format!("autopilot: PX4 {wanted}; ")), "{text}");
    }
}
