//! Detections in, traffic out: tracks and their threat, the camera's own turning removed.
//!
//! Directions are followed in a frame of reference that stands still: the world's where the vehicle's attitude is known.
//! Where it is not, the turning of the camera is the rotation that explains the motion of the background best; the frame
//! of reference then drifts slowly, and what the camera's own flight adds to the motion of near ground is taken for
//! turning. For a second after an attitude of the vehicle the frame of reference still counts as the world's: links that
//! send an attitude a few times a second only are enough.

mod measurement;
mod settings;
pub mod threat;
pub mod tracker;
pub mod traffic;

use crate::camera::Camera;
use crate::camera::attitude::Attitude;
use crate::camera::attitude_buffer::AttitudeBuffer;
use crate::detector::detection::{Detection, SHIFTS};
use crate::math::linear;
use crate::math::real::{ONE, Real, Vector, ZERO, add, cross, norm, ratio};
use crate::registration::global_motion::GlobalMotion;
use fixed::types::I28F4;
use threat::AlertMonitor;
use tracker::{CameraPose, Tracker};
use traffic::{MAX_TRAFFIC, Traffic};

/// A longer time between two frames starts anew, in microseconds.
const GAP: i64 = 1_000_000;

/// Points along each side of the picture at which the background's motion is read.
const POINTS: i32 = 5;

/// Settings of tracker and alerts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TrafficSettings {
    /// Starting, confirming and ending tracks.
    pub track: tracker::TrackerSettings,
    /// Raising and lowering alert levels.
    pub threat: threat::AlertSettings,
}

/// Longest time since an attitude of the vehicle that the picture's motion bridges, in microseconds: at a third of a pixel a
/// frame and a field of view that is known to a twentieth it drifts by some degrees in that time.
const BRIDGE: i64 = 1_000_000;

/// Source of the last frames' attitudes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum AttitudeSource {
    Vehicle,
    /// The picture's motion since the vehicle's attitude of this time, microseconds.
    Bridge(i64),
    Image,
}

/// Tracks the detections of one camera and raises alerts.
///
/// ```
/// use fixed::types::I28F4;
/// use lookout::camera::Camera;
/// use lookout::camera::attitude_buffer::AttitudeBuffer;
/// use lookout::detector::Detection;
/// use lookout::image::Rect;
/// use lookout::math::real::PI;
/// use lookout::registration::GlobalMotion;
/// use lookout::tracking::traffic::AlertLevel;
/// use lookout::tracking::{TrafficSettings, TrafficMonitor};
///
/// let camera = Camera::from_field_of_view(640, 480, PI / 3)?;
/// let mut watch = TrafficMonitor::new(TrafficSettings::default(), camera);
/// // The background stands still, and no attitude of the vehicle is known.
/// let (still, attitudes) = (GlobalMotion::new(640, 480, [0; 8]), AttitudeBuffer::new());
///
/// // 30 frames a second of an object ahead that is 6 s from contact in the first frame.
/// let mut level = AlertLevel::None;
/// for frame in 0..105 {
///     let side = I28F4::from_num(120.0 / (6.0 - f64::from(frame) / 30.0));
///     let centre = [320, 240].map(I28F4::from_num::<i32>);
///     let [x, y] = centre.map(|middle| middle - side / 2);
///     let rect = Rect { x, y, width: side, height: side };
///     let detection = Detection { rect, score: 4 << 16, frame_score: 4 << 16, shifts: Default::default() };
///     let time_us = i64::from(frame) * 33_333;
///     let traffic = watch.update(&[detection], time_us, &still, &attitudes);
///     level = traffic[0].level;
/// }
/// assert_eq!(level, AlertLevel::Warning);
/// # Ok::<(), lookout::camera::CameraError>(())
/// ```
#[derive(Debug, Clone)]
pub struct TrafficMonitor {
    camera: Camera,
    tracker: Tracker,
    alerts: AlertMonitor,
    /// Times and attitudes of the last frames, the newest first; from the body to the frame of reference.
    frames: heapless::Vec<(i64, Attitude), { SHIFTS + 1 }>,
    source: AttitudeSource,
}

impl TrafficMonitor {
    /// Without tracks; settings are clamped to their ranges.
    pub fn new(settings: TrafficSettings, camera: Camera) -> Self {
        Self {
            camera,
            tracker: Tracker::new(settings.track),
            alerts: AlertMonitor::new(settings.threat),
            frames: heapless::Vec::new(),
            source: AttitudeSource::Image,
        }
    }

    /// Changes the settings from the next frame on; tracks stay.
    pub fn set(&mut self, settings: TrafficSettings) {
        self.tracker.set(settings.track);
        self.alerts.set(settings.threat);
    }

    /// Camera that directions are computed with.
    pub const fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Number of detections that started no track and tracks that were ended for want of room, since the start.
    pub fn dropped(&self) -> u32 {
        self.tracker.dropped()
    }

    /// Tracks of these numbers are supported by evidence from elsewhere, until the next call
    /// ([`tracker::Tracker::support`]).
    pub fn support(&mut self, tracks: impl Iterator<Item = u16>) {
        self.tracker.support(tracks);
    }

    /// Ends all tracks and forgets all frames.
    pub fn clear(&mut self) {
        self.tracker.clear();
        self.frames.clear();
        self.source = AttitudeSource::Image;
    }

    /// Updates the tracks with the detections of a frame taken at `time_us` and returns them: confirmed ones first, then by
    /// alert level and age.
    ///
    /// `background` is the detector's motion of that frame ([`crate::detector::Detections::motion`]); `attitudes` those of
    /// the vehicle, by the clock of the frames, empty without any. A frame that is not later than the last one, or by more
    /// than a second, starts anew: every track ends.
    pub fn update(
        &mut self,
        detections: &[Detection],
        time_us: i64,
        background: &GlobalMotion,
        attitudes: &AttitudeBuffer,
    ) -> heapless::Vec<Traffic, MAX_TRAFFIC> {
        let last = self.frames.first().copied();
        let step = last.map_or(0, |(time, _)| time_us.saturating_sub(time));
        let goes_on = last.is_some() && (1..=GAP).contains(&step);
        if last.is_some() && !goes_on {
            self.clear();
        }
        let dt = seconds(step);
        let turn = background.is_valid().then(|| rotation(&self.camera, background)).flatten();
        let vehicle = match (attitudes.isolated(time_us), turn) {
            // Turned on from its own time to the frame's as the picture turns.
            (Some((age, attitude)), Some(turn)) if goes_on => {
                let part = Real::from_num(age) / 1_000_000 / dt.max(ratio(1, 200));
                Some(attitude.compose(Attitude::from_small(turn.map(|angle| angle * part))))
            }
            _ => attitudes.at(time_us),
        };
        // Attitudes that were forgotten, as those of another autopilot, carry nothing on.
        let recent = |time: i64| time_us.saturating_sub(time) <= BRIDGE;
        if !attitudes.last_before(time_us).is_some_and(recent) {
            self.source = AttitudeSource::Image;
        }
        let (attitude, error) = self.attitude(vehicle, turn, time_us, dt);
        let before = self.frames.iter().take(SHIFTS);
        let before = before.map(|(time, attitude)| (seconds(time_us - time), *attitude)).collect();
        let pose = CameraPose { camera: &self.camera, attitude, error, before };
        self.tracker.update(detections, time_us, dt, &pose);
        if self.frames.is_full() {
            self.frames.pop();
        }
        // There is room now.
        let _ = self.frames.insert(0, (time_us, attitude));
        let observer = threat::Observer {
            camera: &self.camera,
            attitude,
            in_world: self.source != AttitudeSource::Image,
            time_us,
        };
        self.alerts.update(self.tracker.tracks(), &observer)
    }

    /// The attitude of this frame in the frame of reference and its error from frame to frame in radians; turns the tracks
    /// where the frame of reference changes.
    fn attitude(
        &mut self,
        vehicle: Option<Attitude>,
        turn: Option<Vector>,
        time_us: i64,
        dt: Real,
    ) -> (Attitude, Real) {
        let last = self.frames.first().map(|(_, attitude)| *attitude);
        let guess =
            last.map(|last| turn.map_or(last, |turn| last.compose(Attitude::from_small(turn))));
        let Some(vehicle) = vehicle else {
            let since = match self.source {
                AttitudeSource::Vehicle => self.frames.first().map(|(time, _)| *time),
                AttitudeSource::Bridge(since) => Some(since),
                AttitudeSource::Image => None,
            };
            let measured = guess.is_some() && turn.is_some();
            let since = since.filter(|since| measured && time_us.saturating_sub(*since) <= BRIDGE);
            self.source = since.map_or(AttitudeSource::Image, AttitudeSource::Bridge);
            // A third of a pixel where it is measured; without, what a multirotor turns at 0.3 rad/s.
            let error = if turn.is_some() { self.camera.pixel() / 3 } else { dt * 3 / 10 };
            return (guess.unwrap_or(Attitude::IDENTITY), error);
        };
        if self.source != AttitudeSource::Vehicle
            && let Some(guess) = guess
        {
            let change = vehicle.compose(guess.inverse());
            self.tracker.turn(change);
            self.frames.iter_mut().for_each(|(_, a)| *a = change.compose(*a));
        }
        self.source = AttitudeSource::Vehicle;
        let turned = self.frames.first().map_or(ZERO, |(_, last)| last.angle_to(vehicle));
        // A milliradian, what the camera's scale is wrong by, and the turn in 2 ms of wrong time.
        let late = if dt > ZERO { turned / dt.max(ratio(1, 200)) / 500 } else { ZERO };
        (vehicle, ratio(1, 1000) + turned * self.camera.scale_error() + late)
    }
}

/// Seconds of at most 1 s of microseconds.
fn seconds(time_us: i64) -> Real {
    Real::from_num(time_us.clamp(0, GAP)) / 1_000_000
}

/// The turn of the body from the last frame to this one, about the body's axes in radians, that explains the motion of the
/// background best: least squares over a grid of points.
fn rotation(camera: &Camera, background: &GlobalMotion) -> Option<Vector> {
    let spec = camera.intrinsics();
    let (mut matrix, mut right) = ([[0i64; 3]; 3], [0i64; 3]);
    let q20 = |v: Real| v.to_bits() >> 12;
    for (i, j) in (0..POINTS).flat_map(|j| (0..POINTS).map(move |i| (i, j))) {
        // A side is at most 65535 pixels.
        let place = |k: i32, side: u32| ((2 * k + 1) * side.cast_signed() / (2 * POINTS)) << 8;
        let (x, y) = (place(i, spec.width), place(j, spec.height));
        let (old_x, old_y) = background.map(x, y);
        let sixteenths = |v: i32| I28F4::from_bits(v >> 4);
        let now = camera.body(sixteenths(x), sixteenths(y));
        let then = camera.body(sixteenths(old_x), sixteenths(old_y));
        let moved = cross(now, add(then, now, -ONE));
        for a in 0..3 {
            for b in a..3 {
                let one = if a == b { ONE } else { ZERO };
                matrix[a][b] += q20(one - now[a] * now[b]);
            }
            right[a] += q20(moved[a]);
        }
    }
    let turn = linear::solve(&matrix, &right, 3, 32)?.map(Real::from_bits);
    (norm(turn.map(|v| v.clamp(-ONE, ONE))) < ratio(1, 2)).then_some(turn)
}
