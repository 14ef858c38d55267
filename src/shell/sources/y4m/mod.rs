//! Uncompressed video: YUV4MPEG2, what `ffmpeg`, mjpegtools and x264 pipe to each other.
//!
//! An own reader because the `y4m` crate reports a stream cut inside a frame as its regular end.

mod header;

pub use header::{Header, RawLayout};

use super::interlaced::keep_earlier;
use super::{Frame, FrameSource, SourceError, frame_time_us};
use std::borrow::ToOwned;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;
use std::string::String;
use std::vec::Vec;

/// Longest header line, bytes; longer ones are damage.
const LINE: u64 = 1024;
/// Frames a second where the stream does not say.
const RATE: (u32, u32) = (25, 1);

/// A y4m stream: `mono`, 4:1:1, 4:2:0, 4:2:2 and 4:4:4 with 8 to 16 bits; only the luma is kept, of interlaced frames the
/// earlier field.
///
/// Frames are full-range grey of 8 bits: `mono` is taken as it is, the luma of a colour stream is expanded
/// from 16..=235 (times 2^(bits - 8)) to 0..=255 unless its header says `XCOLORRANGE=FULL`.
#[derive(Debug)]
pub struct Y4m<R> {
    reader: R,
    name: String,
    header: Header,
    read: u64,
    /// Samples of more than 8 bits of one frame.
    wide: Vec<u8>,
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
            Ok(Some(line)) => Header::parse(&line),
            Ok(None) => Err("it ends before the first line is complete".to_owned()),
            Err(source) => {
                return Err(SourceError::Read { name: name.to_owned(), frame: 1, source });
            }
        };
        let header =
            header.map_err(|reason| SourceError::Header { name: name.to_owned(), reason })?;
        Ok(Self::with_header(reader, name, header))
    }

    /// The frames of a stream whose header is known; `name` stands for the stream in errors.
    pub fn with_header(reader: R, name: &str, header: Header) -> Self {
        Self { reader, name: name.to_owned(), header, read: 0, wide: Vec::new() }
    }

    /// Number of frames read.
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

    fn read_frame_line(&mut self) -> Result<(), SourceError> {
        let line = read_line(&mut self.reader).map_err(|source| self.read_failed(source))?;
        match line.as_deref() {
            Some(line) if line == b"FRAME" || line.starts_with(b"FRAME ") => Ok(()),
            Some(_) => {
                Err(SourceError::FrameHeader { name: self.name.clone(), frame: self.read + 1 })
            }
            None => Err(self.read_failed(io::ErrorKind::UnexpectedEof.into())),
        }
    }

    /// Reads the planes of one frame into `pixels`.
    fn read_planes(&mut self, pixels: &mut Vec<u8>) -> io::Result<()> {
        let Self { reader, header, wide, .. } = self;
        pixels.resize(header.width * header.height, 0);
        if header.depth > 8 {
            wide.resize(2 * pixels.len(), 0);
            reader.read_exact(wide)?;
            for (pixel, sample) in pixels.iter_mut().zip(wide.as_chunks().0) {
                *pixel = header.grey(u16::from_le_bytes(*sample));
            }
        } else {
            reader.read_exact(pixels)?;
            if header.limited_range {
                for pixel in pixels.iter_mut() {
                    *pixel = expand(*pixel);
                }
            }
        }
        let skipped = io::copy(&mut reader.by_ref().take(header.skipped), &mut io::sink())?;
        if skipped < header.skipped {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        if let Some(earlier) = header.interlaced {
            keep_earlier(pixels, header.width, earlier);
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
        if self.header.framed {
            self.read_frame_line()?;
        }
        // The size first: a frame cut off half way still has the pixels its size promises.
        frame.width = self.header.width;
        frame.height = self.header.height;
        self.read_planes(&mut frame.pixels).map_err(|source| self.read_failed(source))?;
        frame.time_us = frame_time_us(self.read, self.header.rate.unwrap_or(RATE));
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

/// Limited-range luma (16 black, 235 white) to full range, rounded.
#[expect(clippy::cast_possible_truncation, reason = "219 parts of 219 are 255")]
pub(crate) fn expand(luma: u8) -> u8 {
    let above = u32::from(luma.clamp(16, 235)) - 16;
    ((above * 255 + 109) / 219) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::format;
    use std::string::String;
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
        for (layout, chroma) in
            [("mono", 0), ("411", 6), ("420", 4), ("420jpeg", 4), ("422", 6), ("444", 18)]
        {
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
    fn samples_of_more_bits() {
        // (depth, sample, full range, limited range)
        for (depth, sample, full, limited) in [
            (10u32, 0u16, 0, 0),
            (10, 1023, 255, 255),
            (10, 64, 16, 0),
            (10, 940, 234, 255),
            (10, 502, 125, 128),
            (16, 0x8000, 128, 130),
            (16, u16::MAX, 255, 255),
            (12, 4095, 255, 255),
        ] {
            for (layout, wanted) in [("mono", full), ("420p", limited), ("444p", limited)] {
                let chroma = match layout {
                    "mono" => 0,
                    "420p" => 2,
                    _ => 4,
                };
                let mut bytes = std::vec::Vec::new();
                (0..2 + chroma).for_each(|_| bytes.extend(sample.to_le_bytes()));
                let stream =
                    stream(&format!("W2 H1 F0:0 C{layout}{depth}"), &[bytes.clone(), bytes]);
                let mut frame = Frame::default();
                let mut source = open(&stream).unwrap();
                for time_us in [0, 40_000] {
                    assert!(source.next_frame(&mut frame).unwrap());
                    assert_eq!(
                        (frame.pixels.as_slice(), frame.time_us),
                        (&[wanted; 2][..], time_us)
                    );
                }
                assert!(!source.next_frame(&mut frame).unwrap());
            }
        }
    }

    #[test]
    fn of_interlaced_frames_the_earlier_field_is_kept() {
        for (field, wanted) in [("It", [10, 20, 30]), ("Ib", [0, 0, 0]), ("Ip", [10, 0, 30])] {
            let bytes = stream(&format!("W1 H3 F25:1 {field} Cmono"), &[vec![10, 0, 30]]);
            let mut frame = Frame::default();
            assert!(open(&bytes).unwrap().next_frame(&mut frame).unwrap());
            assert_eq!(frame.pixels, wanted, "{field}");
        }
    }

    #[test]
    fn frames_without_headers() {
        for (layout, behind, first) in
            [(RawLayout::Grey, 0, 16), (RawLayout::I420, 4, 0), (RawLayout::Nv12, 4, 0)]
        {
            let mut bytes = vec![16, 235, 16];
            bytes.extend(vec![99; behind]);
            let bytes = [bytes.clone(), bytes].concat();
            let mut source = Y4m::with_header(&bytes[..], "raw", Header::raw(layout, 3, 1));
            let mut frame = Frame::default();
            for _ in 0..2 {
                assert!(source.next_frame(&mut frame).unwrap());
                assert_eq!(frame.pixels[0], first);
            }
            assert!(!source.next_frame(&mut frame).unwrap());
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
            ("W2 H2 F0:5", "frame rate F is '0:5'"),
            ("W2 H2 F30", "frame rate F is '30'"),
            ("W2 H2 C420p8", "colour space C is '420p8'"),
            ("W2 H2 Cmono17", "colour space C is 'mono17'"),
            ("W2 H2 C422jpeg", "colour space C is '422jpeg'"),
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
