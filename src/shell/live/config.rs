//! The settings of `lookout run`: a TOML file, checked against the table of keys.

use super::keys::{self, KEYS};
use super::source_setting::SourceSetting;
use crate::mavlink::component::FLEET;
use crate::shell::error::Error;
use crate::shell::formats::camera_file::{CameraArgs, CameraFile};
use crate::shell::formats::error::FormatError;
use crate::shell::link::LinkSpec;
use crate::shell::support::bounded_file;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::format;
use std::net::SocketAddr;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;
use toml::de::{DeTable, DeValue};
use toml::{Spanned, Table, Value};

/// All settings; [`KEYS`] says what they mean.
#[allow(missing_docs, reason = "the table of keys documents every one")]
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct ServiceConfig {
    pub source: SourceSetting,
    pub repeat: bool,
    pub links: Vec<LinkSetting>,
    pub system_id: Option<u8>,
    pub component_id: u8,
    pub heartbeat_type: String,
    pub camera_component: Option<u8>,
    pub signing_key: Option<PathBuf>,
    pub signing_time: Option<PathBuf>,
    pub parameters: Option<PathBuf>,
    pub model: Option<PathBuf>,
    pub threads: usize,
    pub event_log: Option<PathBuf>,
    pub event_log_megabytes: u64,
    pub record: Option<PathBuf>,
    pub record_minutes: u64,
    pub record_megabytes: u64,
    pub json: Option<String>,
    pub preview: Option<SocketAddr>,
    pub preview_token: Option<String>,
    pub traffic: TrafficConfig,
    pub camera: CameraConfig,
    pub stream: StreamConfig,
    /// The same as text, key by key.
    #[serde(skip)]
    values: Table,
}

/// The table `traffic`.
#[allow(missing_docs, reason = "the table of keys documents every one")]
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
pub struct TrafficConfig {
    pub assume: String,
    pub fleet: Vec<String>,
}

/// The table `camera`.
#[allow(missing_docs, reason = "the table of keys documents every one")]
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct CameraConfig {
    pub width: u32,
    pub height: u32,
    pub rate: u32,
    pub format: Option<String>,
    pub calibration: Option<PathBuf>,
    pub field_of_view: f64,
    pub mounting: Vec<f64>,
    pub gimbal: bool,
    pub mask: Option<PathBuf>,
    pub controls: BTreeMap<String, i64>,
}

/// The table `stream`.
#[allow(missing_docs, reason = "the table of keys documents every one")]
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
pub struct StreamConfig {
    pub latency_ms: Option<u32>,
    pub timeout_ms: u32,
}

/// A link as the file names it.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub struct LinkSetting(pub LinkSpec);

impl TryFrom<String> for LinkSetting {
    type Error = crate::shell::link::spec::LinkSpecError;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse().map(Self)
    }
}

impl ServiceConfig {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// [`FileError::Read`](crate::shell::support::file_error::FileError::Read); [`FormatError::Line`] naming line and key.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let text = bounded_file::read_text(path).map_err(Error::read(path))?;
        Self::parse(path, &text)
    }

    /// Checks the text of the file `path`.
    ///
    /// # Errors
    /// [`FormatError::Line`] naming line and key.
    pub fn parse(path: &Path, text: &str) -> Result<Self, Error> {
        let at = |place: usize, reason: String| FormatError::Line {
            path: path.into(),
            // Bytes: the place may be within a character.
            line: text.bytes().take(place).filter(|&byte| byte == b'\n').count() + 1,
            reason,
        };
        let spanned = |span: Option<Range<usize>>| span.map_or(0, |span| span.start);
        let syntax = |e: toml::de::Error| at(spanned(e.span()), e.message().to_string());
        let places = DeTable::parse(text).map_err(syntax)?;
        let mut values: Table = text.parse().map_err(syntax)?;
        check("", places.get_ref(), &values).map_err(|(place, reason)| at(place, reason))?;
        let whole = |reason: &str| at(text.len().saturating_sub(1), reason.into());
        for key in KEYS.iter().filter(|key| !key.default.is_empty()) {
            let (table, name) = match key.name.split_once('.') {
                None => (&mut values, key.name),
                Some((table, name)) => {
                    let table = values.entry(table).or_insert_with(|| Table::new().into());
                    (table.as_table_mut().ok_or_else(|| whole("a table is expected"))?, name)
                }
            };
            let default = || {
                let line: Table = format!("value = {}", key.default).parse().unwrap_or_default();
                line.get("value").cloned().unwrap_or(Value::Boolean(false))
            };
            table.entry(name).or_insert_with(default);
        }
        if !values.contains_key("source") {
            return Err(whole("source is missing: say where frames come from").into());
        }
        let mut config: Self =
            values.clone().try_into().map_err(|e: toml::de::Error| whole(e.message()))?;
        config.values = values;
        if config.traffic.fleet.len() > FLEET {
            return Err(whole(&format!("traffic.fleet: more than {FLEET} callsigns")).into());
        }
        let place = |key: &str| {
            let found = places.get_ref().iter().find(|(name, _)| name.get_ref() == key);
            found.map_or(0, |(name, _)| name.span().start)
        };
        if config.source.is_stream() && config.stream.latency_ms.is_none() {
            let reason = "source: a stream's frames arrive late, and by how much has to be given: stream.latency_ms, the \
                          milliseconds from exposure to arrival (film a running clock; 30 to 60 on the same board, 100 \
                          to 300 over RTSP)";
            return Err(at(place("source"), reason.into()).into());
        }
        if config.preview.is_some_and(|address| !address.ip().is_loopback())
            && config.preview_token.is_none()
        {
            let reason = "preview: others can reach this address; give a preview_token, or listen at 127.0.0.1";
            return Err(at(place("preview"), reason.into()).into());
        }
        Ok(config)
    }

    /// The value of a key as TOML, if it has one.
    pub fn value(&self, name: &str) -> Option<String> {
        get(&self.values, name).map(Value::to_string)
    }

    /// Keys whose values differ.
    pub fn changes(&self, other: &Self) -> Vec<&'static keys::Key> {
        KEYS.iter()
            .filter(|key| get(&self.values, key.name) != get(&other.values, key.name))
            .collect()
    }

    /// The camera for frames of this size; `own` is what the source knows of it.
    ///
    /// # Errors
    /// As [`CameraArgs::camera`].
    pub fn camera(
        &self,
        (width, height): (usize, usize),
        own: Option<&CameraFile>,
    ) -> Result<crate::camera::Camera, Error> {
        let CameraConfig { calibration, field_of_view, mounting, .. } = &self.camera;
        let args = CameraArgs {
            camera: calibration.clone(),
            fov: *field_of_view,
            mounting: mounting.clone(),
        };
        Ok(args.camera(width, height, own)?)
    }
}

fn get<'a>(values: &'a Table, name: &str) -> Option<&'a Value> {
    match name.split_once('.') {
        None => values.get(name),
        Some((table, name)) => values.get(table)?.get(name),
    }
}

/// Checks a table; the place in the text and the reason where something is wrong.
fn check(prefix: &str, places: &DeTable<'_>, values: &Table) -> Result<(), (usize, String)> {
    for (name, place) in places {
        let full = format!("{prefix}{}", name.get_ref());
        let value = values.get(name.get_ref().as_ref());
        match (keys::find(&full), place.get_ref(), value) {
            (Some(key), _, Some(value)) => {
                let named = |reason| (start(place), format!("{full}: {reason}"));
                key.check(value).map_err(named)?;
            }
            (None, DeValue::Table(inner), Some(Value::Table(value)))
                if KEYS.iter().any(|key| key.name.starts_with(&format!("{full}."))) =>
            {
                check(&format!("{full}."), inner, value)?;
            }
            _ => {
                let near = KEYS.iter().map(|key| key.name);
                let near =
                    near.min_by_key(|known| strsim::levenshtein(known, &full)).unwrap_or_default();
                let reason = format!(
                    "unknown key {full}; is {near} meant? `lookout run --print-config` explains all"
                );
                return Err((name.span().start, reason));
            }
        }
    }
    Ok(())
}

fn start(place: &Spanned<DeValue<'_>>) -> usize {
    place.span().start
}

/// The key whose value is not shown.
const SECRET: &str = "preview_token";

/// All keys explained, with the values of `config` or their defaults: a file that can be used.
pub fn print(config: Option<&ServiceConfig>) -> String {
    let mut text = String::from(
        "# Settings of `lookout run`. After a change `systemctl reload lookout` (SIGHUP) takes what can change in flight.\n",
    );
    let mut table = "";
    for key in KEYS {
        let name = match key.name.split_once('.') {
            None => key.name,
            Some((inside, name)) => {
                if table != inside {
                    table = inside;
                    // Writing to a string cannot fail, here and below.
                    let _ = writeln!(text, "\n[{table}]");
                }
                name
            }
        };
        let default = if key.default.is_empty() { "none" } else { key.default };
        let reload = if key.reload { "" } else { " A restart takes a change." };
        let _ = writeln!(text, "\n# {}", key.about);
        let _ = writeln!(text, "# Expected: {}. Default: {default}.{reload}", key.expected());
        let value = config.map_or(Some(key.default.into()), |config| config.value(key.name));
        let _ = match value.filter(|value| !value.is_empty()) {
            Some(_) if key.name == SECRET => writeln!(text, "# {name} = (set, not shown)"),
            Some(value) => writeln!(text, "{name} = {value}"),
            None => writeln!(text, "# {name} ="),
        };
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<ServiceConfig, String> {
        ServiceConfig::parse(Path::new("f.toml"), text).map_err(|error| error.to_string())
    }

    #[test]
    fn what_is_printed_is_the_same_again() {
        let text = "source = \"simulate:hover\"\nlinks = ['udpin:0.0.0.0:14540']\nthreads = 2\n\
                    [camera]\nfield_of_view = 62\ncontrols = { gain = 7 }\nmounting = [0, -10, 0]\n";
        let config = parse(text).unwrap();
        let printed = print(Some(&config));
        assert_eq!(parse(&printed).unwrap(), config, "{printed}");
        assert_eq!((config.threads, config.camera.field_of_view), (2, 62.0));
        assert_eq!(config.camera.controls["gain"], 7);
        for key in KEYS {
            let name = key.name.rsplit('.').next().unwrap();
            assert!(
                printed.lines().any(|l| l.trim_start_matches("# ").starts_with(name)),
                "{name}"
            );
        }
        let text = "source = { exec = ['gst-launch-1.0', 'a \"b\"'] }\nstream.latency_ms = 40\n";
        let config = parse(text).unwrap();
        assert_eq!(parse(&print(Some(&config))).unwrap(), config);
        // Without a file: all defaults, ready for a source.
        let defaults = print(None).replacen("# source =", "source = \"file:x\"", 1);
        assert_eq!(parse(&defaults).unwrap(), parse("source = 'file:x'").unwrap());
    }

    #[test]
    fn defaults_are_in_range() {
        for key in KEYS.iter().filter(|key| !key.default.is_empty()) {
            let table: Table = format!("value = {}", key.default).parse().unwrap();
            assert_eq!(key.check(&table["value"]), Ok(()), "{}", key.name);
        }
    }

    #[test]
    fn the_token_is_not_printed() {
        let text = "source = 'simulate:hover'\npreview_token = 'a-token-of-enough-letters'\n";
        let printed = print(Some(&parse(text).unwrap()));
        assert!(printed.contains("# preview_token = (set, not shown)"), "{printed}");
        assert!(!printed.contains("a-token"), "{printed}");
    }

    /// Found with the fuzz target `config` in mind: the line was counted up to a byte within the last character.
    #[test]
    fn a_last_letter_of_several_bytes() {
        let error = parse("links = []\n# \u{e9}").unwrap_err();
        assert!(error.contains("line 2: source is missing"), "{error}");
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        for (text, wanted) in [
            (
                "source = 'v4l2:/dev/video0'\n\nlinx = []\n",
                "line 3: unknown key linx; is links meant?",
            ),
            (
                "source = 'v4l2:/dev/video0'\n[camera]\nwidht = 640\n",
                "line 3: unknown key camera.widht",
            ),
            (
                "source = 'v4l2:/dev/video0'\n[camera]\n\nwidth = 0\n",
                "line 4: camera.width: expected a whole",
            ),
            (
                "source = 'v4l2:/dev/video0'\ncamera.width = '640'\n",
                "line 2: camera.width: expected a whole",
            ),
            ("source = 'simulate:dance'\n", "line 1: source: expected v4l2:DEVICE"),
            ("source = 5\n", "line 1: source: expected v4l2:DEVICE"),
            (
                "repeat = true\nsource = 'rtsp://cam/x'\n",
                "line 2: source: a stream's frames arrive late",
            ),
            (
                "source = 'file:rtsp://cam/x'\n",
                "line 1: source: file: plays recordings at their own",
            ),
            ("source = { exec = [] }\n", "line 1: source: exec is empty"),
            (
                "source = 'file:x'\n[stream]\nlatency_ms = -1\n",
                "line 3: stream.latency_ms: expected a whole",
            ),
            ("source = 'file:x'\nlinks = ['udpin:1']\n", "line 2: links: link 'udpin:1'"),
            (
                "source = 'file:x'\nthreads = 1.5\n",
                "line 2: threads: expected a whole number from 0",
            ),
            ("source = 'file:x'\ncamera = 3\n", "line 2: unknown key camera"),
            ("source = 'file:x'\n[other]\na = 1\n", "line 2: unknown key other"),
            ("source = 'file:x'\nthreads =\n", "line 2: "),
            ("source = 'file:x'\nrepeat = false\nrepeat = true\n", "line 3: duplicate key"),
            ("threads = 1\n", "source is missing"),
            ("", "source is missing"),
            ("source = 'file:x'\npreview = '0.0.0.0:80'\n", "line 2: preview: others can reach"),
            (
                "source = 'file:x'\ncamera.mounting = [0, 0]\n",
                "line 2: camera.mounting: expected 3",
            ),
            (
                "source = 'file:x'\ncamera.controls = { gain = 'x' }\n",
                "line 2: camera.controls: exp",
            ),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.starts_with("f.toml line ") && error.contains(wanted), "{text}: {error}");
        }
    }

    #[test]
    fn changes_are_found_by_key() {
        let before = parse("source = 'file:x'\n").unwrap();
        let after = parse("source = 'file:y'\nthreads = 3\ncamera.width = 640\n").unwrap();
        let names: Vec<_> = before.changes(&after).iter().map(|key| key.name).collect();
        assert_eq!(names, ["source", "threads"]);
    }
}
