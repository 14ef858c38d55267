//! Reduction of pictures: by two, and by fractions of an octave.

use crate::image::Image;
use crate::math::slices;
use crate::math::threads;

/// Columns blended at a time by [`resize`]: a strip on the stack, so that no caller's buffer is needed.
const STRIP: usize = 256;

/// Rows that one thread samples at a time in [`resize`].
const BAND: usize = 64;

/// Halves `src` in both directions, each pixel the rounded mean of four; an odd last column or row is left out.
/// Returns the size of the picture written row by row to `dst`.
///
/// Panics if `dst` has fewer than `(width / 2) * (height / 2)` bytes.
#[inline(never)]
pub fn halve(src: Image<'_>, dst: &mut [u8]) -> (usize, usize) {
    let (width, height) = (src.width() / 2, src.height() / 2);
    if width == 0 || height == 0 {
        return (width, height);
    }
    for (y, out) in slices::rows_mut(slices::part_mut(dst, 0, width * height), width).enumerate() {
        halve_rows(src.row(2 * y), src.row(2 * y + 1), out);
    }
    (width, height)
}

/// One row of [`halve`].
#[cfg_attr(feature = "simd", multiversion::multiversion(targets("x86_64+avx2", "x86_64+sse4.1")))]
fn halve_rows(upper: &[u8], lower: &[u8], out: &mut [u8]) {
    // Pairs as one number each, so that vector instructions add them without sorting bytes first.
    let (upper, lower) = (upper.as_chunks::<2>().0, lower.as_chunks::<2>().0);
    for ((out, upper), lower) in out.iter_mut().zip(upper).zip(lower) {
        let (upper, lower) = (u16::from_le_bytes(*upper), u16::from_le_bytes(*lower));
        let sum = (upper & 255) + (upper >> 8) + (lower & 255) + (lower >> 8);
        *out = ((sum + 2) >> 2) as u8;
    }
}

/// Pixels along a side of `length` pixels after [`resize`] by `step` (Q16): `floor(length * 65536 / step)`.
///
/// Panics if `step` is 0.
pub const fn resized(length: usize, step: u32) -> usize {
    ((length as u64 * 65536) / step as u64) as usize
}

/// Bilinear samples of `src`, `steps` pixels apart across and down (Q16, 65536 is one pixel, more makes the picture
/// smaller): the centre of pixel x of the result lies at `(x + 1/2) * steps.0` in `src`. Returns the size of the picture
/// written row by row to `dst`.
///
/// Panics if a step is 0 or `dst` has fewer bytes than the result, see [`resized`].
pub fn resize(src: Image<'_>, steps: (u32, u32), dst: &mut [u8]) -> (usize, usize) {
    let (step_x, step_y) = steps;
    let (width, height) = (resized(src.width(), step_x), resized(src.height(), step_y));
    if width == 0 || height == 0 {
        return (width, height);
    }
    if steps == (65536, 65536) {
        for (y, out) in
            slices::rows_mut(slices::part_mut(dst, 0, width * height), width).enumerate()
        {
            slices::copy(src.row(y), out);
        }
        return (width, height);
    }
    let last_y = src.height() - 1;
    threads::pieces(slices::part_mut(dst, 0, width * height), BAND * width, true, |number, dst| {
        let mut left = 0;
        while left < width {
            let columns = Columns::new(left, width, step_x, src.width());
            for (y, out) in (number * BAND..).zip(slices::rows_mut(dst, width)) {
                let (y0, weight) = sample(y, step_y, last_y);
                let rows = [y0, (y0 + 1).min(last_y)].map(|y| &src.row(y)[columns.source.clone()]);
                columns.blend(rows, weight, slices::part_mut(out, left, columns.count));
            }
            left += columns.count;
        }
    });
    (width, height)
}

/// Columns of a resized picture, as many as can be sampled from [`STRIP`] columns of the source.
struct Columns {
    /// Columns of the source from which they are sampled.
    source: core::ops::Range<usize>,
    count: usize,
    /// Of each column its left neighbour, counted from the first one of the source.
    places: [u8; STRIP],
    /// Weight of the right neighbour, Q8.
    weights: [u16; STRIP],
}

impl Columns {
    /// Columns from `left` on, of `width`, of a source of `length` columns.
    fn new(left: usize, width: usize, step: u32, length: usize) -> Self {
        let first = sample(left, step, length - 1).0;
        let source = first..(first + STRIP).min(length);
        let mut columns = Self { source, count: 0, places: [0; STRIP], weights: [0; STRIP] };
        for x in left..width.min(left + STRIP) {
            let (place, weight) = sample(x, step, length - 1);
            if (place + 1).min(length - 1) >= columns.source.end {
                break;
            }
            columns.places[columns.count] = (place - first) as u8;
            columns.weights[columns.count] = weight;
            columns.count += 1;
        }
        columns
    }

    /// Samples one row between two rows of the source, `weight` (Q8) the lower one's.
    fn blend(&self, [upper, lower]: [&[u8]; 2], weight: u16, out: &mut [u8]) {
        blend_row(self, upper, lower, weight, out);
    }
}

#[cfg_attr(feature = "simd", multiversion::multiversion(targets("x86_64+avx2", "x86_64+sse4.1")))]
fn blend_row(columns: &Columns, upper: &[u8], lower: &[u8], weight: u16, out: &mut [u8]) {
    // One more, so that every column has a neighbour; the weight of what is beyond the picture is 0.
    let mut strip = [0u16; STRIP + 1];
    for ((blend, &a), &b) in strip.iter_mut().zip(upper).zip(lower) {
        *blend = u16::from(a) * (256 - weight) + u16::from(b) * weight;
    }
    // Neighbours are looked up first, which no vector instruction does.
    let mut pairs = [[0u16; 2]; STRIP];
    let count = out.len().min(STRIP);
    for (pair, &place) in pairs[..count].iter_mut().zip(&columns.places) {
        let place = usize::from(place);
        *pair = [strip[place], strip[place + 1]];
    }
    for ((out, &[a, b]), &weight) in out.iter_mut().zip(&pairs).zip(&columns.weights) {
        let (a, b, weight) = (u32::from(a), u32::from(b), u32::from(weight));
        *out = ((a * (256 - weight) + b * weight + (1 << 15)) >> 16) as u8;
    }
}

/// Left (upper) neighbour of output pixel `i` and the weight of the right (lower) one, Q8 below 256.
fn sample(i: usize, step: u32, last: usize) -> (usize, u16) {
    let position = ((2 * i as u64 + 1) * u64::from(step) / 2).saturating_sub(1 << 15);
    let whole = (position >> 16) as usize;
    if whole >= last { (last, 0) } else { (whole, (position >> 8) as u16 & 255) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    fn noise(len: usize, seed: u32) -> Vec<u8> {
        let mut state = seed | 1;
        (0..len)
            .map(|_| {
                state ^= state << 13;
                state ^= state >> 17;
                state ^= state << 5;
                (state >> 8) as u8
            })
            .collect()
    }

    proptest! {
        #[test]
        fn halving_is_a_mean_of_four(w in 1..40usize, h in 1..20usize, pad in 0..4usize, seed: u32) {
            let pixels = noise((w + pad) * h, seed);
            let src = Image::new(&pixels, w, h, w + pad).unwrap();
            let mut out = vec![0; (w / 2) * (h / 2)];
            prop_assert_eq!(halve(src, &mut out), (w / 2, h / 2));
            for y in 0..h / 2 {
                for x in 0..w / 2 {
                    let p = |i: usize, j: usize| f64::from(src.row(2 * y + j)[2 * x + i]);
                    let mean = (p(0, 0) + p(1, 0) + p(0, 1) + p(1, 1)) / 4.0;
                    prop_assert_eq!(out[y * (w / 2) + x], (mean + 0.5).floor() as u8);
                }
            }
        }

        #[test]
        fn resizing_agrees_with_f64(w in 1..600usize, h in 1..9usize, pad in 0..4usize, step in 40_000..900_000u32, seed: u32) {
            let pixels = noise((w + pad) * h, seed);
            let src = Image::new(&pixels, w, h, w + pad).unwrap();
            let (ow, oh) = (resized(w, step), resized(h, step));
            let mut out = vec![0; ow * oh];
            prop_assert_eq!(resize(src, (step, step), &mut out), (ow, oh));
            let scale = f64::from(step) / 65536.0;
            let place = |i: usize, n: usize| ((i as f64 + 0.5) * scale - 0.5).clamp(0.0, (n - 1) as f64);
            for y in 0..oh {
                for x in 0..ow {
                    let (sx, sy) = (place(x, w), place(y, h));
                    let (x0, y0) = (sx as usize, sy as usize);
                    let (fx, fy) = (sx - x0 as f64, sy - y0 as f64);
                    let p = |i: usize, j: usize| f64::from(src.row(j.min(h - 1))[i.min(w - 1)]);
                    let upper = p(x0, y0) * (1.0 - fx) + p(x0 + 1, y0) * fx;
                    let lower = p(x0, y0 + 1) * (1.0 - fx) + p(x0 + 1, y0 + 1) * fx;
                    let want = upper * (1.0 - fy) + lower * fy;
                    // Weights are Q8: up to 1/256 of the contrast in each direction, and rounding.
                    prop_assert!((f64::from(out[y * ow + x]) - want).abs() <= 2.5, "{x} {y}: {want}");
                }
            }
        }
    }

    #[test]
    fn nothing_comes_from_nothing() {
        let one = Image::packed(&[9], 1, 1).unwrap();
        assert_eq!(halve(one, &mut []), (0, 0));
        assert_eq!(resize(one, (65537, 65537), &mut []), (0, 0));
        let mut out = [0; 4];
        assert_eq!(resize(one, (32768, 32768), &mut out), (2, 2));
        assert_eq!(out, [9; 4]);
        assert_eq!(resize(Image::packed(&[], 0, 3).unwrap(), (65536, 65536), &mut out), (0, 3));
    }
}
