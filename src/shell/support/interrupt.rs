//! Ctrl-C ends a run after the frame in hand; pressed again, at once. A service handles SIGHUP too.

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, LazyLock};
use std::vec::Vec;

static REQUESTED: LazyLock<Arc<AtomicBool>> = LazyLock::new(Arc::default);

/// The exit status of a program ended by Ctrl-C.
pub const EXIT_STATUS: u8 = 130;

/// End of a run without an error.
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
/// [`InterruptError`] when the system refuses.
pub fn watch() -> Result<(), InterruptError> {
    let mut signals = Vec::from([SIGINT, SIGTERM]);
    #[cfg(unix)]
    signals.push(signal_hook::consts::SIGHUP);
    end_by(&signals)
}

/// Orders to a service.
#[derive(Debug, Clone, Default)]
pub struct ServiceOrders {
    /// Set by the first signal.
    pub stop: Arc<AtomicBool>,
    /// To read the settings again.
    pub reload: Arc<AtomicBool>,
}

/// The same for a service, where SIGHUP asks for a reload, and SIGTERM, however often, lets it complete its files: those
/// who send it (`timeout`, a manager that ends a whole group) may well send two.
///
/// # Errors
/// [`InterruptError`] when the system refuses.
pub fn watch_service() -> Result<ServiceOrders, InterruptError> {
    end_by(&[SIGINT])?;
    flag::register(SIGTERM, REQUESTED.clone()).map_err(refused)?;
    let control = ServiceOrders { stop: REQUESTED.clone(), ..ServiceOrders::default() };
    #[cfg(unix)]
    flag::register(signal_hook::consts::SIGHUP, control.reload.clone()).map_err(refused)?;
    Ok(control)
}

fn end_by(signals: &[i32]) -> Result<(), InterruptError> {
    for &signal in signals {
        // The order counts: the first signal finds the flag not yet set.
        flag::register_conditional_shutdown(signal, EXIT_STATUS.into(), REQUESTED.clone())
            .and_then(|_| flag::register(signal, REQUESTED.clone()))
            .map_err(refused)?;
    }
    Ok(())
}

fn refused(source: io::Error) -> InterruptError {
    InterruptError { source }
}

/// Signals cannot be watched.
#[derive(Debug, thiserror::Error)]
#[error("cannot watch for Ctrl-C: {source}")]
pub struct InterruptError {
    source: io::Error,
}

/// Whether Ctrl-C was pressed.
pub fn requested() -> bool {
    REQUESTED.load(Ordering::Relaxed)
}
