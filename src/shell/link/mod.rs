//! Links to autopilots and ground stations: UDP, TCP, serial, several at once.
//!
//! Every link has a thread of its own that connects, reads and writes, and connects again after a failure, with growing
//! pauses; a link that fails affects no other. A message goes to all links or to one of them; received frames are not
//! forwarded. Only MAVLink 2 is sent: MAVLink 1 would cut off the frame of OBSTACLE_DISTANCE.

pub mod budget;
pub mod params;
mod queue;
pub mod signing;
pub mod spec;
pub(in crate::shell) mod transport;
mod worker;

pub use spec::LinkSpec;

use crate::mavlink::component::{Destination, Outgoing, Trust};
use crate::shell::support::histogram::Histogram;
use budget::Budget;
use crossbeam_channel::{Receiver, Sender, bounded};
use mavlink_core::{MAVLinkMessageRaw, MAVLinkV2MessageRaw, consts};
use signing::Signing;
use std::collections::HashMap;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use std::vec::Vec;
use worker::{LinkShared, Worker};

/// Received frames that wait for the main loop at most; more are dropped and counted.
const HEARD: usize = 1024;

/// A frame that arrived.
pub struct Inbound {
    /// Index of the link it came over.
    pub link: u8,
    /// Time of arrival, microseconds of [`crate::shell::support::clock::now_us`].
    pub time_us: i64,
    /// Result of the check of its signature.
    pub trust: Trust,
    /// The frame, its checksum right.
    pub frame: MAVLinkMessageRaw,
}

/// Statistics of a link since the start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LinkStatus {
    /// Whether it is open. A UDP link is open also while nobody answers: see `heard_us`.
    pub connected: bool,
    /// Number of times it was opened.
    pub opened: u32,
    /// Time of the last frame that was accepted, microseconds of [`crate::shell::support::clock::now_us`].
    pub heard_us: Option<i64>,
    /// Frames queued to be sent.
    pub sent: u32,
    /// Frames left out because they exceeded its bandwidth.
    pub capped: u32,
    /// Frames dropped from its queue, because it was too slow or closed.
    pub dropped: u32,
    /// Received frames dropped because the main loop was too slow.
    pub unheard: u32,
}

struct OpenLink {
    spec: LinkSpec,
    shared: Arc<LinkShared>,
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
    links: Vec<OpenLink>,
    /// Kept, so that the channel lives without links too.
    heard: Sender<Inbound>,
    inbound: Receiver<Inbound>,
    sent: Arc<Mutex<Histogram>>,
    signing: Option<Arc<Mutex<Signing>>>,
}

/// Timeout for the end of the links' threads; one that looks up a name is left to itself.
const END: Duration = Duration::from_secs(1);

impl Links {
    /// Starts a thread for every link, at most 255. A link that cannot connect tries again until it is dropped.
    pub fn open(specs: &[LinkSpec]) -> Self {
        Self::open_signed(specs, None)
    }

    /// The same; with `signing` every frame that is sent is signed, and the signature of every received one is checked.
    pub fn open_signed(specs: &[LinkSpec], signing: Option<Signing>) -> Self {
        let (heard, inbound) = bounded(HEARD);
        let signing = signing.map(|signing| Arc::new(Mutex::new(signing)));
        let mut links = Self { links: Vec::new(), heard, inbound, sent: Arc::default(), signing };
        links.reopen(specs);
        links
    }

    /// Replaces the links by those of `specs`; a link that stays the same goes on undisturbed. Waits for nothing: the
    /// threads of links that are gone end by themselves, and a new link that needs their port tries until it is free.
    pub fn reopen(&mut self, specs: &[LinkSpec]) {
        let mut before: Vec<_> = self.links.drain(..).map(Some).collect();
        for (index, spec) in (0..u8::MAX).zip(specs) {
            let place = before.get_mut(usize::from(index));
            let same = place.and_then(|link| link.take_if(|link| link.spec == *spec));
            let link = same.unwrap_or_else(|| self.start(index, spec));
            self.links.push(link);
        }
        for link in before.into_iter().flatten() {
            link.shared.stop.store(true, Ordering::Relaxed);
        }
    }

    fn start(&self, index: u8, spec: &LinkSpec) -> OpenLink {
        let shared = Arc::<LinkShared>::default();
        let worker = Worker {
            index,
            spec: spec.clone(),
            shared: shared.clone(),
            signing: self.signing.clone(),
            inbound: self.heard.clone(),
            sent: self.sent.clone(),
        };
        let name = std::format!("link {index}");
        let thread = thread::Builder::new().name(name).spawn(move || worker.run());
        if let Err(error) = &thread {
            tracing::error!("link {spec}: no thread for it: {error}");
        }
        OpenLink {
            spec: spec.clone(),
            shared,
            budget: Budget::new(spec.bytes_per_second),
            sequences: HashMap::new(),
            sent: 0,
            capped: 0,
            thread: thread.ok(),
        }
    }

    /// Sends `message` to its destination. Never waits for a link: what exceeds a link's [`Budget`] is left out, and a full
    /// queue loses its oldest frame; both are counted.
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
            if !link.budget.take(bytes, now_us, message.priority) {
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
                signing.sign(&mut frame, index, signing::clock());
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

    /// Receiver of inbound frames, for `select!`.
    pub fn inbound(&self) -> &Receiver<Inbound> {
        &self.inbound
    }

    /// Sender of inbound frames that come from no link, as those of a simulated vehicle.
    pub fn heard(&self) -> &Sender<Inbound> {
        &self.heard
    }

    /// Times from the exposure of a frame to the last byte sent about it, over all links, in microseconds.
    pub fn latency(&self) -> Histogram {
        self.sent.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Whether frames are signed with times that cannot be kept over a restart.
    pub fn is_signing_time_lost(&self) -> bool {
        self.signing.as_ref().is_some_and(|signing| {
            signing.lock().unwrap_or_else(PoisonError::into_inner).is_failing()
        })
    }

    /// Whether a rightly signed frame was refused since the last call because its time is more than a day ahead.
    pub fn take_refused_future(&self) -> bool {
        self.signing.as_ref().is_some_and(|signing| {
            signing.lock().unwrap_or_else(PoisonError::into_inner).take_refused_future()
        })
    }

    /// Specifications of the links, in the order of their indices.
    pub fn specs(&self) -> impl Iterator<Item = &LinkSpec> {
        self.links.iter().map(|link| &link.spec)
    }

    /// Statistics of the link of this index; zeros if there is none.
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

impl Drop for Links {
    fn drop(&mut self) {
        for link in &self.links {
            link.shared.stop.store(true, Ordering::Relaxed);
        }
        let until = Instant::now() + END;
        for thread in self.links.drain(..).filter_map(|link| link.thread) {
            while !thread.is_finished() && Instant::now() < until {
                thread::sleep(Duration::from_millis(2));
            }
        }
    }
}

#[cfg(test)]
mod tests;
