//! `lookout params`: reads and sets the LK_* parameters of a running lookout over a link.
//!
//! QGroundControl lists the parameters of an ArduPilot vehicle alone, not those of other components.

mod client;

use super::error::Error;
use super::link::{LinkSpec, Links};
use super::support::clock::now_us;
use super::support::interrupt::{self, Ended};
use crate::mavlink::component::{Destination, Outgoing, Priority};
use crate::shell::support::print::print_line;
use client::{ParameterClient, Value};
pub use client::{ParamsError, Wish};
use std::format;
use std::string::String;
use std::time::{Duration, Instant};
use std::vec::Vec;

/// Longest wait for a frame.
const WAIT: Duration = Duration::from_millis(20);
/// Our ids: a ground station's, with a component of its own.
const SYSTEM: u8 = 254;
const COMPONENT: u8 = 190;

/// Command-line arguments of `lookout params`.
#[derive(Debug, Clone, clap::Args)]
pub struct ParamsArgs {
    #[command(subcommand)]
    verb: ParamsVerb,
}

/// Operations on parameters.
#[derive(Debug, Clone, clap::Subcommand)]
enum ParamsVerb {
    /// Print parameters: NAME VALUE a line; without names all of them
    Get {
        /// Names, as LK_WINGSPAN
        names: Vec<String>,
        #[command(flatten)]
        link: LinkArgs,
    },
    /// Set a parameter
    Set {
        /// Its name, as LK_WINGSPAN
        name: String,
        /// Its new value
        #[arg(allow_negative_numbers = true)]
        value: f32,
        #[command(flatten)]
        link: LinkArgs,
    },
}

/// Link to the lookout.
#[derive(Debug, Clone, clap::Args)]
struct LinkArgs {
    /// Link to the lookout, or to an autopilot or router that forwards: udpin:HOST:PORT, udpout:.., tcpin:.., tcpout:.. or
    /// serial:DEVICE:BAUD
    #[arg(long, value_name = "SPEC")]
    link: LinkSpec,
    /// Its component id
    #[arg(long, value_name = "ID", default_value_t = 196, value_parser = clap::value_parser!(u8).range(1..))]
    component: u8,
    /// Seconds to wait
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=600))]
    seconds: u32,
}

/// Reads or sets parameters.
///
/// # Errors
/// [`ParamsError`] where there is no answer or a value is refused; standard output that cannot be written.
pub fn run(args: &ParamsArgs) -> Result<Ended, Error> {
    let (wish, link) = match &args.verb {
        ParamsVerb::Get { names, link } => (Wish::Get(names.clone()), link),
        ParamsVerb::Set { name, value, link } => (Wish::Set(name.clone(), *value), link),
    };
    interrupt::watch()?;
    let mut links = Links::open(core::slice::from_ref(&link.link));
    let mut client = ParameterClient::new(wish, link.component, now_us());
    let end = Instant::now() + Duration::from_secs(link.seconds.into());
    while !client.is_complete() && Instant::now() < end {
        if interrupt::requested() {
            return Ok(Ended::Interrupted);
        }
        while let Some(payload) = client.poll(now_us()) {
            let message = Outgoing {
                to: Destination::All,
                priority: Priority::Urgent,
                system_id: SYSTEM,
                component_id: COMPONENT,
                payload,
            };
            links.send(&message, now_us());
        }
        if let Some(inbound) = links.receive(WAIT) {
            client.receive(&inbound.frame);
        }
    }
    let values = client.finish(&link.link, link.seconds).map_err(Error::verb)?;
    for Value { name, value } in values {
        print_line(&format!("{name} {value}"))?;
    }
    Ok(Ended::Complete)
}
