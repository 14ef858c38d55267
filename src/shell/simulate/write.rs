//! `lookout simulate`: a flight as files, in the form of the recorded ones.

use super::{START_US, SimulateSettings, Simulator, Telemetry, Truth};
use crate::shell::formats::camera_file::CameraFile;
use crate::shell::formats::tlog;
use crate::shell::sources::Frame;
use image::ImageEncoder;
use image::codecs::png::PngEncoder;
use indicatif::{ProgressBar, ProgressStyle};
use std::format;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::string::String;
use std::vec::Vec;

/// Renders a flight: frames/, gt.txt, truth.csv, camera.json as in the recorded ones, and flight.tlog, the vehicle's telemetry
#[derive(Debug, Clone, clap::Args)]
pub struct SimulateArgs {
    /// New or empty folder for the flight
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Which flight
    #[command(flatten)]
    pub settings: SimulateSettings,
}

/// Why a flight cannot be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SimulateError {
    /// The system failed while writing.
    #[error("{}: cannot be written: {source}; what is complete before it stays usable", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Something is there already.
    #[error("{}: not empty; give a new folder, or remove what is in it", path.display())]
    NotEmpty {
        /// The folder.
        path: PathBuf,
    },
}

/// What `camera.json` says.
#[derive(serde::Serialize)]
struct FlightFile {
    #[serde(flatten)]
    camera: CameraFile,
    fps: u32,
    spans_m: Vec<f64>,
}

/// Renders the flight and writes it frame by frame; what is written stays complete up to an error.
///
/// # Errors
/// [`SimulateError`] when the folder holds something already or cannot be written.
pub fn run(args: &SimulateArgs) -> Result<(), SimulateError> {
    let frames = args.out.join("frames");
    fs::create_dir_all(&args.out).map_err(failed(&args.out))?;
    let mut entries = fs::read_dir(&args.out).map_err(failed(&args.out))?;
    if entries.next().is_some() {
        return Err(SimulateError::NotEmpty { path: args.out.clone() });
    }
    fs::create_dir(&frames).map_err(failed(&frames))?;
    let mut simulator = Simulator::new(&args.settings);
    write(&args.out.join("camera.json"), camera_file(&simulator).as_bytes())?;
    let mut boxes = Lines::create(args.out.join("gt.txt"))?;
    let mut truths = Lines::create(args.out.join("truth.csv"))?;
    truths.add(
        "frame,time_s,yaw_rad,pitch_rad,roll_rad,id,azimuth_rad,elevation_rad,range_m,time_to_contact_s\n",
    )?;
    let progress = progress_bar(args.settings.frames());
    write(&args.out.join("flight.tlog"), &telemetry(&args.settings))?;
    let mut frame = Frame::default();
    for index in 0..args.settings.frames() {
        let truth = simulator.render(index, &mut frame);
        let path = frames.join(format!("{:06}.png", index + 1));
        write(&path, &png(&frame).map_err(failed(&path))?)?;
        boxes.add(&box_line(index + 1, &truth))?;
        truths.add(&truth_line(index + 1, args.settings.fps, &truth))?;
        progress.inc(1);
    }
    progress.finish_and_clear();
    Ok(())
}

fn failed(path: &Path) -> impl FnOnce(io::Error) -> SimulateError {
    |source| SimulateError::Write { path: path.into(), source }
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), SimulateError> {
    fs::write(path, bytes).map_err(failed(path))
}

/// A text file that is complete after every line.
struct Lines {
    path: PathBuf,
    file: File,
}

impl Lines {
    fn create(path: PathBuf) -> Result<Self, SimulateError> {
        let file = File::create(&path).map_err(failed(&path))?;
        Ok(Self { path, file })
    }

    fn add(&mut self, text: &str) -> Result<(), SimulateError> {
        self.file.write_all(text.as_bytes()).map_err(failed(&self.path))
    }
}

fn png(frame: &Frame) -> io::Result<Vec<u8>> {
    let (width, height) = (frame.width as u32, frame.height as u32);
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(&frame.pixels, width, height, image::ExtendedColorType::L8)
        .map_err(io::Error::other)?;
    Ok(bytes)
}

fn camera_file(simulator: &Simulator) -> String {
    let file = FlightFile {
        camera: simulator.camera(),
        fps: simulator.settings().fps,
        spans_m: simulator.spans(),
    };
    serde_json::to_string(&file).expect("numbers and words always make JSON") + "\n"
}

/// The bytes of `flight.tlog`; its first message comes with the first frame.
fn telemetry(settings: &SimulateSettings) -> Vec<u8> {
    let mut log = Vec::new();
    for (time_us, frame) in Telemetry::of(settings) {
        let time_us = START_US.saturating_add(time_us);
        tlog::write(&mut log, time_us, frame.raw_bytes())
            .expect("memory takes every frame the simulator makes");
    }
    log
}

/// The line of `gt.txt`; empty when nothing is seen.
fn box_line(frame: u64, truth: &Truth) -> String {
    let seen = truth.target.and_then(|target| target.seen);
    seen.map_or_else(String::new, |seen| {
        format!(
            "{frame},{},{},{},{},{},1,{},{:.1}\n",
            seen.id, seen.left, seen.top, seen.width, seen.height, seen.class, seen.visibility
        )
    })
}

/// The line of `truth.csv`.
fn truth_line(frame: u64, fps: u32, truth: &Truth) -> String {
    let time = (frame - 1) as f64 / f64::from(fps);
    let Truth { yaw, pitch, roll, .. } = truth;
    let camera = format!("{frame},{time:.4},{yaw:.6},{pitch:.6},{roll:.6}");
    truth.target.map_or_else(
        || format!("{camera},,,,,\n"),
        |target| {
            let contact = target
                .time_to_contact
                .map_or_else(|| "nan".into(), |seconds| format!("{seconds:.3}"));
            format!(
                "{camera},1,{:.6},{:.6},{:.3},{contact}\n",
                target.azimuth, target.elevation, target.range
            )
        },
    )
}

fn progress_bar(frames: u64) -> ProgressBar {
    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} frames, {per_sec}, {eta} left");
    ProgressBar::new(frames).with_style(style.expect("the template is a constant"))
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn a_full_disk_is_named() {
        let full = Path::new("/dev/full");
        let error = write(full, b"picture").unwrap_err().to_string();
        assert!(error.starts_with("/dev/full: cannot be written: "), "{error}");
        let mut lines = Lines::create(full.into()).unwrap();
        let error = lines.add("1,1,2,3,4,5\n").unwrap_err().to_string();
        assert!(error.starts_with("/dev/full: cannot be written: "), "{error}");
    }
}
