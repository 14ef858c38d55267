//! The value of `source` in the settings: which camera, stream, program or file frames come from.

use crate::shell::simulate::Manoeuvre;
use crate::shell::sources::y4m::RawLayout;
use clap::ValueEnum;
use serde::Deserialize;
use std::fmt;
use std::path::PathBuf;
use std::string::String;
use std::vec::Vec;

/// Schemes of addresses that `ffmpeg` receives live.
const SCHEMES: [&str; 9] = ["rtsp", "rtsps", "rtmp", "http", "https", "udp", "tcp", "srt", "rtp"];

/// Where frames come from.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(try_from = "SourceSpelling")]
pub enum SourceSetting {
    /// `v4l2:DEVICE`: a V4L2 video node.
    Camera(PathBuf),
    /// `rtsp://...` and other addresses: a network stream, received by `ffmpeg`.
    Address(String),
    /// `{ exec = [PROGRAM, ARGUMENT...] }`: a program that writes y4m to its standard output, or with `raw = "I420"` (NV12,
    /// GRAY8) bare frames.
    Program {
        /// The program and its arguments; no shell reads them.
        words: Vec<String>,
        /// Layout of frames of `camera.width` x `camera.height` without any header; `None`: y4m.
        raw: Option<RawLayout>,
    },
    /// `file:PATH`: a recording, played at its own rate.
    File(PathBuf),
    /// `simulate:KIND`.
    Simulated(Manoeuvre),
}

/// As it stands in the file.
#[derive(Deserialize)]
#[serde(untagged)]
enum SourceSpelling {
    Text(String),
    Table(ProgramTable),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ProgramTable {
    exec: Vec<String>,
    raw: Option<RawLayout>,
}

/// Why a value is no source.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum SourceSettingError {
    /// None of the known forms.
    #[error(
        "expected v4l2:DEVICE, rtsp://HOST/PATH, {{ exec = [\"PROGRAM\", \"ARGUMENT\"] }}, file:PATH or \
         simulate:crossing|hover|collision|receding|none"
    )]
    Form,
    /// A live stream where a recording belongs.
    #[error(
        "file: plays recordings at their own rate; for a live stream write its address alone (\"rtsp://...\"), for a \
         program's output {{ exec = [\"PROGRAM\", \"ARGUMENT\"] }}"
    )]
    Live,
    /// An empty command.
    #[error("exec is empty; name the program and its arguments, each a string of its own")]
    NoProgram,
}

impl TryFrom<SourceSpelling> for SourceSetting {
    type Error = SourceSettingError;

    fn try_from(written: SourceSpelling) -> Result<Self, SourceSettingError> {
        match written {
            SourceSpelling::Text(text) => text.parse(),
            SourceSpelling::Table(ProgramTable { exec, raw }) => match exec.first() {
                Some(program) if !program.is_empty() => Ok(Self::Program { words: exec, raw }),
                _ => Err(SourceSettingError::NoProgram),
            },
        }
    }
}

impl std::str::FromStr for SourceSetting {
    type Err = SourceSettingError;

    fn from_str(text: &str) -> Result<Self, SourceSettingError> {
        if text.starts_with("/dev/video") {
            return Ok(Self::Camera(text.into()));
        }
        match text.split_once(':') {
            Some(("v4l2", path)) if !path.is_empty() => Ok(Self::Camera(path.into())),
            Some(("file", path)) if path == "-" || path.contains("://") => {
                Err(SourceSettingError::Live)
            }
            Some(("file", path)) if !path.is_empty() => Ok(Self::File(path.into())),
            Some(("simulate", kind)) => Manoeuvre::from_str(kind, false)
                .map(Self::Simulated)
                .map_err(|_| SourceSettingError::Form),
            Some((scheme, rest)) if SCHEMES.contains(&scheme) && rest.len() > 2 => {
                let address = rest.starts_with("//").then(|| Self::Address(text.into()));
                address.ok_or(SourceSettingError::Form)
            }
            _ => Err(SourceSettingError::Form),
        }
    }
}

impl SourceSetting {
    /// Checks a value of the settings.
    ///
    /// # Errors
    /// [`SourceSettingError`].
    pub fn check(value: &toml::Value) -> Result<(), SourceSettingError> {
        match value {
            toml::Value::String(text) => text.parse::<Self>().map(drop),
            toml::Value::Table(_) => {
                let table = value.clone().try_into().map_err(|_| SourceSettingError::Form)?;
                Self::try_from(SourceSpelling::Table(table)).map(drop)
            }
            _ => Err(SourceSettingError::Form),
        }
    }

    /// Whether frames arrive as they are taken, over a way whose latency this program cannot know.
    pub fn is_stream(&self) -> bool {
        matches!(self, Self::Address(_) | Self::Program { .. })
    }

    /// User and password of an address with the `@` behind them, which must not be logged.
    pub fn secret(&self) -> Option<&str> {
        let Self::Address(address) = self else { return None };
        let (_, rest) = address.split_once("://")?;
        let authority = rest.split(['/', '?', '#']).next()?;
        authority.get(..=authority.rfind('@')?)
    }
}

/// As it may be logged and shown: without user and password.
impl fmt::Display for SourceSetting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Camera(path) => write!(f, "v4l2:{}", path.display()),
            Self::File(path) => write!(f, "file:{}", path.display()),
            Self::Simulated(kind) => write!(f, "simulate:{}", kind.name()),
            Self::Program { words, .. } => f.write_str(&words.join(" ")),
            Self::Address(address) => match self.secret() {
                Some(secret) => f.write_str(&address.replacen(secret, "***@", 1)),
                None => f.write_str(address),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    fn read(value: &str) -> Result<SourceSetting, String> {
        let table: toml::Table = std::format!("source = {value}").parse().unwrap();
        SourceSetting::check(&table["source"]).map_err(|error| error.to_string())?;
        table["source"].clone().try_into().map_err(|error: toml::de::Error| error.to_string())
    }

    #[test]
    fn every_form() {
        let text = |text: &str| String::from(text);
        for (value, wanted, shown) in [
            ("'v4l2:/dev/video0'", SourceSetting::Camera("/dev/video0".into()), "v4l2:/dev/video0"),
            ("'/dev/video1'", SourceSetting::Camera("/dev/video1".into()), "v4l2:/dev/video1"),
            ("'file:a:b.mp4'", SourceSetting::File("a:b.mp4".into()), "file:a:b.mp4"),
            ("'simulate:hover'", SourceSetting::Simulated(Manoeuvre::Hover), "simulate:hover"),
            (
                "'rtsp://10.0.0.2:8554/m'",
                SourceSetting::Address(text("rtsp://10.0.0.2:8554/m")),
                "rtsp://10.0.0.2:8554/m",
            ),
            (
                "'rtsp://me:p@ss@cam/a@b'",
                SourceSetting::Address(text("rtsp://me:p@ss@cam/a@b")),
                "rtsp://***@cam/a@b",
            ),
            (
                "{ exec = ['gst-launch-1.0', '-q'] }",
                SourceSetting::Program {
                    words: [text("gst-launch-1.0"), text("-q")].into(),
                    raw: None,
                },
                "gst-launch-1.0 -q",
            ),
            (
                "{ exec = ['cam'], raw = 'I420' }",
                SourceSetting::Program { words: [text("cam")].into(), raw: Some(RawLayout::I420) },
                "cam",
            ),
        ] {
            let setting = read(value).unwrap();
            assert_eq!(setting, wanted);
            assert_eq!(setting.to_string(), shown);
        }
        assert!(read("{ exec = ['a'] }").unwrap().is_stream());
        assert!(!read("'file:a'").unwrap().is_stream());
    }

    #[test]
    fn what_is_none_is_refused_with_the_way_out() {
        for (value, wanted) in [
            ("'file:rtsp://cam/x'", "file: plays recordings"),
            ("'file:-'", "file: plays recordings"),
            ("'file:'", "expected v4l2:DEVICE"),
            ("'simulate:dance'", "expected v4l2:DEVICE"),
            ("'rtsp:cam'", "expected v4l2:DEVICE"),
            ("'gopher://cam'", "expected v4l2:DEVICE"),
            ("5", "expected v4l2:DEVICE"),
            ("{ exec = [] }", "exec is empty"),
            ("{ exec = [''] }", "exec is empty"),
            ("{ exec = 'gst-launch-1.0 -q' }", "expected v4l2:DEVICE"),
            ("{ exec = ['a'], shell = true }", "expected v4l2:DEVICE"),
            ("{ exec = ['a'], raw = 'RGB' }", "expected v4l2:DEVICE"),
        ] {
            let error = read(value).unwrap_err();
            assert!(error.contains(wanted), "{value}: {error}");
        }
    }
}
