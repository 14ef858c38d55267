//! Checks of the files, folders and devices that the settings name.

use super::config::ServiceConfig;
use super::source_setting::SourceSetting;
use crate::shell::formats::camera_file;
use crate::shell::link::spec::Address;
use crate::shell::link::{params, signing};
use crate::shell::pipeline::{MaskFile, ModelFile};
use crate::shell::sources::process;
use std::ffi::OsStr;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;
use std::{format, io};

/// A fault of the settings.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// The key, as `camera.calibration`.
    pub key: &'static str,
    /// The problem and its remedy.
    pub text: String,
    /// Whether `lookout run` starts nevertheless: a device may be plugged in later, a folder is made.
    pub starts: bool,
}

/// Settings with which `lookout run` does not start.
#[derive(Debug, thiserror::Error)]
#[error("{}: faults: {faults}, see above", path.display())]
pub struct UnusableSettings {
    /// The file of the settings.
    pub path: PathBuf,
    /// Number of settings that are wrong.
    pub faults: usize,
}

/// Whether the settings make the lookout do nothing that anybody or anything learns of.
pub fn does_nothing(config: &ServiceConfig) -> bool {
    config.links.is_empty()
        && config.preview.is_none()
        && config.event_log.is_none()
        && config.record.is_none()
        && config.json.is_none()
}

/// Text of the warning of [`does_nothing`].
pub const NOTHING: &str = "nothing to do: there is no link, preview, event_log, record or json; traffic is watched and reported to nobody";

/// All faults of what the settings name, in the order of the keys.
pub fn faults(config: &ServiceConfig) -> Vec<Fault> {
    let mut faults = Vec::new();
    let mut add = |key, starts, found: Result<(), String>| {
        faults.extend(found.err().map(|text| Fault { key, text, starts }));
    };
    let named = |path: &Path, error: io::Error| format!("{}: {error}", path.display());
    let device = |path: &Path| match fs::metadata(path) {
        Ok(_) => Ok(()),
        Err(error) => Err(format!("{}; `lookout run` waits for it", named(path, error))),
    };
    // A program may be installed later, as a device may be plugged in.
    let program = |name: &str| match process::find(OsStr::new(name)) {
        Ok(_) => Ok(()),
        Err(error) => Err(format!("{error}; install it, or name its path")),
    };
    match &config.source {
        SourceSetting::Camera(path) => add("source", true, device(path)),
        SourceSetting::File(path) => {
            add("source", false, fs::metadata(path).map(drop).map_err(|e| named(path, e)));
        }
        SourceSetting::Program { words, .. } => {
            add("source", true, words.first().map_or(Ok(()), |name| program(name)));
        }
        SourceSetting::Address(_) => add("source", true, program("ffmpeg")),
        SourceSetting::Simulated(_) => {}
    }
    for link in &config.links {
        if let Address::Serial { device: path, .. } = &link.0.address {
            add("links", true, device(Path::new(path)));
        }
    }
    if let Some(path) = &config.signing_key {
        add("signing_key", false, signing::read_key(path).map(drop).map_err(|e| named(path, e)));
    }
    if let Some(path) = &config.signing_time {
        // Made where it is missing.
        match File::open(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                add("signing_time", true, parent(path));
            }
            opened => add("signing_time", false, opened.map(drop).map_err(|e| named(path, e))),
        }
    }
    if let Some(path) = &config.parameters {
        // The defaults do, and what cannot be written is tried again.
        let read = params::load(path).map(drop).map_err(|e| named(path, e));
        add("parameters", true, read.and_then(|()| parent(path)));
    }
    if config.model.is_some() {
        let model = ModelFile::load(config.model.as_deref());
        let parsed = model.and_then(|file| file.parse().map(drop)).map_err(|e| e.to_string());
        add("model", false, parsed);
    }
    for (key, folder) in [("event_log", &config.event_log), ("record", &config.record)] {
        let Some(path) = folder else { continue };
        match fs::metadata(path) {
            Ok(found) if found.is_dir() => {}
            // It is tried again and again, and watching goes on without it.
            Ok(_) => add(key, true, Err(format!("{}: is no folder", path.display()))),
            Err(_) => add(key, true, can_be_made(path)),
        }
    }
    let calibration = config.camera.calibration.as_deref();
    if let Some(path) = calibration {
        let size = (config.camera.width as usize, config.camera.height as usize);
        // A file or a stream has a size of its own, which only its frames show.
        let own_size = config.source.is_stream() || matches!(config.source, SourceSetting::File(_));
        let fits = || config.camera(size, None).map(drop).map_err(|e| e.to_string());
        let read = || camera_file::read(path).map(drop).map_err(|e| e.to_string());
        add("camera.calibration", false, if own_size { read() } else { fits() });
    }
    if let Some(path) = &config.camera.mask {
        add("camera.mask", true, MaskFile::load(path).map(drop).map_err(|e| e.to_string()));
    }
    if does_nothing(config) {
        add("links", true, Err(NOTHING.into()));
    }
    faults
}

/// Whether the folder `path` can be made, with those that are missing above it.
fn can_be_made(path: &Path) -> Result<(), String> {
    let Some(above) = path.ancestors().skip(1).find(|above| fs::metadata(above).is_ok()) else {
        // Relative to the folder in which the program runs.
        return Ok(());
    };
    match rustix::fs::access(above, rustix::fs::Access::WRITE_OK | rustix::fs::Access::EXEC_OK) {
        _ if !above.is_dir() => Err(format!("{}: {} is a file", path.display(), above.display())),
        Ok(()) => Ok(()),
        Err(error) => Err(format!(
            "{}: cannot be made in {}: {}; as another user, as a service, it may be",
            path.display(),
            above.display(),
            io::Error::from(error)
        )),
    }
}

/// Checks that the folder exists in which `path` will be created.
fn parent(path: &Path) -> Result<(), String> {
    let folder = match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    match fs::metadata(folder) {
        Ok(found) if found.is_dir() => Ok(()),
        Ok(_) => Err(format!("{}: its folder is a file", path.display())),
        Err(error) => Err(format!("{}: its folder: {error}", path.display())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn faults_of(text: &str) -> Vec<Fault> {
        faults(&ServiceConfig::parse(Path::new("f.toml"), text).unwrap())
    }

    #[test]
    fn all_faults_are_listed() {
        let text = r#"
            source = "v4l2:/dev/video-nosuch"
            links = ["serial:/dev/nosuch:57600"]
            model = "/nope/model.lkm"
            signing_key = "/nope/key"
            signing_time = "/nope/key.time"
            parameters = "/nope/dir/p.txt"
            event_log = "/dev/null/ev"
            record = "/dev/null"
            camera.calibration = "/nope/camera.yaml"
            camera.mask = "/nope/mask.png"
        "#;
        let faults = faults_of(text);
        let keys: Vec<_> = faults.iter().map(|fault| (fault.key, fault.starts)).collect();
        assert_eq!(
            keys,
            [
                ("source", true),
                ("links", true),
                ("signing_key", false),
                ("signing_time", true),
                ("parameters", true),
                ("model", false),
                ("event_log", true),
                ("record", true),
                ("camera.calibration", false),
                ("camera.mask", true),
            ]
        );
        for (fault, path) in faults.iter().zip([
            "/dev/video-nosuch",
            "/dev/nosuch",
            "/nope/key",
            "/nope/key.time",
            "/nope/dir/p.txt",
            "/nope/model.lkm",
            "/dev/null/ev: /dev/null is a file",
            "/dev/null: is no folder",
            "/nope/camera.yaml",
            "/nope/mask.png",
        ]) {
            assert!(fault.text.contains(path), "{fault:?}");
        }
    }

    /// `lookout run` makes them at its start.
    #[test]
    fn folders_that_will_be_made_are_no_fault() {
        let place = tempfile::tempdir().unwrap();
        let at = |name: &str| place.path().join(name).display().to_string();
        let text = format!(
            "source = 'simulate:hover'\nrecord = '{}'\nevent_log = '{}'\nparameters = '{}'\n",
            at("new"),
            at("a/b/c"),
            at("parameters.txt")
        );
        assert_eq!(faults_of(&text), []);
        assert_eq!(faults_of("source = 'simulate:hover'\nrecord = 'rec/ording'"), []);
        // A calibration that is none is found whatever the source's size is.
        std::fs::write(place.path().join("camera.yaml"), "camera_matrix: 5").unwrap();
        std::fs::write(place.path().join("flight.y4m"), "").unwrap();
        let text = format!(
            "source = 'file:{}'\nlinks = ['udpin:0.0.0.0:14550']\ncamera.calibration = '{}'\n",
            at("flight.y4m"),
            at("camera.yaml")
        );
        let faults = faults_of(&text);
        assert_eq!((faults.len(), faults[0].key), (1, "camera.calibration"), "{faults:?}");
    }

    #[test]
    fn nothing_to_do_is_a_fault() {
        let faults = faults_of("source = 'simulate:hover'");
        assert_eq!(faults.len(), 1);
        assert!(faults[0].starts && faults[0].text.contains("nothing to do"));
        assert_eq!(faults_of("source = 'simulate:hover'\nlinks = ['udpin:0.0.0.0:14550']"), []);
        assert_eq!(faults_of("source = 'simulate:hover'\npreview = '127.0.0.1:8090'"), []);
    }
}
