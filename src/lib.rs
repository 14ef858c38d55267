//! Lookout: an onboard lookout for drones.
#![no_std]

#[cfg(any(test, feature = "std"))]
extern crate std;

pub mod channels;
pub mod cube;
pub mod detector;
pub mod feature;
pub mod fixed;
pub mod flow;
pub mod front;
pub mod gradient;
pub mod image;
pub mod integral;
pub mod judge;
pub mod levels;
pub mod linear;
pub mod model;
pub mod motion;
pub mod nms;
pub mod planar;
pub mod pyramid;
pub mod registration;
pub mod scan;
#[cfg(feature = "std")]
pub mod shell;
pub mod trees;
pub mod warp;
