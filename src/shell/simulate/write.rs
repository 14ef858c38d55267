//! `lookout simulate`: a flight as files, in the form of the recorded ones.

use super::files::{
    FlightFile, Lines, SimulateError, TRUTH_HEADER, failed, png, progress_bar, write,
};
use super::rendered::{self, RenderedFlightArgs};
use super::{FlightTelemetry, START_US, SimulateSettings, SimulatedTruth, Simulator};
use crate::shell::formats::tlog;
use crate::shell::sources::Frame;
use std::format;
use std::fs;
use std::path::PathBuf;
use std::string::String;
use std::vec::Vec;

/// Renders a flight through a procedural world: frames/, gt.txt, truth.csv, camera.json as in the recorded ones, and
/// flight.tlog, the vehicle's telemetry. With --backgrounds, flights over photographs of your own, for training
#[derive(Debug, Clone, clap::Args)]
#[command(mut_arg("kind", |kind| kind.conflicts_with("backgrounds")))]
pub struct SimulateArgs {
    /// New or empty folder for the flight; with --backgrounds for a folder of each flight
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Length, size and seed
    #[command(flatten)]
    pub settings: SimulateSettings,
    /// Flights over photographs
    #[command(flatten)]
    pub render: RenderedFlightArgs,
}

/// Renders the flight and writes it frame by frame; after an error the frames before it are complete.
///
/// # Errors
/// [`SimulateError`] when the folder holds something already or cannot be written.
pub fn run(args: &SimulateArgs) -> Result<(), SimulateError> {
    fs::create_dir_all(&args.out).map_err(failed(&args.out))?;
    let mut entries = fs::read_dir(&args.out).map_err(failed(&args.out))?;
    if entries.next().is_some() {
        return Err(SimulateError::NotEmpty { path: args.out.clone() });
    }
    if let Some(backgrounds) = &args.render.backgrounds {
        return rendered::run(&args.out, &args.settings, &args.render, backgrounds);
    }
    let frames = args.out.join("frames");
    fs::create_dir(&frames).map_err(failed(&frames))?;
    let mut simulator = Simulator::new(&args.settings);
    write(&args.out.join("camera.json"), camera_file(&simulator).as_bytes())?;
    let mut boxes = Lines::create(args.out.join("gt.txt"))?;
    let mut truths = Lines::create(args.out.join("truth.csv"))?;
    truths.add(TRUTH_HEADER)?;
    let progress = progress_bar(args.settings.frames()).with_message("frames");
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

#[allow(clippy::expect_used, reason = "numbers and words always make JSON")]
fn camera_file(simulator: &Simulator) -> String {
    let file = FlightFile {
        camera: simulator.camera(),
        fps: simulator.settings().fps,
        spans_m: simulator.spans(),
        k1: None,
    };
    serde_json::to_string(&file).expect("numbers and words always make JSON") + "\n"
}

/// The bytes of `flight.tlog`; its first message comes with the first frame.
#[allow(clippy::expect_used, reason = "memory takes every frame the simulator makes")]
fn telemetry(settings: &SimulateSettings) -> Vec<u8> {
    let mut log = Vec::new();
    for (time_us, frame) in FlightTelemetry::of(settings) {
        let time_us = START_US.saturating_add(time_us);
        tlog::write(&mut log, time_us, frame.raw_bytes())
            .expect("memory takes every frame the simulator makes");
    }
    log
}

/// The line of `gt.txt`; empty when nothing is seen.
fn box_line(frame: u64, truth: &SimulatedTruth) -> String {
    let seen = truth.target.and_then(|target| target.seen);
    seen.map_or_else(String::new, |seen| seen.line(frame))
}

/// The line of `truth.csv`.
fn truth_line(frame: u64, fps: u32, truth: &SimulatedTruth) -> String {
    let time = (frame - 1) as f64 / f64::from(fps);
    let SimulatedTruth { yaw, pitch, roll, .. } = truth;
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
