//! Settings of rendered flights: every range that a flight is drawn from. `default.toml` documents and holds the defaults.

use serde::{Deserialize, Serialize};
use std::format;
use std::string::{String, ToString};
use std::vec::Vec;

/// The defaults, with a comment for every field.
pub const DEFAULT: &str = include_str!("default.toml");

/// Why settings cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum RenderSettingsError {
    /// The text is no TOML of these fields.
    #[error("{0}")]
    Text(String),
    /// A value is out of its range.
    #[error("'{field}' is {value}, expected {expected}")]
    Value {
        /// The field with its section.
        field: &'static str,
        /// Value that was given.
        value: String,
        /// The values that can be used.
        expected: &'static str,
    },
}

/// Ranges and probabilities that flights are drawn from; each flight draws its own values.
///
/// Ranges are `[low, high]`, drawn evenly unless a field says "by ratio" (evenly in the logarithm).
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct RenderSettings {
    /// Width and height of the frames, pixels; multiples of 16. Given by the caller, not by the file.
    #[serde(skip, default = "size")]
    pub size: [usize; 2],
    /// Focal length, pixels at a width of 640.
    pub focal: [f64; 2],
    /// Frames a second. Given by the caller, not by the file.
    #[serde(skip, default = "fps")]
    pub fps: u32,
    /// Frames of a flight. Given by the caller, not by the file.
    #[serde(skip, default = "frames")]
    pub frames: u64,
    /// Choice of the background.
    pub pictures: BackgroundSettings,
    /// Motion of the camera.
    pub motion: MotionSettings,
    /// Image formation after the scene.
    pub sensor: Sensor,
    /// Distractors, which are no targets.
    pub scene: SceneSettings,
    /// Flying objects that are targets.
    pub targets: Targets,
}

/// Choice of the background.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct BackgroundSettings {
    /// Shares of the kinds of pictures: level, oblique, straight down, panorama.
    pub shares: [f64; 4],
    /// Probability that an oblique picture is used as ground seen straight down.
    pub oblique_as_ground: f64,
}

/// Motion of the camera.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct MotionSettings {
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

/// Numbers of distractors: moving objects that are no targets.
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
    /// Largest number of birds.
    pub birds: usize,
    /// Height of trees and houses as a share of the inverse depth of the ground below them.
    pub structure: [f64; 2],
    /// Amplitude with which foliage and water shimmer, pixels.
    pub shimmer: [f64; 2],
    /// Probability of glints and lamps.
    pub glints_probability: f64,
}

/// Numbers, sizes and contrasts of flying objects.
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

impl RenderSettings {
    /// Reads settings from TOML; fields that are left out keep their defaults.
    ///
    /// # Errors
    /// [`RenderSettingsError`] naming the line or the field.
    pub fn parse(text: &str) -> Result<Self, RenderSettingsError> {
        let settings: Self =
            toml::from_str(text).map_err(|e| RenderSettingsError::Text(e.to_string()))?;
        settings.check()?;
        Ok(settings)
    }

    /// Whether every range can be drawn from.
    ///
    /// # Errors
    /// [`RenderSettingsError::Value`] of the first one that cannot.
    pub fn check(&self) -> Result<(), RenderSettingsError> {
        let Self { pictures, motion, sensor, scene, targets, .. } = self;
        let shares = |shares: &[f64]| {
            shares.iter().all(|s| (0.0..=1e6).contains(s)) && shares.iter().any(|s| *s > 0.0)
        };
        let wrong = |field, value: String, expected| {
            Err(RenderSettingsError::Value { field, value, expected })
        };
        for (field, values) in
            [("pictures.shares", &pictures.shares[..]), ("targets.kinds", &targets.kinds[..])]
        {
            if !shares(values) {
                return wrong(field, format!("{values:?}"), "numbers from 0, one of them above 0");
            }
        }
        for (field, value) in [
            ("pictures.oblique_as_ground", pictures.oblique_as_ground),
            ("motion.turn_probability", motion.turn_probability),
            ("motion.hover_probability", motion.hover_probability),
            ("sensor.own_craft_probability", sensor.own_craft_probability),
            ("scene.movers_probability", scene.movers_probability),
            ("scene.birds_probability", scene.birds_probability),
            ("scene.glints_probability", scene.glints_probability),
            ("targets.more_probability", targets.more_probability),
            ("targets.solid_probability", targets.solid_probability),
            ("targets.inverted_probability", targets.inverted_probability),
        ] {
            if !(0.0..=1.0).contains(&value) {
                return wrong(field, value.to_string(), "a probability from 0 to 1");
            }
        }
        // Field, range, least and largest value.
        for (field, [low, high], least, most, expected) in [
            ("focal", self.focal, 100.0, 4000.0, "two rising numbers from 100 to 4000"),
            (
                "motion.agitation",
                motion.agitation,
                1e-3,
                10.0,
                "two rising numbers from 0.001 to 10",
            ),
            (
                "motion.vibration",
                motion.vibration,
                1e-7,
                0.1,
                "two rising numbers from 1e-7 to 0.1",
            ),
            (
                "motion.vibration_hz",
                motion.vibration_hz,
                0.1,
                500.0,
                "two rising numbers from 0.1 to 500",
            ),
            ("motion.turn", motion.turn, 1e-3, 6.0, "two rising numbers from 0.001 to 6"),
            ("motion.speed", motion.speed, 0.0, 100.0, "two rising numbers from 0 to 100"),
            ("motion.height", motion.height, 1.0, 10_000.0, "two rising numbers from 1 to 10000"),
            ("motion.readout", motion.readout, 0.0, 0.1, "two rising numbers from 0 to 0.1"),
            ("motion.exposure", motion.exposure, 1e-6, 0.1, "two rising numbers from 1e-6 to 0.1"),
            (
                "sensor.distortion",
                sensor.distortion,
                -0.3,
                0.3,
                "two rising numbers from -0.3 to 0.3",
            ),
            (
                "sensor.brightness",
                sensor.brightness,
                0.0,
                255.0,
                "two rising numbers from 0 to 255",
            ),
            ("sensor.contrast", sensor.contrast, 0.0, 200.0, "two rising numbers from 0 to 200"),
            ("sensor.gain_drift", sensor.gain_drift, 0.0, 0.5, "two rising numbers from 0 to 0.5"),
            ("sensor.vignette", sensor.vignette, 0.0, 1.0, "two rising numbers from 0 to 1"),
            ("sensor.noise", sensor.noise, 1e-3, 50.0, "two rising numbers from 0.001 to 50"),
            (
                "sensor.quantiser",
                sensor.quantiser,
                0.1,
                200.0,
                "two rising numbers from 0.1 to 200",
            ),
            (
                "scene.mover_pixels",
                scene.mover_pixels,
                1.0,
                400.0,
                "two rising numbers from 1 to 400",
            ),
            ("scene.structure", scene.structure, 0.0, 10.0, "two rising numbers from 0 to 10"),
            ("scene.shimmer", scene.shimmer, 0.0, 4.0, "two rising numbers from 0 to 4"),
            ("targets.pixels", targets.pixels, 2.0, 300.0, "two rising numbers from 2 to 300"),
            ("targets.contrast", targets.contrast, 0.0, 4.0, "two rising numbers from 0 to 4"),
        ] {
            if !(low <= high && low >= least && high <= most) {
                return wrong(field, format!("[{low}, {high}]"), expected);
            }
        }
        let movers: Vec<usize> = scene.movers.to_vec();
        if movers[0] > movers[1] || movers[1] > 200 {
            return wrong("scene.movers", format!("{movers:?}"), "two rising whole numbers to 200");
        }
        if scene.birds > 50 {
            return wrong("scene.birds", scene.birds.to_string(), "a whole number to 50");
        }
        if self.size.iter().any(|s| !(64..=4096).contains(s) || s % 16 != 0) {
            return wrong("size", format!("{:?}", self.size), "multiples of 16 from 64 to 4096");
        }
        if !(1..=240).contains(&self.fps) || !(1..=36_000).contains(&self.frames) {
            let value = format!("{} frames at {}/s", self.frames, self.fps);
            return wrong("frames", value, "1 to 36000 frames at 1 to 240/s");
        }
        Ok(())
    }
}

fn size() -> [usize; 2] {
    [640, 480]
}

fn fps() -> u32 {
    30
}

fn frames() -> u64 {
    150
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self {
            size: size(),
            focal: [480.0, 640.0],
            fps: fps(),
            frames: frames(),
            pictures: BackgroundSettings::default(),
            motion: MotionSettings::default(),
            sensor: Sensor::default(),
            scene: SceneSettings::default(),
            targets: Targets::default(),
        }
    }
}

impl Default for BackgroundSettings {
    fn default() -> Self {
        Self { shares: [0.34, 0.18, 0.2, 0.28], oblique_as_ground: 0.25 }
    }
}

impl Default for MotionSettings {
    fn default() -> Self {
        Self {
            agitation: [0.35, 2.2],
            vibration: [0.00005, 0.0012],
            vibration_hz: [20.0, 45.0],
            turn_probability: 0.15,
            turn: [0.1, 1.2],
            speed: [0.5, 12.0],
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
            contrast: [22.0, 66.0],
            gain_drift: [0.0, 0.12],
            vignette: [0.0, 0.35],
            noise: [0.4, 4.0],
            quantiser: [1.5, 20.0],
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
            pixels: [8.0, 110.0],
            solid_probability: 0.25,
            contrast: [0.6, 1.2],
            inverted_probability: 0.12,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_holds_every_field_with_its_default() {
        assert_eq!(RenderSettings::parse(DEFAULT), Ok(RenderSettings::default()));
        assert_eq!(RenderSettings::parse(""), Ok(RenderSettings::default()));
        // Every field of the structs is in the file: it is written again without a line more.
        let fields = |text: &str| text.lines().filter(|line| line.contains(" = ")).count();
        let written = toml::to_string(&RenderSettings::default()).unwrap();
        let documented = DEFAULT.lines().filter(|line| !line.starts_with('#')).collect::<Vec<_>>();
        assert_eq!(fields(&written), fields(&documented.join("\n")));
    }

    #[test]
    fn mistakes_are_named() {
        for (text, expected) in [
            ("[motion]\nspeeed = [1.0, 2.0]", "speeed"),
            ("[motion]\nspeed = [3.0, 2.0]", "'motion.speed' is [3, 2]"),
            ("[motion]\nheight = [0.0, 2.0]", "'motion.height'"),
            ("[scene]\nmovers_probability = 1.5", "'scene.movers_probability' is 1.5"),
            ("[targets]\nkinds = [0, 0, 0, 0, 0.0]", "targets.kinds"),
            ("[scene]\nmovers = [5, 2]", "scene.movers"),
            ("[motion]\nspeed = [nan, 2.0]", "'motion.speed' is [NaN, 2]"),
        ] {
            let error = RenderSettings::parse(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}
