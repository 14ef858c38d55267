//! The program: from the words of the command line to the exit status.

use super::cli::{Cli, Verb};
use super::error::Error;
use super::live::log::Log;
use super::sources::process as children;
use super::support::interrupt::{self, Ended};
use super::{bench, doctor, evaluate, import, live, mask, params, replay, train};
use clap::Parser;
use std::boxed::Box;
use std::ffi::OsString;
use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;
use std::time::Duration;
use std::vec::Vec;
use std::{format, process, thread};
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

/// The exit status after a panic, as Rust itself has it.
const PANIC_STATUS: i32 = 101;

/// How long the last lines of the log may take.
const LAST_LINES: Duration = Duration::from_secs(1);

/// Runs a verb; gives the exit status. `words` begin with the program's name. `own` is the file that supervises children when
/// it is started with [`children::SUPERVISE`]; without it they are started without a supervisor. Words that make no sense end
/// the process.
pub fn run(words: Vec<OsString>, own: Option<PathBuf>) -> u8 {
    if let Some(own) = own {
        children::supervise_with(own);
    }
    let cli = Cli::parse_from(words);
    let service = matches!(cli.verb, Verb::Run(_));
    // Without a thread for it, the log is written as that of the other verbs.
    let log = if service { Log::start().ok() } else { None };
    let lines = log.clone();
    let say = move |line: &str| {
        let line = format!("{}\n", line.replace(['\r', '\n'], " "));
        // A standard error that is gone is no reason to end otherwise than by the status.
        let _ = match lines.clone() {
            Some(mut log) => log.write_all(line.as_bytes()).map(|()| log.drain(LAST_LINES)),
            None => io::stderr().write_all(line.as_bytes()),
        };
    };
    let last = say.clone();
    // Nothing is worth going on with a part of the threads: a panic of any of them ends the program.
    std::panic::set_hook(Box::new(move |panic| {
        last(&format!("lookout: thread '{}': {panic}", thread::current().name().unwrap_or("?")));
        process::exit(PANIC_STATUS);
    }));
    // A service logs its state; whoever types a verb sees what is wrong or doubtful.
    let level = if service { LevelFilter::INFO } else { LevelFilter::WARN };
    let layer = tracing_subscriber::fmt::layer()
        .with_ansi(io::stderr().is_terminal())
        // A line that cannot be written is lost. By default it is complained about on standard error, with a panic.
        .log_internal_errors(false);
    let filter = log_filter(level, &say);
    // It is there already where a program runs a second verb.
    let _ = match log.clone() {
        Some(log) => {
            tracing_subscriber::registry().with(layer.with_writer(log)).with(filter).try_init()
        }
        None => {
            let layer = layer.with_writer(io::stderr);
            tracing_subscriber::registry().with(layer).with(filter).try_init()
        }
    };
    let status = match dispatch(&cli.verb) {
        Ok(Ended::Complete) => 0,
        Ok(Ended::Interrupted) => interrupt::EXIT_STATUS,
        Err(error) if error.is_closed_pipe() => 0,
        Err(error) => {
            // One line, whatever a decoder or the system put into its reason.
            say(&format!("lookout: {error}"));
            error.exit_status()
        }
    };
    if let Some(log) = log {
        log.drain(LAST_LINES);
    }
    status
}

/// Filter of the log: the environment variable `LOOKOUT_LOG` (a level, or `target=level,...`), or `default` where it is not
/// set or cannot be read.
fn log_filter(default: LevelFilter, say: &dyn Fn(&str)) -> Targets {
    let text = std::env::var("LOOKOUT_LOG").unwrap_or_default();
    let default = Targets::new().with_default(default);
    if text.is_empty() {
        return default;
    }
    text.parse().unwrap_or_else(|error| {
        say(&format!(
            "lookout: LOOKOUT_LOG={text}: {error}; use error, warn, info, debug or trace"
        ));
        default
    })
}

fn dispatch(verb: &Verb) -> Result<Ended, Error> {
    match verb {
        Verb::Simulate(args) => Ok(super::simulate::run(args).map(|()| Ended::Complete)?),
        Verb::Replay(args) => replay::run(args),
        Verb::Run(args) => live::run(args),
        Verb::Eval(args) => evaluate::run(args),
        Verb::Score(args) => evaluate::run_score(args),
        Verb::Manifest(args) => evaluate::fleet::manifest::run(args),
        Verb::Merge(args) => evaluate::fleet::merge::run(args),
        Verb::Import(args) => Ok(import::run(args)?),
        Verb::Bench(args) => bench::run(args),
        Verb::Doctor(args) => doctor::run(args),
        Verb::Mask(args) => mask::run(args),
        Verb::Params(args) => params::run(args),
        Verb::Train(args) => train::run(args),
        Verb::Mine(args) => train::run_mine(args),
        Verb::Fit(args) => train::run_fit(args),
    }
}
