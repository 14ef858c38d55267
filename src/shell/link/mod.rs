//! Links to autopilots and ground stations: UDP, TCP, serial, several at once.
//!
//! Every link has a thread of its own that connects, reads and writes, and connects again after a failure, with growing
//! pauses; a link that dies takes nothing else down. What is sent goes to all links, or to the one it is meant for; what
//! arrives is not forwarded. Only MAVLink 2 is sent: MAVLink 1 would cut off the frame of OBSTACLE_DISTANCE.

pub mod budget;
pub mod params;
mod queue;
pub mod signing;
pub mod spec;
mod transport;
mod worker;

pub use spec::LinkSpec;

use crate::mavlink::component::{Destination, Outgoing, Trust};
use crate::shell::support::histogram::Histogram;
use budget::Budget;
use crossbeam_channel::{Receiver, Sender, bounded};
use mavlink_core::{MAVLinkMessageRaw, MAVLinkV2MessageRaw, consts};
use signing::Signing;
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;
use std::vec::Vec;
use worker::{Shared, Worker};

/// Frames heard that wait to be taken; more are lost and counted.
const HEARD: usize = 1024;

/// A frame that arrived.
pub struct Inbound {
    /// Index of the link it came over.
    pub link: u8,
    /// When it came, by [`crate::shell::support::clock::now_us`].
    pub time_us: i64,
    /// What its signature is worth.
    pub trust: Trust,
    /// The frame, its checksum right.
    pub frame: MAVLinkMessageRaw,
}

/// How a link fares.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LinkStatus {
    /// Whether it is open. A UDP link is open also while nobody is there.
    pub connected: bool,
    /// How often it was opened.
    pub opened: u32,
    /// When the last frame was heard, by [`crate::shell::support::clock::now_us`].
    pub heard_us: Option<i64>,
    /// Frames given to it.
    pub sent: u32,
    /// Frames left out for its budget.
    pub capped: u32,
    /// Frames that waited too long, or while it was away.
    pub dropped: u32,
    /// Frames heard that found no room.
    pub unheard: u32,
}

struct Link {
    spec: LinkSpec,
    shared: Arc<Shared>,
    budget: Budget,
    /// The next sequence number of each component that speaks.
    sequences: HashMap<u8, u8>,
    sent: u32,
    capped: u32,
    thread: Option<JoinHandle<()>>,
}

/// Opens a link once, and closes it again.
///
/// # Errors
/// The system's reason why it cannot be opened: no permission, no such device, connection refused.
pub fn try_open(spec: &LinkSpec) -> std::io::Result<()> {
    transport::Transport::open(&spec.address).map(drop)
}

/// The open links; dropped, their threads end.
pub struct Links {
    links: Vec<Link>,
    /// Kept, so that the channel lives without links too.
    heard: Sender<Inbound>,
    inbound: Receiver<Inbound>,
    sent: Arc<Mutex<Histogram>>,
    signing: Option<Arc<Mutex<Signing>>>,
    stop: Arc<AtomicBool>,
}

impl Links {
    /// Starts a thread for every link, at most 255. A link that cannot connect yet is tried again and again.
    pub fn open(specs: &[LinkSpec]) -> Self {
        Self::open_signed(specs, None)
    }

    /// The same; with `signing` every frame sent is signed, and those heard are judged by their signatures.
    pub fn open_signed(specs: &[LinkSpec], signing: Option<Signing>) -> Self {
        let (heard, inbound) = bounded(HEARD);
        let signing = signing.map(|signing| Arc::new(Mutex::new(signing)));
        let (stop, sent) = (Arc::default(), Arc::default());
        let mut links = Self { links: Vec::new(), heard, inbound, sent, signing, stop };
        links.start(specs);
        links
    }

    /// Ends these links and starts others in their place; who listens hears those.
    pub fn reopen(&mut self, specs: &[LinkSpec]) {
        self.end();
        self.stop = Arc::default();
        self.start(specs);
    }

    fn start(&mut self, specs: &[LinkSpec]) {
        for (index, spec) in (0..u8::MAX).zip(specs) {
            let shared = Arc::<Shared>::default();
            let worker = Worker {
                index,
                spec: spec.clone(),
                shared: shared.clone(),
                stop: self.stop.clone(),
                signing: self.signing.clone(),
                inbound: self.heard.clone(),
                sent: self.sent.clone(),
            };
            let name = std::format!("link {index}");
            let thread = thread::Builder::new().name(name).spawn(move || worker.run());
            if let Err(error) = &thread {
                tracing::error!("link {spec}: no thread for it: {error}");
            }
            self.links.push(Link {
                spec: spec.clone(),
                shared,
                budget: Budget::new(spec.bytes_per_second),
                sequences: HashMap::new(),
                sent: 0,
                capped: 0,
                thread: thread.ok(),
            });
        }
    }

    /// Sends `message` where it is to go. Never waits for a link: what goes beyond a link's budget is left out unless
    /// urgent, and a full queue loses its oldest frame; both are counted.
    pub fn send(&mut self, message: &Outgoing, now_us: i64) {
        self.send_about(message, now_us, None);
    }

    /// The same for a message about the picture taken at `exposed_us`: see [`Links::latency`]. Gives the frame as the first
    /// link got it.
    pub fn send_about(
        &mut self,
        message: &Outgoing,
        now_us: i64,
        exposed_us: Option<i64>,
    ) -> Option<MAVLinkV2MessageRaw> {
        let mut first = None;
        for (index, link) in (0..u8::MAX).zip(&mut self.links) {
            if !matches!(message.to, Destination::All) && message.to != Destination::Link(index) {
                continue;
            }
            let signature = if self.signing.is_some() { consts::v2::SIGNATURE_SIZE } else { 0 };
            let bytes = message.payload.frame_len() + signature;
            if !link.budget.take(bytes, now_us, message.urgent) {
                link.capped = link.capped.saturating_add(1);
                continue;
            }
            let sequence = link.sequences.entry(message.component_id).or_default();
            let mut frame = message.payload.frame(
                message.system_id,
                message.component_id,
                *sequence,
                self.signing.is_some(),
            );
            if let Some(signing) = &self.signing {
                let mut signing = signing.lock().unwrap_or_else(PoisonError::into_inner);
                if let Err(error) = signing.sign(&mut frame, index, signing::clock()) {
                    tracing::error!("the signing time cannot be kept, nothing is sent: {error}");
                    continue;
                }
            }
            *sequence = sequence.wrapping_add(1);
            link.sent = link.sent.saturating_add(1);
            link.shared.queue.push(frame.raw_bytes(), exposed_us);
            first.get_or_insert(frame);
        }
        first
    }

    /// The next frame that arrived, waiting at most `timeout` for it.
    pub fn receive(&mut self, timeout: Duration) -> Option<Inbound> {
        self.inbound.recv_timeout(timeout).ok()
    }

    /// Where frames that arrived wait, for those who wait for other things too.
    pub fn inbound(&self) -> &Receiver<Inbound> {
        &self.inbound
    }

    /// For others who have frames to be heard, as a simulated vehicle.
    pub fn heard(&self) -> &Sender<Inbound> {
        &self.heard
    }

    /// Times from the exposure of a frame to the last byte sent about it, over all links, in microseconds.
    pub fn latency(&self) -> Histogram {
        self.sent.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The links as they were asked for.
    pub fn specs(&self) -> impl Iterator<Item = &LinkSpec> {
        self.links.iter().map(|link| &link.spec)
    }

    /// How a link fares; nothing of a link there is not.
    pub fn status(&self, link: u8) -> LinkStatus {
        let Some(link) = self.links.get(usize::from(link)) else { return LinkStatus::default() };
        LinkStatus {
            connected: link.shared.connected.load(Ordering::Relaxed),
            opened: link.shared.opened.load(Ordering::Relaxed),
            heard_us: Some(link.shared.heard_us.load(Ordering::Relaxed)).filter(|&us| us != 0),
            sent: link.sent,
            capped: link.capped,
            dropped: link.shared.queue.dropped(),
            unheard: link.shared.unheard.load(Ordering::Relaxed),
        }
    }
}

impl Links {
    fn end(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.links.drain(..).filter_map(|link| link.thread) {
            // A thread that panicked has said so.
            let _ = thread.join();
        }
    }
}

impl Drop for Links {
    fn drop(&mut self) {
        self.end();
    }
}

#[cfg(test)]
mod tests;
