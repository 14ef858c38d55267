//! The `lookout` program.

use clap::Parser;
use lookout::shell::cli::{Cli, Verb};
use lookout::shell::error::Error;
use lookout::shell::support::interrupt::{self, Ended};
use lookout::shell::{bench, doctor, evaluate, live, replay, train};
use std::io::IsTerminal;
use std::process::ExitCode;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::LevelFilter;

fn main() -> ExitCode {
    let cli = Cli::parse();
    // A service tells what happens to it; who types a verb sees what is wrong.
    let silent =
        if matches!(cli.verb, Verb::Run(_)) { LevelFilter::INFO } else { LevelFilter::ERROR };
    let filter = EnvFilter::builder().with_default_directive(silent.into());
    tracing_subscriber::fmt()
        .with_env_filter(filter.with_env_var("LOOKOUT_LOG").from_env_lossy())
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
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
        Verb::Run(args) => live::run(args),
        Verb::Eval(args) => evaluate::run(args),
        Verb::Score(args) => evaluate::run_score(args),
        Verb::Bench(args) => bench::run(args),
        Verb::Doctor(args) => doctor::run(args),
        Verb::Train(args) => train::run(args),
    }
}
