//! MAVLink commands to the lookout, and their acknowledgements.
//!
//! COMMAND_LONG, COMMAND_INT and COMMAND_ACK are read and written by hand: the crate's types cannot hold a command that is
//! younger than this program, and those too must be answered. Source: <https://mavlink.io/en/services/command.html>.

use super::written::{ByHand, SentMessage};
use super::{Component, Destination, Priority, Sender};
use crate::mavlink::dialect::COMMAND_ACK_DATA;
use crate::mavlink::messages::{Payload, status};
use fixed::types::{I16F16, I48F16};
use mavlink_core::MessageData;

const REQUEST_MESSAGE: u16 = 512;
const SET_MESSAGE_INTERVAL: u16 = 511;
const GET_MESSAGE_INTERVAL: u16 = 510;
const CAMERA_TRACK_POINT: u16 = 2004;
const CAMERA_TRACK_RECTANGLE: u16 = 2005;
const CAMERA_STOP_TRACKING: u16 = 2010;

/// MAV_RESULT.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    Accepted = 0,
    Denied = 2,
    Unsupported = 3,
    Failed = 4,
}

/// Little-endian fields of a payload whose trailing zeros were cut off.
#[derive(Clone, Copy)]
pub(super) struct PayloadFields<'a>(pub &'a [u8]);

impl PayloadFields<'_> {
    pub(super) fn bytes<const N: usize>(self, at: usize) -> [u8; N] {
        core::array::from_fn(|i| self.0.get(at + i).copied().unwrap_or(0))
    }

    pub(super) fn byte(self, at: usize) -> u8 {
        self.bytes::<1>(at)[0]
    }

    pub(super) fn float(self, at: usize) -> f32 {
        f32::from_le_bytes(self.bytes(at))
    }
}

/// COMMAND_ACK of any command.
struct Acknowledgement {
    command: u16,
    verdict: Verdict,
    to: Sender,
}

impl SentMessage for Acknowledgement {
    const ID: u32 = COMMAND_ACK_DATA::ID;
    const NAME: &'static str = COMMAND_ACK_DATA::NAME;
    const EXTRA_CRC: u8 = COMMAND_ACK_DATA::EXTRA_CRC;
    const ENCODED_LEN: usize = COMMAND_ACK_DATA::ENCODED_LEN;

    fn bytes(&self) -> impl AsRef<[u8]> {
        let [low, high] = self.command.to_le_bytes();
        [low, high, self.verdict as u8, 0, 0, 0, 0, 0, self.to.system, self.to.component]
    }
}

/// A command that reached us.
#[derive(Clone, Copy)]
struct Command<'a> {
    number: u16,
    fields: PayloadFields<'a>,
    /// The component it is for.
    component: u8,
    /// Whether it names that component, or all of them.
    direct: bool,
    from: Sender,
}

impl Command<'_> {
    /// A parameter as a whole number; `None` where it is none.
    fn whole(&self, at: usize) -> Option<i64> {
        I48F16::checked_from_num(self.fields.float(at * 4)).map(|v| v.to_num())
    }

    /// A parameter as a part of the frame.
    fn part(&self, at: usize) -> Option<I16F16> {
        I16F16::checked_from_num(self.fields.float(at * 4))
    }
}

/// Whether the camera's tracking box is wanted, and of what.
#[derive(Debug, Clone, Copy)]
pub(super) struct Follow {
    pub on: bool,
    pub chosen: Option<u16>,
}

impl Component {
    /// COMMAND_LONG or COMMAND_INT: both have their first two parameters, command and target at the same places.
    pub(super) fn hear_command(&mut self, from: Sender, payload: &[u8], now_us: i64) {
        let fields = PayloadFields(payload);
        let Some((component, direct)) = self.addressed(fields.byte(30), fields.byte(31)) else {
            return;
        };
        let number = u16::from_le_bytes(fields.bytes(28));
        let command = Command { number, fields, component, direct, from };
        let camera = self.config.camera.map(|camera| camera.component_id);
        let is_camera = camera == Some(component);
        let verdict = match number {
            REQUEST_MESSAGE => self.request(&command, camera, now_us),
            SET_MESSAGE_INTERVAL => self.set_interval(&command),
            GET_MESSAGE_INTERVAL => {
                self.answer(&command, Verdict::Accepted);
                self.tell_interval(&command, command.whole(0));
                return;
            }
            CAMERA_TRACK_POINT | CAMERA_TRACK_RECTANGLE if is_camera => {
                self.choose(&command, now_us)
            }
            CAMERA_STOP_TRACKING if is_camera => {
                self.follow = Follow { on: false, chosen: None };
                Verdict::Accepted
            }
            _ => Verdict::Unsupported,
        };
        // REQUEST_MESSAGE acknowledged the command before it sent the message.
        if number != REQUEST_MESSAGE || verdict != Verdict::Accepted {
            self.answer(&command, verdict);
        }
    }

    /// The component a target means, and whether it names it. Zero means all.
    pub(super) fn addressed(&self, system: u8, component: u8) -> Option<(u8, bool)> {
        let main = self.config.component_id;
        let camera = self.config.camera.is_some_and(|camera| camera.component_id == component);
        if system != 0 && system != self.system_id() {
            return None;
        }
        match component {
            0 => Some((main, false)),
            _ if component == main || camera => Some((component, true)),
            _ => None,
        }
    }

    /// Answers a command. One for all components that is nothing for us is left to the others: our "unsupported" would
    /// be taken for theirs.
    fn answer(&mut self, command: &Command, verdict: Verdict) {
        if verdict == Verdict::Unsupported && !command.direct {
            return;
        }
        let data = Acknowledgement { command: command.number, verdict, to: command.from };
        let to = Destination::Link(command.from.link);
        self.say(to, command.component, Priority::Answer, &ByHand(data));
    }

    fn request(&mut self, command: &Command, camera: Option<u8>, now_us: i64) -> Verdict {
        let boot_ms = self.boot_ms(now_us);
        let is_camera = camera == Some(command.component);
        let mut speaker = command.component;
        let payload = match command.whole(0) {
            Some(0) if is_camera => Payload::new(&status::camera_heartbeat(self.state)),
            Some(0) => Payload::new(&status::heartbeat(self.state, self.config.heartbeat)),
            Some(148) => Payload::new(&status::version()),
            Some(300) => Payload::new(&status::protocol()),
            Some(396) => Payload::new(&status::component(boot_ms)),
            Some(244) => {
                self.answer(command, Verdict::Accepted);
                self.tell_interval(command, command.whole(1));
                return Verdict::Accepted;
            }
            Some(259 | 275) if is_camera || !command.direct => {
                let Some(own) = self.config.camera else { return Verdict::Unsupported };
                speaker = own.component_id;
                if command.whole(0) == Some(259) {
                    Payload::new(&status::camera(own.width, own.height, boot_ms))
                } else {
                    let target = self.target(now_us).filter(|_| self.follow.on);
                    Payload::new(&status::image(target.as_ref(), own.width, own.height))
                }
            }
            // COMPONENT_METADATA (397) names a file to be fetched; there is none.
            _ => return Verdict::Unsupported,
        };
        self.answer(&Command { component: speaker, ..*command }, Verdict::Accepted);
        self.queue(Destination::Link(command.from.link), speaker, Priority::Answer, payload);
        Verdict::Accepted
    }

    fn set_interval(&mut self, command: &Command) -> Verdict {
        let (Some(id), Some(interval_us)) = (command.whole(0), command.whole(1)) else {
            return Verdict::Denied;
        };
        let Ok(id) = u32::try_from(id) else { return Verdict::Denied };
        match self.stream_of(id) {
            Some(stream) if self.want_interval(stream, interval_us) => Verdict::Accepted,
            // Known, but not to be changed from afar.
            Some(_) => Verdict::Denied,
            None if [246, 247, 251, 275, 330, 11037].contains(&id) => Verdict::Denied,
            None => Verdict::Unsupported,
        }
    }

    /// MESSAGE_INTERVAL (244): microseconds, -1 for off, 0 for a message we never send.
    fn tell_interval(&mut self, command: &Command, id: Option<i64>) {
        let id = id.and_then(|id| u16::try_from(id).ok()).unwrap_or(u16::MAX);
        let interval_us = match self.stream_of(id.into()) {
            Some(stream) => {
                self.interval_us(stream).map_or(-1, |us| us.min(i32::MAX.into()) as i32)
            }
            None => 0,
        };
        let data = crate::mavlink::dialect::MESSAGE_INTERVAL_DATA { interval_us, message_id: id };
        self.say(Destination::Link(command.from.link), command.component, Priority::Answer, &data);
    }

    /// CAMERA_TRACK_POINT and CAMERA_TRACK_RECTANGLE: the object nearest to it.
    fn choose(&mut self, command: &Command, now_us: i64) -> Verdict {
        let Some(camera) = self.config.camera else { return Verdict::Unsupported };
        let part = |at| command.part(at).map(|part| part.clamp(I16F16::ZERO, I16F16::ONE));
        let (Some(mut x), Some(mut y)) = (part(0), part(1)) else { return Verdict::Denied };
        if command.number == CAMERA_TRACK_RECTANGLE {
            let (Some(right), Some(bottom)) = (part(2), part(3)) else { return Verdict::Denied };
            (x, y) = ((x + right) / 2, (y + bottom) / 2);
        }
        // To sixteenths of a pixel, as boxes are.
        let place = |part: I16F16, whole: u16| (i64::from(part.to_bits()) * i64::from(whole)) >> 12;
        let (x, y) = (place(x, camera.width), place(y, camera.height));
        let nearest =
            self.objects(now_us).iter().filter(|object| object.confirmed).min_by_key(|object| {
                let middle = |start: i32, extent: i32| i64::from(start) + i64::from(extent) / 2;
                let rect = object.rect;
                let dx = middle(rect.x.to_bits(), rect.width.to_bits()) - x;
                let dy = middle(rect.y.to_bits(), rect.height.to_bits()) - y;
                dx.unsigned_abs().saturating_add(dy.unsigned_abs())
            });
        let Some(chosen) = nearest.map(|object| object.id) else { return Verdict::Failed };
        self.follow = Follow { on: true, chosen: Some(chosen) };
        Verdict::Accepted
    }
}
