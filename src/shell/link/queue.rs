//! Queue of frames to be sent over one link.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::vec::Vec;

/// Capacity in frames: about a second of all messages.
pub const WAITING: usize = 128;

/// A frame, and the exposure time of the picture that it is about, in microseconds.
pub type Waiting = (Vec<u8>, Option<i64>);

/// A bounded queue of frames. Where it is full the oldest frame is dropped and counted: the newest is the most useful.
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

    /// Adds a frame; never blocks.
    pub fn push(&self, frame: &[u8], exposed_us: Option<i64>) {
        let mut frames = self.frames();
        if frames.len() >= WAITING {
            frames.pop_front();
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
        frames.push_back((frame.into(), exposed_us));
    }

    /// Takes the oldest frame.
    pub fn pop(&self) -> Option<Waiting> {
        self.frames().pop_front()
    }

    /// Drops all frames, as when a link is opened again: they are out of date.
    pub fn clear(&self) {
        let mut frames = self.frames();
        let dropped = u32::try_from(frames.len()).unwrap_or(u32::MAX);
        self.dropped.fetch_add(dropped, Ordering::Relaxed);
        frames.clear();
    }

    /// Frames dropped since the start.
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
