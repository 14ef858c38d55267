//! Settings of rendered flights: every range that a flight is drawn from.

use serde::{Deserialize, Serialize};

/// Ranges and probabilities that flights are drawn from; each flight draws its own values.
///
/// Ranges are `[low, high]`, drawn evenly unless a field says "by ratio" (evenly in the logarithm).
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Width and height of the frames, pixels; multiples of 16.
    pub size: [usize; 2],
    /// Focal length, pixels at a width of 640.
    pub focal: [f64; 2],
    /// Frames a second.
    pub fps: u32,
    /// Frames of a flight.
    pub frames: u64,
    /// Motion of the camera.
    pub motion: Motion,
    /// Image formation after the scene.
    pub sensor: Sensor,
    /// What moves with or before the scene.
    pub scene: SceneSettings,
    /// Flying objects.
    pub targets: Targets,
}

/// Motion of the camera.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Motion {
    /// Strength of the sway of a multirotor: 0.35 calm, 1.8 rough; by ratio.
    pub agitation: [f64; 2],
    /// Amplitude of the vibration, radians; by ratio.
    pub vibration: [f64; 2],
    /// Frequency of the vibration, Hz.
    pub vibration_hz: [f64; 2],
    /// Probability of a sustained turn.
    pub turn_probability: f64,
    /// Rate of a sustained turn, radians a second; by ratio.
    pub turn: [f64; 2],
    /// Ground speed, metres a second.
    pub speed: [f64; 2],
    /// Probability that the camera hovers.
    pub hover_probability: f64,
    /// Height above the ground, metres; by ratio.
    pub height: [f64; 2],
    /// Time from the first row of a frame to its last, seconds; 0 with probability 1/5 (global shutter).
    pub readout: [f64; 2],
    /// Exposure time, seconds; by ratio.
    pub exposure: [f64; 2],
}

/// Image formation after the scene.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Sensor {
    /// Radial distortion coefficient k1 of the lens.
    pub distortion: [f64; 2],
    /// Mean grey level of the background.
    pub brightness: [f64; 2],
    /// Standard deviation of the background's grey levels.
    pub contrast: [f64; 2],
    /// Relative drift of the gain over a flight.
    pub gain_drift: [f64; 2],
    /// Loss of light in the corners.
    pub vignette: [f64; 2],
    /// Standard deviation of the noise at mid grey, grey levels; by ratio.
    pub noise: [f64; 2],
    /// Quantiser step of the video compression, grey levels; by ratio. Below 2: none.
    pub quantiser: [f64; 2],
    /// Probability that a part of the own craft is in the picture.
    pub own_craft_probability: f64,
}

/// What moves with or before the scene and is no target.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct SceneSettings {
    /// Probability that things move along the ground.
    pub movers_probability: f64,
    /// Number of things that move along the ground, where there are any.
    pub movers: [usize; 2],
    /// Longer side of a mover, pixels; by ratio.
    pub mover_pixels: [f64; 2],
    /// Probability of birds.
    pub birds_probability: f64,
    /// Most birds.
    pub birds: usize,
    /// Height of trees and houses as a share of the inverse depth of the ground below them.
    pub structure: [f64; 2],
    /// Amplitude with which foliage and water shimmer, pixels.
    pub shimmer: [f64; 2],
    /// Probability of glints and lamps.
    pub glints_probability: f64,
}

/// Flying objects.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Targets {
    /// Share of the flights of each kind: crossing, hover, collision, receding, none.
    pub kinds: [f64; 5],
    /// Probability of each further target after the first.
    pub more_probability: f64,
    /// Longer side, pixels, where it is nearest; by ratio.
    pub pixels: [f64; 2],
    /// Probability that a solid model is used where there are any.
    pub solid_probability: f64,
    /// Change of contrast of a cut-out.
    pub contrast: [f64; 2],
    /// Probability that light and dark of a cut-out change places.
    pub inverted_probability: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            size: [640, 480],
            focal: [480.0, 640.0],
            fps: 30,
            frames: 150,
            motion: Motion::default(),
            sensor: Sensor::default(),
            scene: SceneSettings::default(),
            targets: Targets::default(),
        }
    }
}

impl Default for Motion {
    fn default() -> Self {
        Self {
            agitation: [0.3, 2.0],
            vibration: [0.00005, 0.0012],
            vibration_hz: [20.0, 45.0],
            turn_probability: 0.12,
            turn: [0.1, 1.2],
            speed: [0.5, 10.0],
            hover_probability: 0.35,
            height: [3.0, 90.0],
            readout: [0.005, 0.03],
            exposure: [0.0008, 0.016],
        }
    }
}

impl Default for Sensor {
    fn default() -> Self {
        Self {
            distortion: [-0.08, 0.03],
            brightness: [50.0, 165.0],
            contrast: [18.0, 60.0],
            gain_drift: [0.0, 0.12],
            vignette: [0.0, 0.35],
            noise: [0.4, 4.0],
            quantiser: [1.5, 26.0],
            own_craft_probability: 0.12,
        }
    }
}

impl Default for SceneSettings {
    fn default() -> Self {
        Self {
            movers_probability: 0.65,
            movers: [1, 12],
            mover_pixels: [6.0, 60.0],
            birds_probability: 0.3,
            birds: 3,
            structure: [0.0, 0.8],
            shimmer: [0.0, 1.2],
            glints_probability: 0.25,
        }
    }
}

impl Default for Targets {
    fn default() -> Self {
        Self {
            kinds: [0.3, 0.2, 0.25, 0.13, 0.12],
            more_probability: 0.3,
            pixels: [8.0, 90.0],
            solid_probability: 0.25,
            contrast: [0.5, 1.15],
            inverted_probability: 0.12,
        }
    }
}
