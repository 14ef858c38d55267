//! Multiple-object tracker: data association and Kalman filters in angle space.
//!
//! A track is a direction in a frame of reference that does not turn with the camera, its rate, the logarithm of the
//! object's angular size and the growth of that. The growth g is the inverse of the time to contact: at a constant
//! closing speed it rises by g² a second, which the filter foretells, so that a long memory does not lag. Both pairs are
//! Kalman filters ([`crate::math::kalman`]). Detections go to the nearest track within its gate, the nearest pair first, tracks
//! that are confirmed before others; what is left starts tracks. Where detections keep coming, weak ones are many false
//! ones, so that a track is confirmed only when there were enough of them and their scores say so together.

use crate::camera::attitude::Attitude;
use crate::detector::detection::Detection;
use crate::image::Rect;
use crate::math::kalman::{Covariance, MILLI};
use crate::math::real::{ONE, Real, Vector, ZERO, add, divide, exp, reject, sqrt, unit};
pub use crate::tracking::measurement::CameraPose;
use crate::tracking::measurement::Measurement;
pub use crate::tracking::settings::TrackerSettings;
use crate::tracking::traffic::MAX_TRAFFIC;

/// Most detections of a frame that are used.
const MAX_MEASUREMENTS: usize = 64;

/// Largest distance of a detection from its track, in standard deviations squared: four of two values, three of the size.
const GATE: [Real; 2] = [Real::lit("16"), Real::lit("9")];

/// Largest angular rate of a track, in radians a second.
const MAX_RATE: Real = Real::lit("10");

/// Fastest growth: a quarter of a second to contact.
const MAX_GROWTH: Real = Real::lit("4");

/// Growth of a new track: within what a contact in 3 s gives.
const FIRST_GROWTH: Real = Real::lit("300");

/// Rate of a new track without shifts, in thousandths.
const FIRST_RATE: Real = Real::lit("300");

/// Intersection over union, Q8, from which on two tracks are of one object: 0.3.
const SAME_OBJECT_IOU: u8 = 77;

/// The same for a detection that starts no track because one is there: 0.1. Lower, since a detection that the gate kept
/// from its track is of that track's object more often than of another one.
const KNOWN_OBJECT_IOU: u8 = 26;

/// Bonus on a track's mean log-odds for evidence from elsewhere, as an aircraft that transmits its position in this
/// direction: 2 in Q16, a likelihood ratio of 7. Not measured: no recording here has both.
const SUPPORT: i32 = 2 << 16;

/// One track: identity, score, state of its Kalman filters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Track {
    /// Number of the track, from 1, in the order in which tracks start.
    pub id: u16,
    /// Whether the track is confirmed.
    pub confirmed: bool,
    /// Whether evidence from elsewhere supports it ([`Tracker::support`]).
    pub supported: bool,
    /// Time of its last detection, microseconds.
    pub seen_us: i64,
    /// Whether the newest frame had none.
    pub coasting: bool,
    /// Score of the last detection.
    pub score: i32,
    /// By its frame alone.
    frame_score: i32,
    /// Exponential moving average of the frames' own scores, weight 1/8, Q16 log-odds; it starts at
    /// [`TrackerSettings::keep_score`], which also stands for frames without a detection.
    pub mean_log_odds: i32,
    /// Box in the newest frame, predicted while coasting.
    pub rect: Rect,
    /// Unit vector in the frame of reference.
    pub direction: Vector,
    /// Its change, square to it, in radians a second.
    pub rate: Vector,
    /// Logarithm of the angular size: root of width times height, in radians.
    pub size: Real,
    /// Change of that logarithm a second: the inverse of the time to contact.
    pub growth: Real,
    /// Logarithm of the longer side over the size, smoothed.
    pub aspect: Real,
    bearing: Covariance,
    growing: Covariance,
    /// One bit a frame, the newest lowest: whether there was a detection.
    history: u32,
    frames: u8,
}

impl Track {
    /// Standard deviation of the direction, in radians.
    pub fn direction_sigma(&self) -> Real {
        sqrt(self.bearing.value) / MILLI
    }

    /// Standard deviation of the rate along each axis, in radians a second.
    pub fn rate_sigma(&self) -> Real {
        sqrt(self.bearing.rate) / MILLI
    }

    /// Standard deviation of the logarithm of the size.
    pub fn size_sigma(&self) -> Real {
        sqrt(self.growing.value) / MILLI
    }

    /// Standard deviation of the growth, per second.
    pub fn growth_sigma(&self) -> Real {
        sqrt(self.growing.rate) / MILLI
    }

    /// Angle of the object's longer side, in radians.
    pub fn extent(&self) -> Real {
        exp(self.size + self.aspect)
    }

    #[inline(never)]
    fn start(id: u16, measurement: &Measurement, time_us: i64, settings: &TrackerSettings) -> Self {
        let (rate, rate_sigma) = match measurement.rate {
            Some((rate, variance)) => (rate, sqrt(variance)),
            None => ([ZERO; 3], FIRST_RATE),
        };
        Self {
            id,
            confirmed: false,
            supported: false,
            seen_us: time_us,
            coasting: false,
            score: measurement.score,
            frame_score: measurement.frame_score,
            mean_log_odds: towards(settings.keep_score, measurement.frame_score),
            rect: measurement.rect,
            direction: measurement.direction,
            rate,
            size: measurement.size,
            growth: ZERO,
            aspect: measurement.aspect,
            bearing: Covariance::new(sqrt(measurement.variance), rate_sigma),
            growing: Covariance::new(sqrt(measurement.size_variance) * 2, FIRST_GROWTH),
            history: 1,
            frames: 1,
        }
    }

    #[inline(never)]
    fn predict(&mut self, dt: Real, settings: &TrackerSettings) {
        self.direction = unit(add(self.direction, self.rate, dt));
        self.rate = reject(self.rate, self.direction);
        self.bearing.predict(dt, ONE, settings.agility);
        let g = self.growth;
        self.size = (self.size + g * dt + g * g * dt * dt / 2).clamp(-MILLI / 50, ONE);
        self.growth = (g + g * g * dt).clamp(-MAX_GROWTH, MAX_GROWTH);
        let bend = (ONE + g * dt * 2).clamp(ONE / 2, ONE * 2);
        self.growing.predict(dt, bend, settings.growth_agility);
        self.history <<= 1;
        self.frames = self.frames.saturating_add(1);
    }

    /// Distance of a measurement in standard deviations squared; `None` outside the gate.
    #[inline(never)]
    fn distance(&self, measurement: &Measurement) -> Option<Real> {
        let off = add(measurement.direction, self.direction, -ONE).map(|v| v * MILLI);
        let place = off.map(|v| divide(v, sqrt(self.bearing.value + measurement.variance)));
        let square = |v: Real| v.saturating_mul(v);
        let place = place.into_iter().map(square).fold(ZERO, Real::saturating_add);
        let size = (measurement.size - self.size) * MILLI;
        let size = square(divide(size, sqrt(self.growing.value + measurement.size_variance)));
        (place <= GATE[0] && size <= GATE[1]).then(|| place + size)
    }

    #[inline(never)]
    fn update(&mut self, measurement: &Measurement, time_us: i64, settings: &TrackerSettings) {
        let off = reject(add(measurement.direction, self.direction, -ONE), self.direction);
        let [place, speed] = self.bearing.update(measurement.variance);
        self.direction = unit(add(self.direction, off, place));
        self.rate = limited(add(self.rate, off, speed), self.direction);
        if let Some((rate, variance)) = measurement.rate {
            let off = reject(add(rate, self.rate, -ONE), self.direction);
            let [place, speed] = self.bearing.update_rate(variance);
            self.direction = unit(add(self.direction, off, place));
            self.rate = limited(add(self.rate, off, speed), self.direction);
        }
        if !measurement.cut {
            let off = measurement.size - self.size;
            // White noise of the same density as errors that are alike for a while: so many frames count for one.
            let since =
                Real::from_num(time_us.saturating_sub(self.seen_us).clamp(1_000, 1_000_000));
            let alike = ONE + settings.size_memory * 2_000_000 / since;
            let [size, growth] =
                self.growing.update(measurement.size_variance.saturating_mul(alike));
            self.size += off * size;
            self.growth = (self.growth + off * growth).clamp(-MAX_GROWTH, MAX_GROWTH);
            self.aspect += (measurement.aspect - self.aspect) / 8;
        }
        self.score = measurement.score;
        self.frame_score = measurement.frame_score;
        self.rect = measurement.rect;
        self.seen_us = time_us;
        self.coasting = false;
        self.history |= 1;
    }

    /// Whether the track is confirmed and its box and `rect` share at least half of the smaller one: a part of the same
    /// object, or one box around both.
    fn covers_half_of(&self, rect: &Rect) -> bool {
        let smaller = self.rect.area().min(rect.area());
        self.confirmed && self.rect.intersection(rect) * 2 > smaller
    }

    /// Updates the mean log-odds, and confirms the track where it and the hits of the last frames suffice.
    fn confirm(&mut self, settings: &TrackerSettings) {
        let seen = if self.coasting { settings.keep_score } else { self.frame_score };
        self.mean_log_odds = towards(self.mean_log_odds, seen);
        let support = if self.supported { SUPPORT } else { 0 };
        self.confirmed |= self.hits(settings.confirm_window) >= u32::from(settings.confirm_hits)
            && self.mean_log_odds.saturating_add(support) >= settings.confirm_score;
    }

    /// Turns everything by `turn`: the frame of reference was another.
    fn turn(&mut self, turn: Attitude) {
        self.direction = unit(turn.rotate(self.direction));
        self.rate = reject(turn.rotate(self.rate), self.direction);
    }

    /// Moves the box to the predicted position.
    fn coast(&mut self, pose: &CameraPose<'_>) {
        self.coasting = true;
        let body = pose.attitude.inverse().rotate(self.direction);
        let Some((x, y)) = pose.camera.project(body) else { return };
        self.rect.x = x - self.rect.width / 2;
        self.rect.y = y - self.rect.height / 2;
    }

    /// Frames with a detection among the last `window` (1 to 32).
    pub fn hits(&self, window: u8) -> u32 {
        let mask = if window >= 32 { u32::MAX } else { (1 << window) - 1 };
        (self.history & mask).count_ones()
    }

    /// Whether the track ends.
    fn is_over(&self, time_us: i64, settings: &TrackerSettings) -> bool {
        if self.confirmed {
            return time_us.saturating_sub(self.seen_us) > settings.coast_us;
        }
        let window = u32::from(settings.confirm_window.min(self.frames));
        let misses = window - self.hits(settings.confirm_window);
        misses > u32::from(settings.confirm_window - settings.confirm_hits)
    }
}

/// An eighth of the way from one score to another.
#[expect(clippy::cast_possible_truncation, reason = "between two numbers of 32 bits")]
fn towards(from: i32, to: i32) -> i32 {
    (i64::from(from) + ((i64::from(to) - i64::from(from)) >> 3)) as i32
}

/// A rate brought square to the direction, and within what is believed along each axis.
fn limited(rate: Vector, direction: Vector) -> Vector {
    reject(rate.map(|v| v.clamp(-MAX_RATE, MAX_RATE)), direction)
}

/// Tracks objects from frame to frame.
///
/// ```
/// use fixed::types::I28F4;
/// use lookout::camera::Camera;
/// use lookout::camera::attitude::Attitude;
/// use lookout::detector::Detection;
/// use lookout::image::Rect;
/// use lookout::math::real::{ONE, PI, ZERO};
/// use lookout::tracking::tracker::{CameraPose, TrackerSettings, Tracker};
///
/// let camera = Camera::from_field_of_view(640, 480, PI / 3)?;
/// let attitude = Attitude::from_euler(ZERO, ZERO, ZERO);
/// let pose = CameraPose { camera: &camera, attitude, error: ZERO, before: heapless::Vec::new() };
/// let mut tracker = Tracker::new(TrackerSettings::default());
/// // Ten frames with a detection that moves two pixels to the right each time.
/// for frame in 0..10 {
///     let [x, y, side] = [100 + 2 * frame, 200, 20].map(I28F4::from_num::<i32>);
///     let rect = Rect { x, y, width: side, height: side };
///     let detection = Detection { rect, score: 4 << 16, frame_score: 4 << 16, shifts: Default::default() };
///     tracker.update(&[detection], i64::from(frame) * 33_333, ONE / 30, &pose);
/// }
/// let [track] = tracker.tracks() else { panic!("one track") };
/// assert!(track.confirmed && track.hits(10) == 10);
/// # Ok::<(), lookout::camera::CameraError>(())
/// ```
#[derive(Debug, Clone)]
pub struct Tracker {
    settings: TrackerSettings,
    tracks: heapless::Vec<Track, MAX_TRAFFIC>,
    last_id: u16,
    dropped: u32,
}

impl Tracker {
    /// A tracker without tracks; settings are clamped to their ranges.
    pub fn new(settings: TrackerSettings) -> Self {
        Self { settings: settings.limited(), tracks: heapless::Vec::new(), last_id: 0, dropped: 0 }
    }

    /// Changes the settings, clamped to their ranges.
    pub fn set(&mut self, settings: TrackerSettings) {
        self.settings = settings.limited();
    }

    /// Tracks after the last frame, confirmed or not.
    pub fn tracks(&self) -> &[Track] {
        &self.tracks
    }

    /// Number of detections that started no track and tracks that were ended for want of room, since the start.
    pub fn dropped(&self) -> u32 {
        self.dropped
    }

    /// Tracks of these numbers are supported by evidence from elsewhere until the next call: it counts when they are
    /// confirmed.
    pub fn support(&mut self, supported: impl Iterator<Item = u16>) {
        self.tracks.iter_mut().for_each(|track| track.supported = false);
        for id in supported {
            let track = self.tracks.iter_mut().find(|track| track.id == id);
            track.into_iter().for_each(|track| track.supported = true);
        }
    }

    /// Ends all tracks; numbers go on.
    pub fn clear(&mut self) {
        self.tracks.clear();
    }

    /// Changes the frame of reference: directions v become `turn` v.
    pub fn turn(&mut self, turn: Attitude) {
        self.tracks.iter_mut().for_each(|track| track.turn(turn));
    }

    /// The detections of a frame at `time_us`, `dt` seconds (0 to 1) after the last one.
    pub fn update(
        &mut self,
        detections: &[Detection],
        time_us: i64,
        dt: Real,
        pose: &CameraPose<'_>,
    ) {
        let dt = dt.clamp(ZERO, ONE);
        let settings = self.settings;
        let measurements: heapless::Vec<Measurement, MAX_MEASUREMENTS> = detections
            .iter()
            .filter(|d| d.score >= settings.keep_score)
            .take(MAX_MEASUREMENTS)
            .map(|d| Measurement::new(d, pose, &settings))
            .collect();
        for track in &mut self.tracks {
            track.predict(dt, &settings);
            track.coasting = true;
        }
        let mut free = [true; MAX_MEASUREMENTS];
        for confirmed in [true, false] {
            self.assign(&measurements, &mut free, confirmed, time_us);
        }
        for track in self.tracks.iter_mut().filter(|track| track.coasting) {
            track.coast(pose);
        }
        for track in &mut self.tracks {
            track.confirm(&settings);
        }
        self.tracks.retain(|track| !track.is_over(time_us, &settings));
        self.merge();
        for (measurement, free) in measurements.iter().zip(free) {
            if free && measurement.frame_score >= settings.start_score {
                self.start(measurement, time_us);
            }
        }
    }

    /// Gives measurements to tracks that are (not) confirmed, the nearest pair first.
    fn assign(
        &mut self,
        measurements: &[Measurement],
        free: &mut [bool; MAX_MEASUREMENTS],
        confirmed: bool,
        time_us: i64,
    ) {
        let mut distances = [[None; MAX_MEASUREMENTS]; MAX_TRAFFIC];
        for (track, row) in self.tracks.iter().zip(&mut distances) {
            for (measurement, distance) in measurements.iter().zip(row) {
                *distance =
                    (track.confirmed == confirmed).then(|| track.distance(measurement)).flatten();
            }
        }
        loop {
            let mut best: Option<(Real, usize, usize)> = None;
            for (t, row) in distances.iter().enumerate().take(self.tracks.len()) {
                for (s, distance) in row.iter().enumerate().filter(|(s, _)| free[*s]) {
                    if let Some(distance) = distance
                        && self.tracks[t].coasting
                        && best.is_none_or(|(least, ..)| *distance < least)
                    {
                        best = Some((*distance, t, s));
                    }
                }
            }
            let Some((_, t, s)) = best else { return };
            if let (Some(track), Some(measurement)) = (self.tracks.get_mut(t), measurements.get(s))
            {
                track.update(measurement, time_us, &self.settings);
            }
            free[s] = false;
        }
    }

    /// Of tracks on the same object only the confirmed, then the older one is kept.
    fn merge(&mut self) {
        let mut i = 0;
        while i < self.tracks.len() {
            let track = self.tracks[i];
            let better = |other: &Track| {
                let rank = |t: &Track| (!t.confirmed, t.coasting, t.frames < 255, 255 - t.frames);
                other.id != track.id
                    && (other.rect.overlaps(&track.rect, SAME_OBJECT_IOU)
                        || other.covers_half_of(&track.rect))
                    && rank(other) < rank(&track)
            };
            if self.tracks.iter().any(better) {
                self.tracks.remove(i);
            } else {
                i += 1;
            }
        }
    }

    /// A new track, in the place of a worse one that is not confirmed where there is no room.
    fn start(&mut self, measurement: &Measurement, time_us: i64) {
        let known = |track: &Track| {
            track.rect.overlaps(&measurement.rect, KNOWN_OBJECT_IOU)
                || track.covers_half_of(&measurement.rect)
        };
        if self.tracks.iter().any(known) {
            return;
        }
        if self.tracks.is_full() {
            let worst = self.tracks.iter().enumerate().filter(|(_, t)| !t.confirmed);
            let worst = worst.min_by_key(|(_, t)| t.score).map(|(i, t)| (i, t.score));
            // One of the two finds no room, whichever it is.
            self.dropped = self.dropped.saturating_add(1);
            match worst {
                Some((i, least)) if least < measurement.score => drop(self.tracks.remove(i)),
                _ => return,
            }
        }
        let id = self.next_id();
        // There is room now.
        let _ = self.tracks.push(Track::start(id, measurement, time_us, &self.settings));
    }

    /// The next number that no track has; never 0.
    fn next_id(&mut self) -> u16 {
        loop {
            self.last_id = self.last_id.wrapping_add(1).max(1);
            if self.tracks.iter().all(|track| track.id != self.last_id) {
                return self.last_id;
            }
        }
    }
}
