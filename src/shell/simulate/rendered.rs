//! `lookout simulate --backgrounds`: flights over given photographs as files, in the form of the recorded ones.

use super::SimulateSettings;
use super::files::{
    FlightFile, Lines, SimulateError, TRUTH_HEADER, failed, png, progress_bar, write,
};
use crate::shell::formats::camera_file::CameraFile;
use crate::shell::formats::class::Class;
use crate::shell::render::{Assets, RenderSettings, RenderedFlight, RenderedTruth};
use crate::shell::sources::Frame;
use crate::shell::support::parallel;
use image::{Rgb, RgbImage};
use std::format;
use std::fs;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::string::{String, ToString};
use std::vec::Vec;

/// Frames of a flight on the contact sheet.
const SHOWN: u64 = 5;
/// Most flights on the contact sheet.
const SHEET_FLIGHTS: u64 = 40;
/// Frame pixels for one of the contact sheet, each way.
const SHRINK: usize = 2;

/// Options of flights over given photographs.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Flights before pictures")]
pub struct RenderedFlightArgs {
    /// Photographs and panoramas (2:1) for backgrounds, JPEG or PNG, in any folders below; index.csv may give their kinds
    #[arg(long, value_name = "DIR")]
    pub backgrounds: Option<PathBuf>,
    /// Clips with ground truth to cut targets and birds out of; can be given several times
    #[arg(long, value_name = "SPLIT", requires = "backgrounds")]
    pub cutouts: Vec<PathBuf>,
    /// OBJ models of aircraft (x forward, y left, z up) that are rendered as targets
    #[arg(long, value_name = "DIR", requires = "backgrounds")]
    pub shapes: Option<PathBuf>,
    /// Ranges that flights are drawn from, TOML; src/shell/render/default.toml documents them and holds the defaults
    #[arg(long = "settings", value_name = "FILE", requires = "backgrounds")]
    pub settings_file: Option<PathBuf>,
    /// Number of flights
    #[arg(long, value_name = "N", default_value_t = 1, requires = "backgrounds", value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub flights: u64,
    /// Flights without targets: every detection except of birds is a false alarm
    #[arg(long, requires = "backgrounds")]
    pub empty: bool,
    /// frames/ of PNG pictures, the same bytes on every machine, instead of video.mp4 (H.264 by ffmpeg)
    #[arg(long, requires = "backgrounds")]
    pub png: bool,
    /// Also a picture of five frames of each of the first 40 flights, with the boxes
    #[arg(long, value_name = "FILE.png", requires = "backgrounds")]
    pub sheet: Option<PathBuf>,
}

/// Renders the flights, in parallel, and writes each into a folder of its own; `flights.csv` lists them.
pub(super) fn run(
    out: &Path,
    options: &SimulateSettings,
    render: &RenderedFlightArgs,
    backgrounds: &Path,
) -> Result<(), SimulateError> {
    let settings = settings(options, render)?;
    let assets = Assets::load(backgrounds, &render.cutouts, render.shapes.as_deref())?;
    let progress = progress_bar(render.flights).with_message("flights");
    let flights = parallel::map((0..render.flights).collect(), |index| {
        let numbers = [options.seed, index];
        let written = write_flight(out, render, &assets, &settings, numbers);
        progress.inc(1);
        written
    });
    progress.finish_and_clear();
    let mut list = Lines::create(out.join("flights.csv"))?;
    list.add("flight,kind,frames,boxes,description\n")?;
    let mut sheet = Vec::new();
    for flight in flights {
        let (line, shown) = flight?;
        list.add(&line)?;
        sheet.extend(shown);
    }
    if let Some(path) = &render.sheet {
        let (width, height) = (settings.size[0] / SHRINK, settings.size[1] / SHRINK);
        let rows = sheet.len().div_ceil(SHOWN as usize);
        let mut picture = RgbImage::new((width * SHOWN as usize) as u32, (height * rows) as u32);
        for (i, frame) in sheet.iter().enumerate() {
            let (column, row) = (i % SHOWN as usize, i / SHOWN as usize);
            let (x, y) = ((column * width) as i64, (row * height) as i64);
            image::imageops::replace(&mut picture, frame, x, y);
        }
        let failed = |e| SimulateError::Write { path: path.clone(), source: io::Error::other(e) };
        picture.save_with_format(path, image::ImageFormat::Png).map_err(failed)?;
    }
    Ok(())
}

/// The settings of the file with size, rate and length of the options.
fn settings(
    options: &SimulateSettings,
    render: &RenderedFlightArgs,
) -> Result<RenderSettings, SimulateError> {
    let mut settings = RenderSettings::default();
    let mut path = PathBuf::from("--width, --height, --fps, --seconds");
    if let Some(file) = &render.settings_file {
        let text = fs::read_to_string(file)
            .map_err(|source| SimulateError::Read { path: file.clone(), source })?;
        let wrong = |source| SimulateError::Settings { path: file.clone(), source };
        settings = RenderSettings::parse(&text).map_err(wrong)?;
        path = file.clone();
    }
    settings.size = [options.width as usize, options.height as usize];
    settings.fps = options.fps;
    settings.frames = options.frames();
    if render.empty {
        settings.targets.kinds = [0.0, 0.0, 0.0, 0.0, 1.0];
        settings.targets.more_probability = 0.0;
    }
    settings.check().map_err(|source| SimulateError::Settings { path, source })?;
    Ok(settings)
}

/// Writes one flight; returns its line of `flights.csv` and its frames on the contact sheet.
fn write_flight(
    out: &Path,
    render: &RenderedFlightArgs,
    assets: &Assets,
    settings: &RenderSettings,
    [seed, index]: [u64; 2],
) -> Result<(String, Vec<RgbImage>), SimulateError> {
    let name = format!("flight_{index:03}");
    let folder = out.join(&name);
    fs::create_dir(&folder).map_err(failed(&folder))?;
    let mut flight = RenderedFlight::new(assets, settings, seed, index);
    let mut output = if render.png {
        Output::Pictures(folder.join("frames"))
    } else {
        // The encoder's own compression takes the place of the rendered one.
        let quality = flight.without_compression();
        Output::Video(FlightEncoder::start(folder.join("video.mp4"), settings, quality)?)
    };
    if let Output::Pictures(frames) = &output {
        fs::create_dir(frames).map_err(failed(frames))?;
    }
    let camera = camera_file(&flight, settings);
    write(&folder.join("camera.json"), camera.as_bytes())?;
    let mut boxes = Lines::create(folder.join("gt.txt"))?;
    let mut truths = Lines::create(folder.join("truth.csv"))?;
    truths.add(TRUTH_HEADER)?;
    let (mut frame, mut shown) = (Frame::default(), Vec::new());
    let (mut number, mut count) = (0, 0);
    let on_sheet = render.sheet.is_some() && index < SHEET_FLIGHTS;
    let every = settings.frames.div_ceil(SHOWN);
    while let Some(truth) = flight.next_frame(&mut frame) {
        number += 1;
        match &mut output {
            Output::Pictures(frames) => {
                let path = frames.join(format!("{number:06}.png"));
                write(&path, &png(&frame).map_err(failed(&path))?)?;
            }
            Output::Video(encoder) => encoder.write(&frame)?,
        }
        count += truth.boxes.len();
        boxes.add(&box_lines(number, &truth))?;
        truths.add(&truth_lines(number, settings.fps, &truth))?;
        if on_sheet && (number - 1).is_multiple_of(every) {
            shown.push(small(&frame, &truth));
        }
    }
    if let Output::Video(encoder) = output {
        encoder.finish()?;
    }
    let line = format!("{name},{},{number},{count},{}\n", flight.kind().name(), flight.describe());
    if on_sheet {
        // Rows of the sheet stay whole for flights of few frames.
        shown.resize_with(SHOWN as usize, || RgbImage::new(1, 1));
    }
    Ok((line, shown))
}

#[allow(clippy::expect_used, reason = "numbers and words always make JSON")]
fn camera_file(flight: &RenderedFlight<'_>, settings: &RenderSettings) -> String {
    let (focal, k1) = flight.optics();
    let [width, height] = settings.size;
    let middle = |side: usize| side as f64 / 2.0 - 0.5;
    let camera = CameraFile {
        width: width as u32,
        height: height as u32,
        fx: focal,
        fy: focal,
        cx: middle(width),
        cy: middle(height),
        kind: Some(flight.kind().name().into()),
    };
    let file = FlightFile { camera, fps: settings.fps, spans_m: flight.spans(), k1: Some(k1) };
    serde_json::to_string(&file).expect("numbers and words always make JSON") + "\n"
}

/// The lines of `gt.txt`.
fn box_lines(frame: u64, truth: &RenderedTruth) -> String {
    truth.boxes.iter().map(|seen| seen.line(frame)).collect()
}

/// The lines of `truth.csv`: one for each target, one without any.
fn truth_lines(frame: u64, fps: u32, truth: &RenderedTruth) -> String {
    let time = (frame - 1) as f64 / f64::from(fps);
    let [yaw, pitch, roll] = truth.attitude;
    let camera = format!("{frame},{time:.4},{yaw:.6},{pitch:.6},{roll:.6}");
    if truth.targets.is_empty() {
        return format!("{camera},,,,,\n");
    }
    let line = |target: &crate::shell::render::RenderedTarget| {
        let contact = target.time_to_contact.map_or_else(|| "nan".into(), |s| format!("{s:.3}"));
        format!(
            "{camera},{},{:.6},{:.6},{:.3},{contact}\n",
            target.id, target.azimuth, target.elevation, target.range
        )
    };
    truth.targets.iter().map(line).collect()
}

/// A frame of the contact sheet: reduced, with boxes; targets red, birds yellow, ignored objects blue.
fn small(frame: &Frame, truth: &RenderedTruth) -> RgbImage {
    let (width, height) = (frame.width / SHRINK, frame.height / SHRINK);
    let grey = |x: usize, y: usize| {
        let at = |i: usize| {
            u32::from(
                frame.pixels[(y * SHRINK + i / SHRINK) * frame.width + x * SHRINK + i % SHRINK],
            )
        };
        ((0..SHRINK * SHRINK).map(at).sum::<u32>() / (SHRINK * SHRINK) as u32) as u8
    };
    let mut picture = RgbImage::from_fn(width as u32, height as u32, |x, y| {
        Rgb([grey(x as usize, y as usize); 3])
    });
    for b in &truth.boxes {
        let colour = match (b.class, b.visibility < 1.0) {
            (Class::Bird, _) => [255, 220, 0],
            (_, true) => [80, 120, 255],
            _ => [255, 0, 0],
        };
        let edge = |v: f64, end: usize| (v / SHRINK as f64).clamp(0.0, end as f64 - 1.0) as u32;
        let (left, right) = (edge(b.left - 3.0, width), edge(b.left + b.width + 2.0, width));
        let (top, bottom) = (edge(b.top - 3.0, height), edge(b.top + b.height + 2.0, height));
        for x in left..=right {
            picture.put_pixel(x, top, Rgb(colour));
            picture.put_pixel(x, bottom, Rgb(colour));
        }
        for y in top..=bottom {
            picture.put_pixel(left, y, Rgb(colour));
            picture.put_pixel(right, y, Rgb(colour));
        }
    }
    picture
}

/// Output of a flight's frames.
enum Output {
    Pictures(PathBuf),
    Video(FlightEncoder),
}

/// A running `ffmpeg` that encodes H.264.
struct FlightEncoder {
    path: PathBuf,
    child: Child,
}

impl FlightEncoder {
    /// Starts it with a constant rate factor.
    fn start(
        path: PathBuf,
        settings: &RenderSettings,
        quality: u32,
    ) -> Result<Self, SimulateError> {
        let [width, height] = settings.size;
        let child = Command::new("ffmpeg")
            .args(["-v", "error", "-nostdin", "-y", "-f", "rawvideo", "-pix_fmt", "gray"])
            .args(["-video_size", &format!("{width}x{height}")])
            .args(["-framerate", &settings.fps.to_string(), "-i", "-"])
            .args(["-c:v", "libx264", "-threads", "1", "-crf", &quality.to_string()])
            .args(["-pix_fmt", "yuv420p"])
            .arg(Path::new(".").join(&path))
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn();
        let reason = |e: io::Error| format!("ffmpeg cannot be started: {e}");
        child
            .map(|child| Self { path: path.clone(), child })
            .map_err(|e| SimulateError::Encoder { path, reason: reason(e) })
    }

    #[allow(clippy::expect_used, reason = "it is piped")]
    fn write(&mut self, frame: &Frame) -> Result<(), SimulateError> {
        let input = self.child.stdin.as_mut().expect("it is piped");
        if let Err(error) = input.write_all(&frame.pixels) {
            return Err(self.failure(error.to_string()));
        }
        Ok(())
    }

    fn finish(mut self) -> Result<(), SimulateError> {
        drop(self.child.stdin.take());
        match self.child.wait() {
            Ok(status) if status.success() => Ok(()),
            Ok(status) => Err(self.failure(status.to_string())),
            Err(error) => Err(self.failure(error.to_string())),
        }
    }

    /// The first line that ffmpeg has written, else `otherwise`.
    fn failure(&mut self, otherwise: String) -> SimulateError {
        let mut words = String::new();
        if let Some(mut stderr) = self.child.stderr.take() {
            // The readable part is enough.
            let _ = stderr.read_to_string(&mut words);
        }
        let line = words.lines().find(|line| !line.trim().is_empty());
        let reason = line.map_or(otherwise, ToString::to_string);
        SimulateError::Encoder { path: self.path.clone(), reason: format!("ffmpeg: {reason}") }
    }
}

impl Drop for FlightEncoder {
    fn drop(&mut self) {
        drop(self.child.stdin.take());
        // Both fail only when it has ended already.
        let _ = self.child.wait();
    }
}
