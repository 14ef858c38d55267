//! `lookout run` as a process in a test.

use super::live::{Ground, PATIENCE};
use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// The program with arguments, without settings of this environment. LOOKOUT_PROGRAM names another one to be tested, as
/// one of an earlier version.
pub fn lookout(args: &[&str]) -> Command {
    let program = std::env::var_os("LOOKOUT_PROGRAM");
    let mut command =
        Command::new(program.as_deref().unwrap_or(env!("CARGO_BIN_EXE_lookout").as_ref()));
    command.args(args).env_remove("LOOKOUT_LOG").env_remove("NOTIFY_SOCKET");
    command
}

/// A service under way; ended with the test.
pub struct Service {
    pub child: Child,
    /// Its standard error so far, and the thread that reads it.
    pub log: Arc<Mutex<String>>,
    scribe: Option<JoinHandle<()>>,
    pub folder: TempDir,
}

impl Service {
    pub fn config(folder: &TempDir) -> PathBuf {
        folder.path().join("lookout.toml")
    }

    /// Starts it with these settings; a word for FOLDER is put in.
    pub fn start(text: &str, prepare: impl FnOnce(&mut Command, &Path)) -> Self {
        Self::start_in(tempfile::tempdir().unwrap(), text, prepare)
    }

    /// The same in a folder of an earlier run.
    pub fn start_in(
        folder: TempDir,
        text: &str,
        prepare: impl FnOnce(&mut Command, &Path),
    ) -> Self {
        let config = Self::config(&folder);
        let place = folder.path().to_str().unwrap();
        fs::write(&config, text.replace("FOLDER", place)).unwrap();
        let mut command = lookout(&["run", "--config", config.to_str().unwrap()]);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        prepare(&mut command, folder.path());
        let mut child = command.spawn().unwrap();
        let log = Arc::<Mutex<String>>::default();
        let (stderr, written) = (child.stderr.take(), log.clone());
        let scribe = thread::spawn(move || {
            let lines = stderr.into_iter().flat_map(|stderr| BufReader::new(stderr).lines());
            lines.for_each(|line| *written.lock().unwrap() += &format!("{}\n", line.unwrap()));
        });
        Self { child, log, scribe: Some(scribe), folder }
    }

    /// Waits until it says these words on standard error.
    pub fn wait_log(&self, words: &str) {
        let start = Instant::now();
        while !self.log.lock().unwrap().contains(words) {
            assert!(start.elapsed() < PATIENCE, "no {words} in {}", self.log.lock().unwrap());
            thread::sleep(Duration::from_millis(20));
        }
    }

    /// Ends it without a chance to complete anything; its folder stays.
    pub fn kill(mut self) -> TempDir {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
        std::mem::replace(&mut self.folder, tempfile::tempdir().unwrap())
    }

    /// Resident memory, kilobytes, without the pages of files.
    pub fn memory(&self) -> u64 {
        let status = fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find(|line| line.starts_with("RssAnon:")).unwrap();
        line.split_whitespace().nth(1).unwrap().parse().unwrap()
    }

    /// Number of open files.
    pub fn files(&self) -> usize {
        fs::read_dir(format!("/proc/{}/fd", self.child.id())).unwrap().count()
    }

    pub fn signal(&self, name: &str) {
        let id = self.child.id().to_string();
        assert!(Command::new("kill").args([&format!("-{name}"), &id]).status().unwrap().success());
    }

    /// Waits for its end; status, standard output and errors.
    pub fn ended(mut self) -> (Option<i32>, String, String, TempDir) {
        let start = Instant::now();
        let status = loop {
            match self.child.try_wait().unwrap() {
                Some(status) => break status,
                None if start.elapsed() > PATIENCE => panic!("it does not end"),
                None => thread::sleep(Duration::from_millis(20)),
            }
        };
        let mut out = String::new();
        self.child.stdout.take().unwrap().read_to_string(&mut out).unwrap();
        self.scribe.take().unwrap().join().unwrap();
        let err = self.log.lock().unwrap().clone();
        let folder = std::mem::replace(&mut self.folder, tempfile::tempdir().unwrap());
        (status.code(), out, err, folder)
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        // Both fail only when it has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A small simulated flight again and again.
pub fn settings(ground: &Ground) -> String {
    format!(
        "source = 'simulate:hover'\nrepeat = true\nlinks = ['{}']\nthreads = 1\n\
         [camera]\nwidth = 160\nheight = 120\nrate = 15\n",
        ground.link()
    )
}
