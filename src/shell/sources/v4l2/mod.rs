//! A camera by Video4Linux2: frames as the driver takes them, the newest first of all.
//!
//! Own requests on `rustix`, as the kernel's interface is small and does not change: buffers mapped from the driver,
//! its own count of frames and its own time of each, and one kind of error for a camera that is gone. Written from the
//! kernel's documentation, "Video for Linux API".
//!
//! Cameras on the connector of a Raspberry Pi or a Jetson give raw sensor data here; they need libcamera or the vendor's
//! own stack in front, as a program that lookout starts (`boards/linux/cameras/`) or with a loopback device.

mod abi;
mod controls;
mod device;
mod error;
mod format;
mod grey;
pub(in crate::shell) mod mjpeg;

pub use controls::CameraControl;
pub use error::V4l2Error;

use crate::shell::sources::Frame;
use crate::shell::support::clock::now_us;
use abi::{Buffer, Capability};
use device::{Device, DeviceStream, Filled};
use grey::{BufferLayout, Converter};
use rustix::event::PollFlags;
use rustix::io::Errno;
use serde::{Deserialize, Serialize};
use std::borrow::ToOwned;
use std::collections::BTreeMap;
use std::fmt;
use std::format;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::string::String;
use std::time::{Duration, Instant};
use std::vec::Vec;

/// Buffers requested: one that is being read, and enough to fill while the machine is busy with something else.
const BUFFERS: u32 = 4;

/// Requested format, rate and controls of a camera.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CameraSettings {
    /// Pixels; the camera must have exactly this size.
    pub width: u32,
    /// Height in pixels; the camera must have exactly this size.
    pub height: u32,
    /// Frames a second; `None` leaves it as it is. A camera takes the nearest that it has.
    pub rate: Option<u32>,
    /// `None`: the first of [`PixelFormat::ALL`] that the camera has in this size and at this rate.
    pub format: Option<PixelFormat>,
    /// Values of controls by name, as `v4l2-ctl --list-ctrls` shows them; upper case and blanks do as well.
    pub controls: BTreeMap<String, i64>,
}

/// A format of pictures that is understood.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum PixelFormat {
    /// 8 bits of grey.
    Grey,
    /// A plane of luma and one of chroma, 4:2:0.
    Nv12,
    /// Luma and chroma in turn, 4:2:2.
    Yuyv,
    /// The same with chroma first.
    Uyvy,
    /// JPEG pictures.
    Mjpeg,
}

impl PixelFormat {
    /// All of them, the best first: the least data for the same grey, and compressed only when nothing else will do.
    pub const ALL: [Self; 5] = [Self::Grey, Self::Nv12, Self::Yuyv, Self::Uyvy, Self::Mjpeg];

    fn name(self) -> &'static str {
        match self {
            Self::Grey => "GREY",
            Self::Nv12 => "NV12",
            Self::Yuyv => "YUYV",
            Self::Uyvy => "UYVY",
            Self::Mjpeg => "MJPEG",
        }
    }

    /// The kernel's four letters.
    fn fourcc(self) -> [u8; 4] {
        match self {
            Self::Grey => *b"GREY",
            Self::Nv12 => *b"NV12",
            Self::Yuyv => *b"YUYV",
            Self::Uyvy => *b"UYVY",
            Self::Mjpeg => *b"MJPG",
        }
    }

    /// Of the plane that has the luma; 1 where it is compressed.
    fn bytes_per_pixel(self) -> usize {
        match self {
            Self::Grey | Self::Nv12 | Self::Mjpeg => 1,
            Self::Yuyv | Self::Uyvy => 2,
        }
    }
}

impl fmt::Display for PixelFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for PixelFormat {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|format| format.name().eq_ignore_ascii_case(text));
        found.ok_or_else(|| format!("'{text}' is none of {}", Self::ALL.map(Self::name).join(", ")))
    }
}

/// Driver's information about a frame; counts are since the frame before.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DriverInfo {
    /// The driver's count of frames; wraps.
    pub sequence: u32,
    /// Frames that the driver took and had no buffer for: gaps in its count.
    pub missed: u32,
    /// Older frames that were ready too and were dropped.
    pub passed_over: u32,
    /// Frames that arrived incomplete or broken.
    pub damaged: u32,
    /// When the driver says that it was taken, microseconds of the monotonic clock.
    pub monotonic_us: Option<i64>,
}

/// An open camera that takes pictures. Dropped, it stops and can be opened again.
#[derive(Debug)]
pub struct V4l2Camera {
    path: PathBuf,
    controls: Vec<CameraControl>,
    rate: Option<format::FrameRate>,
    stream: DeviceStream,
    converter: Converter,
    /// Of the last buffer that came.
    sequence: Option<u32>,
    /// The counts since the last frame that was given out.
    since: DriverInfo,
}

impl V4l2Camera {
    /// Opens and sets up the camera of a video node such as `/dev/video0`, and starts it.
    ///
    /// # Errors
    /// [`V4l2Error`]; one that [`is_gone`](V4l2Error::is_gone) may be another next time, the others stay until
    /// somebody does something.
    pub fn open(path: &Path, settings: &CameraSettings) -> Result<Self, V4l2Error> {
        let failed = |request| V4l2Error::system(path, request);
        let device = Device::open(path).map_err(|errno| match errno {
            Errno::BUSY => V4l2Error::Busy { path: path.into() },
            _ => V4l2Error::Open { path: path.into(), source: errno.into() },
        })?;
        check(&device, path)?;
        let controls = controls::list(&device).map_err(failed("cannot list the controls"))?;
        let (layout, rate) = format::agree(&device, path, settings)?;
        controls::set_all(&device, &controls, &settings.controls, path)?;
        let stream =
            DeviceStream::start(device, BUFFERS).map_err(failed("cannot start the camera"))?;
        let (converter, since) = (Converter::new(layout), DriverInfo::default());
        Ok(Self { path: path.into(), controls, rate, stream, converter, sequence: None, since })
    }

    /// Format of what the camera sends, width and height of the frames.
    pub fn format(&self) -> (PixelFormat, u32, u32) {
        let BufferLayout { format, width, height, .. } = self.converter.layout;
        let side = |pixels: usize| u32::try_from(pixels).unwrap_or(u32::MAX);
        (format, side(width), side(height))
    }

    /// Frames a second as a fraction, where the driver knows.
    pub fn rate(&self) -> Option<(u32, u32)> {
        self.rate
    }

    /// The controls that the camera has.
    pub fn controls(&self) -> &[CameraControl] {
        &self.controls
    }

    /// The value of a control.
    ///
    /// # Errors
    /// [`V4l2Error::NoControl`], [`V4l2Error::Gone`], [`V4l2Error::System`].
    pub fn control(&self, name: &str) -> Result<i64, V4l2Error> {
        let control = controls::find(&self.controls, name, &self.path)?;
        controls::value(self.stream.device(), control, &self.path)
    }

    /// Sets a control, also between frames.
    ///
    /// # Errors
    /// [`V4l2Error::NoControl`], [`V4l2Error::ControlValue`], [`V4l2Error::Gone`], [`V4l2Error::System`].
    pub fn set_control(&mut self, name: &str, value: i64) -> Result<(), V4l2Error> {
        let control = controls::find(&self.controls, name, &self.path)?;
        controls::set(self.stream.device(), control, value, &self.path)
    }

    /// Waits at most `timeout` for a frame and writes the newest one to `frame`, whose memory it uses again.
    ///
    /// The frame's time is that of [`DriverInfo::monotonic_us`], or now where the driver gives none.
    ///
    /// # Errors
    /// [`V4l2Error::Timeout`]: call again. [`V4l2Error::Gone`]: drop the camera, open it again when it is back.
    pub fn next(&mut self, frame: &mut Frame, timeout: Duration) -> Result<DriverInfo, V4l2Error> {
        let start = Instant::now();
        loop {
            self.wait(timeout.saturating_sub(start.elapsed()))?;
            if let Some(taken) = self.newest(frame)? {
                return Ok(taken);
            }
            if start.elapsed() >= timeout {
                return Err(V4l2Error::Timeout);
            }
        }
    }

    /// Until there is something to fetch, a frame or the reason why there is none.
    fn wait(&self, timeout: Duration) -> Result<(), V4l2Error> {
        let events = self.stream.device().wait(timeout).map_err(V4l2Error::gone(&self.path))?;
        if events.intersects(PollFlags::HUP | PollFlags::NVAL) {
            return Err(V4l2Error::gone(&self.path)(Errno::NODEV));
        }
        if events.contains(PollFlags::ERR) {
            let errno = self.stream.dequeue().err().filter(|errno| *errno != Errno::AGAIN);
            return Err(V4l2Error::gone(&self.path)(errno.unwrap_or(Errno::IO)));
        }
        Ok(())
    }

    /// Takes everything that is ready and converts the newest of it; `None` if nothing of it is whole.
    fn newest(&mut self, frame: &mut Frame) -> Result<Option<DriverInfo>, V4l2Error> {
        let mut newest: Option<Filled<'_>> = None;
        loop {
            let filled = match self.stream.dequeue() {
                Ok(filled) => filled,
                Err(Errno::AGAIN) => break,
                Err(errno) => return Err(V4l2Error::gone(&self.path)(errno)),
            };
            let sequence = filled.buffer().sequence;
            self.since.missed += gap(self.sequence.replace(sequence), sequence);
            if filled.buffer().flags & Buffer::ERROR != 0 {
                self.since.damaged += 1;
            } else if newest.replace(filled).is_some() {
                self.since.passed_over += 1;
            }
        }
        let Some(filled) = newest else { return Ok(None) };
        if self.converter.convert(filled.bytes(), frame).is_err() {
            self.since.damaged += 1;
            return Ok(None);
        }
        let monotonic_us = monotonic_us(filled.buffer());
        frame.time_us = monotonic_us.unwrap_or_else(now_us);
        let sequence = filled.buffer().sequence;
        Ok(Some(DriverInfo { sequence, monotonic_us, ..core::mem::take(&mut self.since) }))
    }
}

/// Whether the node gives pictures in a way that is understood.
fn check(device: &Device, path: &Path) -> Result<(), V4l2Error> {
    let no_camera = |reason| V4l2Error::NoCamera { path: path.into(), reason };
    let capability = match device.capability() {
        Err(Errno::NOTTY | Errno::INVAL) => {
            return Err(no_camera("this is no video node".to_owned()));
        }
        other => other.map_err(V4l2Error::system(path, "cannot ask what it is"))?,
    };
    let needed = Capability::VIDEO_CAPTURE | Capability::STREAMING;
    if capability.of_node() & needed != needed {
        let card = controls::text(&capability.card);
        return Err(no_camera(format!("this node of '{card}' gives no pictures in one plane")));
    }
    Ok(())
}

/// Number of frames missing before `sequence`; 0 where the count begins, stands still or begins anew.
fn gap(last: Option<u32>, sequence: u32) -> u32 {
    let step = last.map_or(1, |last| sequence.wrapping_sub(last));
    if step > u32::MAX / 2 { 0 } else { step.saturating_sub(1) }
}

fn monotonic_us(buffer: &Buffer) -> Option<i64> {
    let monotonic = buffer.flags & Buffer::TIMESTAMP_MASK == Buffer::TIMESTAMP_MONOTONIC;
    let time = buffer.seconds.checked_mul(1_000_000)?.checked_add(buffer.microseconds)?;
    monotonic.then_some(time)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    fn settings() -> CameraSettings {
        CameraSettings {
            width: 640,
            height: 480,
            rate: None,
            format: None,
            controls: BTreeMap::new(),
        }
    }

    #[test]
    fn gaps_are_counted_and_odd_counts_are_not() {
        assert_eq!(gap(None, 5), 0);
        assert_eq!(gap(Some(5), 6), 0);
        assert_eq!(gap(Some(5), 9), 3);
        assert_eq!(gap(Some(u32::MAX), 1), 1);
        assert_eq!(gap(Some(5), 5), 0);
        assert_eq!(gap(Some(500), 0), 0);
    }

    #[test]
    fn only_a_monotonic_time_is_a_time() {
        let buffer = Buffer { seconds: 12, microseconds: 345, ..Buffer::mapped(0) };
        assert_eq!(monotonic_us(&buffer), None);
        let buffer = Buffer { flags: Buffer::TIMESTAMP_MONOTONIC, ..buffer };
        assert_eq!(monotonic_us(&buffer), Some(12_000_345));
        assert_eq!(monotonic_us(&Buffer { seconds: i64::MAX, ..buffer }), None);
    }

    #[test]
    fn a_missing_camera_may_come() {
        let error = V4l2Camera::open(Path::new("/dev/nowhere"), &settings()).unwrap_err();
        assert!(error.is_gone());
        assert!(error.to_string().starts_with("/dev/nowhere: cannot open the camera: "), "{error}");
    }

    #[test]
    fn what_is_no_camera_never_becomes_one() {
        for path in ["/dev/null", "/dev/zero"] {
            let error = V4l2Camera::open(Path::new(path), &settings()).unwrap_err();
            assert!(!error.is_gone());
            let expected = format!("{path}: this is no video node; ");
            assert!(error.to_string().starts_with(&expected), "{error}");
        }
    }

    #[test]
    fn formats_have_one_name_everywhere() {
        for format in PixelFormat::ALL {
            assert_eq!(format.to_string().parse(), Ok(format));
            assert_eq!(serde_json::to_string(&format).unwrap(), format!("\"{format}\""));
        }
        assert_eq!("mjpeg".parse(), Ok(PixelFormat::Mjpeg));
        let error = "RGB".parse::<PixelFormat>().unwrap_err();
        assert_eq!(error, "'RGB' is none of GREY, NV12, YUYV, UYVY, MJPEG");
    }
}
