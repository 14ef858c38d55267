//! Draws cut-out objects into a frame.

use super::cutout::Cutout;
use crate::shell::support::vectors::sin_cos;

/// Pixels around the solid part of a cut-out that are drawn too, of the cut-out.
const HALO: f64 = 5.0;
/// Most parts of a pixel each way, and most instants of the exposure.
const MOST: (f64, f64) = (3.0, 6.0);
/// Opacity from which on a pixel belongs to an object's box.
const VISIBLE: f64 = 0.2;

/// Where and how an object is drawn.
#[derive(Debug, Clone, Copy)]
pub(super) struct Placement {
    /// Centre of its solid bounds in the frame, pixels.
    pub centre: [f64; 2],
    /// Width and height of its solid bounds before the turn, pixels.
    pub size: [f64; 2],
    /// Clockwise turn, radians.
    pub turn: f64,
    /// Left and right change places.
    pub mirrored: bool,
    /// Way of the object during the exposure, pixels.
    pub blur: [f64; 2],
}

/// Change of an object's grey levels: `gain * light + offset`, then 255 less it if inverted.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tone {
    pub gain: f64,
    pub offset: f64,
    pub inverted: bool,
    /// Factor of the opacity.
    pub opacity: f64,
}

impl Tone {
    /// No change.
    pub(super) const PLAIN: Self = Self { gain: 1.0, offset: 0.0, inverted: false, opacity: 1.0 };
}

/// Result of drawing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Drawn {
    /// Left, top, right, bottom of the visible pixels in the frame.
    pub bounds: [f64; 4],
    /// Mean change of the object's pixels, grey levels.
    pub contrast: f64,
    /// Whether a part of it is outside of the frame.
    pub cut: bool,
}

/// Draws an object; `None` if nothing of it is visible. Each pixel is the mean over its area and the exposure.
pub(super) fn draw(
    pixels: &mut [u8],
    [width, height]: [usize; 2],
    cutout: &Cutout,
    placement: &Placement,
    tone: &Tone,
) -> Option<Drawn> {
    let [left, top, wide, high] = cutout.bounds;
    let Placement { centre, size, turn, mirrored, blur } = *placement;
    if !(size[0] > 0.2 && size[1] > 0.2) {
        return None;
    }
    let steps = [wide / size[0], high / size[1]];
    let length = (blur[0] * blur[0] + blur[1] * blur[1]).sqrt();
    let parts = steps[0].max(steps[1]).ceil().clamp(1.0, MOST.0);
    let times = (length + 0.4).ceil().clamp(1.0, MOST.1);
    let (sine, cosine) = sin_cos(turn);
    let halves = [0, 1].map(|i: usize| size[i] / 2.0 + HALO / steps[i] + 1.0);
    let reach = [
        halves[0] * cosine.abs() + halves[1] * sine.abs() + blur[0].abs() / 2.0,
        halves[0] * sine.abs() + halves[1] * cosine.abs() + blur[1].abs() / 2.0,
    ];
    // Two pixels beyond the frame, to see whether the object is cut.
    let span = |i: usize, end: usize| {
        let first = (centre[i] - reach[i]).floor().clamp(-2.0, end as f64 + 2.0);
        let last = (centre[i] + reach[i]).ceil().clamp(-2.0, end as f64 + 2.0);
        first as i64..last as i64
    };
    let (mut changes, mut weight) = (0.0, 0.0);
    let mut bounds = [i64::MAX, i64::MAX, i64::MIN, i64::MIN];
    let mut cut = false;
    let count = parts * parts * times;
    for y in span(1, height) {
        for x in span(0, width) {
            let [mut opacity, mut light] = [0.0; 2];
            for time in 0..times as i64 {
                let moved = (time as f64 + 0.5) / times - 0.5;
                for part in 0..(parts * parts) as i64 {
                    let across = (part % parts as i64) as f64 + 0.5;
                    let down = (part / parts as i64) as f64 + 0.5;
                    let dx = x as f64 + across / parts - centre[0] - blur[0] * moved;
                    let dy = y as f64 + down / parts - centre[1] - blur[1] * moved;
                    let (u, v) = (dx * cosine + dy * sine, dy * cosine - dx * sine);
                    let u = if mirrored { -u } else { u };
                    let [o, l] = cutout
                        .at(left + wide / 2.0 + u * steps[0], top + high / 2.0 + v * steps[1]);
                    opacity += o;
                    light += l;
                }
            }
            (opacity, light) = (opacity / count * tone.opacity, light / count * tone.opacity);
            if opacity <= 0.0 {
                continue;
            }
            let inside = (0..width as i64).contains(&x) && (0..height as i64).contains(&y);
            if opacity >= VISIBLE * tone.opacity {
                if inside {
                    let [left, top, right, bottom] = bounds;
                    bounds = [left.min(x), top.min(y), right.max(x + 1), bottom.max(y + 1)];
                } else {
                    cut = true;
                }
            }
            if !inside {
                continue;
            }
            let toned = tone.gain * light + tone.offset * opacity;
            let toned = if tone.inverted { 255.0 * opacity - toned } else { toned };
            let pixel = &mut pixels[y as usize * width + x as usize];
            let behind = f64::from(*pixel) * opacity;
            let toned = toned.clamp(0.0, 255.0 * opacity);
            changes += (toned - behind).abs();
            weight += opacity;
            *pixel = (f64::from(*pixel) - behind + toned + 0.5).clamp(0.0, 255.0) as u8;
        }
    }
    (bounds[0] < bounds[2]).then(|| Drawn {
        bounds: bounds.map(|v| v as f64),
        contrast: changes / weight,
        cut,
    })
}
