//! Frames that wait for a link's thread.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::vec::Vec;

/// Frames that wait at most: about a second of everything.
pub const WAITING: usize = 128;

/// A frame, and when the picture that it is due to was taken.
pub type Waiting = (Vec<u8>, Option<i64>);

/// A bounded queue of frames. The oldest give way to the newest, and are counted: news is worth more than history.
#[derive(Debug, Default)]
pub struct Queue {
    frames: Mutex<VecDeque<Waiting>>,
    dropped: AtomicU32,
}

impl Queue {
    fn frames(&self) -> MutexGuard<'_, VecDeque<Waiting>> {
        // Nothing panics while it holds the lock, and whole frames stay whole.
        self.frames.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a frame. Never waits for the link.
    pub fn push(&self, frame: &[u8], exposed_us: Option<i64>) {
        let mut frames = self.frames();
        if frames.len() >= WAITING {
            frames.pop_front();
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
        frames.push_back((frame.into(), exposed_us));
    }

    /// The oldest frame.
    pub fn pop(&self) -> Option<Waiting> {
        self.frames().pop_front()
    }

    /// Throws away all frames, as when a link comes back: they are of the past.
    pub fn clear(&self) {
        let mut frames = self.frames();
        self.dropped.fetch_add(frames.len() as u32, Ordering::Relaxed);
        frames.clear();
    }

    /// Frames that were never sent.
    pub fn dropped(&self) -> u32 {
        self.dropped.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_give_way() {
        let queue = Queue::default();
        for i in 0..WAITING + 10 {
            queue.push(&[i as u8], None);
        }
        assert_eq!(queue.dropped(), 10);
        assert_eq!(queue.pop().unwrap().0, [10]);
        queue.clear();
        assert_eq!((queue.pop(), queue.dropped()), (None, (10 + WAITING - 1) as u32));
    }
}
