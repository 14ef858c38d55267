//! MAVLink messages about traffic and about the lookout itself (level 3).
//!
//! Each builder takes what is known and gives the payload of one message, or nothing where the receivers would be told
//! what nobody knows. No clock, no I/O, no state but that of [`text::Alerts`]. Floating point stands only in fields
//! that are `f32` on the wire. Field by field the builders follow what ArduPilot, PX4 and the ground stations read.
//! Source of the messages: MAVLink message set `ardupilotmega`, <https://mavlink.io/en/messages/ardupilotmega.html>.

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
    /// Too dark.
    pub const DARK: Self = Self(1);
    /// The sun, or another light that whitens the picture.
    pub const GLARE: Self = Self(2);
    /// Out of focus, or smeared by motion.
    pub const BLUR: Self = Self(4);
    /// The lens is covered, or the picture frozen.
    pub const COVERED: Self = Self(8);

    /// Both reasons.
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

    /// The bits: 1 dark, 2 glare, 4 blur, 8 covered.
    pub const fn bits(self) -> u8 {
        self.0
    }
}

/// How the work on the frames goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Health {
    /// Frames the detector really finished, since the start.
    pub frames: u32,
    /// Frames that were left out because the detector was busy, since the start.
    pub dropped: u32,
    /// Time from the frame to its detections in microseconds.
    pub latency_us: u32,
    /// Why nothing can be seen, if so.
    pub blind: Blind,
}
