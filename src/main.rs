//! The `lookout` program.

use clap::Parser;
use lookout::shell::cli::{Cli, Verb};
use lookout::shell::error::Error;
use lookout::shell::support::interrupt::{self, Ended};
use lookout::shell::{bench, doctor, evaluate, live, params, replay, train};
use std::io::IsTerminal;
use std::process::ExitCode;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

fn main() -> ExitCode {
    let cli = Cli::parse();
    // A service logs what happens to it; a verb typed by a person shows what is wrong.
    let level =
        if matches!(cli.verb, Verb::Run(_)) { LevelFilter::INFO } else { LevelFilter::ERROR };
    let stderr = tracing_subscriber::fmt::layer()
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal());
    tracing_subscriber::registry().with(stderr).with(log_filter(level)).init();
    match dispatch(&cli.verb) {
        Ok(Ended::Complete) => ExitCode::SUCCESS,
        Ok(Ended::Interrupted) => interrupt::EXIT_STATUS.into(),
        Err(error) if error.is_closed_pipe() => ExitCode::SUCCESS,
        Err(error) => {
            // One line, whatever a decoder or the system put into its reason.
            eprintln!("lookout: {}", error.to_string().replace(['\r', '\n'], " "));
            ExitCode::FAILURE
        }
    }
}

/// Filter of the log: the environment variable `LOOKOUT_LOG` (a level, or `target=level,...`), or `default` where it is not
/// set or cannot be read.
fn log_filter(default: LevelFilter) -> Targets {
    let text = std::env::var("LOOKOUT_LOG").unwrap_or_default();
    let default = Targets::new().with_default(default);
    if text.is_empty() {
        return default;
    }
    text.parse().unwrap_or_else(|error| {
        eprintln!("lookout: LOOKOUT_LOG={text}: {error}; use error, warn, info, debug or trace");
        default
    })
}

fn dispatch(verb: &Verb) -> Result<Ended, Error> {
    match verb {
        Verb::Simulate(args) => Ok(lookout::shell::simulate::run(args).map(|()| Ended::Complete)?),
        Verb::Replay(args) => replay::run(args),
        Verb::Run(args) => live::run(args),
        Verb::Eval(args) => evaluate::run(args),
        Verb::Score(args) => evaluate::run_score(args),
        Verb::Bench(args) => bench::run(args),
        Verb::Doctor(args) => doctor::run(args),
        Verb::Params(args) => params::run(args),
        Verb::Train(args) => train::run(args),
    }
}
