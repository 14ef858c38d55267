//! Traffic: the tracker's output about one object, its direction, range, time to contact and alert level.
//!
//! The tracker and the judgement of threats fill these in; messages, logs and pages read them. All in fixed point.

pub use crate::camera::attitude::Direction;
use crate::image::Rect;
use fixed::types::I16F16;

/// Most tracks at a time.
pub const MAX_TRAFFIC: usize = 16;

/// Alert level of an object, lowest first.
///
/// ```
/// use lookout::tracking::traffic::AlertLevel;
///
/// // Levels are ordered, so that the most urgent object is the maximum.
/// let most_urgent = [AlertLevel::Traffic, AlertLevel::Warning, AlertLevel::Caution].into_iter().max();
/// assert_eq!(most_urgent, Some(AlertLevel::Warning));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub enum AlertLevel {
    /// Tracked, not confirmed: not reported.
    #[default]
    None,
    /// Confirmed, no predicted conflict.
    Traffic,
    /// Predicted to pass within the caution distance, in less than the caution time.
    Caution,
    /// Predicted to pass within the warning distance, in less than the warning time.
    Warning,
}

/// A measured quantity and its standard deviation, in the same unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Estimate {
    /// Estimate, in the unit of the field.
    pub value: I16F16,
    /// One standard deviation, 0 or more.
    pub sigma: I16F16,
}

/// State of one tracked object at the time of one frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Traffic {
    /// Number of the track: from 1, the same for as long as it lives, not given again before all others were.
    pub id: u16,
    /// Time of the frame in microseconds.
    pub time_us: i64,
    /// Box in the frame, in pixels; predicted while `coasting`.
    pub rect: Rect,
    /// Score of its last detection, Q16 log-odds.
    pub score: i32,
    /// Whether the track is confirmed: M detections in N frames and a sufficient mean score.
    pub confirmed: bool,
    /// Whether this frame has no detection of it and its position is predicted.
    pub coasting: bool,
    /// Alert level of the object in this frame.
    pub level: AlertLevel,
    /// Direction from the vehicle in body axes: forward, right, down.
    pub body: Direction,
    /// Direction in the world: north, east, down. `None` without an attitude of the vehicle.
    pub ned: Option<Direction>,
    /// Standard deviation of the direction, in radians.
    pub direction_sigma: I16F16,
    /// Angular rate of the line of sight with the camera's own turning removed, in radians a second.
    pub rate: Estimate,
    /// Distance in metres, from the assumed wingspan. `None` where it is not known.
    pub range: Option<Estimate>,
    /// Velocity relative to the vehicle in metres a second: north, east, down; body axes without an attitude.
    pub velocity: Option<[I16F16; 3]>,
    /// Time to contact in seconds. `None` where it is not known or the object does not come nearer.
    pub time_to_contact: Option<Estimate>,
    /// Distance at the closest approach in metres. `None` where it is not known.
    pub closest: Option<Estimate>,
}
