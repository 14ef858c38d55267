//! Where frames come from.

#[cfg(feature = "mcap")]
mod cdr;
mod folder;
pub mod interlaced;
#[cfg(feature = "mcap")]
mod mcap;
pub mod process;
pub mod stream;
mod times;
#[cfg(target_os = "linux")]
pub mod v4l2;
mod video;
pub mod y4m;

pub use folder::Folder;
pub(crate) use folder::is_picture;
use std::fs;
pub use video::{VideoSource, passthrough};
pub use y4m::Y4m;
pub(crate) use y4m::expand;

use crate::image::Image;
use std::boxed::Box;
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};
use std::string::String;
use std::vec::Vec;

/// One grey frame, owned, and when it was taken.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Frame {
    /// Rows of `width` pixels without padding.
    pub pixels: Vec<u8>,
    /// Pixels in a row.
    pub width: usize,
    /// Number of rows of pixels.
    pub height: usize,
    /// When it was taken, microseconds since the first frame; of a live camera by the system's monotonic clock.
    pub time_us: i64,
}

impl Frame {
    /// Width and height, for encoders; saturated.
    pub fn size(&self) -> (u32, u32) {
        let side = |pixels: usize| u32::try_from(pixels).unwrap_or(u32::MAX);
        (side(self.width), side(self.height))
    }

    /// The frame as the core sees it.
    ///
    /// # Panics
    /// Where `pixels` are not as many as `width` and `height` say, which no source does.
    #[cfg_attr(
        not(test),
        expect(clippy::expect_used, reason = "a source fills a frame whole, or fails")
    )]
    pub fn view(&self) -> Image<'_> {
        Image::packed(&self.pixels, self.width, self.height)
            .expect("a frame's pixels always fill its size")
    }
}

/// A sequence of frames of one size.
pub trait FrameSource {
    /// Writes the next frame into `frame` (reusing its memory); `false` at the end.
    ///
    /// # Errors
    /// [`SourceError`] naming the file and the frame; what was read before stays valid.
    fn next_frame(&mut self, frame: &mut Frame) -> Result<bool, SourceError>;

    /// Number of all frames, where it is known beforehand.
    fn frame_count(&self) -> Option<u64> {
        None
    }
}

impl FrameSource for Box<dyn FrameSource> {
    fn next_frame(&mut self, frame: &mut Frame) -> Result<bool, SourceError> {
        (**self).next_frame(frame)
    }

    fn frame_count(&self) -> Option<u64> {
        (**self).frame_count()
    }
}

/// Opens what the user names: `-` (y4m on standard input), a `.y4m` file, a folder of pictures, a
/// clip's folder (its `frames/` or its video), an MCAP file (feature `mcap`), or any video that `ffmpeg` reads.
///
/// # Errors
/// [`SourceError`] when it is missing, empty or not of these forms.
pub fn open<P: AsRef<Path> + ?Sized>(input: &P) -> Result<Box<dyn FrameSource>, SourceError> {
    open_at(input.as_ref(), None)
}

/// The same with the rate of pictures that have no times of their own, in frames a second.
///
/// # Errors
/// As [`open`].
pub fn open_at(path: &Path, rate: Option<u32>) -> Result<Box<dyn FrameSource>, SourceError> {
    if path == Path::new("-") {
        let reader = BufReader::new(io::stdin());
        return Ok(Box::new(Y4m::new(reader, "standard input")?));
    }
    #[cfg(feature = "mcap")]
    if let Some((file, topic)) = mcap::parts(path) {
        return Ok(Box::new(mcap::McapSource::open(&file, topic)?));
    }
    #[cfg(not(feature = "mcap"))]
    if has_extension(path, &["mcap"]) {
        return Err(SourceError::McapMissing { path: path.into() });
    }
    // An address has a scheme, and no name of a file need be text.
    if !path.to_str().is_some_and(|text| text.contains("://")) {
        path.metadata().map_err(|source| SourceError::Open { path: path.into(), source })?;
    }
    if !path.is_dir() {
        return open_file(path);
    }
    match (Folder::new(path, rate), clip_input(path)) {
        (Err(SourceError::NoPictures { .. }), Some(found)) if found.is_dir() => {
            Ok(Box::new(Folder::new(&found, rate)?))
        }
        (Err(SourceError::NoPictures { .. }), Some(found)) => open_file(&found),
        (pictures, _) => Ok(Box::new(pictures?)),
    }
}

/// Endings of video files that are looked for in a folder.
const VIDEOS: [&str; 13] =
    ["mp4", "avi", "mkv", "mov", "webm", "m4v", "y4m", "ts", "mpg", "mpeg", "wmv", "h264", "flv"];

/// Whether `path` is a file whose name ends as those of videos do; hidden ones are none.
pub fn is_video(path: &Path) -> bool {
    let hidden = path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
    !hidden && has_extension(path, &VIDEOS) && path.is_file()
}

/// The frames of the clip in `directory`: `video.mp4`, else the first other video by name, else the
/// pictures in `frames/`, else pictures in the folder itself.
pub fn clip_input(directory: &Path) -> Option<PathBuf> {
    let video = directory.join("video.mp4");
    if video.is_file() {
        return Some(video);
    }
    let entries = || fs::read_dir(directory).ok().into_iter().flatten().flatten();
    let videos = entries().map(|entry| entry.path()).filter(|path| is_video(path));
    let frames = directory.join("frames");
    videos.min().or_else(|| frames.is_dir().then_some(frames)).or_else(|| {
        let pictures = entries().any(|entry| is_picture(&entry.path()));
        pictures.then(|| directory.to_path_buf())
    })
}

fn open_file(path: &Path) -> Result<Box<dyn FrameSource>, SourceError> {
    if has_extension(path, &["y4m"]) {
        Ok(Box::new(Y4m::open(path)?))
    } else {
        Ok(Box::new(VideoSource::open(path)?))
    }
}

/// Whether the name of `path` ends in one of `extensions` (given in lower case), in any case.
pub(crate) fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension()
        .and_then(|found| found.to_str())
        .is_some_and(|found| extensions.contains(&found.to_ascii_lowercase().as_str()))
}

/// When frame `index` (from 0) is taken at `rate.0 / rate.1` frames a second, microseconds.
pub(crate) fn frame_time_us(index: u64, rate: (u32, u32)) -> i64 {
    let time = u128::from(index) * 1_000_000 * u128::from(rate.1) / u128::from(rate.0);
    i64::try_from(time).unwrap_or(i64::MAX)
}

/// Why frames cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SourceError {
    /// The input is missing or may not be read.
    #[error("{}: cannot open: {source}; give a folder of pictures, a .y4m file, a video or - for y4m on standard input", path.display())]
    Open {
        /// Path of the input.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// A folder without a picture.
    #[error("{}: no PNG, JPEG or PGM picture in this folder; put the frames there, named in order", path.display())]
    NoPictures {
        /// Path of the folder.
        path: PathBuf,
    },
    /// Times of pictures that are not understood.
    #[error("{} line {line}: {reason}; without this file the pictures have the rate of camera.json or --fps", path.display())]
    Times {
        /// Path of the file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// Reason, in words.
        reason: String,
    },
    /// A rate of pictures that is none.
    #[error("{}: fps is {rate}, expected frames a second from 0.001 to 1000", path.display())]
    Rate {
        /// The file `camera.json`.
        path: PathBuf,
        /// Value of the rate in the file.
        rate: serde_json::Value,
    },
    /// A stream without a frame.
    #[error("{name}: no frame in it; check how it was recorded")]
    NoFrames {
        /// The file, or `standard input`.
        name: String,
    },
    /// A picture that cannot be decoded.
    #[error("{}: frame {frame} cannot be decoded: {source}; replace the file or take it out", path.display())]
    Picture {
        /// Path of the picture.
        path: PathBuf,
        /// Its place in the folder, from 1.
        frame: u64,
        /// The decoder's reason.
        source: image::ImageError,
    },
    /// A picture of another size than the first.
    #[error("{}: frame {frame} is {}x{}, the frames before are {}x{}; all must have one size", path.display(), size.0, size.1, expected.0, expected.1)]
    Size {
        /// Path of the picture.
        path: PathBuf,
        /// Its place in the folder, from 1.
        frame: u64,
        /// Its width and height.
        size: (usize, usize),
        /// Width and height of the first.
        expected: (usize, usize),
    },
    /// A y4m header that is not understood.
    #[error("{name}: y4m header: {reason}")]
    Header {
        /// The file, or `standard input`.
        name: String,
        /// The field, what it is and what is expected.
        reason: String,
    },
    /// Something else where a y4m frame should begin.
    #[error("{name}: frame {frame} does not begin with FRAME; the file is damaged from there on")]
    FrameHeader {
        /// The file, or `standard input`.
        name: String,
        /// Which frame, from 1.
        frame: u64,
    },
    /// A y4m stream that ends inside a frame.
    #[error("{name}: cut off inside frame {frame}; the {} complete frames before it were read, record it again for the rest", frame - 1)]
    CutOff {
        /// The file, or `standard input`.
        name: String,
        /// Which frame, from 1.
        frame: u64,
    },
    /// The system failed while reading.
    #[error("{name}: frame {frame} cannot be read: {source}")]
    Read {
        /// The file, or `standard input`.
        name: String,
        /// Which frame, from 1.
        frame: u64,
        /// The system's reason.
        source: io::Error,
    },
    /// Messages of an MCAP file that are no pictures.
    #[error("{}: frame {frame}: {reason}", path.display())]
    Mcap {
        /// Path of the file.
        path: PathBuf,
        /// Which frame, from 1.
        frame: u64,
        /// Fault, in words.
        reason: String,
    },
    /// An MCAP file that this program was not built to read.
    #[error("{}: this program was built without MCAP; build it with `--features mcap`, or install the Python wheel, which has it", path.display())]
    McapMissing {
        /// Path of the file.
        path: PathBuf,
    },
    /// `ffmpeg` cannot be started.
    #[error("{}: videos are read with ffmpeg, which cannot be started: {source}; install it (Debian, Ubuntu: apt install ffmpeg; macOS: brew install ffmpeg) or give a folder of pictures or a .y4m file", path.display())]
    FfmpegMissing {
        /// Path of the video.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// `ffmpeg` could not decode all of the video.
    #[error("{}: ffmpeg could not decode it all (frames read: {frames}): {message}", path.display())]
    Ffmpeg {
        /// Path of the video.
        path: PathBuf,
        /// Number of frames delivered before.
        frames: u64,
        /// Its last words.
        message: String,
    },
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn a_missing_file_is_named() {
        let error = open("/nowhere/flight.mp4").err().unwrap().to_string();
        assert!(error.starts_with("/nowhere/flight.mp4: cannot open"));
    }

    #[test]
    fn the_form_is_recognised() {
        let folder = tempfile::tempdir().unwrap();
        let frames = folder.path().join("frames");
        std::fs::create_dir(&frames).unwrap();
        let stream = folder.path().join("flight.Y4M");
        std::fs::write(&stream, "YUV4MPEG2 W2 H1 F10:1 Cmono\nFRAME\nab").unwrap();
        let open = |path: &Path| open(path.to_str().unwrap());
        let mut frame = Frame::default();
        assert!(open(&stream).unwrap().next_frame(&mut frame).unwrap());
        assert_eq!(frame.pixels, b"ab");
        // A stream in a clip's folder is its video; without it the folder of pictures counts, and is empty.
        assert!(open(folder.path()).is_ok());
        std::fs::remove_file(&stream).unwrap();
        let error = open(folder.path()).err().unwrap().to_string();
        assert!(error.contains("frames: no PNG"), "{error}");
        let picture = image::GrayImage::new(3, 2);
        picture.save(frames.join("1.png")).unwrap();
        assert_eq!(open(folder.path()).unwrap().frame_count(), Some(1));
        assert!(open(folder.path()).unwrap().next_frame(&mut frame).unwrap());
        assert_eq!((frame.width, frame.height), (3, 2));
    }

    #[test]
    fn times_do_not_drift() {
        assert_eq!(frame_time_us(30_000, (30_000, 1001)), 1_001_000_000);
        assert_eq!(frame_time_us(1, (30, 1)), 33_333);
        assert_eq!(frame_time_us(2, (30, 1)), 66_666);
        assert_eq!(frame_time_us(u64::MAX, (1, u32::MAX)), i64::MAX);
    }
}
