//! The newest snapshot and picture: the main loop writes, the server reads, neither waits for the other.

use super::snapshot::{PictureView, Snapshot, TrackView};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use std::vec::Vec;

/// Time without a request for a picture after which none is copied any more.
const LOOKING: Duration = Duration::from_secs(3);

/// Shortest time between two pictures.
const PAUSE: Duration = Duration::from_millis(95);

/// Pictures and frames older than this are old.
pub const STALE: Duration = Duration::from_secs(2);

/// A picture and what was followed in it.
#[derive(Debug)]
pub struct Shown {
    /// Counts the pictures, from 1.
    pub number: u64,
    /// The picture; its size is right.
    pub picture: PictureView,
    /// The objects in it.
    pub tracks: Vec<TrackView>,
}

/// The newest snapshot and its ages.
#[derive(Debug)]
pub struct Reading {
    /// The snapshot, without its picture.
    pub snapshot: Arc<Snapshot>,
    /// Since it was published.
    pub age: Duration,
    /// Since number or time of the frames last changed; `None` before the first frame.
    pub frame_age: Option<Duration>,
}

/// The newest snapshot and the newest picture.
#[derive(Debug)]
pub struct Board(Mutex<Posted>);

#[derive(Debug)]
struct Posted {
    snapshot: Arc<Snapshot>,
    published: Instant,
    /// When number or time of the frames last changed.
    frame: Option<Instant>,
    /// The newest picture, and when it came.
    shown: Option<(Arc<Shown>, Instant)>,
    pictures: u64,
    /// Time of the last request for a picture.
    looked: Option<Instant>,
    /// Shortest time until the next picture.
    pause: Duration,
}

impl Default for Board {
    fn default() -> Self {
        Self(Mutex::new(Posted {
            snapshot: Arc::default(),
            published: Instant::now(),
            frame: None,
            shown: None,
            pictures: 0,
            looked: None,
            pause: PAUSE,
        }))
    }
}

impl Board {
    /// Held for a few assignments only: no side waits for the other's work.
    fn newest(&self) -> MutexGuard<'_, Posted> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// See [`super::Preview::publish`].
    pub fn publish(&self, mut snapshot: Snapshot) {
        let now = Instant::now();
        let picture = snapshot.picture.take().filter(PictureView::is_whole);
        let shown = picture.map(|picture| (picture, snapshot.tracks.clone()));
        let mut newest = self.newest();
        let frame = |snapshot: &Snapshot| (snapshot.health.frames, snapshot.time_us);
        if frame(&snapshot) != frame(&newest.snapshot) {
            newest.frame = Some(now);
        }
        let mut old = None;
        if let Some((picture, tracks)) = shown {
            newest.pictures += 1;
            let shown = Shown { number: newest.pictures, picture, tracks };
            old = newest.shown.replace((Arc::new(shown), now));
        }
        let snapshot = std::mem::replace(&mut newest.snapshot, Arc::new(snapshot));
        newest.published = now;
        // Freed after the lock is.
        drop(newest);
        drop((snapshot, old));
    }

    /// See [`super::Preview::wants_picture`].
    pub fn wants_picture(&self) -> bool {
        let newest = self.newest();
        let since = newest.shown.as_ref().map(|(_, at)| at.elapsed());
        newest.looked.is_some_and(|at| at.elapsed() < LOOKING)
            && since.is_none_or(|since| since >= newest.pause)
    }

    /// Newest snapshot, its age and that of its frame.
    pub fn read(&self) -> Reading {
        let newest = self.newest();
        Reading {
            snapshot: newest.snapshot.clone(),
            age: newest.published.elapsed(),
            frame_age: newest.frame.map(|at| at.elapsed()),
        }
    }

    /// The newest picture, if it is not an old one; and from now on somebody looks.
    pub fn look(&self) -> Option<Arc<Shown>> {
        let mut newest = self.newest();
        newest.looked = Some(Instant::now());
        let (shown, at) = newest.shown.as_ref()?;
        (at.elapsed() < STALE).then(|| shown.clone())
    }

    /// Records the time that a picture took to encode: the pause after it is four times that.
    pub fn encoded_in(&self, took: Duration) {
        self.newest().pause = PAUSE.max(took * 4);
    }
}

impl PictureView {
    /// Whether there are as many pixels as its size says, and JPEG can hold them.
    fn is_whole(&self) -> bool {
        let sides = [self.width, self.height];
        sides.iter().all(|side| (1..=65535).contains(side))
            && self.pixels.len() == self.width * self.height
    }
}
