//! The thread of one link.

use super::queue::Queue;
use super::signing::{self, Signing};
use super::transport::{Transport, is_idle};
use super::{Inbound, LinkSpec};
use crate::mavlink::component::Trust;
use crate::mavlink::dialect::Frames;
use crate::shell::support::clock::now_us;
use crate::shell::support::histogram::Histogram;
use crossbeam_channel::Sender;
use mavlink_core::MavlinkReader;
use mavlink_core::error::MessageReadError;
use std::io;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// The first wait before a link is opened again; it doubles up to the last.
const FIRST_WAIT: Duration = Duration::from_millis(200);
const LAST_WAIT: Duration = Duration::from_secs(5);

/// A link that held so long starts with the first wait again.
const HELD: Duration = Duration::from_secs(5);

/// Frames read before it is looked whether any are to be written.
const READS: usize = 32;

/// What a link's thread shares with those who send.
#[derive(Debug, Default)]
pub struct Shared {
    /// What is to be sent.
    pub queue: Queue,
    /// Whether the link is open.
    pub connected: AtomicBool,
    /// When the last frame was heard; 0: none yet.
    pub heard_us: AtomicI64,
    /// Frames heard that found no room.
    pub unheard: AtomicU32,
    /// How often the link was opened.
    pub opened: AtomicU32,
}

/// A link's thread.
pub struct Worker {
    pub index: u8,
    pub spec: LinkSpec,
    pub shared: Arc<Shared>,
    pub stop: Arc<AtomicBool>,
    pub signing: Option<Arc<Mutex<Signing>>>,
    pub inbound: Sender<Inbound>,
    pub sent: Arc<Mutex<Histogram>>,
}

impl Worker {
    /// Opens the link, serves it, opens it again, until it is to stop.
    pub fn run(self) {
        let mut wait = FIRST_WAIT;
        while !self.stopped() {
            let start = Instant::now();
            let error = match Transport::open(&self.spec.address) {
                Ok(transport) => {
                    tracing::info!("link {}: open", self.spec);
                    // What waited is of the past.
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
            }
            tracing::warn!("link {}: {error}; again in {} ms", self.spec, wait.as_millis());
            let until = Instant::now() + wait;
            while Instant::now() < until && !self.stopped() {
                thread::sleep(Duration::from_millis(20));
            }
            wait = (wait * 2).min(LAST_WAIT);
        }
    }

    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Reads and writes until something fails.
    fn serve(&self, transport: Transport) -> io::Error {
        let mut reader = MavlinkReader::new(transport);
        loop {
            for _ in 0..READS {
                match reader.read_any_raw_message_with_dialect(&Frames) {
                    Ok(frame) => {
                        let trust = match &self.signing {
                            None => Trust::Open,
                            Some(signing) => signing
                                .lock()
                                .unwrap_or_else(PoisonError::into_inner)
                                .verify(&frame, signing::clock()),
                        };
                        let time_us = now_us();
                        self.shared.heard_us.store(time_us, Ordering::Relaxed);
                        let heard = Inbound { link: self.index, time_us, trust, frame };
                        if self.inbound.try_send(heard).is_err() {
                            self.shared.unheard.fetch_add(1, Ordering::Relaxed);
                        }
                    }
                    Err(MessageReadError::Io(error)) if is_idle(&error) => break,
                    Err(MessageReadError::Io(error)) => return error,
                    // Raw frames are not parsed.
                    Err(MessageReadError::Parse(_)) => break,
                }
            }
            while let Some((frame, exposed_us)) = self.shared.queue.pop() {
                if let Err(error) = reader.get_mut().send(&frame) {
                    return error;
                }
                if let Some(exposed_us) = exposed_us {
                    let mut sent = self.sent.lock().unwrap_or_else(PoisonError::into_inner);
                    sent.add(now_us() - exposed_us);
                }
            }
            if self.stopped() {
                return io::ErrorKind::ConnectionAborted.into();
            }
        }
    }
}
