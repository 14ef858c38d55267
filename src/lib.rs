//! Lookout: an onboard lookout for drones.
#![no_std]

#[cfg(any(test, feature = "std"))]
extern crate std;

pub mod detector;
pub mod image;
pub mod model;
#[cfg(feature = "std")]
pub mod shell;
pub mod trees;
