//! Camera model: pixels to directions and back.
//!
//! A camera has a [`Lens`], focal lengths and an optical axis, as OpenCV's calibration finds them. OpenCV puts the centre
//! of a pixel at whole numbers; points of this crate's pictures are half a pixel further (see [`crate::image`]), which is
//! taken care of here.

pub mod attitude;
pub mod attitude_buffer;
mod distortion;

pub use distortion::Lens;

use crate::math::real::{self, ONE, Real, Vector, ZERO, cross, divide, norm, ratio, sqrt, unit};
use attitude::Attitude;
use distortion::MAX_RATIO;
use fixed::types::I28F4;

/// Error of the focal length that is assumed where only a field of view is known: one part in 20, as between what is
/// printed on a lens and what a calibration finds.
const ROUGH_SCALE: Real = ratio(1, 20);

/// Error of the optical axis in that case, in parts of the picture's width.
const ROUGH_CENTRE: Real = ratio(1, 50);

/// Error of a calibrated camera: a pixel.
const CALIBRATED: Real = ONE;

/// Intrinsic parameters of a camera in OpenCV's convention.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Intrinsics {
    /// Width of the picture in pixels.
    pub width: u32,
    /// Height of the picture in pixels.
    pub height: u32,
    /// Focal lengths along x and y in pixels.
    pub focal: [Real; 2],
    /// Where the optical axis meets the picture; the centre of the first pixel is (0, 0).
    pub centre: [Real; 2],
    /// Distortion of the lens.
    pub lens: Lens,
}

/// Why intrinsic parameters are refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraError {
    /// The picture is not 1 to 65535 pixels wide and high.
    Size,
    /// A focal length is not between a sixteenth and 64 times the picture's longer side.
    Focal,
    /// The optical axis does not meet the picture or its surroundings of one picture each way.
    Centre,
    /// A distortion coefficient is above 1000 in magnitude.
    Distortion,
    /// The field of view is not between 1 and 170 degrees.
    FieldOfView,
}

impl core::fmt::Display for CameraError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Size => "the picture's width and height must be 1 to 65535 pixels",
            Self::Focal => {
                "a focal length must be between 1/16 and 64 times the picture's longer side"
            }
            Self::Centre => "the optical axis must meet the picture or its near surroundings",
            Self::Distortion => "a distortion coefficient must be between -1000 and 1000",
            Self::FieldOfView => "the field of view must be between 1 and 170 degrees",
        })
    }
}

impl core::error::Error for CameraError {}

/// A camera on a vehicle.
///
/// ```
/// use fixed::types::I28F4;
/// use lookout::camera::{Camera, CameraError};
/// use lookout::math::real::{PI, Real};
///
/// // 640x480 pixels with a horizontal field of view of 90 degrees.
/// let camera = Camera::from_field_of_view(640, 480, PI / 2)?;
/// let pixel = |v: i32| I28F4::from_num(v);
/// // Axes of the body: forward, right, down. The middle of the right edge is 45 degrees to the right.
/// let [forward, right, down] = camera.body(pixel(640), pixel(240)).map(|v| v.to_num::<f64>());
/// assert!((forward - right).abs() < 1e-6 && down.abs() < 1e-6);
/// let (x, y) = camera.project([forward, right, down].map(Real::from_num)).unwrap();
/// assert!((x - pixel(640)).abs() < 1 && (y - pixel(240)).abs() < 1);
///
/// assert_eq!(Camera::from_field_of_view(640, 480, PI), Err(CameraError::FieldOfView));
/// # Ok::<(), CameraError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Camera {
    intrinsics: Intrinsics,
    mounting: Attitude,
    /// Relative error of the focal length.
    scale_error: Real,
    /// Error of the optical axis in pixels.
    centre_error: Real,
}

impl Camera {
    /// A calibrated camera that looks forward.
    ///
    /// # Errors
    /// [`CameraError`] when a number is out of its range.
    pub fn new(intrinsics: Intrinsics) -> Result<Self, CameraError> {
        let Intrinsics { width, height, focal, centre, lens } = intrinsics;
        let sides = [width, height];
        if sides.iter().any(|side| !(1..=65535).contains(side)) {
            return Err(CameraError::Size);
        }
        let longer = Real::from_num(width.max(height));
        if focal.iter().any(|f| *f < longer / 16 || *f > longer * 64) {
            return Err(CameraError::Focal);
        }
        for (c, side) in centre.into_iter().zip(sides.map(Real::from_num)) {
            if c < -side || c > side * 2 {
                return Err(CameraError::Centre);
            }
        }
        if lens.largest() > 1000 {
            return Err(CameraError::Distortion);
        }
        Ok(Self {
            intrinsics,
            mounting: Attitude::FORWARD,
            scale_error: ZERO,
            centre_error: CALIBRATED,
        })
    }

    /// A camera of which only the horizontal field of view is known, in radians; its stated error is that of such a guess.
    ///
    /// # Errors
    /// [`CameraError::Size`], [`CameraError::FieldOfView`].
    pub fn from_field_of_view(width: u32, height: u32, view: Real) -> Result<Self, CameraError> {
        if view < real::PI / 180 || view > real::PI * 17 / 18 {
            return Err(CameraError::FieldOfView);
        }
        let (sine, cosine) = real::sin_cos(view / 2);
        let half = Real::from_num(width.min(1 << 20)) / 2;
        let focal = divide(half * cosine, sine);
        let camera = Self::new(Intrinsics {
            width,
            height,
            focal: [focal; 2],
            centre: [width, height].map(|side| Real::from_num(side.min(1 << 20)) / 2 - ONE / 2),
            lens: Lens::PINHOLE,
        })?;
        let centre_error = ROUGH_CENTRE * Real::from_num(width);
        Ok(Self { scale_error: ROUGH_SCALE, centre_error, ..camera })
    }

    /// The camera with another mounting: `mounting` leads from the camera's axes to the body's. [`Attitude::FORWARD`]
    /// before.
    pub const fn mounted(self, mounting: Attitude) -> Self {
        Self { mounting, ..self }
    }

    /// The camera for frames that were scaled to `width` x `height`: by one whole factor, up or down, in both directions.
    /// `None` where that is not so.
    pub fn scaled(&self, width: u32, height: u32) -> Option<Self> {
        let Intrinsics { width: from_width, height: from_height, .. } = self.intrinsics;
        let whole = |large: u32, small: u32| {
            let factor = large.checked_div(small).filter(|factor| (1..=16).contains(factor))?;
            (small * factor == large).then_some(factor)
        };
        let (up, down) = if width >= from_width {
            (whole(width, from_width)?, 1)
        } else {
            (1, whole(from_width, width)?)
        };
        if u64::from(height) * u64::from(down) != u64::from(from_height) * u64::from(up) {
            return None;
        }
        let scale = |v: Real| v * i64::from(up) / i64::from(down);
        let half = ONE / 2;
        let intrinsics = Intrinsics {
            width,
            height,
            focal: self.intrinsics.focal.map(scale),
            // The centre of the first pixel is at 0, its edge at -1/2.
            centre: self.intrinsics.centre.map(|c| scale(c + half) - half),
            lens: self.intrinsics.lens,
        };
        Some(Self { intrinsics, centre_error: scale(self.centre_error).max(CALIBRATED), ..*self })
    }

    /// Focal lengths, principal point and distortion, in pixels of the full frame.
    pub const fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }

    /// From the camera's axes to the body's.
    pub const fn mounting(&self) -> Attitude {
        self.mounting
    }

    /// Relative error of angles far from the axis, and of turns measured in the picture.
    pub const fn scale_error(&self) -> Real {
        self.scale_error
    }

    /// The angle of a pixel in the middle of the picture, in radians.
    pub fn pixel(&self) -> Real {
        ONE / self.intrinsics.focal[0]
    }

    /// Angle between the middles of the picture's left and right edges, in radians.
    pub fn field_of_view(&self) -> Real {
        let Intrinsics { width, height, .. } = self.intrinsics;
        let [width, height] = [width, height].map(I28F4::saturating_from_num);
        let left = self.direction(I28F4::ZERO, height / 2);
        let right = self.direction(width, height / 2);
        let cosine = left.into_iter().zip(right).map(|(a, b)| a * b).sum();
        real::atan2(norm(cross(left, right)), cosine)
    }

    /// Unit vector of the point (x, y) of the picture, in the camera's axes.
    #[inline(never)]
    pub fn direction(&self, x: I28F4, y: I28F4) -> Vector {
        let Intrinsics { focal, centre, lens, .. } = &self.intrinsics;
        let half = ONE / 2;
        let distorted: [Real; 2] = core::array::from_fn(|i| {
            let v = Real::from_num([x, y][i]);
            (divide(v - half - centre[i], focal[i])).clamp(-MAX_RATIO, MAX_RATIO)
        });
        lens.ray(distorted)
    }

    /// Unit vector of the point (x, y) of the picture, in the body's axes.
    pub fn body(&self, x: I28F4, y: I28F4) -> Vector {
        self.mounting.rotate(self.direction(x, y))
    }

    /// The point of the picture in which a direction in the body's axes is seen; it may lie outside of the picture.
    /// `None` behind the camera and far to its side.
    #[inline(never)]
    pub fn project(&self, body: Vector) -> Option<(I28F4, I28F4)> {
        let [x, y] = self.intrinsics.lens.project(self.mounting.inverse().rotate(unit(body)))?;
        let place = |i: usize, v: Real| {
            let limit = Real::from_num(1 << 20);
            let v = v.clamp(-MAX_RATIO, MAX_RATIO) * self.intrinsics.focal[i];
            I28F4::saturating_from_num(
                (v + self.intrinsics.centre[i] + ONE / 2).clamp(-limit, limit),
            )
        };
        Some((place(0, x), place(1, y)))
    }

    /// One standard deviation of a direction at `camera` (a unit vector in the camera's axes), in radians.
    pub fn sigma(&self, camera: Vector) -> Real {
        let cosine = camera[2].clamp(ZERO, ONE);
        let sine = sqrt(ONE - cosine * cosine);
        let scale = self.scale_error * sine * cosine;
        let centre = self.centre_error * self.pixel();
        sqrt(scale * scale + centre * centre)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn lens(distortion: [f64; 5]) -> Lens {
        let mut k = [ZERO; 14];
        k[..5].copy_from_slice(&distortion.map(Real::from_num));
        Lens::Polynomial(k)
    }

    fn camera(distortion: [f64; 5]) -> Camera {
        Camera::new(Intrinsics {
            width: 640,
            height: 480,
            focal: [560.0, 570.0].map(Real::from_num),
            centre: [310.5, 245.0].map(Real::from_num),
            lens: lens(distortion),
        })
        .unwrap()
    }

    fn sixteenths(v: f64) -> I28F4 {
        I28F4::from_num(v)
    }

    proptest! {
        #[test]
        fn agrees_with_opencv_model_in_f64(x in -0.55..0.55f64, y in -0.4..0.4f64, k in (-0.3..0.2f64, -0.1..0.1f64, -0.003..0.003f64, -0.003..0.003f64, -0.05..0.05f64)) {
            let (k1, k2, p1, p2, k3) = k;
            let camera = camera([k1, k2, p1, p2, k3]);
            let r2 = x * x + y * y;
            let radial = 1.0 + k1 * r2 + k2 * r2 * r2 + k3 * r2 * r2 * r2;
            let xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x);
            let yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y;
            let (u, v) = (xd * 560.0 + 310.5 + 0.5, yd * 570.0 + 245.0 + 0.5);
            let got = camera.direction(sixteenths(u), sixteenths(v)).map(|v| v.to_num::<f64>());
            let length = (r2 + 1.0).sqrt();
            let error = (got[0] - x / length).hypot(got[1] - y / length);
            prop_assert!(error < 4e-4, "{error}"); // a sixteenth of a pixel is 1e-4
            // And back through the body's axes.
            let body = camera.body(sixteenths(u), sixteenths(v));
            let (pu, pv) = camera.project(body).unwrap();
            prop_assert!((pu.to_num::<f64>() - u).abs() < 0.2 && (pv.to_num::<f64>() - v).abs() < 0.2);
        }

        #[test]
        fn no_numbers_panic(focal: [i64; 2], centre: [i64; 2], k: [i64; 14], x: i32, y: i32, v: [i32; 3], view: i64) {
            let real = Real::from_bits;
            let intrinsics = Intrinsics { width: 640, height: 480, focal: focal.map(real), centre: centre.map(real), lens: Lens::Polynomial(k.map(real)) };
            let cameras = [Camera::new(intrinsics), Camera::new(Intrinsics {
                focal: [real(focal[0].rem_euclid(1 << 47)) + Real::from_num(40), Real::from_num(300)],
                centre: [Real::from_num(100); 2],
                lens: Lens::Polynomial(k.map(|k| real(k % (1 << 41)))),
                ..intrinsics
            }), Camera::from_field_of_view(640, 480, real(view % (1 << 34)))];
            for camera in cameras.into_iter().flatten() {
                let direction = camera.direction(I28F4::from_bits(x), I28F4::from_bits(y));
                prop_assert!(camera.sigma(direction) >= ZERO);
                let _ = camera.project(v.map(|v| Real::from_bits(v.into())));
            }
        }
    }

    #[test]
    fn a_scaled_camera_sees_the_same_in_the_same_place() {
        let full = camera([-0.2, 0.05, 0.001, 0.0, 0.0]);
        for (width, height, factor) in
            [(320, 240, 0.5), (1280, 960, 2.0), (640, 480, 1.0), (160, 120, 0.25)]
        {
            let scaled = full.scaled(width, height).unwrap();
            let (x, y) = (500.0, 100.0);
            let same = full.direction(sixteenths(x), sixteenths(y));
            let there = scaled.direction(sixteenths(x * factor), sixteenths(y * factor));
            for (a, b) in same.into_iter().zip(there) {
                assert!((a - b).saturating_abs() < Real::from_num(1e-4), "{factor}: {a} {b}");
            }
        }
        for (width, height) in [(320, 256), (480, 360), (320, 480), (0, 0), (640, 240), (1281, 960)]
        {
            assert_eq!(full.scaled(width, height), None, "{width}x{height}");
        }
    }

    #[test]
    fn a_field_of_view_states_a_larger_error() {
        let rough = Camera::from_field_of_view(640, 480, real::PI / 3).unwrap();
        assert!((rough.intrinsics().focal[0].to_num::<f64>() - 554.256).abs() < 0.01);
        for view in [2, 3, 20] {
            let camera = Camera::from_field_of_view(640, 480, real::PI / view).unwrap();
            let off = camera.field_of_view() - real::PI / view;
            assert!(off.saturating_abs() < Real::from_num(1e-4), "{view}: {off}");
        }
        let exact = camera([0.0; 5]);
        let middle = [ZERO, ZERO, ONE];
        let corner = rough.direction(sixteenths(0.0), sixteenths(0.0));
        assert!(exact.sigma(middle) * 5 < rough.sigma(middle));
        assert!(rough.sigma(middle) < rough.sigma(corner));
        assert_eq!(
            Camera::from_field_of_view(640, 480, ZERO).unwrap_err(),
            CameraError::FieldOfView
        );
        assert!(rough.project([-ONE, ZERO, ZERO]).is_none());
    }
}
