//! Objects cut out of recorded frames: what differs from the plain sky around them.

use crate::shell::formats::class::Class;
use crate::shell::formats::clips::TruthBox;
use crate::shell::sources::Frame;
use std::vec::Vec;

/// Pixels around a box that are cut out with it.
const MARGIN: usize = 4;

/// Pixels along the edge of what is cut out from which the sky is learned.
const RIM: usize = 2;

/// Largest root mean square of the sky's own differences, grey levels: a sky that hides no part of an object.
const PLAIN: f64 = 4.0;

/// Lengths of objects that are cut out, pixels along the longer side: large enough to be shown smaller.
const LENGTHS: core::ops::RangeInclusive<f64> = 18.0..=160.0;

/// The same of birds, which are filmed from farther away.
const BIRD_LENGTHS: core::ops::RangeInclusive<f64> = 10.0..=160.0;

/// Opacity from which on a pixel belongs to the object's box, of 255.
const SOLID: u8 = 51;

/// An object without what was behind it.
#[derive(Debug, Clone)]
pub struct Cutout {
    width: usize,
    height: usize,
    /// Opacity and light of each pixel, row by row; light is grey levels times opacity.
    pixels: Vec<[u8; 2]>,
    /// Bounding box of its opaque part: left, top, width, height in its pixels.
    pub bounds: [f64; 4],
    /// Its class in the ground truth.
    pub class: Class,
}

impl Cutout {
    /// Cuts the object in the box out of `frame`; none where it is too small, too large, cut by the frame's edge, or
    /// not before a plain sky.
    pub fn cut(frame: &Frame, truth: &TruthBox) -> Option<Self> {
        let lengths = if truth.class == Class::Bird { BIRD_LENGTHS } else { LENGTHS };
        if truth.visibility < 1.0 || !lengths.contains(&truth.width.max(truth.height)) {
            return None;
        }
        let span = |from: f64, length: f64, end: usize| {
            let first = (from.floor().max(0.0) as usize).checked_sub(MARGIN)?;
            let last = (from + length).ceil() as usize + MARGIN;
            (last <= end).then_some((first, last - first))
        };
        let (left, width) = span(truth.left, truth.width, frame.width)?;
        let (top, height) = span(truth.top, truth.height, frame.height)?;
        let grey = |x: usize, y: usize| f64::from(frame.pixels[(top + y) * frame.width + left + x]);
        let places = || (0..height).flat_map(move |y| (0..width).map(move |x| (x, y)));
        let inner = |(x, y): (usize, usize)| {
            (RIM..width - RIM).contains(&x) && (RIM..height - RIM).contains(&y)
        };
        let sky = Sky::of(&grey, width, height);
        let difference = |(x, y)| grey(x, y) - sky.at(x, y);
        let rim: Vec<f64> = places().filter(|&at| !inner(at)).map(difference).collect();
        let mean =
            |of: &dyn Fn(f64) -> f64| rim.iter().map(|&d| of(d)).sum::<f64>() / rim.len() as f64;
        if mean(&|d| d * d) > PLAIN * PLAIN {
            return None;
        }
        // From twice the sky's own differences on it is the object; all of it well below its strongest difference.
        let noise = 2.0 * (mean(&f64::abs) + 0.5);
        let mut sizes: Vec<f64> = places().map(|at| difference(at).abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let full = (0.35 * sizes[sizes.len() * 24 / 25]).max(6.0);
        let pixel = |at: (usize, usize)| {
            let opacity =
                ((difference(at).abs() - noise) / (full - noise).max(2.0)).clamp(0.0, 1.0);
            if !inner(at) || opacity == 0.0 {
                return [0, 0];
            }
            let light = difference(at) + opacity * sky.at(at.0, at.1);
            [(opacity * 255.0).round() as u8, light.round().clamp(0.0, 255.0) as u8]
        };
        let pixels: Vec<[u8; 2]> = places().map(pixel).collect();
        let solid = || places().zip(&pixels).filter(|(_, [opacity, _])| *opacity >= SOLID);
        let range = |of: fn((usize, usize)) -> usize| {
            let first = solid().map(|(at, _)| of(at)).min()?;
            let last = solid().map(|(at, _)| of(at)).max()?;
            Some((first as f64, (last + 1 - first) as f64))
        };
        let (x, y) = (range(|at| at.0)?, range(|at| at.1)?);
        let bounds = [x.0, y.0, x.1, y.1];
        lengths.contains(&x.1.max(y.1)).then_some(Self {
            width,
            height,
            pixels,
            bounds,
            class: truth.class,
        })
    }

    /// An object of pixels that are known: opacity and light of each, row by row; none where nothing of it is solid.
    pub(super) fn of(
        width: usize,
        height: usize,
        pixels: Vec<[u8; 2]>,
        class: Class,
    ) -> Option<Self> {
        let solid = || (0..width * height).filter(|&i| pixels[i][0] >= SOLID);
        let (left, right) = (solid().map(|i| i % width).min()?, solid().map(|i| i % width).max()?);
        let (top, bottom) = (solid().next()? / width, solid().next_back()? / width);
        let bounds = [left, top, right + 1 - left, bottom + 1 - top].map(|v| v as f64);
        Some(Self { width, height, pixels, bounds, class })
    }

    /// Left, top, right and bottom of a box beyond which [`Cutout::at`] gives 0.
    pub fn reach(&self) -> [f64; 4] {
        let mut reach = [f64::MAX, f64::MAX, f64::MIN, f64::MIN];
        for (i, _) in self.pixels.iter().enumerate().filter(|(_, pixel)| **pixel != [0, 0]) {
            let (x, y) = ((i % self.width) as f64, (i / self.width) as f64);
            let [left, top, right, bottom] = reach;
            reach = [left.min(x - 0.5), top.min(y - 0.5), right.max(x + 1.5), bottom.max(y + 1.5)];
        }
        reach
    }

    /// Opacity (0 to 1) and light (grey levels times opacity) at a point, between the centres of its pixels bilinear;
    /// 0 outside. Its left upper corner is (0, 0).
    pub fn at(&self, x: f64, y: f64) -> [f64; 2] {
        let (x, y) = (x - 0.5, y - 0.5);
        let (left, top) = (x.floor(), y.floor());
        let (across, down) = (x - left, y - top);
        let mut sum = [0.0; 2];
        // Most sampled points are beside the object.
        if left < -1.0 || top < -1.0 || left >= self.width as f64 || top >= self.height as f64 {
            return sum;
        }
        let (left, top) = (left as isize, top as isize);
        let pixel = |x: isize, y: isize| {
            let inside =
                (0..self.width as isize).contains(&x) && (0..self.height as isize).contains(&y);
            if inside { self.pixels[y as usize * self.width + x as usize] } else { [0, 0] }
        };
        for (j, row) in [1.0 - down, down].into_iter().enumerate() {
            for (i, column) in [1.0 - across, across].into_iter().enumerate() {
                let [opacity, light] = pixel(left + i as isize, top + j as isize);
                if (opacity, light) == (0, 0) {
                    continue;
                }
                sum[0] += row * column * f64::from(opacity) / 255.0;
                sum[1] += row * column * f64::from(light);
            }
        }
        sum
    }
}

/// The sky around an object: a plane of grey levels through what is seen along the edges.
struct Sky {
    /// Means along the left and upper edge, and what is added for each pixel to the right and down.
    edges: [(f64, f64); 2],
    mean: f64,
}

impl Sky {
    fn of(grey: &impl Fn(usize, usize) -> f64, width: usize, height: usize) -> Self {
        let mean = |xs: core::ops::Range<usize>, ys: core::ops::Range<usize>| {
            let count = (xs.len() * ys.len()) as f64;
            ys.flat_map(|y| xs.clone().map(move |x| (x, y))).map(|(x, y)| grey(x, y)).sum::<f64>()
                / count
        };
        let across = [mean(0..RIM, 0..height), mean(width - RIM..width, 0..height)];
        let down = [mean(0..width, 0..RIM), mean(0..width, height - RIM..height)];
        let line = |[first, last]: [f64; 2], length: usize| {
            let slope = (last - first) / (length - RIM) as f64;
            (first - slope * (RIM as f64 - 1.0) / 2.0, slope)
        };
        Self {
            edges: [line(across, width), line(down, height)],
            mean: (across[0] + across[1] + down[0] + down[1]) / 4.0,
        }
    }

    fn at(&self, x: usize, y: usize) -> f64 {
        let [(left, right), (upper, down)] = self.edges;
        left + right * x as f64 + upper + down * y as f64 - self.mean
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;

    /// A sky that brightens to the right and down, with a bar of grey level 40 in a box.
    fn frame(truth: &TruthBox) -> Frame {
        let (width, height) = (120usize, 90usize);
        let mut frame = Frame { pixels: vec![0; width * height], width, height, time_us: 0 };
        for (i, pixel) in frame.pixels.iter_mut().enumerate() {
            let (x, y) = ((i % width) as f64, (i / width) as f64);
            let inside = (truth.left..truth.left + truth.width).contains(&x)
                && (truth.top..truth.top + truth.height).contains(&y);
            *pixel = if inside { 40 } else { (150.0 + x / 4.0 + y / 8.0) as u8 };
        }
        frame
    }

    fn truth(left: f64, top: f64, width: f64, height: f64) -> TruthBox {
        TruthBox { id: 1, left, top, width, height, class: Class::Helicopter, visibility: 1.0 }
    }

    #[test]
    fn a_bar_is_cut_out_of_a_slanting_sky() {
        let truth = truth(40.0, 30.0, 30.0, 8.0);
        let cutout = Cutout::cut(&frame(&truth), &truth).unwrap();
        let margin = MARGIN as f64;
        assert_eq!(cutout.bounds, [margin, margin, 30.0, 8.0]);
        assert_eq!(cutout.class, Class::Helicopter);
        let [opacity, light] = cutout.at(margin + 15.0, margin + 4.0);
        assert!(opacity == 1.0 && (light - 40.0).abs() <= 1.0, "{opacity} {light}");
        assert_eq!(cutout.at(margin + 15.0, margin - 1.5), [0.0, 0.0]);
        assert_eq!(cutout.at(-5.0, 400.0), [0.0, 0.0]);
    }

    #[test]
    fn what_cannot_be_told_from_its_surroundings_is_not_cut_out() {
        let good = truth(40.0, 30.0, 30.0, 8.0);
        let mut picture = frame(&good);
        for bad in
            [truth(2.0, 30.0, 30.0, 8.0), truth(40.0, 80.0, 30.0, 8.0), truth(40.0, 30.0, 9.0, 8.0)]
        {
            assert!(Cutout::cut(&frame(&bad), &bad).is_none(), "{bad:?}");
        }
        let cut = TruthBox { visibility: 0.5, ..good };
        assert!(Cutout::cut(&picture, &cut).is_none());
        picture.pixels.iter_mut().step_by(3).for_each(|pixel| *pixel -= 30);
        assert!(Cutout::cut(&picture, &good).is_none());
    }
}
