//! Messages whose payload is written by hand, because the dialect's types cannot hold a command or a mission type that is
//! younger than this program.

use crate::mavlink::dialect::MavMessage;
use mavlink_core::error::ParserError;
use mavlink_core::{MavlinkVersion, MessageData};

/// A message that is sent and never read.
pub(super) trait SentMessage {
    const ID: u32;
    const NAME: &'static str;
    /// CRC_EXTRA of its definition.
    const EXTRA_CRC: u8;
    /// Longest payload in bytes.
    const ENCODED_LEN: usize;

    /// The payload's first bytes; the others are 0.
    fn bytes(&self) -> impl AsRef<[u8]>;
}

/// The message as `mavlink-core` sends it.
pub(super) struct ByHand<M>(pub M);

impl<M: SentMessage> MessageData for ByHand<M> {
    type Message = MavMessage;
    const ID: u32 = M::ID;
    const NAME: &'static str = M::NAME;
    const EXTRA_CRC: u8 = M::EXTRA_CRC;
    const ENCODED_LEN: usize = M::ENCODED_LEN;

    fn ser(&self, _version: MavlinkVersion, payload: &mut [u8]) -> usize {
        let bytes = self.0.bytes();
        let bytes = bytes.as_ref();
        let length = bytes.len().min(payload.len());
        let payload = &mut payload[..length];
        payload.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
        mavlink_core::utils::remove_trailing_zeroes(payload)
    }

    fn deser(_version: MavlinkVersion, _payload: &[u8]) -> Result<Self, ParserError> {
        Err(ParserError::UnknownMessage { id: Self::ID })
    }
}
