//! The textures of the scene: fields with roads, bushes and trees, and clouds.

use crate::shell::render::noise::{Texture, fractal, hash};
use crate::shell::support::random::Random;
use std::vec;
use std::vec::Vec;

/// Texels of the ground's side, as a power of two.
const SIZE: u32 = 10;
const SIDE: u32 = 1 << SIZE;

/// Fields of many kinds, roads and hedges between them, single trees; repeats at its edges.
pub(super) fn ground(random: &mut Random) -> Texture {
    let seed = random.bits() as u32;
    let fields = paint_fields(random);
    let noise = |x, y, cell, salt: u32| fractal(x, y, SIZE, cell, 0, 150, seed ^ salt);
    let mut texels = vec![0u8; (SIDE * SIDE) as usize];
    for (place, texel) in (0u32..).zip(&mut texels) {
        let (x, y) = (place & (SIDE - 1), place >> SIZE);
        // Borders that wind: the painted fields are looked up a little aside.
        let wind = |salt| fractal(x, y, SIZE, 7, 5, 110, seed ^ salt) >> 11;
        let (fx, fy) = ((x + wind(1)) & (SIDE - 1), (y + wind(2)) & (SIDE - 1));
        let field = u32::from(fields[((fy << SIZE) | fx) as usize]);
        let grain = (noise(x, y, 5, 3) + hash(x, y, seed) / (1 << 18)) / 5 * 4;
        *texel = ((field * (40_000 + grain)) >> 16).min(255) as u8;
    }
    plant(&mut texels, random, seed);
    Texture::new(SIZE, |x, y| texels[((y << SIZE) | x) as usize])
}

/// Divides the tile into rectangles again and again; each becomes a field with a border.
fn paint_fields(random: &mut Random) -> Vec<u8> {
    let mut painted = vec![0u8; (SIDE * SIDE) as usize];
    let mut open = vec![(0, 0, SIDE, SIDE)];
    while let Some((left, top, width, height)) = open.pop() {
        let long = width.max(height);
        if long > 330 || (long > 150 && random.chance(0.75)) {
            let cut = (f64::from(long) * random.within(0.35, 0.65)) as u32;
            if width > height {
                open.push((left, top, cut, height));
                open.push((left + cut, top, width - cut, height));
            } else {
                open.push((left, top, width, cut));
                open.push((left, top + cut, width, height - cut));
            }
            continue;
        }
        let tone = random.within(85.0, 170.0) as u32;
        let (road, hedge) = (random.chance(0.4), random.chance(0.5));
        let furrows = if random.chance(0.6) { random.within(4.0, 20.0) as u32 } else { 0 };
        let across = random.chance(0.5);
        for y in 0..height {
            for x in 0..width {
                let border = x.min(y).min(width - 1 - x).min(height - 1 - y);
                let furrow = (if across { x } else { y }) & 7 < 4;
                let tone = match border {
                    0..=3 if road => 175,
                    _ if road && border < 6 => 110,
                    _ if hedge && border < 5 => 60,
                    _ if furrow => tone - furrows,
                    _ => tone,
                };
                painted[(((top + y) << SIZE) | (left + x)) as usize] = tone as u8;
            }
        }
    }
    painted
}

/// Trees and bushes with a lit side and a shadow, in groups.
fn plant(texels: &mut [u8], random: &mut Random, seed: u32) {
    const CELL: u32 = 8;
    for place in 0..(SIDE / CELL) * (SIDE / CELL) {
        let (x, y) = (place % (SIDE / CELL) * CELL, place / (SIDE / CELL) * CELL);
        let density = f64::from(fractal(x, y, SIZE, 7, 5, 128, seed ^ 9)) / 65_536.0;
        let radius = random.within(2.0, 6.5);
        let shift = random.bits();
        if !random.chance((density - 0.5) * 3.5 + 0.02) {
            continue;
        }
        let (x, y) = (x + (shift & 7) as u32, y + (shift >> 8 & 7) as u32);
        let reach = radius as i64 + 3;
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                let at = |value: u32, step: i64| (i64::from(value) + step) as u32 & (SIDE - 1);
                let (tx, ty) = (at(x, dx), at(y, dy));
                let texel = &mut texels[((ty << SIZE) | tx) as usize];
                let rough = f64::from(hash(tx, ty, seed) >> 24) / 90.0;
                let squared = |x: f64, y: f64| x * x + y * y;
                let (fx, fy) = (dx as f64, dy as f64);
                if squared(fx, fy) + rough * radius < radius * radius {
                    let light = 52.0 - (fx + fy) * 22.0 / radius + rough * 10.0;
                    *texel = light.max(12.0) as u8;
                } else if squared(fx - 2.5, fy - 2.5) < radius * radius {
                    *texel = (u32::from(*texel) * 5 / 9) as u8;
                }
            }
        }
    }
}

/// Fine grain to lay over what the ground leaves smooth: grass, stones, leaves.
pub(super) fn grain(random: &mut Random) -> Texture {
    let seed = random.bits() as u32;
    Texture::new(8, |x, y| {
        let value = fractal(x, y, 8, 5, 0, 190, seed) as i64;
        // Sums of octaves crowd about the middle: spread them.
        (128 + (value - 32_768) / 110).clamp(0, 255) as u8
    })
}

/// Cover of the sky, 0 clear to 255 cloud.
pub(super) fn clouds(random: &mut Random) -> Texture {
    let seed = random.bits() as u32;
    let clear = random.within(26_000.0, 40_000.0) as i64;
    Texture::new(9, |x, y| {
        let value = i64::from(fractal(x, y, 9, 7, 1, 135, seed));
        ((value - clear) / 70).clamp(0, 255) as u8
    })
}
