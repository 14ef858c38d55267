//! Lookout: the open onboard lookout for drones.
//!
//! It watches the grey camera of a drone that moves itself and finds other flying objects in it, of 10 to 240 pixels along
//! their longer side ([`detector::TARGETS`]), before ground, trees and sky that move as well. The method is that of
//! Rozantsev, Lepetit and Fua, "Flying Objects Detection from a Single Moving Camera" (CVPR 2015): windows of the last
//! frames form a st-cube, regressors keep the object in the middle of every slice, boosted trees over the gradient
//! energies of boxes in the cube classify it.
//!
//! # The core
//! Without features the crate is the detector alone: no standard library, no allocation, integers only; memory and time
//! come from the caller. The same frames give the same bytes on a desktop and on a microcontroller.
//!
//! ```
//! use lookout::detector::{Buffers, Config, Detections, Detector};
//! use lookout::image::Image;
//! use lookout::model::Model;
//!
//! let model = Model::parse(include_bytes!("../models/lookout.lkm"))?;
//! let config = Config::for_model(&model, 160, 120);
//! let (mut bytes, mut words) = (vec![0; config.bytes_len()], vec![0; config.words_len()]);
//! let buffers = Buffers { bytes: &mut bytes, words: &mut words };
//! let mut detector = Detector::new(&model, config, buffers)?;
//!
//! let grey = [90; 160 * 120];
//! let mut detections = Detections::default();
//! for number in 0..3 {
//!     let frame = Image::packed(&grey, 160, 120)?;
//!     detector.process(frame, number * 33_333, &mut detections)?;
//!     for detection in &detections.list {
//!         println!("{:?} with score {}", detection.rect, detection.score);
//!     }
//! }
//! assert!(detections.windows > 0 && detections.list.is_empty());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Where memory is static, its size comes from the model's header: see `examples/static_memory.rs`.
//!
//! # Features
//! - `std` (default): the shell around the core, `shell`, and the program `lookout`: recorded flights in, detections,
//!   scores and trained models out.
//! - `rayon` (default, implies `std`): levels of the pyramid and the trainer's work on all processors. The results are
//!   those of one thread, byte for byte.
//! - `embedded` (excludes `std`): `mavlink` for a board without an operating system.
//!
//! # Layers
//! Folders follow the way of a frame; each imports those above it alone. ARCHITECTURE.md has the table that a test checks.
//!
//! frame → [`registration`] → [`channels`] → [`scan`] → [`stcube`] → [`boxes`] → [`detector`] → [`tracking`] → `mavlink`
//!
//! Below them lie [`math`], [`image`] and [`trees`]; beside them [`model`] (the model file) and [`camera`] (pixels to
//! directions); above them `shell`, everything that needs an operating system.
#![no_std]
// A cast that may change a value is an error: `try_from`, or a reason. The exceptions are folders of arithmetic, named here
// and in `shell/mod.rs`; a new folder has none. Tests cast freely. `cast_precision_loss` is off: counts and microseconds
// are far below 2^53.
#![cfg_attr(
    not(test),
    deny(clippy::cast_possible_truncation, clippy::cast_possible_wrap, clippy::cast_sign_loss,)
)]
// Bad input is an error, not a panic. Where a panic is right, its reason stands there. Indices: `shell/mod.rs`; on boards
// every place that may panic is listed with its reason (`boards/*/panics.txt`).
#![cfg_attr(not(test), deny(clippy::unwrap_used, clippy::expect_used))]

#[cfg(any(test, feature = "simd"))]
extern crate std;

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "fixed-point arithmetic: bounds stand beside the casts, tests compare with f64"
)]
pub mod boxes;
pub mod camera;
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "pixels and cells of a frame, at most 2^16 a side; sums of bytes"
)]
pub mod channels;
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "fixed-point arithmetic: bounds stand beside the casts, tests compare with f64"
)]
pub mod detector;
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "pixels of a frame, at most 2^16 a side; sums of bytes"
)]
pub mod image;
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "fixed-point arithmetic: bounds stand beside the casts, tests compare with f64"
)]
pub mod math;
#[cfg(feature = "mavlink")]
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "fixed-point numbers into the fields of messages, clamped before"
)]
pub mod mavlink;
pub mod model;
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "fixed-point arithmetic: bounds stand beside the casts, tests compare with f64"
)]
pub mod registration;
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "cells of a level, at most 2^15 a side; sums of bytes"
)]
pub mod scan;
#[cfg(feature = "std")]
pub mod shell;
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "fixed-point arithmetic: bounds stand beside the casts, tests compare with f64"
)]
pub mod stcube;
pub mod tracking;
pub mod trees;
