//! Rendered flights for training: clips in the folder `OUT.flights`.

use super::footage::is_held_back;
use super::paste::Turning;
use super::report::TrainingReport;
use super::{TrainArgs, TrainError};
use crate::shell::error::Error;
use crate::shell::formats::clips;
use crate::shell::pictures::PictureError;
use crate::shell::render::{Assets, RenderSettings, RenderedFlight, RenderedTruth};
use crate::shell::sources::Frame;
use crate::shell::support::interrupt;
use crate::shell::support::parallel;
use crate::shell::support::random::Random;
use std::ffi::OsString;
use std::fmt::Write as _;
use std::format;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::string::{String, ToString};
use std::vec::Vec;

/// Constant rate factors of H.264 that flights are encoded with: hardly any loss to that of a poor radio link.
const RATE_FACTORS: core::ops::Range<usize> = 14..33;

/// Rendered flights for training
#[derive(Debug, Clone, clap::Args, serde::Serialize)]
pub struct TrainRenderArgs {
    /// Flights to render and learn from in addition to DATA; needs --backgrounds. They stay in OUT.flights
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub render: usize,
    /// Frames of each rendered flight, at 30 a second: more flights of fewer frames show more scenes and objects
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = clap::value_parser!(u64).range(20..=3000))]
    pub render_frames: u64,
    /// Folder of photographs and panoramas for backgrounds; every folder in it is one scene
    #[arg(long, value_name = "DIR")]
    pub backgrounds: Option<PathBuf>,
    /// Folder of OBJ models of aircraft, shown in addition to objects cut out of DATA
    #[arg(long, value_name = "DIR")]
    pub shapes: Option<PathBuf>,
}

/// Renders the flights that are not there yet. Every `--hold-back`th flight, which is never trained on, is before scenes
/// of its own. Objects are cut out of the clips of DATA that are trained on.
///
/// # Errors
/// [`Error`] of a picture, clip or shape that cannot be read, of files that cannot be written, or of `ffmpeg`.
pub fn render(args: &TrainArgs, report: &TrainingReport) -> Result<(), Error> {
    let TrainArgs { data, seed, hold_back, rendered, .. } = args;
    let (seed, hold_back, folder) = (*seed, *hold_back, &args.flights());
    let Some(backgrounds) = &rendered.backgrounds else {
        return Err(TrainError::NoBackgrounds.into());
    };
    // Real video compression instead of the renderer's own.
    let mut settings = RenderSettings::default();
    settings.sensor.quantiser = [1.0, 1.0];
    settings.frames = rendered.render_frames;
    fs::create_dir_all(folder).map_err(Error::write(folder))?;
    let of = serde_json::json!({
        "seed": seed, "hold_back": hold_back, "cut out of": data, "backgrounds": backgrounds,
        "shapes": rendered.shapes, "frames": settings.frames, "settings": settings,
    });
    same_settings(folder, &format!("{of}\n"))?;
    let missing: Vec<usize> =
        (0..rendered.render).filter(|&index| !flight(folder, index).is_dir()).collect();
    if missing.is_empty() {
        return Ok(());
    }
    let mut cutouts = Vec::new();
    for folder in data {
        for (place, clip) in clips::clips(folder)?.into_iter().enumerate() {
            // As for pasting: what is rendered itself shows the same objects again.
            if !is_held_back(place, hold_back) && !Turning::is_known(&clip.directory)? {
                cutouts.push(clip.directory);
            }
        }
    }
    let assets = Assets::load(backgrounds, &cutouts, rendered.shapes.as_deref())
        .map_err(TrainError::Render)?;
    let [held_back, learned] = assets.split(hold_back);
    let bar = report.bar("rendering flights", missing.len() as u64);
    let rendered = parallel::map(missing, |index| {
        if interrupt::requested() {
            return Ok(());
        }
        let assets = if is_held_back(index, hold_back) { &held_back } else { &learned };
        let mut flight_of = RenderedFlight::new(assets, &settings, seed, index as u64);
        let rate = Random::stream(seed, index as u64).below(RATE_FACTORS.len());
        write(&mut flight_of, &settings, RATE_FACTORS.start + rate, &flight(folder, index))?;
        bar.inc(1);
        Ok(())
    });
    bar.finish_and_clear();
    rendered.into_iter().collect()
}

/// Refuses a folder with flights of other settings; writes down those of an empty one.
fn same_settings(folder: &Path, settings: &str) -> Result<(), Error> {
    let path = folder.join("settings.json");
    if fs::read_to_string(&path).is_ok_and(|known| known == settings) {
        return Ok(());
    }
    if fs::read_dir(folder).map_err(Error::read(folder))?.next().is_some() {
        return Err(TrainError::OtherFlights { path: folder.into() }.into());
    }
    fs::write(&path, settings).map_err(Error::write(&path))
}

/// The folder of a flight.
fn flight(folder: &Path, index: usize) -> PathBuf {
    folder.join(format!("flight_{index:04}"))
}

/// Renders a flight and writes it as a clip: whole, or not there.
fn write(
    flight: &mut RenderedFlight<'_>,
    settings: &RenderSettings,
    rate_factor: usize,
    path: &Path,
) -> Result<(), Error> {
    let partial = path.with_extension("partial");
    if partial.is_dir() {
        fs::remove_dir_all(&partial).map_err(Error::write(&partial))?;
    }
    fs::create_dir(&partial).map_err(Error::write(&partial))?;
    let [width, height] = settings.size;
    let (focal, _) = flight.optics();
    let camera = serde_json::json!({
        "width": width, "height": height, "fps": settings.fps, "fx": focal, "fy": focal,
        "cx": (width as f64 - 1.0) / 2.0, "cy": (height as f64 - 1.0) / 2.0, "spans_m": flight.spans(),
    });
    let mut encoder = GreyEncoder::start(&partial.join("video.mp4"), settings, rate_factor)?;
    let mut boxes = String::new();
    let mut truths = String::from(
        "frame,time_s,yaw_rad,pitch_rad,roll_rad,id,azimuth_rad,elevation_rad,range_m,time_to_contact_s\n",
    );
    let mut frame = Frame::default();
    let mut number = 0;
    while let Some(truth) = flight.next_frame(&mut frame) {
        number += 1;
        encoder.add(&frame.pixels)?;
        lines(number, settings.fps, &truth, &mut boxes, &mut truths);
    }
    encoder.finish()?;
    for (name, text) in
        [("gt.txt", boxes), ("truth.csv", truths), ("camera.json", format!("{camera}\n"))]
    {
        let path = partial.join(name);
        fs::write(&path, text).map_err(Error::write(&path))?;
    }
    fs::rename(&partial, path).map_err(Error::write(path))
}

/// Adds the lines of a frame to `gt.txt` and `truth.csv`.
fn lines(number: u64, fps: u32, truth: &RenderedTruth, boxes: &mut String, truths: &mut String) {
    truth.boxes.iter().for_each(|b| *boxes += &b.rounded_line(number));
    // A String takes all that is written to it.
    let [yaw, pitch, roll] = truth.attitude;
    let time = (number - 1) as f64 / f64::from(fps);
    let camera = format!("{number},{time:.4},{yaw:.6},{pitch:.6},{roll:.6}");
    if truth.targets.is_empty() {
        let _ = writeln!(truths, "{camera},,,,,");
    }
    for t in &truth.targets {
        let contact =
            t.time_to_contact.map_or_else(|| "nan".to_string(), |seconds| format!("{seconds:.3}"));
        let _ = writeln!(
            truths,
            "{camera},{},{:.6},{:.6},{:.3},{contact}",
            t.id, t.azimuth, t.elevation, t.range
        );
    }
}

/// An `ffmpeg` process that encodes grey frames to H.264.
struct GreyEncoder {
    child: Child,
    path: PathBuf,
}

impl GreyEncoder {
    fn start(path: &Path, settings: &RenderSettings, rate_factor: usize) -> Result<Self, Error> {
        let [width, height] = settings.size;
        let mut output = OsString::from("file:");
        output.push(path);
        let child = Command::new("ffmpeg")
            .args(["-nostdin", "-v", "error", "-f", "rawvideo", "-pix_fmt", "gray"])
            .args(["-s", &format!("{width}x{height}"), "-r", &settings.fps.to_string(), "-i", "-"])
            .args(["-c:v", "libx264", "-preset", "veryfast", "-threads", "1"])
            .args(["-crf", &rate_factor.to_string(), "-pix_fmt", "yuv420p"])
            .arg(output)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .spawn();
        let child = child.map_err(|error| PictureError::Encoder {
            path: path.into(),
            reason: format!("ffmpeg cannot be started: {error}; install it with libx264"),
        })?;
        Ok(Self { child, path: path.into() })
    }

    fn add(&mut self, pixels: &[u8]) -> Result<(), Error> {
        let Some(stdin) = &mut self.child.stdin else { return Ok(()) };
        stdin.write_all(pixels).map_err(Error::write(&self.path))
    }

    fn finish(mut self) -> Result<(), Error> {
        drop(self.child.stdin.take());
        let path = self.path.clone();
        let status = self.child.wait().map_err(Error::write(&path))?;
        if status.success() {
            return Ok(());
        }
        let reason = format!("ffmpeg ended with {status}; it has to know libx264");
        Err(PictureError::Encoder { path: self.path.clone(), reason }.into())
    }
}

impl Drop for GreyEncoder {
    fn drop(&mut self) {
        // Both fail only when the process has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shell::formats::clips::TruthBox;
    use crate::shell::formats::truth;
    use crate::shell::render::RenderedTarget;

    #[test]
    fn flights_of_other_settings_are_not_mixed() {
        let folder = tempfile::tempdir().unwrap();
        same_settings(folder.path(), "{\"seed\":1}\n").unwrap();
        same_settings(folder.path(), "{\"seed\":1}\n").unwrap();
        let error = same_settings(folder.path(), "{\"seed\":2}\n").unwrap_err().to_string();
        assert!(error.contains("flights of other settings; remove the folder"), "{error}");
        // Without the settings nobody knows of which settings flights are.
        fs::remove_file(folder.path().join("settings.json")).unwrap();
        fs::create_dir(flight(folder.path(), 3)).unwrap();
        assert!(same_settings(folder.path(), "{\"seed\":1}\n").is_err());
    }

    #[test]
    fn truth_is_written_as_it_is_read() {
        let target = |id| RenderedTarget {
            id,
            azimuth: 0.25,
            elevation: -0.5,
            range: 40.0,
            time_to_contact: None,
        };
        let mut frame = RenderedTruth {
            attitude: [0.1, 0.2, 0.3],
            targets: [target(1), RenderedTarget { time_to_contact: Some(2.5), ..target(2) }].into(),
            ..RenderedTruth::default()
        };
        let seen = TruthBox {
            id: 2,
            left: 1.25,
            top: 2.5,
            width: 12.0,
            height: 6.0,
            class: crate::shell::formats::class::Class::Airplane,
            visibility: 0.5,
        };
        frame.boxes.push(seen);
        let (mut boxes, mut truths) = (String::new(), String::from("header\n"));
        lines(7, 30, &frame, &mut boxes, &mut truths);
        lines(8, 30, &RenderedTruth::default(), &mut boxes, &mut truths);
        let read = clips::GroundTruth::parse(&boxes, Path::new("gt.txt")).unwrap();
        assert_eq!(read.frame(7), [seen]);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("truth.csv");
        fs::write(&path, truths).unwrap();
        let read = truth::read(&path).unwrap();
        assert_eq!(read[&7].attitude, [0.3, 0.2, 0.1], "roll, pitch, yaw");
        assert_eq!(read[&7].targets[1].time_to_contact, Some(2.5));
        assert_eq!((read[&7].targets.len(), read[&8].targets.len()), (2, 0));
    }
}
