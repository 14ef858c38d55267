//! Periodic textures of fractal value noise, integers throughout.

use std::vec::Vec;

/// 32 random bits of a lattice point.
pub(in crate::shell) fn hash(x: u32, y: u32, seed: u32) -> u32 {
    let mut bits = x.wrapping_mul(0x9e37_79b1)
        ^ y.wrapping_mul(0x85eb_ca77).rotate_left(13)
        ^ seed.wrapping_mul(0xc2b2_ae3d);
    bits = (bits ^ (bits >> 15)).wrapping_mul(0x2c1b_3c6d);
    bits = (bits ^ (bits >> 12)).wrapping_mul(0x297a_2d39);
    bits ^ (bits >> 15)
}

/// Value noise in 0..=65535 at texel (x, y) of a tile of `1 << size` texels with lattice cells of
/// `1 << cell` texels.
fn value_noise(x: u32, y: u32, size: u32, cell: u32, seed: u32) -> u32 {
    let mask = (1 << (size - cell)) - 1;
    let (column, row) = (x >> cell, y >> cell);
    // Smoothstep 3 t^2 - 2 t^3 in 1/65536.
    let weight = |place: u32| {
        let t = u64::from(place & ((1 << cell) - 1)) << (16 - cell);
        ((t * t * ((3 << 16) - 2 * t)) >> 32) as u32
    };
    let value = |column: u32, row: u32| hash(column & mask, row & mask, seed) >> 16;
    let mix = |a: u32, b: u32, t: u32| {
        ((u64::from(a) * u64::from(65_536 - t) + u64::from(b) * u64::from(t)) >> 16) as u32
    };
    let (wx, wy) = (weight(x), weight(y));
    mix(
        mix(value(column, row), value(column + 1, row), wx),
        mix(value(column, row + 1), value(column + 1, row + 1), wx),
        wy,
    )
}

/// Fractal noise in 0..=65535: cells of `1 << cell` texels and each finer octave down to
/// `1 << finest`, every one with `fall` / 256 of the strength of the one before.
pub(in crate::shell) fn fractal(
    x: u32,
    y: u32,
    size: u32,
    cell: u32,
    finest: u32,
    fall: u32,
    seed: u32,
) -> u32 {
    let (mut sum, mut total, mut strength) = (0u64, 0u64, 1u64 << 16);
    for cell in (finest..=cell).rev() {
        let octave = value_noise(x, y, size, cell, seed.wrapping_add(cell));
        sum += u64::from(octave) * strength;
        total += strength;
        strength = (strength * u64::from(fall)) >> 8;
    }
    (sum / total) as u32
}

/// A square periodic picture with its halved copies, for sampling at any scale.
#[derive(Debug, Clone)]
pub(in crate::shell) struct Texture {
    levels: Vec<Vec<u8>>,
    size: u32,
}

impl Texture {
    /// Calls `texel` for every place of a tile of `1 << size` texels.
    pub(in crate::shell) fn new(size: u32, mut texel: impl FnMut(u32, u32) -> u8) -> Self {
        let side = 1u32 << size;
        let finest = (0..side * side).map(|place| texel(place & (side - 1), place >> size));
        let mut levels: Vec<Vec<u8>> = Vec::with_capacity(size as usize + 1);
        levels.push(finest.collect());
        for level in 0..size {
            let finer = &levels[level as usize];
            let row = 1usize << (size - level);
            let half = row / 2;
            let mean = |place: usize| {
                let corner = (place / half) * 2 * row + (place % half) * 2;
                let sum: u32 =
                    [0, 1, row, row + 1].map(|step| u32::from(finer[corner + step])).iter().sum();
                ((sum + 2) / 4) as u8
            };
            let coarser = (0..half * half).map(mean).collect();
            levels.push(coarser);
        }
        Self { levels, size }
    }

    /// Value in 1/256 at (u, v), in 1/256 texel of the finest level, blended between neighbouring
    /// texels and levels; `lod` is the level in 1/256.
    #[inline]
    pub(in crate::shell) fn sample(&self, u: i64, v: i64, lod: u32) -> u32 {
        let (level, fine) = ((lod >> 8).min(self.size), lod & 255);
        let here = self.bilinear(u, v, level);
        if fine == 0 || level == self.size {
            return here;
        }
        let above = self.bilinear(u, v, level + 1);
        (here * (256 - fine) + above * fine) >> 8
    }

    #[inline]
    fn bilinear(&self, u: i64, v: i64, level: u32) -> u32 {
        let bits = self.size - level;
        let mask = (1i64 << bits) - 1;
        // Texel centres are at half texels.
        let (u, v) = ((u >> level) - 128, (v >> level) - 128);
        let (wu, wv) = ((u & 255) as u32, (v & 255) as u32);
        let (left, top) = (u >> 8, v >> 8);
        let texels = &self.levels[level as usize][..];
        let at = |column: i64, row: i64| {
            u32::from(texels[(((row & mask) << bits) | (column & mask)) as usize])
        };
        let upper = at(left, top) * (256 - wu) + at(left + 1, top) * wu;
        let lower = at(left, top + 1) * (256 - wu) + at(left + 1, top + 1) * wu;
        (upper * (256 - wv) + lower * wv) >> 8
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_smooth_periodic_and_fills_its_range() {
        let (mut low, mut high) = (u32::MAX, 0);
        for place in 0..128 {
            let value = |x: u32| value_noise(x & 127, 37, 7, 3, 5);
            assert!(value(place).abs_diff(value(place + 1)) < 65_536 / 8 * 2);
            low = low.min(value(place));
            high = high.max(value(place));
        }
        assert!(low < 10_000 && high > 55_000);
        assert_eq!(fractal(9, 9, 7, 4, 0, 0, 5), value_noise(9, 9, 7, 4, 9));
    }

    #[test]
    fn samples_hit_texels_and_means() {
        let texture = Texture::new(2, |x, y| (x * 10 + y * 50) as u8);
        for (x, y) in [(0, 0), (3, 2), (1, 3)] {
            let (u, v) = (x * 256 + 128, y * 256 + 128);
            assert_eq!(texture.sample(u, v, 0), (x * 10 + y * 50) as u32 * 256);
            // The tile repeats.
            assert_eq!(texture.sample(u - 4 * 256, v + 8 * 256, 0), texture.sample(u, v, 0));
        }
        assert_eq!(texture.sample(256, 128, 0), 5 * 256);
        assert_eq!(texture.sample(77, 99, 2 * 256), 90 * 256);
        assert_eq!(texture.sample(77, 99, 9 * 256 + 3), 90 * 256);
    }
}
