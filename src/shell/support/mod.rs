//! Helpers that know nothing of frames: clock, signals, threads, seeded random numbers, histograms, atomic files.

pub mod atomic_file;
pub mod bounded_file;
pub mod clock;
pub mod file_error;
pub mod histogram;
pub mod interrupt;
pub mod keeper;
pub mod lock;
pub mod parallel;
pub mod print;
pub mod random;
pub mod repeats;
pub mod sorter;
pub mod spool;
pub mod text;
pub mod vectors;
