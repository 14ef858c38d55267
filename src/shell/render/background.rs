//! The background of a frame: every pixel gathers from the texture where its ray meets the surface (inverse mapping).

use super::motion::CameraMotion;
use super::scene::{BLOCK, BackgroundScene};
use super::view::Optics;
use crate::shell::support::random::Random;
use std::vec;
use std::vec::Vec;

/// Pixels between two nodes, where texture coordinates are computed exactly; between them they are interpolated.
pub(super) const NODE: usize = 16;
/// Side of the pattern of displacements of the shimmer, texture cells; a power of two.
const PATTERN: usize = 64;
/// Most looks along the way that a pixel moves during the exposure.
const MOST_LOOKS: i32 = 6;
/// Relief at which the motion during the exposure is measured.
const BLUR_RELIEF: f64 = 0.2;

/// Texture coordinates of a node, their change for one step of relief, and their way during the exposure; Q16 pixels.
type TextureNode = [i32; 6];

/// Renders the background of frames.
#[derive(Debug, Clone)]
pub(super) struct Renderer {
    nodes: Vec<TextureNode>,
    /// Those of the frame before; empty before the first.
    before: Vec<TextureNode>,
    /// Displacements of the shimmer, 1/16 of its amplitude; wraps round.
    pattern: Vec<[i8; 2]>,
    columns: usize,
}

impl Renderer {
    /// For frames of this size, a multiple of [`NODE`] each way.
    pub(super) fn new(size: [usize; 2], random: &mut Random) -> Self {
        let columns = size[0] / NODE + 1;
        let rows = size[1] / NODE + 1;
        // Smoothed twice, so that neighbouring places move alike.
        let mut field: Vec<[i32; 2]> = (0..PATTERN * PATTERN)
            .map(|_| [0; 2].map(|_: i32| (random.symmetric() * 127.0) as i32))
            .collect();
        for _ in 0..2 {
            let old = field.clone();
            let at = |x: usize, y: usize| old[(y % PATTERN) * PATTERN + x % PATTERN];
            for (i, value) in field.iter_mut().enumerate() {
                let (x, y) = (i % PATTERN, i / PATTERN);
                let near = [at(x, y), at(x + 1, y), at(x, y + 1), at(x + 1, y + 1)];
                *value =
                    [0, 1].map(|axis: usize| near.iter().map(|n| n[axis]).sum::<i32>() * 3 / 8);
            }
        }
        let pattern = field.iter().map(|v| v.map(|v| (v / 4).clamp(-32, 32) as i8)).collect();
        Self { nodes: vec![[0; 6]; columns * rows], before: Vec::new(), pattern, columns }
    }

    /// Computes the nodes of the frame at `time` (its middle row); `false` where a ray misses the surface: that node
    /// keeps its last values.
    fn aim(&mut self, scene: &BackgroundScene, motion: &CameraMotion, view: &Optics, time: f64) {
        let rows = self.nodes.len() / self.columns;
        for row in 0..rows {
            let y = (row * NODE) as f64;
            let instant = view.row_time(motion, time, y);
            let pose = |time: f64| (motion.rotation(time), motion.position(time));
            let (middle, start, end) = (
                pose(instant),
                pose(instant - motion.exposure / 2.0),
                pose(instant + motion.exposure / 2.0),
            );
            for column in 0..self.columns {
                let ray = view.ray([(column * NODE) as f64, y]);
                let place =
                    |(rotation, position): &(crate::shell::support::vectors::Rotation, _),
                     relief: f64| {
                        scene.projection.place(rotation.apply(ray), *position, relief)
                    };
                let fixed = |v: f64| (v.clamp(-16_000.0, 16_000.0) * 65_536.0) as i32;
                let places = (
                    place(&middle, 0.0),
                    place(&middle, 0.5),
                    place(&start, BLUR_RELIEF),
                    place(&end, BLUR_RELIEF),
                );
                if let (Some(far), Some(near), Some(start), Some(end)) = places {
                    self.nodes[row * self.columns + column] = [
                        fixed(far[0] - 0.5),
                        fixed(far[1] - 0.5),
                        fixed((near[0] - far[0]) * (2.0 / 255.0)),
                        fixed((near[1] - far[1]) * (2.0 / 255.0)),
                        fixed((end[0] - start[0]).clamp(-400.0, 400.0)),
                        fixed((end[1] - start[1]).clamp(-400.0, 400.0)),
                    ];
                }
            }
        }
    }

    /// Renders the frame at `time`, number `index` of the flight, into `pixels`.
    pub(super) fn render(
        &mut self,
        scene: &BackgroundScene,
        motion: &CameraMotion,
        view: &Optics,
        (time, index): (f64, u64),
        pixels: &mut [u8],
    ) {
        if index > 0 {
            self.before.clone_from(&self.nodes);
        }
        self.aim(scene, motion, view, time);
        let width = view.size[0] as usize;
        let blocks = scene.width.div_ceil(BLOCK);
        let half = scene.width.div_ceil(2);
        // The last texture pixel that has a neighbour to the right and below.
        let last = [scene.width as i32 - 2, scene.height as i32 - 2].map(|v| v << 16);
        let wave = [index as usize, (index as usize * 3) / 2];
        for (y, row) in pixels.chunks_exact_mut(width).enumerate() {
            let (band, down) = (y / NODE, (y % NODE) as i32);
            for (cell, out) in row.chunks_exact_mut(NODE).enumerate() {
                let at = |column: usize| {
                    let above = &self.nodes[band * self.columns + column];
                    let below = &self.nodes[(band + 1) * self.columns + column];
                    core::array::from_fn::<i32, 6, _>(|i| {
                        above[i] + ((below[i] - above[i]) >> 4) * down
                    })
                };
                let (from, to) = (at(cell), at(cell + 1));
                let step: TextureNode = core::array::from_fn(|i| (to[i] - from[i]) >> 4);
                let way = from[4].abs().max(from[5].abs());
                let looks = ((way + (1 << 15)) >> 16).clamp(1, MOST_LOOKS);
                let mut node = from;
                // Pixel centres are at halves.
                for i in 0..6 {
                    node[i] += step[i] / 2;
                }
                for pixel in out {
                    let [x0, y0, dx, dy, bx, by] = node;
                    let inside = |x: i32, y: i32| (x.clamp(0, last[0]), y.clamp(0, last[1]));
                    let (x, y) = inside(x0, y0);
                    // From the nearest relief around towards the surface that is really there.
                    let block = (y >> 21) as usize * blocks + (x >> 21) as usize;
                    let mut relief = i32::from(scene.nearest[block]);
                    let mut moving = 0;
                    if relief > 0 {
                        for _ in 0..3 {
                            let (x, y) = inside(x0 + dx * relief, y0 + dy * relief);
                            let [seen, shimmer] =
                                scene.relief[(y >> 17) as usize * half + (x >> 17) as usize];
                            relief = i32::from(seen);
                            moving = i32::from(shimmer);
                        }
                    }
                    let (mut x, mut y) = (x0 + dx * relief, y0 + dy * relief);
                    if moving > 0 {
                        let place = |v: i32, shift: usize| {
                            ((v >> 17) as usize).wrapping_add(shift) % PATTERN
                        };
                        let [right, lower] =
                            self.pattern[place(y, wave[1]) * PATTERN + place(x, wave[0])];
                        x += (i32::from(right) * moving) << 7;
                        y += (i32::from(lower) * moving) << 7;
                    }
                    let mut sum = 0;
                    for look in 0..looks {
                        let part = 2 * look + 1 - looks;
                        let (x, y) =
                            inside(x + bx / (2 * looks) * part, y + by / (2 * looks) * part);
                        let place = (y >> 16) as usize * scene.width + (x >> 16) as usize;
                        let (across, down) = (((x >> 8) & 255) as u32, ((y >> 8) & 255) as u32);
                        let texel = |at: usize| u32::from(scene.pixels[at]);
                        let upper = texel(place) * (256 - across) + texel(place + 1) * across;
                        let below = place + scene.width;
                        let lower = texel(below) * (256 - across) + texel(below + 1) * across;
                        sum += (upper * (256 - down) + lower * down) >> 8;
                    }
                    *pixel = ((sum / looks as u32 + 128) >> 8).min(255) as u8;
                    for i in 0..6 {
                        node[i] += step[i];
                    }
                }
            }
        }
    }

    /// Where the background of every [`NODE`] x [`NODE`] pixels was in the frame before, row by row: offsets in quarters
    /// of a pixel.
    pub(super) fn motions(&self, scene: &BackgroundScene) -> Vec<[i32; 2]> {
        let (columns, rows) = (self.columns - 1, self.nodes.len() / self.columns - 1);
        if self.before.is_empty() {
            return vec![[0; 2]; columns * rows];
        }
        let motion = |index: usize| {
            let at = index / columns * self.columns + index % columns;
            let corners = [at, at + 1, at + self.columns, at + self.columns + 1];
            let mean = |nodes: &[TextureNode], i: usize| {
                corners.map(|c| f64::from(nodes[c][i])).iter().sum::<f64>() / 4.0
            };
            let place = [0, 1].map(|i: usize| mean(&self.nodes, i) / 65_536.0);
            let relief = scene.relief_at(place) * 255.0;
            let seen =
                |nodes: &[TextureNode], i: usize| mean(nodes, i) + relief * mean(nodes, i + 2);
            // Texture pixels that one pixel to the right and one downwards are.
            let slope = |a: usize, b: usize, i: usize| {
                f64::from(self.before[b][i] - self.before[a][i]) / NODE as f64
            };
            let right = [0, 1].map(|i: usize| slope(corners[0], corners[1], i));
            let down = [0, 1].map(|i: usize| slope(corners[0], corners[2], i));
            let [x, y] = [0, 1].map(|i: usize| seen(&self.nodes, i) - seen(&self.before, i));
            let area = right[0] * down[1] - right[1] * down[0];
            if area.abs() < 1e6 {
                return [0; 2];
            }
            let offset = [(x * down[1] - y * down[0]) / area, (y * right[0] - x * right[1]) / area];
            offset.map(|v| ((v * 4.0 + 1000.5).clamp(0.0, 2000.0)) as i32 - 1000)
        };
        (0..columns * rows).map(motion).collect()
    }
}
