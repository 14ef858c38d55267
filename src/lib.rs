//! Lookout: an onboard lookout for drones.
#![no_std]

#[cfg(any(test, feature = "std"))]
extern crate std;

pub mod channels;
pub mod cube;
pub mod detector;
pub mod feature;
pub mod gradient;
pub mod image;
pub mod integral;
pub mod model;
#[cfg(feature = "std")]
pub mod shell;
pub mod trees;
