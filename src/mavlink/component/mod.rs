//! The lookout as a MAVLink component: protocol state, services, reports of traffic.
//!
//! A state machine without I/O: received frames go in with [`Component::receive`], traffic with [`Component::observe`];
//! [`Component::poll`] returns messages to send, [`Component::event`] changes that its owner handles.
//! All times are microseconds of one clock that never goes back, that of the frames.

mod autopilot;
mod cadence;
mod clock;
mod commands;
mod cooperative;
mod event;
mod exchange;
mod gimbal;
mod heartbeat;
mod identity;
pub mod parameters;
mod requests;
mod rotation;
mod settings;
mod streams;
mod written;

use autopilot::{OTHERS, OtherVehicle};

pub use autopilot::Autopilot;
pub use clock::ClockOffset;
pub use cooperative::Aircraft;
pub use event::ComponentEvent;
pub use exchange::{Destination, Outgoing, Priority, Trust};
pub use gimbal::{Gimbal, STALE_US as GIMBAL_STALE_US};
pub use heartbeat::is_vehicle;
pub use identity::{FLEET, Naming};
pub use settings::{CameraComponent, ComponentConfig};

use crate::mavlink::dialect::{
    ADSB_VEHICLE_DATA, ATTITUDE_DATA, ATTITUDE_QUATERNION_DATA, CAMERA_FOV_STATUS_DATA,
    COLLISION_DATA, COMMAND_INT_DATA, COMMAND_LONG_DATA, GIMBAL_DEVICE_ATTITUDE_STATUS_DATA,
    GLOBAL_POSITION_INT_DATA, HEARTBEAT_DATA, HIGHRES_IMU_DATA, PARAM_REQUEST_LIST_DATA,
    PARAM_REQUEST_READ_DATA, PARAM_SET_DATA, SCALED_IMU_DATA, SYSTEM_TIME_DATA, TIMESYNC_DATA,
};
use crate::mavlink::messages::status::LookoutState;
use crate::mavlink::messages::text::Alerts;
use crate::mavlink::messages::{self, Health, Payload, Vehicle};
use crate::tracking::traffic::{AlertLevel, MAX_TRAFFIC, Traffic};
use commands::{Follow, PayloadFields};
use cooperative::AIRCRAFT;
use fixed::types::I16F16;
use identity::Slots;
use mavlink_core::{MAVLinkMessageRaw, MessageData};
use parameters::{Parameter, Parameters};
use streams::{LastSeen, STREAMS, Timer};

/// Numbers of frames and messages that were received, refused or lost since the start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counters {
    /// Frames received with a right checksum, refused ones included.
    pub received: u32,
    /// Frames that do not hold what their number says.
    pub malformed: u32,
    /// Frames without the signature they need.
    pub refused: u32,
    /// Frames whose signature or signing time is invalid.
    pub forged: u32,
    /// Messages that found no room in the queue.
    pub overflow: u32,
}

/// Who sent a frame, and over which link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Sender {
    link: u8,
    system: u8,
    component: u8,
}

/// Messages that wait to be taken: every message about every object at once.
const OUTBOX: usize = 4 * MAX_TRAFFIC;

/// Answers that wait to be taken, and how many of them may be for one link: a flood over one link leaves room for the
/// others.
const ANSWERS: usize = if cfg!(feature = "std") { 64 } else { ANSWERS_PER_LINK };
const ANSWERS_PER_LINK: usize = 24;

/// Events that wait to be taken.
const EVENTS: usize = 32;

/// The component.
///
/// ```
/// use lookout::mavlink::component::parameters::Parameters;
/// use lookout::mavlink::component::{Component, ComponentConfig, ComponentEvent, Trust};
/// use lookout::mavlink::dialect::{HEARTBEAT_DATA, MavAutopilot, MavType};
/// use lookout::mavlink::messages::Payload;
/// use lookout::mavlink::messages::status::{self, HeartbeatType, LookoutState};
/// use mavlink_core::MAVLinkMessageRaw;
///
/// let mut component = Component::new(ComponentConfig::default(), Parameters::default(), 0);
/// let heartbeat = HEARTBEAT_DATA {
///     autopilot: MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA,
///     mavtype: MavType::MAV_TYPE_QUADROTOR,
///     ..status::heartbeat(LookoutState::Starting, HeartbeatType::default())
/// };
/// // Frames that arrived on link 0 go in, from system 5, component 1.
/// let frame = MAVLinkMessageRaw::V2(Payload::new(&heartbeat).frame(5, 1, 0, false));
/// component.receive(0, &frame, Trust::Open, 1_000);
/// assert_eq!(component.event(), Some(ComponentEvent::Found { system_id: 5, autopilot: 3 }));
/// assert_eq!(component.system_id(), 5);
///
/// // Messages to be sent come out: our own heartbeat (message 0) among them.
/// let mut ids = Vec::new();
/// while let Some(message) = component.poll(2_000) {
///     ids.push(message.payload.id());
/// }
/// assert!(ids.contains(&0));
/// ```
#[derive(Debug)]
pub struct Component {
    config: ComponentConfig,
    parameters: Parameters,
    counters: Counters,
    outbox: heapless::Deque<Outgoing, OUTBOX>,
    answers: heapless::Deque<Outgoing, ANSWERS>,
    events: heapless::Deque<ComponentEvent, EVENTS>,
    started_us: i64,

    autopilot: Option<Autopilot>,
    /// The autopilot that was served last; its system id is ours too, also while it is lost.
    last_served: Option<Autopilot>,
    /// System and component id of the autopilot that was served first.
    home: Option<(u8, u8)>,
    others: heapless::Vec<OtherVehicle, OTHERS>,
    /// When a text last said that the autopilot is lost, and whether the last loss was said.
    loss_text_us: Option<i64>,
    loss_announced: bool,
    clock: ClockOffset,
    timesync_us: Option<i64>,
    unix_offset_us: Option<i64>,
    vehicle: Option<Vehicle>,
    gimbal: Gimbal,
    /// Aircraft that transmit their position.
    aircraft: heapless::Vec<Aircraft, AIRCRAFT>,
    slots: Slots,

    traffic: heapless::Vec<Traffic, MAX_TRAFFIC>,
    seen: heapless::Vec<LastSeen, MAX_TRAFFIC>,
    health: Health,
    frame_us: i64,
    observed_us: Option<i64>,
    /// Whether the detector takes longer for a frame than is waited for one.
    slow: bool,
    /// Frames and time when the rate was last taken, and that rate.
    counted: (u32, i64),
    rate: I16F16,

    state: LookoutState,
    ending: bool,
    /// When the lookout began to see, or not to see for the present reason.
    sight_us: i64,
    /// The state of the last text about it, and when the last text said that nothing is seen.
    sight_announced: (LookoutState, Option<i64>),
    alerts: Alerts,
    timers: [Timer; STREAMS.len()],
    follow: Follow,
    /// Link and index of a list of parameters that is under way.
    listing: Option<(u8, usize)>,
}

impl Component {
    /// A component that has received nothing.
    pub fn new(config: ComponentConfig, parameters: Parameters, now_us: i64) -> Self {
        Self {
            config,
            parameters,
            counters: Counters::default(),
            outbox: heapless::Deque::new(),
            answers: heapless::Deque::new(),
            events: heapless::Deque::new(),
            started_us: now_us,
            autopilot: None,
            last_served: None,
            home: None,
            others: heapless::Vec::new(),
            loss_text_us: None,
            loss_announced: false,
            clock: ClockOffset::default(),
            timesync_us: None,
            unix_offset_us: None,
            vehicle: None,
            gimbal: Gimbal::default(),
            aircraft: heapless::Vec::new(),
            slots: Slots::default(),
            traffic: heapless::Vec::new(),
            seen: heapless::Vec::new(),
            health: Health::default(),
            frame_us: 0,
            observed_us: None,
            slow: false,
            counted: (0, now_us),
            rate: I16F16::ZERO,
            state: LookoutState::Starting,
            ending: false,
            sight_us: now_us,
            sight_announced: (LookoutState::Starting, None),
            alerts: Alerts::default(),
            timers: [Timer::default(); STREAMS.len()],
            follow: Follow { on: true, chosen: None },
            listing: None,
        }
    }

    /// Handles a frame received on `link` whose checksum was right.
    pub fn receive(&mut self, link: u8, frame: &MAVLinkMessageRaw, trust: Trust, now_us: i64) {
        let count = |counter: &mut u32| *counter = counter.saturating_add(1);
        count(&mut self.counters.received);
        match trust {
            Trust::Open | Trust::Signed => {}
            Trust::Unsigned => return count(&mut self.counters.refused),
            Trust::Forged => return count(&mut self.counters.forged),
        }
        let Ok(system) = u8::try_from(frame.system_id()) else { return };
        let from = Sender { link, system, component: frame.component_id() };
        let own = self.addressed(system, from.component).is_some_and(|(_, direct)| direct);
        if system == 0 || own {
            // Nobody, or what we sent ourselves.
            return;
        }
        let (id, version, payload) = (frame.message_id(), frame.version(), frame.payload());
        let mut good = true;
        self.hear_autopilot(from, now_us);
        match id {
            HEARTBEAT_DATA::ID => {
                let fields = PayloadFields(payload);
                self.hear_heartbeat(from, fields.byte(4), fields.byte(5), now_us);
            }
            ATTITUDE_DATA::ID
            | ATTITUDE_QUATERNION_DATA::ID
            | GLOBAL_POSITION_INT_DATA::ID
            | SYSTEM_TIME_DATA::ID
            | SCALED_IMU_DATA::ID
            | HIGHRES_IMU_DATA::ID
                if self.is_autopilot(from) =>
            {
                good = self.hear_vehicle(id, version, payload, now_us);
            }
            GIMBAL_DEVICE_ATTITUDE_STATUS_DATA::ID if self.is_on_vehicle(from) => {
                good = self.hear_gimbal(from, payload, now_us);
            }
            CAMERA_FOV_STATUS_DATA::ID if self.is_on_vehicle(from) => {
                self.hear_view(from, payload, now_us);
            }
            COLLISION_DATA::ID if self.is_autopilot(from) => {
                match COLLISION_DATA::deser(version, payload) {
                    Ok(data) => self.hear_collision(&data, now_us),
                    Err(_) => good = false,
                }
            }
            TIMESYNC_DATA::ID => match TIMESYNC_DATA::deser(version, payload) {
                Ok(data) if self.is_for_us(data.target_system, data.target_component) => {
                    self.hear_timesync(from, &data, now_us);
                }
                Ok(_) => {}
                Err(_) => good = false,
            },
            COMMAND_LONG_DATA::ID | COMMAND_INT_DATA::ID => {
                self.hear_command(from, payload, now_us);
            }
            PARAM_REQUEST_READ_DATA::ID | PARAM_REQUEST_LIST_DATA::ID | PARAM_SET_DATA::ID => {
                self.hear_parameter(id, from, payload);
            }
            ADSB_VEHICLE_DATA::ID if self.is_autopilot(from) => {
                match ADSB_VEHICLE_DATA::deser(version, payload) {
                    Ok(data) => self.hear_aircraft(&data, now_us),
                    Err(_) => good = false,
                }
            }
            _ => self.hear_request(id, from, payload),
        }
        if !good {
            count(&mut self.counters.malformed);
        }
    }

    fn is_for_us(&self, system: u8, component: u8) -> bool {
        self.addressed(system, component).is_some()
    }

    /// Sets the traffic of the frame taken at `frame_time_us`, at most [`MAX_TRAFFIC`] objects. Call it for every processed
    /// frame, also without traffic: without calls for [`ComponentConfig::stall_us`] the state becomes stalled.
    pub fn observe(
        &mut self,
        traffic: &[Traffic],
        health: Health,
        frame_time_us: i64,
        now_us: i64,
    ) {
        self.health = health;
        self.frame_us = frame_time_us;
        self.observed_us = Some(now_us);
        // It has to become clearly better.
        let limit = if self.slow { self.config.stall_us / 2 } else { self.config.stall_us };
        self.slow = i64::from(health.busy_us) > limit;
        self.traffic.clear();
        // Most urgent first, should there ever be too many.
        for level in
            [AlertLevel::Warning, AlertLevel::Caution, AlertLevel::Traffic, AlertLevel::None]
        {
            for object in traffic.iter().filter(|object| object.level == level) {
                let _ = self.traffic.push(*object);
            }
        }
        let traffic = &self.traffic;
        self.seen.retain(|seen| traffic.iter().any(|object| object.id == seen.track));
        for object in &self.traffic {
            let threat = (object.level >= AlertLevel::Caution).then_some(now_us);
            match self.seen.iter_mut().find(|seen| seen.track == object.id) {
                Some(seen) => {
                    if !object.coasting {
                        seen.time_us = frame_time_us;
                    }
                    seen.threat_us = threat.or(seen.threat_us);
                }
                None => {
                    let time_us = frame_time_us;
                    let new =
                        LastSeen { track: object.id, time_us, threat_us: threat, yield_us: None };
                    let _ = self.seen.push(new);
                }
            }
        }
        let confirmed = self.traffic.iter().filter(|object| object.confirmed);
        self.slots.update(confirmed.map(|object| object.id));
        self.match_aircraft(now_us);
        if !self.parameters.is_on(Parameter::Text) {
            return;
        }
        let interval = i64::from(self.parameters.get(Parameter::TextInterval).to_bits());
        let interval_us = (interval * 1_000_000) >> 16;
        for at in 0..self.traffic.len() {
            let object = self.traffic[at];
            if !self.is_reported(&object) {
                continue;
            }
            let callsign = self.callsign(object.id);
            let pointed = self.health.pointed;
            if let Some(words) = self.alerts.due(&object, callsign, pointed, now_us, interval_us) {
                self.say(Destination::All, self.config.component_id, Priority::Urgent, &words);
            }
        }
    }

    /// Sends a STATUSTEXT of at most 50 characters to all links, as about the state of a recording.
    pub fn notify(&mut self, notice: messages::text::Notice) {
        let data = notice.data();
        self.say(Destination::All, self.config.component_id, Priority::Urgent, &data);
    }

    /// The lookout ends: the next messages are a heartbeat and a text of that.
    pub fn end(&mut self) {
        self.ending = true;
    }

    /// The next message to send, answers last. Call it about every 20 ms until it returns `None`.
    pub fn poll(&mut self, now_us: i64) -> Option<Outgoing> {
        if self.outbox.is_empty() {
            self.update_state(now_us);
            self.keep_autopilot(now_us);
            self.keep_gimbal(now_us);
            self.stream(now_us);
        }
        if self.answers.is_empty() {
            self.list_parameters();
        }
        self.outbox.pop_front().or_else(|| self.answers.pop_front())
    }

    /// The next event, oldest first.
    pub fn event(&mut self) -> Option<ComponentEvent> {
        self.events.pop_front()
    }

    /// The parameters as they are now.
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// Numbers of frames that were received, refused or lost.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// State of the lookout.
    pub fn state(&self) -> LookoutState {
        self.state
    }

    /// The autopilot, while it is there.
    pub fn autopilot(&self) -> Option<&Autopilot> {
        self.autopilot.as_ref()
    }

    /// The autopilot that was served last; that of [`Component::autopilot`] while it is there.
    pub fn last_served(&self) -> Option<&Autopilot> {
        self.autopilot.as_ref().or(self.last_served.as_ref())
    }

    /// The vehicle's place, unless it is too old to put others on the map.
    fn fresh_vehicle(&self, now_us: i64) -> Option<Vehicle> {
        self.vehicle.filter(|own| now_us.saturating_sub(own.time_us) <= streams::POSITION_US)
    }

    /// Whether directions of objects from the vehicle are known.
    pub fn is_pointed(&self) -> bool {
        self.health.pointed
    }

    /// Whether the vehicle's place is known well enough to put others on the map.
    pub fn is_positioned(&self, now_us: i64) -> bool {
        self.fresh_vehicle(now_us).is_some()
    }

    /// The vehicle's last known place.
    pub fn vehicle(&self) -> Option<&Vehicle> {
        self.vehicle.as_ref()
    }

    /// Estimated offset of the autopilot's clock.
    pub fn clock(&self) -> &ClockOffset {
        &self.clock
    }

    /// Time of day as the autopilot knows it, in microseconds since 1970.
    pub fn unix_us(&self, now_us: i64) -> Option<i64> {
        self.unix_offset_us.map(|offset| now_us.saturating_add(offset))
    }

    /// Our system id now.
    pub fn system_id(&self) -> u8 {
        let served = self.last_served.map(|last| last.system_id);
        self.config.system_id.or(served).unwrap_or(1)
    }

    /// Time without a finished frame after which the lookout counts as stalled, in microseconds.
    fn stall_us(&self) -> i64 {
        let busy = if self.slow { 3 * i64::from(self.health.busy_us) } else { 0 };
        self.config.stall_us.saturating_add(busy)
    }

    /// The objects that are watched; none after the frames have stopped.
    fn objects(&self, now_us: i64) -> &[Traffic] {
        let fresh =
            self.observed_us.is_some_and(|last| now_us.saturating_sub(last) <= self.stall_us());
        if fresh { &self.traffic } else { &[] }
    }

    /// Milliseconds since our start.
    fn boot_ms(&self, now_us: i64) -> u32 {
        (now_us.saturating_sub(self.started_us).max(0) / 1000) as u32
    }

    fn say<D: MessageData>(
        &mut self,
        to: Destination,
        component: u8,
        priority: Priority,
        data: &D,
    ) {
        self.queue(to, component, priority, Payload::new(data));
    }

    fn queue(&mut self, to: Destination, component_id: u8, priority: Priority, payload: Payload) {
        let system_id = self.system_id();
        let message = Outgoing { to, priority, system_id, component_id, payload };
        let queued = if priority == Priority::Answer {
            let same = self.answers.iter().filter(|answer| answer.to == to).count();
            same < ANSWERS_PER_LINK && self.answers.push_back(message).is_ok()
        } else {
            self.outbox.push_back(message).is_ok()
        };
        if !queued {
            self.counters.overflow = self.counters.overflow.saturating_add(1);
        }
    }

    /// Keeps an event. Of too many the oldest are lost; attitudes never displace others.
    fn happened(&mut self, event: ComponentEvent) {
        if self.events.is_full() {
            if matches!(
                event,
                ComponentEvent::Attitude { .. }
                    | ComponentEvent::Rates { .. }
                    | ComponentEvent::Gimbal { .. }
            ) {
                return;
            }
            self.events.pop_front();
        }
        let _ = self.events.push_back(event);
    }
}

#[cfg(test)]
mod tests;
