//! Ctrl-C ends a run after the frame in hand; pressed again, at once.

use super::error::Error;
use std::string::ToString;
use std::sync::atomic::{AtomicBool, Ordering};

static REQUESTED: AtomicBool = AtomicBool::new(false);

/// The exit status of a program ended by Ctrl-C.
pub const EXIT_STATUS: u8 = 130;

/// How a run that met no error ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// With its last frame.
    Complete,
    /// By Ctrl-C, before its last frame.
    Interrupted,
}

/// From now on Ctrl-C (and SIGTERM, SIGHUP) only sets [`requested`]; the second one ends the program.
///
/// # Errors
/// [`Error::Interrupt`] when the system refuses, or on a second call.
pub fn watch() -> Result<(), Error> {
    ctrlc::set_handler(|| {
        if REQUESTED.swap(true, Ordering::Relaxed) {
            std::process::exit(EXIT_STATUS.into());
        }
    })
    .map_err(|e| Error::Interrupt { reason: e.to_string() })
}

/// Whether Ctrl-C was pressed.
pub fn requested() -> bool {
    REQUESTED.load(Ordering::Relaxed)
}
