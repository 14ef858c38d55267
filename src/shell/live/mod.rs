//! `lookout run`: a live camera and live links, as a service.

pub mod capture;
pub mod check;
mod components;
pub mod config;
mod events;
pub mod image_health;
mod json_stream;
pub mod keys;
mod live_source;
pub mod log;
mod mailbox;
mod notify;
mod outputs;
mod pace;
mod paced;
mod record;
mod ring;
pub mod service;
pub mod source;
pub mod source_setting;
mod stages;
mod stream;
pub mod summary;
mod v4l2;
mod worker;
mod writer;

use super::error::Error;
use super::support::interrupt::{self, Ended};
use crate::shell::support::print::print_line;
use config::ServiceConfig;
use service::ServiceError;
use std::eprintln;
use std::path::{Path, PathBuf};
use std::string::ToString;
use std::sync::atomic::Ordering;
use std::thread;
use std::time::Duration;

/// Command-line arguments of `lookout run`.
#[derive(Debug, Clone, clap::Args)]
pub struct RunArgs {
    /// The settings, TOML
    #[arg(long, value_name = "FILE", required_unless_present = "print_config")]
    config: Option<PathBuf>,
    /// Check the settings and what they name, print those in effect with every key explained, and end
    #[arg(long)]
    print_config: bool,
}

/// Timeout of the shutdown: less than the 10 s after which a service manager or `docker stop` kills.
const END: Duration = Duration::from_secs(5);

/// Ends the program if it does not end by itself in time after an order to stop, as where a read of a source never returns.
fn end_at_last(control: &interrupt::ServiceOrders) -> std::io::Result<()> {
    let stop = control.stop.clone();
    let wait = move || {
        while !stop.load(Ordering::Relaxed) {
            thread::sleep(Duration::from_millis(50));
        }
        thread::sleep(END);
        tracing::error!("the source does not end within 5 s: ended without it");
        thread::sleep(Duration::from_millis(100));
        std::process::exit(STUCK_STATUS);
    };
    thread::Builder::new().name("end".into()).spawn(wait).map(drop)
}

/// The exit status of a service that had to be ended.
const STUCK_STATUS: i32 = 1;

/// Runs the service.
///
/// # Errors
/// [`Error`]; what was written before stays.
pub fn run(args: &RunArgs) -> Result<Ended, Error> {
    let config = args.config.as_deref().map(ServiceConfig::read).transpose()?;
    let (Some(path), Some(config), false) = (&args.config, &config, args.print_config) else {
        print_line(config::print(config.as_ref()).trim_end())?;
        return match (&args.config, &config) {
            (Some(path), Some(config)) => report_faults(path, config),
            _ => Ok(Ended::Complete),
        };
    };
    if check::does_nothing(config) {
        tracing::warn!("{}", check::NOTHING);
    }
    let control = interrupt::watch_service()?;
    end_at_last(&control).map_err(|source| ServiceError::Thread { source })?;
    let summary =
        service::run(config.clone(), &|| ServiceConfig::read(path), &control, &source::open)?;
    print_line(summary.to_string().trim_end())?;
    Ok(Ended::Complete)
}

/// All faults of what the settings in `path` name, on standard error.
///
/// # Errors
/// [`check::UnusableSettings`] where `lookout run` would not start.
fn report_faults(path: &Path, config: &ServiceConfig) -> Result<Ended, Error> {
    let faults = check::faults(config);
    for check::Fault { key, text, starts } in &faults {
        let word = if *starts { "note" } else { "fault" };
        eprintln!("{word}: {key}: {text}");
    }
    match faults.iter().filter(|fault| !fault.starts).count() {
        0 => Ok(Ended::Complete),
        faults => Err(Error::verb(check::UnusableSettings { path: path.into(), faults })),
    }
}
