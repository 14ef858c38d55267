//! A program that writes frames to its standard output: started without a shell in a process group of its own, and ended
//! as a group.
//!
//! The group also ends when this program is killed without a chance to clean up. For that the program starts itself as a
//! supervisor (`lookout supervise`, hidden) between itself and the child: the supervisor's standard input is a pipe that
//! closes with us, and then it kills the group that it leads. `PR_SET_PDEATHSIG` would reach the child alone, not what the
//! child started, and needs code between `fork` and `exec`, which is unsafe.

use std::boxed::Box;
use std::ffi::{OsStr, OsString};
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, ExitCode, ExitStatus, Stdio};
use std::string::String;
use std::sync::OnceLock;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use std::vec::Vec;
use std::{env, format};

/// The verb under which this program supervises a child.
pub const SUPERVISE: &str = "supervise";

/// Time from SIGTERM to SIGKILL of a process group.
const GRACE: Duration = Duration::from_millis(400);

/// Longest line of a child's standard error that is kept, bytes.
const LINE: u64 = 1000;

static SUPERVISOR: OnceLock<PathBuf> = OnceLock::new();

/// Starts children below `program`, which must call [`supervise`] when its first argument is [`SUPERVISE`].
///
/// Without this call (the library used alone) children are started directly, and outlive a parent that is killed.
pub fn supervise_with(program: PathBuf) {
    // A second call changes nothing: children of one program have one supervisor.
    let _ = SUPERVISOR.set(program);
}

/// A running child and the thread that reads its standard error.
#[derive(Debug)]
pub struct Process {
    child: Child,
    complaints: Option<JoinHandle<()>>,
}

impl Process {
    /// Starts the program `words[0]` with the arguments after it. `complaint` is called with every line of its standard
    /// error, from another thread.
    ///
    /// # Errors
    /// [`io::ErrorKind::NotFound`] when there is no such program, else what the system said.
    pub fn start(
        words: &[OsString],
        mut complaint: Box<dyn FnMut(&str) + Send>,
    ) -> io::Result<(Self, ChildStdout)> {
        let (program, arguments) = words.split_first().ok_or(io::ErrorKind::InvalidInput)?;
        let program = find(program)?;
        let spawn = |mut command: Command| {
            #[cfg(unix)]
            std::os::unix::process::CommandExt::process_group(&mut command, 0);
            command.args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()
        };
        let supervised = SUPERVISOR.get().map(|supervisor| {
            let mut command = Command::new(supervisor);
            command.arg(SUPERVISE).arg(&program).stdin(Stdio::piped());
            spawn(command)
        });
        let mut child = match supervised {
            Some(Ok(child)) => child,
            // This program's file may have been replaced or be of another machine (under an emulator): without it then.
            Some(Err(_)) | None => {
                let mut command = Command::new(program);
                command.stdin(Stdio::null());
                spawn(command)?
            }
        };
        let stdout = child.stdout.take().ok_or(io::ErrorKind::BrokenPipe)?;
        let stderr = child.stderr.take().ok_or(io::ErrorKind::BrokenPipe)?;
        // Read all the time: a full pipe of complaints would stop the child.
        let complaints = thread::spawn(move || read_lines(stderr, &mut complaint));
        Ok((Self { child, complaints: Some(complaints) }, stdout))
    }

    /// Waits for the end of the child, after which all its complaints were given out.
    ///
    /// # Errors
    /// The system's reason.
    pub fn wait(&mut self) -> io::Result<ExitStatus> {
        let status = self.child.wait()?;
        self.join();
        Ok(status)
    }

    /// Ends the whole group: SIGTERM, then SIGKILL after 0.4 s.
    ///
    /// # Errors
    /// The system's reason.
    pub fn end(&mut self) -> io::Result<ExitStatus> {
        if let Some(status) = self.child.try_wait()? {
            // Children that it left in its process group.
            self.kill();
            self.join();
            return Ok(status);
        }
        #[cfg(target_os = "linux")]
        {
            self.signal(rustix::process::Signal::TERM);
            let start = Instant::now();
            while start.elapsed() < GRACE && self.child.try_wait()?.is_none() {
                thread::sleep(Duration::from_millis(5));
            }
        }
        self.kill();
        let status = self.child.wait()?;
        self.join();
        Ok(status)
    }

    fn join(&mut self) {
        if let Some(complaints) = self.complaints.take() {
            // A child of the child may hold the pipe of standard error open: it is not waited for for ever.
            let start = Instant::now();
            while !complaints.is_finished() && start.elapsed() < GRACE {
                thread::sleep(Duration::from_millis(2));
            }
            if complaints.is_finished() {
                let _ = complaints.join();
            }
        }
    }

    fn kill(&mut self) {
        #[cfg(target_os = "linux")]
        self.signal(rustix::process::Signal::KILL);
        // Fails only when it has ended already.
        let _ = self.child.kill();
    }

    #[cfg(target_os = "linux")]
    fn signal(&self, signal: rustix::process::Signal) {
        // Fails only when nobody of the group is left. The group's number is not given to another while it has members.
        if let Some(group) = rustix::process::Pid::from_raw(self.child.id().cast_signed()) {
            let _ = rustix::process::kill_process_group(group, signal);
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.end();
    }
}

/// The path of a program: as it is where it has a slash, else the first of that name in `PATH`.
///
/// # Errors
/// [`io::ErrorKind::NotFound`].
pub fn find(program: &OsStr) -> io::Result<PathBuf> {
    let path = Path::new(program);
    let found = if path.components().count() > 1 {
        Some(path.to_path_buf())
    } else {
        let folders = env::var_os("PATH").unwrap_or_default();
        env::split_paths(&folders).map(|folder| folder.join(path)).find(|path| path.is_file())
    };
    found.filter(|path| path.is_file()).ok_or_else(|| {
        io::Error::new(io::ErrorKind::NotFound, format!("no program {} here", path.display()))
    })
}

/// Gives every line without its end; what is longer than [`LINE`] in pieces.
fn read_lines(from: impl Read, line: &mut dyn FnMut(&str)) {
    let mut reader = BufReader::new(from);
    let mut bytes = Vec::new();
    loop {
        bytes.clear();
        match reader.by_ref().take(LINE).read_until(b'\n', &mut bytes) {
            // A child that dies while it writes leaves what it wrote.
            Ok(0) | Err(_) => return,
            Ok(_) => {
                let text = String::from_utf8_lossy(&bytes);
                if !text.trim().is_empty() {
                    line(text.trim());
                }
            }
        }
    }
}

/// Runs the program `words[0]` as a child of this process, which leads a process group, and ends as the child does. When
/// standard input ends before, the whole group is killed, this process with it.
pub fn supervise(words: &[OsString]) -> ExitCode {
    let Some((program, arguments)) = words.split_first() else { return ExitCode::from(127) };
    // SIGTERM is meant for the child; this process ends after it. Where it cannot be caught it ends this process too.
    #[cfg(unix)]
    let _ = signal_hook::flag::register(signal_hook::consts::SIGTERM, std::sync::Arc::default());
    let mut child = match Command::new(program).args(arguments).stdin(Stdio::null()).spawn() {
        Ok(child) => child,
        Err(error) => {
            std::eprintln!("{}: {error}", Path::new(program).display());
            return ExitCode::from(127);
        }
    };
    thread::spawn(|| {
        // Nothing is ever written there: it ends when the parent does.
        let _ = io::copy(&mut io::stdin(), &mut io::sink());
        #[cfg(target_os = "linux")]
        let _ = rustix::process::kill_process_group(
            rustix::process::getpgrp(),
            rustix::process::Signal::KILL,
        );
        std::process::exit(1);
    });
    let code = child.wait().ok().and_then(|status| status.code());
    code.and_then(|code| u8::try_from(code).ok()).map_or(ExitCode::FAILURE, ExitCode::from)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;
    use std::sync::{Arc, Mutex};

    fn words(words: &[&str]) -> Vec<OsString> {
        words.iter().map(OsString::from).collect()
    }

    #[test]
    fn output_and_complaints_are_apart_and_whole() {
        let heard = Arc::new(Mutex::new(Vec::new()));
        let lines = heard.clone();
        let complaint = move |line: &str| lines.lock().unwrap().push(String::from(line));
        let script = "echo frames; echo one >&2; echo; echo two >&2; exit 3";
        let (mut process, mut stdout) =
            Process::start(&words(&["sh", "-c", script]), Box::new(complaint)).unwrap();
        let mut text = String::new();
        stdout.read_to_string(&mut text).unwrap();
        assert_eq!(text, "frames\n\n");
        assert_eq!(process.wait().unwrap().code(), Some(3));
        assert_eq!(*heard.lock().unwrap(), ["one", "two"]);
    }

    #[test]
    fn a_long_line_comes_in_pieces() {
        let mut pieces = Vec::new();
        let text = std::vec![b'x'; 2500];
        read_lines(text.as_slice(), &mut |line| pieces.push(line.len()));
        assert_eq!(pieces, [1000, 1000, 500]);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn the_whole_group_ends_and_what_ignores_sigterm_too() {
        let script = "trap '' TERM; sleep 1000 & echo $!; wait; sleep 1000";
        let (mut process, stdout) =
            Process::start(&words(&["sh", "-c", script]), Box::new(|_| {})).unwrap();
        let mut line = String::new();
        BufReader::new(stdout).read_line(&mut line).unwrap();
        let grandchild = PathBuf::from(format!("/proc/{}/stat", line.trim()));
        let running = || {
            // A process that nobody has waited for yet is a zombie, Z.
            let stat = std::fs::read_to_string(&grandchild).unwrap_or_default();
            stat.rsplit(") ").next().is_some_and(|rest| !rest.is_empty() && !rest.starts_with('Z'))
        };
        assert!(running());
        let start = Instant::now();
        process.end().unwrap();
        assert!(start.elapsed() < Duration::from_secs(5));
        while running() && start.elapsed() < Duration::from_secs(5) {
            thread::sleep(Duration::from_millis(10));
        }
        assert!(!running(), "the child's child goes on");
    }

    #[test]
    fn a_missing_program_is_named() {
        let error = Process::start(&words(&["no-such-program"]), Box::new(|_| {})).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::NotFound);
        assert!(error.to_string().contains("no-such-program"));
        assert!(Process::start(&[], Box::new(|_| {})).is_err());
    }
}
