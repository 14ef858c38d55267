//! `lookout doctor`: examines links, the autopilot's parameters and video sources, and prints findings with remedies.

mod examination;
mod finding;
mod gimbal;
mod parameters;
mod probe;
mod request;
mod source;
mod timing;

#[cfg(test)]
mod tests;

pub use examination::{COMPONENT, Examination, Finding, Mark};
pub use parameters::Purpose;
pub use source::SourceArgs;

use super::error::Error;
use super::link::{self, LinkSpec, Links};
use super::support::interrupt::{self, Ended};
use crate::mavlink::component::{Destination, Outgoing, Priority};
use crate::shell::live::source::LiveError;
use crate::shell::support::print::print_line;
use std::string::{String, ToString};
use std::time::{Duration, Instant};
use std::vec::Vec;
use std::{format, io};

/// Why the doctor does not find all well.
#[derive(Debug, thiserror::Error)]
pub enum DoctorError {
    /// A link whose port cannot be opened.
    #[error("{link}: {reason}")]
    Unopened {
        /// The link as the user named it.
        link: String,
        /// The system's reason and what to do.
        reason: String,
    },
    /// A live source that gives no picture.
    #[error("{name}: no picture: {reason}")]
    NoPicture {
        /// The source, without user and password.
        name: String,
        /// Error of the source.
        reason: LiveError,
    },
    /// A link on which nothing was heard.
    #[error(
        "{link}: nothing was heard in {seconds} s; is the autopilot on, does it send MAVLink to this port, is the \
        baud rate its own?"
    )]
    Silent {
        /// The link as the user named it.
        link: String,
        /// Seconds listened.
        seconds: u32,
    },
    /// A requirement is not met.
    #[error("missing: {missing}, see above")]
    Missing {
        /// Number of missing requirements.
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

/// Command-line arguments of `lookout doctor`.
#[derive(Debug, Clone, clap::Args)]
pub struct DoctorArgs {
    /// Link to examine: udpin:HOST:PORT, udpout:.., tcpin:.., tcpout:HOST:PORT or serial:DEVICE:BAUD; may be repeated
    #[arg(long, value_name = "SPEC", required_unless_present_any = ["source", "config"])]
    link: Vec<LinkSpec>,
    /// Seconds to listen
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=600))]
    seconds: u32,
    /// Messages that the autopilot must accept; missing settings for other messages are reported, but are no fault
    #[arg(long, value_name = "LIST", value_enum, value_delimiter = ',', default_value = "traffic")]
    messages: Vec<Purpose>,
    /// Send the autopilot an obstacle 12 m ahead and check that it comes back; not to an armed vehicle
    #[arg(long)]
    probe: bool,
    /// The camera is on a gimbal: check that it says where it points
    #[arg(long, requires = "link")]
    gimbal: bool,
    #[command(flatten)]
    source: SourceArgs,
}

/// Examines the links and prints what was found.
///
/// # Errors
/// [`DoctorError`] where a port cannot be opened, nothing was heard or something is missing,
/// [`FileError::Write`](crate::shell::support::file_error::FileError::Write).
pub fn run(args: &DoctorArgs) -> Result<Ended, Error> {
    interrupt::watch()?;
    let missing = source::examine(&args.source, args.seconds)?;
    let started = Instant::now();
    let now = || i64::try_from(started.elapsed().as_micros()).unwrap_or(i64::MAX);
    let mut links = Links::open(&args.link);
    let examination = |_| {
        let mut examination = Examination::new(&args.messages, args.probe, now());
        if args.gimbal {
            examination.expect_gimbal();
        }
        examination
    };
    let mut examinations: Vec<Examination> = args.link.iter().map(examination).collect();
    let listen = !args.link.is_empty();
    while listen && now() < i64::from(args.seconds) * 1_000_000 && !interrupt::requested() {
        for (link, examination) in (0..=u8::MAX).zip(&mut examinations) {
            while let Some(payload) = examination.poll(now()) {
                let message = Outgoing {
                    to: Destination::Link(link),
                    priority: Priority::Urgent,
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
    let never_open: Vec<bool> =
        (0..u8::MAX).zip(&args.link).map(|(index, _)| links.status(index).opened == 0).collect();
    drop(links);
    let reason = |(spec, never): (&LinkSpec, bool)| {
        never.then(|| link::try_open(spec).err()).flatten().map(|e| reason_in_words(&e))
    };
    let reasons: Vec<Option<String>> = args.link.iter().zip(never_open).map(reason).collect();
    report(args, &examinations, &reasons, missing)
}

/// A line about one finding.
fn print_finding(finding: &Finding) -> Result<(), Error> {
    let word = match finding.mark {
        Mark::Good => "ok",
        Mark::Note => "note",
        Mark::Missing => "missing",
    };
    Ok(print_line(&format!("  {word:<8} {}", finding.text))?)
}

/// Why a port cannot be opened, and what to do.
fn reason_in_words(error: &io::Error) -> String {
    let advice = match error.kind() {
        io::ErrorKind::PermissionDenied => {
            "; give this user the port, as by the group dialout (`sudo usermod -aG dialout $USER`, then log in again)"
        }
        io::ErrorKind::NotFound => "; is it plugged in? /dev/serial/by-id lists what is there",
        io::ErrorKind::ConnectionRefused => "; does a program listen there?",
        io::ErrorKind::AddrInUse => "; another program, or a running lookout, has it",
        _ => "",
    };
    format!("cannot be opened: {error}{advice}")
}

/// Prints the findings. `reasons`: why a port cannot be opened, link by link; `missing`: what is missing besides.
fn report(
    args: &DoctorArgs,
    examinations: &[Examination],
    reasons: &[Option<String>],
    mut missing: usize,
) -> Result<Ended, Error> {
    for ((link, examination), reason) in args.link.iter().zip(examinations).zip(reasons) {
        print_line(&format!("link {link}, {} s", args.seconds))?;
        if let Some(reason) = reason {
            print_line(&format!("  missing  the port {reason}"))?;
            missing += 1;
            continue;
        }
        for finding in examination.findings() {
            print_finding(&finding)?;
            missing += usize::from(finding.mark == Mark::Missing);
        }
    }
    if interrupt::requested() {
        return Ok(Ended::Interrupted);
    }
    if let Some((link, reason)) =
        args.link.iter().zip(reasons).find_map(|(link, reason)| Some((link, reason.clone()?)))
    {
        return Err(DoctorError::Unopened { link: link.to_string(), reason }.into());
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

#[cfg(test)]
mod reason_tests {
    use super::*;

    #[test]
    fn ports_that_cannot_be_opened() {
        let reason = |spec: &str| {
            reason_in_words(&link::try_open(&spec.parse().unwrap()).expect_err("it is not there"))
        };
        let missing = reason("serial:/dev/nosuch:57600");
        assert!(missing.contains("No such file") && missing.contains("plugged in"), "{missing}");
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let taken = reason(&format!("tcpin:127.0.0.1:{port}"));
        assert!(taken.contains("in use") && taken.contains("another program"), "{taken}");
        drop(listener);
        let refused = reason(&format!("tcpout:127.0.0.1:{port}"));
        assert!(refused.contains("refused") && refused.contains("listen"), "{refused}");
        let denied = reason_in_words(&io::Error::from_raw_os_error(13));
        assert!(denied.contains("ermission denied") && denied.contains("dialout"), "{denied}");
    }
}
