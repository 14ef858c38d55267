//! Uncompressed video: YUV4MPEG2, what `ffmpeg`, mjpegtools and x264 pipe to each other.
//!
//! An own reader because the `y4m` crate reports a stream cut inside a frame as its regular end.

use super::{Frame, FrameSource, SourceError, frame_time_us};
use core::str;
use std::borrow::ToOwned;
use std::format;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;
use std::string::String;
use std::vec::Vec;

/// Longest header line, bytes; longer ones are damage.
const LINE: u64 = 1024;
/// Largest width and height, pixels.
const SIDE: usize = 16_384;

/// A y4m stream: `mono`, 4:2:0, 4:2:2 and 4:4:4 with 8 bits; only the luma is kept.
///
/// Frames are full-range grey: `mono` is taken as it is, the luma of a colour stream is expanded
/// from 16..=235 to 0..=255 unless its header says `XCOLORRANGE=FULL`.
#[derive(Debug)]
pub struct Y4m<R> {
    reader: R,
    name: String,
    header: Header,
    read: u64,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Header {
    width: usize,
    height: usize,
    rate: (u32, u32),
    /// Bytes of both chroma planes together.
    chroma: u64,
    limited_range: bool,
}

impl Y4m<BufReader<File>> {
    /// Opens a file.
    ///
    /// # Errors
    /// [`SourceError::Open`] or [`SourceError::Header`].
    pub fn open(path: &Path) -> Result<Self, SourceError> {
        let file =
            File::open(path).map_err(|source| SourceError::Open { path: path.into(), source })?;
        Self::new(BufReader::new(file), &path.to_string_lossy())
    }
}

impl<R: BufRead> Y4m<R> {
    /// Reads the header; `name` stands for the stream in errors.
    ///
    /// # Errors
    /// [`SourceError::Header`] with the field that is not understood, [`SourceError::Read`].
    pub fn new(mut reader: R, name: &str) -> Result<Self, SourceError> {
        let header = match read_line(&mut reader) {
            Ok(Some(line)) => parse_header(&line),
            Ok(None) => Err("it ends before the first line is complete".to_owned()),
            Err(source) => {
                return Err(SourceError::Read { name: name.to_owned(), frame: 1, source });
            }
        };
        let header =
            header.map_err(|reason| SourceError::Header { name: name.to_owned(), reason })?;
        Ok(Self { reader, name: name.to_owned(), header, read: 0 })
    }

    /// How many frames were read so far.
    pub fn frames_read(&self) -> u64 {
        self.read
    }

    fn read_failed(&self, source: io::Error) -> SourceError {
        let (name, frame) = (self.name.clone(), self.read + 1);
        if source.kind() == io::ErrorKind::UnexpectedEof {
            SourceError::CutOff { name, frame }
        } else {
            SourceError::Read { name, frame, source }
        }
    }

    /// Reads the planes of one frame into `pixels`.
    fn read_planes(&mut self, pixels: &mut Vec<u8>) -> io::Result<()> {
        pixels.resize(self.header.width * self.header.height, 0);
        self.reader.read_exact(pixels)?;
        let chroma = self.header.chroma;
        let skipped = io::copy(&mut self.reader.by_ref().take(chroma), &mut io::sink())?;
        if skipped < chroma {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        if self.header.limited_range {
            for pixel in pixels {
                *pixel = expand(*pixel);
            }
        }
        Ok(())
    }
}

impl<R: BufRead> FrameSource for Y4m<R> {
    fn next_frame(&mut self, frame: &mut Frame) -> Result<bool, SourceError> {
        let at_end = match self.reader.fill_buf() {
            Ok(bytes) => bytes.is_empty(),
            Err(source) => return Err(self.read_failed(source)),
        };
        if at_end {
            return if self.read == 0 {
                Err(SourceError::NoFrames { name: self.name.clone() })
            } else {
                Ok(false)
            };
        }
        let line = read_line(&mut self.reader).map_err(|source| self.read_failed(source))?;
        match line.as_deref() {
            Some(b"FRAME") => {}
            Some(line) if line.starts_with(b"FRAME ") => {}
            Some(_) => {
                return Err(SourceError::FrameHeader {
                    name: self.name.clone(),
                    frame: self.read + 1,
                });
            }
            None => return Err(self.read_failed(io::ErrorKind::UnexpectedEof.into())),
        }
        // The size first: a frame cut off half way still has the pixels its size promises.
        frame.width = self.header.width;
        frame.height = self.header.height;
        self.read_planes(&mut frame.pixels).map_err(|source| self.read_failed(source))?;
        frame.time_us = frame_time_us(self.read, self.header.rate);
        self.read += 1;
        Ok(true)
    }
}

/// A line without its end; `None` when the stream ends first.
fn read_line(reader: &mut impl BufRead) -> io::Result<Option<Vec<u8>>> {
    let mut line = Vec::new();
    reader.take(LINE).read_until(b'\n', &mut line)?;
    Ok(match line.pop() {
        Some(b'\n') => Some(line),
        // A line that does not end within the limit is no header either: keep it, it is refused.
        Some(last) if line.len() as u64 + 1 == LINE => {
            line.push(last);
            Some(line)
        }
        _ => None,
    })
}

fn parse_header(line: &[u8]) -> Result<Header, String> {
    let fields = line
        .strip_prefix(b"YUV4MPEG2")
        .ok_or("it does not begin with YUV4MPEG2; is this a .y4m file?")?;
    let fields = str::from_utf8(fields).map_err(|_| "it is not text")?;
    let (mut width, mut height, mut rate) = (None, None, (25, 1));
    let (mut chroma_format, mut full_range) = ("420", false);
    for field in fields.split_ascii_whitespace() {
        match field.split_at_checked(1) {
            Some(("W", value)) => width = Some(parse_side("width W", value)?),
            Some(("H", value)) => height = Some(parse_side("height H", value)?),
            Some(("F", value)) => rate = parse_rate(value)?,
            Some(("C", value)) => chroma_format = value,
            Some(("X", value)) => full_range |= value.eq_ignore_ascii_case("COLORRANGE=FULL"),
            // Interlacing, aspect and comments do not change the samples.
            _ => {}
        }
    }
    let width = width.ok_or("width W is missing")?;
    let height = height.ok_or("height H is missing")?;
    let half_width = width.div_ceil(2);
    let plane = match chroma_format {
        "mono" => 0,
        "420" | "420jpeg" | "420mpeg2" | "420paldv" => half_width * height.div_ceil(2),
        "422" => half_width * height,
        "444" => width * height,
        other => {
            return Err(format!(
                "colour space C is '{other}', expected mono, 420, 422 or 444 with 8 bits; convert it with ffmpeg -pix_fmt gray"
            ));
        }
    };
    Ok(Header {
        width,
        height,
        rate,
        chroma: 2 * plane as u64,
        limited_range: chroma_format != "mono" && !full_range,
    })
}

fn parse_side(field: &str, value: &str) -> Result<usize, String> {
    value
        .parse()
        .ok()
        .filter(|side| (1..=SIDE).contains(side))
        .ok_or_else(|| format!("{field} is '{value}', expected a number from 1 to {SIDE}"))
}

fn parse_rate(value: &str) -> Result<(u32, u32), String> {
    let rate =
        value.split_once(':').and_then(|(num, den)| Some((num.parse().ok()?, den.parse().ok()?)));
    match rate {
        // What the format says for "unknown".
        Some((0, 0)) => Ok((25, 1)),
        Some((num, den)) if num > 0 && den > 0 => Ok((num, den)),
        _ => Err(format!("frame rate F is '{value}', expected for example 30:1")),
    }
}

/// Limited-range luma (16 black, 235 white) to full range, rounded.
pub(crate) fn expand(luma: u8) -> u8 {
    let above = u32::from(luma.clamp(16, 235)) - 16;
    ((above * 255 + 109) / 219) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;
    use std::vec;

    fn stream(header: &str, frames: &[Vec<u8>]) -> Vec<u8> {
        let mut bytes = format!("YUV4MPEG2 {header}\n").into_bytes();
        for frame in frames {
            bytes.extend_from_slice(b"FRAME\n");
            bytes.extend_from_slice(frame);
        }
        bytes
    }

    fn open(bytes: &[u8]) -> Result<Y4m<&[u8]>, SourceError> {
        Y4m::new(bytes, "t.y4m")
    }

    fn error(bytes: &[u8]) -> String {
        let mut frame = Frame::default();
        open(bytes)
            .and_then(|mut source| {
                while source.next_frame(&mut frame)? {}
                Ok(())
            })
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn luma_of_every_layout() {
        for (layout, chroma) in [("mono", 0), ("420", 4), ("420jpeg", 4), ("422", 6), ("444", 18)] {
            let frames: Vec<Vec<u8>> = (0..3)
                .map(|number| {
                    let mut bytes: Vec<u8> = (0..9).map(|i| 100 + number * 10 + i).collect();
                    bytes.extend(vec![
                        77;
                        chroma
                            * if layout == "422" || layout.starts_with("420") {
                                2
                            } else {
                                1
                            }
                    ]);
                    bytes
                })
                .collect();
            let bytes = stream(&format!("W3 H3 F25:1 Ip A1:1 C{layout} XCOLORRANGE=FULL"), &frames);
            let mut source = open(&bytes).unwrap();
            let mut frame = Frame::default();
            for (number, expected) in frames.iter().enumerate() {
                assert!(source.next_frame(&mut frame).unwrap(), "{layout}");
                assert_eq!(frame.pixels, expected[..9]);
                assert_eq!(frame.time_us, number as i64 * 40_000);
            }
            assert!(!source.next_frame(&mut frame).unwrap());
        }
    }

    #[test]
    fn limited_range_is_expanded() {
        let bytes = stream("W4 H1 F30:1 C444", &[vec![0, 16, 235, 126, 1, 2, 3, 4, 5, 6, 7, 8]]);
        let mut frame = Frame::default();
        open(&bytes).unwrap().next_frame(&mut frame).unwrap();
        assert_eq!(frame.pixels, [0, 0, 255, 128]);
        for luma in 0..=255 {
            let exact = ((f64::from(luma) - 16.0) * 255.0 / 219.0).clamp(0.0, 255.0);
            assert_eq!(expand(luma), exact.round() as u8);
        }
    }

    #[test]
    fn a_cut_is_told_from_the_end() {
        let bytes = stream("W3 H2 F30:1 Cmono", &[vec![1; 6], vec![2; 6]]);
        let second = bytes.len() - 12;
        for cut in second + 1..bytes.len() {
            let mut source = open(&bytes[..cut]).unwrap();
            let mut frame = Frame::default();
            assert!(source.next_frame(&mut frame).unwrap());
            let error = source.next_frame(&mut frame).unwrap_err().to_string();
            assert!(error.starts_with("t.y4m: cut off inside frame 2; the 1 complete"), "{error}");
        }
        let colour = stream("W2 H2 F30:1 C420", &[vec![1; 6]]);
        assert!(error(&colour[..colour.len() - 1]).contains("cut off inside frame 1"));
    }

    #[test]
    fn bad_headers_name_the_field() {
        for (header, reason) in [
            ("H2 F30:1", "width W is missing"),
            ("W2", "height H is missing"),
            ("W0 H2", "width W is '0', expected a number from 1 to 16384"),
            ("Wx H2", "width W is 'x'"),
            ("W99999999999999999999 H2", "width W is"),
            ("W2 H-2", "height H is '-2'"),
            ("W2 H2 F30:0", "frame rate F is '30:0'"),
            ("W2 H2 F30", "frame rate F is '30'"),
            ("W2 H2 C420p10", "colour space C is '420p10'"),
        ] {
            let found = error(&stream(header, &[]));
            assert!(found.starts_with("t.y4m: y4m header: ") && found.contains(reason), "{found}");
        }
        assert!(error(b"RIFF1234\n").contains("does not begin with YUV4MPEG2"));
        assert!(error(b"YUV4MPEG2 W2").contains("ends before the first line"));
        assert!(error(&[b'Y'; 3000]).contains("does not begin with YUV4MPEG2"));
        assert!(error(b"").contains("ends before the first line"));
        assert!(error(&stream("W2 H2", &[])).contains("no frame in it"));
    }

    #[test]
    fn damage_between_frames_is_named() {
        let mut bytes = stream("W2 H2 F30:1 Cmono", &[vec![1; 4]]);
        bytes.extend_from_slice(b"FRAMES\n1234");
        assert!(error(&bytes).contains("frame 2 does not begin with FRAME"));
    }

    proptest::proptest! {
        #[test]
        fn nothing_panics(place in 0usize..60, value: u8, cut in 0usize..80) {
            let mut bytes = stream("W3 H2 F30:1 Ip A1:1 C420jpeg", &[vec![9; 10], vec![8; 10]]);
            if let Some(byte) = bytes.get_mut(place) {
                *byte = value;
            }
            bytes.truncate(cut);
            let mut frame = Frame::default();
            if let Ok(mut source) = open(&bytes) {
                while let Ok(true) = source.next_frame(&mut frame) {
                    assert_eq!(frame.pixels.len(), frame.width * frame.height);
                }
            }
        }
    }
}
