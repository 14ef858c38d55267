//! Messages that are sent periodically, and their intervals.

use super::parameters::Parameter;
use super::{Component, Destination, Priority};
use crate::mavlink::dialect::{
    ADSB_VEHICLE_DATA, CAMERA_TRACKING_IMAGE_STATUS_DATA, COLLISION_DATA, HEARTBEAT_DATA,
    MavCollisionThreatLevel, NAMED_VALUE_FLOAT_DATA, OBSTACLE_DISTANCE_3D_DATA,
    OBSTACLE_DISTANCE_DATA,
};
use crate::mavlink::messages::adsb::{self, Identity};
use crate::mavlink::messages::{Payload, obstacle, status, text};
use crate::tracking::traffic::{AlertLevel, Traffic};
use fixed::types::I16F16;
use mavlink_core::MessageData;

/// MAV_AUTOPILOT_ARDUPILOTMEGA.
const ARDUPILOT: u8 = 3;

/// A position of the vehicle older than this puts nothing on the map.
pub(super) const POSITION_US: i64 = 2_000_000;

/// Time for which COLLISION is still sent after a threat is over, to show that it is.
const CLEARING_US: i64 = 5_000_000;

/// While the autopilot reports an object of ours as a threat by its own COLLISION, ours about it is not sent. ArduPilot
/// repeats it every second.
const YIELD_US: i64 = 3_000_000;

/// Shortest interval that can be set, in microseconds.
const SHORTEST_US: i64 = 50_000;

/// A message that is sent regularly.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MessageStream {
    Heartbeat,
    Adsb,
    Proximity,
    Collision,
    Health,
    Image,
}

pub(super) const STREAMS: [MessageStream; 6] = [
    MessageStream::Heartbeat,
    MessageStream::Adsb,
    MessageStream::Proximity,
    MessageStream::Collision,
    MessageStream::Health,
    MessageStream::Image,
];

/// Time a stream was last sent, and its interval.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Timer {
    next_us: Option<i64>,
    /// As SET_MESSAGE_INTERVAL wants it: `Some(None)` for not at all.
    wanted_us: Option<Option<i64>>,
}

/// When an object was last detected, when it was last a threat, and when the autopilot last reported it as one.
#[derive(Debug, Clone, Copy)]
pub(super) struct LastSeen {
    pub track: u16,
    pub time_us: i64,
    pub threat_us: Option<i64>,
    pub yield_us: Option<i64>,
}

impl Component {
    /// The stream that sends the message `id`, unless the parameters switch it off.
    pub(super) fn stream_of(&self, id: u32) -> Option<MessageStream> {
        let on = |parameter| self.parameters.is_on(parameter);
        let proximity = self.parameters.get(Parameter::Proximity);
        let stream = match id {
            HEARTBEAT_DATA::ID => MessageStream::Heartbeat,
            ADSB_VEHICLE_DATA::ID if on(Parameter::AdsbRate) => MessageStream::Adsb,
            OBSTACLE_DISTANCE_DATA::ID if proximity == 1 => MessageStream::Proximity,
            OBSTACLE_DISTANCE_3D_DATA::ID if proximity == 2 => MessageStream::Proximity,
            COLLISION_DATA::ID if on(Parameter::Collision) => MessageStream::Collision,
            NAMED_VALUE_FLOAT_DATA::ID if on(Parameter::Health) => MessageStream::Health,
            CAMERA_TRACKING_IMAGE_STATUS_DATA::ID if self.config.camera.is_some() => {
                MessageStream::Image
            }
            _ => return None,
        };
        Some(stream)
    }

    /// Time between two of a stream in microseconds; `None` where it is off.
    pub(super) fn interval_us(&self, stream: MessageStream) -> Option<i64> {
        let rate = |parameter| {
            let bits = i64::from(self.parameters.get(parameter).to_bits());
            (1_000_000i64 << 16).checked_div(bits)
        };
        let second = |parameter| self.parameters.is_on(parameter).then_some(1_000_000);
        let default = match stream {
            MessageStream::Heartbeat => Some(1_000_000),
            MessageStream::Adsb => rate(Parameter::AdsbRate),
            MessageStream::Proximity => {
                let on = self.parameters.is_on(Parameter::Proximity);
                rate(Parameter::ProximityRate).filter(|_| on)
            }
            MessageStream::Collision => second(Parameter::Collision),
            MessageStream::Health => second(Parameter::Health),
            MessageStream::Image => self.config.camera.map(|_| 200_000),
        };
        match self.timers[stream as usize].wanted_us {
            Some(wanted) => default.and(wanted),
            None => default,
        }
    }

    /// Takes the interval of SET_MESSAGE_INTERVAL: 0 the default, negative off. The heartbeat cannot be changed.
    pub(super) fn want_interval(&mut self, stream: MessageStream, interval_us: i64) -> bool {
        if stream == MessageStream::Heartbeat {
            return false;
        }
        let timer = &mut self.timers[stream as usize];
        timer.wanted_us = match interval_us {
            0 => None,
            ..0 => Some(None),
            _ => Some(Some(interval_us.max(SHORTEST_US))),
        };
        timer.next_us = None;
        true
    }

    /// Queues what is due.
    pub(super) fn stream(&mut self, now_us: i64) {
        for stream in STREAMS {
            let Some(interval) = self.interval_us(stream) else { continue };
            let timer = &mut self.timers[stream as usize];
            let next = timer.next_us.unwrap_or(now_us);
            if now_us >= next {
                // Keeps its rate over late polls, but makes up for no gap.
                let following = next.saturating_add(interval);
                timer.next_us =
                    Some(if following <= now_us { now_us + interval } else { following });
                self.send_stream(stream, now_us);
            }
        }
    }

    /// Queues one round of a stream now.
    pub(super) fn send_stream(&mut self, stream: MessageStream, now_us: i64) {
        let main = self.config.component_id;
        let all = Destination::All;
        let boot_ms = self.boot_ms(now_us);
        let state = self.state;
        match stream {
            MessageStream::Heartbeat => {
                self.say(
                    all,
                    main,
                    Priority::Urgent,
                    &status::heartbeat(state, self.config.heartbeat),
                );
                if let Some(camera) = self.config.camera {
                    let data = status::camera_heartbeat(state);
                    self.say(all, camera.component_id, Priority::Urgent, &data);
                }
            }
            MessageStream::Adsb => {
                let Some(own) = self.fresh_vehicle(now_us) else { return };
                self.each_object(now_us, |object, identity, seen| {
                    let age = seen.map_or(0, |seen| now_us.saturating_sub(seen.time_us));
                    let seconds = (age / 1_000_000).clamp(0, 255) as u8;
                    adsb::vehicle(object, &own, identity, seconds).map(|data| Payload::new(&data))
                });
            }
            MessageStream::Proximity => self.send_proximity(now_us),
            MessageStream::Collision => {
                self.each_object(now_us, |object, identity, seen| {
                    let since = seen.and_then(|seen| seen.threat_us);
                    let threat = object.level >= AlertLevel::Caution
                        || since.is_some_and(|us| now_us.saturating_sub(us) < CLEARING_US);
                    let yields = seen.and_then(|seen| seen.yield_us);
                    let yields = yields.is_some_and(|us| now_us.saturating_sub(us) < YIELD_US);
                    let data = adsb::collision(object, identity).filter(|_| threat && !yields);
                    data.map(|data| Payload::new(&data))
                });
            }
            MessageStream::Health => {
                let (frames, since_us) = self.counted;
                let span = now_us.saturating_sub(since_us);
                if span > 0 {
                    let new = i64::from(self.health.frames.wrapping_sub(frames));
                    let rate = (new * 1_000_000) << 16;
                    self.rate = I16F16::from_bits((rate / span).clamp(0, i32::MAX.into()) as i32);
                    self.counted = (self.health.frames, now_us);
                }
                let tracks = self.objects(now_us).iter().filter(|t| t.confirmed).count();
                for value in status::health(&self.health, self.rate, tracks, boot_ms) {
                    self.say(all, main, Priority::Status, &value);
                }
            }
            MessageStream::Image => {
                let Some(camera) = self.config.camera.filter(|_| self.follow.on) else { return };
                let target = self.target(now_us);
                let data = status::image(target.as_ref(), camera.width, camera.height);
                self.say(all, camera.component_id, Priority::Status, &data);
            }
        }
    }

    /// COLLISION of the autopilot: as far as it reports an object of ours as a threat, ours about that one is not needed.
    pub(super) fn hear_collision(&mut self, data: &COLLISION_DATA, now_us: i64) {
        if data.threat_level == MavCollisionThreatLevel::MAV_COLLISION_THREAT_LEVEL_NONE {
            return;
        }
        let ours =
            |seen: &LastSeen| self.identity(seen.track).is_some_and(|own| own.address == data.id);
        if let Some(at) = self.seen.iter().position(ours) {
            self.seen[at].yield_us = Some(now_us);
        }
    }

    /// Queues what `message` makes of each object that has an identity and is reported.
    fn each_object(
        &mut self,
        now_us: i64,
        message: impl Fn(&Traffic, &Identity, Option<LastSeen>) -> Option<Payload>,
    ) {
        for at in 0..self.objects(now_us).len() {
            let object = self.traffic[at];
            let Some(identity) = self.identity(object.id).filter(|_| self.is_reported(&object))
            else {
                continue;
            };
            let seen = self.seen.iter().find(|seen| seen.track == object.id).copied();
            if let Some(payload) = message(&object, &identity, seen) {
                self.queue(Destination::All, self.config.component_id, Priority::Traffic, payload);
            }
        }
    }

    /// OBSTACLE_DISTANCE or OBSTACLE_DISTANCE_3D, for the autopilot alone; regularly, also of nothing. Not while the
    /// lookout sees nothing, or does not know where its gimbal points: the autopilot then takes it for a lost sensor, which
    /// it is.
    fn send_proximity(&mut self, now_us: i64) {
        let Some(autopilot) = self.autopilot else { return };
        if self.state != status::LookoutState::Watching || !self.health.pointed {
            return;
        }
        let to = Destination::Link(autopilot.link);
        let main = self.config.component_id;
        let metres = self.parameters.get(Parameter::ProximityMax);
        let max_cm = (metres.to_num::<i64>() * 100).clamp(0, 65_534) as u16;
        if self.parameters.get(Parameter::Proximity) == 1 {
            let data = obstacle::distances(self.objects(now_us), max_cm, self.frame_us);
            self.say(to, main, Priority::Traffic, &data);
        } else if autopilot.kind == ARDUPILOT {
            let boot_ms = self.boot_ms(now_us);
            let mut any = false;
            for at in 0..self.objects(now_us).len() {
                if let Some(data) = obstacle::point(&self.traffic[at], max_cm, boot_ms) {
                    any = true;
                    self.say(to, main, Priority::Traffic, &data);
                }
            }
            if !any {
                self.say(to, main, Priority::Traffic, &obstacle::nothing(max_cm, boot_ms));
            }
        }
    }

    /// The object of the box on the video: the one chosen by command, or the most urgent, then the nearest.
    pub(super) fn target(&self, now_us: i64) -> Option<Traffic> {
        let objects = self.objects(now_us).iter().filter(|object| object.confirmed);
        let chosen = objects.clone().find(|object| self.follow.chosen == Some(object.id));
        let distance = |object: &Traffic| object.range.map_or(i32::MAX, |r| r.value.to_bits());
        let urgent = objects.max_by_key(|object| {
            (object.level, core::cmp::Reverse(distance(object)), core::cmp::Reverse(object.id))
        });
        chosen.or(urgent).copied()
    }

    /// Updates the state of the heartbeat: by when frames were finished, what they showed, and whether the autopilot that
    /// was served is there.
    pub(super) fn update_state(&mut self, now_us: i64) {
        let state = match self.observed_us {
            _ if self.ending => status::LookoutState::Ending,
            None => status::LookoutState::Starting,
            Some(last) if now_us.saturating_sub(last) > self.stall_us() => {
                status::LookoutState::Stalled
            }
            Some(_) if self.slow => status::LookoutState::Slow,
            Some(_) if self.health.blind.any() => status::LookoutState::Blind(self.health.blind),
            Some(_) if self.autopilot.is_none() && self.last_served.is_some() => {
                status::LookoutState::NoAutopilot
            }
            Some(_) => status::LookoutState::Watching,
        };
        if state != self.state {
            if sees(state) != sees(self.state) || !sees(state) {
                self.sight_us = now_us;
            }
            self.state = state;
            // Others learn it now, not at the next second.
            self.send_stream(MessageStream::Heartbeat, now_us);
            self.timers[MessageStream::Heartbeat as usize].next_us = Some(now_us + 1_000_000);
        }
        self.announce_sight(now_us);
    }

    /// A text where the lookout sees nothing, at most one in ten seconds, or sees again. Only what has lasted counts.
    fn announce_sight(&mut self, now_us: i64) {
        let (announced, bad_us) = self.sight_announced;
        let good = sees(self.state);
        let state = if good { status::LookoutState::Watching } else { self.state };
        let lasted =
            now_us.saturating_sub(self.sight_us) >= if good { 3_000_000 } else { 1_000_000 };
        let quiet = good || bad_us.is_none_or(|last| now_us.saturating_sub(last) >= 10_000_000);
        // There is no later.
        let due = self.ending || (lasted && quiet);
        if state == announced || !due || !self.parameters.is_on(Parameter::Text) {
            return;
        }
        let words = text::sight(state);
        self.say(Destination::All, self.config.component_id, Priority::Urgent, &words);
        self.sight_announced = (state, if good { bad_us } else { Some(now_us) });
    }
}

/// Whether frames come and show something.
fn sees(state: status::LookoutState) -> bool {
    matches!(state, status::LookoutState::Watching | status::LookoutState::NoAutopilot)
}
