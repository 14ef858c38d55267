//! The lookout as a MAVLink component: what it hears, what it answers, what it tells (level 4).
//!
//! A state machine without I/O: frames that arrived go in with [`Component::receive`], what was seen with
//! [`Component::observe`]; [`Component::poll`] gives what is to be sent, [`Component::event`] what others want to know.
//! All times are microseconds of one clock that never goes back, that of the frames.

pub mod parameters;

use crate::message::{Health, Payload};
use crate::traffic::Traffic;
use mavlink::MAVLinkMessageRaw;
use parameters::{Parameter, Parameters};

/// What is fixed while the component runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Config {
    /// Our system id. `None`: the autopilot's, from its first heartbeat; 1 until then.
    pub system_id: Option<u8>,
    /// Our component id. Default 196, MAV_COMP_ID_OBSTACLE_AVOIDANCE; 191 is the neutral choice.
    pub component_id: u8,
    /// Behave as a camera too, so that QGroundControl draws a box (off by default).
    pub camera: Option<Camera>,
    /// How often the autopilot is asked for its attitude, a second. Default 50.
    pub attitude_hz: u16,
    /// How often the autopilot is asked for its position, a second. Default 5.
    pub position_hz: u16,
    /// Without a finished frame for this long the lookout counts as stalled, in microseconds. Default 700 000.
    pub stall_us: i64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            system_id: None,
            component_id: 196,
            camera: None,
            attitude_hz: 50,
            position_hz: 5,
            stall_us: 700_000,
        }
    }
}

/// The camera component that CAMERA_TRACKING_IMAGE_STATUS needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Camera {
    /// Its component id: 100, MAV_COMP_ID_CAMERA, unless another program serves that camera.
    pub component_id: u8,
    /// Width of the frames in pixels.
    pub width: u16,
    /// Height of the frames in pixels.
    pub height: u16,
}

/// What a frame's signature is worth.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trust {
    /// No key is configured: everyone may command.
    Open,
    /// Rightly signed.
    Signed,
    /// A key is configured and the frame bears no signature: it may inform, not command.
    Unsigned,
    /// Wrongly signed, or signed with a time of the past: not heard at all.
    Forged,
}

/// Where a message is to go.
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
    /// Where to.
    pub to: Destination,
    /// Sent even when a link's budget is used up: heartbeats, warnings, answers.
    pub urgent: bool,
    /// Our system id.
    pub system_id: u8,
    /// The component that speaks.
    pub component_id: u8,
    /// What it says.
    pub payload: Payload,
}

/// What happened, for those around the component.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event {
    /// The first heartbeat of an autopilot, or of another one after ours was lost.
    Found {
        /// Its system id.
        system_id: u8,
        /// Its MAV_AUTOPILOT: 3 ArduPilot, 12 PX4.
        autopilot: u8,
    },
    /// No heartbeat of the autopilot for five seconds.
    Lost,
    /// The autopilot's time since boot fell: attitudes from before are of another flight.
    Restarted,
    /// Attitude of the vehicle: rotation from body (forward, right, down) to north, east, down.
    Attitude {
        /// When it was measured, in microseconds of our clock.
        time_us: i64,
        /// Quaternion w, x, y, z of unit length in Q30.
        quaternion: [i32; 4],
    },
    /// A parameter was set to another value, which is to be kept over a restart.
    Parameter(Parameter),
}

/// What was refused or lost, since the start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counters {
    /// Frames heard.
    pub received: u32,
    /// Frames that do not hold what their number says.
    pub malformed: u32,
    /// Commands and parameter writes without the signature they need.
    pub refused: u32,
    /// Frames wrongly signed.
    pub forged: u32,
    /// Messages that found no room in the queue.
    pub overflow: u32,
}

/// The component.
#[derive(Debug)]
pub struct Component {
    config: Config,
    parameters: Parameters,
    counters: Counters,
}

impl Component {
    /// A component that has heard nothing yet.
    pub fn new(config: Config, parameters: Parameters, now_us: i64) -> Self {
        let _ = now_us;
        Self { config, parameters, counters: Counters::default() }
    }

    /// Hears a frame that came over `link` and passed its checksum.
    pub fn receive(&mut self, link: u8, frame: &MAVLinkMessageRaw, trust: Trust, now_us: i64) {
        let _ = (link, frame, trust, now_us);
    }

    /// Takes what was seen in the frame of `frame_time_us`. To be called for every frame that was finished, also when
    /// nothing was seen: silence means stalled.
    pub fn observe(
        &mut self,
        traffic: &[Traffic],
        health: Health,
        frame_time_us: i64,
        now_us: i64,
    ) {
        let _ = (traffic, health, frame_time_us, now_us);
    }

    /// The next message to be sent, if any; to be called until there is none, every 20 ms or so.
    pub fn poll(&mut self, now_us: i64) -> Option<Outgoing> {
        let _ = now_us;
        None
    }

    /// The next thing that happened, oldest first.
    pub fn event(&mut self) -> Option<Event> {
        None
    }

    /// The parameters as they are now.
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// What was refused or lost.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// Our system id now.
    pub fn system_id(&self) -> u8 {
        self.config.system_id.unwrap_or(1)
    }
}
