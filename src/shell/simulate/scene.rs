//! The scene without the target: ground, trees, hills and sky along a ray.

use super::landscape;
use crate::shell::render::noise::{Texture, fractal};
use crate::shell::support::random::Random;
use crate::shell::support::vectors::{Rotation, WorldVector};
use std::vec::Vec;

/// Metres a texel of the ground.
const GROUND: f64 = 0.5;
/// Metres a texel of the grain.
const GRAIN: f64 = 0.12;
/// Grey of far haze.
const HAZE: u32 = 188;
/// Distance at which haze hides half, metres.
const HAZE_DISTANCE: f64 = 2500.0;
/// Metres between two heights of a [`Ridge`], at 100 m from the camera.
const RIDGE_STEP: f64 = 0.2;

/// The procedural world, static; x right, y down, z forward, the ground is y = 0.
#[derive(Debug, Clone)]
pub(super) struct ProceduralScene {
    ground: Texture,
    grain: Texture,
    clouds: Texture,
    /// From near to far.
    ridges: [Ridge; 2],
    /// Haze in 1/256 by the ground's level of detail, see [`ProceduralScene::ground`].
    haze: Vec<u32>,
    /// Angle of a pixel, radians.
    pixel: f64,
}

/// A row of trees or hills: an upright screen across the view.
#[derive(Debug, Clone)]
struct Ridge {
    /// Its place on the z axis, metres.
    z: f64,
    /// Height in metres, every `step` metres along x; periodic.
    heights: Vec<f64>,
    step: f64,
    highest: f64,
    tone: u32,
}

impl Ridge {
    fn new(random: &mut Random, z: f64, base: f64, height: f64, rough: u32, tone: u32) -> Self {
        let seed = random.bits() as u32;
        let profile = |x| f64::from(fractal(x, 7, 11, 9, 0, rough, seed)) / 65_536.0;
        let heights: Vec<f64> =
            (0..2048).map(|x| (base + height * (profile(x) - 0.5) * 2.0).max(0.0)).collect();
        let highest = heights.iter().copied().fold(0.0, f64::max);
        Self { z, heights, step: RIDGE_STEP * z / 100.0, highest, tone }
    }
}

/// A camera's pose for one instant.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pose {
    /// Metres; y is minus the height.
    pub(super) position: WorldVector,
    /// From camera to world.
    pub(super) rotation: Rotation,
}

impl ProceduralScene {
    /// A world whose trees stand `trees` metres ahead; `pixel` is the angle of one, radians.
    pub(super) fn new(random: &mut Random, trees: f64, pixel: f64) -> Self {
        let haze = (0..=16 * 16)
            .map(|step| {
                // Inverse of the level of detail for a camera 60 m up.
                let level = f64::from(step) / 16.0;
                let footprint = (1u64 << level as u32) as f64 * (1.0 + level % 1.0) * GROUND;
                let distance = cube_root(footprint * footprint * 60.0 / (pixel * pixel));
                (256.0 * distance / (distance + HAZE_DISTANCE)) as u32
            })
            .collect();
        Self {
            ground: landscape::ground(random),
            grain: landscape::grain(random),
            clouds: landscape::clouds(random),
            ridges: [
                Ridge::new(random, trees, 1.0, 16.0, 170, 52),
                Ridge::new(random, 6000.0, 160.0, 260.0, 100, 105),
            ],
            haze,
            pixel,
        }
    }

    /// Adds the grey of row `row` in 1/256 to `sums`; `focal` is in pixels, `offset` shifts the
    /// sampled points within their pixels (1/2 is the centre).
    pub(super) fn add_row(
        &self,
        pose: &Pose,
        row: f64,
        (width, height, focal): (usize, usize, f64),
        offset: (f64, f64),
        sums: &mut [u32],
    ) {
        let y = (row + offset.1 - height as f64 / 2.0) / focal;
        let left = (offset.0 - width as f64 / 2.0) / focal;
        let start = pose.rotation.apply([left, y, 1.0]);
        let step = pose.rotation.apply([1.0 / focal, 0.0, 0.0]);
        for (column, sum) in sums.iter_mut().enumerate() {
            let along = column as f64;
            let ray = [
                start[0] + step[0] * along,
                start[1] + step[1] * along,
                start[2] + step[2] * along,
            ];
            *sum += self.grey(&pose.position, ray);
        }
    }

    /// Grey in 1/256 that comes along `ray`.
    #[inline]
    fn grey(&self, from: &WorldVector, ray: WorldVector) -> u32 {
        let height = -from[1];
        let mut hidden = None;
        for ridge in &self.ridges {
            let distance = ridge.z - from[2];
            // Its foot lies behind the ground or its top below the ray: no division needed.
            let low = height * ray[2] - ray[1] * distance;
            if low < 0.0 || low > ridge.highest * ray[2] || distance < 1.0 {
                continue;
            }
            let scale = distance / ray[2];
            let (x, above) = (from[0] + ray[0] * scale, low / ray[2]);
            let place = x / ridge.step + 1e9;
            let index = place as u64;
            let fraction = place - index as f64;
            let at = |index: u64| ridge.heights[(index & 2047) as usize];
            let top = at(index) * (1.0 - fraction) + at(index + 1) * fraction;
            // The outline fades over a pixel.
            let cover = (top - above) / (self.pixel * distance);
            if cover > 0.0 {
                let grain = self.grain.sample(
                    (x * (256.0 * 30.0 / distance) + 1e9) as i64 * 8,
                    (above * (256.0 * 30.0 / distance) + 1e9) as i64 * 8,
                    128,
                );
                let haze = (256.0 * distance / (distance + HAZE_DISTANCE)) as u32;
                let tone = (ridge.tone * (grain / 2 + 128 * 192)) >> 15;
                let grey = tone * (256 - haze) + HAZE * haze;
                hidden = Some((grey, (cover.min(1.0) * 256.0) as u32));
                break;
            }
        }
        match hidden {
            Some((grey, 256)) => grey,
            Some((grey, cover)) => {
                (grey * cover + self.open(from, ray, height) * (256 - cover)) >> 8
            }
            None => self.open(from, ray, height),
        }
    }

    /// Grey without trees and hills.
    #[inline]
    fn open(&self, from: &WorldVector, ray: WorldVector, height: f64) -> u32 {
        if ray[1] > 1e-4 { self.ground(from, ray, height / ray[1]) } else { self.sky(ray) }
    }

    #[inline]
    fn ground(&self, from: &WorldVector, ray: WorldVector, distance: f64) -> u32 {
        let (x, z) = (from[0] + ray[0] * distance, from[2] + ray[2] * distance);
        // Area of a pixel on the ground in texels, d^3 pixel^2 / height; its root is the scale.
        let height = ray[1] * distance;
        let area = distance * distance * distance * (self.pixel * self.pixel / (GROUND * GROUND));
        let lod = (log2(area / height) + 32).max(0) as u32 / 2;
        let texel = |metres: f64, size: f64| (metres * (256.0 / size) + 1e12) as i64;
        let coarse = self.ground.sample(texel(x, GROUND), texel(z, GROUND), lod);
        // Grain has about four times the resolution; beyond its coarsest level it is flat.
        let fine = self.grain.sample(texel(x, GRAIN), texel(z, GRAIN), lod + 2 * 256);
        // Half from the grain and, much enlarged, differences from place to place.
        let wide =
            self.grain.sample(texel(x, 6.0), texel(z, 6.0), lod.saturating_sub(3 * 256) & !255);
        let lit = (coarse * ((fine + wide) / 512 + 128) / 256).min(255 << 8);
        let haze = self.haze[(lod as usize / 16).min(self.haze.len() - 1)];
        (lit * (256 - haze) + (HAZE << 8) * haze) >> 8
    }

    #[inline]
    fn sky(&self, ray: WorldVector) -> u32 {
        let up = (-ray[1]).max(0.0);
        let scale = 1.0 / (up + 0.07);
        let texel = |along: f64| (along * scale * (256.0 * 60.0) + 1e9) as i64;
        let cloud = self.clouds.sample(texel(ray[0]), texel(ray[2]), 0) >> 8;
        // Clouds thin out where they would crowd at the horizon.
        let cloud = (cloud * ((up * 2048.0) as u32).min(256)) >> 8;
        let clear = (HAZE << 8) + 3000 - (up.min(1.0) * 20_000.0) as u32;
        let white = (225 << 8) - (cloud << 5);
        (clear * (256 - cloud) + white * cloud) >> 8
    }
}

/// Logarithm to base 2 of a positive number in 1/256, linear between powers of two.
#[inline]
fn log2(value: f64) -> i64 {
    let bits = ((value * 65_536.0) as u64).max(1);
    let exponent = 63 - bits.leading_zeros();
    let mantissa =
        if exponent >= 8 { bits >> (exponent - 8) } else { bits << (8 - exponent) } & 255;
    i64::from(exponent) * 256 + mantissa as i64 - 16 * 256
}

/// Cube root by Newton's iteration.
fn cube_root(value: f64) -> f64 {
    let mut root = value.sqrt().max(1.0);
    for _ in 0..60 {
        root -= (root * root * root - value) / (3.0 * root * root);
    }
    root
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logarithm_and_root_agree_with_the_standard_library() {
        for value in [0.001, 0.7, 1.0, 3.0, 1000.0, 1e9] {
            assert!((log2(value) as f64 / 256.0 - f64::log2(value)).abs() < 0.1, "{value}");
            assert!((cube_root(value) - value.cbrt()).abs() < 1e-9 * value.max(1.0));
        }
    }

    #[test]
    fn every_direction_has_a_grey() {
        let scene = ProceduralScene::new(&mut Random::stream(1, 0), 300.0, 1.0 / 560.0);
        for step in 0..20_000 {
            let mut random = Random::stream(step, 1);
            let mut any = || random.within(-1.0, 1.0);
            let ray = [any(), any(), any()];
            let grey = scene.grey(&[any() * 1e4, -50.0 + any(), any() * 400.0], ray);
            assert!(grey < 256 << 8, "{ray:?}: {grey}");
        }
    }
}
