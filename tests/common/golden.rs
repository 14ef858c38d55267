//! Frames, model and digest that every machine must agree on. `core` alone: the boards' firmware includes this file.

use lookout::detector::{Buffers, Config, Detections, Detector, Error};
use lookout::image::Image;
use lookout::model::{Method, Model, checksum};
use lookout::stcube::compensation::Alignment;

/// The model: that of `sections` in `mod.rs`, as a file.
pub static MODEL: &[u8] = include_bytes!("golden.lkm");

/// Configuration of the detector: small enough for a microcontroller.
pub const CONFIG: Config = Config {
    max_target: 40,
    candidates: 24,
    ..match Method::of_header(MODEL) {
        Some(method) => Config::for_method(method, 160, 120),
        None => panic!("golden.lkm names no method"),
    }
};

/// Frames of the run.
pub const FRAMES: u32 = 12;

/// [`digest`] of the run.
pub const DIGEST: u32 = 0xfaa4_25cf;

/// A number of 0..256 for a point of a lattice.
fn lattice(x: u32, y: u32) -> u32 {
    let mut h = x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77);
    h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
    (h ^ (h >> 15)) & 255
}

/// Ground at (x, y): lattices of 16 and 4 pixels, interpolated.
fn ground(x: u32, y: u32) -> u32 {
    let octave = |side: u32, salt: u32| {
        let (i, j, fx, fy) = (x / side + salt, y / side, x % side, y % side);
        let upper = lattice(i, j) * (side - fx) + lattice(i + 1, j) * fx;
        let lower = lattice(i, j + 1) * (side - fx) + lattice(i + 1, j + 1) * fx;
        (upper * (side - fy) + lower * fy) / (side * side)
    };
    60 + (octave(16, 0) * 2 + octave(4, 1 << 20)) / 6
}

/// Draws frame `number` of rows of `width` pixels: ground that passes by, and two dark blobs that fly their own ways.
pub fn draw(number: u32, width: usize, pixels: &mut [u8]) {
    let (pan, tilt) = (1000 + 3 * number, 1000 + number + number * number / 16);
    let blobs = [
        ((30 + 7 * number) % 160, (40 + 2 * number) % 120, 6),
        ((140 + 155 * number) % 160, (90 + 119 * number) % 120, 9_u32),
    ];
    for (y, row) in pixels.chunks_exact_mut(width.max(1)).enumerate() {
        for (x, pixel) in row.iter_mut().enumerate() {
            let (x, y) = (x as u32, y as u32);
            let mut value = ground(x + pan, y + tilt);
            for (bx, by, radius) in blobs {
                let (dx, dy) = (x.abs_diff(bx), y.abs_diff(by));
                let inside = (radius * radius).saturating_sub(dx * dx + 3 * dy * dy);
                value = value * 16 / (16 + inside.min(48));
            }
            *pixel = value as u8;
        }
    }
}

/// Takes one number into a digest.
fn mix(digest: u32, number: u32) -> u32 {
    let mut record = [0; 8];
    record[..4].copy_from_slice(&digest.to_le_bytes());
    record[4..].copy_from_slice(&number.to_le_bytes());
    checksum(&record)
}

/// Takes one frame's detections into a digest.
fn fold(digest: u32, detections: &Detections) -> u32 {
    let registered = u32::from(detections.registered);
    let counts = [detections.windows, detections.kept, detections.dropped, registered];
    let digest = counts.into_iter().fold(digest, mix);
    detections.list.iter().fold(digest, |digest, detection| {
        let rect = detection.rect;
        let rect = [rect.x, rect.y, rect.width, rect.height].map(|v| v.to_bits());
        let shifts = detection.shifts.map(|shift| [shift.x.to_bits(), shift.y.to_bits()]);
        let numbers = rect.iter().chain(shifts.as_flattened()).chain([&detection.score]);
        numbers.fold(digest, |digest, &number| mix(digest, number.cast_unsigned()))
    })
}

/// Runs the detector over the frames twice, with cubes that follow the object and cubes that stay with the background,
/// in memory for [`CONFIG`] and one frame; gives digest and number of detections.
///
/// # Errors
/// As [`Detector::new`].
pub fn digest(mut buffers: Buffers<'_>, pixels: &mut [u8]) -> Result<(u32, usize), Error> {
    let (mut digest, mut found) = (0, 0);
    let Ok(model) = Model::parse(MODEL) else { return Ok((0, 0)) };
    let mut detections = Detections::default();
    for alignment in [CONFIG.method.alignment, Alignment::Background] {
        let method = Method { alignment, ..CONFIG.method };
        let mut detector = Detector::new(&model, Config { method, ..CONFIG }, buffers)?;
        for number in 0..FRAMES {
            draw(number, CONFIG.width, pixels);
            let size = Error::FrameSize { width: CONFIG.width, height: CONFIG.height };
            let frame = Image::packed(pixels, CONFIG.width, CONFIG.height).map_err(|_| size)?;
            detector.process(frame, i64::from(number) * 33_333, &mut detections)?;
            digest = fold(digest, &detections);
            found += detections.list.len();
        }
        buffers = detector.release();
    }
    Ok((digest, found))
}
