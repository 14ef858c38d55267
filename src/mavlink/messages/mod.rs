//! MAVLink messages about traffic and about the lookout itself.
//!
//! Each builder returns the payload of one message, or `None` where a required value is not known. No clock, no I/O, no
//! state but that of [`text::Alerts`]. Floating point stands only in fields that are `f32` on the wire. Field by field the
//! builders follow what ArduPilot, PX4 and the ground stations read. Source of the messages: MAVLink message set
//! `ardupilotmega`, <https://mavlink.io/en/messages/ardupilotmega.html>.

pub mod adsb;
pub mod angle;
pub mod obstacle;
pub mod payload;
pub mod status;
pub mod text;

pub use payload::Payload;

/// The vehicle's own place and motion, from GLOBAL_POSITION_INT.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Vehicle {
    /// Latitude in degrees times 10^7.
    pub latitude: i32,
    /// Longitude in degrees times 10^7.
    pub longitude: i32,
    /// Altitude above mean sea level in millimetres.
    pub altitude: i32,
    /// Velocity north, east, down in cm/s.
    pub velocity: [i16; 3],
    /// When it was received, in microseconds of our clock.
    pub time_us: i64,
}

/// Why frames come but nothing can be seen in them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Blind(u8);

impl Blind {
    /// Nothing hinders the view.
    pub const NO: Self = Self(0);
    /// Picture too dark to see anything in.
    pub const DARK: Self = Self(1);
    /// The sun, or another light that whitens the picture.
    pub const GLARE: Self = Self(2);
    /// Out of focus, or smeared by motion.
    pub const BLUR: Self = Self(4);
    /// The picture does not change: frozen, or the lens covered.
    pub const COVERED: Self = Self(8);

    /// Union of two sets of reasons.
    pub const fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Whether `reason` is among the reasons.
    pub const fn has(self, reason: Self) -> bool {
        self.0 & reason.0 != 0
    }

    /// Whether there is any reason.
    pub const fn any(self) -> bool {
        self.0 != 0
    }

    /// The reasons in words.
    pub fn reasons(self) -> impl Iterator<Item = &'static str> {
        let words = [
            (Self::DARK, "too dark"),
            (Self::GLARE, "glare"),
            (Self::BLUR, "blurred"),
            (Self::COVERED, "covered or frozen"),
        ];
        words.into_iter().filter(move |(reason, _)| self.has(*reason)).map(|(_, word)| word)
    }

    /// The bits: 1 dark, 2 glare, 4 blur, 8 covered.
    pub const fn bits(self) -> u8 {
        self.0
    }
}

/// Counts, latency and blindness of the frames since the start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Health {
    /// Frames the detector really finished, since the start.
    pub frames: u32,
    /// Frames that were left out because the detector was busy, since the start.
    pub dropped: u32,
    /// Time from the frame to its detections in microseconds.
    pub latency_us: u32,
    /// Time that the detector worked on it, in microseconds; 0 where it is not measured.
    pub busy_us: u32,
    /// Why nothing can be seen, if so.
    pub blind: Blind,
    /// Whether objects' directions from the vehicle are known: not with a gimbal that does not say where it points.
    pub pointed: bool,
}

impl Default for Health {
    fn default() -> Self {
        Self { frames: 0, dropped: 0, latency_us: 0, busy_us: 0, blind: Blind::NO, pointed: true }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::image::Rect;
    use crate::tracking::traffic::{AlertLevel, Direction, Estimate, Traffic};
    use fixed::types::{I2F30, I16F16, I28F4};
    use proptest::prelude::*;

    /// Unit vector of a bearing clockwise from forward and an elevation, in degrees.
    pub fn direction(bearing: f64, elevation: f64) -> Direction {
        let (b, e) = (bearing.to_radians(), elevation.to_radians());
        let unit = I2F30::from_num::<f64>;
        Direction { x: unit(b.cos() * e.cos()), y: unit(b.sin() * e.cos()), z: unit(-e.sin()) }
    }

    fn rect(sixteenths: [i32; 4]) -> Rect {
        let [x, y, width, height] = sixteenths.map(I28F4::from_bits);
        Rect { x, y, width, height }
    }

    /// A distance, 20 % uncertain.
    pub fn metres(value: i32) -> Estimate {
        let value = I16F16::from_num(value);
        Estimate { value, sigma: value / 5 }
    }

    /// A confirmed object 300 m to the north-east, while we fly north; level with us.
    pub fn traffic(id: u16) -> Traffic {
        Traffic {
            id,
            time_us: 0,
            rect: rect([1600, 800, 320, 160]),
            score: 1 << 17,
            confirmed: true,
            coasting: false,
            level: AlertLevel::Traffic,
            body: direction(45.0, 0.0),
            ned: Some(direction(45.0, 0.0)),
            direction_sigma: I16F16::from_num(0.002),
            rate: Estimate { value: I16F16::ZERO, sigma: I16F16::from_num(0.01) },
            range: Some(metres(300)),
            velocity: Some([I16F16::from_num(-20), I16F16::ZERO, I16F16::from_num(-1)]),
            time_to_contact: None,
            closest: None,
        }
    }

    /// Our vehicle over Zurich, 500 m high, flying north at 10 m/s.
    pub fn own() -> Vehicle {
        Vehicle {
            latitude: 473_769_000,
            longitude: 85_417_000,
            altitude: 500_000,
            velocity: [1000, 0, 0],
            time_us: 0,
        }
    }

    fn any_estimate() -> impl Strategy<Value = Estimate> {
        any::<[i32; 2]>().prop_map(|[value, sigma]| Estimate {
            value: I16F16::from_bits(value),
            sigma: I16F16::from_bits(sigma),
        })
    }

    fn any_direction() -> impl Strategy<Value = Direction> {
        (any::<[i32; 3]>()).prop_map(|[x, y, z]| Direction {
            x: I2F30::from_bits(x),
            y: I2F30::from_bits(y),
            z: I2F30::from_bits(z),
        })
    }

    /// Any traffic at all, sensible or not.
    pub fn any_traffic() -> impl Strategy<Value = Traffic> {
        let numbers = any::<(u16, i64, [i32; 4], i32, bool, bool, u8)>();
        let places = (any_direction(), prop::option::of(any_direction()), any_estimate());
        let motion = (
            prop::option::of(any_estimate()),
            prop::option::of(any::<[i32; 3]>()),
            prop::option::of(any_estimate()),
            prop::option::of(any_estimate()),
        );
        (numbers, places, motion).prop_map(|(numbers, (body, ned, rate), motion)| {
            let (id, time_us, [x, y, width, height], score, confirmed, coasting, level) = numbers;
            let (range, velocity, time_to_contact, closest) = motion;
            let levels =
                [AlertLevel::None, AlertLevel::Traffic, AlertLevel::Caution, AlertLevel::Warning];
            let level = levels[usize::from(level % 4)];
            let velocity = velocity.map(|v| v.map(I16F16::from_bits));
            let rect = rect([x, y, width, height]);
            let direction_sigma = rate.sigma;
            Traffic {
                id,
                time_us,
                rect,
                score,
                confirmed,
                coasting,
                level,
                body,
                ned,
                direction_sigma,
                rate,
                range,
                velocity,
                time_to_contact,
                closest,
            }
        })
    }
}
