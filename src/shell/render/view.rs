//! The camera's optics and readout: pixel to ray in the world and back.

use super::motion::CameraMotion;
use crate::shell::support::vectors::{WorldVector, dot};

/// Nearest depth that is projected, as a share of the distance.
const NEAREST: f64 = 0.05;

/// Optics of a camera with square pixels: pinhole and one radial term. Pixel centres are at half numbers.
#[derive(Debug, Clone, Copy)]
pub(super) struct Optics {
    /// Width and height, pixels.
    pub size: [f64; 2],
    /// Focal length, pixels.
    pub focal: f64,
    /// Undistorted radius over distorted radius less 1, at normalised radius 1.
    pub undistortion: f64,
}

impl Optics {
    /// Ray of a pixel in the camera's frame; not normalised, z is 1.
    pub(super) fn ray(&self, [x, y]: [f64; 2]) -> WorldVector {
        let x = (x - self.size[0] / 2.0) / self.focal;
        let y = (y - self.size[1] / 2.0) / self.focal;
        let scale = 1.0 + self.undistortion * (x * x + y * y);
        [x * scale, y * scale, 1.0]
    }

    /// Pixel of a point in the camera's frame; `None` behind the camera or far outside of the lens.
    pub(super) fn pixel(&self, point: WorldVector) -> Option<[f64; 2]> {
        let length = dot(point, point).sqrt();
        if point[2] <= NEAREST * length || length == 0.0 {
            return None;
        }
        let [x, y] = [point[0] / point[2], point[1] / point[2]];
        if x * x + y * y > 4.0 {
            return None;
        }
        // x_d = x_u / (1 + k r_d^2) by iteration; converges for the small coefficients that are drawn.
        let mut scale = 1.0;
        for _ in 0..8 {
            let square = (x * x + y * y) * scale * scale;
            scale = 1.0 / (1.0 + self.undistortion * square);
        }
        Some([
            self.size[0] / 2.0 + self.focal * x * scale,
            self.size[1] / 2.0 + self.focal * y * scale,
        ])
    }

    /// Time at which row `y` of the frame at `time` is exposed.
    pub(super) fn row_time(&self, motion: &CameraMotion, time: f64, y: f64) -> f64 {
        time + (y / self.size[1] - 0.5) * motion.readout
    }

    /// Pixel in the frame at `time` (its middle row) of what stands at `point(instant, camera position)`, relative to
    /// the camera in the axes of the world; the row's own instant is found by iteration.
    pub(super) fn project(
        &self,
        motion: &CameraMotion,
        time: f64,
        point: impl Fn(f64) -> WorldVector,
    ) -> Option<[f64; 2]> {
        let mut instant = time;
        let mut found = None;
        for _ in 0..3 {
            let pixel = self.pixel(motion.rotation(instant).invert(point(instant)))?;
            let row = pixel[1].clamp(-self.size[1], 2.0 * self.size[1]);
            instant = self.row_time(motion, time, row);
            found = Some(pixel);
        }
        found
    }
}
