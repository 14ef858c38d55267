//! Tracker, threat and MAVLink component joined, on the clock of the frames.
//!
//! Without I/O: a recorded flight, a live one and a board without an operating system run the same code.

use crate::camera::Camera;
use crate::camera::attitude::{Attitude, Direction};
use crate::camera::attitude_buffer::AttitudeBuffer;
use crate::detector::Detections;
use crate::math::real::{ONE, PI, Real, ZERO};
use crate::mavlink::component::parameters::{Parameter, Parameters};
use crate::mavlink::component::{
    Component, ComponentConfig, ComponentEvent, GIMBAL_STALE_US, Outgoing, Trust,
};
use crate::mavlink::messages::text::Notice;
use crate::mavlink::messages::{Blind, Health};
use crate::mavlink::placing::{News, Placing, UnplacedCause};
use crate::tracking::tracker;
use crate::tracking::traffic::{MAX_TRAFFIC, Traffic};
use crate::tracking::{TrafficMonitor, TrafficSettings};
use mavlink_core::MAVLinkMessageRaw;

/// Bits after the point of a quaternion's numbers.
const QUATERNION_BITS: u32 = 30;

/// Events that wait to be taken.
const EVENTS: usize = 8;

/// An attitude of the vehicle older than this is none, in microseconds.
const NO_ATTITUDE_US: i64 = 1_500_000;

/// Tracks one camera's detections and reports them over MAVLink.
///
/// ```
/// use lookout::camera::Camera;
/// use lookout::detector::Detections;
/// use lookout::math::real::PI;
/// use lookout::mavlink::component::ComponentConfig;
/// use lookout::mavlink::component::parameters::Parameters;
/// use lookout::mavlink::lookout::Lookout;
/// use lookout::tracking::tracker;
///
/// let camera = Camera::from_field_of_view(640, 480, PI / 3)?;
/// let tracks = tracker::TrackerSettings::default();
/// let mut onboard = Lookout::new(camera, tracks, ComponentConfig::default(), Parameters::default(), 0);
/// // For each frame: the detector's result, when it was taken, and when it was finished.
/// let traffic = onboard.process(&Detections::default(), 0, 30_000);
/// assert!(traffic.is_empty());
/// // Every 20 ms: the messages to send.
/// while let Some(message) = onboard.poll(40_000) {
///     assert!(message.payload.frame_len() <= 280);
/// }
/// # Ok::<(), lookout::camera::CameraError>(())
/// ```
#[derive(Debug)]
pub struct Lookout {
    tracks: tracker::TrackerSettings,
    watch: TrafficMonitor,
    /// The vehicle's.
    attitudes: AttitudeBuffer,
    /// Those of the gimbal that carries the camera, where there is one.
    gimbal: AttitudeBuffer,
    /// The camera as it was given, and the field of view (radians) that it has itself.
    given: Camera,
    view: Option<Real>,
    component: Component,
    health: Health,
    placing: Placing,
    /// Time of the last frame, microseconds.
    frame_us: i64,
    events: heapless::Deque<ComponentEvent, EVENTS>,
}

impl Lookout {
    /// Without traffic and without an autopilot. `tracks` are the settings for the scores of the model in use
    /// ([`tracker::TrackerSettings::calibrated`]); `parameters` make them stricter or laxer.
    pub fn new(
        camera: Camera,
        tracks: tracker::TrackerSettings,
        config: ComponentConfig,
        parameters: Parameters,
        now_us: i64,
    ) -> Self {
        Self {
            tracks,
            watch: TrafficMonitor::new(settings(tracks, &parameters), camera),
            attitudes: AttitudeBuffer::new(),
            gimbal: AttitudeBuffer::held_for(GIMBAL_STALE_US),
            given: camera,
            view: None,
            component: Component::new(config, parameters, now_us),
            health: Health::default(),
            placing: Placing::default(),
            frame_us: 0,
            events: heapless::Deque::new(),
        }
    }

    /// Handles a MAVLink frame received on `link` at `now_us`.
    pub fn receive(&mut self, link: u8, frame: &MAVLinkMessageRaw, trust: Trust, now_us: i64) {
        self.component.receive(link, frame, trust, now_us);
        self.handle_events();
    }

    /// Changes the camera; every track ends. On a gimbal its mounting is that in the gimbal's axes, and the field of view is
    /// the one in the gimbal's messages.
    pub fn set_camera(&mut self, camera: Camera) {
        self.given = camera;
        let zoomed = self.view.and_then(|view| zoomed(&camera, view));
        self.look_through(zoomed.unwrap_or(camera));
    }

    fn look_through(&mut self, camera: Camera) {
        self.watch =
            TrafficMonitor::new(settings(self.tracks, self.component.parameters()), camera);
    }

    /// Sets the number of frames dropped since the start, the reasons for a blocked view, and the detector's time for the next
    /// frame in microseconds; reported with that frame.
    pub fn report(&mut self, dropped: u32, blind: Blind, busy_us: i64) {
        self.health.busy_us = u32::try_from(busy_us.max(0)).unwrap_or(u32::MAX);
        self.health.dropped = dropped;
        self.health.blind = blind;
    }

    /// Updates the tracks with the detections of the frame taken at `time_us` and finished at `now_us`. Returns the tracks
    /// with their threat.
    pub fn process(
        &mut self,
        found: &Detections,
        time_us: i64,
        now_us: i64,
    ) -> heapless::Vec<Traffic, MAX_TRAFFIC> {
        self.frame_us = time_us;
        self.watch.support(self.component.explained());
        let on_gimbal = self.component.gimbal().is_some();
        let carrier = if on_gimbal { &self.gimbal } else { &self.attitudes };
        let mut traffic = self.watch.update(&found.list, time_us, &found.motion, carrier);
        self.health.pointed = !on_gimbal || self.see_from_vehicle(&mut traffic, time_us);
        self.count_unplaced(&traffic, time_us, now_us);
        self.health.frames = self.health.frames.wrapping_add(1);
        let latency = now_us.saturating_sub(time_us).max(0);
        self.health.latency_us = u32::try_from(latency).unwrap_or(u32::MAX);
        self.component.observe(&traffic, self.health, time_us, now_us);
        traffic
    }

    /// Turns directions from the gimbal's axes to the vehicle's; whether both are known. Without a recent attitude of the
    /// gimbal none in the world is known either.
    fn see_from_vehicle(&self, traffic: &mut [Traffic], time_us: i64) -> bool {
        let fresh = self.is_gimbal_fresh(time_us);
        let turn = self.gimbal_on_vehicle(time_us);
        for object in traffic {
            object.ned = object.ned.filter(|_| fresh);
            if let Some(turn) = turn {
                object.body = Direction::from(turn.rotate(object.body.into()));
            }
        }
        turn.is_some()
    }

    /// From the gimbal's axes to the vehicle's.
    fn gimbal_on_vehicle(&self, time_us: i64) -> Option<Attitude> {
        let gimbal = self.gimbal.at(time_us).filter(|_| self.is_gimbal_fresh(time_us))?;
        Some(self.attitudes.at(time_us)?.inverse().compose(gimbal))
    }

    fn is_gimbal_fresh(&self, time_us: i64) -> bool {
        self.gimbal.nearest_us(time_us).is_some_and(|apart| apart <= GIMBAL_STALE_US)
    }

    /// Counts the objects that have no place in the world, and says so where it goes on.
    fn count_unplaced(&mut self, traffic: &[Traffic], time_us: i64, now_us: i64) {
        let gimbal = match self.component.gimbal() {
            Some(_) if !self.is_gimbal_fresh(time_us) => Some(UnplacedCause::Gimbal),
            _ => None,
        };
        let attitude = || match self.attitudes.last_before(time_us) {
            Some(last) if time_us.saturating_sub(last) <= NO_ATTITUDE_US => {
                UnplacedCause::RareAttitude
            }
            _ => UnplacedCause::NoAttitude,
        };
        let autopilot = self.component.autopilot().is_some();
        // A gimbal that counts from the vehicle's heading is of no use without it.
        let heard = self.component.gimbal().and_then(|gimbal| gimbal.heard_us());
        let gimbal_comes = heard.is_some_and(|us| now_us.saturating_sub(us) <= GIMBAL_STALE_US);
        let undirected = || match gimbal {
            _ if !autopilot => UnplacedCause::NoAutopilot,
            Some(gimbal) if !gimbal_comes => gimbal,
            _ => attitude(),
        };
        let positioned = self.component.is_positioned(now_us);
        let confirmed = traffic.iter().filter(|object| object.confirmed);
        for object in confirmed.clone() {
            let cause = match object.ned {
                None => Some(undirected()),
                Some(_) if !positioned => Some(UnplacedCause::NoPosition),
                Some(_) => None,
            };
            self.placing.object(cause);
        }
        if confirmed.count() == 0 && self.component.gimbal().is_some() && autopilot {
            self.placing.frame(gimbal.map(|_| undirected()));
        }
        match self.placing.news(now_us) {
            None | Some(News::Lost(UnplacedCause::NoAutopilot)) => {}
            Some(news) => {
                if self.component.parameters().is_on(Parameter::Text) {
                    self.component.notify(Notice::Map(news));
                }
                self.happened(ComponentEvent::Map(news));
            }
        }
    }

    /// Whether directions of objects from the vehicle are known.
    pub fn is_pointed(&self) -> bool {
        self.health.pointed
    }

    /// Counts of objects that had a place in the world, and of those without one by cause.
    pub fn placing(&self) -> &Placing {
        &self.placing
    }

    /// How often attitudes of the vehicle come, or came last: microseconds between two.
    pub fn attitude_interval_us(&self) -> Option<i64> {
        self.attitudes.interval_us()
    }

    /// The next message to send. Call it about every 20 ms until it returns `None`.
    pub fn poll(&mut self, now_us: i64) -> Option<Outgoing> {
        let message = self.component.poll(now_us);
        self.handle_events();
        message
    }

    /// Sends a text about the lookout's own outputs to all.
    pub fn notify(&mut self, notice: Notice) {
        self.component.notify(notice);
    }

    /// The lookout ends: see [`Component::end`].
    pub fn end(&mut self) {
        self.component.end();
    }

    /// The attitude of the vehicle at `time_us`, where it is known.
    pub fn attitude(&self, time_us: i64) -> Option<Attitude> {
        self.attitudes.at(time_us)
    }

    /// The camera as it looked from the vehicle in the last frame; `None` where it is not known where a gimbal points.
    pub fn camera_on_vehicle(&self) -> Option<Camera> {
        let camera = self.watch.camera();
        if self.component.gimbal().is_none() {
            return Some(*camera);
        }
        let turn = self.gimbal_on_vehicle(self.frame_us)?;
        Some(camera.mounted(turn.compose(camera.mounting())))
    }

    /// The camera; on a gimbal its mounting is that in the gimbal's axes.
    pub fn camera(&self) -> &Camera {
        self.watch.camera()
    }

    /// The next event, oldest first. Attitudes are handled here; when the queue is full the oldest event is dropped.
    pub fn event(&mut self) -> Option<ComponentEvent> {
        self.events.pop_front()
    }

    /// The component, to look at.
    pub fn component(&self) -> &Component {
        &self.component
    }

    fn handle_events(&mut self) {
        while let Some(event) = self.component.event() {
            match event {
                ComponentEvent::Attitude { time_us, quaternion } => {
                    if let Some(attitude) = from_wire(quaternion) {
                        self.attitudes.push(time_us, attitude);
                    }
                    continue;
                }
                ComponentEvent::Rates { time_us, rates } => {
                    self.attitudes.push_rate(time_us, rates);
                    continue;
                }
                ComponentEvent::Gimbal { time_us, quaternion, from_north } => {
                    let vehicle = || self.attitudes.at(time_us).map(heading);
                    let from = if from_north { Some(Attitude::IDENTITY) } else { vehicle() };
                    if let (Some(gimbal), Some(from)) = (from_wire(quaternion), from) {
                        self.gimbal.push(time_us, from.compose(gimbal));
                    }
                    continue;
                }
                ComponentEvent::FieldOfView { degrees } => {
                    if !self.zoom(Real::from(degrees) * PI / 180) {
                        continue;
                    }
                }
                ComponentEvent::Restarted | ComponentEvent::Lost | ComponentEvent::Found { .. } => {
                    self.attitudes.clear();
                    self.gimbal.clear();
                }
                ComponentEvent::Parameter(_) => {
                    self.watch.set(settings(self.tracks, self.component.parameters()));
                }
                ComponentEvent::Returned { .. } | ComponentEvent::Map(_) => {}
            }
            self.happened(event);
        }
    }

    /// Takes the field of view that the camera says itself, in radians; whether it is another one than before.
    fn zoom(&mut self, view: Real) -> bool {
        let change = (self.camera().field_of_view() - view).saturating_abs();
        let Some(camera) = zoomed(&self.given, view).filter(|_| change * SAME_VIEW > view) else {
            return false;
        };
        self.view = Some(view);
        self.look_through(camera);
        true
    }

    fn happened(&mut self, event: ComponentEvent) {
        if self.events.is_full() {
            self.events.pop_front();
        }
        // There is room now.
        let _ = self.events.push_back(event);
    }
}

/// Fields of view that differ by less than this part are the same: tracks end with another one.
const SAME_VIEW: i64 = 50;

/// The camera of another field of view (radians); the given one, with its calibration, where the two are within a twentieth.
fn zoomed(given: &Camera, view: Real) -> Option<Camera> {
    if (given.field_of_view() - view).saturating_abs() * 20 <= view {
        return Some(*given);
    }
    let spec = given.intrinsics();
    let camera = Camera::from_field_of_view(spec.width, spec.height, view).ok()?;
    Some(camera.mounted(given.mounting()))
}

fn from_wire(quaternion: [i32; 4]) -> Option<Attitude> {
    let real = |bits: i32| Real::from_bits(i64::from(bits) << (32 - QUATERNION_BITS));
    Attitude::new(quaternion.map(real))
}

/// The turn about down that brings north to where the vehicle's nose points.
fn heading(vehicle: Attitude) -> Attitude {
    let nose = Direction::from(vehicle.rotate([ONE, ZERO, ZERO]));
    Attitude::from_euler(ZERO, ZERO, nose.azimuth())
}

/// Settings of tracker and alerts under these parameters.
fn settings(tracks: tracker::TrackerSettings, parameters: &Parameters) -> TrafficSettings {
    let real = |parameter| Real::from(parameters.get(parameter));
    let mut settings = TrafficSettings { track: tracks, ..TrafficSettings::default() };
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
        let tracks = tracker::TrackerSettings::default();
        assert_eq!(settings(tracks, &Parameters::default()), TrafficSettings::default());
    }

    #[test]
    fn the_threshold_moves_the_scores_of_the_model() {
        let (start_score, confirm_score, keep_score) = (-9, -7, -20);
        let default = tracker::TrackerSettings::default();
        let tracks = tracker::TrackerSettings { start_score, confirm_score, keep_score, ..default };
        let mut parameters = Parameters::default();
        assert!(parameters.set(Parameter::Threshold, 1.0));
        let moved = settings(tracks, &parameters).track;
        let scores = [moved.start_score, moved.confirm_score, moved.keep_score];
        assert_eq!(scores, [start_score, confirm_score, keep_score].map(|v| v + (1 << 16)));
    }

    #[test]
    fn an_autopilot_is_told_of_once() {
        let camera = Camera::from_field_of_view(64, 48, Real::ONE).unwrap();
        let (tracks, parameters) = (tracker::TrackerSettings::default(), Parameters::default());
        let mut onboard = Lookout::new(camera, tracks, ComponentConfig::default(), parameters, 0);
        let heartbeat = HEARTBEAT_DATA {
            autopilot: MavAutopilot::MAV_AUTOPILOT_PX4,
            mavtype: MavType::MAV_TYPE_QUADROTOR,
            ..messages::status::heartbeat(onboard.component().state(), HeartbeatType::default())
        };
        let frame = MAVLinkMessageRaw::V2(Payload::new(&heartbeat).frame(7, 1, 0, false));
        for now_us in [0, 1_000_000] {
            onboard.receive(0, &frame, Trust::Open, now_us);
        }
        assert_eq!(onboard.event(), Some(ComponentEvent::Found { system_id: 7, autopilot: 12 }));
        assert_eq!(onboard.event(), None);
    }
}
