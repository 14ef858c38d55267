//! Measurement model: a detection as direction and angular size with their errors, in a non-rotating frame of reference.

use super::settings::TrackerSettings;
use crate::camera::Camera;
use crate::camera::attitude::Attitude;
use crate::detector::detection::{Detection, SHIFTS};
use crate::image::Rect;
use crate::math::kalman::{MAX_VARIANCE, MILLI};
use crate::math::real::{ONE, Real, Vector, add, divide, exp, ln, norm, ratio, reject, unit};
use fixed::types::I28F4;

/// Attitudes of the camera in a frame and the frames before it.
#[derive(Debug, Clone)]
pub struct CameraPose<'a> {
    /// Intrinsics and mounting of the camera.
    pub camera: &'a Camera,
    /// From the body to the frame of reference.
    pub attitude: Attitude,
    /// Its error that differs from frame to frame, in radians.
    pub error: Real,
    /// Seconds ago and attitudes of the frames before, the last one first.
    pub before: heapless::Vec<(Real, Attitude), SHIFTS>,
}

/// A detection in the frame of reference. Variances in thousandths squared.
#[derive(Debug, Clone, Copy)]
pub struct Measurement {
    pub rect: Rect,
    /// [`Detection::score`](crate::detector::Detection::score): mean over the last frames, log-odds, Q16.
    pub score: i32,
    /// Score of the frame alone, log-odds, Q16.
    pub frame_score: i32,
    pub direction: Vector,
    pub variance: Real,
    pub size: Real,
    pub size_variance: Real,
    pub aspect: Real,
    /// In radians a second, from the shifts.
    pub rate: Option<(Vector, Real)>,
    /// Whether the frame's edge cuts it.
    pub cut: bool,
}

impl Measurement {
    #[inline(never)]
    pub fn new(detection: &Detection, pose: &CameraPose<'_>, settings: &TrackerSettings) -> Self {
        let camera = pose.camera;
        let limit = I28F4::from_num(1 << 20);
        let Rect { x, y, width, height } = detection.rect;
        let [x, y] = [x, y].map(|v| v.clamp(-limit, limit));
        let [width, height] = [width, height].map(|v| v.clamp(I28F4::ONE, limit));
        let (right, bottom) = (x + width, y + height);
        let (mx, my) = (x + width / 2, y + height / 2);
        let angle = |a: (I28F4, I28F4), b: (I28F4, I28F4)| {
            let (a, b) = (camera.direction(a.0, a.1), camera.direction(b.0, b.1));
            norm(add(a, b, -ONE)).max(ratio(1, 100_000))
        };
        let wide = angle((x, my), (right, my));
        let high = angle((mx, y), (mx, bottom));
        let size = (ln(wide) + ln(high)) / 2;
        let pixel = camera.pixel();
        let extent = exp(size);
        let milli = |v: Real| (v * MILLI).min(MILLI * 4);
        let place = milli(extent * settings.place_error + pixel);
        let error = milli(pose.error);
        let direction = unit(pose.attitude.rotate(camera.body(mx, my)));
        let size_error = milli(settings.size_error + divide(pixel, extent) / 4);
        let spec = camera.intrinsics();
        let edge = |v: I28F4, side: u32| v + I28F4::ONE >= I28F4::saturating_from_num(side);
        // The longest way back that is known: its error is that of two places, alike as they are.
        let rate =
            pose.before.iter().zip(&detection.shifts).next_back().and_then(|(then, shift)| {
                let place = |v: I28F4, shift: I28F4| v.saturating_add(shift).clamp(-limit, limit);
                let body = camera.body(place(mx, shift.x), place(my, shift.y));
                let old = unit(then.1.rotate(body));
                (then.0 >= ratio(1, 200)).then(|| {
                    let rate = add(direction, old, -ONE).map(|v| v / then.0);
                    let sigma = (milli(pixel * 3) + error) / then.0;
                    (reject(rate, direction), sigma.saturating_mul(sigma).min(MAX_VARIANCE))
                })
            });
        Self {
            rect: Rect { x, y, width, height },
            score: detection.score,
            frame_score: detection.frame_score,
            direction,
            variance: place * place + error * error,
            size,
            size_variance: size_error * size_error,
            aspect: ln(wide.max(high)) - size,
            rate,
            cut: x <= I28F4::ONE
                || y <= I28F4::ONE
                || edge(right, spec.width)
                || edge(bottom, spec.height),
        }
    }
}
