//! Fixed-point mathematics: rounding helpers, real numbers and vectors, small linear systems, a two-state Kalman filter.
//!
//! In: numbers. Out: numbers. Imports no other folder.

pub mod fixed;
pub mod kalman;
pub mod linear;
pub mod real;
pub mod slices;
pub mod threads;
