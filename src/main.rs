//! The `lookout` program.

use clap::Parser;
use lookout::shell::cli::{Cli, Verb};
use lookout::shell::error::Error;
use lookout::shell::interrupt::{self, Ended};
use lookout::shell::{bench, doctor, eval, replay, train};
use std::process::ExitCode;
use tracing_subscriber::EnvFilter;

fn main() -> ExitCode {
    let cli = Cli::parse();
    tracing_subscriber::fmt()
        .with_env_filter(EnvFilter::from_env("LOOKOUT_LOG"))
        .with_writer(std::io::stderr)
        .init();
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

fn dispatch(verb: &Verb) -> Result<Ended, Error> {
    match verb {
        Verb::Simulate(args) => Ok(lookout::shell::simulate::run(args).map(|()| Ended::Complete)?),
        Verb::Replay(args) => replay::run(args),
        Verb::Eval(args) => eval::run(args),
        Verb::Score(args) => eval::run_score(args),
        Verb::Bench(args) => bench::run(args),
        Verb::Doctor(args) => doctor::run(args),
        Verb::Train(args) => train::run(args),
    }
}
