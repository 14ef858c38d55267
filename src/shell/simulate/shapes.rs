//! Aircraft as a few solids, seen in perspective.

use crate::shell::formats::class::Class;
use crate::shell::support::vectors::{Rotation, WorldVector};
use std::vec::Vec;

/// Opacity of a spinning rotor.
const ROTOR: f64 = 0.5;

/// A part of an aircraft; lengths in spans, x right, y down, z forward.
#[derive(Debug, Clone, Copy)]
enum Part {
    /// A round bar between two points with a radius at each.
    Bar([WorldVector; 2], [f64; 2]),
    /// A flat convex plate.
    Plate([WorldVector; 4]),
    /// A spinning rotor about the y axis: centre and radius; half transparent.
    Rotor(WorldVector, f64),
}

/// An aircraft's parts, each with its tone (0 is the aircraft's own grey).
#[derive(Debug, Clone)]
pub(super) struct Shape {
    parts: Vec<(Part, f64)>,
    /// Its class in the ground truth.
    pub(super) class: Class,
}

impl Shape {
    /// Four arms with rotors, a body, skids and a camera below.
    pub(super) fn multirotor() -> Self {
        let mut parts = Vec::new();
        parts.push((Part::Bar([[0.0, 0.0, -0.11], [0.0, 0.01, 0.12]], [0.085, 0.075]), 0.0));
        parts.push((Part::Bar([[0.0, -0.05, -0.08], [0.0, -0.05, 0.06]], [0.05, 0.05]), 18.0));
        parts.push((Part::Bar([[0.0, 0.09, 0.09], [0.0, 0.10, 0.10]], [0.04, 0.04]), -12.0));
        for (x, z) in [(-0.31, -0.29), (0.31, -0.29), (-0.31, 0.29), (0.31, 0.29)] {
            let motor = [x, -0.02, z];
            parts.push((Part::Bar([[x * 0.15, 0.0, z * 0.15], motor], [0.03, 0.02]), 6.0));
            parts.push((Part::Bar([[x, -0.055, z], [x, 0.015, z]], [0.032, 0.032]), -8.0));
            parts.push((Part::Rotor([x, -0.065, z], 0.185), -5.0));
        }
        for x in [-1.0, 1.0] {
            let foot = [x * 0.13, 0.19, -0.09];
            let other = [x * 0.13, 0.19, 0.11];
            parts.push((
                Part::Bar([[x * 0.06, 0.05, 0.0], [x * 0.13, 0.19, 0.01]], [0.016; 2]),
                0.0,
            ));
            parts.push((Part::Bar([foot, other], [0.015; 2]), 0.0));
        }
        Self { parts, class: Class::Drone }
    }

    /// A fuselage with high wings, tail plane and fin.
    pub(super) fn aeroplane() -> Self {
        let wing = |x: f64| {
            Part::Plate([
                [0.0, -0.05, 0.13],
                [x, -0.065, 0.09],
                [x, -0.065, 0.0],
                [0.0, -0.05, -0.02],
            ])
        };
        let tail = |x: f64| {
            Part::Plate([
                [0.0, -0.03, -0.34],
                [x, -0.03, -0.37],
                [x, -0.03, -0.43],
                [0.0, -0.03, -0.44],
            ])
        };
        let fin =
            [[0.0, -0.02, -0.31], [0.0, -0.15, -0.40], [0.0, -0.15, -0.46], [0.0, -0.02, -0.45]];
        let parts = [
            (Part::Bar([[0.0, 0.0, 0.25], [0.0, 0.0, 0.05]], [0.04, 0.062]), 0.0),
            (Part::Bar([[0.0, 0.0, 0.05], [0.0, -0.02, -0.44]], [0.062, 0.018]), 0.0),
            (Part::Bar([[0.0, -0.03, 0.10], [0.0, -0.04, -0.02]], [0.045, 0.04]), 14.0),
            (wing(-0.5), 6.0),
            (wing(0.5), 6.0),
            // Spars give the wings a thickness when seen from the front.
            (Part::Bar([[0.0, -0.05, 0.09], [-0.49, -0.065, 0.06]], [0.016, 0.009]), 0.0),
            (Part::Bar([[0.0, -0.05, 0.09], [0.49, -0.065, 0.06]], [0.016, 0.009]), 0.0),
            (tail(-0.17), 4.0),
            (tail(0.17), 4.0),
            (Part::Plate(fin), 0.0),
        ];
        Self { parts: parts.into(), class: Class::Airplane }
    }
}

/// An aircraft as one camera pose sees it.
#[derive(Debug, Clone, Default)]
pub(super) struct Outline {
    /// From near to far.
    parts: Vec<VisiblePart>,
}

#[derive(Debug, Clone)]
struct VisiblePart {
    figure: PartOutline,
    tone: f64,
    depth: f64,
    /// Left, top, right, bottom.
    bounds: [f64; 4],
}

#[derive(Debug, Clone)]
enum PartOutline {
    /// Start, the way to the end over its squared length, radius at both.
    Bar {
        start: [f64; 2],
        way: [f64; 2],
        length2: f64,
        radius: [f64; 2],
    },
    Plate([[f64; 2]; 4]),
    /// Centre and the symmetric form (xx, xy, yy) that is 1 on the ellipse.
    Rotor {
        centre: [f64; 2],
        inverse: [f64; 3],
    },
}

impl Outline {
    /// Projects `shape` at `place` (camera frame, metres, in front), `span` metres wide and turned by `attitude`
    /// (world) into a camera turned by `camera`; pixels.
    pub(super) fn project(
        shape: &Shape,
        (place, span, attitude): (WorldVector, f64, &Rotation),
        camera: &Rotation,
        (width, height, focal): (usize, usize, f64),
    ) -> Self {
        let turn = |v: WorldVector| camera.invert(attitude.apply(v.map(|x| x * span)));
        let seat = |v: WorldVector| {
            let turned = turn(v);
            [place[0] + turned[0], place[1] + turned[1], place[2] + turned[2]]
        };
        let centre = (width as f64 / 2.0, height as f64 / 2.0);
        let point =
            |p: WorldVector| [centre.0 + focal * p[0] / p[2], centre.1 + focal * p[1] / p[2]];
        let mut parts: Vec<VisiblePart> = Vec::with_capacity(shape.parts.len());
        for &(part, tone) in &shape.parts {
            let (figure, depth, bounds) = match part {
                Part::Bar(ends, radii) => {
                    let ends = ends.map(seat);
                    let radius = [0, 1].map(|i| focal * radii[i] * span / ends[i][2]);
                    let [start, end] = ends.map(point);
                    let way = [end[0] - start[0], end[1] - start[1]];
                    let length2 = way[0] * way[0] + way[1] * way[1];
                    let wide = radius[0].max(radius[1]);
                    let bounds = bounds(&[start, end], wide);
                    let figure = PartOutline::Bar { start, way, length2, radius };
                    (figure, (ends[0][2] + ends[1][2]) / 2.0, bounds)
                }
                Part::Plate(corners) => {
                    let corners = corners.map(seat);
                    let depth = corners.iter().map(|corner| corner[2]).sum::<f64>() / 4.0;
                    let corners = corners.map(point);
                    (PartOutline::Plate(corners), depth, bounds(&corners, 0.0))
                }
                Part::Rotor(middle, radius) => {
                    let middle = seat(middle);
                    // Small against its distance: seen as an ellipse.
                    let axis = |v: WorldVector| {
                        let v = turn(v.map(|x| x * radius));
                        let far = [middle[0] + v[0], middle[1] + v[1], middle[2] + v[2]];
                        let (far, near) = (point(far), point(middle));
                        [far[0] - near[0], far[1] - near[1]]
                    };
                    let (a, b) = (axis([1.0, 0.0, 0.0]), axis([0.0, 0.0, 1.0]));
                    // The ellipse is all d with d' C^-1 d <= 1, C = a a' + b b'; seen from the edge
                    // it keeps the thickness of its blades.
                    let blade = 0.003 * (a[0] * a[0] + a[1] * a[1] + b[0] * b[0] + b[1] * b[1]);
                    let xx = a[0] * a[0] + b[0] * b[0] + blade;
                    let yy = a[1] * a[1] + b[1] * b[1] + blade;
                    let xy = a[0] * a[1] + b[0] * b[1];
                    let scale = xx * yy - xy * xy;
                    let inverse = [yy / scale, -xy / scale, xx / scale];
                    let centre = point(middle);
                    let figure = PartOutline::Rotor { centre, inverse };
                    let (wide, high) = (xx.sqrt(), yy.sqrt());
                    let [x, y] = centre;
                    (figure, middle[2], [x - wide, y - high, x + wide, y + high])
                }
            };
            parts.push(VisiblePart { figure, tone, depth, bounds });
        }
        // Stable: equal depths keep the order of the model.
        parts.sort_by(|a, b| a.depth.total_cmp(&b.depth));
        Self { parts }
    }

    /// Left, top, right and bottom of all parts; not tight.
    pub(super) fn bounds(&self) -> [f64; 4] {
        let widest = [f64::MAX, f64::MAX, f64::MIN, f64::MIN];
        self.parts.iter().fold(widest, |all, part| join(all, part.bounds))
    }

    /// Opacity 0..=1 and tone times opacity at a point of the picture.
    pub(super) fn at(&self, x: f64, y: f64) -> (f64, f64) {
        let (mut opacity, mut tone) = (0.0, 0.0);
        for part in &self.parts {
            let [left, top, right, bottom] = part.bounds;
            if x < left || x > right || y < top || y > bottom {
                continue;
            }
            if let Some((solid, light)) = part.figure.at(x, y) {
                let share = (1.0 - opacity) * solid;
                opacity += share;
                tone += share * (part.tone + light);
                if solid == 1.0 {
                    break;
                }
            }
        }
        (opacity, tone)
    }
}

impl PartOutline {
    /// Opacity and light of the surface where the figure covers the point.
    fn at(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        match self {
            Self::Bar { start, way, length2, radius } => {
                let (dx, dy) = (x - start[0], y - start[1]);
                let along = dx * way[0] + dy * way[1];
                let along = if *length2 > 0.0 { (along / length2).clamp(0.0, 1.0) } else { 0.0 };
                let (ax, ay) = (dx - way[0] * along, dy - way[1] * along);
                let radius = radius[0] + (radius[1] - radius[0]) * along;
                // The sky lights it from above.
                (ax * ax + ay * ay <= radius * radius).then(|| (1.0, -18.0 * ay / radius))
            }
            Self::Plate(corners) => {
                let (mut left, mut right) = (false, false);
                for i in 0..4 {
                    let (a, b) = (corners[i], corners[(i + 1) % 4]);
                    let side = (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]);
                    left |= side < 0.0;
                    right |= side > 0.0;
                }
                (left != right).then_some((1.0, 0.0))
            }
            Self::Rotor { centre, inverse } => {
                let (dx, dy) = (x - centre[0], y - centre[1]);
                let [xx, xy, yy] = inverse;
                let form = dx * dx * xx + 2.0 * dx * dy * xy + dy * dy * yy;
                (form <= 1.0).then_some((ROTOR, 0.0))
            }
        }
    }
}

fn bounds(points: &[[f64; 2]], margin: f64) -> [f64; 4] {
    points.iter().fold([f64::MAX, f64::MAX, f64::MIN, f64::MIN], |all, p| {
        join(all, [p[0] - margin, p[1] - margin, p[0] + margin, p[1] + margin])
    })
}

fn join(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3])]
}

#[cfg(test)]
mod tests {
    use super::*;

    const VIEW: (usize, usize, f64) = (640, 480, 560.0);

    fn seen(shape: &Shape, yaw: f64, pitch: f64) -> Outline {
        let level = Rotation::new(0.0, 0.0, 0.0);
        let attitude = Rotation::new(yaw, pitch, 0.0);
        Outline::project(shape, ([0.0, 0.0, 11.2], 1.0, &attitude), &level, VIEW)
    }

    /// Left, top, right, bottom of what is covered, by looking everywhere.
    fn extent(outline: &Outline) -> [f64; 4] {
        let mut all = [f64::MAX, f64::MAX, f64::MIN, f64::MIN];
        for step in 0..400 * 400 {
            let (x, y) = (270.0 + f64::from(step % 400) / 4.0, 190.0 + f64::from(step / 400) / 4.0);
            if outline.at(x, y).0 > 0.0 {
                all = join(all, [x, y, x, y]);
            }
        }
        all
    }

    #[test]
    fn shapes_are_as_wide_as_their_span() {
        // 1 m at 11.2 m and 560 px focal length: 50 px.
        for shape in [Shape::multirotor(), Shape::aeroplane()] {
            let [left, top, right, bottom] = extent(&seen(&shape, 0.0, 0.0));
            assert!((right - left - 50.0).abs() < 2.0, "{}", right - left);
            assert!((320.0 - (left + right) / 2.0).abs() < 0.5);
            assert!(bottom - top > 6.0 && bottom - top < 20.0, "{}", bottom - top);
        }
    }

    #[test]
    fn bounds_hold_everything() {
        for (yaw, pitch) in [(0.0, 0.0), (0.7, 0.2), (1.6, -0.3), (2.5, 1.0)] {
            for shape in [Shape::multirotor(), Shape::aeroplane()] {
                let outline = seen(&shape, yaw, pitch);
                let (outer, inner) = (outline.bounds(), extent(&outline));
                assert!(outer[0] <= inner[0] && outer[1] <= inner[1]);
                assert!(outer[2] >= inner[2] && outer[3] >= inner[3]);
                assert!(outer[2] - outer[0] < 90.0);
            }
        }
    }

    #[test]
    fn rotors_let_the_background_through() {
        let outline = seen(&Shape::multirotor(), 0.0, -1.5);
        let opacities: Vec<f64> = (0..5000)
            .map(|i| outline.at(270.0 + f64::from(i % 100), 215.0 + f64::from(i / 100)).0)
            .collect();
        assert!(opacities.contains(&1.0) && opacities.contains(&ROTOR) && opacities.contains(&0.0));
    }
}
