//! Spatio-temporal cubes (Rozantsev, Lepetit, Fua 2015, section 3): windows of the last frames, their gradient energies,
//! and the motion compensation of Algorithm 1.
//!
//! In: channels of the last frames and a window. Out: a cube of slices, its features, the shifts of the slices.
//! Imports mathematics, image, trees, registration and channels.

pub mod compensation;
pub mod cube;
pub mod feature;
pub mod spans;
#[cfg(feature = "std")]
pub mod window_flow;
