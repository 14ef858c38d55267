//! A live lookout in a test: a camera that is drawn, faults at will, and somebody on the ground who listens.

use super::golden;
use lookout::mavlink::dialect::{HEARTBEAT_DATA, MavMessage};
use lookout::shell::live::config::ServiceConfig;
use lookout::shell::live::service;
use lookout::shell::live::source::{CaptureInfo, LiveError, LiveSource, OpenSource};
use lookout::shell::live::summary::ServiceSummary;
use lookout::shell::sources::Frame;
use lookout::shell::support::clock::now_us;
use lookout::shell::support::interrupt::ServiceOrders;
use mavlink_core::{MAVLinkV2MessageRaw, MavlinkVersion, Message};
use std::fs;
use std::net::{SocketAddr, UdpSocket};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, AtomicU32, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// How long anything may take on a busy machine.
pub const PATIENCE: Duration = Duration::from_secs(30);

/// The hand-made model in a file.
pub const MODEL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/common/golden.lkm");

/// A camera that sees [`golden::draw`]'s ground.
pub struct Drawn {
    pub size: (usize, usize),
    pub period: Duration,
    number: Arc<AtomicU32>,
    /// It ends after so many frames.
    pub frames: u32,
}

impl LiveSource for Drawn {
    fn next(&mut self, frame: &mut Frame, _: Duration) -> Result<CaptureInfo, LiveError> {
        let number = self.number.fetch_add(1, Ordering::Relaxed);
        if number >= self.frames {
            return Err(LiveError::Ended);
        }
        thread::sleep(self.period);
        (frame.width, frame.height) = self.size;
        frame.pixels.resize(self.size.0 * self.size.1, 0);
        // The ground passes by for ever; its numbers stay small.
        golden::draw(number % 4096, self.size.0, &mut frame.pixels);
        frame.time_us = now_us();
        Ok(CaptureInfo::default())
    }
}

/// Faults of a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Fault {
    None,
    /// The lens is covered.
    Dark,
    /// The sun.
    White,
    /// The same picture again and again.
    Frozen,
    /// Out of focus.
    Blurred,
    /// Its cable is pulled.
    Unplugged,
    /// It is there, and gives nothing.
    Silent,
}

/// Lets things go wrong, from outside.
#[derive(Debug, Clone, Default)]
pub struct Faults(Arc<AtomicU8>);

impl Faults {
    pub fn set(&self, fault: Fault) {
        self.0.store(fault as u8, Ordering::Relaxed);
    }

    pub fn is(&self, fault: Fault) -> bool {
        self.0.load(Ordering::Relaxed) == fault as u8
    }
}

/// A source in which things go wrong.
pub struct FaultInjector<S> {
    pub source: S,
    pub faults: Faults,
    pub last: Vec<u8>,
}

impl<S: LiveSource> LiveSource for FaultInjector<S> {
    fn next(&mut self, frame: &mut Frame, timeout: Duration) -> Result<CaptureInfo, LiveError> {
        if self.faults.is(Fault::Unplugged) {
            return Err(LiveError::Gone("the cable is pulled".into()));
        }
        if self.faults.is(Fault::Silent) {
            thread::sleep(timeout);
            return Err(LiveError::Timeout);
        }
        let taken = self.source.next(frame, timeout)?;
        let (width, noise) = (frame.width, frame.time_us as u8 % 3);
        if self.faults.is(Fault::Frozen) && self.last.len() == frame.pixels.len() {
            frame.pixels.copy_from_slice(&self.last);
        } else if self.faults.is(Fault::Dark) {
            frame.pixels.iter_mut().for_each(|pixel| *pixel = noise + *pixel / 64);
        } else if self.faults.is(Fault::White) {
            frame.pixels.iter_mut().for_each(|pixel| *pixel = 255 - noise - *pixel / 128);
        } else if self.faults.is(Fault::Blurred) {
            // Wide edges, and nothing else.
            for (place, pixel) in frame.pixels.iter_mut().enumerate() {
                let ramp = (place % width + place / width + usize::from(noise)) % 80;
                *pixel = 60 + 3 * ramp.min(80 - ramp) as u8;
            }
        }
        self.last.clone_from(&frame.pixels);
        Ok(taken)
    }
}

/// Somebody who listens at a socket.
pub struct Ground {
    pub socket: UdpSocket,
    /// Where the last message came from.
    pub from: Option<SocketAddr>,
    /// Everything heard, and when.
    pub heard: Vec<(Instant, Vec<u8>, MavMessage)>,
}

impl Default for Ground {
    fn default() -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
        Self { socket, from: None, heard: Vec::new() }
    }
}

impl Ground {
    /// The link that leads here.
    pub fn link(&self) -> String {
        format!("udpout:{}", self.socket.local_addr().unwrap())
    }

    /// Hears the next message, if one comes soon.
    pub fn hear(&mut self) -> Option<&MavMessage> {
        let mut buffer = [0; 300];
        let (length, from) = self.socket.recv_from(&mut buffer).ok()?;
        self.from = Some(from);
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.as_mut_slice()[..length].copy_from_slice(&buffer[..length]);
        assert!(raw.has_valid_crc::<MavMessage>(), "{:?}", &buffer[..length]);
        let message = MavMessage::parse(MavlinkVersion::V2, raw.message_id(), raw.payload());
        self.heard.push((Instant::now(), buffer[..length].to_vec(), message.unwrap()));
        self.heard.last().map(|heard| &heard.2)
    }

    /// Hears what has arrived, without waiting.
    pub fn drain(&mut self) {
        self.socket.set_nonblocking(true).unwrap();
        while self.hear().is_some() {}
        self.socket.set_nonblocking(false).unwrap();
    }

    /// Waits for a message.
    pub fn wait(&mut self, what: &str, wanted: impl Fn(&MavMessage) -> bool) -> MavMessage {
        let start = Instant::now();
        while start.elapsed() < PATIENCE {
            if let Some(message) = self.hear().filter(|message| wanted(message)) {
                return message.clone();
            }
        }
        let heard: Vec<_> = self.heard.iter().rev().take(9).map(|heard| &heard.2).collect();
        panic!("{what} did not come; the last were {heard:#?}");
    }

    /// Waits for a heartbeat of this state and these reasons to be blind.
    pub fn wait_state(&mut self, status: u8, blind: u32) -> HEARTBEAT_DATA {
        let wanted =
            |data: &HEARTBEAT_DATA| (data.system_status as u8, data.custom_mode) == (status, blind);
        let what = format!("heartbeat of state {status}, blind {blind}");
        match self.wait(&what, |m| matches!(m, MavMessage::HEARTBEAT(data) if wanted(data))) {
            MavMessage::HEARTBEAT(data) => data,
            _ => unreachable!(),
        }
    }

    /// Listens for some time; the heartbeats heard, and the longest time without one.
    pub fn beats(&mut self, time: Duration) -> (usize, Duration) {
        let start = Instant::now();
        let (mut count, mut last, mut longest) = (0, start, Duration::ZERO);
        while start.elapsed() < time {
            if let Some(MavMessage::HEARTBEAT(_)) = self.hear() {
                count += 1;
                longest = longest.max(last.elapsed());
                last = Instant::now();
            }
        }
        (count, longest.max(last.elapsed()))
    }

    /// By how much the age of messages varied that bear a time, from the one heard as number `from` on: one that waited
    /// somewhere, as in the queue of a link, is older than the others.
    pub fn spread(&self, from: usize) -> Duration {
        let start = self.heard.first().map(|heard| heard.0);
        let ages = self.heard[from..].iter().filter_map(|(time, _, message)| match message {
            MavMessage::NAMED_VALUE_FLOAT(value) => {
                let heard = time.duration_since(start?).as_millis() as i64;
                Some(heard - i64::from(value.time_boot_ms))
            }
            _ => None,
        });
        let (least, most) = ages.fold((i64::MAX, i64::MIN), |(a, b), age| (a.min(age), b.max(age)));
        Duration::from_millis(most.saturating_sub(least).max(0) as u64)
    }

    /// Waits for a text with these words.
    pub fn wait_text(&mut self, words: &str) -> String {
        let text = |message: &MavMessage| match message {
            MavMessage::STATUSTEXT(data) => data.text.to_str().unwrap().to_owned(),
            _ => String::new(),
        };
        let message = self.wait(words, |message| text(message).contains(words));
        text(&message)
    }
}

/// MAV_STATE.
pub const ACTIVE: u8 = 4;
pub const CRITICAL: u8 = 5;

/// A lookout under way in this process.
pub struct Run {
    pub control: ServiceOrders,
    pub faults: Faults,
    thread: JoinHandle<Result<ServiceSummary, String>>,
}

/// A camera that is drawn, with faults at will; reopened it goes on where it was.
pub fn drawn(
    size: (usize, usize),
    period: Duration,
    frames: u32,
    faults: &Faults,
) -> Box<OpenSource> {
    let (number, faults) = (Arc::<AtomicU32>::default(), faults.clone());
    Box::new(move |_, _| {
        if faults.is(Fault::Unplugged) {
            return Err(LiveError::Gone("nothing is plugged in".into()));
        }
        let source = Drawn { size, period, number: number.clone(), frames };
        Ok(Box::new(FaultInjector { source, faults: faults.clone(), last: vec![] }))
    })
}

impl Run {
    /// Starts with these settings and that source.
    pub fn start(text: &str, open: Box<OpenSource>, faults: Faults) -> Self {
        let path = PathBuf::from("test.toml");
        let config =
            ServiceConfig::parse(&path, &format!("source = 'v4l2:drawn'\n{text}")).unwrap();
        let control = ServiceOrders::default();
        let orders = control.clone();
        let thread = thread::spawn(move || {
            let reread = || Ok(config.clone());
            service::run(config.clone(), &reread, &orders, &*open).map_err(|e| e.to_string())
        });
        Self { control, faults, thread }
    }

    /// Tells it to end.
    pub fn stop(self) -> ServiceSummary {
        self.control.stop.store(true, Ordering::Relaxed);
        self.ended()
    }

    /// Whether it has ended.
    pub fn is_finished(&self) -> bool {
        self.thread.is_finished()
    }

    /// Whether it ended by a panic; waits for its end.
    pub fn panicked(self) -> bool {
        self.thread.join().is_err()
    }

    /// Waits for its own end.
    pub fn ended(self) -> ServiceSummary {
        self.thread.join().unwrap().unwrap()
    }
}

/// Folders and files in a folder, by name, without hidden ones.
pub fn listed(folder: &Path) -> Vec<PathBuf> {
    let hidden = |path: &Path| path.file_name().unwrap().as_encoded_bytes().starts_with(b".");
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut entries: Vec<_> = entries.filter(|path| !hidden(path)).collect();
    entries.sort();
    entries
}
