//! Sparse optical flow: corner detection and tracking.
//!
//! Corners after Harris & Stephens (1988), tracking after Lucas & Kanade (1981) in the form whose gradients are those
//! of the template, one level of a pyramid at a time. All in integers.

use crate::image::Image;

/// Side of the window that is tracked, in pixels.
pub const WINDOW: usize = 10;

/// Room for the samples of a row: whole vectors, where there are vector instructions. Behind the samples are zeros.
const LANES: usize = if cfg!(feature = "simd") { 16 } else { WINDOW + 2 };

/// How many of them are added up: all where there are vector instructions, else the samples alone.
const TAKEN: usize = if cfg!(feature = "simd") { LANES } else { WINDOW };

/// Pixels between a corner and the picture's edge, so that the window with its gradients fits.
pub const MARGIN: usize = WINDOW / 2 + 2;

/// Side of the blocks in which corners are detected.
const BLOCK: usize = 8;

/// Gradients are clamped to this, in grey levels over two pixels: a single strong edge must not exceed a corner's
/// response, and sums over 3x3 pixels stay within 16 bits.
const GRADIENT_LIMIT: i16 = 60;

/// Least corner response, above that of noise and compression in a plain sky.
const MIN_CORNER: i32 = 20_000;

/// Steps of Gauss and Newton for one point.
const MAX_STEPS: usize = 6;

/// A step shorter than this ends the iteration, in pixels, Q8: the resolution of sampling at sixteenths of a pixel.
const SHORT_STEP: i32 = 16;

/// Longest single step, in pixels, Q8.
const LONG_STEP: i64 = 3 << 8;

/// Largest total shift, in pixels, Q8.
const MAX_SHIFT: i32 = (WINDOW as i32) << 7;

/// Least eigenvalue of the window's gradient matrix (2^22 is a mean gradient of one grey level a pixel).
const MIN_EIGENVALUE: i64 = 1 << 22;

/// Largest mean difference left between the windows, in grey levels, Q4.
const MAX_RESIDUAL: i64 = 12 << 4;

/// The strongest corner among the pixels `left..right` x `top..bottom`, or `None` where nothing stands out. The
/// outermost [`MARGIN`] pixels of the picture are left out.
pub fn corner(
    image: Image<'_>,
    (left, top): (usize, usize),
    (right, bottom): (usize, usize),
) -> Option<(usize, usize)> {
    let (left, top) = (left.max(MARGIN), top.max(MARGIN));
    let right = right.min(image.width().saturating_sub(MARGIN));
    let bottom = bottom.min(image.height().saturating_sub(MARGIN));
    if left + BLOCK > right || top + BLOCK > bottom {
        return None;
    }
    let mut best = (MIN_CORNER, None);
    for y in (top..bottom).step_by(BLOCK) {
        // The last block of a row or column overlaps the one before it.
        let y = y.min(bottom - BLOCK);
        for x in (left..right).step_by(BLOCK) {
            strongest(image, (x.min(right - BLOCK), y), &mut best);
        }
    }
    best.1
}

/// The strongest corner of the block around `centre`, moved as far as need be to leave out what [`corner`] leaves out.
pub fn block_corner(image: Image<'_>, (x, y): (usize, usize)) -> Option<(usize, usize)> {
    let first = |centre: usize, length: usize| {
        let last = length.checked_sub(MARGIN + BLOCK).filter(|&last| last >= MARGIN)?;
        Some(centre.saturating_sub(BLOCK / 2).clamp(MARGIN, last))
    };
    let mut best = (MIN_CORNER, None);
    strongest(image, (first(x, image.width())?, first(y, image.height())?), &mut best);
    best.1
}

/// Response and place of a corner.
type Corner = (i32, Option<(usize, usize)>);

/// Makes `best` the strongest corner of the block at (x, y), if that is stronger.
fn strongest(image: Image<'_>, (x, y): (usize, usize), best: &mut Corner) {
    let response = responses(image, x, y);
    for (j, row) in response.iter().enumerate() {
        for (i, &value) in row.iter().enumerate() {
            if value > best.0 {
                *best = (value, Some((x + i, y + j)));
            }
        }
    }
}

/// Pixels of a row that [`responses`] takes: of a block, with two more on either side, and room for whole vectors.
const ROOM: usize = 2 * BLOCK;

/// The first pixels of `row`; behind its end 0.
#[inline(always)]
fn widened(row: &[u8]) -> [i16; ROOM] {
    let mut values = [0; ROOM];
    match row.first_chunk::<ROOM>() {
        Some(row) => {
            for (value, &pixel) in values.iter_mut().zip(row) {
                *value = pixel.into();
            }
        }
        None => values.iter_mut().zip(row).for_each(|(value, &v)| *value = v.into()),
    }
    values
}

/// Corner response of the block at (x, y): determinant less a sixteenth of the squared trace of the gradient matrix
/// summed over 3x3 pixels.
#[cfg_attr(feature = "simd", multiversion::multiversion(targets("x86_64+avx2", "x86_64+sse4.1")))]
fn responses(image: Image<'_>, x: usize, y: usize) -> [[i32; BLOCK]; BLOCK] {
    // The block with one pixel more on every side: there are [`MARGIN`] pixels.
    const ROWS: usize = BLOCK + 2;
    let mut sums = [[[0i16; BLOCK]; 3]; ROWS];
    for (j, sums) in sums.iter_mut().enumerate() {
        let from = |k: usize| &image.row(y + j + k - 2)[x - 2..];
        let (above, here, below) = (widened(from(0)), widened(from(1)), widened(from(2)));
        let (mut across, mut down) = ([0i16; ROOM], [0i16; ROOM]);
        for i in 0..ROOM - 2 {
            let limited = |difference: i16| difference.clamp(-GRADIENT_LIMIT, GRADIENT_LIMIT);
            across[i] = limited(here[i + 2] - here[i]);
            down[i] = limited(below[i + 1] - above[i + 1]);
        }
        let factors = [[&across, &across], [&across, &down], [&down, &down]];
        for (sums, [a, b]) in sums.iter_mut().zip(factors) {
            let mut products = [0; ROOM];
            for (product, (a, b)) in products.iter_mut().zip(a.iter().zip(b)) {
                *product = a * b;
            }
            for (i, sum) in sums.iter_mut().enumerate() {
                *sum = products[i] + products[i + 1] + products[i + 2];
            }
        }
    }
    let mut responses = [[0; BLOCK]; BLOCK];
    for (j, responses) in responses.iter_mut().enumerate() {
        for (i, response) in responses.iter_mut().enumerate() {
            let sum = |k: usize| i32::from(sums[j][k][i] + sums[j + 1][k][i] + sums[j + 2][k][i]);
            let (xx, xy, yy) = (sum(0), sum(1), sum(2));
            let trace = (xx + yy) >> 2;
            *response = xx * yy - xy * xy - trace * trace;
        }
    }
    responses
}

/// Where the surroundings of `point` in `from` lie in `to`: the shift from `point`, found from the first guess
/// `shift`. Both in pixels, Q8, continuous coordinates. `None` where the window leaves a picture, has no structure
/// in one direction, or does not come to look alike.
#[cfg_attr(feature = "simd", multiversion::multiversion(targets("x86_64+avx2", "x86_64+sse4.1")))]
pub fn track(
    from: Image<'_>,
    to: Image<'_>,
    point: (i32, i32),
    guess: (i32, i32),
) -> Option<(i32, i32)> {
    const AREA: i64 = (WINDOW * WINDOW) as i64;
    let mut around = [[0i16; LANES]; WINDOW + 2];
    let (at_x, at_y) = sample(from, point, &mut around)?;
    // The template was taken at the nearest sixteenth of a pixel.
    let point = (at_x, at_y);

    let mut template = [[0i16; LANES]; WINDOW];
    let (mut gx, mut gy) = (template, template);
    let (mut xx, mut xy, mut yy, mut sum_x, mut sum_y) = (0i32, 0i32, 0i32, 0i32, 0i32);
    for (j, rows) in around.windows(3).enumerate() {
        let [above, here, below] = rows else { continue };
        for i in 0..WINDOW {
            template[j][i] = here[i + 1];
            gx[j][i] = (here[i + 2] - here[i]) >> 1;
            gy[j][i] = (below[i + 1] - above[i + 1]) >> 1;
        }
        for (x, y) in gx[j].iter().zip(&gy[j]).take(TAKEN) {
            let (x, y) = (i32::from(*x), i32::from(*y));
            xx += x * x;
            xy += x * y;
            yy += y * y;
            sum_x += x;
            sum_y += y;
        }
    }
    // Gradients less their mean: the brightness may change by a constant.
    let (sum_x, sum_y) = (i64::from(sum_x), i64::from(sum_y));
    let xx = i64::from(xx) * AREA - sum_x * sum_x;
    let xy = i64::from(xy) * AREA - sum_x * sum_y;
    let yy = i64::from(yy) * AREA - sum_y * sum_y;
    // 24 bits leave room for the products below.
    let down = (64 - xx.max(yy).leading_zeros()).saturating_sub(24);
    let least = MIN_EIGENVALUE >> down;
    let (xx, xy, yy) = (xx >> down, xy >> down, yy >> down);
    let determinant = xx * yy - xy * xy;
    // det / trace lies between half of the smaller eigenvalue and all of it.
    if determinant <= least.max((xx + yy) >> 6) * (xx + yy) {
        return None;
    }

    let start = guess;
    let mut shift = guess;
    let mut window = [[0i16; LANES]; WINDOW];
    for _ in 0..MAX_STEPS {
        let place = sample(to, (point.0 + shift.0, point.1 + shift.1), &mut window)?;
        let (mut ex, mut ey, mut e, mut size) = (0i32, 0i32, 0i32, 0i32);
        for j in 0..WINDOW {
            let (template, window, gx, gy) = (&template[j], &window[j], &gx[j], &gy[j]);
            for i in 0..TAKEN {
                let error = template[i] - window[i];
                ex += i32::from(error) * i32::from(gx[i]);
                ey += i32::from(error) * i32::from(gy[i]);
                e += i32::from(error);
                size += i32::from(error.abs());
            }
        }
        let (ex, ey, e) = (i64::from(ex), i64::from(ey), i64::from(e));
        let right = |eg: i64, sum: i64| ((eg * AREA - e * sum) >> down).clamp(-1 << 27, 1 << 27);
        let (bx, by) = (right(ex, sum_x), right(ey, sum_y));
        let step = |n: i64| ((n << 8) / determinant).clamp(-LONG_STEP, LONG_STEP) as i32;
        let (dx, dy) = (step(yy * bx - xy * by), step(xx * by - xy * bx));
        shift = (place.0 - point.0 + dx, place.1 - point.1 + dy);
        if (shift.0 - start.0).abs().max((shift.1 - start.1).abs()) > MAX_SHIFT {
            return None;
        }
        if dx.abs().max(dy.abs()) < SHORT_STEP {
            let same = i64::from(size) - e.abs() <= MAX_RESIDUAL * AREA;
            return same.then_some(shift);
        }
    }
    None
}

/// Bilinear samples (grey levels, Q4) a pixel apart, as many in each row as there are rows, their middle at `centre` (Q8);
/// those behind them are 0. Returns the centre that was taken, a multiple of a sixteenth of a pixel. `None` if a sample
/// would lie outside.
#[inline(always)]
fn sample<const N: usize>(
    image: Image<'_>,
    centre: (i32, i32),
    out: &mut [[i16; LANES]; N],
) -> Option<(i32, i32)> {
    let (x, y) = ((centre.0 + 8) >> 4, (centre.1 + 8) >> 4);
    let (left, top) = ((x >> 4) - N as i32 / 2, (y >> 4) - N as i32 / 2);
    let (left, top) = (usize::try_from(left).ok()?, usize::try_from(top).ok()?);
    if left + N >= image.width() || top + N >= image.height() {
        return None;
    }
    let (wx, wy) = ((x & 15) as u16, (y & 15) as u16);
    let taken = if TAKEN == LANES { LANES } else { N };
    let mut upper = across::<N>(&image.row(top)[left..], wx);
    for (j, out) in out.iter_mut().enumerate() {
        let lower = across::<N>(&image.row(top + j + 1)[left..], wx);
        for i in 0..taken {
            out[i] = ((upper[i] * (16 - wy) + lower[i] * wy + 8) >> 4) as i16;
        }
        upper = lower;
    }
    Some((x << 4, y << 4))
}

/// Mixtures of the first `N` pixels of `row` with their right neighbours, `weight` sixteenths of those; 0 behind them.
#[inline(always)]
fn across<const N: usize>(row: &[u8], weight: u16) -> [u16; LANES] {
    let mut out = [0; LANES];
    match row.first_chunk::<{ LANES + 1 }>() {
        // Whole vectors where the picture goes on.
        Some(row) if TAKEN == LANES => {
            for i in 0..LANES {
                let mixed = u16::from(row[i]) * (16 - weight) + u16::from(row[i + 1]) * weight;
                out[i] = if i < N { mixed } else { 0 };
            }
        }
        _ => {
            let row = &row[..N + 1];
            for i in 0..N {
                out[i] = u16::from(row[i]) * (16 - weight) + u16::from(row[i + 1]) * weight;
            }
        }
    }
    out
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    /// Grey level of an endless texture: smooth noise with structures of 5 to 80 pixels, as photographs have.
    pub(crate) fn texture(x: f64, y: f64) -> f64 {
        let lattice = |x: f64, y: f64| {
            let mixed = (x as i64).wrapping_mul(0x9e37_79b9_7f4a_7c15u64 as i64)
                ^ (y as i64).wrapping_mul(0xc2b2_ae3d_27d4_eb4fu64 as i64);
            ((mixed.wrapping_mul(mixed | 1) >> 40) & 0xffff) as f64 / 65536.0 - 0.5
        };
        let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
        [5.0, 10.0, 20.0, 40.0, 80.0].iter().fold(128.0, |sum, cell| {
            let (x, y) = (x / cell + 1000.0, y / cell + 1000.0);
            let (x0, y0) = (x.floor(), y.floor());
            let (tx, ty) = (smooth(x - x0), smooth(y - y0));
            let across = |y| lattice(x0, y) * (1.0 - tx) + lattice(x0 + 1.0, y) * tx;
            sum + 60.0 * (across(y0) * (1.0 - ty) + across(y0 + 1.0) * ty)
        })
    }

    /// A packed picture, each pixel sampled from `grey` at its centre.
    pub(crate) fn render(w: usize, h: usize, grey: impl Fn(f64, f64) -> f64) -> Vec<u8> {
        let pixel = |i: usize| grey((i % w) as f64 + 0.5, (i / w) as f64 + 0.5);
        (0..w * h).map(|i| (pixel(i) + 0.5).clamp(0.0, 255.0) as u8).collect()
    }

    #[test]
    fn corners_are_found_where_they_are() {
        let pixels = render(40, 32, |x, y| if x < 21.0 && y < 15.0 { 40.0 } else { 160.0 });
        let image = Image::packed(&pixels, 40, 32).unwrap();
        let (x, y) = corner(image, (0, 0), (40, 32)).unwrap();
        assert!(x.abs_diff(20) <= 1 && y.abs_diff(14) <= 1, "{x} {y}");
        assert_eq!(corner(image, (0, 0), (40, 12)), None, "an edge is no corner");
        assert_eq!(corner(image, (24, 18), (40, 32)), None, "nothing there");
        for (w, h) in [(0, 0), (1, 1), (5, 32), (22, 21)] {
            let _ = corner(Image::new(&pixels, w, h, 40).unwrap(), (0, 0), (w, h));
        }
    }

    #[test]
    fn a_block_is_sought_around_its_centre_within_the_margins() {
        let pixels = render(40, 32, |x, y| texture(3.0 * x, 3.0 * y));
        let image = Image::packed(&pixels, 40, 32).unwrap();
        for (x, y) in (0..32).flat_map(|y| (0..40).map(move |x| (x, y))) {
            let (left, top) = (x.clamp(11, 29) - 4, y.clamp(11, 21) - 4);
            let whole = corner(image, (left, top), (left + BLOCK, top + BLOCK));
            assert_eq!(block_corner(image, (x, y)), whole, "{x} {y}");
        }
        for (w, h) in [(0, 0), (1, 1), (21, 32), (40, 21)] {
            let image = Image::new(&pixels, w, h, 40).unwrap();
            assert_eq!(block_corner(image, (w / 2, h / 2)), None, "{w}x{h}");
        }
    }

    #[test]
    fn responses_agree_with_f64() {
        let pixels = render(12, 12, |x, y| texture(3.0 * x, 3.0 * y));
        let image = Image::packed(&pixels, 12, 12).unwrap();
        let p = |x: usize, y: usize| f64::from(image.row(y)[x]);
        for (j, row) in responses(image, 2, 2).iter().enumerate() {
            for (i, &got) in row.iter().enumerate() {
                let (mut a, mut b, mut c) = (0.0, 0.0, 0.0);
                for (x, y) in (0..9).map(|k| (i + 1 + k % 3, j + 1 + k / 3)) {
                    let gx = (p(x + 1, y) - p(x - 1, y)).clamp(-60.0, 60.0);
                    let gy = (p(x, y + 1) - p(x, y - 1)).clamp(-60.0, 60.0);
                    (a, b, c) = (a + gx * gx, b + gx * gy, c + gy * gy);
                }
                let want = a * c - b * b - (a + c) * (a + c) / 16.0;
                assert!((f64::from(got) - want).abs() <= (a + c) / 2.0 + 1.0, "{got} {want}");
            }
        }
    }

    proptest! {
        #[test]
        fn tracks_a_shifted_texture(dx in -1.5..1.5f64, dy in -1.5..1.5f64, x in 13..35i32, y in 13..27i32, brighter in -20.0..20.0f64) {
            let from = render(48, 40, texture);
            let to = render(48, 40, |x, y| texture(x - dx, y - dy) + brighter);
            let view = |p| Image::packed(p, 48, 40).unwrap();
            let corner = corner(view(&from), (x as usize - 5, y as usize - 5), (x as usize + 5, y as usize + 5));
            prop_assume!(corner.is_some());
            let (x, y) = corner.unwrap();
            let point = ((2 * x as i32 + 1) << 7, (2 * y as i32 + 1) << 7);
            let (gx, gy) = track(view(&from), view(&to), point, (0, 0)).unwrap();
            prop_assert!((f64::from(gx) / 256.0 - dx).abs() < 0.1, "{gx} {dx}");
            prop_assert!((f64::from(gy) / 256.0 - dy).abs() < 0.1, "{gy} {dy}");
        }

        #[test]
        fn any_bytes_will_do(w in 0..40usize, h in 0..40usize, bytes in proptest::collection::vec(any::<u8>(), 3200), x in -20_000..20_000i32, y in -20_000..20_000i32, dx in -9000..9000i32) {
            let from = Image::new(&bytes, w, h, 40).unwrap();
            let to = Image::new(&bytes[1600..], w, h, 40).unwrap();
            let _ = corner(from, (0, 0), (w, h));
            if let Some((sx, sy)) = track(from, to, (x, y), (dx, 0)) {
                prop_assert!((sx - dx).abs().max(sy.abs()) <= MAX_SHIFT);
            }
        }
    }

    #[test]
    fn a_plain_or_striped_window_is_not_tracked() {
        let plain = render(30, 30, |_, _| 90.0);
        let stripes = render(30, 30, |x, _| 128.0 + 60.0 * x.sin());
        for pixels in [plain, stripes] {
            let image = Image::packed(&pixels, 30, 30).unwrap();
            assert_eq!(track(image, image, (15 << 8, 15 << 8), (0, 0)), None);
        }
    }
}
