//! Motion JPEG: every buffer is a JPEG picture, of which only the luma is decoded.
//!
//! A picture that was cut off has no end and is refused. One that lost something in the middle and still ends in due
//! form cannot be distinguished from a good one by its bytes (the decoder's strict mode noticed 0 to 10 % of such damage, and
//! refused good 4:4:4 pictures); the driver marks the buffer when it knows.

use super::error::Damaged;
use std::vec::Vec;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

const START_OF_IMAGE: [u8; 2] = [0xff, 0xd8];
const END_OF_IMAGE: [u8; 2] = [0xff, 0xd9];
const HUFFMAN_TABLES: u8 = 0xc4;
const START_OF_SCAN: u8 = 0xda;

/// Tells the decoder to use the tables of the standard's annex K, as in AVI files.
const AVI: [u8; 18] = *b"\xff\xe0\x00\x10AVI1\0\0\0\0\0\0\0\0\0\0";

/// A decoder with memory of its own.
#[derive(Debug, Default)]
pub struct MjpegDecoder {
    completed: Vec<u8>,
}

impl MjpegDecoder {
    /// Fills `pixels` with the luma of a picture that must be of `size`, width and height.
    ///
    /// JPEG has the full range of grey. Many cameras leave out the Huffman tables, which are then the standard's.
    pub fn decode(
        &mut self,
        bytes: &[u8],
        size: (usize, usize),
        pixels: &mut [u8],
    ) -> Result<(), Damaged> {
        // Behind the end there may be padding.
        let end = bytes.windows(2).rposition(|pair| pair == END_OF_IMAGE).ok_or(Damaged)?;
        let picture = bytes.get(..end + END_OF_IMAGE.len()).ok_or(Damaged)?;
        let picture = if has_huffman_tables(picture).ok_or(Damaged)? {
            picture
        } else {
            self.completed.clear();
            self.completed.extend(START_OF_IMAGE);
            self.completed.extend(AVI);
            self.completed.extend(picture.iter().skip(START_OF_IMAGE.len()));
            &self.completed
        };
        let options = DecoderOptions::default()
            .set_strict_mode(false)
            .jpeg_set_out_colorspace(ColorSpace::Luma);
        let mut decoder = JpegDecoder::new_with_options(ZCursor::new(picture), options);
        decoder.decode_headers().map_err(|_| Damaged)?;
        if decoder.dimensions() != Some(size) {
            return Err(Damaged);
        }
        decoder.decode_into(pixels).map_err(|_| Damaged)
    }
}

/// Whether there are Huffman tables before the first scan; `None` where this is no JPEG picture.
fn has_huffman_tables(picture: &[u8]) -> Option<bool> {
    let mut rest = picture.strip_prefix(&START_OF_IMAGE)?;
    loop {
        match *rest {
            // Any number of these may stand before a marker.
            [0xff, 0xff, ..] => rest = rest.get(1..)?,
            [0xff, HUFFMAN_TABLES, ..] => return Some(true),
            [0xff, START_OF_SCAN, ..] => return Some(false),
            [0xff, _, high, low, ..] => {
                rest = rest.get(2 + usize::from(u16::from_be_bytes([high, low]))..)?;
            }
            _ => return None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::codecs::jpeg::JpegEncoder;
    use image::{ExtendedColorType, GrayImage, RgbImage};
    use proptest::prelude::*;
    use std::path::Path;
    use std::process::{Command, Stdio};
    use std::{eprintln, format, fs, vec};

    const SIZE: (usize, usize) = (52, 36);

    fn decode(bytes: &[u8]) -> Result<Vec<u8>, Damaged> {
        let mut pixels = vec![0; SIZE.0 * SIZE.1];
        MjpegDecoder::default().decode(bytes, SIZE, &mut pixels).map(|()| pixels)
    }

    /// A ramp in every colour.
    fn colours() -> RgbImage {
        RgbImage::from_fn(SIZE.0 as u32, SIZE.1 as u32, |x, y| {
            image::Rgb([(x * 4) as u8, (y * 7) as u8, 255 - (x * 2 + y) as u8])
        })
    }

    fn encoded() -> Vec<u8> {
        let mut bytes = Vec::new();
        JpegEncoder::new_with_quality(&mut bytes, 95).encode_image(&colours()).unwrap();
        bytes
    }

    /// Luma of JFIF, from its definition.
    fn luma(picture: &RgbImage) -> Vec<u8> {
        let luma = |[r, g, b]: [f64; 3]| 0.299 * r + 0.587 * g + 0.114 * b;
        picture.pixels().map(|pixel| luma(pixel.0.map(f64::from)).round() as u8).collect()
    }

    fn largest_difference(a: &[u8], b: &[u8]) -> u8 {
        assert_eq!(a.len(), b.len());
        a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max().unwrap()
    }

    /// Without the Huffman tables: those of the encoder are the standard's.
    fn without_tables(bytes: &[u8]) -> Vec<u8> {
        let mut rest = &bytes[2..];
        let mut kept = bytes[..2].to_vec();
        while rest[1] != START_OF_SCAN {
            let (segment, after) =
                rest.split_at(2 + usize::from(u16::from_be_bytes([rest[2], rest[3]])));
            if segment[1] != HUFFMAN_TABLES {
                kept.extend(segment);
            }
            rest = after;
        }
        kept.extend(rest);
        kept
    }

    #[test]
    fn colour_becomes_its_luma_in_full_range() {
        assert!(largest_difference(&decode(&encoded()).unwrap(), &luma(&colours())) <= 6);
        let mut grey = GrayImage::new(SIZE.0 as u32, SIZE.1 as u32);
        grey.pixels_mut()
            .enumerate()
            .for_each(|(i, pixel)| pixel.0 = [if i % 52 < 24 { 0 } else { 255 }]);
        let mut bytes = Vec::new();
        let encoder = JpegEncoder::new_with_quality(&mut bytes, 100);
        grey.write_with_encoder(encoder).unwrap();
        let pixels = decode(&bytes).unwrap();
        assert_eq!((pixels[0], pixels[51]), (0, 255));
    }

    #[test]
    fn missing_tables_and_padding_are_no_damage() {
        let bytes = encoded();
        let short = without_tables(&bytes);
        assert!(short.len() + 400 < bytes.len());
        assert_eq!(decode(&short), decode(&bytes));
        let padded = [&bytes[..], &[0; 300]].concat();
        assert_eq!(decode(&padded), decode(&bytes));
        let mut filled = bytes.clone();
        filled.splice(2..2, [0xff; 3]);
        assert_eq!(has_huffman_tables(&filled), Some(true));
    }

    #[test]
    fn another_size_is_damage() {
        let mut bytes = Vec::new();
        let pixels = [200; 64 * 64];
        JpegEncoder::new(&mut bytes).encode(&pixels, 64, 64, ExtendedColorType::L8).unwrap();
        assert_eq!(decode(&bytes), Err(Damaged));
    }

    #[test]
    fn cut_off_anywhere_is_damage() {
        let bytes = encoded();
        for length in 0..bytes.len() {
            assert_eq!(decode(&bytes[..length]), Err(Damaged), "after {length} bytes");
        }
    }

    /// Standard output of ffmpeg with these arguments; `None` without ffmpeg.
    fn ffmpeg(arguments: &str, file: &Path) -> Option<Vec<u8>> {
        let mut command = Command::new("ffmpeg");
        command.args(["-v", "error", "-nostdin"]);
        let file = file.to_str().unwrap();
        command.args(arguments.split(' ').map(|word| if word == "FILE" { file } else { word }));
        let output = command.stderr(Stdio::inherit()).output().ok()?;
        assert!(output.status.success());
        Some(output.stdout)
    }

    /// Those of a USB camera are 4:2:2 as a rule.
    #[test]
    fn pictures_of_other_encoders_are_read_as_others_read_them() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("picture.mjpeg");
        for subsampling in ["yuvj422p", "yuvj420p", "yuvj444p"] {
            let encode = format!(
                "-f lavfi -i testsrc=s=52x36 -frames:v 1 -pix_fmt {subsampling} -q:v 3 -f mjpeg -"
            );
            let Some(bytes) = ffmpeg(&encode, &file) else {
                eprintln!("skipped: no ffmpeg");
                return;
            };
            fs::write(&file, &bytes).unwrap();
            let luma = ffmpeg("-f mjpeg -i FILE -vf extractplanes=y -f rawvideo -", &file).unwrap();
            assert!(luma.iter().max().unwrap() - luma.iter().min().unwrap() > 200);
            let pixels = decode(&bytes).unwrap();
            assert!(largest_difference(&pixels, &luma) <= 2, "{subsampling}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(256))]

        #[test]
        fn disturbed_pictures_are_decoded_or_refused(
            changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
            tables in any::<bool>(),
        ) {
            let mut bytes = if tables { encoded() } else { without_tables(&encoded()) };
            for (index, value) in changes {
                *index.get_mut(&mut bytes) = value;
            }
            let _ = decode(&bytes);
        }

        #[test]
        fn random_bytes_are_refused(mut bytes in prop::collection::vec(any::<u8>(), 0..400)) {
            bytes.splice(..bytes.len().min(2), START_OF_IMAGE);
            bytes.extend(END_OF_IMAGE);
            prop_assert_eq!(decode(&bytes), Err(Damaged));
        }
    }
}
