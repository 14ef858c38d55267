//! Examination of one link: requests, answers and findings. A state machine without I/O and clock.

pub use super::finding::{Finding, Mark};
use super::finding::{good, note};
use super::gimbal::Gimbals;
use super::parameters::{self, Check, Purpose};
use super::probe::Probe;
use super::request::{RepeatedRequest, command_long};
use super::timing::{MessageRate, Sync};
use crate::mavlink::component::is_vehicle;
use crate::mavlink::dialect::{
    AUTOPILOT_VERSION_DATA, HEARTBEAT_DATA, MavAutopilot, MavCmd, MavMessage, MavModeFlag,
    MavState, MavType, PARAM_REQUEST_READ_DATA,
};
use crate::mavlink::messages::Payload;
use mavlink_core::{MAVLinkMessageRaw, Message, MessageData};
use std::collections::BTreeMap;
use std::string::String;
use std::vec::Vec;
use std::{format, vec};

/// Our component id: the neutral one of an onboard computer. That of a running lookout stays its own.
pub const COMPONENT: u8 = 191;
/// Microseconds from one heartbeat of ours to the next.
const BEAT_US: i64 = 1_000_000;
/// The messages that the lookout lives on: number, microseconds between two of them, what for.
const STREAMS: [(u32, i64, &str); 3] = [
    (ATTITUDE_QUATERNION, 20_000, "attitude"),
    (GLOBAL_POSITION_INT, 200_000, "position"),
    (SYSTEM_TIME, 1_000_000, "time"),
];
const SYSTEM_TIME: u32 = 2;
const ATTITUDE: u32 = 30;
const ATTITUDE_QUATERNION: u32 = 31;
const GLOBAL_POSITION_INT: u32 = 33;
const AUTOPILOT_VERSION: u32 = 148;
/// Attitudes a second from which on a frame's direction is good.
const ATTITUDE_RATE: f64 = 20.0;
/// Attitudes a second below which the time between two has to be bridged.
const BRIDGED_RATE: f64 = 8.0;
/// Angular velocities a second from which on they bridge it, and their messages.
const GYROSCOPE_RATE: f64 = 7.0;
const SCALED_IMU: u32 = 26;
const HIGHRES_IMU: u32 = 105;

/// A requested parameter, under one of its names.
#[derive(Debug)]
struct Asked {
    check: &'static Check,
    name: &'static str,
    request: RepeatedRequest,
    answer: Option<f64>,
}

/// The autopilot that was heard first.
#[derive(Debug)]
struct HeardAutopilot {
    system: u8,
    component: u8,
    heartbeat: HEARTBEAT_DATA,
    version: Option<AUTOPILOT_VERSION_DATA>,
    version_request: RepeatedRequest,
    streams: [RepeatedRequest; STREAMS.len()],
    asked: Vec<Asked>,
}

/// The examination of one link.
#[derive(Debug)]
pub struct Examination {
    purposes: Vec<Purpose>,
    probe: Option<Probe>,
    next_beat_us: i64,
    frames: u64,
    others: BTreeMap<(u32, u8), MavType>,
    rates: BTreeMap<u32, MessageRate>,
    sync: Sync,
    /// Whether SYSTEM_TIME held the time of day.
    clock: bool,
    gimbals: Gimbals,
    autopilot: Option<HeardAutopilot>,
}

impl Examination {
    /// Begins; `probe`: our own messages are sent, to see whether they come back.
    pub fn new(purposes: &[Purpose], probe: bool, now_us: i64) -> Self {
        let mut purposes = purposes.to_vec();
        if probe {
            purposes.push(Purpose::Proximity);
        }
        Self {
            purposes,
            probe: probe.then(|| Probe::new(now_us)),
            next_beat_us: now_us,
            frames: 0,
            others: BTreeMap::new(),
            rates: BTreeMap::new(),
            sync: Sync::default(),
            clock: false,
            gimbals: Gimbals::default(),
            autopilot: None,
        }
    }

    /// The camera is on a gimbal: its attitude has to come.
    pub fn expect_gimbal(&mut self) {
        self.gimbals.wanted = true;
    }

    /// The system id to speak with: the autopilot's, 1 before it is known.
    pub fn system(&self) -> u8 {
        self.autopilot.as_ref().map_or(1, |autopilot| autopilot.system)
    }

    /// Handles a received frame.
    pub fn receive(&mut self, raw: &MAVLinkMessageRaw, now_us: i64) {
        self.frames += 1;
        let parsed = MavMessage::parse(raw.version(), raw.message_id(), raw.payload());
        let Ok(message) = parsed else { return };
        let from = (raw.system_id(), raw.component_id());
        if let MavMessage::HEARTBEAT(data) = &message {
            self.heartbeat(from, data.clone());
        }
        let Some(autopilot) = &mut self.autopilot else { return };
        if from.0 == u32::from(autopilot.system) {
            self.gimbals.receive(from.1, &message, now_us);
        }
        if from != (autopilot.system.into(), autopilot.component) {
            return;
        }
        self.rates.entry(raw.message_id()).or_default().add(now_us);
        match &message {
            MavMessage::AUTOPILOT_VERSION(data) => autopilot.version = Some(data.clone()),
            MavMessage::PARAM_VALUE(data) => {
                let name = data.param_id.to_str().unwrap_or_default();
                let kind = autopilot.heartbeat.autopilot;
                for asked in autopilot.asked.iter_mut().filter(|asked| asked.name == name) {
                    asked.answer = Some(parameters::value(kind, data.param_value, data.param_type));
                }
            }
            MavMessage::TIMESYNC(data) => self.sync.receive(data, now_us),
            MavMessage::SYSTEM_TIME(data) => self.clock |= data.time_unix_usec > 0,
            _ => {}
        }
        if let Some(probe) = &mut self.probe {
            probe.receive(&message);
        }
    }

    fn heartbeat(&mut self, from: (u32, u8), data: HEARTBEAT_DATA) {
        let is_autopilot = is_vehicle(data.mavtype as u8, data.autopilot as u8, from.1);
        match (&mut self.autopilot, u8::try_from(from.0)) {
            (Some(known), _) if from == (known.system.into(), known.component) => {
                known.heartbeat = data;
            }
            (None, Ok(system)) if is_autopilot => {
                let asked = |check: &'static Check| {
                    let names = core::iter::once(check.name).chain(check.old_name);
                    names.map(move |name| Asked {
                        check,
                        name,
                        request: RepeatedRequest::default(),
                        answer: None,
                    })
                };
                let checks = parameters::checks(data.autopilot);
                self.autopilot = Some(HeardAutopilot {
                    system,
                    component: from.1,
                    heartbeat: data,
                    version: None,
                    version_request: RepeatedRequest::default(),
                    streams: Default::default(),
                    asked: checks.iter().flat_map(asked).collect(),
                });
            }
            _ => {
                self.others.insert(from, data.mavtype);
            }
        }
    }

    /// The next message to send; to be called until there is none, every 20 ms or so.
    pub fn poll(&mut self, now_us: i64) -> Option<Payload> {
        if now_us >= self.next_beat_us {
            self.next_beat_us = now_us + BEAT_US;
            return Some(beat());
        }
        let autopilot = self.autopilot.as_mut()?;
        let (system, component) = (autopilot.system, autopilot.component);
        if autopilot.version.is_none() && autopilot.version_request.ask(now_us) {
            let command = MavCmd::MAV_CMD_REQUEST_MESSAGE;
            let message = AUTOPILOT_VERSION as f32;
            return Some(command_long((system, component), command, [message, 0.0]));
        }
        for (&(message, interval_us, _), request) in STREAMS.iter().zip(&mut autopilot.streams) {
            let rate = self.rates.get(&message).map_or(0.0, MessageRate::hertz);
            if rate * (interval_us as f64) < 0.8e6 && request.ask(now_us) {
                let command = MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL;
                let parameters = [message as f32, interval_us as f32];
                return Some(command_long((system, component), command, parameters));
            }
        }
        if let Some(question) = self.gimbals.poll((system, component), now_us) {
            return Some(question);
        }
        for asked in autopilot.asked.iter_mut().filter(|asked| asked.answer.is_none()) {
            if asked.request.ask(now_us) {
                return Some(Payload::new(&PARAM_REQUEST_READ_DATA {
                    param_index: -1,
                    target_system: system,
                    target_component: component,
                    param_id: asked.name.into(),
                }));
            }
        }
        let armed = autopilot.is_armed();
        let sync = self.sync.poll((system, component), now_us);
        sync.or_else(|| self.probe.as_mut()?.poll(armed, now_us))
    }

    /// Whether anything at all was heard.
    pub fn heard(&self) -> bool {
        self.frames > 0
    }

    /// The findings, most important first.
    pub fn findings(&self) -> Vec<Finding> {
        let missing = |text: &str| Finding { mark: Mark::Missing, text: text.into() };
        let Some(autopilot) = &self.autopilot else {
            let text = match self.frames {
                0 => "nothing was heard",
                _ => {
                    "MAVLink was heard, but no heartbeat of an autopilot; does this link lead to it?"
                }
            };
            return core::iter::once(missing(text)).chain(self.neighbours()).collect();
        };
        let mut findings = vec![autopilot.in_words(self.rates.get(&HEARTBEAT_DATA::ID))];
        findings.extend(self.neighbours());
        findings.extend(self.attitude());
        findings.extend(self.gimbals.findings());
        findings.push(self.position());
        findings.push(match self.clock {
            true => good("time: SYSTEM_TIME holds the time of day".into()),
            false => note("time: the autopilot does not know the time of day yet (no GPS?)".into()),
        });
        findings.push(self.sync.find());
        let kind = autopilot.heartbeat.autopilot;
        if parameters::checks(kind).is_empty() {
            findings.push(note(format!(
                "parameters: which ones matter is known for ArduPilot and PX4, not for {}",
                words(&format!("{kind:?}"), "MAV_AUTOPILOT_")
            )));
        }
        for check in parameters::checks(kind) {
            let mut asked =
                autopilot.asked.iter().filter(|asked| core::ptr::eq(asked.check, check));
            let answered = asked.find(|asked| asked.answer.is_some());
            let (name, value) = answered.map_or((check.name, None), |a| (a.name, a.answer));
            findings.push(check.find(name, value, self.purposes.contains(&check.purpose)));
        }
        if let Some(probe) = &self.probe {
            findings.extend(probe.findings(autopilot.is_armed(), kind));
        }
        findings
    }

    /// Others that were heard.
    fn neighbours(&self) -> impl Iterator<Item = Finding> {
        self.others.iter().map(|((system, component), kind)| {
            let kind = words(&format!("{kind:?}"), "MAV_TYPE_");
            note(format!("also heard: {kind}, system {system}, component {component}"))
        })
    }

    fn attitude(&self) -> Option<Finding> {
        let rate = |message| self.rates.get(&message).map_or(0.0, MessageRate::hertz);
        let (quaternion, angles) = (rate(ATTITUDE_QUATERNION), rate(ATTITUDE));
        let best = f64::max(quaternion, angles);
        let name = if quaternion >= angles { "ATTITUDE_QUATERNION" } else { "ATTITUDE" };
        let text = format!("attitude: {name} comes {best:.0} times a second");
        let gyroscopes = [(HIGHRES_IMU, "HIGHRES_IMU"), (SCALED_IMU, "SCALED_IMU")];
        let gyroscope = gyroscopes.into_iter().find(|(id, _)| rate(*id) >= GYROSCOPE_RATE);
        Some(match best {
            // As it is printed.
            best if best.round() >= ATTITUDE_RATE => good(text),
            best if best > 0.0 && best.round() < BRIDGED_RATE => note(match gyroscope {
                Some((id, name)) => format!(
                    "{text}; below {BRIDGED_RATE} it is carried on by {name}, which comes {:.0} times a second; raise its \
                     rate on this port",
                    rate(id)
                ),
                None => format!(
                    "{text}; below {BRIDGED_RATE} traffic is put on the map only while the picture shows ground to go by; \
                     raise its rate on this port, or let HIGHRES_IMU or SCALED_IMU come 10 times a second"
                ),
            }),
            best if best > 0.0 => note(format!(
                "{text}; below {ATTITUDE_RATE} directions are rough while the vehicle turns, raise its rate on this port"
            )),
            _ => Finding {
                mark: Mark::Missing,
                text: "attitude: neither ATTITUDE_QUATERNION nor ATTITUDE comes, also not when asked for; \
                    without it no direction in the world is known"
                    .into(),
            },
        })
    }

    fn position(&self) -> Finding {
        let rate = self.rates.get(&GLOBAL_POSITION_INT).map_or(0.0, MessageRate::hertz);
        if rate > 0.0 {
            good(format!("position: GLOBAL_POSITION_INT comes {rate:.0} times a second"))
        } else {
            let wanted = self.purposes.contains(&Purpose::Traffic);
            let mark = if wanted { Mark::Missing } else { Mark::Note };
            let text = "position: GLOBAL_POSITION_INT does not come; ADSB_VEHICLE needs it".into();
            Finding { mark, text }
        }
    }
}

impl HeardAutopilot {
    fn is_armed(&self) -> bool {
        self.heartbeat.base_mode.contains(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED)
    }

    fn in_words(&self, beats: Option<&MessageRate>) -> Finding {
        let kind = match self.heartbeat.autopilot {
            MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA => "ArduPilot".into(),
            MavAutopilot::MAV_AUTOPILOT_PX4 => "PX4".into(),
            other => words(&format!("{other:?}"), "MAV_AUTOPILOT_"),
        };
        let version = self.version.as_ref().map_or_else(
            || ", version unknown (AUTOPILOT_VERSION was not answered)".into(),
            |version| format!(" {}", version_in_words(version)),
        );
        let vehicle = words(&format!("{:?}", self.heartbeat.mavtype), "MAV_TYPE_");
        let state = if self.is_armed() { "armed" } else { "not armed" };
        let beats = beats.map_or(0.0, MessageRate::hertz);
        good(format!(
            "autopilot: {kind}{version}; {vehicle}, system {}, component {}, {state}, {beats:.1} heartbeats a second",
            self.system, self.component
        ))
    }
}

/// `MAV_TYPE_FIXED_WING` without its prefix, as words.
fn words(name: &str, prefix: &str) -> String {
    name.strip_prefix(prefix).unwrap_or(name).to_lowercase().replace('_', " ")
}

/// `4.6.1 (official, 3fc7011a)`.
/// Source: flight_sw_version, <https://mavlink.io/en/messages/common.html#AUTOPILOT_VERSION>.
fn version_in_words(version: &AUTOPILOT_VERSION_DATA) -> String {
    let [kind, patch, minor, major] = version.flight_sw_version.to_le_bytes();
    let kind = match kind {
        0..64 => "in development",
        64..128 => "alpha",
        128..192 => "beta",
        192..255 => "release candidate",
        255 => "official",
    };
    let hash = version.flight_custom_version;
    let hash: String = match core::str::from_utf8(&hash) {
        // ArduPilot sends letters, PX4 bytes.
        Ok(text) if text.bytes().all(|b| b.is_ascii_hexdigit()) => text.into(),
        _ => hash.iter().rev().map(|byte| format!("{byte:02x}")).collect(),
    };
    format!("{major}.{minor}.{patch} ({kind}, {hash})")
}

fn beat() -> Payload {
    Payload::new(&HEARTBEAT_DATA {
        custom_mode: 0,
        mavtype: MavType::MAV_TYPE_ONBOARD_CONTROLLER,
        autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
        base_mode: MavModeFlag::empty(),
        // Nothing is watched while the link is examined.
        system_status: MavState::MAV_STATE_STANDBY,
        mavlink_version: 3,
    })
}
