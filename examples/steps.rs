//! Writes one picture for each step of the method, as AprilTag's debug pictures do for its detector: where a target is
//! lost, the first picture without it names the step.
//!
//! `cargo run --release --example steps -- [FOLDER [INPUT [FRAME]]]` (default: `target/steps`, `sim` for a simulated flight,
//! its frame 45)
//!
//! - `1-registration.png`: differences to the frame 3 frames back, as the camera saw it (left) and after the background's
//!   motion is removed (right), 8 times as bright.
//! - `2-gradients.png`: gradient energy of the cells of the finest level; the hue is the orientation.
//! - `3-scan.png`: share of the cascade's trees that each window passes (white: all), maximum over the levels; proposals.
//! - `4-stcube.png`: the slices of the best proposal's st-cube, newest first, along the background's motion (upper row) and
//!   after Algorithm 1 (lower row).
//! - `5-boxes.png`: proposals (grey) and detections (green).

use fixed::types::I28F4;
use image::{Rgb, RgbImage};
use lookout::channels::front_end::FrameChannels;
use lookout::channels::scale_space::LevelView;
use lookout::channels::window::{PADDING, Position, SLICES, SUBCELL, WINDOW};
use lookout::detector::{Buffers, Config, Detection, Detections, Detector};
use lookout::image::gradient::{CELL, CellRow, ORIENTATIONS};
use lookout::image::{Image, Rect};
use lookout::model::Model;
use lookout::scan::aggregate::{self, MapStrip};
use lookout::scan::cascade::{Candidate, Map};
use lookout::scan::{self, Scratch};
use lookout::shell::simulate::SimulateSettings;
use lookout::shell::simulate::source::Simulated;
use lookout::shell::sources::{self, Frame, FrameSource};
use lookout::stcube::compensation;
use lookout::stcube::cube::Cube;
use std::error::Error;
use std::path::PathBuf;
use std::{env, fs};

/// Frames back of the differences that are shown.
const LAG: usize = 3;

/// Differences are shown this many times as bright.
const GAIN: u8 = 8;

/// Side of a pixel of a slice in its picture.
const ZOOM: u32 = 8;

const GREY: [u8; 3] = [140; 3];
const GREEN: [u8; 3] = [64, 255, 64];

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = env::args().skip(1);
    let folder = PathBuf::from(arguments.next().unwrap_or("target/steps".into()));
    let mut source: Box<dyn FrameSource> = match arguments.next() {
        Some(input) if input != "sim" => sources::open(&input)?,
        _ => Box::new(Simulated::new(&SimulateSettings::default())),
    };
    let wanted: usize = arguments.next().map_or(Ok(45), |number| number.parse())?;
    let mut frames: Vec<Frame> = Vec::new();
    while frames.len() < wanted {
        let mut frame = Frame::default();
        if !source.next_frame(&mut frame)? {
            break;
        }
        frames.push(frame);
    }
    let Some(newest) = frames.last() else { return Err("no frames".into()) };

    let model = Model::parse(include_bytes!("../models/lookout.lkm"))?;
    let threshold = model.calibration().threshold(58_982).unwrap_or(i32::MIN);
    let config = Config { threshold, ..Config::for_model(&model, newest.width, newest.height) };
    let detections = detect(&model, config, &frames)?;

    // The detector's own front end, and the steps behind it one by one.
    let (mut bytes, mut words) = (vec![0; config.bytes_len()], vec![0; config.words_len()]);
    let mut front_end = config.front_end(&mut bytes)?;
    let (last, before) = frames.split_last().ok_or("no frames")?;
    for frame in before {
        front_end.process(frame.view(), &mut || {})?;
    }
    let (channels, bytes) = front_end.process(last.view(), &mut || {})?;
    let scratch = Scratch { bytes, words: &mut words };
    let (proposals, _) =
        scan::search(model.scan(), &channels.pyramid, config.candidates, false, scratch);

    fs::create_dir_all(&folder)?;
    let save = |name: &str, picture: RgbImage| -> Result<(), Box<dyn Error>> {
        let path = folder.join(name);
        picture.save(&path).map_err(|error| format!("{}: {error}", path.display()))?;
        println!("{}: {}x{}", path.display(), picture.width(), picture.height());
        Ok(())
    };
    let older = &frames[frames.len().saturating_sub(LAG + 1)];
    save("1-registration.png", registration(older.view(), last.view(), &channels))?;
    save("2-gradients.png", gradients(&channels.pyramid.level(0).newest.slice.grey))?;
    let mut scanned = response(&model, &channels, (last.width, last.height));
    for proposal in &detections.proposals {
        outline(&mut scanned, proposal, GREEN);
    }
    save("3-scan.png", scanned)?;
    if let Some(proposal) = proposal_of(&proposals, &channels, &detections.list) {
        save("4-stcube.png", stcube(&model, &channels, proposal))?;
    }
    let mut boxes = picture(last.width, last.height, |x, y| [last.view().row(y)[x]; 3]);
    for proposal in &detections.proposals {
        outline(&mut boxes, proposal, GREY);
    }
    for detection in &detections.list {
        outline(&mut boxes, &detection.rect, GREEN);
    }
    save("5-boxes.png", boxes)?;
    let (proposals, found) = (detections.proposals.len(), detections.list.len());
    println!("frame {}: {proposals} proposals, {found} detections", frames.len());
    Ok(())
}

/// Detections in the last of the frames.
fn detect(
    model: &Model<'_>,
    config: Config,
    frames: &[Frame],
) -> Result<Detections, Box<dyn Error>> {
    let (mut bytes, mut words) = (vec![0; config.bytes_len()], vec![0; config.words_len()]);
    let buffers = Buffers { bytes: &mut bytes, words: &mut words };
    let mut detector = Detector::new(model, config, buffers)?;
    let mut detections = Detections::default();
    for frame in frames {
        detector.process(frame.view(), frame.time_us, &mut detections)?;
    }
    Ok(detections)
}

/// A picture of `width` x `height` pixels, each given by its column and row.
fn picture(width: usize, height: usize, colour: impl Fn(usize, usize) -> [u8; 3]) -> RgbImage {
    RgbImage::from_fn(width as u32, height as u32, |x, y| Rgb(colour(x as usize, y as usize)))
}

/// Draws the outline of a box, as far as it is within the picture.
fn outline(picture: &mut RgbImage, rect: &Rect, colour: [u8; 3]) {
    let pixel = |v: I28F4| v.to_num::<i32>();
    let (left, top) = (pixel(rect.x), pixel(rect.y));
    let (right, bottom) = (pixel(rect.x + rect.width), pixel(rect.y + rect.height));
    let across = (left..=right).flat_map(|x| [(x, top), (x, bottom)]);
    let down = (top..=bottom).flat_map(|y| [(left, y), (right, y)]);
    for (x, y) in across.chain(down) {
        let place = u32::try_from(x).ok().zip(u32::try_from(y).ok());
        if let Some(pixel) = place.and_then(|(x, y)| picture.get_pixel_mut_checked(x, y)) {
            *pixel = Rgb(colour);
        }
    }
}

/// Differences between two frames, before and after the background's motion is removed.
fn registration(older: Image<'_>, newest: Image<'_>, channels: &FrameChannels<'_>) -> RgbImage {
    let (width, height) = (newest.width(), newest.height());
    let residual = channels.pyramid.level(0).newest.plain.picture;
    picture(2 * width, height, |x, y| {
        let difference = if x < width {
            newest.row(y)[x].abs_diff(older.row(y)[x])
        } else {
            residual.row(y)[x - width]
        };
        [difference.saturating_mul(GAIN); 3]
    })
}

/// Gradient energies of the cells of a level: brightness by magnitude, hue by orientation.
fn gradients(grey: &Image<'_>) -> RgbImage {
    let (columns, rows) = (grey.width() / CELL, grey.height() / CELL);
    picture(columns, rows, |x, y| {
        let [orientations @ .., _] = CellRow::new(grey, y).cell(x).energies();
        let mut colour = [0u32; 3];
        for (bin, energy) in orientations.into_iter().enumerate() {
            // Six hues around the colour circle: red, yellow, green, cyan, blue, magenta.
            let hue = [[2, 0, 0], [1, 1, 0], [0, 2, 0], [0, 1, 1], [0, 0, 2], [1, 0, 1]];
            for (sum, part) in colour.iter_mut().zip(hue[bin % ORIENTATIONS]) {
                *sum += part * u32::from(energy);
            }
        }
        colour.map(|sum| (2 * sum).min(255) as u8)
    })
}

/// Share of the trees of the scan that windows pass, at the middle of each window's nominal target.
fn response(
    model: &Model<'_>,
    channels: &FrameChannels<'_>,
    (width, height): (usize, usize),
) -> RgbImage {
    let pyramid = &channels.pyramid;
    let noise = scan::noise(pyramid, &mut vec![0; scan::noise_words(pyramid.levels())]);
    let step = pyramid.geometry().history().stride();
    let mut best = vec![0; width * height];
    for level in pyramid.searched() {
        let (columns, rows) = level.level.cells();
        let rows = rows + 2 * PADDING;
        let mut bytes = vec![0; aggregate::strip_bytes(columns, rows)];
        let mut words = vec![0; aggregate::strip_words(columns)];
        let show = |strip: MapStrip<'_>| {
            let map = Map::new(strip, columns);
            let (across, down) = map.windows();
            for (x, y) in (0..down).flat_map(|y| (0..across).map(move |x| (x, y))) {
                let cell = |place: usize| place as i16 - PADDING as i16;
                if x % step == 0 && y % step == 0 {
                    let passed = share_passed(model, &map.values(cell(x), cell(y)));
                    let middle = Position::of_cell(cell(x), cell(y)).centre(level.level.scale);
                    // The cell in the middle of the window, in pixels of the frame.
                    let side = ((CELL * step) as u32 * level.level.scale).div_ceil(1 << 16) as i32;
                    let from = |q8: i32| (q8 >> 8) - side / 2;
                    let (left, top) = (from(middle.0), from(middle.1));
                    for (x, y) in
                        (top..top + side).flat_map(|y| (left..left + side).map(move |x| (x, y)))
                    {
                        if (0..width as i32).contains(&x) && (0..height as i32).contains(&y) {
                            let pixel: &mut u8 = &mut best[y as usize * width + x as usize];
                            *pixel = passed.max(*pixel);
                        }
                    }
                }
            }
        };
        aggregate::strips(&level.newest, &noise, (rows, 0), &mut bytes, &mut words, show);
    }
    picture(width, height, |x, y| [best[y * width + x]; 3])
}

/// Share of the trees of the scan that a window with these feature values passes, 255 for all of them.
fn share_passed(model: &Model<'_>, values: &[u8]) -> u8 {
    let cascade = model.scan();
    let mut tests = 0;
    let _ = cascade.cascade(|feature, threshold| {
        tests += 1;
        u16::from(values[usize::from(feature)]) > threshold
    });
    // Every tree takes as many tests as it is deep.
    let all = cascade.trees().len() * usize::from(cascade.depth());
    (255 * tests / all.max(1)) as u8
}

/// The proposal nearest to the best detection, or the best one.
fn proposal_of<'a>(
    proposals: &'a [Candidate],
    channels: &FrameChannels<'_>,
    detections: &[Detection],
) -> Option<&'a Candidate> {
    let Some(Detection { rect, .. }) = detections.first() else { return proposals.first() };
    let shared = |proposal: &&Candidate| {
        let level = &channels.pyramid.levels()[usize::from(proposal.level)];
        let nominal = level.nominal_box(scan::window(proposal));
        let shared = nominal.intersection(rect);
        // IoU in Q16.
        (shared << 16) / (nominal.area() + rect.area() - shared).max(1)
    };
    proposals.iter().max_by_key(shared)
}

/// The slices of a proposal's cube: along the background, and by Algorithm 1.
fn stcube(model: &Model<'_>, channels: &FrameChannels<'_>, proposal: &Candidate) -> RgbImage {
    let level = channels.pyramid.level(usize::from(proposal.level));
    let (slices, start) = (channels.slices(&level), scan::window(proposal));
    let mut cube = Cube::EMPTY;
    let background = compensation::compensate(&slices, None, start, &mut cube);
    let moved = compensation::compensate(&slices, Some(model.regressors()), start, &mut cube);
    let side = (WINDOW * CELL) as u32 * ZOOM;
    let gap = ZOOM;
    let mut out = RgbImage::new(SLICES as u32 * (side + gap) - gap, 2 * side + gap);
    for (row, path) in (0..).zip([background, moved]) {
        for (age, position) in (0..).zip(path.positions) {
            let (left, top) = (age * (side + gap), row * (side + gap));
            for (x, y) in (0..side).flat_map(|y| (0..side).map(move |x| (x, y))) {
                let grey = pixel(&level, age as usize, position, (x, y));
                // The middle of the window, where the object should be.
                let middle = x == side / 2 || y == side / 2;
                let colour = if middle { [grey / 2, grey / 2 + 60, grey / 2] } else { [grey; 3] };
                out.put_pixel(left + x, top + y, Rgb(colour));
            }
        }
    }
    out
}

/// Grey level of a slice at a pixel of its enlarged window; 0 outside the frame.
fn pixel(level: &LevelView<'_>, age: usize, position: Position, (x, y): (u32, u32)) -> u8 {
    let Some(slice) = level.slices[age] else { return 0 };
    // A window begins at a quarter of a cell.
    let zoom = ZOOM as i32;
    let place = |corner: i32, at: u32| {
        usize::try_from((corner * CELL as i32 * zoom / SUBCELL + at as i32).div_euclid(zoom))
    };
    let (Ok(x), Ok(y)) = (place(position.x, x), place(position.y, y)) else { return 0 };
    if x < slice.grey.width() && y < slice.grey.height() { slice.grey.row(y)[x] } else { 0 }
}
