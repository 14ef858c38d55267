//! A folder of pictures, one frame each.

use super::{Frame, FrameSource, SourceError, frame_time_us, has_extension, times};
use crate::shell::support::text::read_text;
use core::cmp::Ordering;
use std::fs;
use std::path::{Path, PathBuf};
use std::vec::Vec;

const EXTENSIONS: [&str; 4] = ["png", "jpg", "jpeg", "pgm"];
/// Frames a second as a fraction where nothing says how fast pictures were taken.
const RATE: (u32, u32) = (30, 1);

/// The PNG, JPEG and PGM pictures of a folder in natural order (`2.png` before `10.png`); colour is converted to luma.
///
/// Their times are those of `times.csv` in the folder; else they have the rate that the user gives, else `fps` of the
/// `camera.json` in the folder or beside it, else 30 frames a second.
#[derive(Debug)]
pub struct Folder {
    pictures: Vec<PathBuf>,
    times: Option<Vec<i64>>,
    rate: (u32, u32),
    next: usize,
    size: Option<(usize, usize)>,
}

impl Folder {
    /// Lists the pictures of `folder`; files of other kinds and hidden ones are left out.
    ///
    /// # Errors
    /// [`SourceError::Open`] when it cannot be listed, [`SourceError::NoPictures`] when there is none,
    /// [`SourceError::Times`], [`SourceError::Rate`].
    pub fn new(folder: &Path, rate: Option<u32>) -> Result<Self, SourceError> {
        let failed = |source| SourceError::Open { path: folder.into(), source };
        let mut pictures = Vec::new();
        for entry in fs::read_dir(folder).map_err(failed)? {
            let path = entry.map_err(failed)?.path();
            if is_picture(&path) {
                pictures.push(path);
            }
        }
        if pictures.is_empty() {
            return Err(SourceError::NoPictures { path: folder.into() });
        }
        pictures.sort_by(|a, b| {
            let name = |path: &PathBuf| path.file_name().unwrap_or_default().to_os_string();
            natural_order(name(a).as_encoded_bytes(), name(b).as_encoded_bytes())
        });
        let times = times::read(folder, &pictures)?;
        let rate = match rate {
            Some(rate) => (rate.max(1), 1),
            None => rate_beside(folder)?.unwrap_or(RATE),
        };
        Ok(Self { pictures, times, rate, next: 0, size: None })
    }
}

impl Folder {
    /// The pictures in the order of frames.
    pub fn pictures(&self) -> &[PathBuf] {
        &self.pictures
    }
}

impl FrameSource for Folder {
    fn next_frame(&mut self, frame: &mut Frame) -> Result<bool, SourceError> {
        let Some(path) = self.pictures.get(self.next) else {
            return Ok(false);
        };
        let number = self.next as u64 + 1;
        let picture = decode(path).map_err(|source| SourceError::Picture {
            path: path.clone(),
            frame: number,
            source,
        })?;
        let size = (picture.width() as usize, picture.height() as usize);
        let expected = *self.size.get_or_insert(size);
        if size != expected {
            return Err(SourceError::Size { path: path.clone(), frame: number, size, expected });
        }
        (frame.width, frame.height) = size;
        frame.time_us = match &self.times {
            // As many as pictures.
            Some(times) => times.get(self.next).copied().unwrap_or_default(),
            None => frame_time_us(self.next as u64, self.rate),
        };
        frame.pixels = picture.into_raw();
        self.next += 1;
        Ok(true)
    }

    fn frame_count(&self) -> Option<u64> {
        Some(self.pictures.len() as u64)
    }
}

/// `fps` of the `camera.json` in `folder` or the folder that it lies in, thousandths of a frame exact.
fn rate_beside(folder: &Path) -> Result<Option<(u32, u32)>, SourceError> {
    for folder in [Some(folder), folder.parent()].into_iter().flatten() {
        let path = folder.join("camera.json");
        // A file that cannot be read or understood is complained about where its other numbers are needed.
        let Ok(text) = read_text(&path) else { continue };
        let Ok(value) = serde_json::from_str::<serde_json::Value>(&text) else { continue };
        let Some(rate) = value.get("fps") else { continue };
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "1 to 1,000,000"
        )]
        let thousandths = |rate: f64| (rate * 1000.0).round() as u32;
        return match rate.as_f64().filter(|rate| (1e-3..=1e3).contains(rate)) {
            Some(rate) => Ok(Some((thousandths(rate), 1000))),
            None => Err(SourceError::Rate { path, rate: rate.clone() }),
        };
    }
    Ok(None)
}

/// Whether `path` names a picture that [`Folder`] reads.
pub(crate) fn is_picture(path: &Path) -> bool {
    let hidden = path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
    !hidden && has_extension(path, &EXTENSIONS) && path.is_file()
}

/// Decodes by content, not by name.
fn decode(path: &Path) -> Result<image::GrayImage, image::ImageError> {
    Ok(image::ImageReader::open(path)?.with_guessed_format()?.decode()?.into_luma8())
}

/// Compares names so that runs of digits count as numbers.
fn natural_order(a: &[u8], b: &[u8]) -> Ordering {
    let (mut rest_a, mut rest_b) = (a, b);
    loop {
        let ((&first_a, tail_a), (&first_b, tail_b)) =
            match (rest_a.split_first(), rest_b.split_first()) {
                (Some(a), Some(b)) => (a, b),
                // Names that differ in leading zeros only must not count as equal.
                (None, None) => return a.cmp(b),
                (a, b) => return a.is_some().cmp(&b.is_some()),
            };
        let order = if first_a.is_ascii_digit() && first_b.is_ascii_digit() {
            let (digits_a, digits_b) = (take_number(&mut rest_a), take_number(&mut rest_b));
            (digits_a.len(), digits_a).cmp(&(digits_b.len(), digits_b))
        } else {
            (rest_a, rest_b) = (tail_a, tail_b);
            first_a.cmp(&first_b)
        };
        if order.is_ne() {
            return order;
        }
    }
}

/// Takes a run of digits off the front of `text` and gives it without leading zeros.
fn take_number<'a>(text: &mut &'a [u8]) -> &'a [u8] {
    let end = text.iter().position(|byte| !byte.is_ascii_digit()).unwrap_or(text.len());
    let (number, rest) = text.split_at(end);
    *text = rest;
    let zeros = number.iter().take_while(|&&byte| byte == b'0').count();
    number.get(zeros..).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{GrayImage, Luma, Rgb, RgbImage};
    use std::string::ToString;

    fn grey(folder: &Path, name: &str, width: u32, value: u8) {
        GrayImage::from_pixel(width, 5, Luma([value])).save(folder.join(name)).unwrap();
    }

    #[test]
    fn pictures_come_in_natural_order_with_times() {
        let folder = tempfile::tempdir().unwrap();
        grey(folder.path(), "f10.png", 7, 10);
        grey(folder.path(), "f9.PNG", 7, 9);
        grey(folder.path(), "f011.pgm", 7, 11);
        grey(folder.path(), ".f1.png", 7, 1);
        fs::write(folder.path().join("notes.txt"), "no picture").unwrap();
        let mut source = Folder::new(folder.path(), None).unwrap();
        assert_eq!(source.frame_count(), Some(3));
        let mut frame = Frame::default();
        for (value, time_us) in [(9, 0), (10, 33_333), (11, 66_666)] {
            assert!(source.next_frame(&mut frame).unwrap());
            assert_eq!((frame.width, frame.height, frame.time_us), (7, 5, time_us));
            assert_eq!(frame.pixels, [value; 35]);
        }
        assert!(!source.next_frame(&mut frame).unwrap());
    }

    #[test]
    fn the_rate_is_that_of_the_camera_or_of_the_user() {
        let root = tempfile::tempdir().unwrap();
        let frames = root.path().join("frames");
        fs::create_dir(&frames).unwrap();
        grey(&frames, "1.png", 7, 1);
        grey(&frames, "2.png", 7, 1);
        let second = |rate| {
            let mut source = Folder::new(&frames, rate)?;
            let mut frame = Frame::default();
            source.next_frame(&mut frame)?;
            source.next_frame(&mut frame)?;
            Ok::<i64, SourceError>(frame.time_us)
        };
        assert_eq!(second(None).unwrap(), 33_333);
        assert_eq!(second(Some(20)).unwrap(), 50_000);
        // Beside the folder, as in a clip; with a byte-order mark, as some editors write it.
        fs::write(root.path().join("camera.json"), "\u{feff}{\"fps\": 10, \"fx\": 1}").unwrap();
        assert_eq!(second(None).unwrap(), 100_000);
        assert_eq!(second(Some(20)).unwrap(), 50_000);
        fs::write(frames.join("camera.json"), "{\"fps\": 29.97}").unwrap();
        assert_eq!(second(None).unwrap(), 33_366);
        fs::write(frames.join("times.csv"), "\u{feff}1.png,0\r\n2.png,70\r\n").unwrap();
        assert_eq!(second(Some(20)).unwrap(), 70);
        fs::remove_file(frames.join("times.csv")).unwrap();
        for bad in ["0", "-1", "\"x\"", "1e9", "null"] {
            fs::write(frames.join("camera.json"), std::format!("{{\"fps\": {bad}}}")).unwrap();
            let error = second(None).unwrap_err().to_string();
            assert!(
                error.contains("camera.json: fps is ") && error.contains("from 0.001"),
                "{error}"
            );
        }
    }

    #[test]
    fn colour_becomes_luma() {
        let folder = tempfile::tempdir().unwrap();
        RgbImage::from_pixel(4, 4, Rgb([0, 255, 0])).save(folder.path().join("1.jpg")).unwrap();
        let mut frame = Frame::default();
        let mut source = Folder::new(folder.path(), None).unwrap();
        source.next_frame(&mut frame).unwrap();
        assert!(frame.pixels.iter().all(|&luma| (140..220).contains(&luma)));
    }

    #[test]
    fn another_size_in_the_middle_is_named() {
        let folder = tempfile::tempdir().unwrap();
        grey(folder.path(), "1.png", 7, 1);
        grey(folder.path(), "2.png", 8, 1);
        let mut source = Folder::new(folder.path(), None).unwrap();
        let mut frame = Frame::default();
        assert!(source.next_frame(&mut frame).unwrap());
        let error = source.next_frame(&mut frame).unwrap_err().to_string();
        assert!(
            error.ends_with(
                "2.png: frame 2 is 8x5, the frames before are 7x5; all must have one size"
            )
        );
        assert_eq!(frame.pixels, [1; 35], "the frame before stays valid");
    }

    #[test]
    fn a_corrupt_picture_is_named() {
        let folder = tempfile::tempdir().unwrap();
        grey(folder.path(), "1.png", 64, 1);
        let bytes = fs::read(folder.path().join("1.png")).unwrap();
        for (name, bytes) in [("2.png", &bytes[..bytes.len() / 2]), ("3.png", &[])] {
            fs::write(folder.path().join(name), bytes).unwrap();
        }
        let mut frame = Frame::default();
        let mut source = Folder::new(folder.path(), None).unwrap();
        assert!(source.next_frame(&mut frame).unwrap());
        let error = source.next_frame(&mut frame).unwrap_err().to_string();
        assert!(error.contains("2.png: frame 2 cannot be decoded"), "{error}");
        source.next = 2;
        let error = source.next_frame(&mut frame).unwrap_err().to_string();
        assert!(error.contains("3.png: frame 3 cannot be decoded"), "{error}");
    }

    #[test]
    fn an_empty_folder_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let error = Folder::new(folder.path(), None).unwrap_err().to_string();
        assert!(error.contains("no PNG, JPEG or PGM picture"), "{error}");
        assert!(Folder::new(&folder.path().join("missing"), None).is_err());
    }

    proptest::proptest! {
        #[test]
        fn natural_order_is_a_total_order(
            a in "[a0-9]{0,4}", b in "[a0-9]{0,4}", c in "[a0-9]{0,4}",
        ) {
            let order = |x: &str, y: &str| natural_order(x.as_bytes(), y.as_bytes());
            assert_eq!(order(&a, &b), order(&b, &a).reverse());
            assert_eq!(order(&a, &b).is_eq(), a == b);
            if order(&a, &b).is_lt() && order(&b, &c).is_lt() {
                assert!(order(&a, &c).is_lt());
            }
        }

        #[test]
        fn numbers_sort_by_value(a: u32, b: u32) {
            let name = |number| std::format!("frame{number}.png");
            assert_eq!(natural_order(name(a).as_bytes(), name(b).as_bytes()), a.cmp(&b));
        }
    }
}
