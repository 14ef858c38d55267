//! The vehicle's telemetry: a tlog on the host, read frame by frame.

use semihosting::fs::File;
use semihosting::io::{self, Read};

/// The longest frame of MAVLink 2, with a signature.
const LONGEST: usize = 280;

/// The start byte of MAVLink 1.
const VERSION_1: u8 = 0xFE;

/// A log, and its next frame.
pub struct Tlog {
    file: File,
    /// Time of the first frame.
    first_us: i64,
    /// Microseconds after the first frame, and how many bytes are of the frame.
    next: Option<(i64, usize)>,
    bytes: [u8; LONGEST],
}

impl Tlog {
    /// Reads up to the first frame.
    pub fn new(file: File) -> io::Result<Self> {
        let mut log = Self { file, first_us: 0, next: None, bytes: [0; LONGEST] };
        log.advance()?;
        log.first_us = log.next.map_or(0, |(time_us, _)| time_us);
        log.next = log.next.map(|(_, length)| (0, length));
        Ok(log)
    }

    /// Hands the next frame, if it came until `now_us`, to `hear` with its time; whether there was one.
    pub fn due(&mut self, now_us: i64, hear: impl FnOnce(&[u8], i64)) -> io::Result<bool> {
        let Some((time_us, length)) = self.next.filter(|(time_us, _)| *time_us <= now_us) else {
            return Ok(false);
        };
        hear(&self.bytes[..length], time_us);
        self.advance()?;
        Ok(true)
    }

    fn advance(&mut self) -> io::Result<()> {
        let mut time = [0; 8];
        self.next = None;
        if self.file.read(&mut time[..1])? == 0 {
            return Ok(());
        }
        self.file.read_exact(&mut time[1..])?;
        self.file.read_exact(&mut self.bytes[..3])?;
        let [version, length, flags, ..] = self.bytes;
        // Around the payload: header and checksum, in version 2 perhaps a signature.
        let around = match (version, flags & 1) {
            (VERSION_1, _) => 8,
            (_, 0) => 12,
            _ => 25,
        };
        let length = usize::from(length) + around;
        self.file.read_exact(&mut self.bytes[3..length])?;
        self.next = Some((i64::from_be_bytes(time) - self.first_us, length));
        Ok(())
    }
}
