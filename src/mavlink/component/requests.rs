//! Answers to what a client asks of every component and the lookout does not have: files, missions, other parameters.
//!
//! Without an answer the client waits for its time-out and asks again, several times.
//! Sources: <https://mavlink.io/en/services/ftp.html>, <https://mavlink.io/en/services/mission.html>,
//! <https://mavlink.io/en/services/parameter.html>.

use super::commands::PayloadFields;
use super::written::{ByHand, SentMessage};
use super::{Component, Destination, Priority, Sender};
use crate::mavlink::dialect::{
    FILE_TRANSFER_PROTOCOL_DATA, MISSION_COUNT_DATA, MISSION_REQUEST_LIST_DATA, PARAM_ERROR_DATA,
};
use mavlink_core::MessageData;
use mavlink_core::types::CharArray;

/// Numbers of messages of the mission protocol that ask for an answer.
const MISSION_WRITE_PARTIAL_LIST: u32 = 38;
const MISSION_REQUEST: u32 = 40;
const MISSION_CLEAR_ALL: u32 = 45;
const MISSION_REQUEST_INT: u32 = 51;

/// MAV_MISSION_RESULT.
const UNSUPPORTED: u8 = 3;
const INVALID_SEQUENCE: u8 = 13;

/// Places in the payload of FILE_TRANSFER_PROTOCOL: header and data of the file protocol begin at byte 3.
const FTP: usize = 3;

/// Operations of the file protocol.
mod operation {
    pub const TERMINATE_SESSION: u8 = 1;
    pub const RESET_SESSIONS: u8 = 2;
    pub const LIST_DIRECTORY: u8 = 3;
    pub const OPEN_FILE: u8 = 4;
    pub const CRC32: u8 = 14;
    pub const ACK: u8 = 128;
    pub const NAK: u8 = 129;
}

/// Error codes of the file protocol.
const UNKNOWN_COMMAND: u8 = 7;
const FILE_NOT_FOUND: u8 = 10;

/// MISSION_ACK (47).
struct MissionAck {
    to: Sender,
    result: u8,
    mission_type: u8,
}

impl SentMessage for MissionAck {
    const ID: u32 = 47;
    const NAME: &'static str = "MISSION_ACK";
    const EXTRA_CRC: u8 = 153;
    const ENCODED_LEN: usize = 8;

    fn bytes(&self) -> impl AsRef<[u8]> {
        [self.to.system, self.to.component, self.result, self.mission_type]
    }
}

/// MISSION_COUNT (44) of an empty mission; the type is copied from the request, also one that is younger than this program.
struct NoMission {
    to: Sender,
    mission_type: u8,
}

impl SentMessage for NoMission {
    const ID: u32 = MISSION_COUNT_DATA::ID;
    const NAME: &'static str = MISSION_COUNT_DATA::NAME;
    const EXTRA_CRC: u8 = MISSION_COUNT_DATA::EXTRA_CRC;
    const ENCODED_LEN: usize = MISSION_COUNT_DATA::ENCODED_LEN;

    fn bytes(&self) -> impl AsRef<[u8]> {
        [0, 0, self.to.system, self.to.component, self.mission_type]
    }
}

/// Why a parameter cannot be read or set: MAV_PARAM_ERROR.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ParameterError {
    DoesNotExist,
    OutOfRange,
    WrongType,
}

impl Component {
    /// Files and missions. Requests to all components are left to those that have them.
    pub(super) fn hear_request(&mut self, id: u32, from: Sender, payload: &[u8]) {
        let fields = PayloadFields(payload);
        // Place of the target system, and of the mission's type where there is one.
        let (target, mission_type) = match id {
            FILE_TRANSFER_PROTOCOL_DATA::ID => (1, 0),
            MISSION_REQUEST_LIST_DATA::ID | MISSION_CLEAR_ALL => (0, 2),
            MISSION_COUNT_DATA::ID | MISSION_REQUEST | MISSION_REQUEST_INT => (2, 4),
            MISSION_WRITE_PARTIAL_LIST => (4, 6),
            _ => return,
        };
        let addressed = self.addressed(fields.byte(target), fields.byte(target + 1));
        let Some((component, true)) = addressed else { return };
        let to = Destination::Link(from.link);
        if id == FILE_TRANSFER_PROTOCOL_DATA::ID {
            if let Some(answer) = file_answer(from, fields) {
                self.say(to, component, Priority::Answer, &answer);
            }
            return;
        }
        let mission_type = fields.byte(mission_type);
        if id == MISSION_REQUEST_LIST_DATA::ID {
            let answer = NoMission { to: from, mission_type };
            self.say(to, component, Priority::Answer, &ByHand(answer));
            return;
        }
        let asks_for_item = matches!(id, MISSION_REQUEST | MISSION_REQUEST_INT);
        let result = if asks_for_item { INVALID_SEQUENCE } else { UNSUPPORTED };
        let answer = MissionAck { to: from, result, mission_type };
        self.say(to, component, Priority::Answer, &ByHand(answer));
    }

    /// PARAM_ERROR (345), which younger clients understand, for a parameter by name or index.
    pub(super) fn refuse_parameter(
        &mut self,
        from: Sender,
        name: [u8; 16],
        index: i16,
        error: ParameterError,
    ) {
        use crate::mavlink::dialect::MavParamError;
        let data = PARAM_ERROR_DATA {
            param_index: index,
            target_system: from.system,
            target_component: from.component,
            param_id: CharArray::new(name),
            error: match error {
                ParameterError::DoesNotExist => MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST,
                ParameterError::OutOfRange => MavParamError::MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE,
                ParameterError::WrongType => MavParamError::MAV_PARAM_ERROR_TYPE_UNSUPPORTED,
            },
        };
        self.say(Destination::Link(from.link), self.config.component_id, Priority::Answer, &data);
    }
}

/// The answer to a file request: there are no files. Ending sessions succeeds, since none is open.
fn file_answer(from: Sender, fields: PayloadFields) -> Option<FILE_TRANSFER_PROTOCOL_DATA> {
    let sequence = u16::from_le_bytes(fields.bytes(FTP));
    let asked = fields.byte(FTP + 3);
    let (answer, error) = match asked {
        // An answer is not answered.
        operation::ACK | operation::NAK => return None,
        operation::TERMINATE_SESSION | operation::RESET_SESSIONS => (operation::ACK, None),
        operation::LIST_DIRECTORY | operation::OPEN_FILE | operation::CRC32 => {
            (operation::NAK, Some(FILE_NOT_FOUND))
        }
        _ => (operation::NAK, Some(UNKNOWN_COMMAND)),
    };
    let mut payload = [0; 251];
    payload[..2].copy_from_slice(&sequence.wrapping_add(1).to_le_bytes());
    payload[2] = fields.byte(FTP + 2);
    payload[3] = answer;
    payload[4] = error.is_some().into();
    payload[5] = asked;
    payload[12] = error.unwrap_or(0);
    Some(FILE_TRANSFER_PROTOCOL_DATA {
        target_network: 0,
        target_system: from.system,
        target_component: from.component,
        payload,
    })
}
