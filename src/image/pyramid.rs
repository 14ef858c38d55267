//! Smaller copies of a picture (level 1).

use crate::image::Image;

/// Columns blended at a time by [`resize`]: a strip on the stack, so that no caller's buffer is needed.
const STRIP: usize = 256;

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
    for (y, out) in dst[..width * height].chunks_exact_mut(width).enumerate() {
        let upper = src.row(2 * y).chunks_exact(2);
        let lower = src.row(2 * y + 1).chunks_exact(2);
        for ((out, a), b) in out.iter_mut().zip(upper).zip(lower) {
            let sum = u16::from(a[0]) + u16::from(a[1]) + u16::from(b[0]) + u16::from(b[1]);
            *out = ((sum + 2) >> 2) as u8;
        }
    }
    (width, height)
}

/// Pixels along a side of `length` pixels after [`resize`] by `step` (Q16): `floor(length * 65536 / step)`.
///
/// Panics if `step` is 0.
pub const fn resized(length: usize, step: u32) -> usize {
    ((length as u64 * 65536) / step as u64) as usize
}

/// Bilinear samples of `src`, `steps` pixels apart across and down (Q16, 65536 is one pixel, more makes the picture
/// smaller): the centre of pixel x of the result lies at `(x + 1/2) * steps.0` in `src`. Returns the size of the picture written row
/// by row to `dst`.
///
/// Panics if a step is 0 or `dst` has fewer bytes than the result, see [`resized`].
pub fn resize(src: Image<'_>, steps: (u32, u32), dst: &mut [u8]) -> (usize, usize) {
    let (step_x, step_y) = steps;
    let (width, height) = (resized(src.width(), step_x), resized(src.height(), step_y));
    if width == 0 || height == 0 {
        return (width, height);
    }
    if steps == (65536, 65536) {
        for (y, out) in dst[..width * height].chunks_exact_mut(width).enumerate() {
            out.copy_from_slice(src.row(y));
        }
        return (width, height);
    }
    let (last_x, last_y) = (src.width() - 1, src.height() - 1);
    let mut strip = [0u16; STRIP];
    for (y, out) in dst[..width * height].chunks_exact_mut(width).enumerate() {
        let (y0, wy) = sample(y, step_y, last_y);
        let (upper, lower) = (src.row(y0), src.row((y0 + 1).min(last_y)));
        let mut x = 0;
        while x < width {
            let first = sample(x, step_x, last_x).0;
            let end = (first + STRIP).min(src.width());
            let rows = upper[first..end].iter().zip(&lower[first..end]);
            for (blend, (&a, &b)) in strip.iter_mut().zip(rows) {
                *blend = u16::from(a) * (256 - wy) + u16::from(b) * wy;
            }
            while x < width {
                let (x0, wx) = sample(x, step_x, last_x);
                let x1 = (x0 + 1).min(last_x);
                if x1 >= end {
                    break;
                }
                let (a, b) = (u32::from(strip[x0 - first]), u32::from(strip[x1 - first]));
                let wx = u32::from(wx);
                out[x] = ((a * (256 - wx) + b * wx + (1 << 15)) >> 16) as u8;
                x += 1;
            }
        }
    }
    (width, height)
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
