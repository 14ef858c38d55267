//! Examination of a source: size, rate, jitter and one picture, or the reason for a failure.

use super::{DoctorError, Finding, Mark};
use crate::shell::error::Error;
use crate::shell::live::config::ServiceConfig;
use crate::shell::live::image_health::ImageHealth;
use crate::shell::live::source::{self, LiveError};
use crate::shell::live::source_setting::SourceSetting;
use crate::shell::sources::Frame;
use crate::shell::support::file_error::FileError;
use crate::shell::support::interrupt;
use crate::shell::support::print::print_line;
use image::GrayImage;
use std::format;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::sync::Arc;
use std::time::{Duration, Instant};
use std::vec::Vec;

/// Timeout of one call for a frame.
const SLICE: Duration = Duration::from_millis(100);
/// Timeout of the first frame: a stream gives up after 15 s.
const FIRST_FRAME: Duration = Duration::from_secs(20);
/// Columns of the picture in characters.
const COLUMNS: usize = 72;
/// Characters from dark to bright.
const RAMP: &[u8] = b" .:-=+*#%@";

/// The source to look at.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Source")]
pub struct SourceArgs {
    /// Examine a source (v4l2:DEVICE, rtsp://HOST/PATH, file:PATH): size, rate, jitter and a picture
    #[arg(long, value_name = "SOURCE")]
    source: Option<SourceSetting>,
    /// The same for the source in these settings of `lookout run`
    #[arg(long, value_name = "FILE", conflicts_with = "source")]
    config: Option<PathBuf>,
    /// Write the last picture as PNG
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
}

/// Looks at the source, if one is named, for `seconds` after its first frame; gives the number of what is missing.
///
/// # Errors
/// [`DoctorError::NoPicture`] with the reason, [`FileError::Write`], those of the settings.
pub fn examine(args: &SourceArgs, seconds: u32) -> Result<usize, Error> {
    let config = match (&args.source, &args.config) {
        (_, Some(path)) => ServiceConfig::read(path)?,
        (Some(source), None) => settings_of(source)?,
        (None, None) => return Ok(0),
    };
    let name = config.source.to_string();
    let (watched, frame) = watch(&config, Duration::from_secs(seconds.into()))
        .map_err(|reason| DoctorError::NoPicture { name: name.clone(), reason })?;
    print_line(&format!("source {name}, {seconds} s"))?;
    let findings = watched.findings(&config, &frame);
    for finding in &findings {
        super::print_finding(finding)?;
    }
    for line in in_characters(&frame) {
        print_line(&line)?;
    }
    if let Some(path) = &args.picture {
        save(path, &frame)?;
        print_line(&format!("the picture is in {}", path.display()))?;
    }
    Ok(findings.iter().filter(|finding| finding.mark == Mark::Missing).count())
}

/// A source without settings: the size is that of a network stream itself, and 640x480 of a camera.
fn settings_of(source: &SourceSetting) -> Result<ServiceConfig, Error> {
    let mut text = String::from("source = 'simulate:none'\nstream.latency_ms = 0\n");
    if matches!(source, SourceSetting::Address(_)) {
        text += "camera.width = 4096\ncamera.height = 4096\n";
    }
    let mut config = ServiceConfig::parse(Path::new("--source"), &text)?;
    config.source = source.clone();
    Ok(config)
}

/// Measured properties of a source.
#[derive(Debug, Default)]
struct Watched {
    frames: u32,
    lost: u32,
    passed_over: u32,
    /// Times from one frame to the next, microseconds.
    intervals: Vec<i64>,
    blind: crate::mavlink::messages::Blind,
}

fn watch(config: &ServiceConfig, span: Duration) -> Result<(Watched, Arc<Frame>), LiveError> {
    // Nobody hears what a simulated vehicle says.
    let (heard, _) = crossbeam_channel::bounded(1);
    let mut live = source::open(config, &heard)?;
    let mut watched = Watched::default();
    let mut sight = ImageHealth::default();
    let mut newest: Option<Arc<Frame>> = None;
    let mut start = Instant::now();
    loop {
        let limit = if newest.is_some() { span } else { FIRST_FRAME };
        if start.elapsed() > limit || interrupt::requested() {
            break;
        }
        let mut frame = Frame::default();
        match live.next(&mut frame, SLICE) {
            Ok(taken) => {
                watched.frames += 1;
                match &newest {
                    Some(before) => {
                        watched.lost += taken.missed;
                        watched.passed_over += taken.passed_over;
                        watched.intervals.push(frame.time_us - before.time_us);
                    }
                    // Frames that arrived while it was opened are not counted.
                    None => start = Instant::now(),
                }
                let frame = Arc::new(frame);
                watched.blind = sight.assess(&frame);
                newest = Some(frame);
            }
            Err(LiveError::Timeout) => {}
            // A short recording is one, too.
            Err(LiveError::Ended) if newest.is_some() => break,
            Err(error) => return Err(error),
        }
    }
    newest.map(|frame| (watched, frame)).ok_or(LiveError::Timeout)
}

impl Watched {
    fn findings(&self, config: &ServiceConfig, frame: &Frame) -> Vec<Finding> {
        let mut findings = Vec::new();
        let mut add = |mark, text| findings.push(Finding { mark, text });
        let span_us: i64 = self.intervals.iter().sum();
        let (width, height) = (frame.width, frame.height);
        if span_us <= 0 {
            add(Mark::Missing, format!("{width}x{height}, a single frame: too few to see motion"));
            return findings;
        }
        let count = self.intervals.len() as f64;
        let rate = (count + f64::from(self.passed_over)) * 1e6 / span_us as f64;
        let mean = span_us as f64 / count;
        let squares: f64 = self.intervals.iter().map(|&us| (us as f64 - mean).powi(2)).sum();
        let jitter_ms = (squares / count).sqrt() / 1000.0;
        let longest_ms = self.intervals.iter().max().map_or(0, |us| us / 1000);
        // A track needs a few frames a second, times to contact more.
        let mark = if rate < 5.0 { Mark::Missing } else { Mark::Good };
        add(
            mark,
            format!(
                "{width}x{height}, {rate:.1} frames a second, {:.1} ms apart with a jitter of {jitter_ms:.1} ms (standard \
                 deviation), the longest gap {longest_ms} ms",
                mean / 1000.0
            ),
        );
        if rate < 10.0 {
            let text = "fewer than 10 frames a second: motion between frames is large, and times to contact are rough";
            add(Mark::Note, text.into());
        }
        if self.lost > 0 {
            add(Mark::Note, format!("{} frames were lost on the way", self.lost));
        }
        let mean: u64 = frame.pixels.iter().map(|&pixel| u64::from(pixel)).sum();
        let mean = mean / frame.pixels.len().max(1) as u64;
        let reasons: Vec<_> = self.blind.reasons().collect();
        match reasons.as_slice() {
            [] => add(Mark::Good, format!("mean brightness {mean} of 255")),
            reasons => add(
                Mark::Missing,
                format!(
                    "nothing can be seen: {}; mean brightness {mean} of 255",
                    reasons.join(", ")
                ),
            ),
        }
        if config.source.is_stream() {
            let text = format!(
                "{} ms from exposure to arrival are assumed (stream.latency_ms); only a filmed clock can check that",
                config.stream.latency_ms.unwrap_or(0)
            );
            add(Mark::Note, text);
        }
        match config.camera((width, height), None) {
            Ok(_) if config.camera.calibration.is_some() => {
                add(Mark::Good, "the calibration fits this size".into());
            }
            Ok(_) => {}
            Err(error) => add(Mark::Missing, error.to_string()),
        }
        findings
    }
}

/// The picture in characters, for who has no screen but a terminal: one for the mean of a block twice as high as wide.
#[allow(clippy::indexing_slicing, reason = "blocks of a frame whose size was checked")]
fn in_characters(frame: &Frame) -> Vec<String> {
    let columns = COLUMNS.min(frame.width);
    let rows = (frame.height * columns / frame.width / 2).clamp(1, frame.height);
    let block = |row: usize, column: usize| {
        let (x, next) = (column * frame.width / columns, (column + 1) * frame.width / columns);
        let (y, below) = (row * frame.height / rows, (row + 1) * frame.height / rows);
        let pixels =
            (y..below).flat_map(|y| &frame.pixels[y * frame.width + x..y * frame.width + next]);
        let (sum, count) =
            pixels.fold((0, 0), |(sum, count), &pixel| (sum + usize::from(pixel), count + 1));
        char::from(RAMP[sum * RAMP.len() / (256 * count.max(1))])
    };
    (0..rows).map(|row| (0..columns).map(|column| block(row, column)).collect()).collect()
}

fn save(path: &Path, frame: &Frame) -> Result<(), FileError> {
    let (width, height) = frame.size();
    let picture = GrayImage::from_raw(width, height, frame.pixels.clone()).unwrap_or_default();
    let failed = |source: image::ImageError| FileError::write(path)(std::io::Error::other(source));
    picture.save_with_format(path, image::ImageFormat::Png).map_err(failed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_in_characters() {
        let mut frame =
            Frame { pixels: std::vec![255; 144 * 8], width: 144, height: 8, time_us: 0 };
        frame.pixels[..144 * 4].fill(0);
        assert_eq!(in_characters(&frame), [" ".repeat(72), "@".repeat(72)]);
        let tiny = Frame { pixels: std::vec![128; 3], width: 3, height: 1, time_us: 0 };
        assert_eq!(in_characters(&tiny), ["+++"]);
    }

    #[test]
    fn rate_and_jitter_are_those_of_the_frames() {
        let watched = Watched {
            frames: 4,
            passed_over: 1,
            lost: 2,
            intervals: std::vec![40_000, 60_000, 100_000],
            ..Watched::default()
        };
        let source = SourceSetting::Program { words: ["cam".into()].into(), raw: None };
        let config = settings_of(&source).unwrap();
        let frame = Frame { pixels: std::vec![100; 12], width: 4, height: 3, time_us: 0 };
        let findings = watched.findings(&config, &frame);
        let text: Vec<&str> = findings.iter().map(|finding| finding.text.as_str()).collect();
        assert_eq!(
            text[0],
            "4x3, 20.0 frames a second, 66.7 ms apart with a jitter of 24.9 ms (standard deviation), the longest gap 100 ms"
        );
        assert!(
            text[1].starts_with("2 frames were lost") && text[2] == "mean brightness 100 of 255"
        );
        assert!(text[3].contains("stream.latency_ms"), "{text:?}");
        let single = Watched { frames: 1, ..Watched::default() };
        assert_eq!(single.findings(&config, &frame)[0].mark, Mark::Missing);
    }

    #[test]
    fn a_simulated_source_is_seen_and_a_missing_one_explained() {
        let config = settings_of(&"simulate:hover".parse().unwrap()).unwrap();
        let (watched, frame) = watch(&config, Duration::from_millis(500)).unwrap();
        assert!(watched.frames >= 2 && (frame.width, frame.height) == (640, 480));
        let config = settings_of(&"file:/nowhere.mp4".parse().unwrap()).unwrap();
        let error = watch(&config, Duration::from_secs(1)).unwrap_err().to_string();
        assert!(error.starts_with("/nowhere.mp4: cannot open"), "{error}");
    }
}
