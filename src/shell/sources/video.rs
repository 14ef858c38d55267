//! Video files of any kind, decoded by `ffmpeg`.

use super::{Frame, FrameSource, SourceError, Y4m};
use std::borrow::ToOwned;
use std::ffi::{OsStr, OsString};
use std::format;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::string::String;
use std::thread::{self, JoinHandle};
use std::vec::Vec;

/// A video decoded by an `ffmpeg` process to full-range grey; the process is ended with the source.
#[derive(Debug)]
pub struct Video {
    path: PathBuf,
    ffmpeg: Ffmpeg,
    frames: Y4m<BufReader<ChildStdout>>,
}

impl Video {
    /// Starts `ffmpeg` on `path` (a file, or an address that `ffmpeg` understands).
    ///
    /// # Errors
    /// [`SourceError::FfmpegMissing`] when it is not installed, [`SourceError::Ffmpeg`] when it
    /// finds no video.
    pub fn open(path: &Path) -> Result<Self, SourceError> {
        Self::open_with(path, OsStr::new("ffmpeg"))
    }

    fn open_with(path: &Path, program: &OsStr) -> Result<Self, SourceError> {
        let (mut ffmpeg, stdout) = Ffmpeg::start(path, program)
            .map_err(|source| SourceError::FfmpegMissing { path: path.into(), source })?;
        match Y4m::new(BufReader::new(stdout), &path.to_string_lossy()) {
            Ok(frames) => Ok(Self { path: path.into(), ffmpeg, frames }),
            // What ffmpeg says about the file explains more than the missing header does.
            Err(error) => Err(ffmpeg.failure(path, 0).unwrap_or(error)),
        }
    }
}

impl FrameSource for Video {
    fn next_frame(&mut self, frame: &mut Frame) -> Result<bool, SourceError> {
        match self.frames.next_frame(frame) {
            Ok(true) => Ok(true),
            ended => match self.ffmpeg.failure(&self.path, self.frames.frames_read()) {
                Some(error) => Err(error),
                None => ended,
            },
        }
    }
}

/// The running process and what it complains about.
#[derive(Debug)]
struct Ffmpeg {
    child: Child,
    complaints: Option<JoinHandle<String>>,
}

impl Ffmpeg {
    fn start(path: &Path, program: &OsStr) -> std::io::Result<(Self, ChildStdout)> {
        // Names like `12:30.mp4` or `-.mp4` must not be taken for protocols or options.
        let mut input = OsString::new();
        if path.exists() {
            input.push("file:");
        }
        input.push(path);
        let mut child = Command::new(program)
            .args(["-nostdin", "-v", "error", "-i"])
            .arg(input)
            .args(["-pix_fmt", "gray", "-f", "yuv4mpegpipe", "-strict", "-1", "-"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()?;
        let stdout = child.stdout.take().expect("stdout is piped");
        let mut stderr = child.stderr.take().expect("stderr is piped");
        // Read beside the frames: a full pipe of complaints would stop the decoder.
        let complaints = thread::spawn(move || {
            let mut text = Vec::new();
            // A process that dies while writing leaves what it wrote.
            let _ = stderr.read_to_end(&mut text);
            String::from_utf8_lossy(&text).into_owned()
        });
        let complaints = Some(complaints);
        Ok((Self { child, complaints }, stdout))
    }

    /// Waits for the process after its last frame; `None` when it decoded everything.
    fn failure(&mut self, path: &Path, frames: u64) -> Option<SourceError> {
        let status = self.child.wait();
        let complaints = self.complaints.take()?.join().unwrap_or_default();
        // A damaged video ends with status 0 when some of it was decoded: complaints count too.
        let message = match (complaints.lines().rfind(|line| !line.trim().is_empty()), status) {
            (Some(line), _) => line.trim().to_owned(),
            (None, Ok(status)) if status.success() => return None,
            (None, Ok(status)) => format!("it ended with {status}"),
            (None, Err(error)) => format!("{error}"),
        };
        Some(SourceError::Ffmpeg { path: path.into(), frames, message })
    }
}

impl Drop for Ffmpeg {
    fn drop(&mut self) {
        // Both fail only when the process has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;
    use std::{eprintln, fs};

    /// Writes a test video of 20 frames with the given name; `false` where there is no ffmpeg.
    fn test_video(path: &Path) -> bool {
        let made = Command::new("ffmpeg")
            .args(["-v", "error", "-f", "lavfi", "-i", "testsrc=size=64x48:rate=25:duration=0.8"])
            .args(["-c:v", "mpeg4", "-movflags", "faststart"])
            .arg(std::format!("file:{}", path.display()))
            .status();
        let made = made.is_ok_and(|status| status.success());
        if !made {
            eprintln!("skipped: ffmpeg is not installed");
        }
        made
    }

    #[test]
    fn a_video_is_decoded() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("-12:30.mp4");
        if !test_video(&path) {
            return;
        }
        let mut source = Video::open(&path).unwrap();
        let mut frame = Frame::default();
        for number in 0..20 {
            assert!(source.next_frame(&mut frame).unwrap());
            assert_eq!((frame.width, frame.height), (64, 48));
            assert_eq!(frame.time_us, number * 40_000);
        }
        assert!(!source.next_frame(&mut frame).unwrap());
        assert!(!source.next_frame(&mut frame).unwrap());
        // Dropped before its end: must not wait for the rest.
        let mut source = Video::open(&path).unwrap();
        assert!(source.next_frame(&mut frame).unwrap());
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
        let mut source = Video::open(&path).unwrap();
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
        match Video::open(&path).unwrap_err() {
            SourceError::Ffmpeg { frames: 0, message, .. } => assert!(!message.is_empty()),
            SourceError::FfmpegMissing { .. } => eprintln!("skipped: ffmpeg is not installed"),
            other => panic!("{other}"),
        }
    }

    #[test]
    fn a_missing_ffmpeg_is_explained() {
        let error = Video::open_with(Path::new("a.mp4"), OsStr::new("/nowhere/ffmpeg"))
            .unwrap_err()
            .to_string();
        assert!(error.contains("apt install ffmpeg"), "{error}");
    }
}
