//! Solid models of aircraft: Wavefront OBJ, turned, shaded and rasterised to a cut-out.

use super::cutout::Cutout;
use crate::shell::formats::class::Class;
use crate::shell::support::vectors::{Rotation, WorldVector, add, dot};
use std::format;
use std::string::String;
use std::vec;
use std::vec::Vec;

/// Tile pixels for one pixel of the frame.
const SUPERSAMPLING: f64 = 3.0;
/// Largest side of a tile, pixels.
const LARGEST: f64 = 320.0;

/// A triangle mesh; coordinates in lengths of its longest extent, x right, y down, z forward, centred.
#[derive(Debug, Clone)]
pub(super) struct Solid {
    points: Vec<WorldVector>,
    triangles: Vec<[usize; 3]>,
    /// Longest extent, metres.
    pub length: f64,
    /// Class of the ground truth.
    pub class: Class,
}

/// A pose and light under which a solid is seen.
#[derive(Debug, Clone, Copy)]
pub(super) struct SolidPose<'a> {
    /// Centre in the camera's frame, metres.
    pub place: WorldVector,
    /// Longest extent, metres.
    pub length: f64,
    /// From the solid's frame to the world.
    pub attitude: &'a Rotation,
    /// From the camera's frame to the world.
    pub camera: &'a Rotation,
    /// Focal length, pixels.
    pub focal: f64,
    /// Direction towards the sun in the world, of length 1.
    pub sun: WorldVector,
    /// Grey level of a face in full sun, and that of one in shade.
    pub tones: [f64; 2],
}

impl Solid {
    /// Reads the vertices and faces of an OBJ file (x forward, y left, z up).
    ///
    /// # Errors
    /// Line number and the field that is wrong.
    pub(super) fn parse(text: &str, class: Class) -> Result<Self, String> {
        let mut points: Vec<WorldVector> = Vec::new();
        let mut triangles = Vec::new();
        for (index, line) in text.lines().enumerate() {
            let mut fields = line.split_whitespace();
            let wrong = |field: &str| format!("line {}: '{field}' is not understood", index + 1);
            match fields.next() {
                Some("v") => {
                    let mut v = [0.0; 3];
                    for value in &mut v {
                        let field = fields.next().unwrap_or("");
                        *value = field
                            .parse::<f64>()
                            .ok()
                            .filter(|v| v.is_finite())
                            .ok_or_else(|| wrong(field))?;
                    }
                    points.push([-v[1], -v[2], v[0]]);
                }
                Some("f") => {
                    let corner = |field: &str| {
                        let number = field.split('/').next().unwrap_or("");
                        let number: i64 = number.parse().map_err(|_| wrong(field))?;
                        let index =
                            if number < 0 { points.len() as i64 + number } else { number - 1 };
                        usize::try_from(index)
                            .ok()
                            .filter(|&i| i < points.len())
                            .ok_or_else(|| wrong(field))
                    };
                    let corners = fields.map(corner).collect::<Result<Vec<usize>, String>>()?;
                    triangles.extend(
                        (2..corners.len()).map(|i| [corners[0], corners[i - 1], corners[i]]),
                    );
                }
                _ => {}
            }
        }
        let mut low = [f64::MAX; 3];
        let mut high = [f64::MIN; 3];
        for point in triangles.iter().flatten().map(|&i: &usize| points[i]) {
            for axis in 0..3 {
                (low[axis], high[axis]) = (low[axis].min(point[axis]), high[axis].max(point[axis]));
            }
        }
        let length = (0..3).map(|i| high[i] - low[i]).fold(0.0, f64::max);
        if triangles.is_empty() || length <= 0.0 {
            return Err("no faces".into());
        }
        for point in &mut points {
            *point = core::array::from_fn(|i| (point[i] - (low[i] + high[i]) / 2.0) / length);
        }
        Ok(Self { points, triangles, length, class })
    }

    /// Rasterises the solid; the cut-out, the pixel of the frame (relative to the optical axis) where the centre of its
    /// bounds is, and their size. `None` if a part of it is behind the camera or nothing is seen.
    pub(super) fn render(&self, pose: &SolidPose<'_>) -> Option<(Cutout, [f64; 2], [f64; 2])> {
        let SolidPose { place, length, attitude, camera, focal, sun, tones } = *pose;
        let turned: Vec<WorldVector> =
            self.points.iter().map(|&p| attitude.apply(p.map(|v| v * length))).collect();
        let mut seen = Vec::with_capacity(turned.len());
        let mut bounds = [f64::MAX, f64::MAX, f64::MIN, f64::MIN];
        for point in &turned {
            let [x, y, z] = add(camera.invert(*point), place, 1.0);
            if z < 0.1 * length {
                return None;
            }
            let [x, y] = [focal * x / z, focal * y / z];
            bounds = [bounds[0].min(x), bounds[1].min(y), bounds[2].max(x), bounds[3].max(y)];
            seen.push([x, y, z]);
        }
        let [left, top, right, bottom] = bounds;
        let scale = SUPERSAMPLING.min(LARGEST / (right - left).max(bottom - top)).max(0.1);
        let side = |from: f64, to: f64| ((to - from) * scale).ceil() as usize + 3;
        let (width, height) = (side(left, right), side(top, bottom));
        let sight = camera.apply(place);
        let mut depth = vec![f64::MAX; width * height];
        let mut pixels = vec![[0u8; 2]; width * height];
        for &corners in &self.triangles {
            let [a, b, c] = corners.map(|i| {
                let [x, y, z] = seen[i];
                [(x - left) * scale + 1.0, (y - top) * scale + 1.0, z]
            });
            let [p, q, r] = corners.map(|i| turned[i]);
            let (pq, pr) = (add(q, p, -1.0), add(r, p, -1.0));
            let normal = [
                pq[1] * pr[2] - pq[2] * pr[1],
                pq[2] * pr[0] - pq[0] * pr[2],
                pq[0] * pr[1] - pq[1] * pr[0],
            ];
            let area = dot(normal, normal).sqrt();
            // Both sides of thin parts are seen: the one towards the camera counts.
            let facing = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
            if area == 0.0 || facing == 0.0 {
                continue;
            }
            let outward = if dot(normal, sight) < 0.0 { 1.0 } else { -1.0 };
            let lit = (outward * dot(normal, sun) / area).max(0.0);
            let tone = (tones[1] + (tones[0] - tones[1]) * lit).clamp(0.0, 255.0) as u8;
            let low = |i: usize| a[i].min(b[i]).min(c[i]).floor().max(0.0) as usize;
            let high =
                |i: usize, end: usize| (a[i].max(b[i]).max(c[i]).ceil() as usize + 1).min(end);
            for y in low(1)..high(1, height) {
                for x in low(0)..high(0, width) {
                    let (px, py) = (x as f64 + 0.5, y as f64 + 0.5);
                    let edge = |m: [f64; 3], n: [f64; 3]| {
                        ((n[0] - m[0]) * (py - m[1]) - (n[1] - m[1]) * (px - m[0])) / facing
                    };
                    let (wa, wb, wc) = (edge(b, c), edge(c, a), edge(a, b));
                    // A little beyond the edges, so that no struts fall between the pixels.
                    let slack = -0.35 / facing.abs().sqrt().max(1.0);
                    if wa < slack || wb < slack || wc < slack {
                        continue;
                    }
                    let z = wa * a[2] + wb * b[2] + wc * c[2];
                    let index = y * width + x;
                    if z < depth[index] {
                        depth[index] = z;
                        pixels[index] = [255, tone];
                    }
                }
            }
        }
        let cutout = Cutout::of(width, height, pixels, self.class)?;
        let [x, y, wide, high] = cutout.bounds;
        let centre = [left + (x + wide / 2.0 - 1.0) / scale, top + (y + high / 2.0 - 1.0) / scale];
        Some((cutout, centre, [wide / scale, high / scale]))
    }
}
