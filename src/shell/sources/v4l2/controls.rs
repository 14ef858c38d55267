//! Controls of a camera, such as exposure and gain, by name.

use super::abi::ControlQuery;
use super::device::Device;
use super::error::V4l2Error;
use rustix::io::{Errno, Result};
use std::borrow::ToOwned;
use std::collections::BTreeMap;
use std::path::Path;
use std::string::String;
use std::vec::Vec;
use std::{format, str};

/// A control of a camera and the values it takes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CameraControl {
    /// As `v4l2-ctl` writes it: small letters, digits and underscores, `exposure_time_absolute`.
    pub name: String,
    /// Smallest value; the unit is the driver's.
    pub minimum: i64,
    /// Largest value that the driver accepts.
    pub maximum: i64,
    /// Distance of the values, from the smallest on.
    pub step: u64,
    /// The value that the driver starts with.
    pub default: i64,
    id: u32,
    kind: ControlKind,
    read_only: bool,
}

/// Kinds of controls whose value is a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ControlKind {
    Integer,
    /// An integer of 64 bits.
    Integer64,
    /// Any value does the same.
    Button,
    /// The range is the bits that may be set.
    Bits,
}

impl ControlKind {
    fn new(number: u32) -> Option<Self> {
        match number {
            // Numbers, switches, menus and menus of numbers.
            1 | 2 | 3 | 9 => Some(Self::Integer),
            4 => Some(Self::Button),
            5 => Some(Self::Integer64),
            8 => Some(Self::Bits),
            // Headings, texts, and what has a structure of its own.
            _ => None,
        }
    }
}

impl CameraControl {
    fn new(query: &ControlQuery) -> Option<Self> {
        let kind = ControlKind::new(query.kind)?;
        if query.flags & ControlQuery::DISABLED != 0 || query.dimensions != 0 {
            return None;
        }
        let bits = |value: i64| if kind == ControlKind::Bits { value & 0xffff_ffff } else { value };
        Some(Self {
            name: plain(text(&query.name)),
            minimum: query.minimum,
            maximum: bits(query.maximum),
            step: query.step,
            default: bits(query.default),
            id: query.id,
            kind,
            read_only: query.flags & ControlQuery::READ_ONLY != 0,
        })
    }

    /// Why it cannot have this value.
    fn refusal(&self, value: i64) -> Option<String> {
        let Self { minimum, maximum, step, .. } = *self;
        let inside = match self.kind {
            ControlKind::Button => true,
            ControlKind::Bits => value & !maximum == 0,
            _ => (minimum..=maximum).contains(&value),
        };
        let on_step = !matches!(self.kind, ControlKind::Integer | ControlKind::Integer64)
            || step < 2
            || value.abs_diff(minimum).is_multiple_of(step);
        if self.read_only {
            Some("it can only be read".to_owned())
        } else if !inside && self.kind == ControlKind::Bits {
            Some(format!("the bits it has are {maximum:#x}"))
        } else if !inside {
            Some(format!("its range is {minimum} to {maximum}"))
        } else if !on_step {
            Some(format!("its values are {minimum} to {maximum} in steps of {step}"))
        } else {
            None
        }
    }

    #[expect(clippy::cast_possible_truncation, reason = "the range was checked")]
    fn encode(&self, value: i64) -> [u8; 8] {
        if self.kind == ControlKind::Integer64 {
            return value.to_ne_bytes();
        }
        // The range was checked: bits fill all 32, everything else is within an i32.
        let [a, b, c, d] = (value as i32).to_ne_bytes();
        [a, b, c, d, 0, 0, 0, 0]
    }

    fn decode(&self, bytes: [u8; 8]) -> i64 {
        let [a, b, c, d, ..] = bytes;
        match self.kind {
            ControlKind::Integer64 => i64::from_ne_bytes(bytes),
            ControlKind::Bits => u32::from_ne_bytes([a, b, c, d]).into(),
            _ => i32::from_ne_bytes([a, b, c, d]).into(),
        }
    }
}

/// All controls of a device.
pub fn list(device: &Device) -> Result<Vec<CameraControl>> {
    let mut controls = Vec::new();
    let mut id = 0;
    loop {
        match device.control_after(id) {
            // A driver that goes round in circles has been seen once.
            Ok(query) if query.id > id => {
                id = query.id;
                controls.extend(CameraControl::new(&query));
            }
            // The end, or a driver that has none at all.
            Ok(_) | Err(Errno::INVAL | Errno::NOTTY) => return Ok(controls),
            Err(error) => return Err(error),
        }
    }
}

/// The control that a user names, in any case, blanks as underscores or as they are.
pub fn find<'a>(
    controls: &'a [CameraControl],
    name: &str,
    path: &Path,
) -> core::result::Result<&'a CameraControl, V4l2Error> {
    let wanted = plain(name);
    controls.iter().find(|control| control.name == wanted).ok_or_else(|| {
        let names: Vec<&str> = controls.iter().map(|control| control.name.as_str()).collect();
        V4l2Error::NoControl {
            path: path.into(),
            name: name.to_owned(),
            offered: if names.is_empty() { "none at all".to_owned() } else { names.join(", ") },
        }
    })
}

/// Sets one control of an open camera.
pub fn set(
    device: &Device,
    control: &CameraControl,
    value: i64,
    path: &Path,
) -> core::result::Result<(), V4l2Error> {
    let refused = |reason| V4l2Error::ControlValue {
        path: path.into(),
        name: control.name.clone(),
        value,
        reason,
    };
    if let Some(reason) = control.refusal(value) {
        return Err(refused(reason));
    }
    device.set_control(control.id, control.encode(value)).map_err(|errno| match errno {
        Errno::RANGE | Errno::INVAL => refused("the camera does not take it".to_owned()),
        Errno::ACCESS | Errno::BUSY => {
            refused("the camera does not take it now; an automatic control may be on".to_owned())
        }
        errno => V4l2Error::system(path, "cannot set a control")(errno),
    })
}

/// Sets all of `values`, those that switch an automatic first: they decide whether the others can be set.
pub fn set_all(
    device: &Device,
    controls: &[CameraControl],
    values: &BTreeMap<String, i64>,
    path: &Path,
) -> core::result::Result<(), V4l2Error> {
    let mut found: Vec<(&CameraControl, i64)> = Vec::new();
    for (name, &value) in values {
        let control = find(controls, name, path)?;
        if found.iter().any(|(other, _)| other.id == control.id) {
            let (path, name) = (path.into(), control.name.clone());
            let reason = "it is set twice, by two spellings of its name".to_owned();
            return Err(V4l2Error::ControlValue { path, name, value, reason });
        }
        found.push((control, value));
    }
    found.sort_by_key(|(control, _)| !control.name.contains("auto"));
    found.into_iter().try_for_each(|(control, value)| set(device, control, value, path))
}

/// The value that a control has.
pub fn value(
    device: &Device,
    control: &CameraControl,
    path: &Path,
) -> core::result::Result<i64, V4l2Error> {
    let bytes = device.control(control.id);
    let bytes = bytes.map_err(V4l2Error::system(path, "cannot read a control"))?;
    Ok(control.decode(bytes))
}

/// A name as `v4l2-ctl` writes it: `Exposure Time, Absolute` is `exposure_time_absolute`.
fn plain(name: &str) -> String {
    let words = name.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    words.collect::<Vec<_>>().join("_").to_ascii_lowercase()
}

/// A C string in a field of fixed size.
pub fn text(field: &[u8]) -> &str {
    let text = field.split(|&byte| byte == 0).next().unwrap_or_default();
    str::from_utf8(text).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    fn control(kind: u32, minimum: i64, maximum: i64, step: u64) -> CameraControl {
        let mut query = ControlQuery { kind, minimum, maximum, step, ..Default::default() };
        query.name[..9].copy_from_slice(b"White (B)");
        CameraControl::new(&query).unwrap()
    }

    #[test]
    fn names_are_those_of_v4l2_ctl() {
        assert_eq!(plain("Exposure Time, Absolute"), "exposure_time_absolute");
        assert_eq!(plain("White Balance Temperature, Auto"), "white_balance_temperature_auto");
        assert_eq!(plain("exposure_auto"), "exposure_auto");
        assert_eq!(plain(" GAIN"), "gain");
        let controls = [control(1, 0, 5, 1)];
        assert_eq!(controls[0].name, "white_b");
        let path = Path::new("/dev/video9");
        assert!(find(&controls, "White_B", path).is_ok());
        let error = find(&controls, "gain", path).unwrap_err().to_string();
        assert_eq!(error, "/dev/video9: the camera has no control 'gain', only white_b");
        let error = find(&[], "gain", path).unwrap_err().to_string();
        assert!(error.ends_with("only none at all"), "{error}");
    }

    #[test]
    fn values_out_of_range_are_refused() {
        let number = control(1, -10, 20, 5);
        let refusal = |value| number.refusal(value).unwrap_or_default();
        assert_eq!(refusal(-5), "");
        assert_eq!(refusal(21), "its range is -10 to 20");
        assert_eq!(refusal(i64::MIN), "its range is -10 to 20");
        assert_eq!(refusal(1), "its values are -10 to 20 in steps of 5");
        assert_eq!(control(4, 0, 0, 0).refusal(1), None);
        let all_of_64 = control(5, i64::MIN, i64::MAX, 1);
        assert_eq!(all_of_64.refusal(i64::MAX), None);
        // The kernel gives 32 bits as a signed number.
        let bits = control(8, 0, -1, 0);
        assert_eq!(bits.refusal(0xffff_ffff), None);
        assert_eq!(bits.refusal(1 << 32).unwrap(), "the bits it has are 0xffffffff");
        let locked = CameraControl { read_only: true, ..number };
        assert_eq!(locked.refusal(0).unwrap(), "it can only be read");
    }

    #[test]
    fn values_come_back_as_they_went() {
        for (kind, value) in [(1, -7), (2, 1), (5, i64::MIN), (5, 1 << 40), (8, 0xffff_fff0)] {
            let control = control(kind, i64::MIN, i64::MAX, 1);
            assert_eq!(control.decode(control.encode(value)), value);
        }
    }
}
