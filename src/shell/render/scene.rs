//! The background of one flight: a texture cut from a picture for the flight's views, with relief and shimmer.

use super::draw::even;
use super::motion::CameraMotion;
use super::noise::fractal;
use super::picture::{BackgroundPicture, PictureKind};
use super::projection::{Projection, Surface};
use super::settings::RenderSettings;
use super::view::Optics;
use crate::shell::support::random::Random;
use crate::shell::support::vectors::{Rotation, WorldVector, atan2, direction, dot, sin_cos};
use std::vec;
use std::vec::Vec;

/// Pixels of texture around what the flight sees.
const MARGIN: f64 = 24.0;
/// Largest side of a texture, pixels.
const LARGEST: f64 = 4096.0;
/// Texture pixels between two places where the source's coordinates are computed exactly.
const STEP: usize = 16;
/// Instants of a flight at which its views are measured, a second.
const MEASURED: f64 = 6.0;
/// Texture pixels a side of a cell of [`BackgroundScene::nearest`].
pub(super) const BLOCK: usize = 32;
/// Largest share of the distance to the nearest surface that a flight may travel.
const TRAVEL: f64 = 0.35;

/// The background of a flight.
#[derive(Debug, Clone)]
pub(super) struct BackgroundScene {
    pub pixels: Vec<u8>,
    pub width: usize,
    pub height: usize,
    /// Relief and amplitude of the shimmer (1/16 pixel) of every 2x2 texture pixels, row by row.
    pub relief: Vec<[u8; 2]>,
    /// Largest relief in and around every [`BLOCK`] x [`BLOCK`] texture pixels.
    pub nearest: Vec<u8>,
    pub projection: Projection,
    /// Whether it has a sky or is seen from above.
    pub kind: PictureKind,
}

/// Correspondence of texture pixels and picture pixels.
enum TextureMapping {
    /// Picture pixel of texture (0, 0), and the picture's steps for one texture pixel to the right and down.
    Affine([f64; 2], [[f64; 2]; 2]),
    /// A panorama turned by this azimuth.
    Turned(f64),
}

impl BackgroundScene {
    /// Cuts the texture of a flight out of `picture`. Draws pitch and speed of `motion` anew so that the flight stays
    /// in it.
    pub(super) fn new(
        picture: &BackgroundPicture,
        kind: PictureKind,
        settings: &RenderSettings,
        view: &Optics,
        random: &mut Random,
    ) -> (Self, CameraMotion) {
        let [wide, high] = view.size;
        let source_size = [picture.width as f64, picture.height as f64];
        // Texture pixels for one frame pixel.
        let density = 1.05;
        let scale = view.focal * density;
        // Picture pixels for one texture pixel: as the picture allows.
        let largest = (source_size[0] / (1.25 * wide)).min(source_size[1] / (1.3 * high)).min(2.2);
        let ratio = random.within(largest.min(0.85), largest.max(0.9));
        let half = 0.62 * high * ratio;
        let middle = if source_size[1] > 2.0 * half {
            random.within(half, source_size[1] - half)
        } else {
            source_size[1] / 2.0
        };
        let pitch = match kind {
            PictureKind::Nadir => -core::f64::consts::FRAC_PI_2 + 0.3 * random.symmetric(),
            PictureKind::Panorama => random.within(-0.45, 0.15),
            _ => atan2(picture.horizon - middle, ratio * scale),
        };
        let may_turn = kind == PictureKind::Panorama;
        let mut motion = CameraMotion::draw(random, settings, pitch, may_turn);
        let structure = even(random, settings.scene.structure);
        let axes = Rotation::new(0.0, pitch, 0.0);
        let (form, scale, reach) = match kind {
            PictureKind::Nadir => {
                motion.raise(8.0);
                let height = motion.height;
                (
                    Surface::Ground(height),
                    scale / height,
                    (0.3 * height).min(14.0) * structure.min(1.0),
                )
            }
            PictureKind::Panorama => (Surface::Sphere(axes), scale, 1.0 / motion.height),
            _ => (Surface::Tangent(axes), scale, 1.0 / motion.height),
        };
        let mut projection = Projection { form, scale, centre: [0.0; 2], reach };
        if kind != PictureKind::Nadir {
            // Rows below the horizon reach down to about half a radian.
            motion.limit_travel(TRAVEL * motion.height / (1.0 + structure));
        }
        let [left, top, right, bottom] = extents(&projection, &motion, view, settings);
        let side = |low: f64, high: f64| {
            ((high - low).min(LARGEST - 2.0 * MARGIN) + 2.0 * MARGIN) as usize
        };
        let (width, height) = (side(left, right), side(top, bottom));
        projection.centre =
            [width as f64 / 2.0 - (left + right) / 2.0, height as f64 / 2.0 - (top + bottom) / 2.0];
        let source = match kind {
            PictureKind::Panorama => {
                TextureMapping::Turned(core::f64::consts::PI * random.symmetric())
            }
            PictureKind::Nadir => {
                let ratio = random.within(0.6, 1.5);
                let turn = direction(core::f64::consts::PI * random.symmetric(), 0.0);
                let steps =
                    [[turn[2] * ratio, turn[0] * ratio], [-turn[0] * ratio, turn[2] * ratio]];
                let start = source_size.map(|s| s * random.within(0.0, 1.0));
                TextureMapping::Affine(start, steps)
            }
            _ => {
                // A photograph seen from its own place; horizon on horizon, any part of its width.
                let spare = (source_size[0] - width as f64 * ratio).max(0.0) / 2.0;
                let middle = source_size[0] / 2.0 + spare * random.symmetric();
                let horizon = projection.centre[1] + scale * tangent(pitch);
                let start =
                    [middle - ratio * width as f64 / 2.0, picture.horizon - ratio * horizon];
                let mirror = if random.chance(0.5) { -1.0 } else { 1.0 };
                let start =
                    [if mirror < 0.0 { source_size[0] - start[0] } else { start[0] }, start[1]];
                TextureMapping::Affine(start, [[mirror * ratio, 0.0], [0.0, ratio]])
            }
        };
        let mut scene = Self {
            pixels: Vec::new(),
            width,
            height,
            relief: Vec::new(),
            nearest: Vec::new(),
            projection,
            kind,
        };
        let sky = scene.sample(picture, &source);
        scene.tone(settings, random);
        scene.shape(&sky, structure, motion.height, settings, random);
        (scene, motion)
    }

    /// Fills the pixels; returns whether every 2x2 of them are sky in the picture's map.
    fn sample(&mut self, picture: &BackgroundPicture, source: &TextureMapping) -> Vec<bool> {
        let (columns, rows) = (self.width / STEP + 2, self.height / STEP + 2);
        let node = |index: usize| {
            let place = [(index % columns * STEP) as f64, (index / columns * STEP) as f64];
            source.place(place, &self.projection, picture)
        };
        let nodes: Vec<[f64; 2]> = (0..columns * rows).map(node).collect();
        let (wide, high) = (picture.width as i64, picture.height as i64);
        let panorama = picture.kind == PictureKind::Panorama;
        let mut pixels = vec![0; self.width * self.height];
        let half = self.width.div_ceil(2);
        let mut sky = vec![false; half * self.height.div_ceil(2)];
        for y in 0..self.height {
            for cell in 0..self.width.div_ceil(STEP) {
                let at = |column: usize| {
                    let [above, below] =
                        [0, 1].map(|row| nodes[(y / STEP + row) * columns + column]);
                    let part = (y % STEP) as f64 / STEP as f64;
                    [0, 1].map(|i: usize| above[i] + (below[i] - above[i]) * part)
                };
                let (from, mut to) = (at(cell), at(cell + 1));
                if panorama {
                    // The short way round.
                    let turns = ((to[0] - from[0]) / picture.width as f64 + 100.5) as i64 - 100;
                    to[0] -= (turns * wide) as f64;
                }
                let step = [0, 1].map(|i: usize| (to[i] - from[i]) / STEP as f64);
                // Means over as many picture pixels as a texture pixel covers.
                let parts = ((step[0] * step[0] + step[1] * step[1]).sqrt() + 0.4) as i64;
                let parts = parts.clamp(1, 4);
                for i in 0..STEP.min(self.width - cell * STEP) {
                    let place = [0, 1].map(|axis: usize| from[axis] + step[axis] * i as f64);
                    let mut sum = 0;
                    for part in 0..parts * parts {
                        let spread = step[0].abs().max(step[1].abs()) / parts as f64;
                        let offset = |n: i64| (n as f64 - (parts - 1) as f64 / 2.0) * spread;
                        let point =
                            [place[0] + offset(part % parts), place[1] + offset(part / parts)];
                        sum += bilinear(picture, point, panorama);
                    }
                    let x = cell * STEP + i;
                    pixels[y * self.width + x] = ((sum / (parts * parts) + 128) >> 8) as u8;
                    if x.is_multiple_of(2) && y.is_multiple_of(2) {
                        let [x_source, y_source] = [
                            wrap(place[0] as i64, wide, panorama),
                            wrap(place[1] as i64, high, false),
                        ];
                        sky[y / 2 * half + x / 2] =
                            picture.is_sky(x_source as usize, y_source as usize);
                    }
                }
            }
        }
        self.pixels = pixels;
        sky
    }

    /// Brings mean and contrast to drawn ones.
    fn tone(&mut self, settings: &RenderSettings, random: &mut Random) {
        let count = self.pixels.len() as f64;
        let sum: u64 = self.pixels.iter().map(|&p| u64::from(p)).sum();
        let squares: u64 = self.pixels.iter().map(|&p| u64::from(p) * u64::from(p)).sum();
        let mean = sum as f64 / count;
        let deviation = (squares as f64 / count - mean * mean).max(1.0).sqrt();
        let gain = (even(random, settings.sensor.contrast) / deviation).clamp(0.4, 1.8);
        // Halfway to the drawn brightness: bright scenes stay rather bright.
        let level = (even(random, settings.sensor.brightness) + mean) / 2.0;
        let table: [u8; 256] = core::array::from_fn(|grey| {
            (level + gain * (grey as f64 - mean)).clamp(0.0, 255.0) as u8
        });
        self.pixels.iter_mut().for_each(|p| *p = table[usize::from(*p)]);
    }

    /// Relief from the ground below the horizon, structures (dark blobs: trees, houses), and a sky without any.
    fn shape(
        &mut self,
        sky: &[bool],
        structure: f64,
        height: f64,
        settings: &RenderSettings,
        random: &mut Random,
    ) {
        let (wide, high) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let grey = |x: usize, y: usize| {
            u32::from(
                self.pixels
                    [(2 * y).min(self.height - 1) * self.width + (2 * x).min(self.width - 1)],
            )
        };
        let sums = RectangleSums::new(wide, high, grey);
        // Sky cells are coarse: what differs from the sky's mean is no sky.
        let (mut count, mut sum, mut squares) = (1.0, 0.0, 0.0);
        for (i, _) in sky.iter().enumerate().filter(|(_, sky)| **sky) {
            let grey = f64::from(grey(i % wide, i / wide));
            (count, sum, squares) = (count + 1.0, sum + grey, squares + grey * grey);
        }
        let mean = sum / count;
        let tolerance = 12.0 + 2.5 * (squares / count - mean * mean).max(0.0).sqrt();
        let seed = random.bits() as u32;
        // Nothing on the ground is farther than this.
        let farthest = random.within(6.0, 40.0) * height;
        let shimmer = if random.chance(0.5) { even(random, settings.scene.shimmer) } else { 0.0 };
        let threshold = random.within(2.0, 10.0);
        let darker = random.chance(0.75);
        let reach = self.projection.reach;
        let mut relief = vec![[0; 2]; wide * high];
        for y in 0..high {
            for x in 0..wide {
                let index = y * wide + x;
                let near_sky = sky[index]
                    || sky[index.saturating_sub(4 * wide).max(index % wide)]
                    || sky[index - x + x.saturating_sub(4)]
                    || sky[index - x + (x + 4).min(wide - 1)];
                let grey = f64::from(grey(x, y));
                if near_sky && grey - mean > -tolerance {
                    continue;
                }
                let (small, large) = (sums.mean(x, y, 5), sums.mean(x, y, 28));
                let difference = if darker { large - small } else { small - large };
                let noise = f64::from(fractal(x as u32, y as u32, 12, 6, 4, 128, seed)) / 65_536.0;
                let blob = if difference + 16.0 * (noise - 0.5) > threshold {
                    structure * (0.3 + noise)
                } else {
                    0.0
                };
                let depth = if let Surface::Ground(_) = self.projection.form {
                    blob.min(1.0)
                } else {
                    let place = [2.0 * x as f64 + 1.0, 2.0 * y as f64 + 1.0];
                    let (ray, _) = self.projection.point(place, 0.0);
                    let ground = (ray[1] / height).max(1.0 / farthest);
                    ground * (1.0 + blob) / reach
                };
                let busy = (small - grey).abs();
                let moving = if noise > 0.5 { shimmer * (busy / 12.0).min(1.0) } else { 0.0 };
                relief[index] = [
                    (depth * 255.0).clamp(0.0, 255.0) as u8,
                    (moving * 16.0).clamp(0.0, 64.0) as u8,
                ];
            }
        }
        self.relief = relief;
        let (columns, rows) = (self.width.div_ceil(BLOCK), self.height.div_ceil(BLOCK));
        let cells = BLOCK / 2;
        let largest: Vec<u8> = (0..columns * rows)
            .map(|i| {
                let (left, top) = (i % columns * cells, i / columns * cells);
                let row =
                    |y: usize| &self.relief[y * wide + left..y * wide + (left + cells).min(wide)];
                (top..(top + cells).min(high)).flat_map(row).map(|r| r[0]).max().unwrap_or(0)
            })
            .collect();
        self.nearest = (0..columns * rows)
            .map(|i| {
                let (x, y) = (i % columns, i / columns);
                let (across, down) = (
                    x.saturating_sub(1)..(x + 2).min(columns),
                    y.saturating_sub(1)..(y + 2).min(rows),
                );
                down.flat_map(|y| across.clone().map(move |x| y * columns + x))
                    .map(|i| largest[i])
                    .max()
                    .unwrap_or(0)
            })
            .collect();
    }

    /// Relief at texture coordinates, 0..=1.
    pub(super) fn relief_at(&self, [x, y]: [f64; 2]) -> f64 {
        let x = (x.max(0.0) as usize).min(self.width - 1) / 2;
        let y = (y.max(0.0) as usize).min(self.height - 1) / 2;
        f64::from(self.relief[y * self.width.div_ceil(2) + x][0]) / 255.0
    }

    /// The point of the relief at texture coordinates, seen from `position`: direction, not normalised, and distance,
    /// metres (none in the sky).
    pub(super) fn seen(
        &self,
        place: [f64; 2],
        relief: f64,
        position: WorldVector,
    ) -> (WorldVector, Option<f64>) {
        let (point, inverse) = self.projection.point(place, relief);
        let seen: WorldVector = core::array::from_fn(|i| point[i] - inverse * position[i]);
        (seen, (inverse > 0.0).then(|| dot(seen, seen).sqrt() / inverse))
    }
}

impl TextureMapping {
    /// Picture coordinates of a texture pixel.
    fn place(
        &self,
        [x, y]: [f64; 2],
        projection: &Projection,
        picture: &BackgroundPicture,
    ) -> [f64; 2] {
        match self {
            Self::Affine(start, [right, down]) => {
                [0, 1].map(|i: usize| start[i] + right[i] * x + down[i] * y)
            }
            Self::Turned(turn) => {
                let (seen, _) = projection.point([x, y], 0.0);
                let azimuth = atan2(seen[0], seen[2]) + turn;
                let elevation = atan2(seen[1], (seen[0] * seen[0] + seen[2] * seen[2]).sqrt());
                let turns = azimuth / core::f64::consts::TAU + 0.5;
                let down = elevation / core::f64::consts::PI + 0.5;
                [turns * picture.width as f64, down * picture.height as f64]
            }
        }
    }
}

/// Left, top, right, bottom of what the flight sees of the texture, whose centre is at (0, 0).
fn extents(
    projection: &Projection,
    motion: &CameraMotion,
    view: &Optics,
    settings: &RenderSettings,
) -> [f64; 4] {
    let seconds = settings.frames as f64 / f64::from(settings.fps);
    let mut seen = [f64::MAX, f64::MAX, f64::MIN, f64::MIN];
    let [wide, high] = view.size;
    let steps = (seconds * MEASURED) as usize + 1;
    for step in 0..=steps {
        let time = seconds * step as f64 / steps as f64;
        let (rotation, position) = (motion.rotation(time), motion.position(time));
        for edge in 0..16 {
            let along = f64::from(edge % 4) / 4.0;
            let [x, y] = [[along, 0.0], [1.0, along], [1.0 - along, 1.0], [0.0, 1.0 - along]]
                [edge as usize / 4];
            let ray = rotation.apply(view.ray([x * wide, y * high]));
            for relief in [0.0, 0.5] {
                if let Some([x, y]) = projection.place(ray, position, relief) {
                    seen = [seen[0].min(x), seen[1].min(y), seen[2].max(x), seen[3].max(y)];
                }
            }
        }
    }
    seen
}

/// Sine over cosine.
fn tangent(angle: f64) -> f64 {
    let (sine, cosine) = sin_cos(angle);
    sine / cosine
}

/// A picture coordinate brought into the picture: wrapped round, or mirrored at the edges.
fn wrap(place: i64, size: i64, round: bool) -> i64 {
    if round {
        return place.rem_euclid(size);
    }
    let folded = place.rem_euclid(2 * size);
    if folded < size { folded } else { 2 * size - 1 - folded }
}

/// Grey level in 1/256 between the centres of four pixels.
fn bilinear(picture: &BackgroundPicture, [x, y]: [f64; 2], round: bool) -> i64 {
    let (x, y) = (
        ((x - 0.5) * 256.0 + 1e9) as i64 - 1_000_000_000,
        ((y - 0.5) * 256.0 + 1e9) as i64 - 1_000_000_000,
    );
    let (wide, high) = (picture.width as i64, picture.height as i64);
    let (left, top, across, down) = (x >> 8, y >> 8, x & 255, y & 255);
    let at = |x: i64, y: i64| {
        i64::from(picture.pixels[(wrap(y, high, false) * wide + wrap(x, wide, round)) as usize])
    };
    let upper = at(left, top) * (256 - across) + at(left + 1, top) * across;
    let lower = at(left, top + 1) * (256 - across) + at(left + 1, top + 1) * across;
    (upper * (256 - down) + lower * down) >> 8
}

/// Sums over rectangles from the upper left corner.
struct RectangleSums {
    sums: Vec<u32>,
    width: usize,
    height: usize,
}

impl RectangleSums {
    fn new(width: usize, height: usize, grey: impl Fn(usize, usize) -> u32) -> Self {
        let mut sums = vec![0; (width + 1) * (height + 1)];
        for y in 0..height {
            let mut row = 0;
            for x in 0..width {
                row += grey(x, y);
                sums[(y + 1) * (width + 1) + x + 1] = sums[y * (width + 1) + x + 1] + row;
            }
        }
        Self { sums, width, height }
    }

    /// Mean over the pixels at most `radius` away each way.
    fn mean(&self, x: usize, y: usize, radius: usize) -> f64 {
        let (left, right) = (x.saturating_sub(radius), (x + radius + 1).min(self.width));
        let (top, bottom) = (y.saturating_sub(radius), (y + radius + 1).min(self.height));
        let at = |x: usize, y: usize| self.sums[y * (self.width + 1) + x];
        let sum = at(right, bottom)
            .wrapping_sub(at(left, bottom))
            .wrapping_sub(at(right, top))
            .wrapping_add(at(left, top));
        f64::from(sum) / ((right - left) * (bottom - top)) as f64
    }
}
