//! Client of the parameter protocol, with repeated requests. A state machine without I/O and clock.
//! Source: <https://mavlink.io/en/services/parameter.html>.

use crate::mavlink::dialect::{
    HEARTBEAT_DATA, MavAutopilot, MavMessage, MavModeFlag, MavParamError, MavParamType, MavState,
    MavType, PARAM_REQUEST_LIST_DATA, PARAM_REQUEST_READ_DATA, PARAM_SET_DATA,
};
use crate::mavlink::messages::Payload;
use crate::shell::link::LinkSpec;
use mavlink_core::types::CharArray;
use mavlink_core::{MAVLinkMessageRaw, Message};
use std::collections::{BTreeMap, VecDeque};
use std::string::{String, ToString};
use std::vec::Vec;

/// Microseconds after which an unanswered request is made again.
const RETRY_US: i64 = 700_000;
/// Microseconds from one heartbeat to the next: a link that listens answers those it heard.
const BEAT_US: i64 = 1_000_000;

/// A request to the lookout.
#[derive(Debug, Clone, PartialEq)]
pub enum Wish {
    /// Parameters of these names; none: all.
    Get(Vec<String>),
    /// A parameter set to a value.
    Set(String, f32),
}

/// Name and value of a parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Value {
    /// Name of the parameter, at most 16 characters.
    pub name: String,
    /// Value as PARAM_VALUE carries it.
    pub value: f32,
}

/// Why a wish was not fulfilled.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ParamsError {
    /// No heartbeat of the component.
    #[error(
        "{link}: no lookout with component id {component} was heard in {seconds} s; is it running, and does it have a \
         link here?"
    )]
    Silent {
        /// Specification of the link.
        link: String,
        /// Its component id.
        component: u8,
        /// Seconds listened.
        seconds: u32,
    },
    /// Some answers did not come.
    #[error("{name}: no answer in {seconds} s{}", if *signed { "; it takes signed frames only" } else { "" })]
    NoAnswer {
        /// A parameter without an answer.
        name: String,
        /// Seconds waited.
        seconds: u32,
        /// Whether the lookout signs what it sends.
        signed: bool,
    },
    /// There is no such parameter.
    #[error("{name}: no such parameter; `lookout params get` lists them")]
    Unknown {
        /// Name of the parameter.
        name: String,
    },
    /// The lookout keeps another value.
    #[error("{name}: {wanted} was refused, it is {held}; README lists the range of each")]
    Refused {
        /// Name of the parameter.
        name: String,
        /// The value to set.
        wanted: f32,
        /// The value that holds.
        held: f32,
    },
}

/// Client of the parameter protocol: a state machine without I/O.
#[derive(Debug)]
pub struct ParameterClient {
    wish: Wish,
    component: u8,
    /// System id of the lookout, once heard.
    system: Option<u8>,
    signed: bool,
    outbox: VecDeque<Payload>,
    beat_us: i64,
    ask_us: i64,
    values: BTreeMap<u16, Value>,
    count: Option<u16>,
    unknown: Option<String>,
    complete: bool,
}

impl ParameterClient {
    /// Has asked nothing yet.
    pub fn new(wish: Wish, component: u8, now_us: i64) -> Self {
        Self {
            wish,
            component,
            system: None,
            signed: false,
            outbox: VecDeque::new(),
            beat_us: now_us,
            ask_us: now_us,
            values: BTreeMap::new(),
            count: None,
            unknown: None,
            complete: false,
        }
    }

    /// Whether all answers came, or one says that there will be none.
    pub fn is_complete(&self) -> bool {
        self.complete
    }

    /// The next message to send; to be called until there is none.
    pub fn poll(&mut self, now_us: i64) -> Option<Payload> {
        if now_us >= self.beat_us {
            self.beat_us = now_us + BEAT_US;
            self.outbox.push_back(Payload::new(&HEARTBEAT_DATA {
                custom_mode: 0,
                mavtype: MavType::MAV_TYPE_GCS,
                autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
                base_mode: MavModeFlag::empty(),
                system_status: MavState::MAV_STATE_ACTIVE,
                mavlink_version: 3,
            }));
        }
        if let Some(system) = self.system
            && now_us >= self.ask_us
            && !self.complete
        {
            self.ask_us = now_us + RETRY_US;
            self.ask(system);
        }
        self.outbox.pop_front()
    }

    fn ask(&mut self, target_system: u8) {
        let target_component = self.component;
        match &self.wish {
            Wish::Get(names) if names.is_empty() => {
                let list = PARAM_REQUEST_LIST_DATA { target_system, target_component };
                self.outbox.push_back(Payload::new(&list));
            }
            Wish::Get(names) => {
                let missing = names.iter().filter(|name| self.value(name).is_none());
                let requests = missing.map(|name| {
                    Payload::new(&PARAM_REQUEST_READ_DATA {
                        param_index: -1,
                        target_system,
                        target_component,
                        param_id: wire_name(name),
                    })
                });
                let requests: Vec<Payload> = requests.collect();
                self.outbox.extend(requests);
            }
            Wish::Set(name, value) => self.outbox.push_back(Payload::new(&PARAM_SET_DATA {
                param_value: *value,
                target_system,
                target_component,
                param_id: wire_name(name),
                param_type: MavParamType::MAV_PARAM_TYPE_REAL32,
            })),
        }
    }

    fn value(&self, name: &str) -> Option<&Value> {
        self.values.values().find(|value| value.name == name)
    }

    /// Handles a received frame.
    pub fn receive(&mut self, raw: &MAVLinkMessageRaw) {
        if raw.component_id() != self.component {
            return;
        }
        if let MAVLinkMessageRaw::V2(frame) = raw {
            self.signed = frame.incompatibility_flags() & 1 != 0;
        }
        let Ok(message) = MavMessage::parse(raw.version(), raw.message_id(), raw.payload()) else {
            return;
        };
        match message {
            MavMessage::HEARTBEAT(_) => {
                self.system = self.system.or(u8::try_from(raw.system_id()).ok());
            }
            MavMessage::PARAM_VALUE(data) => {
                let name = data.param_id.to_str().unwrap_or_default().to_string();
                self.count = Some(data.param_count);
                self.values.insert(data.param_index, Value { name, value: data.param_value });
                self.complete |= match &self.wish {
                    Wish::Get(names) if names.is_empty() => {
                        self.values.len() == usize::from(data.param_count)
                    }
                    Wish::Get(names) => names.iter().all(|name| self.value(name).is_some()),
                    Wish::Set(name, _) => self.value(name).is_some(),
                };
            }
            MavMessage::PARAM_ERROR(data)
                if data.error == MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST =>
            {
                self.unknown = data.param_id.to_str().ok().map(ToString::to_string);
                self.complete = true;
            }
            _ => {}
        }
    }

    /// The requested values, by index.
    ///
    /// # Errors
    /// [`ParamsError`].
    pub fn finish(self, link: &LinkSpec, seconds: u32) -> Result<Vec<Value>, ParamsError> {
        let component = self.component;
        if let Some(name) = self.unknown {
            return Err(ParamsError::Unknown { name });
        }
        if self.system.is_none() && self.values.is_empty() {
            return Err(ParamsError::Silent { link: link.to_string(), component, seconds });
        }
        let no_answer =
            |name: &str| ParamsError::NoAnswer { name: name.into(), seconds, signed: self.signed };
        match &self.wish {
            Wish::Get(names) if names.is_empty() && !self.complete => {
                Err(no_answer("the list of parameters"))
            }
            Wish::Get(names) if names.is_empty() => Ok(self.values.into_values().collect()),
            Wish::Get(names) => names
                .iter()
                .map(|name| self.value(name).cloned().ok_or_else(|| no_answer(name)))
                .collect(),
            Wish::Set(name, wanted) => {
                let held = self.value(name).cloned().ok_or_else(|| no_answer(name))?;
                if held.value != *wanted {
                    let (name, wanted, held) = (name.clone(), *wanted, held.value);
                    return Err(ParamsError::Refused { name, wanted, held });
                }
                Ok(Vec::from([held]))
            }
        }
    }
}

/// A name as messages hold it, cut off after 16 letters.
fn wire_name(name: &str) -> CharArray<16> {
    let mut bytes = [0; 16];
    for (to, from) in bytes.iter_mut().zip(name.bytes()) {
        *to = from;
    }
    CharArray::new(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mavlink::component::{Component, ComponentConfig, Trust};

    /// A client and a lookout on a link that loses every third frame.
    fn talk(wish: Wish) -> Result<Vec<Value>, ParamsError> {
        let mut component = Component::new(ComponentConfig::default(), Default::default(), 0);
        let mut client = ParameterClient::new(wish, 196, 0);
        let mut frames = 0;
        for now_us in (0..10_000_000).step_by(20_000) {
            while let Some(payload) = client.poll(now_us) {
                frames += 1;
                if frames % 3 != 0 {
                    let frame = payload.frame(254, 190, 0, false);
                    component.receive(0, &MAVLinkMessageRaw::V2(frame), Trust::Open, now_us);
                }
            }
            while let Some(message) = component.poll(now_us) {
                frames += 1;
                if frames % 3 != 0 {
                    let frame = message.payload.frame(1, 196, 0, false);
                    client.receive(&MAVLinkMessageRaw::V2(frame));
                }
            }
        }
        client.finish(&"udpin:127.0.0.1:1".parse().unwrap(), 10)
    }

    #[test]
    fn parameters_are_read_and_set() {
        let all = talk(Wish::Get(Vec::new())).unwrap();
        assert_eq!(all.len(), 12);
        assert_eq!(all[1], Value { name: "LK_WINGSPAN".into(), value: 1.0 });
        let two = ["LK_TEXT", "LK_ADSB_HZ"].map(String::from);
        let values = talk(Wish::Get(two.into())).unwrap();
        assert_eq!(values.iter().map(|v| v.value).collect::<Vec<_>>(), [1.0, 2.0]);
        let set = talk(Wish::Set("LK_WINGSPAN".into(), 0.35)).unwrap();
        assert_eq!(set, [Value { name: "LK_WINGSPAN".into(), value: 0.35 }]);
    }

    #[test]
    fn refusals_are_named() {
        let error = |wish| talk(wish).unwrap_err().to_string();
        assert!(
            error(Wish::Set("LK_WINGSPAN".into(), 900.0)).contains("900 was refused, it is 1;")
        );
        assert!(error(Wish::Set("WP_SPEED".into(), 1.0)).contains("WP_SPEED: no such parameter"));
        assert!(error(Wish::Get(Vec::from(["LK_X".into()]))).contains("no such parameter"));
        let client = ParameterClient::new(Wish::Get(Vec::new()), 196, 0);
        let silent = client.finish(&"udpin:127.0.0.1:1".parse().unwrap(), 3).unwrap_err();
        assert!(silent.to_string().contains("no lookout with component id 196"));
    }
}
