//! Lookout: the open onboard lookout for drones.
//!
//! It watches the grey camera of a drone that moves itself and finds other flying objects in it: small ones, of 10 to
//! 100 pixels, before ground, trees and sky that move as well. The method is that of Rozantsev, Lepetit and Fua,
//! "Flying Objects Detection from a Single Moving Camera" (CVPR 2015): the last frames around an object are put
//! together to a st-cube, regressors keep the object in the middle of every slice, boosted trees over the gradient
//! energies of boxes in the cube tell objects from what is left of the background.
//!
//! # The core
//! Without features the crate is the detector alone: no standard library, no allocation, integers only, memory and time
//! given by the caller. The same frames give the same bytes on a desktop and on a microcontroller.
//!
//! ```
//! use lookout::detector::{Buffers, Config, Detector};
//! use lookout::image::Image;
//! use lookout::model::Model;
//!
//! const CONFIG: Config = Config { max_target: 60, ..Config::new(160, 120) };
//! let mut bytes = [0; CONFIG.bytes_len()];
//! let mut words = [0; CONFIG.words_len()];
//!
//! let model = Model::parse(include_bytes!("../models/lookout.lkm"))?;
//! let buffers = Buffers { bytes: &mut bytes, words: &mut words };
//! let mut detector = Detector::new(&model, CONFIG, buffers)?;
//!
//! let grey = [90; 160 * 120];
//! let frame = Image::packed(&grey, 160, 120)?;
//! let detections = detector.process(frame, 33_333)?;
//! for detection in &detections.list {
//!     println!("{:?} with score {}", detection.rect, detection.score);
//! }
//! # assert!(detections.windows > 0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Features
//! - `std` (default): the shell around the core, `shell`, and the program `lookout`: recorded flights in, detections,
//!   scores and trained models out.
//! - `rayon` (default, implies `std`): levels of the pyramid and the trainer's work on all processors. The results are
//!   those of one thread, byte for byte.
//! - `embedded` (excludes `std`): `message`, `component` and `onboard`, the MAVLink side, for a board without an operating system.
//!
//! # Layers, from the top down
//! A module uses modules of lower levels only; a test checks it.
//!
//! | level | module | what it does |
//! | --- | --- | --- |
//! | 10 | `shell` | everything that needs an operating system: sources, replay, training, evaluation |
//! | 9 | `onboard` | the lookout behind its detector: tracks, threat, MAVLink (feature `mavlink`) |
//! | 8 | [`detector`] | frames in, detections out: configuration, memory, the order of the steps below |
//! | 7 | [`judge`] | the verdict on a candidate: its st-cube, a score, a box |
//! | 6 | [`front`] | the front end: from frames to the pictures of all levels, for the last frames |
//! | 6 | [`search`] | the candidates of a frame: maps of all levels, scanned in strips |
//! | 6 | [`window_flow`] | the slices of a cube along the optical flow of its window, to compare Algorithm 1 with |
//! | 6 | [`model`] | the model file, checked once and read where it lies |
//! | 5 | [`scan`] | a soft cascade over every window of every level: the candidates |
//! | 5 | [`fit`] | the box of an object, from windows that are stretched to it |
//! | 5 | [`motion`] | Algorithm 1: the object stays in the middle of every slice of its cube |
//! | 5 | [`watch`] | detections in, traffic out: tracks and their threat, the camera's own turning removed |
//! | 4 | [`threat`] | time to contact, constant bearing, range, alert levels |
//! | 4 | [`feature`] | energies of boxes in a cube, compared without a division |
//! | 4 | [`levels`] | the pyramid of a frame and its memory |
//! | 4 | `component` | a MAVLink component: what it hears, answers and tells (feature `mavlink`) |
//! | 3 | `message` | MAVLink messages about traffic (feature `mavlink`) |
//! | 3 | [`track`] | which detections are of one object, and how it moves |
//! | 3 | [`map`] | the channels of a level, normalised: what the scan looks up |
//! | 3 | [`cube`] | windows on the last frames: the slices of a st-cube |
//! | 3 | [`warp`] | an older frame seen from where the camera is now, and what differs |
//! | 2 | [`attitudes`] | the vehicle's attitude at the time of a frame |
//! | 2 | [`camera`] | from a point in the picture to a direction, and back |
//! | 2 | [`digest`] | one number for all detections of a flight |
//! | 2 | [`channels`] | gradient energies and differences of the cells of a level |
//! | 2 | [`registration`] | the motion of the background from frame to frame |
//! | 2 | [`traffic`] | what is told to others about an object: where it is, how near, how dangerous |
//! | 1 | [`geometry`] | directions and attitudes |
//! | 1 | [`detection`] | what was found in a frame |
//! | 1 | [`calibration`] | what share of detections of a score is right |
//! | 1 | [`persistence`] | what was there a frame ago makes a detection surer |
//! | 1 | [`kalman`] | a value and its rate: how wrong they are, and what a measurement changes |
//! | 1 | [`trees`] | boosted trees and their cascade; they know no image |
//! | 1 | [`planar`] | a motion of the whole picture, fitted to the motion of points |
//! | 1 | [`flow`] | corners, and where they were in another picture |
//! | 1 | [`gradient`] | gradient energy of cells by orientation |
//! | 1 | [`history`] | what is kept of the last frames |
//! | 1 | [`pyramid`] | smaller copies of a picture |
//! | 1 | [`nms`] | of boxes that overlap only the best is kept |
//! | 0 | [`image`] | views of grey pictures, and boxes in them |
//! | 0 | [`angle`] | roots, logarithms, sines, vectors in fixed point |
//! | 0 | [`fixed`] | fixed-point helpers |
//! | 0 | [`linear`] | small systems of linear equations in integers |
#![no_std]

#[cfg(any(test, feature = "simd"))]
extern crate std;

pub mod boxes;
pub mod camera;
pub mod channels;
pub mod detector;
pub mod image;
pub mod math;
#[cfg(feature = "mavlink")]
pub mod mavlink;
pub mod model;
pub mod registration;
pub mod scan;
#[cfg(feature = "std")]
pub mod shell;
pub mod stcube;
pub mod tracking;
pub mod trees;
