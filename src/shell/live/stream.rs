//! A network stream, or a program that writes frames, as a live source.

use super::config::ServiceConfig;
use super::live_source::{CaptureInfo, LiveError, LiveSource};
use crate::shell::sources::stream::{ProgramStream, StreamError, StreamSettings};
use crate::shell::sources::y4m::{Header, RawLayout};
use crate::shell::sources::{self, Frame};
use std::boxed::Box;
use std::ffi::OsString;
use std::format;
use std::string::{String, ToString};
use std::time::Duration;
use std::vec::Vec;

/// Starts `command`, which writes y4m or bare frames of that layout; a frame's time is that of its arrival less
/// `stream.latency_ms`.
///
/// # Errors
/// [`LiveError::Gone`] with the reason, also for what only a person can mend.
pub fn open(
    command: Vec<OsString>,
    raw: Option<RawLayout>,
    config: &ServiceConfig,
) -> Result<Box<dyn LiveSource>, LiveError> {
    let (width, height) = (config.camera.width as usize, config.camera.height as usize);
    let settings = StreamSettings {
        command,
        header: raw.map(|layout| Header::raw(layout, width, height)),
        latency_us: i64::from(config.stream.latency_ms.unwrap_or(0)) * 1000,
        timeout: Duration::from_millis(config.stream.timeout_ms.into()),
        secret: config.source.secret().map(String::from),
    };
    let stream =
        ProgramStream::start(settings).map_err(|error| LiveError::Gone(error.to_string()))?;
    Ok(Box::new(stream))
}

impl LiveSource for ProgramStream {
    fn next(&mut self, frame: &mut Frame, timeout: Duration) -> Result<CaptureInfo, LiveError> {
        match Self::next(self, frame, timeout) {
            Ok(passed_over) => Ok(CaptureInfo { missed: 0, passed_over }),
            Err(StreamError::Timeout) => Err(LiveError::Timeout),
            Err(error) => Err(LiveError::Gone(error.to_string())),
        }
    }

    /// It gives itself up: a stream takes longer to begin than to be found dead.
    fn silence(&self) -> Duration {
        Duration::MAX
    }
}

/// The `ffmpeg` that receives `input` with as little delay as it can and gives grey frames of at most
/// `camera.width` x `camera.height`, in the stream's own shape: what is dropped there need not cross the pipe.
pub fn receiver(input: &str, config: &ServiceConfig) -> Vec<OsString> {
    let (width, height) = (config.camera.width, config.camera.height);
    let scale = format!(
        "scale=w='min(iw,{width})':h='min(ih,{height})':force_original_aspect_ratio=decrease,format=gray"
    );
    let mut words = Vec::from(["ffmpeg", "-nostdin", "-v", "error"]);
    if input.starts_with("rtsp") {
        // Datagrams that are lost on a radio link leave smeared pictures, in which nothing may be sought.
        words.extend(["-rtsp_transport", "tcp"]);
    }
    words.extend(["-fflags", "nobuffer", "-flags", "low_delay"]);
    // Enough to find the stream's size, less than the five seconds that are usual.
    words.extend(["-probesize", "500000", "-analyzeduration", "500000"]);
    words.extend(["-i", input, "-map", "0:v:0", "-vf", &scale]);
    words.extend(sources::passthrough());
    words.extend(["-f", "yuv4mpegpipe", "-strict", "-1", "-"]);
    words.into_iter().map(OsString::from).collect()
}
