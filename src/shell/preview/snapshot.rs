//! State shown on the page: plain data, one snapshot a frame.

use crate::camera::Camera;
use crate::mavlink::component::Component;
use crate::mavlink::component::parameters::{Parameter, Parameters};
use crate::mavlink::messages::Blind;
use crate::shell::formats::detections::Decimal;
use crate::shell::formats::traffic::name;
use crate::shell::link::{LinkSpec, LinkStatus};
use crate::tracking::traffic::{AlertLevel, Direction, Traffic};
use fixed::types::I28F4;
use serde::{Serialize, Serializer};
use std::string::{String, ToString};
use std::vec::Vec;

/// The lookout at one time.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Snapshot {
    /// The frame, if [`super::Preview::wants_picture`] was true.
    #[serde(skip)]
    pub picture: Option<PictureView>,
    /// Time of the frame in microseconds.
    pub time_us: i64,
    /// The objects that are followed.
    pub tracks: Vec<TrackView>,
    /// The most urgent level of all.
    #[serde(serialize_with = "level")]
    pub level: AlertLevel,
    /// Counts, latencies and state of the machine.
    pub health: HealthView,
    /// How long the stages of the work take.
    pub latency: Vec<Latency>,
    /// The links to autopilots and ground stations.
    pub links: Vec<LinkView>,
    /// Name of the autopilot, once one was received.
    pub autopilot: Option<String>,
    /// Whether it is gone.
    pub autopilot_lost: bool,
    /// Why objects are not put on the map, in words.
    pub off_map: Option<String>,
    /// The parameters that ground stations set.
    pub parameters: Vec<ParameterLine>,
    /// Horizontal field of view of the camera in degrees; see [`Snapshot::look_through`].
    pub field_of_view_deg: f64,
    /// Where the middle of the picture is, in degrees to the right of the vehicle's nose.
    pub camera_azimuth_deg: f64,
}

impl Snapshot {
    /// Fills in field of view and direction of the camera, where these are known.
    pub fn look_through(&mut self, camera: Option<&Camera>) {
        let Some(camera) = camera else {
            (self.field_of_view_deg, self.camera_azimuth_deg) = (0.0, 0.0);
            return;
        };
        let (width, height) = (camera.intrinsics().width, camera.intrinsics().height);
        let middle = I28F4::saturating_from_num(height) / 2;
        let azimuth = |x: I28F4| degrees(Direction::from(camera.body(x, middle)).azimuth());
        let width = I28F4::saturating_from_num(width);
        self.camera_azimuth_deg = azimuth(width / 2);
        // A camera that looks backward has the jump from 180 to -180 in its picture.
        self.field_of_view_deg = (azimuth(width) - azimuth(I28F4::ZERO)).rem_euclid(360.0);
    }
}

/// A parameter of the lookout.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct ParameterLine {
    /// Its name, `LK_...`.
    pub name: &'static str,
    /// Value of the parameter now.
    pub value: f32,
    /// Least and largest value.
    pub range: [f32; 2],
}

impl ParameterLine {
    /// All of them, in the order of their indices.
    pub fn all(parameters: &Parameters) -> Vec<Self> {
        let line = |parameter: Parameter| {
            let (least, most) = parameter.range();
            let (name, value) = (parameter.name(), parameters.wire(parameter));
            Self { name, value, range: [least, most] }
        };
        Parameter::all().map(line).collect()
    }
}

/// A grey picture.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct PictureView {
    /// Row by row, without gaps.
    pub pixels: Vec<u8>,
    /// Pixels of a row.
    pub width: usize,
    /// Number of rows of pixels.
    pub height: usize,
}

/// An object that is followed.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct TrackView {
    /// Number of the track.
    pub id: u16,
    /// Left, top, width, height in pixels of the picture.
    pub rect: [f64; 4],
    /// How urgent it is.
    #[serde(serialize_with = "level")]
    pub level: AlertLevel,
    /// Whether enough detections agreed that it is there.
    pub confirmed: bool,
    /// Whether the frame has no detection of it and its position is predicted.
    pub coasting: bool,
    /// Degrees to the right of the vehicle's nose; none where it is not known where a gimbal points.
    pub azimuth_deg: Option<f64>,
    /// Degrees above the vehicle's level plane.
    pub elevation_deg: Option<f64>,
    /// Callsign of the aircraft that explains it; empty without one.
    pub callsign: String,
    /// Whether it is of the own fleet, and not reported.
    pub muted: bool,
    /// Distance in metres, where it is known.
    pub range_m: Option<f64>,
    /// Standard deviation of the distance in metres.
    pub range_sigma_m: Option<f64>,
    /// Time to contact in seconds, where one is foreseen.
    pub time_to_contact_s: Option<f64>,
    /// Score of the last detection: log-odds.
    pub score: f64,
}

impl TrackView {
    /// The track with what `component` knows of it.
    pub fn named(traffic: &Traffic, component: &Component) -> Self {
        Self {
            callsign: component
                .aircraft_of(traffic.id)
                .and_then(|aircraft| aircraft.callsign)
                .map_or(String::new(), |callsign| callsign.to_string()),
            muted: component.is_muted(traffic.id),
            ..if component.is_pointed() {
                Self::from(traffic)
            } else {
                Self { azimuth_deg: None, elevation_deg: None, ..Self::from(traffic) }
            }
        }
    }
}

impl From<&Traffic> for TrackView {
    fn from(traffic: &Traffic) -> Self {
        let rect = traffic.rect;
        Self {
            id: traffic.id,
            rect: [rect.x, rect.y, rect.width, rect.height].map(|v| v.to_num()),
            level: traffic.level,
            confirmed: traffic.confirmed,
            coasting: traffic.coasting,
            azimuth_deg: Some(degrees(traffic.body.azimuth())),
            elevation_deg: Some(degrees(traffic.body.elevation())),
            callsign: String::new(),
            muted: false,
            range_m: traffic.range.map(|range| range.value.to_num()),
            range_sigma_m: traffic.range.map(|range| range.sigma.to_num()),
            time_to_contact_s: traffic.time_to_contact.map(|time| time.value.to_num()),
            score: Decimal::score(traffic.score).to_f64(),
        }
    }
}

/// How the work goes.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct HealthView {
    /// The state in one word.
    pub state: StateView,
    /// Why nothing can be seen, if so.
    #[serde(serialize_with = "reasons")]
    pub blind: Blind,
    /// Frames the detector finished, since the start.
    pub frames: u64,
    /// Frames left out because the detector was busy, since the start.
    pub dropped: u64,
    /// Frames the detector finishes a second.
    pub frames_per_second: f64,
    /// The camera in words: device, size, format.
    pub camera: String,
    /// Advice where the detector is too slow for the frame rate.
    pub advice: Option<String>,
}

impl HealthView {
    /// Why nothing can be seen, in words.
    pub fn reasons(&self) -> impl Iterator<Item = &'static str> {
        self.blind.reasons()
    }
}

/// The state of the lookout.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StateView {
    /// No frame yet.
    #[default]
    Starting,
    /// Frames come, and something can be seen in them.
    Watching,
    /// Frames come, but nothing can be seen in them.
    Blind,
    /// The source gives no frames.
    CameraGone,
    /// Frames come, but the detector takes too long for one.
    Slow,
}

/// How long a stage of the work takes.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Latency {
    /// The stage in words.
    pub stage: String,
    /// Median in milliseconds.
    pub p50_ms: f64,
    /// 99th percentile in milliseconds.
    pub p99_ms: f64,
}

/// State of a MAVLink link.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct LinkView {
    /// The link as the user named it.
    pub name: String,
    /// Whether it is open, and somebody answers.
    pub state: LinkState,
    /// Frames given to it.
    pub sent: u64,
    /// Frames left out: for its budget, or for waiting too long.
    pub dropped: u64,
}

/// State of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LinkState {
    /// The link is not open.
    #[default]
    Down,
    /// Open, but nothing was heard for [`SILENT_US`]: a UDP link is open also while nobody is there.
    Silent,
    /// Open, and frames are heard.
    Up,
}

/// Time without a frame after which a link is silent, microseconds: five heartbeats.
pub const SILENT_US: i64 = 5_000_000;

impl LinkView {
    /// The link of `spec` at `now_us`.
    pub fn new(spec: &LinkSpec, status: LinkStatus, now_us: i64) -> Self {
        let heard = status.heard_us.is_some_and(|last| now_us.saturating_sub(last) < SILENT_US);
        Self {
            name: spec.to_string(),
            state: match (status.connected, heard) {
                (false, _) => LinkState::Down,
                (true, false) => LinkState::Silent,
                (true, true) => LinkState::Up,
            },
            sent: status.sent.into(),
            dropped: u64::from(status.capped) + u64::from(status.dropped),
        }
    }
}

fn degrees(radians: crate::math::real::Real) -> f64 {
    radians.to_num::<f64>().to_degrees()
}

fn level<S: Serializer>(level: &AlertLevel, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(name(*level))
}

fn reasons<S: Serializer>(blind: &Blind, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(blind.reasons())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::attitude::Attitude;
    use crate::math::real::{PI, Real};
    use crate::mavlink::messages::tests::traffic;
    use serde_json::json;

    fn near(a: f64, b: f64) -> bool {
        (a - b).abs() < 0.01
    }

    #[test]
    fn a_track_in_degrees_and_metres() {
        let track = TrackView::from(&traffic(7));
        assert!(
            near(track.azimuth_deg.unwrap(), 45.0) && near(track.elevation_deg.unwrap(), 0.0),
            "{track:?}"
        );
        assert_eq!((track.id, track.range_m, track.time_to_contact_s), (7, Some(300.0), None));
        assert_eq!((track.rect, track.score), ([100.0, 50.0, 20.0, 10.0], 2.0));
        let value = serde_json::to_value(&track).unwrap();
        assert_eq!((&value["level"], &value["confirmed"]), (&json!("traffic"), &json!(true)));
    }

    #[test]
    fn where_a_camera_looks() {
        let camera = Camera::from_field_of_view(640, 480, PI / 3).unwrap();
        for (yaw, azimuth) in [(0, 0.0), (40, 40.0), (-90, -90.0), (170, 170.0)] {
            let turn = Attitude::from_euler(Real::ZERO, Real::ZERO, Real::from_num(yaw) * PI / 180);
            let mut snapshot = Snapshot::default();
            snapshot.look_through(Some(&camera.mounted(turn.compose(Attitude::FORWARD))));
            assert!(near(snapshot.camera_azimuth_deg, azimuth), "{snapshot:?}");
            assert!(near(snapshot.field_of_view_deg, 60.0), "{snapshot:?}");
        }
    }

    #[test]
    fn reasons_in_words() {
        let health = HealthView { blind: Blind::DARK.and(Blind::COVERED), ..HealthView::default() };
        assert_eq!(health.reasons().collect::<Vec<_>>(), ["too dark", "covered or frozen"]);
        let value = serde_json::to_value(&health).unwrap();
        assert_eq!(value["blind"], json!(["too dark", "covered or frozen"]));
        assert_eq!(value["state"], "starting");
    }

    #[test]
    fn a_link_that_nobody_answers_is_not_up() {
        let spec: LinkSpec = "udpout:127.0.0.1:14550".parse().unwrap();
        let state = |connected, heard_us| {
            let status = LinkStatus { connected, heard_us, ..LinkStatus::default() };
            LinkView::new(&spec, status, 60_000_000).state
        };
        assert_eq!(state(true, None), LinkState::Silent);
        assert_eq!(state(true, Some(54_000_000)), LinkState::Silent);
        assert_eq!(state(true, Some(59_000_000)), LinkState::Up);
        assert_eq!(state(false, Some(59_000_000)), LinkState::Down);
    }

    #[test]
    fn a_link_that_lost_frames() {
        let spec: LinkSpec = "udpout:127.0.0.1:14550".parse().unwrap();
        let status = LinkStatus { sent: 9, capped: 2, dropped: u32::MAX, ..LinkStatus::default() };
        let link = LinkView::new(&spec, status, 0);
        let found = (link.state, link.sent, link.dropped);
        assert_eq!(found, (LinkState::Down, 9, u64::from(u32::MAX) + 2));
        assert_eq!(link.name, "udpout:127.0.0.1:14550");
    }
}
