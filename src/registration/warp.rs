//! Warping of an older frame to the newest one, and temporal differences.

use crate::image::Image;
use crate::math::slices;
use crate::math::threads;
use crate::registration::GlobalMotion;

/// Side of the blocks whose corners are mapped exactly; inside, positions are interpolated.
const BLOCK: usize = 16;

/// Rows of a band, of which each is work for one thread: whole blocks.
const BAND: usize = 4 * BLOCK;

/// Pixels that are tried in one run where those of a whole row of a block cannot be.
const PIECE: usize = 4;

/// Resamples `previous`, the frame `chain.len()` frames before `current`, to the geometry of `current`: `chain` holds
/// the motions from `current` to the frame before it, from there to the one before, and so on. Both pictures are the
/// frames halved `octave` times. Pixels that `previous` did not see take the value of `current`. `out` is packed,
/// `width * height` bytes.
///
/// Panics if the pictures differ in size or `out` has fewer bytes than they have pixels.
pub fn warp(
    previous: Image<'_>,
    current: Image<'_>,
    octave: u32,
    chain: &[GlobalMotion],
    parallel: bool,
    out: &mut [u8],
) {
    let (width, height) = (current.width(), current.height());
    assert_eq!((previous.width(), previous.height()), (width, height), "size of the frames");
    if width == 0 || height == 0 {
        return;
    }
    let out = slices::part_mut(out, 0, width * height);
    threads::pieces(out, BAND * width, parallel, |number, out| {
        warp_rows(previous, current, octave, chain, number * BAND, out);
    });
}

/// Rows of [`warp`] from row `first` on, which is a multiple of [`BLOCK`].
#[cfg_attr(feature = "simd", multiversion::multiversion(targets("x86_64+avx2", "x86_64+sse4.1")))]
fn warp_rows(
    previous: Image<'_>,
    current: Image<'_>,
    octave: u32,
    chain: &[GlobalMotion],
    first: usize,
    out: &mut [u8],
) {
    let width = current.width();
    if chain.iter().all(GlobalMotion::is_identity) {
        for (y, out) in (first..).zip(slices::rows_mut(out, width)) {
            slices::copy(previous.row(y), out);
        }
        return;
    }
    // Knots below a row of blocks are those above the next one: of so many blocks they are kept.
    const KEPT: usize = 32;
    for start in (0..width).step_by(KEPT * BLOCK) {
        let mut knots = [(0, 0); KEPT + 1];
        for (x, place) in (start..width + BLOCK).step_by(BLOCK).zip(&mut knots) {
            *place = knot(chain, octave, x, first);
        }
        warp_blocks(previous, current, octave, chain, (start, first), &mut knots, out);
    }
}

/// Blocks of [`warp`] from pixel `start` on, as many as there are between `knots`, which are those of the first row of
/// blocks and become those below the last.
#[inline(always)]
fn warp_blocks(
    previous: Image<'_>,
    current: Image<'_>,
    octave: u32,
    chain: &[GlobalMotion],
    (start, first): (usize, usize),
    knots: &mut [(i32, i32)],
    out: &mut [u8],
) {
    let width = current.width();
    for (top, out) in (first..).step_by(BLOCK).zip(out.chunks_mut((BLOCK * width).max(1))) {
        let rows = out.len() / width;
        let knot = |x| knot(chain, octave, x, top + BLOCK);
        let Some((corner, others)) = knots.split_first_mut() else { return };
        let mut left = [*corner, knot(start)];
        *corner = left[1];
        for (x, upper) in (start..width).step_by(BLOCK).zip(others) {
            let right = [*upper, knot(x + BLOCK)];
            *upper = right[1];
            for j in 0..rows {
                let y = top + j;
                let start = between(left, j);
                let end = between(right, j);
                let slope = ((end.0 - start.0) >> 4, (end.1 - start.1) >> 4);
                let segment = RowSegment { x, y, shift: start, slope };
                let columns = BLOCK.min(width - x);
                let out = slices::part_mut(out, j * width + x, columns);
                let instead = slices::part(current.row(y), x, columns);
                if segment.copy_straight::<BLOCK>(previous, out) {
                    continue;
                }
                if segment.copy_stepped(previous, out) {
                    continue;
                }
                // At the edges of the picture and under large slopes: most often so in pieces.
                let pieces = out.chunks_mut(PIECE).zip(instead.chunks(PIECE)).enumerate();
                for (i, (out, instead)) in pieces {
                    let piece = segment.from(i * PIECE);
                    if !piece.copy_straight::<PIECE>(previous, out) {
                        piece.copy(previous, instead, out);
                    }
                }
            }
            left = right;
        }
    }
}

/// Shift of the centre of pixel (x, y) of the halved frames through the whole chain, in their pixels, Q16.
fn knot(chain: &[GlobalMotion], octave: u32, x: usize, y: usize) -> (i32, i32) {
    let centre = |v: usize| ((2 * v + 1) << (7 + octave)) as i32;
    let start = (centre(x), centre(y));
    let end = chain.iter().fold(start, |(x, y), motion| motion.map(x, y));
    // Farther than any picture reaches, and no overflow in what follows.
    let limit = |v: i32| v.clamp(-1 << 21, 1 << 21) << 8 >> octave;
    (limit(end.0.saturating_sub(start.0)), limit(end.1.saturating_sub(start.1)))
}

/// The shift in row `j` of a block, from those at its upper and lower corner.
fn between([upper, lower]: [(i32, i32); 2], j: usize) -> (i32, i32) {
    let blend = |a: i32, b: i32| a + ((b - a) >> 4) * j as i32;
    (blend(upper.0, lower.0), blend(upper.1, lower.1))
}

/// Part of a row of one block.
struct RowSegment {
    x: usize,
    y: usize,
    /// Shift of its first pixel, in pixels, Q16.
    shift: (i32, i32),
    /// By how much the shift grows from pixel to pixel, Q16.
    slope: (i32, i32),
}

impl RowSegment {
    /// The part from pixel `i` on.
    fn from(&self, i: usize) -> Self {
        let along = |shift: i32, slope: i32| shift + i as i32 * slope;
        let shift = (along(self.shift.0, self.slope.0), along(self.shift.1, self.slope.1));
        Self { x: self.x + i, y: self.y, shift, slope: self.slope }
    }

    /// Samples `N` pixels from two runs of consecutive bytes, which the compiler turns into vector instructions. False when
    /// that cannot be: there are fewer, the whole part of the shift changes on the way, or pixels are missing.
    #[inline(always)]
    fn copy_straight<const N: usize>(&self, from: Image<'_>, out: &mut [u8]) -> bool {
        let Ok(out) = <&mut [u8; N]>::try_from(out) else { return false };
        let last = N as i32 - 1;
        // Half a sixteenth, to round.
        let (dx, dy) = (self.shift.0 + (1 << 11), self.shift.1 + (1 << 11));
        let whole = (dx >> 16, dy >> 16);
        if ((dx + last * self.slope.0) >> 16, (dy + last * self.slope.1) >> 16) != whole {
            return false;
        }
        let (Ok(x), Ok(y)) =
            (usize::try_from(self.x as i32 + whole.0), usize::try_from(self.y as i32 + whole.1))
        else {
            return false;
        };
        if x + N >= from.width() || y + 1 >= from.height() {
            return false;
        }
        let (upper, lower) = (&from.row(y)[x..=x + N], &from.row(y + 1)[x..=x + N]);
        let (dx, dy) = (dx as u16, dy as u16);
        let (across, down) = (self.slope.0 as u16, self.slope.1 as u16);
        for (i, out) in out.iter_mut().enumerate() {
            let wx = dx.wrapping_add(across.wrapping_mul(i as u16)) >> 12;
            let wy = dy.wrapping_add(down.wrapping_mul(i as u16)) >> 12;
            let a = blend(upper[i].into(), upper[i + 1].into(), wx);
            let b = blend(lower[i].into(), lower[i + 1].into(), wx);
            *out = ((blend(a, b, wy) + 128) >> 8) as u8;
        }
        true
    }

    /// As [`RowSegment::copy_straight`] of a whole row of a block, where the whole part of the shift grows or shrinks by up to
    /// one on the way. False when it changes more or pixels are missing.
    #[inline(always)]
    fn copy_stepped(&self, from: Image<'_>, out: &mut [u8]) -> bool {
        const LAST: i32 = BLOCK as i32 - 1;
        const ROOM: usize = BLOCK + 2;
        let Ok(out) = <&mut [u8; BLOCK]>::try_from(out) else { return false };
        let (dx, dy) = (self.shift.0 + (1 << 11), self.shift.1 + (1 << 11));
        let (across, down) = self.slope;
        let (first, last) =
            ((dx >> 16, dy >> 16), ((dx + LAST * across) >> 16, (dy + LAST * down) >> 16));
        let least = (first.0.min(last.0), first.1.min(last.1));
        if first.0.abs_diff(last.0) > 1 || first.1.abs_diff(last.1) > 1 {
            return false;
        }
        let (Ok(x), Ok(y)) =
            (usize::try_from(self.x as i32 + least.0), usize::try_from(self.y as i32 + least.1))
        else {
            return false;
        };
        if x + ROOM > from.width() || y + 2 >= from.height() {
            return false;
        }
        // Of each pixel whether the whole part is one more than the least, and the weight of the next one.
        let (mut right, mut below) = ([0u16; BLOCK], [0u16; BLOCK]);
        let (mut wx, mut wy) = ([0u16; BLOCK], [0u16; BLOCK]);
        for i in 0..BLOCK {
            let (dx, dy) = (dx + i as i32 * across, dy + i as i32 * down);
            (right[i], below[i]) = (((dx >> 16) - least.0) as u16, ((dy >> 16) - least.1) as u16);
            (wx[i], wy[i]) = (dx as u16 >> 12, dy as u16 >> 12);
        }
        // The first value, or the second where the choice is 1; what wraps on the way is right in the end.
        let choose = |first: u16, second: u16, choice: u16| {
            first.wrapping_add(second.wrapping_sub(first).wrapping_mul(choice))
        };
        let mut rows = [[0u16; BLOCK]; 3];
        for (out, y) in rows.iter_mut().zip(y..) {
            let Some(row) = from.row(y).get(x..).and_then(|row| row.first_chunk::<ROOM>()) else {
                return false;
            };
            for i in 0..BLOCK {
                let [a, b, c] = [row[i].into(), row[i + 1].into(), row[i + 2].into()];
                out[i] = blend(choose(a, b, right[i]), choose(b, c, right[i]), wx[i]);
            }
        }
        let [upper, middle, lower] = &rows;
        for (i, out) in out.iter_mut().enumerate() {
            let a = choose(upper[i], middle[i], below[i]);
            let b = choose(middle[i], lower[i], below[i]);
            *out = ((blend(a, b, wy[i]) + 128) >> 8) as u8;
        }
        true
    }

    /// Samples pixel by pixel; those outside of `from` come from `instead`.
    fn copy(&self, from: Image<'_>, instead: &[u8], out: &mut [u8]) {
        let (last_x, last_y) = (from.width() as i32 - 1, from.height() as i32 - 1);
        let (mut dx, mut dy) = (self.shift.0 + (1 << 11), self.shift.1 + (1 << 11));
        for (i, (out, &instead)) in out.iter_mut().zip(instead).enumerate() {
            let (x, y) = ((self.x + i) as i32 + (dx >> 16), self.y as i32 + (dy >> 16));
            let (wx, wy) = (dx as u16 >> 12, dy as u16 >> 12);
            dx += self.slope.0;
            dy += self.slope.1;
            let beyond = |v: i32, w: u16, last: i32| v < 0 || v > last || (v == last && w > 0);
            if beyond(x, wx, last_x) || beyond(y, wy, last_y) {
                *out = instead;
                continue;
            }
            let next = (x + 1).min(last_x) as usize;
            let across = |y: i32| {
                let row = from.row(y as usize);
                blend(row[x as usize].into(), row[next].into(), wx)
            };
            let (a, b) = (across(y), across((y + 1).min(last_y)));
            *out = ((blend(a, b, wy) + 128) >> 8) as u8;
        }
    }
}

/// 16 times the mixture of two values with `weight` sixteenths of the second.
#[inline(always)]
fn blend(first: u16, second: u16, weight: u16) -> u16 {
    // One product instead of two; what wraps on the way is right in the end, which is below 2^16.
    (first * 16).wrapping_add(second.wrapping_sub(first).wrapping_mul(weight))
}

/// Distance of each pixel of `current` to the range of the 3x3 pixels around it in `warped`, in grey levels: 0
/// where the older frame, moved by up to a pixel, explains it. Both slices are packed, `width * height` bytes.
///
/// Panics if a slice has fewer bytes than the frame has pixels.
pub fn temporal_difference(current: Image<'_>, warped: &[u8], parallel: bool, out: &mut [u8]) {
    let (width, height) = (current.width(), current.height());
    if width == 0 || height == 0 {
        return;
    }
    let (warped, out) =
        (slices::part(warped, 0, width * height), slices::part_mut(out, 0, width * height));
    threads::pieces(out, BAND * width, parallel, |number, out| {
        difference_rows(current, warped, number * BAND, out);
    });
}

/// Rows of [`temporal_difference`] from row `first` on.
#[cfg_attr(feature = "simd", multiversion::multiversion(targets("x86_64+avx2", "x86_64+sse4.1")))]
fn difference_rows(current: Image<'_>, warped: &[u8], first: usize, out: &mut [u8]) {
    const STRIP: usize = 128;
    let (width, height) = (current.width(), current.height());
    for (y, out) in (first..).zip(slices::rows_mut(out, width)) {
        let row = |y: usize| slices::part(warped, y * width, width);
        let rows = [row(y.saturating_sub(1)), row(y), row((y + 1).min(height - 1))];
        let here = current.row(y);
        if !cfg!(feature = "simd") {
            difference_row_by_pixels(rows, here, out);
            continue;
        }
        for left in (0..width).step_by(STRIP) {
            let right = (left + STRIP).min(width);
            let n = right - left;
            // The columns with one on either side; beyond the edge is what changes neither extreme.
            let (from, to) = (left.saturating_sub(1), (right + 1).min(width));
            let (mut low, mut high) = ([255; STRIP + 2], [0; STRIP + 2]);
            let inner = from + 1 - left..to + 1 - left;
            let columns = rows.map(|row| slices::part(row, from, to - from));
            combine(columns, &mut low[inner.clone()], u8::min);
            combine(columns, &mut high[inner], u8::max);
            let (mut lowest, mut highest) = ([0; STRIP], [0; STRIP]);
            combine([0, 1, 2].map(|k| &low[k..k + n]), &mut lowest[..n], u8::min);
            combine([0, 1, 2].map(|k| &high[k..k + n]), &mut highest[..n], u8::max);
            let ranges = lowest.iter().zip(&highest);
            for ((out, &value), (low, &high)) in
                out[left..right].iter_mut().zip(&here[left..right]).zip(ranges)
            {
                *out = low.saturating_sub(value) | value.saturating_sub(high);
            }
        }
    }
}

/// A row of [`temporal_difference`], pixel by pixel, from the rows of the older frame above, beside and below it: for
/// processors without vector instructions.
fn difference_row_by_pixels([above, beside, below]: [&[u8]; 3], current: &[u8], out: &mut [u8]) {
    // Least and greatest of each column; beyond the edge is what changes neither.
    const BEYOND: (u8, u8) = (255, 0);
    let columns = above.iter().zip(beside).zip(below);
    let mut columns = columns.map(|((&a, &b), &c)| (a.min(b).min(c), a.max(b).max(c)));
    let (mut left, mut here) = (BEYOND, columns.next().unwrap_or(BEYOND));
    for (out, &value) in out.iter_mut().zip(current) {
        let right = columns.next().unwrap_or(BEYOND);
        let low = left.0.min(here.0).min(right.0);
        let high = left.1.max(here.1).max(right.1);
        *out = low.saturating_sub(value) | value.saturating_sub(high);
        (left, here) = (here, right);
    }
}

/// The distance of each pixel of `current` from that of `warped`, in grey levels. Both slices are packed, `width * height`
/// bytes. Panics if a slice has fewer bytes than the frame has pixels.
pub fn plain_difference(current: Image<'_>, warped: &[u8], parallel: bool, out: &mut [u8]) {
    let width = current.width();
    if width == 0 {
        return;
    }
    let size = width * current.height();
    threads::pieces(slices::part_mut(out, 0, size), BAND * width, parallel, |number, out| {
        let warped = slices::rows(slices::split(warped, number * BAND * width).1, width);
        for (y, (out, warped)) in (number * BAND..).zip(slices::rows_mut(out, width).zip(warped)) {
            distances(current.row(y), warped, out);
        }
    });
}

#[cfg_attr(feature = "simd", multiversion::multiversion(targets("x86_64+avx2", "x86_64+sse4.1")))]
fn distances(current: &[u8], warped: &[u8], out: &mut [u8]) {
    for ((out, a), b) in out.iter_mut().zip(current).zip(warped) {
        *out = a.abs_diff(*b);
    }
}

/// Writes `f` of the elements at the same place of three slices.
#[inline(always)]
fn combine([a, b, c]: [&[u8]; 3], out: &mut [u8], f: impl Fn(u8, u8) -> u8) {
    for (out, ((&a, &b), &c)) in out.iter_mut().zip(a.iter().zip(b).zip(c)) {
        *out = f(f(a, b), c);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::lucas_kanade::tests::{render, texture};
    use crate::registration::{Registration, buffer_len};
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    /// A measured motion: the texture turned by an angle and shifted.
    fn motion(w: usize, h: usize, angle: f64, dx: f64, dy: f64) -> GlobalMotion {
        let buffer = vec![0; buffer_len(w, h)];
        let mut registration = Registration::new(w, h, buffer).unwrap();
        for k in [0.0, 1.0] {
            let (s, c) = (k * angle).sin_cos();
            let frame =
                render(w, h, |x, y| texture(x * c - y * s + k * dx, x * s + y * c + k * dy));
            let result = registration.register(Image::packed(&frame, w, h).unwrap()).unwrap();
            if k > 0.0 {
                assert!(result.is_valid());
                return result;
            }
        }
        unreachable!()
    }

    #[test]
    fn warping_agrees_with_f64() {
        for (w, h, chain) in [
            (320, 240, vec![motion(320, 240, 0.02, 3.3, -2.0)]),
            (333, 251, vec![motion(333, 251, -0.01, -4.0, 6.6), motion(333, 251, 0.03, 1.0, 2.0)]),
            (333, 251, vec![motion(333, 251, 0.0, 12.0, 0.0); 3]),
        ] {
            let previous = render(w, h, |x, y| texture(x / 2.0, y / 2.0));
            let current: Vec<u8> = previous.iter().map(|v| v ^ 255).collect();
            let view = |p| Image::packed(p, w, h).unwrap();
            let mut out = vec![0; w * h];
            warp(view(&previous), view(&current), 0, &chain, true, &mut out);
            for (i, &got) in out.iter().enumerate() {
                let (x, y) = ((i % w) as i32, (i / w) as i32);
                let start = (x * 256 + 128, y * 256 + 128);
                let (sx, sy) = chain.iter().fold(start, |(x, y), m| m.map(x, y));
                let (sx, sy) = (f64::from(sx) / 256.0 - 0.5, f64::from(sy) / 256.0 - 0.5);
                let inside = |s: f64, last: usize, by: f64| s > by && s < last as f64 - by;
                if inside(sx, w - 1, 0.1) && inside(sy, h - 1, 0.1) {
                    let p = |i: usize, j: usize| f64::from(previous[j * w + i]);
                    let (x0, y0) = (sx as usize, sy as usize);
                    let (fx, fy) = (sx - x0 as f64, sy - y0 as f64);
                    let upper = p(x0, y0) * (1.0 - fx) + p(x0 + 1, y0) * fx;
                    let lower = p(x0, y0 + 1) * (1.0 - fx) + p(x0 + 1, y0 + 1) * fx;
                    let want = upper * (1.0 - fy) + lower * fy;
                    assert!((f64::from(got) - want).abs() < 4.0, "{x} {y}: {got} {want}");
                } else if !(inside(sx, w - 1, -0.1) && inside(sy, h - 1, -0.1)) {
                    assert_eq!(got, current[i], "outside, {x} {y}");
                }
            }
        }
    }

    #[test]
    fn without_motion_it_is_a_copy() {
        let pixels = render(41, 23, texture);
        let (previous, current) =
            (Image::new(&pixels, 38, 23, 41).unwrap(), Image::packed(&[7; 874], 38, 23).unwrap());
        let mut out = vec![0; 874];
        warp(previous, current, 0, &[GlobalMotion::IDENTITY; 3], true, &mut out);
        assert!((0..23).all(|y| out[y * 38..][..38] == *previous.row(y)));
        warp(
            Image::packed(&[], 0, 4).unwrap(),
            Image::packed(&[], 0, 4).unwrap(),
            0,
            &[],
            true,
            &mut [],
        );
    }

    proptest! {
        #[test]
        fn difference_agrees_with_its_definition(w in 1..150usize, h in 1..7usize, pad in 0..3usize, bytes in proptest::collection::vec(any::<u8>(), 2200)) {
            let current = Image::new(&bytes[1100..], w, h, w + pad);
            let Ok(current) = current else { return Ok(()) };
            let warped = &bytes[..w * h];
            let mut out = vec![1; w * h];
            temporal_difference(current, warped, true, &mut out);
            for (i, &got) in out.iter().enumerate() {
                let (x, y) = (i % w, i / w);
                let around = (0..h).filter(|j| j.abs_diff(y) <= 1).flat_map(|j| (0..w).filter(|i| i.abs_diff(x) <= 1).map(move |i| warped[j * w + i]));
                let (low, high) = around.fold((255, 0), |(l, h): (u8, u8), v| (l.min(v), h.max(v)));
                let value = current.row(y)[x];
                let want = value.abs_diff(value.clamp(low, high));
                prop_assert_eq!(got, want);
            }
            for (y, out) in out.chunks(w).enumerate() {
                let rows = [y.saturating_sub(1), y, (y + 1).min(h - 1)].map(|y| &warped[y * w..][..w]);
                let mut by_pixels = vec![1; w];
                difference_row_by_pixels(rows, current.row(y), &mut by_pixels);
                prop_assert_eq!(out, by_pixels);
            }
            plain_difference(current, warped, true, &mut out);
            for (i, &got) in out.iter().enumerate() {
                prop_assert_eq!(got, current.row(i / w)[i % w].abs_diff(warped[i]));
            }
        }
    }
}
