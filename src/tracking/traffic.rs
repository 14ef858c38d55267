//! What is told to others about an object that is followed: where it is, how near, how dangerous (level 2).
//!
//! The tracker and the judgement of threats fill these in; messages, logs and pages read them. All in fixed point.

pub use crate::camera::attitude::Direction;
use crate::image::Rect;
use fixed::types::I16F16;

/// Most objects that are followed at once.
pub const MAX_TRAFFIC: usize = 16;

/// How urgent an object is, mildest first.
///
/// ```
/// use lookout::tracking::traffic::Level;
///
/// // Levels are ordered, so that the most urgent object is the maximum.
/// let most_urgent = [Level::Traffic, Level::Warning, Level::Caution].into_iter().max();
/// assert_eq!(most_urgent, Some(Level::Warning));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub enum Level {
    /// Followed, not yet worth a word.
    #[default]
    None,
    /// Something else flies there.
    Traffic,
    /// It may come near.
    Caution,
    /// It is on a collision course and near in time.
    Warning,
}

/// A measured quantity and its standard deviation, in the same unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Estimate {
    /// The value.
    pub value: I16F16,
    /// One standard deviation, 0 or more.
    pub sigma: I16F16,
}

/// One object that is followed, at the time of one frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Traffic {
    /// Number of the track: from 1, the same for as long as it lives, not given again before all others were.
    pub id: u16,
    /// Time of the frame in microseconds.
    pub time_us: i64,
    /// Box in the frame, in pixels; foretold while `coasting`.
    pub rect: Rect,
    /// Score of the last detection of it: log-odds in Q16.
    pub score: i32,
    /// Whether enough detections agreed (M of N) that it is there.
    pub confirmed: bool,
    /// Whether this frame showed nothing of it and its place is foretold.
    pub coasting: bool,
    /// How urgent it is.
    pub level: Level,
    /// Where it is, seen from the vehicle: forward, right, down.
    pub body: Direction,
    /// Where it is in the world: north, east, down. `None` without an attitude of the vehicle.
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
