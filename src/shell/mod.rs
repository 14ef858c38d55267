//! The shell: everything that needs an operating system (level 8).

pub mod clips;
pub mod simulate;
pub mod source;
