//! Video files of any kind, decoded by `ffmpeg`.
//!
//! A frame has the time that the file gives it: recordings of browsers, phones and streams have no constant rate. y4m
//! cannot carry times, so `ffmpeg` is made to log them: the filter `metadata=print` writes a line for a frame before the
//! frame leaves the filters.

use super::process::Process;
use super::{Frame, FrameSource, SourceError, Y4m};
use std::borrow::ToOwned;
use std::boxed::Box;
use std::ffi::{OsStr, OsString};
use std::format;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::process::{ChildStdout, Command};
use std::string::String;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;
use std::vec::Vec;

/// Timeout for the line of a frame that was read: it was written before the frame.
const LINE_WAIT: Duration = Duration::from_secs(2);

/// Grey first, so that every format is converted as it was without filters; times in nanoseconds.
const FILTERS: &str = "format=gray,settb=1/1000000000,metadata=add:key=t:value=0,metadata=print";

/// A video decoded by an `ffmpeg` process to full-range grey; the process is ended with the source.
#[derive(Debug)]
pub struct VideoSource {
    path: PathBuf,
    process: Process,
    frames: Y4m<BufReader<ChildStdout>>,
    heard: Arc<Mutex<Heard>>,
    /// Of each frame in nanoseconds; `None` where the file gives none. Taken away when the lines do not come.
    times: Option<Receiver<Option<i64>>>,
    first_ns: Option<i64>,
    last_us: Option<i64>,
    ended: bool,
}

/// Messages of `ffmpeg` on standard error.
#[derive(Debug, Default)]
struct Heard {
    complaints: u64,
    /// Last message.
    last: Option<String>,
    /// The last one that means that a part of the file is missing.
    cut: Option<String>,
}

impl VideoSource {
    /// Starts `ffmpeg` on `path` (a file, or an address that `ffmpeg` understands).
    ///
    /// # Errors
    /// [`SourceError::FfmpegMissing`] when it is not installed, [`SourceError::Ffmpeg`] when it
    /// finds no video.
    pub fn open(path: &Path) -> Result<Self, SourceError> {
        Self::open_with(path, OsStr::new("ffmpeg"))
    }

    fn open_with(path: &Path, program: &OsStr) -> Result<Self, SourceError> {
        let heard = Arc::<Mutex<Heard>>::default();
        let (sender, times) = channel();
        let listen = listener(heard.clone(), sender);
        let (mut process, stdout) = Process::start(&command(path, program), listen)
            .map_err(|source| SourceError::FfmpegMissing { path: path.into(), source })?;
        match Y4m::new(BufReader::new(stdout), &path.to_string_lossy()) {
            Ok(frames) => Ok(Self {
                path: path.into(),
                process,
                frames,
                heard,
                times: Some(times),
                first_ns: None,
                last_us: None,
                ended: false,
            }),
            // ffmpeg's message about the file explains more than the missing header.
            Err(error) => Err(failure(&mut process, &heard, path, 0).unwrap_or(error)),
        }
    }

    /// The time of the frame that was read last, microseconds since the first one; `by_rate` where the file gives none.
    fn time_us(&mut self, by_rate: i64) -> i64 {
        let time = match &self.times {
            Some(times) => times.recv_timeout(LINE_WAIT),
            None => Ok(None),
        };
        let ns = time.unwrap_or_else(|_| {
            // An ffmpeg that logs otherwise: its frames have the rate of the header then.
            self.times = None;
            None
        });
        let time_us = match ns {
            Some(ns) => {
                let first = *self.first_ns.get_or_insert(ns);
                // Times in other units were rounded to nanoseconds: 33333333 of 33333333.33 is still 33333.
                ns.saturating_sub(first).saturating_add(2).div_euclid(1000)
            }
            None => by_rate,
        };
        // Damaged files repeat times, or go back.
        let time_us = self.last_us.map_or(time_us, |last| time_us.max(last.saturating_add(1)));
        self.last_us = Some(time_us);
        time_us
    }

    /// The end: an error when it is none, and a warning when not all could be decoded.
    fn end(&mut self) -> Option<SourceError> {
        let frames = self.frames.frames_read();
        let failure = failure(&mut self.process, &self.heard, &self.path, frames);
        let heard = self.heard.lock().unwrap_or_else(PoisonError::into_inner);
        if failure.is_none()
            && let Some(last) = &heard.last
            && !self.ended
        {
            tracing::warn!(
                "{}: not all of it could be decoded, as where a recording begins between key frames or is damaged; \
                 {frames} frames were read; ffmpeg complained {} times: {last}",
                self.path.display(),
                heard.complaints
            );
        }
        self.ended = true;
        failure
    }
}

impl FrameSource for VideoSource {
    fn next_frame(&mut self, frame: &mut Frame) -> Result<bool, SourceError> {
        match self.frames.next_frame(frame) {
            Ok(true) => {
                frame.time_us = self.time_us(frame.time_us);
                Ok(true)
            }
            ended => self.end().map_or(ended, Err),
        }
    }
}

fn command(path: &Path, program: &OsStr) -> Vec<OsString> {
    // Names like `12:30.mp4` or `-.mp4` must not be taken for protocols or options.
    let mut input = OsString::new();
    if path.exists() {
        input.push("file:");
    }
    input.push(path);
    let mut words = Vec::from([program.to_owned()]);
    words.extend(
        ["-nostdin", "-hide_banner", "-nostats", "-v", "repeat+level+info", "-i"]
            .map(OsString::from),
    );
    words.push(input);
    words.extend(["-vf", FILTERS].map(OsString::from));
    words.extend(passthrough().map(OsString::from));
    words.extend(["-f", "yuv4mpegpipe", "-strict", "-1", "-"].map(OsString::from));
    words
}

/// Frames as they come, none doubled or left out to keep a rate: the option has another name since `ffmpeg` 5.1.
pub fn passthrough() -> [&'static str; 2] {
    static MODERN: OnceLock<bool> = OnceLock::new();
    let modern = MODERN.get_or_init(|| {
        let output = Command::new("ffmpeg").arg("-version").output();
        let text = output.map(|output| output.stdout).unwrap_or_default();
        is_modern(&String::from_utf8_lossy(&text))
    });
    if *modern { ["-fps_mode", "passthrough"] } else { ["-vsync", "passthrough"] }
}

/// Whether `ffmpeg -version` says 5.1 or later; a build without a number counts as new.
fn is_modern(version: &str) -> bool {
    let number = version.strip_prefix("ffmpeg version ").unwrap_or_default();
    let mut parts = number.trim_start_matches('n').split(|c: char| !c.is_ascii_digit());
    match [parts.next(), parts.next()].map(|part| part.and_then(|part| part.parse::<u32>().ok())) {
        [Some(major), minor] => (major, minor.unwrap_or(0)) >= (5, 1),
        [None, _] => !number.is_empty(),
    }
}

/// Parses lines of `ffmpeg`'s log: times of frames into the channel, messages to `heard`.
fn listener(heard: Arc<Mutex<Heard>>, times: Sender<Option<i64>>) -> Box<dyn FnMut(&str) + Send> {
    Box::new(move |line: &str| match parse(line) {
        LogLine::Time(time) => {
            // Nobody waits for it any more when the source was dropped.
            let _ = times.send(time);
        }
        LogLine::Complaint(text) => {
            let mut heard = heard.lock().unwrap_or_else(PoisonError::into_inner);
            heard.complaints += 1;
            heard.last = Some(text.to_owned());
            let small = text.to_ascii_lowercase();
            if ["partial file", "truncat", "corrupt", "prematurely"]
                .iter()
                .any(|w| small.contains(w))
            {
                heard.cut = Some(text.to_owned());
            }
        }
        LogLine::Other => {}
    })
}

/// A line of the log.
#[derive(Debug, PartialEq, Eq)]
enum LogLine<'a> {
    /// The time of the next frame in nanoseconds, if it has one.
    Time(Option<i64>),
    Complaint(&'a str),
    Other,
}

/// Parses `[CONTEXT @ ADDRESS] [LEVEL] TEXT`, context and address being optional.
fn parse(line: &str) -> LogLine<'_> {
    for level in ["[error] ", "[fatal] ", "[panic] "] {
        if let Some((_, text)) = line.split_once(level) {
            return LogLine::Complaint(text.trim());
        }
    }
    let Some(("", rest)) = line.split_once("[Parsed_metadata_") else { return LogLine::Other };
    let Some((_, fields)) = rest.split_once("] frame:") else { return LogLine::Other };
    let Some((_, time)) = fields.split_once("pts:") else { return LogLine::Other };
    LogLine::Time(time.split_whitespace().next().and_then(|time| time.parse().ok()))
}

/// Waits for the process after its last frame; `None` when it came to the end of the file.
fn failure(
    process: &mut Process,
    heard: &Mutex<Heard>,
    path: &Path,
    frames: u64,
) -> Option<SourceError> {
    let status = process.wait();
    let heard = heard.lock().unwrap_or_else(PoisonError::into_inner);
    let complaint = if frames == 0 { &heard.last } else { &heard.cut };
    // A file that is cut off ends with status 0 when some of it was decoded.
    let message = match (complaint, status) {
        (Some(line), _) => line.clone(),
        (None, Ok(status)) if status.success() => return None,
        (None, Ok(status)) => {
            heard.last.clone().unwrap_or_else(|| format!("it ended with {status}"))
        }
        (None, Err(error)) => format!("{error}"),
    };
    Some(SourceError::Ffmpeg { path: path.into(), frames, message })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;
    use std::{eprintln, fs};

    /// Whether ffmpeg ran and succeeded; prints why a test is skipped if not.
    fn encoded(status: std::io::Result<std::process::ExitStatus>) -> bool {
        let encoded = status.is_ok_and(|status| status.success());
        if !encoded {
            eprintln!("skipped: ffmpeg is not installed");
        }
        encoded
    }

    /// Writes a test video of 20 frames with the given name; `false` where there is no ffmpeg.
    fn test_video(path: &Path) -> bool {
        let made = Command::new("ffmpeg")
            .args(["-v", "error", "-f", "lavfi", "-i", "testsrc=size=64x48:rate=25:duration=0.8"])
            .args(["-c:v", "mpeg4", "-movflags", "faststart"])
            .arg(std::format!("file:{}", path.display()))
            .status();
        encoded(made)
    }

    #[test]
    fn a_video_is_decoded() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("-12:30.mp4");
        if !test_video(&path) {
            return;
        }
        let mut source = VideoSource::open(&path).unwrap();
        let mut frame = Frame::default();
        for number in 0..20 {
            assert!(source.next_frame(&mut frame).unwrap());
            assert_eq!((frame.width, frame.height), (64, 48));
            assert_eq!(frame.time_us, number * 40_000);
        }
        assert!(!source.next_frame(&mut frame).unwrap());
        assert!(!source.next_frame(&mut frame).unwrap());
        // Dropped before its end: must not wait for the rest.
        let mut source = VideoSource::open(&path).unwrap();
        assert!(source.next_frame(&mut frame).unwrap());
    }

    #[test]
    fn a_frame_has_the_time_of_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("phone.mkv");
        // 20 frames at 25 a second, less every third: what a phone or a browser records.
        let made = Command::new("ffmpeg")
            .args(["-v", "error", "-f", "lavfi", "-i", "testsrc=size=64x48:rate=25:duration=0.8"])
            .args([
                "-vf",
                "select='mod(n,3)'",
                "-vsync",
                "passthrough",
                "-c:v",
                "mpeg4",
                "-enc_time_base",
                "1/1000",
            ])
            .arg(&path)
            .status();
        if !encoded(made) {
            return;
        }
        let mut source = VideoSource::open(&path).unwrap();
        let mut frame = Frame::default();
        let mut times = Vec::new();
        while source.next_frame(&mut frame).unwrap() {
            times.push(frame.time_us);
        }
        let wanted: Vec<i64> = (0..20i64).filter(|n| n % 3 > 0).map(|n| (n - 1) * 40_000).collect();
        assert_eq!(times, wanted);
    }

    #[test]
    fn interlaced_video_keeps_one_field_of_each_frame() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("camera.mpg");
        // A bar that moves by 8 pixels a field: in a combed picture 16 pixels differ from row to row. At the edge the codec
        // leaves some.
        let made = Command::new("ffmpeg")
            .args([
                "-v",
                "error",
                "-f",
                "lavfi",
                "-i",
                "color=black:size=128x64:rate=50:duration=0.4",
            ])
            .args(["-f", "lavfi", "-i", "color=white:size=16x64:rate=50:duration=0.4"])
            .args([
                "-filter_complex",
                "[0][1]overlay=x=n*8:shortest=1,interlace=lowpass=off",
                "-q:v",
                "1",
            ])
            .args(["-flags", "+ildct+ilme", "-c:v", "mpeg2video"])
            .arg(&path)
            .status();
        if !encoded(made) {
            return;
        }
        let mut source = VideoSource::open(&path).unwrap();
        let mut frame = Frame::default();
        let mut count = 0;
        while source.next_frame(&mut frame).unwrap() {
            count += 1;
            for (y, rows) in frame.pixels.windows(256).step_by(128).enumerate() {
                let apart = (0..128).filter(|&x| rows[x].abs_diff(rows[x + 128]) > 100).count();
                assert!(
                    apart < 12,
                    "frame {count}: rows {y} and {} differ in {apart} pixels",
                    y + 1
                );
            }
        }
        assert!(count >= 9, "{count}");
    }

    #[test]
    fn a_stream_joined_between_key_frames_gives_what_can_be_decoded() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("joined.h264");
        let made = Command::new("ffmpeg")
            .args(["-v", "error", "-f", "lavfi", "-i", "testsrc=size=64x48:rate=25:duration=2"])
            .args(["-c:v", "libx264", "-g", "20", "-bf", "0", "-f", "h264"])
            .arg(&path)
            .status();
        if !encoded(made) {
            return;
        }
        // From the middle of the first group of pictures on: without its parameters and its key frame.
        let bytes = fs::read(&path).unwrap();
        let start = |kind: u8| {
            let is_start = move |w: &[u8]| w[..3] == [0, 0, 1] && w[3] & 0x1f == kind;
            bytes.windows(4).enumerate().filter(move |(_, w)| is_start(w)).map(|(i, _)| i)
        };
        let cut = start(1).nth(9).unwrap();
        let left = start(1).filter(|&i| i > start(5).nth(1).unwrap()).count() + 2;
        assert_eq!(start(5).count(), 3);
        fs::write(&path, &bytes[cut..]).unwrap();
        let mut source = VideoSource::open(&path).unwrap();
        let mut frame = Frame::default();
        let mut count = 0;
        while source.next_frame(&mut frame).unwrap() {
            count += 1;
        }
        assert_eq!(count, left, "all frames from the second key frame on");
        assert!(source.heard.lock().unwrap().complaints > 0);
    }

    #[test]
    fn lines_of_the_log() {
        for (line, wanted) in [
            (
                "[Parsed_metadata_3 @ 0x5561d8a87a00] [info] frame:12   pts:400000000 pts_time:0.4",
                LogLine::Time(Some(400_000_000)),
            ),
            (
                "[Parsed_metadata_3 @ 0x1] [info] frame:0    pts:NOPTS   pts_time:NOPTS",
                LogLine::Time(None),
            ),
            ("[Parsed_metadata_3 @ 0x1] [info] t=0", LogLine::Other),
            (
                "[h264 @ 0x5] [error] non-existing PPS 0 referenced",
                LogLine::Complaint("non-existing PPS 0 referenced"),
            ),
            ("[error] Conversion failed!", LogLine::Complaint("Conversion failed!")),
            ("[info] Stream mapping:", LogLine::Other),
            ("[info] title : [Parsed_metadata_3 @ 1] frame:1 pts:5", LogLine::Other),
            ("", LogLine::Other),
        ] {
            assert_eq!(parse(line), wanted, "{line}");
        }
    }

    #[test]
    fn the_option_follows_the_version() {
        for (version, modern) in [
            ("ffmpeg version 4.4.2-0ubuntu0.22.04.1 Copyright", false),
            ("ffmpeg version 5.0.1 Copyright", false),
            ("ffmpeg version 5.1.9-0+deb12u1 Copyright", true),
            ("ffmpeg version n7.1 Copyright", true),
            ("ffmpeg version 7 Copyright", true),
            ("ffmpeg version N-118000-gabcdef Copyright", true),
            ("", false),
        ] {
            assert_eq!(is_modern(version), modern, "{version}");
        }
    }

    #[test]
    fn a_cut_off_video_fails_after_its_frames() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cut.mp4");
        if !test_video(&path) {
            return;
        }
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..bytes.len() * 3 / 4]).unwrap();
        let mut source = VideoSource::open(&path).unwrap();
        let mut frame = Frame::default();
        let mut frames = 0;
        let error = loop {
            match source.next_frame(&mut frame) {
                Ok(true) => frames += 1,
                Ok(false) => panic!("the cut was not noticed"),
                Err(error) => break error.to_string(),
            }
        };
        assert!(frames > 5 && frames < 20, "{frames}");
        assert!(error.contains("cut.mp4: ffmpeg could not decode it all"), "{error}");
        assert!(error.contains(&std::format!("frames read: {frames}")), "{error}");
        assert!(!error.contains('\n'));
    }

    #[test]
    fn what_is_no_video_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("letter.mp4");
        fs::write(&path, "Dear reader").unwrap();
        match VideoSource::open(&path).unwrap_err() {
            SourceError::Ffmpeg { frames: 0, message, .. } => assert!(!message.is_empty()),
            SourceError::FfmpegMissing { .. } => eprintln!("skipped: ffmpeg is not installed"),
            other => panic!("{other}"),
        }
    }

    #[test]
    fn a_missing_ffmpeg_is_explained() {
        let error = VideoSource::open_with(Path::new("a.mp4"), OsStr::new("/nowhere/ffmpeg"))
            .unwrap_err()
            .to_string();
        assert!(error.contains("apt install ffmpeg"), "{error}");
    }
}
