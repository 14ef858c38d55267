//! The shell: everything that needs an operating system (level 8).

pub mod source;
pub mod train;
