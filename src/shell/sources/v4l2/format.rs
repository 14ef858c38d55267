//! Agreeing with a camera on how its pictures are to come.

use super::abi::{
    ANY_FIELD, Format, INTERLACED, INTERLACED_BOTTOM, INTERLACED_TOP, PROGRESSIVE, StreamParameters,
};
use super::device::Device;
use super::error::V4l2Error;
use super::grey::BufferLayout;
use super::{CameraSettings, PixelFormat};
use crate::shell::sources::interlaced::FieldOrder;
use rustix::io::{Errno, Result};
use std::borrow::ToOwned;
use std::path::Path;
use std::string::{String, ToString};
use std::vec::Vec;

/// Frames a second as a fraction.
pub type FrameRate = (u32, u32);

/// Sets format, size and rate. Without a format the first of [`PixelFormat::ALL`] that the camera has in this size and at
/// this rate; if the rate is out of reach in all of them, the first in this size.
pub fn agree(
    device: &Device,
    path: &Path,
    settings: &CameraSettings,
) -> core::result::Result<(BufferLayout, Option<FrameRate>), V4l2Error> {
    let failed = |request| V4l2Error::system(path, request);
    let offered = offered(device).map_err(failed("cannot list the formats"))?;
    let known = |format: &PixelFormat| offered.contains(&format.fourcc());
    let wanted: Vec<PixelFormat> = match settings.format {
        Some(format) => [format].into_iter().filter(known).collect(),
        None => PixelFormat::ALL.into_iter().filter(known).collect(),
    };
    let mut slow = None;
    let mut nearest: Option<(PixelFormat, (u32, u32))> = None;
    let set = |format: PixelFormat| -> core::result::Result<_, V4l2Error> {
        let granted = device.set_format(format.fourcc(), settings.width, settings.height);
        let granted = granted.map_err(failed("cannot set the format"))?;
        let rate = rate(device, settings.rate).map_err(failed("cannot set the rate"))?;
        Ok((granted, rate))
    };
    for &format in &wanted {
        let (granted, rate) = set(format)?;
        let size = (granted.width, granted.height);
        if granted.fourcc != format.fourcc() {
            continue;
        }
        if size != (settings.width, settings.height) || size.0 == 0 || size.1 == 0 {
            let distance = |(width, height): (u32, u32)| {
                width.abs_diff(settings.width) + height.abs_diff(settings.height)
            };
            if nearest.is_none_or(|(_, other)| distance(size) < distance(other)) {
                nearest = Some((format, size));
            }
        } else if is_reached(rate, settings.rate) {
            return Ok((layout(format, &granted, path)?, rate));
        } else {
            slow.get_or_insert(format);
        }
    }
    if let Some(format) = slow {
        let (granted, rate) = set(format)?;
        return Ok((layout(format, &granted, path)?, rate));
    }
    Err(match nearest {
        Some((format, nearest)) => V4l2Error::Size {
            path: path.into(),
            format,
            wanted: (settings.width, settings.height),
            nearest,
        },
        None => V4l2Error::Format {
            path: path.into(),
            wanted: match settings.format {
                Some(format) => format.to_string(),
                None => PixelFormat::ALL.map(|format| format.to_string()).join(", "),
            },
            offered: names(&offered),
        },
    })
}

/// The four letters of every format that the device has.
fn offered(device: &Device) -> Result<Vec<[u8; 4]>> {
    let mut formats = Vec::new();
    for index in 0.. {
        match device.format_description(index) {
            Ok(description) => formats.push(description.fourcc),
            Err(Errno::INVAL) => break,
            Err(error) => return Err(error),
        }
    }
    Ok(formats)
}

fn names(formats: &[[u8; 4]]) -> String {
    if formats.is_empty() {
        return "none at all".to_owned();
    }
    let name = |format: &[u8; 4]| String::from_utf8_lossy(format).trim_end().to_owned();
    formats.iter().map(name).collect::<Vec<_>>().join(", ")
}

/// Sets the rate if one is given, and returns the camera's rate, if the driver knows it.
fn rate(device: &Device, wanted: Option<u32>) -> Result<Option<FrameRate>> {
    let parameters = match wanted {
        Some(rate) => device.set_rate(rate),
        None => device.stream_parameters(),
    };
    match parameters {
        Ok(StreamParameters { capability, numerator, denominator, .. }) => {
            let known = capability & StreamParameters::TIME_PER_FRAME != 0;
            Ok((known && numerator > 0 && denominator > 0).then_some((denominator, numerator)))
        }
        // A camera whose rate cannot be set.
        Err(Errno::NOTTY | Errno::INVAL) => Ok(None),
        Err(error) => Err(error),
    }
}

/// Whether a rate is the one requested within a hundredth: 29.97 is 30. An unknown rate counts as right.
fn is_reached(rate: Option<FrameRate>, wanted: Option<u32>) -> bool {
    rate.zip(wanted).is_none_or(|((frames, seconds), wanted)| {
        u64::from(frames) * 100 >= u64::from(wanted) * u64::from(seconds) * 99
    })
}

fn layout(
    format: PixelFormat,
    granted: &Format,
    path: &Path,
) -> core::result::Result<BufferLayout, V4l2Error> {
    let interlaced = match granted.field {
        PROGRESSIVE | ANY_FIELD => None,
        INTERLACED | INTERLACED_TOP => Some(FieldOrder::Top),
        INTERLACED_BOTTOM => Some(FieldOrder::Bottom),
        field => return Err(V4l2Error::Fields { path: path.into(), field }),
    };
    let (width, height) = (granted.width as usize, granted.height as usize);
    let limited_range = match (format, granted.quantization) {
        (PixelFormat::Mjpeg, _) | (_, Format::FULL_RANGE) => false,
        (_, Format::LIMITED_RANGE) => true,
        (PixelFormat::Grey, _) => false,
        _ => granted.colorspace != Format::COLORSPACE_JPEG,
    };
    // A driver may leave out what follows from the width.
    let stride = (granted.bytes_per_line as usize).max(width * format.bytes_per_pixel());
    Ok(BufferLayout { format, width, height, stride, limited_range, interlaced })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_range_is_what_the_driver_says_or_the_format_s_own() {
        let limited = |format, quantization, colorspace| {
            let granted =
                Format { quantization, colorspace, width: 4, height: 2, ..Default::default() };
            layout(format, &granted, Path::new("v")).unwrap().limited_range
        };
        let srgb = 8;
        assert!(limited(PixelFormat::Yuyv, 0, srgb));
        assert!(!limited(PixelFormat::Yuyv, 0, Format::COLORSPACE_JPEG));
        assert!(!limited(PixelFormat::Nv12, Format::FULL_RANGE, srgb));
        assert!(limited(PixelFormat::Nv12, Format::LIMITED_RANGE, Format::COLORSPACE_JPEG));
        assert!(!limited(PixelFormat::Grey, 0, srgb));
        assert!(limited(PixelFormat::Grey, Format::LIMITED_RANGE, srgb));
        assert!(!limited(PixelFormat::Mjpeg, Format::LIMITED_RANGE, srgb));
    }

    #[test]
    fn the_granted_field_order_is_heeded() {
        let order = |field| {
            let granted = Format { field, width: 4, height: 2, ..Default::default() };
            layout(PixelFormat::Yuyv, &granted, Path::new("/dev/video7"))
        };
        for (field, wanted) in [
            (0, None),
            (1, None),
            (4, Some(FieldOrder::Top)),
            (8, Some(FieldOrder::Top)),
            (9, Some(FieldOrder::Bottom)),
        ] {
            assert_eq!(order(field).unwrap().interlaced, wanted);
        }
        // Top or bottom alone, one after the other in a buffer, in turn.
        for field in [2, 3, 5, 6, 7, 10] {
            let error = order(field).unwrap_err().to_string();
            assert!(error.starts_with("/dev/video7: the camera gives fields apart"), "{error}");
        }
    }

    #[test]
    fn the_stride_is_never_less_than_a_row() {
        let stride = |format, bytes_per_line| {
            let granted = Format { bytes_per_line, width: 6, height: 2, ..Default::default() };
            layout(format, &granted, Path::new("v")).unwrap().stride
        };
        assert_eq!(stride(PixelFormat::Grey, 0), 6);
        assert_eq!(stride(PixelFormat::Grey, 64), 64);
        assert_eq!(stride(PixelFormat::Yuyv, 6), 12);
        // As drivers give it for what is compressed.
        assert!(stride(PixelFormat::Mjpeg, 0) > 0);
    }

    #[test]
    fn a_rate_is_reached_to_a_hundredth() {
        assert!(is_reached(Some((30_000, 1001)), Some(30)));
        assert!(!is_reached(Some((25, 1)), Some(30)));
        assert!(is_reached(Some((60, 1)), Some(30)));
        assert!(is_reached(None, Some(30)) && is_reached(Some((5, 1)), None));
    }

    #[test]
    fn formats_are_named_by_their_letters() {
        assert_eq!(names(&[*b"RGB3", *b"Y16 "]), "RGB3, Y16");
        assert_eq!(names(&[]), "none at all");
    }
}
