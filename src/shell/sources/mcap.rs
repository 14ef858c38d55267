//! Pictures in an MCAP file: ROS 2's `sensor_msgs/msg/Image` and `CompressedImage` (CDR), and `foxglove.CompressedImage`
//! (JSON), as `lookout replay --mcap` writes it.
//!
//! Pictures of one topic are read: the first that has any, or TOPIC of `FILE.mcap#TOPIC`.

use super::cdr::Cdr;
use super::{Frame, FrameSource, SourceError};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use image::{DynamicImage, GrayImage, RgbImage, RgbaImage};
use mcap::Message;
use mcap::io::MessageReader;
use mcap::sans_io::LinearReaderOptions;
use serde::Deserialize;
use std::boxed::Box;
use std::format;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;

/// Bytes of a message at most, so that a broken length asks for no more memory.
const MOST_BYTES: usize = 1 << 28;

/// Forms of pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum PictureEncoding {
    Image,
    Compressed,
    Foxglove,
}

/// The pictures of a topic.
pub struct McapSource {
    path: PathBuf,
    messages: Box<MessageReader<BufReader<File>>>,
    /// The topic; none before its first picture where the user names none.
    topic: Option<String>,
    /// Whether the user was shown another topic.
    announced: bool,
    first_ns: Option<i64>,
    size: Option<(usize, usize)>,
    frames: u64,
}

/// `FILE.mcap#TOPIC` in its parts; none for other files.
pub fn parts(path: &Path) -> Option<(PathBuf, Option<String>)> {
    if super::has_extension(path, &["mcap"]) {
        return Some((path.into(), None));
    }
    let (file, topic) = path.to_str()?.rsplit_once(".mcap#")?;
    Some((format!("{file}.mcap").into(), Some(topic.into())))
}

impl McapSource {
    /// Opens a file.
    ///
    /// # Errors
    /// [`SourceError::Open`].
    pub fn open(path: &Path, topic: Option<String>) -> Result<Self, SourceError> {
        let file =
            File::open(path).map_err(|source| SourceError::Open { path: path.into(), source })?;
        let options = LinearReaderOptions::default().with_record_length_limit(MOST_BYTES);
        let reader = MessageReader::new_with_options(BufReader::new(file), options);
        Ok(Self {
            path: path.into(),
            messages: Box::new(reader),
            topic,
            announced: false,
            first_ns: None,
            size: None,
            frames: 0,
        })
    }

    fn wrong(&self, reason: impl ToString) -> SourceError {
        let reason = reason.to_string();
        SourceError::Mcap { path: self.path.clone(), frame: self.frames + 1, reason }
    }

    /// Whether a message is a picture of the topic.
    fn is_wanted(&mut self, message: &Message<'_>) -> Option<PictureEncoding> {
        let form = form(message)?;
        let topic = &message.channel.topic;
        let wanted = self.topic.get_or_insert_with(|| topic.clone());
        if wanted == topic {
            return Some(form);
        }
        if !std::mem::replace(&mut self.announced, true) {
            let file = self.path.display();
            tracing::warn!(
                "{file}: pictures of {wanted} are read; those of {topic}: {file}#{topic}"
            );
        }
        None
    }
}

impl FrameSource for McapSource {
    fn next_frame(&mut self, frame: &mut Frame) -> Result<bool, SourceError> {
        loop {
            let Some(message) = self.messages.next() else {
                if self.frames == 0 {
                    let topic = self.topic.as_deref().map_or(String::new(), |t| format!(" of {t}"));
                    return Err(self.wrong(format!(
                        "no picture{topic} in it: sensor_msgs/msg/Image or CompressedImage in CDR (ROS 2), or \
                         foxglove.CompressedImage in JSON"
                    )));
                }
                return Ok(false);
            };
            let message = message.map_err(|error| self.wrong(error))?;
            let Some(form) = self.is_wanted(&message) else { continue };
            let (mut time_ns, picture) =
                picture(form, &message.data).map_err(|reason| self.wrong(reason))?;
            if time_ns == 0 {
                time_ns = i64::try_from(message.log_time).unwrap_or(i64::MAX);
            }
            let first = *self.first_ns.get_or_insert(time_ns);
            let size = (picture.width() as usize, picture.height() as usize);
            let expected = *self.size.get_or_insert(size);
            self.frames += 1;
            if size != expected {
                let (path, frame) = (self.path.clone(), self.frames);
                return Err(SourceError::Size { path, frame, size, expected });
            }
            *frame = Frame {
                pixels: picture.into_raw(),
                width: size.0,
                height: size.1,
                time_us: time_ns.saturating_sub(first) / 1000,
            };
            return Ok(true);
        }
    }
}

/// The form of a message; none where it is no picture.
fn form(message: &Message<'_>) -> Option<PictureEncoding> {
    let schema = message.channel.schema.as_deref()?;
    match (message.channel.message_encoding.as_str(), schema.name.as_str()) {
        ("cdr", "sensor_msgs/msg/Image") => Some(PictureEncoding::Image),
        ("cdr", "sensor_msgs/msg/CompressedImage") => Some(PictureEncoding::Compressed),
        ("json", "foxglove.CompressedImage") => Some(PictureEncoding::Foxglove),
        _ => None,
    }
}

/// Time in nanoseconds and the grey picture of a message.
fn picture(form: PictureEncoding, data: &[u8]) -> Result<(i64, GrayImage), String> {
    const CUT: &str = "a message that is cut off, or none of its schema";
    let decode = |bytes: &[u8]| image::load_from_memory(bytes).map_err(|e| e.to_string());
    match form {
        PictureEncoding::Foxglove => {
            let found: Foxglove = serde_json::from_slice(data).map_err(|e| e.to_string())?;
            let bytes = STANDARD.decode(found.data).map_err(|e| e.to_string())?;
            let Stamp { sec, nsec } = found.timestamp;
            let time = i64::from(sec) * 1_000_000_000 + i64::from(nsec);
            Ok((time, decode(&bytes)?.into_luma8()))
        }
        PictureEncoding::Compressed => {
            let mut cdr = Cdr::new(data).ok_or(CUT)?;
            let time = cdr.header().ok_or(CUT)?;
            cdr.text().ok_or(CUT)?;
            Ok((time, decode(cdr.bytes().ok_or(CUT)?)?.into_luma8()))
        }
        PictureEncoding::Image => {
            let mut cdr = Cdr::new(data).ok_or(CUT)?;
            let time = cdr.header().ok_or(CUT)?;
            let mut raw = || {
                let (height, width, encoding) = (cdr.word()?, cdr.word()?, cdr.text()?);
                let (big_endian, step) = (cdr.byte()? != 0, cdr.word()? as usize);
                Some((Raw { width, height, encoding, big_endian, step }, cdr.bytes()?))
            };
            let (raw, bytes) = raw().ok_or(CUT)?;
            Ok((time, raw.grey(bytes)?))
        }
    }
}

#[derive(Deserialize)]
struct Foxglove {
    timestamp: Stamp,
    data: String,
}

#[derive(Deserialize)]
struct Stamp {
    sec: u32,
    nsec: u32,
}

/// A picture that is not compressed.
struct Raw {
    width: u32,
    height: u32,
    encoding: String,
    big_endian: bool,
    /// Bytes of a row.
    step: usize,
}

impl Raw {
    fn grey(&self, bytes: &[u8]) -> Result<GrayImage, String> {
        let (width, height) = (self.width as usize, self.height as usize);
        let pixel: usize = match self.encoding.as_str() {
            "mono8" | "8UC1" => 1,
            "mono16" | "16UC1" | "yuv422" | "uyvy" | "yuv422_yuy2" | "yuyv" => 2,
            "rgb8" | "bgr8" | "8UC3" => 3,
            "rgba8" | "bgra8" | "8UC4" => 4,
            other => {
                return Err(format!(
                    "pictures of encoding {other}; give mono8, mono16, rgb8, bgr8, rgba8, bgra8, yuv422 or yuv422_yuy2 \
                     (image_proc makes grey pictures of Bayer ones)"
                ));
            }
        };
        let row = width.saturating_mul(pixel);
        let fits = row > 0
            && height > 0
            && self.step >= row
            && (height - 1).saturating_mul(self.step).saturating_add(row) <= bytes.len();
        if !fits {
            return Err(format!("{width}x{height} pixels do not stand in {} bytes", bytes.len()));
        }
        let rows = bytes.chunks(self.step).take(height).filter_map(|line| line.get(..row));
        // Of two bytes a pixel one is its brightness: the upper one, or that of YUV.
        let one = |place: usize| -> Vec<u8> {
            rows.clone()
                .flat_map(|row| {
                    row.as_chunks::<2>().0.iter().map(move |&[a, b]| if place == 0 { a } else { b })
                })
                .collect()
        };
        let (w, h) = (self.width, self.height);
        let picture = match self.encoding.as_str() {
            "mono8" | "8UC1" => GrayImage::from_raw(w, h, rows.flatten().copied().collect()),
            "mono16" | "16UC1" => GrayImage::from_raw(w, h, one(usize::from(!self.big_endian))),
            "yuv422" | "uyvy" => GrayImage::from_raw(w, h, one(1)),
            "yuv422_yuy2" | "yuyv" => GrayImage::from_raw(w, h, one(0)),
            name => {
                let mut colours: Vec<u8> = rows.flatten().copied().collect();
                // OpenCV's order is that of pictures without a name for it.
                if !name.starts_with("rgb") {
                    colours.chunks_exact_mut(pixel).for_each(|pixel| pixel.swap(0, 2));
                }
                let of_three = |colours| RgbImage::from_raw(w, h, colours).map(DynamicImage::from);
                let of_four = |colours| RgbaImage::from_raw(w, h, colours).map(DynamicImage::from);
                let picture = if pixel == 3 { of_three(colours) } else { of_four(colours) };
                picture.map(DynamicImage::into_luma8)
            }
        };
        picture.ok_or_else(|| format!("{width}x{height} pixels are too many"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn raw(encoding: &str, step: usize, big_endian: bool) -> Raw {
        Raw { width: 2, height: 2, encoding: encoding.into(), big_endian, step }
    }

    #[test]
    fn pictures_become_grey() {
        let grey = |encoding, step, bytes: &[u8]| {
            raw(encoding, step, false).grey(bytes).map(GrayImage::into_raw)
        };
        assert_eq!(grey("mono8", 3, &[1, 2, 0, 3, 4]), Ok([1, 2, 3, 4].into()));
        let two = [9, 1, 9, 2, 9, 3, 9, 4];
        for encoding in ["mono16", "yuv422"] {
            assert_eq!(grey(encoding, 4, &two), Ok([1, 2, 3, 4].into()), "{encoding}");
        }
        assert_eq!(raw("16UC1", 4, true).grey(&two).unwrap().into_raw(), [9; 4]);
        assert_eq!(grey("yuyv", 4, &two), Ok([9; 4].into()));
        let red = [200, 0, 0].repeat(4);
        let (rgb, bgr) = (grey("rgb8", 6, &red).unwrap(), grey("bgr8", 6, &red).unwrap());
        assert!(rgb[0] > bgr[0] && bgr[0] > 0, "{rgb:?} {bgr:?}");
        assert_eq!(grey("rgba8", 8, &[200, 0, 0, 255].repeat(4)).unwrap(), rgb);
        assert!(grey("bayer_rggb8", 2, &[0; 4]).unwrap_err().contains("image_proc"));
        for (step, length) in [(1, 9), (2, 3), (0, 9), (usize::MAX, 9)] {
            let error = grey("mono8", step, &[0; 9][..length]).unwrap_err();
            assert!(error.contains("do not stand in"), "{error}");
        }
    }

    #[test]
    fn names_of_topics() {
        let of = |text: &str| parts(Path::new(text));
        assert_eq!(of("a/b.MCAP"), Some(("a/b.MCAP".into(), None)));
        assert_eq!(of("b.mcap#/camera/raw"), Some(("b.mcap".into(), Some("/camera/raw".into()))));
        assert_eq!(of("b.mp4"), None);
    }
}
