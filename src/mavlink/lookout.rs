//! Tracker, threat and MAVLink component joined, on the clock of the frames (level 9).
//!
//! Without I/O: a recorded flight, a live one and a board without an operating system run the same code.

use crate::camera::Camera;
use crate::camera::attitude::Attitude;
use crate::camera::attitude_buffer::Attitudes;
use crate::detector::Detections;
use crate::math::real::Real;
use crate::mavlink::component::parameters::{Parameter, Parameters};
use crate::mavlink::component::{Component, Config, Event, Outgoing, Trust};
use crate::mavlink::messages::text::Notice;
use crate::mavlink::messages::{Blind, Health};
use crate::tracking::tracker;
use crate::tracking::traffic::{MAX_TRAFFIC, Traffic};
use crate::tracking::{Settings, Watch};
use mavlink_core::MAVLinkMessageRaw;

/// Bits after the point of a quaternion's numbers.
const QUATERNION_BITS: u32 = 30;

/// Events that wait to be taken.
const EVENTS: usize = 8;

/// Tracks one camera's detections and reports them over MAVLink.
///
/// ```
/// use lookout::camera::Camera;
/// use lookout::detector::Detections;
/// use lookout::math::real::PI;
/// use lookout::mavlink::component::Config;
/// use lookout::mavlink::component::parameters::Parameters;
/// use lookout::mavlink::lookout::Onboard;
/// use lookout::tracking::tracker;
///
/// let camera = Camera::from_field_of_view(640, 480, PI / 3)?;
/// let tracks = tracker::Settings::default();
/// let mut onboard = Onboard::new(camera, tracks, Config::default(), Parameters::default(), 0);
/// // For each frame: the detector's result, when it was taken, and when it was finished.
/// let traffic = onboard.see(&Detections::default(), 0, 30_000);
/// assert!(traffic.is_empty());
/// // Every 20 ms: the messages to send.
/// while let Some(message) = onboard.poll(40_000) {
///     assert!(message.payload.frame_len() <= 280);
/// }
/// # Ok::<(), lookout::camera::CameraError>(())
/// ```
#[derive(Debug)]
pub struct Onboard {
    tracks: tracker::Settings,
    watch: Watch,
    attitudes: Attitudes,
    component: Component,
    health: Health,
    events: heapless::Deque<Event, EVENTS>,
}

impl Onboard {
    /// Without traffic and without an autopilot. `tracks` are the settings for the scores of the model in use
    /// ([`tracker::Settings::calibrated`]); `parameters` make them stricter or laxer.
    pub fn new(
        camera: Camera,
        tracks: tracker::Settings,
        config: Config,
        parameters: Parameters,
        now_us: i64,
    ) -> Self {
        Self {
            tracks,
            watch: Watch::new(settings(tracks, &parameters), camera),
            attitudes: Attitudes::new(),
            component: Component::new(config, parameters, now_us),
            health: Health::default(),
            events: heapless::Deque::new(),
        }
    }

    /// Handles a MAVLink frame received on `link` at `now_us`.
    pub fn hear(&mut self, link: u8, frame: &MAVLinkMessageRaw, trust: Trust, now_us: i64) {
        self.component.receive(link, frame, trust, now_us);
        self.heed();
    }

    /// Changes the camera; every track ends.
    pub fn set_camera(&mut self, camera: Camera) {
        self.watch = Watch::new(settings(self.tracks, self.component.parameters()), camera);
    }

    /// Sets the number of frames dropped since the start and the reasons for a blocked view, reported with the next frame.
    pub fn report(&mut self, dropped: u32, blind: Blind) {
        self.health.dropped = dropped;
        self.health.blind = blind;
    }

    /// Updates the tracks with the detections of the frame taken at `time_us` and finished at `now_us`. Returns the tracks
    /// with their threat.
    pub fn see(
        &mut self,
        found: &Detections,
        time_us: i64,
        now_us: i64,
    ) -> heapless::Vec<Traffic, MAX_TRAFFIC> {
        self.watch.support(self.component.explained());
        let traffic = self.watch.update(&found.list, time_us, &found.motion, &self.attitudes);
        self.health.frames = self.health.frames.wrapping_add(1);
        let latency = now_us.saturating_sub(time_us).max(0);
        self.health.latency_us = u32::try_from(latency).unwrap_or(u32::MAX);
        self.component.observe(&traffic, self.health, time_us, now_us);
        traffic
    }

    /// The next message to send. Call it about every 20 ms until it returns `None`.
    pub fn poll(&mut self, now_us: i64) -> Option<Outgoing> {
        let message = self.component.poll(now_us);
        self.heed();
        message
    }

    /// Sends a text about the lookout's own outputs to all.
    pub fn notify(&mut self, notice: Notice) {
        self.component.notify(notice);
    }

    /// The attitude of the vehicle at `time_us`, where it is known.
    pub fn attitude(&self, time_us: i64) -> Option<Attitude> {
        self.attitudes.at(time_us)
    }

    /// The camera.
    pub fn camera(&self) -> &Camera {
        self.watch.camera()
    }

    /// The next event, oldest first. Attitudes are handled here; when the queue is full the oldest event is dropped.
    pub fn event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// The component, to look at.
    pub fn component(&self) -> &Component {
        &self.component
    }

    fn heed(&mut self) {
        while let Some(event) = self.component.event() {
            match event {
                Event::Attitude { time_us, quaternion } => {
                    let real =
                        |bits: i32| Real::from_bits(i64::from(bits) << (32 - QUATERNION_BITS));
                    if let Some(attitude) = Attitude::new(quaternion.map(real)) {
                        self.attitudes.push(time_us, attitude);
                    }
                    continue;
                }
                Event::Restarted | Event::Lost => self.attitudes.clear(),
                Event::Parameter(_) => {
                    self.watch.set(settings(self.tracks, self.component.parameters()));
                }
                Event::Found { .. } | Event::Returned { .. } => {}
            }
            if self.events.is_full() {
                self.events.pop_front();
            }
            // There is room now.
            let _ = self.events.push_back(event);
        }
    }
}

/// Settings of tracker and alerts under these parameters.
fn settings(tracks: tracker::Settings, parameters: &Parameters) -> Settings {
    let real = |parameter| Real::from(parameters.get(parameter));
    let mut settings = Settings { track: tracks, ..Settings::default() };
    let surer = parameters.get(Parameter::Threshold).to_bits();
    settings.track.start_score = tracks.start_score.saturating_add(surer);
    settings.track.confirm_score = tracks.confirm_score.saturating_add(surer);
    settings.track.keep_score = tracks.keep_score.saturating_add(surer);
    settings.threat.wingspan = real(Parameter::Wingspan);
    settings.threat.caution_time = real(Parameter::CautionTime);
    settings.threat.warning_time = real(Parameter::WarningTime);
    settings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mavlink::dialect::{HEARTBEAT_DATA, MavAutopilot, MavType};
    use crate::mavlink::messages::status::HeartbeatType;
    use crate::mavlink::messages::{self, Payload};

    #[test]
    fn the_parameters_defaults_are_those_of_the_tracker() {
        let tracks = tracker::Settings::default();
        assert_eq!(settings(tracks, &Parameters::default()), Settings::default());
    }

    #[test]
    fn the_threshold_moves_the_scores_of_the_model() {
        let (start_score, confirm_score, keep_score) = (-9, -7, -20);
        let default = tracker::Settings::default();
        let tracks = tracker::Settings { start_score, confirm_score, keep_score, ..default };
        let mut parameters = Parameters::default();
        assert!(parameters.set(Parameter::Threshold, 1.0));
        let moved = settings(tracks, &parameters).track;
        let scores = [moved.start_score, moved.confirm_score, moved.keep_score];
        assert_eq!(scores, [start_score, confirm_score, keep_score].map(|v| v + (1 << 16)));
    }

    #[test]
    fn an_autopilot_is_told_of_once() {
        let camera = Camera::from_field_of_view(64, 48, Real::ONE).unwrap();
        let (tracks, parameters) = (tracker::Settings::default(), Parameters::default());
        let mut onboard = Onboard::new(camera, tracks, Config::default(), parameters, 0);
        let heartbeat = HEARTBEAT_DATA {
            autopilot: MavAutopilot::MAV_AUTOPILOT_PX4,
            mavtype: MavType::MAV_TYPE_QUADROTOR,
            ..messages::status::heartbeat(onboard.component().state(), HeartbeatType::default())
        };
        let frame = MAVLinkMessageRaw::V2(Payload::new(&heartbeat).frame(7, 1, 0, false));
        for now_us in [0, 1_000_000] {
            onboard.hear(0, &frame, Trust::Open, now_us);
        }
        assert_eq!(onboard.event(), Some(Event::Found { system_id: 7, autopilot: 12 }));
        assert_eq!(onboard.event(), None);
    }
}
