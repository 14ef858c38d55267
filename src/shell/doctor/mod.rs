//! `lookout doctor`: what stands between the lookout and the autopilot, in words.

mod examination;
mod finding;
mod parameters;
mod probe;
mod timing;

#[cfg(test)]
mod tests;

pub use examination::{COMPONENT, Examination, Finding, Mark};
pub use parameters::Purpose;

use super::error::Error;
use super::link::{LinkSpec, Links};
use super::support::interrupt::{self, Ended};
use crate::mavlink::component::{Destination, Outgoing};
use crate::shell::support::print::print_line;
use std::format;
use std::string::{String, ToString};
use std::time::{Duration, Instant};
use std::vec::Vec;

/// Why the doctor does not find all well.
#[derive(Debug, thiserror::Error)]
pub enum DoctorError {
    /// A link on which nothing was heard.
    #[error(
        "{link}: nothing was heard in {seconds} s; is the autopilot on, does it send MAVLink to this port, is the \
        baud rate its own?"
    )]
    Silent {
        /// The link as the user named it.
        link: String,
        /// How long it was listened to.
        seconds: u32,
    },
    /// The doctor's verdict.
    #[error("missing: {missing}, see above")]
    Missing {
        /// How many things are missing.
        missing: usize,
    },
}

impl From<DoctorError> for Error {
    fn from(error: DoctorError) -> Self {
        Self::verb(error)
    }
}

/// Longest wait for a frame.
const WAIT: Duration = Duration::from_millis(10);

/// What `lookout doctor` can be told.
#[derive(Debug, Clone, clap::Args)]
pub struct DoctorArgs {
    /// Link to examine: udpin:HOST:PORT, udpout:.., tcpin:.., tcpout:HOST:PORT or serial:DEVICE:BAUD; may be repeated
    #[arg(long, value_name = "SPEC", required = true)]
    link: Vec<LinkSpec>,
    /// How long to listen
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=600))]
    seconds: u32,
    /// Messages that the autopilot is to heed; what is missing for the others is told, but no fault
    #[arg(long, value_name = "LIST", value_enum, value_delimiter = ',', default_value = "traffic")]
    messages: Vec<Purpose>,
    /// Tell the autopilot of an obstacle 12 m ahead and see whether it comes back; not to an armed vehicle
    #[arg(long)]
    probe: bool,
}

/// Examines the links and tells what was found.
///
/// # Errors
/// [`DoctorError::Silent`] where nothing was heard, [`DoctorError::Missing`] where something is missing, [`FileError::Write`].
pub fn run(args: &DoctorArgs) -> Result<Ended, Error> {
    interrupt::watch()?;
    let started = Instant::now();
    let now = || i64::try_from(started.elapsed().as_micros()).unwrap_or(i64::MAX);
    let mut links = Links::open(&args.link);
    let examination = |_| Examination::new(&args.messages, args.probe, now());
    let mut examinations: Vec<Examination> = args.link.iter().map(examination).collect();
    while now() < i64::from(args.seconds) * 1_000_000 && !interrupt::requested() {
        for (index, examination) in examinations.iter_mut().enumerate() {
            while let Some(payload) = examination.poll(now()) {
                let message = Outgoing {
                    to: Destination::Link(index as u8),
                    urgent: true,
                    system_id: examination.system(),
                    component_id: COMPONENT,
                    payload,
                };
                links.send(&message, now());
            }
        }
        if let Some(inbound) = links.receive(WAIT)
            && let Some(examination) = examinations.get_mut(usize::from(inbound.link))
        {
            examination.receive(&inbound.frame, now());
        }
    }
    tell(args, &examinations)
}

fn tell(args: &DoctorArgs, examinations: &[Examination]) -> Result<Ended, Error> {
    let mut missing = 0;
    for (link, examination) in args.link.iter().zip(examinations) {
        print_line(&format!("link {link}, {} s", args.seconds))?;
        for Finding { mark, text } in examination.findings() {
            let word = match mark {
                Mark::Good => "ok",
                Mark::Note => "note",
                Mark::Missing => "missing",
            };
            print_line(&format!("  {word:<8} {text}"))?;
            missing += usize::from(mark == Mark::Missing);
        }
    }
    if interrupt::requested() {
        return Ok(Ended::Interrupted);
    }
    let silent = args.link.iter().zip(examinations).find(|(_, examination)| !examination.heard());
    match (silent, missing) {
        (Some((link, _)), _) => {
            Err(DoctorError::Silent { link: link.to_string(), seconds: args.seconds }.into())
        }
        (None, 0) => Ok(Ended::Complete),
        (None, missing) => Err(DoctorError::Missing { missing }.into()),
    }
}
