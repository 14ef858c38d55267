//! The slices of a cube along the optical flow of its window.
//!
//! The paper's comparison for Algorithm 1 (section 4.2): pyramidal Lucas-Kanade flow of the window's content from slice to
//! slice. It follows structure, which over trees and fields is the background's.

use crate::channels::front_end::Slices;
use crate::channels::window::Position;
use crate::channels::window::SLICES;
use crate::image::Image;
use crate::image::pyramid;
use crate::registration::lucas_kanade;
use crate::stcube::compensation::{FIRST_SCALAR, Trajectory};
use crate::stcube::cube::Cube;

/// Levels of the flow's own pyramid: windows of the target, of the cube, and of twice that.
const LEVELS: usize = 3;

/// Side of the pictures in which a window is followed, in pixels of the window's level.
const SIDE: usize = 80;

/// Most samples of the frame along one side of a pixel of the level: keeps coarse levels from aliasing.
const MOST_SAMPLES: i64 = 4;

/// A small pyramid of the surroundings of a point.
struct Surroundings {
    pixels: [u8; Self::LEN],
}

impl Surroundings {
    const LEN: usize = SIDE * SIDE * 21 / 16;
    const EMPTY: Self = Self { pixels: [0; Self::LEN] };

    /// Takes the surroundings of `centre` (Q8 pixels of the frame) with pixels of `scale` (Q16) frame pixels.
    fn take(&mut self, frame: &Image<'_>, centre: (i32, i32), scale: u32) {
        let scale = i64::from(scale);
        let samples = ((scale + 65535) >> 16).clamp(1, MOST_SAMPLES);
        // Place of sample `a` of pixel `i` in the frame, in sixteenths of a pixel from the middle of pixel 0.
        let place = |centre: i32, i: usize, a: i64| {
            let from_middle = 2 * samples * (i as i64 - SIDE as i64 / 2) + 2 * a + 1;
            (i64::from(centre) * 16 + (((from_middle * scale) / (2 * samples)) >> 4) - 2048) >> 8
        };
        // The pixels of a line of `length` on both sides of a sample, and the weight of the second one in sixteenths.
        let sides = |at: i64, length: usize| {
            let pixel = |at: i64| at.min(length as i64 - 1).max(0) as usize;
            (pixel(at >> 4), pixel((at >> 4) + 1), (at & 15) as u32)
        };
        let mut columns = [[(0, 0, 0); MOST_SAMPLES as usize]; SIDE];
        for (i, columns) in columns.iter_mut().enumerate() {
            for (a, column) in (0..samples).zip(columns) {
                *column = sides(place(centre.0, i, a), frame.width());
            }
        }
        let (area, samples_across) = (256 * (samples * samples) as u32, samples as usize);
        for (j, row) in self.pixels[..SIDE * SIDE].chunks_exact_mut(SIDE).enumerate() {
            let mut sums = [0u32; SIDE];
            for b in 0..samples {
                let (upper, lower, down) = sides(place(centre.1, j, b), frame.height());
                let (upper, lower) = (frame.row(upper), frame.row(lower));
                for (sum, columns) in sums.iter_mut().zip(&columns) {
                    for &(left, next, right) in columns.iter().take(samples_across) {
                        let across = |row: &[u8]| {
                            u32::from(row[left]) * (16 - right) + u32::from(row[next]) * right
                        };
                        *sum += across(upper) * (16 - down) + across(lower) * down;
                    }
                }
            }
            for (out, sum) in row.iter_mut().zip(sums) {
                *out = (sum / area) as u8;
            }
        }
        let (mut above, mut rest) = self.pixels.split_at_mut(SIDE * SIDE);
        for level in 1..LEVELS {
            let (out, below) = rest.split_at_mut((SIDE >> level) * (SIDE >> level));
            pyramid::halve(picture(above, level - 1), out);
            (above, rest) = (out, below);
        }
    }

    /// The levels, finest first.
    fn levels(&self) -> [Image<'_>; LEVELS] {
        let mut rest = &self.pixels[..];
        core::array::from_fn(|level| {
            let (pixels, below) = rest.split_at((SIDE >> level) * (SIDE >> level));
            rest = below;
            picture(pixels, level)
        })
    }
}

#[allow(clippy::expect_used, reason = "the pixels are those of the level")]
fn picture(pixels: &[u8], level: usize) -> Image<'_> {
    Image::packed(pixels, SIDE >> level, SIDE >> level).expect("the pixels are those of the level")
}

/// From the middle of `from` to what looks like it in `to`: pixels of the finest level, Q8. Where the flow of a level
/// cannot be found, that of the coarser one stands.
fn track(from: &Surroundings, to: &Surroundings) -> (i32, i32) {
    let (from, to) = (from.levels(), to.levels());
    let mut shift = (0, 0);
    for level in (0..LEVELS).rev() {
        let middle = (SIDE as i32) << 7 >> level;
        let guess = (shift.0 >> level, shift.1 >> level);
        if let Some((x, y)) = lucas_kanade::track(from[level], to[level], (middle, middle), guess) {
            shift = (x << level, y << level);
        }
    }
    shift
}

/// Cuts the cube of the window at `start`: each older slice lies where the flow from the slice before leads, sought from
/// where the background's motion puts it. `frames` are those of `slices`, newest first.
// Its surroundings take room on the stack: nobody who follows otherwise is to give it.
#[inline(never)]
pub fn follow(
    slices: &Slices<'_>,
    frames: &[Image<'_>; SLICES],
    start: Position,
    cube: &mut Cube,
) -> Trajectory {
    let mut path = Trajectory::default();
    let (mut here, mut there) = (Surroundings::EMPTY, Surroundings::EMPTY);
    let mut at = start;
    for k in 0..SLICES {
        let mut origin = at;
        if let Some(newer) = k.checked_sub(1) {
            let centre = at.centre(slices.scale);
            let guess = slices.motions[newer].map(centre.0, centre.1);
            origin = Position::centred(guess, slices.scale);
            here.take(&frames[newer], centre, slices.scale);
            there.take(&frames[k], guess, slices.scale);
            let (x, y) = track(&here, &there);
            let pixels = |shift: i32| ((i64::from(shift) * i64::from(slices.scale)) >> 16) as i32;
            at = Position::centred((guess.0 + pixels(x), guess.1 + pixels(y)), slices.scale);
        }
        match &slices.slices[k] {
            Some(slice) => cube.slices[k].cut(slice, at.x, at.y),
            None => cube.slices[k].clear(),
        }
        path.positions[k] = at;
        path.moved[k] = Position { x: at.x - origin.x, y: at.y - origin.y };
    }
    cube.newest.cut_newest(&slices.newest, start.x, start.y);
    cube.scalars[FIRST_SCALAR..].copy_from_slice(&path.scalars());
    path
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::channels::window::SUBCELL;
    use crate::channels::{Difference, NewestChannels, Slice};
    use crate::image::gradient::CELL;
    use crate::registration::GlobalMotion;
    use crate::registration::lucas_kanade::tests::{render, texture};
    use proptest::prelude::*;
    use std::vec::Vec;

    const WIDTH: usize = 320;
    const HEIGHT: usize = 240;

    fn empty() -> Cube {
        Cube::EMPTY
    }

    /// Slices in which there is nothing: the flow looks at the frames.
    fn plain(scale: u32) -> Slices<'static> {
        let picture = Image::packed(&[90; 12], 4, 3).unwrap();
        let difference = Difference { picture, halved: false };
        let slice = Slice { grey: picture, near: difference };
        Slices {
            slices: [Some(slice); SLICES],
            newest: NewestChannels { slice, far: difference, plain: difference, oriented: true },
            motions: [GlobalMotion::IDENTITY; SLICES - 1],
            scale,
        }
    }

    /// Positions of the slices where the picture moves by `step` pixels a frame, in frame pixels from the newest.
    fn followed(step: (f64, f64), scale: u32) -> [(f64, f64); SLICES] {
        let frames: Vec<Vec<u8>> = (0..SLICES)
            .map(|k| {
                let (dx, dy) = (step.0 * k as f64, step.1 * k as f64);
                render(WIDTH, HEIGHT, |x, y| texture(x + dx, y + dy))
            })
            .collect();
        let frames = core::array::from_fn(|k| Image::packed(&frames[k], WIDTH, HEIGHT).unwrap());
        let slices = plain(scale);
        let start = Position::centred((160 << 8, 120 << 8), scale);
        let path = follow(&slices, &frames, start, &mut empty());
        let unit = f64::from(scale) / 65536.0 * CELL as f64 / f64::from(SUBCELL);
        path.positions.map(|p| (f64::from(p.x - start.x) * unit, f64::from(p.y - start.y) * unit))
    }

    #[test]
    fn slices_follow_a_moving_picture() {
        for scale in [65536, 92682, 3 * 65536] {
            for step in [(0.0, 0.0), (2.5, -1.5), (-4.0, 6.0)] {
                let quarter = f64::from(scale) / 65536.0 / 2.0;
                for (k, (x, y)) in followed(step, scale).into_iter().enumerate() {
                    // The content moves by `step` a frame: the older slice lies against the motion.
                    let (wx, wy) = (-step.0 * k as f64, -step.1 * k as f64);
                    let allowed = 0.1 + quarter * k as f64;
                    assert!(
                        (x - wx).abs() <= allowed && (y - wy).abs() <= allowed,
                        "{scale} {step:?} {k}: {x} {y}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_plain_picture_holds_the_slices_where_they_are() {
        let frames = [Image::packed(&[90; 64 * 48], 64, 48).unwrap(); SLICES];
        let slices = plain(65536);
        // Partly outside, too.
        for x in [-30, 20, 100] {
            let start = Position { x, y: 20 };
            let path = follow(&slices, &frames, start, &mut empty());
            assert_eq!((path.positions, path.moves), ([start; SLICES], 0));
        }
    }

    proptest! {
        #[test]
        fn surroundings_are_means_of_bilinear_samples(
            pixels in prop::collection::vec(any::<u8>(), 40 * 30), x in -20..60i32, y in -20..50i32, scale in 65536..400_000u32,
        ) {
            let frame = Image::packed(&pixels, 40, 30).unwrap();
            let centre = (x * 256 + 77, y * 256 + 200);
            let mut surroundings = Surroundings::EMPTY;
            surroundings.take(&frame, centre, scale);
            let scale = i64::from(scale);
            let samples = ((scale + 65535) >> 16).min(MOST_SAMPLES);
            let pixel = |x: i64, y: i64| {
                let inside = |v: i64, length: i64| v.clamp(0, length - 1) as usize;
                i64::from(frame.row(inside(y, 30))[inside(x, 40)])
            };
            // Sixteenths of a pixel from the middle of pixel 0.
            let place = |centre: i32, i: usize, a: i64| {
                let from_middle = 2 * samples * (i as i64 - SIDE as i64 / 2) + 2 * a + 1;
                (i64::from(centre) * 16 + (((from_middle * scale) / (2 * samples)) >> 4) - 2048) >> 8
            };
            for (j, i) in (0..SIDE).flat_map(|j| (0..SIDE).map(move |i| (j, i))) {
                let mut sum = 0;
                for (b, a) in (0..samples).flat_map(|b| (0..samples).map(move |a| (b, a))) {
                    let (x, y) = (place(centre.0, i, a), place(centre.1, j, b));
                    let (left, top, right, down) = (x >> 4, y >> 4, x & 15, y & 15);
                    let row = |y| pixel(left, y) * (16 - right) + pixel(left + 1, y) * right;
                    sum += row(top) * (16 - down) + row(top + 1) * down;
                }
                let naive = sum / (256 * samples * samples);
                prop_assert_eq!(i64::from(surroundings.levels()[0].row(j)[i]), naive, "{} {}", i, j);
            }
        }
    }
}
