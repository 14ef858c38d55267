//! The colours of a source's frames, to draw on: the detector's own sources are grey.
//!
//! The source is read a second time beside the grey one. Pictures whose brightness is not that of the grey frame are out of
//! step with it and are not used.

use super::annotate::ColourPicture;
use crate::shell::sources::{self, Folder, Frame};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::vec;

/// Largest mean difference of brightness between the colour picture and the grey frame, grey levels.
const SAME: f64 = 12.0;
/// Weights of red, green and blue in the brightness of a decoded picture (ITU-R BT.709, as the `image` crate has them).
const OF_PICTURES: [f64; 3] = [0.2126, 0.7152, 0.0722];
/// The same of a video's brightness (ITU-R BT.601).
const OF_VIDEOS: [f64; 3] = [0.299, 0.587, 0.114];
/// One pixel of this number is compared.
const COMPARED: usize = 17;

/// The frames of a source in colour.
#[derive(Debug)]
pub enum Colours {
    /// The source has no colours, or cannot be read twice: standard input, a simulated flight.
    Grey,
    /// Pictures of a folder, from the next one on.
    Folder(vec::IntoIter<PathBuf>),
    /// A video.
    Video(ColourVideo),
}

/// A video decoded to red, green, blue by `ffmpeg`; the process is ended with it.
#[derive(Debug)]
pub struct ColourVideo {
    child: Child,
    output: ChildStdout,
}

impl Drop for ColourVideo {
    fn drop(&mut self) {
        // Both fail only when the process has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Colours {
    /// Those of what the user names; grey where there are none.
    pub fn open(input: Option<&Path>) -> Self {
        let Some(path) = input.filter(|path| path.exists()) else { return Self::Grey };
        let found = if path.is_dir() && Folder::new(path, None).is_err() {
            sources::clip_input(path).unwrap_or_else(|| path.into())
        } else {
            path.into()
        };
        if found.is_dir() {
            let pictures = Folder::new(&found, None).map(|folder| folder.pictures().to_vec());
            return pictures.map_or(Self::Grey, |pictures| Self::Folder(pictures.into_iter()));
        }
        Self::video(&found)
    }

    fn video(path: &Path) -> Self {
        // Names like `12:30.mp4` must not be taken for protocols.
        let mut input = std::ffi::OsString::from("file:");
        input.push(path);
        let started = Command::new("ffmpeg")
            .args(["-nostdin", "-v", "quiet", "-i"])
            .arg(input)
            .args(["-fps_mode", "passthrough", "-pix_fmt", "rgb24", "-f", "rawvideo", "-"])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn();
        let Ok(mut child) = started else { return Self::Grey };
        match child.stdout.take() {
            Some(output) => Self::Video(ColourVideo { child, output }),
            None => Self::Grey,
        }
    }

    /// Writes the next frame, which is `frame`, over `picture`; in grey where it has no colours, and from there on.
    pub fn next(&mut self, frame: &Frame, picture: &mut ColourPicture) {
        (picture.width, picture.height) = (frame.width, frame.height);
        picture.rgb.resize(frame.pixels.len() * 3, 0);
        let read = match self {
            Self::Grey => None,
            Self::Folder(pictures) => {
                let decoded = pictures.next().is_some_and(|path| decode(&path, picture));
                decoded.then_some(OF_PICTURES)
            }
            Self::Video(video) => {
                video.output.read_exact(&mut picture.rgb).is_ok().then_some(OF_VIDEOS)
            }
        };
        if !read.is_some_and(|weights| in_step(frame, &picture.rgb, weights)) {
            *self = Self::Grey;
            picture.grey(frame);
        }
    }
}

/// Whether it could be decoded and has the size of the picture that it is written over.
fn decode(path: &Path, picture: &mut ColourPicture) -> bool {
    let reader = image::ImageReader::open(path).and_then(|reader| reader.with_guessed_format());
    let Some(decoded) = reader.ok().and_then(|reader| reader.decode().ok()) else { return false };
    let same =
        (decoded.width() as usize, decoded.height() as usize) == (picture.width, picture.height);
    if same {
        picture.rgb = decoded.into_rgb8().into_raw();
    }
    same
}

/// Whether the brightness of the colours is that of the frame.
fn in_step(frame: &Frame, rgb: &[u8], [red, green, blue]: [f64; 3]) -> bool {
    let pairs = frame.pixels.iter().zip(rgb.as_chunks::<3>().0).step_by(COMPARED);
    let (sum, count) = pairs.fold((0.0, 0.0f64), |(sum, count), (&grey, &[r, g, b])| {
        let bright = red * f64::from(r) + green * f64::from(g) + blue * f64::from(b);
        (sum + (bright - f64::from(grey)).abs(), count + 1.0)
    });
    sum <= SAME * count.max(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shell::sources::FrameSource;

    #[test]
    fn pictures_of_a_folder_keep_their_colours() {
        let folder = tempfile::tempdir().unwrap();
        let colour = |n: u8| image::Rgb([200, 40 + n, 10]);
        for n in 0..3 {
            let picture = image::RgbImage::from_pixel(8, 6, colour(n));
            picture.save(folder.path().join(std::format!("{n}.png"))).unwrap();
        }
        let input = folder.path().to_str().unwrap();
        let mut colours = Colours::open(Some(Path::new(input)));
        let mut source = sources::open(input).unwrap();
        let (mut frame, mut picture) = (Frame::default(), ColourPicture::default());
        for n in 0..3 {
            assert!(source.next_frame(&mut frame).unwrap());
            colours.next(&frame, &mut picture);
            assert_eq!(picture.rgb[..3], colour(n).0, "frame {n}");
            assert_eq!(picture.rgb.len(), 8 * 6 * 3);
        }
        // A frame that is another one: grey, and from there on.
        let mut colours = Colours::open(Some(Path::new(input)));
        let dark = Frame { pixels: vec![3; 48], width: 8, height: 6, time_us: 0 };
        colours.next(&dark, &mut picture);
        assert_eq!(picture.rgb, [3; 144]);
        assert!(matches!(colours, Colours::Grey));
        let mut none = Colours::open(Some(Path::new("-")));
        none.next(&frame, &mut picture);
        assert!(picture.rgb[0] == picture.rgb[1]);
    }

    #[test]
    fn videos_keep_their_colours() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a 1:2.mp4");
        let made = Command::new("ffmpeg")
            .args(["-v", "error", "-f", "lavfi", "-i", "color=red:size=32x24:rate=10:duration=0.5"])
            .args(["-c:v", "mpeg4", "-q:v", "2"])
            .arg(std::format!("file:{}", path.display()))
            .status();
        if !made.is_ok_and(|status| status.success()) {
            std::eprintln!("skipped: ffmpeg is not installed");
            return;
        }
        let input = path.to_str().unwrap();
        let mut colours = Colours::open(Some(Path::new(input)));
        let mut source = sources::open(input).unwrap();
        let (mut frame, mut picture) = (Frame::default(), ColourPicture::default());
        let mut frames = 0;
        while source.next_frame(&mut frame).unwrap() {
            colours.next(&frame, &mut picture);
            let [r, g, b] = [0, 1, 2].map(|i| picture.rgb[i]);
            assert!(r > 200 && g < 60 && b < 60, "{r} {g} {b}");
            frames += 1;
        }
        assert_eq!(frames, 5);
    }
}
