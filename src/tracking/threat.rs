//! Threat of an object: time to contact, closest point of approach, alert level.
//!
//! A camera measures angles alone. Three things follow from them without a range:
//! - the inverse of the growth of the angular size is the time to contact, range over closing speed (Lee, "A theory of
//!   visual control of braking based on information about time-to-collision", Perception 5, 1976);
//! - an object on a collision course keeps its bearing: its line of sight does not turn;
//! - with line of sight rate w and growth g the closest approach is at range times w / sqrt(w² + g²), after
//!   g / (w² + g²) seconds, while neither turns.
//!
//! Metres come from an assumed wingspan, and are no better than that: every range carries its error.

use crate::camera::Camera;
use crate::camera::attitude::{Attitude, Direction};
use crate::math::real::{ONE, Real, ZERO, add, divide, norm, ratio, sqrt};
use crate::tracking::tracker::Track;
use crate::tracking::traffic::{AlertLevel, Estimate, MAX_TRAFFIC, Traffic};
use fixed::types::I16F16;

/// Longest time to contact that is reported, in seconds.
const LONGEST: Real = Real::lit("60");

/// Detections among the last [`EVIDENCE_FRAMES`] frames below which no alert is raised or held: a box that comes back
/// now and then is weaker evidence than the one that raised it.
const EVIDENCE_HITS: u32 = 4;

/// Frames of [`EVIDENCE_HITS`]; as many as a track is confirmed by.
const EVIDENCE_FRAMES: u8 = 15;

/// Thresholds of the alert levels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AlertSettings {
    /// Assumed wingspan in metres, 0.05 to 100. Default 1: between the small multirotors of `airborne` (0.55 m) and small
    /// aeroplanes (2 m).
    pub wingspan: Real,
    /// Error of it: standard deviation of its logarithm, 0 to 2. Default 0.7: half to twice the span, seen from any side.
    pub wingspan_sigma: Real,
    /// Time to contact below which an object on a collision course is a warning, in seconds, 0 to 60. Default 8: time
    /// for a manoeuvre of 2 to 3 s, twice: of `airborne/train`'s times that are known half are wrong by two fifths or more.
    pub warning_time: Real,
    /// The same for caution, in seconds, `warning_time` to 60. Default 16.
    pub caution_time: Real,
    /// Distance at the closest approach below which an object is on a collision course, in metres for an object of the
    /// assumed wingspan, 0 to 1000. Default 1, the assumed wingspan: there two such wings touch. `airborne/train` warns
    /// alike from 1 to 2 (once more than at 0.5); an object that turns as it crosses grows as if it came near, and is less
    /// often taken for one that does. An object that passes by farther off is a caution.
    pub warning_distance: Real,
    /// The same for caution, in metres. Default 8.
    pub caution_distance: Real,
    /// Least growth over its standard deviation at which a time to contact is reported, 1 to 10. Default 1.5.
    pub min_snr_time_to_contact: Real,
    /// The same for a warning. Default 2: at 1.75 one of 50 flights without a collision is warned of, at 2.25
    /// two of 12 warnings come too late (`airborne/train`, with a persistence of 0.5 s).
    pub min_snr_warning: Real,
    /// How long a level's conditions must hold before it is raised, in microseconds, 0 to 10 s. Default 0.7 s: at
    /// 0.6 s one of 50 flights without a collision is warned of, at 1 s four of 13 warnings come too late (`airborne/train`).
    pub persistence_us: i64,
    /// How long they must not hold before it is lowered, in microseconds, 0 to 60 s. Default 2 s, as ArduPilot's
    /// avoidance (AP_Avoidance, `AVD_*`).
    pub hold_us: i64,
    /// How long caution and warning outlive the last detection of the object, in microseconds, 0 to 10 s; never longer
    /// than its time to contact was. Default 0.4 s: a course that is only predicted is no evidence.
    pub evidence_us: i64,
}

impl Default for AlertSettings {
    fn default() -> Self {
        // At compile time, so that a board needs no code to read numbers.
        const {
            Self {
                wingspan: ONE,
                wingspan_sigma: ratio(7, 10),
                warning_time: Real::lit("8"),
                caution_time: Real::lit("16"),
                warning_distance: Real::lit("1"),
                caution_distance: Real::lit("8"),
                min_snr_time_to_contact: Real::lit("1.5"),
                min_snr_warning: Real::lit("2"),
                persistence_us: 700_000,
                hold_us: 2_000_000,
                evidence_us: 400_000,
            }
        }
    }
}

impl AlertSettings {
    /// Every value within its range.
    fn limited(self) -> Self {
        let within = |v: Real, low: Real, high: i32| v.clamp(low, Real::from_num(high));
        let warning_time = within(self.warning_time, ZERO, 60);
        Self {
            wingspan: within(self.wingspan, ratio(5, 100), 100),
            wingspan_sigma: within(self.wingspan_sigma, ZERO, 2),
            warning_time,
            caution_time: within(self.caution_time, warning_time, 60),
            warning_distance: within(self.warning_distance, ZERO, 1000),
            caution_distance: within(self.caution_distance, ZERO, 1000),
            min_snr_time_to_contact: within(self.min_snr_time_to_contact, ONE, 10),
            min_snr_warning: within(self.min_snr_warning, ONE, 10),
            persistence_us: self.persistence_us.clamp(0, 10_000_000),
            hold_us: self.hold_us.clamp(0, 60_000_000),
            evidence_us: self.evidence_us.clamp(0, 10_000_000),
        }
    }
}

/// The vehicle at the time of the newest frame.
#[derive(Debug, Clone)]
pub struct Observer<'a> {
    /// Camera that the frame was taken with.
    pub camera: &'a Camera,
    /// From the body to the tracks' frame of reference.
    pub attitude: Attitude,
    /// Whether that frame is the world (NED).
    pub in_world: bool,
    /// Time of the frame in microseconds.
    pub time_us: i64,
}

/// The alert level of a track over time.
#[derive(Debug, Clone, Copy)]
struct TrackAlert {
    id: u16,
    level: AlertLevel,
    /// Since when the conditions of caution and of warning hold without a break.
    since: [Option<i64>; 2],
    /// When they held last.
    last: [i64; 2],
    /// Until when the last detection of the object counts as evidence.
    evidence_until_us: i64,
}

const RAISED: [AlertLevel; 2] = [AlertLevel::Caution, AlertLevel::Warning];

impl TrackAlert {
    /// `holds`: the conditions of caution and warning in this frame; `None` for a frame without a detection of the object.
    #[inline(never)]
    fn update(&mut self, holds: Option<[bool; 2]>, time_us: i64, settings: &AlertSettings) {
        if time_us > self.evidence_until_us {
            // The conditions have to hold anew.
            self.level = AlertLevel::Traffic;
            self.since = [None; 2];
            return;
        }
        let mut level = AlertLevel::Traffic;
        for i in 0..2 {
            match holds.map(|holds| holds[i]) {
                Some(true) => {
                    self.last[i] = time_us;
                    let since = *self.since[i].get_or_insert(time_us);
                    if time_us.saturating_sub(since) >= settings.persistence_us {
                        level = RAISED[i];
                    }
                }
                Some(false) => self.since[i] = None,
                None => {}
            }
            if self.level >= RAISED[i] && time_us.saturating_sub(self.last[i]) <= settings.hold_us {
                level = level.max(RAISED[i]);
            }
        }
        self.level = level;
    }
}

/// Raises and lowers the alert level of each track, frame after frame.
///
/// ```
/// use lookout::camera::Camera;
/// use lookout::camera::attitude::Attitude;
/// use lookout::math::real::{PI, ZERO};
/// use lookout::tracking::threat::{AlertMonitor, Observer, AlertSettings};
/// use lookout::tracking::tracker::{self, Tracker};
///
/// let camera = Camera::from_field_of_view(640, 480, PI / 3)?;
/// let mut alerts = AlertMonitor::new(AlertSettings::default());
/// let attitude = Attitude::from_euler(ZERO, ZERO, ZERO);
/// let observer = Observer { camera: &camera, attitude, in_world: false, time_us: 0 };
/// // Called once a frame, with the tracks after it; `tracking::Watch` does so.
/// let tracker = Tracker::new(tracker::TrackerSettings::default());
/// assert!(alerts.update(tracker.tracks(), &observer).is_empty());
/// # Ok::<(), lookout::camera::CameraError>(())
/// ```
#[derive(Debug, Clone)]
pub struct AlertMonitor {
    settings: AlertSettings,
    alerts: heapless::Vec<TrackAlert, MAX_TRAFFIC>,
}

impl AlertMonitor {
    /// Monitors nothing yet; settings are brought within their ranges.
    pub fn new(settings: AlertSettings) -> Self {
        Self { settings: settings.limited(), alerts: heapless::Vec::new() }
    }

    /// Other settings from now on, brought within their ranges.
    pub fn set(&mut self, settings: AlertSettings) {
        self.settings = settings.limited();
    }

    /// The traffic of a frame: confirmed tracks first, the most urgent before others. Boxes are clipped to the frame.
    pub fn update(
        &mut self,
        tracks: &[Track],
        observer: &Observer<'_>,
    ) -> heapless::Vec<Traffic, MAX_TRAFFIC> {
        self.alerts.retain(|alert| tracks.iter().any(|t| t.id == alert.id && t.confirmed));
        let mut all: heapless::Vec<Traffic, MAX_TRAFFIC> =
            tracks.iter().take(MAX_TRAFFIC).map(|track| self.track(track, observer)).collect();
        all.sort_unstable_by_key(|t| (!t.confirmed, core::cmp::Reverse(t.level), t.id));
        all
    }

    #[inline(never)]
    fn track(&mut self, track: &Track, observer: &Observer<'_>) -> Traffic {
        let body = observer.attitude.inverse().rotate(track.direction);
        let camera = observer.camera;
        let [width, height] =
            [camera.intrinsics().width, camera.intrinsics().height].map(|side| side as usize);
        let own = camera.sigma(camera.mounting().inverse().rotate(body));
        let sigma = track.direction_sigma();
        let course = RelativeCourse::new(track, &self.settings);
        let level = if track.confirmed {
            let holds = (!track.coasting).then(|| course.holds(&self.settings));
            let contact = course.time_to_contact.map(|time| time.value);
            let holds = holds.filter(|_| track.hits(EVIDENCE_FRAMES) >= EVIDENCE_HITS);
            self.alert(track.id, holds, contact, observer.time_us)
        } else {
            AlertLevel::None
        };
        // Without a world, along the body's axes.
        let velocity = match observer.in_world {
            true => course.velocity,
            false => course.velocity.map(|v| observer.attitude.inverse().rotate(v)),
        };
        Traffic {
            id: track.id,
            time_us: observer.time_us,
            rect: track.rect.within(width, height),
            score: track.score,
            confirmed: track.confirmed,
            coasting: track.coasting,
            level,
            body: Direction::from(body),
            ned: observer.in_world.then(|| Direction::from(track.direction)),
            direction_sigma: short(sqrt(sigma * sigma + own * own)),
            rate: course.rate.short(),
            range: Some(course.range.short()),
            velocity: velocity.map(|v| v.map(short)),
            time_to_contact: course.time_to_contact.map(Measured::short),
            closest: course.closest.map(Measured::short),
        }
    }

    #[inline(never)]
    fn alert(
        &mut self,
        id: u16,
        holds: Option<[bool; 2]>,
        time_to_contact: Option<Real>,
        time_us: i64,
    ) -> AlertLevel {
        let place = self.alerts.iter().position(|alert| alert.id == id);
        let place = place.or_else(|| {
            let new = TrackAlert {
                id,
                level: AlertLevel::Traffic,
                since: [None; 2],
                last: [i64::MIN; 2],
                evidence_until_us: i64::MIN,
            };
            // As many as there are tracks.
            self.alerts.push(new).ok()?;
            Some(self.alerts.len() - 1)
        });
        let Some(alert) = place.and_then(|i| self.alerts.get_mut(i)) else {
            return AlertLevel::Traffic;
        };
        if holds.is_some() {
            let contact_us = time_to_contact.map(|time| (time * 1_000_000).to_num::<i64>());
            let lasts_us = contact_us.unwrap_or(i64::MAX).clamp(0, self.settings.evidence_us);
            alert.evidence_until_us = time_us.saturating_add(lasts_us);
        }
        alert.update(holds, time_us, &self.settings);
        alert.level
    }
}

/// A value and its standard deviation.
#[derive(Debug, Clone, Copy)]
struct Measured {
    value: Real,
    sigma: Real,
}

impl Measured {
    fn short(self) -> Estimate {
        Estimate { value: short(self.value), sigma: short(self.sigma) }
    }
}

/// As an [`I16F16`], saturated.
fn short(value: Real) -> I16F16 {
    I16F16::saturating_from_num(value)
}

/// Relative motion of an object: range, velocity, time to contact, closest approach.
struct RelativeCourse {
    rate: Measured,
    growth: Measured,
    range: Measured,
    time_to_contact: Option<Measured>,
    /// Metres a second in the tracks' frame of reference.
    velocity: Option<[Real; 3]>,
    closest: Option<Measured>,
    /// Closest approach at the least rate that agrees with the measured one, in metres.
    nearest: Real,
}

impl RelativeCourse {
    #[inline(never)]
    fn new(track: &Track, settings: &AlertSettings) -> Self {
        let rate = Measured { value: norm(track.rate), sigma: track.rate_sigma() };
        let growth = Measured { value: track.growth, sigma: track.growth_sigma() };
        let extent = track.extent().max(ratio(1, 10_000));
        // At most 1,000,000 m.
        let range = settings.wingspan / extent;
        let spread = sqrt(
            settings.wingspan_sigma * settings.wingspan_sigma + {
                let size = track.size_sigma();
                size * size
            },
        );
        let range = Measured { value: range, sigma: range * spread };
        let g = growth.value;
        let known = g > ONE / LONGEST && g >= growth.sigma * settings.min_snr_time_to_contact;
        let time_to_contact = known.then(|| {
            let time = divide(ONE, g);
            Measured { value: time, sigma: (time * growth.sigma).saturating_mul(time) }
        });
        let speed = |rate: Real| sqrt(rate * rate + g * g).max(ratio(1, 10_000));
        let aside = |rate: Real| range.value.saturating_mul(divide(rate, speed(rate)));
        let closest = known.then(|| {
            // Share of the range, and its errors by rate and growth: w g / (w² + g²)^(3/2) times dw/w and dg/g.
            let whole = speed(rate.value);
            let (w, h) = (rate.value / whole, g / whole);
            let by_rate = h * h * divide(rate.sigma, whole);
            let by_growth = w * h * divide(growth.sigma, whole);
            let by_range = w.saturating_mul(spread);
            let square = |v: Real| v.saturating_mul(v);
            let error = square(by_rate).saturating_add(square(by_growth));
            let error = sqrt(error.saturating_add(square(by_range)));
            Measured { value: aside(rate.value), sigma: range.value.saturating_mul(error) }
        });
        let velocity = known.then(|| {
            let along = -(range.value.saturating_mul(g));
            let across = track.rate.map(|v| v.saturating_mul(range.value));
            // Rates are at most 10 a second, ranges at most 1,000,000 m.
            add(across, track.direction, along)
        });
        let least = (rate.value - rate.sigma * 2).max(ZERO);
        Self { rate, growth, range, time_to_contact, velocity, closest, nearest: aside(least) }
    }

    /// Whether the conditions of caution and of warning hold.
    #[inline(never)]
    fn holds(&self, settings: &AlertSettings) -> [bool; 2] {
        let Some(time) = self.time_to_contact else { return [false; 2] };
        let sure = self.growth.value >= self.growth.sigma * settings.min_snr_warning;
        [
            time.value <= settings.caution_time && self.nearest <= settings.caution_distance,
            sure && time.value <= settings.warning_time
                && self.nearest <= settings.warning_distance,
        ]
    }
}
