//! A slot for the newest frame: an older one that was not taken is replaced and counted as dropped.

use crate::shell::sources::Frame;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;
use std::vec::Vec;

#[derive(Debug, Default)]
struct MailSlot {
    frame: Option<Arc<Frame>>,
    taken: u64,
}

/// Between the thread that takes frames and the one that looks at them.
#[derive(Debug, Default)]
pub struct Mailbox {
    slot: Mutex<MailSlot>,
    ready: Condvar,
    dropped: AtomicU32,
}

impl Mailbox {
    /// Puts a frame in the place of the one that waits. Never blocks.
    pub fn put(&self, frame: Arc<Frame>) {
        let mut slot = self.slot.lock().unwrap_or_else(PoisonError::into_inner);
        if slot.frame.replace(frame).is_some() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
        drop(slot);
        self.ready.notify_one();
    }

    /// Takes the frame, waiting for it at most `timeout`.
    pub fn take(&self, timeout: Duration) -> Option<Arc<Frame>> {
        let slot = self.slot.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = self.ready.wait_timeout_while(slot, timeout, |slot| slot.frame.is_none());
        let mut slot = waited.unwrap_or_else(PoisonError::into_inner).0;
        slot.taken += u64::from(slot.frame.is_some());
        slot.frame.take()
    }

    /// Whether no frame waits, and `done` of them were taken: nothing is under way.
    pub fn is_drained(&self, done: u64) -> bool {
        let slot = self.slot.lock().unwrap_or_else(PoisonError::into_inner);
        slot.frame.is_none() && slot.taken == done
    }

    /// Counts frames that gave way before they came here.
    pub fn pass_over(&self, frames: u32) {
        self.dropped.fetch_add(frames, Ordering::Relaxed);
    }

    /// Frames that gave way, since the start.
    pub fn dropped(&self) -> u32 {
        self.dropped.load(Ordering::Relaxed)
    }
}

/// Frames' memory, used again when nobody looks at it any more.
#[derive(Debug, Default)]
pub struct Pool {
    frames: Vec<Arc<Frame>>,
}

impl Pool {
    /// A frame that nobody else holds; there are never more than were held at once.
    pub fn take(&mut self) -> Arc<Frame> {
        match self.frames.iter().position(|frame| Arc::strong_count(frame) == 1) {
            Some(free) => self.frames.swap_remove(free),
            None => Arc::default(),
        }
    }

    /// Keeps a frame's memory in mind, whoever else holds it.
    pub fn give(&mut self, frame: Arc<Frame>) {
        self.frames.push(frame);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::thread;

    fn frame(time_us: i64) -> Arc<Frame> {
        Arc::new(Frame { time_us, ..Frame::default() })
    }

    #[test]
    fn the_newest_waits() {
        let mailbox = Mailbox::default();
        assert!(mailbox.take(Duration::ZERO).is_none());
        (1..=5).for_each(|time| mailbox.put(frame(time)));
        assert_eq!(mailbox.take(Duration::ZERO).unwrap().time_us, 5);
        assert_eq!(mailbox.dropped(), 4);
        assert!(mailbox.is_drained(1) && !mailbox.is_drained(0));
        let taken = thread::scope(|scope| {
            let waiting = scope.spawn(|| mailbox.take(Duration::from_secs(10)));
            mailbox.put(frame(6));
            waiting.join().unwrap()
        });
        assert_eq!((taken.unwrap().time_us, mailbox.dropped()), (6, 4));
    }

    #[test]
    fn memory_is_used_again() {
        let mut pool = Pool::default();
        let mut held = Vec::new();
        for round in 0..100 {
            let mut frame = pool.take();
            Arc::get_mut(&mut frame).expect("nobody else holds it").time_us = round;
            held.push(frame.clone());
            pool.give(frame);
            if held.len() > 3 {
                held.remove(0);
            }
        }
        assert_eq!(pool.frames.len(), 4);
    }
}
