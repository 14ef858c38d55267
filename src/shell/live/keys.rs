//! Every key of the settings: meaning, unit, default, range, and whether a reload (SIGHUP) applies a change.

use super::json_stream;
use super::source_setting::SourceSetting;
use crate::mavlink::messages::adsb::Callsign;
use crate::shell::link::LinkSpec;
use crate::shell::preview::is_token;
use std::format;
use std::net::SocketAddr;
use std::string::{String, ToString};
use toml::Value;

/// Type and range of a key's value.
#[derive(Debug, Clone, Copy)]
pub enum KeyKind {
    /// Text, and a check that gives the error, or nothing for the general one.
    Text(fn(&str) -> Result<(), String>),
    /// A [`SourceSetting`].
    Source,
    /// A list of texts.
    Texts(fn(&str) -> Result<(), String>),
    /// A whole number in an inclusive range.
    Whole(i64, i64),
    /// A number in an inclusive range.
    Number(f64, f64),
    /// A list of this length of numbers in an inclusive range.
    Numbers(usize, f64, f64),
    /// `true` or `false`.
    Switch,
    /// A table of whole numbers; its names are controls of the camera.
    Wholes,
}

/// A key of the settings.
#[derive(Debug, Clone, Copy)]
pub struct Key {
    /// Name; `TABLE.NAME` for a key in a table.
    pub name: &'static str,
    /// Type and range of the value.
    pub kind: KeyKind,
    /// Unit, or form of the value.
    pub unit: &'static str,
    /// Default as TOML; empty where the key has none.
    pub default: &'static str,
    /// Whether a reload applies a change; otherwise a restart does.
    pub reload: bool,
    /// Meaning, one or two sentences.
    pub about: &'static str,
}

/// All keys, in the order in which they are explained.
pub const KEYS: &[Key] = &[
    Key {
        name: "source",
        kind: KeyKind::Source,
        unit: "v4l2:DEVICE, rtsp://HOST/PATH, { exec = [\"PROGRAM\", \"ARGUMENT\"] }, file:PATH or simulate:crossing|hover|collision|receding|none",
        default: "",
        reload: true,
        about: "Where frames come from; always needed. An address is received by ffmpeg; a program writes y4m to its standard output. A file (video, .y4m, folder of pictures) or a simulated flight runs in real time.",
    },
    Key {
        name: "repeat",
        kind: KeyKind::Switch,
        unit: "",
        default: "false",
        reload: true,
        about: "Start a file or a simulated flight anew at its end, where the program ends otherwise.",
    },
    Key {
        name: "links",
        kind: KeyKind::Texts(link),
        unit: "udpout:HOST:PORT, udpin:HOST:PORT, tcpout:HOST:PORT, tcpin:HOST:PORT, serial:DEVICE:BAUD",
        default: "[]",
        reload: true,
        about: "Links to autopilots and ground stations. What is sent goes to all of them.",
    },
    Key {
        name: "system_id",
        kind: KeyKind::Whole(1, 255),
        unit: "",
        default: "",
        reload: false,
        about: "MAVLink system id; left out: that of the autopilot, from its first heartbeat.",
    },
    Key {
        name: "component_id",
        kind: KeyKind::Whole(1, 255),
        unit: "",
        default: "196",
        reload: false,
        about: "MAVLink component id: 196 obstacle avoidance, 191 onboard computer. A second lookout on the same vehicle needs another, 197 say: the ids of its traffic follow from it.",
    },
    Key {
        name: "heartbeat_type",
        kind: KeyKind::Text(heartbeat_type),
        unit: "onboard_controller, adsb or flarm",
        default: "\"onboard_controller\"",
        reload: false,
        about: "MAV_TYPE of the heartbeat. adsb or flarm satisfy PX4's check for a traffic receiver (COM_ARM_TRAFF, COM_TRAFF_AVOID), though the lookout sees no traffic outside of its camera's view.",
    },
    Key {
        name: "camera_component",
        kind: KeyKind::Whole(1, 255),
        unit: "",
        default: "",
        reload: false,
        about: "Be a camera component of this id too (100 is usual), so that QGroundControl draws a box on its video.",
    },
    Key {
        name: "signing_key",
        kind: KeyKind::Text(any),
        unit: "file of 64 hexadecimal digits",
        default: "",
        reload: false,
        about: "Sign what is sent, and ignore what is not signed with this key. Other users must not be able to read the file.",
    },
    Key {
        name: "signing_time",
        kind: KeyKind::Text(any),
        unit: "file",
        default: "",
        reload: false,
        about: "Where the signing times are kept over a restart; left out: in FILE.time, FILE being the signing key.",
    },
    Key {
        name: "parameters",
        kind: KeyKind::Text(any),
        unit: "file",
        default: "",
        reload: false,
        about: "Where the parameters that ground stations set (LK_...) are kept over a restart; left out: not kept.",
    },
    Key {
        name: "model",
        kind: KeyKind::Text(any),
        unit: "file",
        default: "",
        reload: false,
        about: "The detector's model; left out: the one in the program.",
    },
    Key {
        name: "threads",
        kind: KeyKind::Whole(0, 64),
        unit: "",
        default: "0",
        reload: false,
        about: "Threads of the detector; 0: one a processor core.",
    },
    Key {
        name: "event_log",
        kind: KeyKind::Text(any),
        unit: "folder",
        default: "",
        reload: true,
        about: "Why did it warn? For every alert a line of JSON and a picture of what was seen; left out: not kept.",
    },
    Key {
        name: "event_log_megabytes",
        kind: KeyKind::Whole(1, 1_000_000),
        unit: "megabytes",
        default: "64",
        reload: true,
        about: "The event log's size; the oldest alerts give way.",
    },
    Key {
        name: "record",
        kind: KeyKind::Text(any),
        unit: "folder",
        default: "",
        reload: true,
        about: "Keep the last minutes as the detector saw them, with the vehicle's telemetry, for `lookout replay`; left out: not kept.",
    },
    Key {
        name: "record_minutes",
        kind: KeyKind::Whole(1, 1440),
        unit: "minutes",
        default: "5",
        reload: true,
        about: "How much is kept at least.",
    },
    Key {
        name: "record_megabytes",
        kind: KeyKind::Whole(1, 1_000_000),
        unit: "megabytes",
        default: "4000",
        reload: true,
        about: "The recording's size; the oldest minute gives way, also before its time.",
    },
    Key {
        name: "json",
        kind: KeyKind::Text(json),
        unit: "udp:HOST:PORT",
        default: "",
        reload: true,
        about: "Send every frame as a line of JSON, as `lookout replay --jsonl` writes it, in a UDP datagram; left out: not sent. examples/ros2_bridge.py reads them.",
    },
    Key {
        name: "preview",
        kind: KeyKind::Text(address),
        unit: "ADDRESS:PORT",
        default: "",
        reload: true,
        about: "A page for browsers: picture, tracks, state; left out: none. 127.0.0.1:8090 is seen on this machine only.",
    },
    Key {
        name: "preview_token",
        kind: KeyKind::Text(token),
        unit: "16 to 256 letters, digits, - . _ ~",
        default: "",
        reload: true,
        about: "Word that a browser must give to see the page. Needed where `preview` is not a loopback address.",
    },
    Key {
        name: "traffic.assume",
        kind: KeyKind::Text(assume),
        unit: "drone or aircraft",
        default: "\"drone\"",
        reload: false,
        about: "What objects are taken for in ADSB_VEHICLE: emitter type UAV with an id that ArduPlane's avoidance gives a drone's margin of 50 m, or LIGHT with one that gets an aircraft's.",
    },
    Key {
        name: "traffic.fleet",
        kind: KeyKind::Texts(callsign),
        unit: "callsigns of at most 8 letters and digits, at most 16 of them",
        default: "[]",
        reload: false,
        about: "The own fleet: an object in the direction of an ADSB_VEHICLE with one of these callsigns gets no text, ADSB_VEHICLE or COLLISION.",
    },
    Key {
        name: "stream.latency_ms",
        kind: KeyKind::Whole(0, 60_000),
        unit: "milliseconds",
        default: "",
        reload: true,
        about: "From exposure to arrival of a frame: camera, encoder, network and decoder. Needed for an address or a program; film a running clock to measure it.",
    },
    Key {
        name: "stream.timeout_ms",
        kind: KeyKind::Whole(200, 60_000),
        unit: "milliseconds",
        default: "2000",
        reload: true,
        about: "An address or a program without a frame for this long is ended and started again; the first frame may take 15 s.",
    },
    Key {
        name: "camera.width",
        kind: KeyKind::Whole(16, 4096),
        unit: "pixels",
        default: "640",
        reload: true,
        about: "Width of frames requested from a camera or simulated; streams are scaled down to fit, files and programs have their own.",
    },
    Key {
        name: "camera.height",
        kind: KeyKind::Whole(16, 4096),
        unit: "pixels",
        default: "480",
        reload: true,
        about: "Height, likewise.",
    },
    Key {
        name: "camera.rate",
        kind: KeyKind::Whole(1, 240),
        unit: "frames a second",
        default: "30",
        reload: true,
        about: "Frames a second, likewise.",
    },
    Key {
        name: "camera.format",
        kind: KeyKind::Text(format),
        unit: "GREY, NV12, YUYV, UYVY or MJPEG",
        default: "",
        reload: true,
        about: "Pixel format of a camera; left out: the best it has.",
    },
    Key {
        name: "camera.calibration",
        kind: KeyKind::Text(any),
        unit: "file: OpenCV or ROS YAML, or camera.json",
        default: "",
        reload: true,
        about: "The camera's calibration at this size.",
    },
    Key {
        name: "camera.mask",
        kind: KeyKind::Text(any),
        unit: "file: PNG, PGM or JPEG with the frames' aspect ratio",
        default: "",
        reload: false,
        about: "Nothing is reported where this picture is black: own legs and propellers, text burnt into the picture. `lookout mask` makes one of a recorded flight.",
    },
    Key {
        name: "camera.field_of_view",
        kind: KeyKind::Number(10.0, 170.0),
        unit: "degrees",
        default: "60.0",
        reload: true,
        about: "Horizontal field of view where there is no calibration; directions and ranges are rough then.",
    },
    Key {
        name: "camera.mounting",
        kind: KeyKind::Numbers(3, -180.0, 180.0),
        unit: "degrees: roll, pitch (nose up), yaw (to the right)",
        default: "[0.0, 0.0, 0.0]",
        reload: true,
        about: "How the camera is turned on the vehicle; zeros look forward.",
    },
    Key {
        name: "camera.gimbal",
        kind: KeyKind::Switch,
        unit: "",
        default: "false",
        reload: false,
        about: "The camera is on a gimbal: where it looks comes from GIMBAL_DEVICE_ATTITUDE_STATUS, its field of view from CAMERA_FOV_STATUS where that is sent, and camera.mounting is how it is turned on the gimbal. Without a message for 0.3 s no position of traffic is sent.",
    },
    Key {
        name: "camera.controls",
        kind: KeyKind::Wholes,
        unit: "the camera's own, see `v4l2-ctl --list-ctrls`",
        default: "{}",
        reload: true,
        about: "Controls of the camera by name, as { exposure_time_absolute = 100, gain = 32 }.",
    },
];

/// The key of a name.
pub fn find(name: &str) -> Option<&'static Key> {
    KEYS.iter().find(|key| key.name == name)
}

impl Key {
    /// The expected value in words, for messages.
    pub fn expected(&self) -> String {
        let range = match self.kind {
            KeyKind::Text(_) | KeyKind::Source => return self.unit.into(),
            KeyKind::Texts(_) => return format!("a list of {}", self.unit),
            KeyKind::Switch => return "true or false".into(),
            KeyKind::Wholes => return format!("a table of whole numbers: {}", self.unit),
            KeyKind::Whole(min, max) => format!("a whole number from {min} to {max}"),
            KeyKind::Number(min, max) => format!("a number from {min} to {max}"),
            KeyKind::Numbers(count, min, max) => format!("{count} numbers from {min} to {max}"),
        };
        if self.unit.is_empty() { range } else { format!("{range}, in {}", self.unit) }
    }

    /// Checks a value.
    ///
    /// # Errors
    /// The reason, without the key's name.
    pub fn check(&self, value: &Value) -> Result<(), String> {
        let wrong = || format!("expected {}", self.expected());
        let text = |check: fn(&str) -> Result<(), String>, value: &Value| {
            let text = value.as_str().filter(|text| !text.is_empty()).ok_or_else(wrong)?;
            check(text).map_err(|reason| if reason.is_empty() { wrong() } else { reason })
        };
        let number = |value: &Value| value.as_float().or(value.as_integer().map(|v| v as f64));
        let good = match self.kind {
            KeyKind::Text(check) => return text(check, value),
            KeyKind::Source => {
                return SourceSetting::check(value).map_err(|error| error.to_string());
            }
            KeyKind::Texts(check) => {
                return value.as_array().ok_or_else(wrong)?.iter().try_for_each(|v| text(check, v));
            }
            KeyKind::Whole(min, max) => {
                value.as_integer().is_some_and(|v| (min..=max).contains(&v))
            }
            KeyKind::Number(min, max) => number(value).is_some_and(|v| (min..=max).contains(&v)),
            KeyKind::Numbers(count, min, max) => value.as_array().is_some_and(|list| {
                let inside = |v| number(v).is_some_and(|v| (min..=max).contains(&v));
                list.len() == count && list.iter().all(inside)
            }),
            KeyKind::Switch => value.is_bool(),
            KeyKind::Wholes => value.as_table().is_some_and(|t| t.values().all(Value::is_integer)),
        };
        if good { Ok(()) } else { Err(wrong()) }
    }
}

fn token(text: &str) -> Result<(), String> {
    if is_token(text) { Ok(()) } else { Err(String::new()) }
}

fn any(_: &str) -> Result<(), String> {
    Ok(())
}

fn json(text: &str) -> Result<(), String> {
    json_stream::address(text).map(drop)
}

fn link(text: &str) -> Result<(), String> {
    text.parse::<LinkSpec>().map(drop).map_err(|error| error.to_string())
}

fn one_of(text: &str, words: &[&str]) -> Result<(), String> {
    if words.contains(&text) { Ok(()) } else { Err(String::new()) }
}

fn heartbeat_type(text: &str) -> Result<(), String> {
    one_of(text, &["onboard_controller", "adsb", "flarm"])
}

fn assume(text: &str) -> Result<(), String> {
    one_of(text, &["drone", "aircraft"])
}

fn callsign(text: &str) -> Result<(), String> {
    let name = Callsign::new(text.as_bytes());
    if name.is_some_and(|name| name.as_str() == text) { Ok(()) } else { Err(String::new()) }
}

fn address(text: &str) -> Result<(), String> {
    text.parse::<SocketAddr>().map(drop).map_err(|_| String::new())
}

fn format(text: &str) -> Result<(), String> {
    if ["GREY", "NV12", "YUYV", "UYVY", "MJPEG"].contains(&text) {
        Ok(())
    } else {
        Err(String::new())
    }
}
