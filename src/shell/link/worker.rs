//! The thread of one link.

use super::queue::{Queue, WAITING};
use super::signing::{self, Signing};
use super::transport::Transport;
use super::{Inbound, LinkSpec};
use crate::mavlink::component::Trust;
use crate::shell::support::clock::now_us;
use crate::shell::support::histogram::Histogram;
use crate::shell::support::repeats::Repeats;
use crossbeam_channel::Sender;
use mavlink_core::MAVLinkMessageRaw;
use std::format;
use std::io;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// The first wait before a link is opened again; it doubles up to the last, so that one that is back is used within two
/// seconds.
const FIRST_WAIT: Duration = Duration::from_millis(200);
const LAST_WAIT: Duration = Duration::from_secs(1);

/// Time after which a link that held starts with the first wait again.
const HELD: Duration = Duration::from_secs(5);

/// Reads before frames are written again, and how long they may take; both bound what input that never pauses can do.
/// Input beyond 8 reads of 4 kB in 10 ms, 3 MB/s, has to wait.
const READS: usize = 8;
const TURN: Duration = Duration::from_millis(10);

/// State that a link's thread shares with the sending side.
#[derive(Debug, Default)]
pub struct LinkShared {
    /// Frames to be sent.
    pub queue: Queue,
    /// Whether the link is to end.
    pub stop: AtomicBool,
    /// Whether the link is open.
    pub connected: AtomicBool,
    /// Time of the last frame received; 0: none yet.
    pub heard_us: AtomicI64,
    /// Received frames dropped for want of room.
    pub unheard: AtomicU32,
    /// Number of times that the link was opened.
    pub opened: AtomicU32,
}

/// Thread that reads from and writes to one link.
pub struct Worker {
    pub index: u8,
    pub spec: LinkSpec,
    pub shared: Arc<LinkShared>,
    pub signing: Option<Arc<Mutex<Signing>>>,
    pub inbound: Sender<Inbound>,
    pub sent: Arc<Mutex<Histogram>>,
}

impl Worker {
    /// Opens the link, serves it, opens it again, until it is to stop.
    pub fn run(self) {
        let mut wait = FIRST_WAIT;
        let mut said = Repeats::default();
        while !self.stopped() {
            let start = Instant::now();
            let error = match Transport::open(&self.spec.address) {
                Ok(transport) => {
                    tracing::info!("link {}: open", self.spec);
                    // Frames that waited are out of date.
                    self.shared.queue.clear();
                    self.shared.opened.fetch_add(1, Ordering::Relaxed);
                    self.shared.connected.store(true, Ordering::Relaxed);
                    let error = self.serve(transport);
                    self.shared.connected.store(false, Ordering::Relaxed);
                    error
                }
                Err(error) => error,
            };
            if self.stopped() {
                return;
            }
            if start.elapsed() > HELD {
                wait = FIRST_WAIT;
                said.forget();
            }
            let text = format!("link {}: {error}", self.spec);
            if said.is_news(&text, Instant::now()) {
                tracing::warn!("{text}; tried again until it opens");
            }
            let until = Instant::now() + wait;
            while Instant::now() < until && !self.stopped() {
                thread::sleep(Duration::from_millis(20));
            }
            wait = (wait * 2).min(LAST_WAIT);
        }
    }

    fn stopped(&self) -> bool {
        self.shared.stop.load(Ordering::Relaxed)
    }

    /// Reads and writes in turns until something fails. What is to be sent when the link ends is still sent.
    fn serve(&self, mut transport: Transport) -> io::Error {
        while !self.stopped() {
            if let Err(error) = self.read(&mut transport).and_then(|()| self.write(&mut transport))
            {
                return error;
            }
        }
        let last = self.write(&mut transport);
        last.err().unwrap_or(io::ErrorKind::ConnectionAborted.into())
    }

    fn read(&self, transport: &mut Transport) -> io::Result<()> {
        let start = Instant::now();
        for _ in 0..READS {
            if !transport.receive(&mut |frame| self.accept(frame))? {
                return Ok(());
            }
            if start.elapsed() >= TURN {
                return Ok(());
            }
        }
        thread::sleep(TURN.saturating_sub(start.elapsed()));
        Ok(())
    }

    /// Hands a frame over; `false` where its signature is wrong or missing.
    fn accept(&self, frame: MAVLinkMessageRaw) -> bool {
        let trust = match &self.signing {
            None => Trust::Open,
            Some(signing) => signing
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .verify(&frame, signing::clock()),
        };
        let good = matches!(trust, Trust::Open | Trust::Signed);
        let time_us = now_us();
        if good {
            self.shared.heard_us.store(time_us, Ordering::Relaxed);
        }
        let heard = Inbound { link: self.index, time_us, trust, frame };
        if self.inbound.try_send(heard).is_err() {
            self.shared.unheard.fetch_add(1, Ordering::Relaxed);
        }
        good
    }

    fn write(&self, transport: &mut Transport) -> io::Result<()> {
        for _ in 0..WAITING {
            let Some((frame, exposed_us)) = self.shared.queue.pop() else { break };
            transport.send(&frame)?;
            if let Some(exposed_us) = exposed_us {
                let mut sent = self.sent.lock().unwrap_or_else(PoisonError::into_inner);
                sent.add(now_us() - exposed_us);
            }
        }
        Ok(())
    }
}
