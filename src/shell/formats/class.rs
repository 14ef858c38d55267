//! Classes of labelled objects and their numbers in MOTChallenge text.

use serde::{Deserialize, Serialize};
use std::fmt;

/// Kind of a labelled flying object.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize,
)]
#[serde(rename_all = "lowercase")]
pub enum Class {
    /// Multirotor or other small unmanned aircraft; number 1.
    #[default]
    Drone,
    /// Aircraft with fixed wings; number 2.
    Airplane,
    /// Helicopter; number 3.
    Helicopter,
    /// Bird: not to be reported, and background to the trainer; number 4.
    Bird,
}

impl Class {
    /// All classes, by number.
    pub const ALL: [Self; 4] = [Self::Drone, Self::Airplane, Self::Helicopter, Self::Bird];

    /// Classes that a detection must be of to be right, by number.
    pub const TARGETS: [Self; 3] = [Self::Drone, Self::Airplane, Self::Helicopter];

    /// The class of a number in `gt.txt`, 1 to 4.
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|class| class.number() == number)
    }

    /// The class of a name as [`Class::name`] gives it, in any case.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|class| class.name().eq_ignore_ascii_case(name))
    }

    /// Its number in `gt.txt`, from 1.
    pub const fn number(self) -> u32 {
        self as u32 + 1
    }

    /// Its name in reports and tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Drone => "drone",
            Self::Airplane => "airplane",
            Self::Helicopter => "helicopter",
            Self::Bird => "bird",
        }
    }
}

impl fmt::Display for Class {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_and_names_lead_back() {
        for (class, number) in Class::ALL.into_iter().zip(1..) {
            assert_eq!(class.number(), number);
            assert_eq!(Class::from_number(number), Some(class));
            assert_eq!(Class::from_name(&class.name().to_uppercase()), Some(class));
        }
        assert_eq!([0, 5].map(Class::from_number), [None; 2]);
        assert_eq!(Class::from_name("kite"), None);
    }
}
