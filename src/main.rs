//! The `lookout` program.

use lookout::shell::program;
use lookout::shell::sources::process as children;
use std::process::ExitCode;

fn main() -> ExitCode {
    let mut words = std::env::args_os().skip(1);
    if words.next().is_some_and(|verb| verb == children::SUPERVISE) {
        return children::supervise(&words.collect::<Vec<_>>());
    }
    // Where the system does not say, children are started without a supervisor.
    program::run(std::env::args_os().collect(), std::env::current_exe().ok()).into()
}
