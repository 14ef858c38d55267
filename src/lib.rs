//! Lookout: an onboard lookout for drones.
#![no_std]

#[cfg(any(test, feature = "std"))]
extern crate std;

pub mod detector;
pub mod flow;
pub mod image;
pub mod linear;
pub mod model;
pub mod planar;
pub mod pyramid;
pub mod registration;
#[cfg(feature = "std")]
pub mod shell;
pub mod warp;
