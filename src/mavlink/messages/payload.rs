//! A message's payload in bytes, and the frame around it.

use crate::mavlink::dialect::MavMessage;
use core::fmt;
use mavlink_core::{MAV_STX_V2, MAVLinkV2MessageRaw, MavlinkVersion, Message, MessageData, consts};

/// Payload of a message, MAVLink 2, trailing zeros cut off.
///
/// Made from one type of message at a time: a program links the writers of those it sends, not of the whole dialect.
///
/// ```
/// use lookout::mavlink::dialect::{MavMessage, SYSTEM_TIME_DATA};
/// use lookout::mavlink::messages::Payload;
///
/// let data = SYSTEM_TIME_DATA { time_unix_usec: 7, time_boot_ms: 0 };
/// let payload = Payload::new(&data);
/// // One of 12 bytes is left when trailing zeros are cut off.
/// assert_eq!((payload.id(), payload.bytes()), (2, &[7][..]));
/// assert_eq!(payload.parse(), Some(MavMessage::SYSTEM_TIME(data)));
/// // The first byte of a MAVLink 2 frame.
/// assert_eq!(payload.frame(1, 196, 0, false).raw_bytes()[0], 0xFD);
/// ```
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Payload {
    id: u32,
    extra_crc: u8,
    length: u8,
    bytes: [u8; consts::MAX_PAYLOAD_LEN],
}

impl Payload {
    /// The payload of `data`.
    pub fn new<D: MessageData>(data: &D) -> Self {
        let mut bytes = [0; consts::MAX_PAYLOAD_LEN];
        let length = data.ser(MavlinkVersion::V2, &mut bytes);
        debug_assert!(length <= consts::MAX_PAYLOAD_LEN);
        Self { id: D::ID, extra_crc: D::EXTRA_CRC, length: length as u8, bytes }
    }

    /// Number of the message.
    pub fn id(&self) -> u32 {
        self.id
    }

    /// Its bytes, 1 to 255.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..usize::from(self.length)]
    }

    /// Bytes of its frame, without a signature.
    pub fn frame_len(&self) -> usize {
        consts::STX_SIZE
            + consts::v2::MIN_HEADER_SIZE
            + usize::from(self.length)
            + consts::CHECKSUM_SIZE
    }

    /// The MAVLink 2 frame. With `signed` it has room for a signature, which the caller fills in. Source:
    /// <https://mavlink.io/en/guide/serialization.html>.
    pub fn frame(
        &self,
        system: u8,
        component: u8,
        sequence: u8,
        signed: bool,
    ) -> MAVLinkV2MessageRaw {
        let mut raw = MAVLinkV2MessageRaw::new();
        let [low, middle, high, _] = self.id.to_le_bytes();
        let flags = if signed { consts::v2::IFLAG_SIGNED } else { 0 };
        let head =
            [MAV_STX_V2, self.length, flags, 0, sequence, system, component, low, middle, high];
        let frame = raw.as_mut_slice();
        let end = head.len() + usize::from(self.length);
        frame[..head.len()].copy_from_slice(&head);
        frame[head.len()..end].copy_from_slice(self.bytes());
        let crc = mavlink_core::calculate_crc(&frame[consts::STX_SIZE..end], self.extra_crc);
        frame[end..end + consts::CHECKSUM_SIZE].copy_from_slice(&crc.to_le_bytes());
        raw
    }

    /// The message as a member of the whole dialect. `None` where the dialect knows no such number in one of its
    /// enumerations.
    pub fn parse(&self) -> Option<MavMessage> {
        MavMessage::parse(MavlinkVersion::V2, self.id, self.bytes()).ok()
    }
}

impl fmt::Debug for Payload {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Payload").field("id", &self.id).field("bytes", &self.bytes()).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mavlink::dialect::{SYSTEM_TIME_DATA, TIMESYNC_DATA};
    use mavlink_core::MavHeader;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn frames_are_those_of_the_crate(tc1: i64, ts1: i64, target: u8, system: u8, component: u8, sequence: u8) {
            let data = TIMESYNC_DATA { tc1, ts1, target_system: target, target_component: 0 };
            let header = MavHeader { system_id: system.into(), component_id: component, sequence };
            let mut want = MAVLinkV2MessageRaw::new();
            want.serialize_message_data(header, &data);
            let payload = Payload::new(&data);
            let frame = payload.frame(system, component, sequence, false);
            prop_assert_eq!(frame.raw_bytes(), want.raw_bytes());
            prop_assert_eq!(frame.raw_bytes().len(), payload.frame_len());
            prop_assert_eq!(payload.parse(), Some(MavMessage::TIMESYNC(data)));
        }
    }

    #[test]
    fn an_empty_payload_keeps_one_byte() {
        let payload = Payload::new(&SYSTEM_TIME_DATA { time_unix_usec: 0, time_boot_ms: 0 });
        assert_eq!(payload.bytes(), [0]);
    }
}
