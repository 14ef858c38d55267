//! A thread that writes items of the main loop: on a slow disk or network items are dropped, never frames of the detector.

use crossbeam_channel::{Sender, TrySendError, bounded};
use std::io;
use std::string::String;
use std::thread::{self, JoinHandle};

/// Hands items to a thread over a bounded queue.
#[derive(Debug)]
pub struct Writer<T> {
    name: &'static str,
    items: Option<Sender<T>>,
    thread: Option<JoinHandle<()>>,
    lost: u64,
}

impl<T: Send + 'static> Writer<T> {
    /// Starts the thread, which calls `write` for every item; at most `waiting` items are queued. Of failures in a row the
    /// first is logged.
    ///
    /// # Errors
    /// The system's, where there is no thread.
    pub fn start(
        name: &'static str,
        waiting: usize,
        mut write: impl FnMut(T) -> io::Result<()> + Send + 'static,
    ) -> io::Result<Self> {
        let (items, taken) = bounded(waiting);
        let work = move || {
            let mut failed = false;
            for item in taken {
                match write(item) {
                    Ok(()) => failed = false,
                    Err(error) if !failed => {
                        failed = true;
                        tracing::error!("{name}: cannot write: {error}; what was written stays");
                    }
                    Err(_) => {}
                }
            }
        };
        let thread = thread::Builder::new().name(String::from(name)).spawn(work)?;
        Ok(Self { name, items: Some(items), thread: Some(thread), lost: 0 })
    }

    /// Queues an item; `false` where the queue is full and the item is lost.
    pub fn hand(&mut self, item: T) -> bool {
        let Some(items) = &self.items else { return false };
        match items.try_send(item) {
            Ok(()) => true,
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => {
                self.lost += 1;
                if self.lost.is_power_of_two() {
                    tracing::warn!("{}: written too slowly, {} lost", self.name, self.lost);
                }
                false
            }
        }
    }
}

impl<T> Drop for Writer<T> {
    /// Waits until everything is written.
    fn drop(&mut self) {
        self.items = None;
        if let Some(thread) = self.thread.take() {
            // A panic of it has ended the program.
            let _ = thread.join();
        }
    }
}
