//! Frames that arrive and messages that leave: authentication, priority, destination.

use crate::mavlink::messages::Payload;

/// Authentication state of a received frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trust {
    /// No key is configured: everyone may command.
    Open,
    /// The signature is valid.
    Signed,
    /// A key is configured and the frame bears no signature: ignored, because everything that is sent is signed and
    /// may derive from signed frames only.
    Unsigned,
    /// Signature or signing time invalid: ignored.
    Forged,
}

/// Which part of a link's bandwidth a message uses, the most important first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Priority {
    /// Heartbeats, texts, requests to the autopilot: few bytes, sent at once.
    Urgent,
    /// Reports about traffic: ADSB_VEHICLE, COLLISION, OBSTACLE_DISTANCE.
    Traffic,
    /// Health values and the box on the video.
    Status,
    /// Answers to what others ask. They have a bandwidth of their own: whoever asks, and however often, takes nothing
    /// from the others.
    Answer,
}

/// Links that a message is sent to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Destination {
    /// To every link.
    All,
    /// To one link: the answer to what came from there, or what is for the autopilot alone.
    Link(u8),
}

/// A message to be sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Outgoing {
    /// Links that the message leaves by.
    pub to: Destination,
    /// Which part of a link's bandwidth it uses.
    pub priority: Priority,
    /// System id of the sender, ours.
    pub system_id: u8,
    /// Component id of the sender.
    pub component_id: u8,
    /// Message number and payload.
    pub payload: Payload,
}
