//! A small file that always holds the newest state, written by a thread of its own: whoever changes the state never
//! waits for a disk.

use super::atomic_file;
use std::io;
use std::path::Path;
use std::string::String;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;
use std::vec::Vec;

/// Time from a failed write to the next attempt.
const AGAIN: Duration = Duration::from_secs(1);

#[derive(Debug, Default)]
struct Pending {
    /// The newest content that is not written yet, and its mark.
    content: Option<(Vec<u8>, u64)>,
    end: bool,
}

#[derive(Debug, Default)]
struct KeeperShared {
    pending: Mutex<Pending>,
    changed: Condvar,
    kept: AtomicU64,
    failing: AtomicBool,
}

/// A file that a thread of its own writes, whole at any time.
#[derive(Debug)]
pub struct Keeper {
    shared: Arc<KeeperShared>,
    thread: Option<JoinHandle<()>>,
}

impl Keeper {
    /// Starts the thread that writes `path`.
    ///
    /// # Errors
    /// The system's, where there is no thread.
    pub fn start(path: &Path) -> io::Result<Self> {
        let shared = Arc::<KeeperShared>::default();
        let work = {
            let (shared, path) = (shared.clone(), path.to_path_buf());
            move || shared.write(&path)
        };
        let thread = thread::Builder::new().name(String::from("keeper")).spawn(work)?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// Writes `content` in the place of what waits to be written. `mark` names it in [`Keeper::kept`].
    pub fn keep(&self, content: Vec<u8>, mark: u64) {
        let mut pending = self.shared.pending.lock().unwrap_or_else(PoisonError::into_inner);
        pending.content = Some((content, mark));
        drop(pending);
        self.shared.changed.notify_one();
    }

    /// The mark of what was written last; 0 before.
    pub fn kept(&self) -> u64 {
        self.shared.kept.load(Ordering::Relaxed)
    }

    /// Whether the last attempt to write failed; there is another one every second.
    pub fn is_failing(&self) -> bool {
        self.shared.failing.load(Ordering::Relaxed)
    }
}

impl KeeperShared {
    fn write(&self, path: &Path) {
        let mut pending = self.pending.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            let Some((content, mark)) = pending.content.take() else {
                if pending.end {
                    return;
                }
                pending = self.changed.wait(pending).unwrap_or_else(PoisonError::into_inner);
                continue;
            };
            drop(pending);
            let written = atomic_file::write(path, &content);
            let failing = written.is_err();
            match (written, self.failing.swap(failing, Ordering::Relaxed)) {
                (Ok(()), before) => {
                    self.kept.store(mark, Ordering::Relaxed);
                    if before {
                        tracing::info!("{}: written again", path.display());
                    }
                }
                (Err(error), false) => tracing::error!("{}: cannot write: {error}", path.display()),
                (Err(_), true) => {}
            }
            pending = self.pending.lock().unwrap_or_else(PoisonError::into_inner);
            if failing {
                if pending.end {
                    return;
                }
                pending.content.get_or_insert((content, mark));
                let waited = self.changed.wait_timeout(pending, AGAIN);
                pending = waited.unwrap_or_else(PoisonError::into_inner).0;
            }
        }
    }
}

impl Drop for Keeper {
    /// Waits until the newest content is written, or an attempt failed.
    fn drop(&mut self) {
        self.shared.pending.lock().unwrap_or_else(PoisonError::into_inner).end = true;
        self.shared.changed.notify_one();
        if let Some(thread) = self.thread.take() {
            // A panic of it has ended the program.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::time::Instant;

    #[test]
    fn the_newest_is_kept_and_a_failure_is_tried_again() {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("missing");
        let file = place.join("state");
        let keeper = Keeper::start(&file).unwrap();
        let start = Instant::now();
        let eventually = |holds: &dyn Fn() -> bool| {
            while !holds() {
                assert!(start.elapsed() < Duration::from_secs(20));
                thread::sleep(Duration::from_millis(5));
            }
        };
        keeper.keep(b"one".into(), 1);
        eventually(&|| keeper.is_failing());
        assert_eq!(keeper.kept(), 0);
        fs::create_dir(&place).unwrap();
        eventually(&|| keeper.kept() == 1 && !keeper.is_failing());
        for mark in 2..=100u64 {
            keeper.keep(std::format!("{mark}").into_bytes(), mark);
        }
        drop(keeper);
        assert_eq!(fs::read(&file).unwrap(), b"100");
    }
}
