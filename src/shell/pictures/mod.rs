//! Pictures written as numbered PNG files or as a video through `ffmpeg`.

pub mod annotate;
pub mod colour;
pub mod strip;

use crate::shell::support::file_error::FileError;
use annotate::ColourPicture;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::string::{String, ToString};
use std::thread::JoinHandle;
use std::vec::Vec;
use std::{format, fs, thread};

/// A picture or video that cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// The system refuses the file.
    #[error(transparent)]
    File(#[from] FileError),
    /// A video encoder that cannot be started or gave up.
    #[error("{}: {reason}", path.display())]
    Encoder {
        /// Path of the video.
        path: PathBuf,
        /// The encoder's own words, and the remedy.
        reason: String,
    },
}

/// Output of pictures.
#[derive(Debug)]
pub enum PictureOutput {
    /// `000001.png`, `000002.png`, .. in a folder.
    Folder(PathBuf),
    /// A video file.
    Video(VideoWriter),
}

impl PictureOutput {
    /// A video if the name ends in `.mp4`, else a folder, which is made if it does not exist.
    ///
    /// # Errors
    /// [`FileError::Write`].
    pub fn create(path: &Path) -> Result<Self, PictureError> {
        if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("mp4")) {
            // An unwritable path fails here rather than in the encoder after some frames.
            fs::File::create(path).map_err(FileError::write(path))?;
            Ok(Self::Video(VideoWriter { path: path.into(), state: VideoState::Empty }))
        } else {
            fs::create_dir_all(path).map_err(FileError::write(path))?;
            Ok(Self::Folder(path.into()))
        }
    }

    /// Writes the picture of frame `number` (from 1), taken at `time_us`.
    ///
    /// # Errors
    /// [`FileError::Write`], [`PictureError::Encoder`]; the pictures before stay as they are.
    pub fn write(
        &mut self,
        number: u64,
        time_us: i64,
        picture: &ColourPicture,
    ) -> Result<(), PictureError> {
        match self {
            Self::Folder(folder) => write_png(&folder.join(format!("{number:06}.png")), picture),
            Self::Video(video) => video.write(time_us, picture),
        }
    }

    /// Completes the video.
    ///
    /// # Errors
    /// [`PictureError::Encoder`].
    pub fn finish(self) -> Result<(), PictureError> {
        match self {
            Self::Folder(_) => Ok(()),
            Self::Video(video) => video.finish(),
        }
    }
}

fn write_png(path: &Path, picture: &ColourPicture) -> Result<(), PictureError> {
    let mut bytes = Vec::new();
    let (width, height) = (picture.width as u32, picture.height as u32);
    PngEncoder::new(&mut bytes)
        .write_image(&picture.rgb, width, height, ExtendedColorType::Rgb8)
        .map_err(|e| FileError::Write { path: path.into(), source: io::Error::other(e) })?;
    fs::write(path, bytes).map_err(|source| {
        // Half a picture is of no use; the first error is returned.
        let _ = fs::remove_file(path);
        FileError::Write { path: path.into(), source }.into()
    })
}

/// A video file being written.
#[derive(Debug)]
pub struct VideoWriter {
    path: PathBuf,
    state: VideoState,
}

#[derive(Debug)]
enum VideoState {
    Empty,
    /// The frame rate is known with the second frame only.
    First {
        time_us: i64,
        picture: ColourPicture,
    },
    Running(ColourEncoder),
}

/// Frames a second of a video of one frame.
const DEFAULT_RATE: f64 = 30.0;

impl VideoWriter {
    fn write(&mut self, time_us: i64, picture: &ColourPicture) -> Result<(), PictureError> {
        match &mut self.state {
            VideoState::Empty => {
                self.state = VideoState::First { time_us, picture: picture.clone() };
                Ok(())
            }
            VideoState::First { time_us: first_us, picture: first } => {
                let rate = 1e6 / time_us.saturating_sub(*first_us).max(1) as f64;
                let mut encoder = ColourEncoder::start(&self.path, first, rate.clamp(1.0, 1000.0))?;
                let written = encoder.write(first).and_then(|()| encoder.write(picture));
                self.state = VideoState::Running(encoder);
                self.explained(written)
            }
            VideoState::Running(encoder) => {
                let written = encoder.write(picture);
                self.explained(written)
            }
        }
    }

    /// The encoder's own words where a write to it failed.
    fn explained(&mut self, written: io::Result<()>) -> Result<(), PictureError> {
        let Err(error) = written else { return Ok(()) };
        match std::mem::replace(&mut self.state, VideoState::Empty) {
            VideoState::Running(encoder) => encoder.finish(&self.path)?,
            VideoState::Empty | VideoState::First { .. } => {}
        }
        Err(PictureError::Encoder { path: self.path.clone(), reason: format!("ffmpeg: {error}") })
    }

    fn finish(self) -> Result<(), PictureError> {
        match self.state {
            VideoState::Empty => Ok(()),
            VideoState::First { picture, .. } => {
                let mut encoder = ColourEncoder::start(&self.path, &picture, DEFAULT_RATE)?;
                let mut video = Self { path: self.path, state: VideoState::Empty };
                let written = encoder.write(&picture);
                video.state = VideoState::Running(encoder);
                video.explained(written)?;
                video.finish()
            }
            VideoState::Running(encoder) => encoder.finish(&self.path),
        }
    }
}

/// A running `ffmpeg`.
#[derive(Debug)]
struct ColourEncoder {
    child: Child,
    input: ChildStdin,
    complaints: JoinHandle<String>,
}

impl ColourEncoder {
    #[allow(clippy::expect_used, reason = "both are piped")]
    fn start(path: &Path, picture: &ColourPicture, rate: f64) -> Result<Self, PictureError> {
        let size = format!("{}x{}", picture.width, picture.height);
        let mut command = Command::new("ffmpeg");
        command
            .args(["-v", "error", "-nostdin", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"])
            .args(["-video_size", &size, "-framerate", &format!("{rate:.3}"), "-i", "-"])
            // Its codec wants even sizes.
            .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p", "-g", "30"])
            // In pieces that can be played even if the end is missing.
            .args(["-movflags", "frag_keyframe+empty_moov+default_base_moof", "-f", "mp4"])
            .arg(Path::new(".").join(path))
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        // Out of reach of the terminal's Ctrl-C: it is to write the video to its end.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let reason = |e: &io::Error| {
            match e.kind() {
            io::ErrorKind::NotFound => {
                "writing a video needs ffmpeg; install it (apt-get install ffmpeg), or name a folder for PNG pictures".into()
            }
            _ => format!("cannot start ffmpeg: {e}"),
        }
        };
        let mut child = command
            .spawn()
            .map_err(|e| PictureError::Encoder { path: path.into(), reason: reason(&e) })?;
        let (input, stderr) = child.stdin.take().zip(child.stderr.take()).expect("both are piped");
        let complaints = thread::spawn(move || {
            let mut bytes = Vec::new();
            // The readable part of its messages is enough.
            let _ = io::BufReader::new(stderr).read_to_end(&mut bytes);
            String::from_utf8_lossy(&bytes).into_owned()
        });
        Ok(Self { child, input, complaints })
    }

    fn write(&mut self, picture: &ColourPicture) -> io::Result<()> {
        self.input.write_all(&picture.rgb)
    }

    /// Waits for the end of the video.
    fn finish(mut self, path: &Path) -> Result<(), PictureError> {
        drop(self.input);
        let status = self.child.wait();
        let complaints = self.complaints.join().unwrap_or_default();
        if complaints.contains("No space left on device") {
            return Err(FileError::write(path)(io::ErrorKind::StorageFull.into()).into());
        }
        // A failure while closing the file ends with status 0: messages count, the first one says most.
        let reason = match (complaints.lines().find(|line| !line.trim().is_empty()), status) {
            (Some(line), _) => line.into(),
            (None, Ok(status)) if status.success() => return Ok(()),
            (None, Ok(status)) => status.to_string(),
            (None, Err(error)) => error.to_string(),
        };
        Err(PictureError::Encoder { path: path.into(), reason: format!("ffmpeg: {reason}") })
    }
}
