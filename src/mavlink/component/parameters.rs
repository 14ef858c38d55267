//! Parameters that can be set over MAVLink's parameter protocol.
//!
//! Every parameter is a REAL32 on the wire, the switches too: there the two encodings in use, bytewise (PX4) and
//! C-cast (ArduPilot), are the same bytes, and no receiver can read them wrongly.
//! Source: <https://mavlink.io/en/services/parameter.html>.

use super::commands::PayloadFields;
use super::requests::ParameterError;
use super::{Component, ComponentEvent, Destination, Priority, Sender};
use crate::mavlink::dialect::{
    MavParamType, PARAM_REQUEST_LIST_DATA, PARAM_REQUEST_READ_DATA, PARAM_VALUE_DATA,
};
use fixed::types::I16F16;
use mavlink_core::MessageData;
use mavlink_core::types::CharArray;

/// A parameter. Its number is its index on the wire; the set never changes while the program runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Parameter {
    /// `LK_THRESHOLD`: offset of the score that starts a track from the one of the model's calibration, log-odds; 0 by
    /// default, negative for more and weaker tracks. It means the same for every model.
    Threshold,
    /// `LK_WINGSPAN`: assumed wingspan of other aircraft in metres; 1 by default.
    Wingspan,
    /// `LK_CAUTION_S`: time to contact below which there is a caution, in seconds; 16 by default.
    CautionTime,
    /// `LK_WARNING_S`: time to contact below which there is a warning, in seconds; 8 by default.
    WarningTime,
    /// `LK_ADSB_HZ`: reports of an aircraft a second by ADSB_VEHICLE, 0 for none or at least 0.125; 2 by default.
    AdsbRate,
    /// `LK_COLLISION`: 1 to send COLLISION; 1 by default.
    Collision,
    /// `LK_TEXT`: 1 to send STATUSTEXT; 1 by default.
    Text,
    /// `LK_TEXT_S`: least time between two texts of one severity about one aircraft, in seconds; 60 by default.
    TextInterval,
    /// `LK_PROXIMITY`: 0 nothing (default), 1 OBSTACLE_DISTANCE, 2 OBSTACLE_DISTANCE_3D (ArduPilot only). Never both:
    /// each OBSTACLE_DISTANCE replaces ArduPilot's obstacles of the other kind. Off by default because PX4 then holds before
    /// every direction that is not seen.
    Proximity,
    /// `LK_PROX_HZ`: their rate; 10 by default. Autopilots take half a second of silence for a lost sensor.
    ProximityRate,
    /// `LK_PROX_MAX`: largest distance in them, in metres; 100 by default.
    ProximityMax,
    /// `LK_HEALTH`: 1 to send NAMED_VALUE_FLOAT about the work on the frames; 1 by default.
    Health,
}

/// Number of parameters of the component, `param_count` in PARAM_VALUE.
pub const COUNT: usize = 12;

/// Values that a parameter may have between its least and its largest.
#[derive(Clone, Copy)]
enum ValueKind {
    /// Any number in the range.
    Any,
    /// Whole numbers in the range.
    Whole,
    /// 0, or at least [`LEAST_RATE`] a second: less would be off without saying so.
    Rate,
}

/// Least rate that is not off, in messages a second.
const LEAST_RATE: f32 = 0.125;

/// Name, default, least and largest value of a parameter, and which values between.
struct Definition(Parameter, &'static str, f32, f32, f32, ValueKind);

static DEFINITIONS: [Definition; COUNT] = [
    Definition(Parameter::Threshold, "LK_THRESHOLD", 0.0, -32.0, 32.0, ValueKind::Any),
    Definition(Parameter::Wingspan, "LK_WINGSPAN", 1.0, 0.0625, 100.0, ValueKind::Any),
    Definition(Parameter::CautionTime, "LK_CAUTION_S", 16.0, 1.0, 60.0, ValueKind::Any),
    Definition(Parameter::WarningTime, "LK_WARNING_S", 8.0, 1.0, 60.0, ValueKind::Any),
    Definition(Parameter::AdsbRate, "LK_ADSB_HZ", 2.0, 0.0, 5.0, ValueKind::Rate),
    Definition(Parameter::Collision, "LK_COLLISION", 1.0, 0.0, 1.0, ValueKind::Whole),
    Definition(Parameter::Text, "LK_TEXT", 1.0, 0.0, 1.0, ValueKind::Whole),
    Definition(Parameter::TextInterval, "LK_TEXT_S", 60.0, 5.0, 600.0, ValueKind::Any),
    Definition(Parameter::Proximity, "LK_PROXIMITY", 0.0, 0.0, 2.0, ValueKind::Whole),
    Definition(Parameter::ProximityRate, "LK_PROX_HZ", 10.0, 5.0, 20.0, ValueKind::Any),
    Definition(Parameter::ProximityMax, "LK_PROX_MAX", 100.0, 10.0, 600.0, ValueKind::Any),
    Definition(Parameter::Health, "LK_HEALTH", 1.0, 0.0, 1.0, ValueKind::Whole),
];

impl Parameter {
    /// The parameter of an index, 0 to [`COUNT`] - 1.
    pub fn from_index(index: usize) -> Option<Self> {
        DEFINITIONS.get(index).map(|d| d.0)
    }

    /// The parameter of a name.
    pub fn from_name(name: &[u8]) -> Option<Self> {
        DEFINITIONS.iter().find(|d| d.1.as_bytes() == name).map(|d| d.0)
    }

    /// The parameter of a name as messages hold it: up to a NUL, or 16 letters.
    fn on_wire(name: &[u8; 16]) -> Option<Self> {
        let length = name.iter().position(|&c| c == 0).unwrap_or(name.len());
        Self::from_name(&name[..length])
    }

    /// All parameters in the order of their indices.
    pub fn all() -> impl Iterator<Item = Self> {
        DEFINITIONS.iter().map(|d| d.0)
    }

    /// Position in the list of parameters, from 0: `param_index` in PARAM_VALUE.
    pub fn index(self) -> usize {
        self as usize
    }

    /// Its name, at most 16 letters.
    pub fn name(self) -> &'static str {
        DEFINITIONS[self.index()].1
    }

    /// Least and largest value.
    pub fn range(self) -> (f32, f32) {
        let definition = &DEFINITIONS[self.index()];
        (definition.3, definition.4)
    }
}

/// A value of every parameter, always within its range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameters {
    values: [f32; COUNT],
}

impl Default for Parameters {
    fn default() -> Self {
        Self { values: core::array::from_fn(|i| DEFINITIONS[i].2) }
    }
}

impl Parameters {
    /// The value as it stands on the wire.
    pub fn wire(&self, parameter: Parameter) -> f32 {
        self.values[parameter.index()]
    }

    /// The value in Q16.
    pub fn get(&self, parameter: Parameter) -> I16F16 {
        I16F16::saturating_from_num(self.wire(parameter))
    }

    /// Whether a switch is on.
    pub fn is_on(&self, parameter: Parameter) -> bool {
        self.get(parameter) != 0
    }

    /// Sets a value; `false` where it is out of range, no number, or not whole where it should be.
    pub fn set(&mut self, parameter: Parameter, value: f32) -> bool {
        let (min, max) = parameter.range();
        let fits = match DEFINITIONS[parameter.index()].5 {
            ValueKind::Any => true,
            ValueKind::Whole => I16F16::checked_from_num(value).is_some_and(|v| v.frac() == 0),
            ValueKind::Rate => value == 0.0 || value >= LEAST_RATE,
        };
        // A NaN is in no range.
        let good = (min..=max).contains(&value) && fits;
        if good {
            // No negative zero: it would differ on the wire.
            self.values[parameter.index()] = if value == 0.0 { 0.0 } else { value };
        }
        good
    }
}

/// MAV_PARAM_TYPE_REAL32.
const REAL32: u8 = 9;

impl Component {
    /// PARAM_REQUEST_READ, PARAM_REQUEST_LIST, PARAM_SET: read by hand, because PARAM_SET may bear any type.
    pub(super) fn hear_parameter(&mut self, id: u32, from: Sender, payload: &[u8]) {
        let fields = PayloadFields(payload);
        let target = match id {
            PARAM_REQUEST_LIST_DATA::ID => 0,
            PARAM_REQUEST_READ_DATA::ID => 2,
            _ => 4,
        };
        let addressed = self.addressed(fields.byte(target), fields.byte(target + 1));
        if addressed.is_none_or(|(component, _)| component != self.config.component_id) {
            return;
        }
        let name = |at: usize| fields.bytes::<16>(at);
        match id {
            PARAM_REQUEST_LIST_DATA::ID => self.listing = Some((from.link, 0)),
            PARAM_REQUEST_READ_DATA::ID => {
                let index = i16::from_le_bytes(fields.bytes(0));
                let parameter = match usize::try_from(index) {
                    Ok(index) => Parameter::from_index(index),
                    Err(_) => Parameter::on_wire(&name(4)),
                };
                match parameter {
                    Some(parameter) => self.send_parameter(Destination::Link(from.link), parameter),
                    None => {
                        self.refuse_parameter(from, name(4), index, ParameterError::DoesNotExist)
                    }
                }
            }
            _ => self.set_parameter(from, name(6), fields.float(0), fields.byte(22)),
        }
    }

    /// PARAM_SET of a name to `value`, whose bytes are of MAV_PARAM_TYPE `kind`.
    fn set_parameter(&mut self, from: Sender, name: [u8; 16], value: f32, kind: u8) {
        let Some(parameter) = Parameter::on_wire(&name) else {
            self.refuse_parameter(from, name, -1, ParameterError::DoesNotExist);
            return;
        };
        let before = self.parameters.wire(parameter);
        // A value of another type could be meant in two ways; it is not taken.
        let error = if kind != REAL32 {
            Some(ParameterError::WrongType)
        } else if !self.parameters.set(parameter, value) {
            Some(ParameterError::OutOfRange)
        } else {
            None
        };
        if let Some(error) = error {
            self.refuse_parameter(from, name, parameter.index() as i16, error);
        } else if self.parameters.wire(parameter) != before {
            self.happened(ComponentEvent::Parameter(parameter));
        }
        // The value that holds now, taken or not; to all, for they all keep a copy.
        self.send_parameter(Destination::All, parameter);
    }

    /// Continues a requested list, one parameter at a time.
    pub(super) fn list_parameters(&mut self) {
        let Some((link, index)) = self.listing else { return };
        let Some(parameter) = Parameter::from_index(index) else {
            self.listing = None;
            return;
        };
        self.listing = Some((link, index + 1));
        self.send_parameter(Destination::Link(link), parameter);
    }

    fn send_parameter(&mut self, to: Destination, parameter: Parameter) {
        let data = PARAM_VALUE_DATA {
            param_value: self.parameters.wire(parameter),
            param_count: COUNT as u16,
            param_index: parameter.index() as u16,
            param_id: CharArray::from(parameter.name()),
            param_type: MavParamType::MAV_PARAM_TYPE_REAL32,
        };
        self.say(to, self.config.component_id, Priority::Answer, &data);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_table_is_in_order_and_its_defaults_are_in_range() {
        for (index, parameter) in Parameter::all().enumerate() {
            assert_eq!(parameter.index(), index);
            assert_eq!(Parameter::from_index(index), Some(parameter));
            assert_eq!(Parameter::from_name(parameter.name().as_bytes()), Some(parameter));
            assert!(parameter.name().len() <= 16);
            let mut parameters = Parameters::default();
            assert!(parameters.set(parameter, Parameters::default().wire(parameter)));
        }
        assert_eq!(Parameter::all().count(), COUNT);
        assert_eq!(Parameters::default().wire(Parameter::Proximity), 0.0);
    }

    proptest! {
        #[test]
        fn values_stay_in_range(index in 0..COUNT, bits: u32) {
            let parameter = Parameter::from_index(index).unwrap();
            let mut parameters = Parameters::default();
            let value = f32::from_bits(bits);
            let taken = parameters.set(parameter, value);
            let (min, max) = parameter.range();
            let now = parameters.wire(parameter);
            prop_assert!((min..=max).contains(&now));
            prop_assert_eq!(now == value, taken || value == Parameters::default().wire(parameter));
        }
    }

    #[test]
    fn what_is_off_says_so() {
        let mut parameters = Parameters::default();
        assert!(!parameters.set(Parameter::AdsbRate, 1e-6));
        assert!(parameters.set(Parameter::AdsbRate, LEAST_RATE));
        assert!(parameters.is_on(Parameter::AdsbRate));
        assert!(parameters.set(Parameter::Proximity, -0.0));
        assert_eq!(parameters.wire(Parameter::Proximity).to_bits(), 0);
    }

    #[test]
    fn switches_are_whole() {
        let mut parameters = Parameters::default();
        assert!(!parameters.set(Parameter::Text, 0.5));
        assert!(parameters.set(Parameter::Text, 0.0));
        assert!(!parameters.is_on(Parameter::Text));
        assert!(parameters.set(Parameter::Wingspan, 0.35));
        assert_eq!(parameters.wire(Parameter::Wingspan), 0.35);
    }
}
