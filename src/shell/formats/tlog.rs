//! Telemetry logs (.tlog), as ground stations write them: for every message the time of its receipt, 8 bytes
//! big-endian in microseconds since 1970, then the MAVLink frame (v1 or v2) as it was on the link.
//!
//! Source of the form: MAVProxy, `mavproxy.py`, `struct.pack('>Q', usec) + m.get_msgbuf()`. MAVProxy keeps the number
//! of the link in the two lowest bits of the time, so a time is true to 4 microseconds.
//!
//! A log may be damaged: a cut end, holes, other bytes between. A record counts where a checksum holds, in search of
//! the next one every byte is tried. Times in another byte order or unit are refused; a clock that was set while the log
//! was written is the matter of `timeline`.

use crate::mavlink::dialect::{ArduPilotFrames, MavMessage};
use mavlink_core::consts::{self, MAX_FRAME_SIZE};
use mavlink_core::error::ParserError;
use mavlink_core::{
    MAV_STX, MAV_STX_V2, MAVLinkMessageRaw, MAVLinkV1MessageRaw, MAVLinkV2MessageRaw, MavHeader,
    Message,
};
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::vec::Vec;

/// Bytes of a time.
const TIME_SIZE: usize = 8;
/// Bytes of the shortest record: a v1 frame without payload.
const SHORTEST: usize =
    TIME_SIZE + consts::STX_SIZE + consts::v1::HEADER_SIZE + consts::CHECKSUM_SIZE;
/// Bytes of the longest.
const LONGEST: usize = TIME_SIZE + MAX_FRAME_SIZE;
/// Bytes read at once.
const BLOCK: usize = 64 * 1024;
/// Times from here on are none: the year 2200, microseconds.
const TIME_END: u64 = 7_258_118_400_000_000;
/// Times of day of a log are later than this: the year 2000, microseconds.
const TIME_START: u64 = 946_684_800_000_000;
/// After a damaged place a time counts only if it is no further than this from the last one: a day, microseconds; or if
/// the record that follows is near.
const TIME_STEP: u64 = 86_400_000_000;
/// Records that follow one another are no further apart than this: a minute, microseconds.
const NEXT_STEP: u64 = 60_000_000;
/// Records at the start of a log by which the unit of its times is checked.
const CHECKED: usize = 64;

/// A message and when it was received.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Record {
    /// Microseconds since 1970, 0 or more.
    pub time_us: i64,
    /// Where the record begins in the log, bytes.
    pub offset: u64,
    /// A whole frame whose checksum holds, from its first byte (0xFD or 0xFE) to its last.
    pub frame: heapless::Vec<u8, MAX_FRAME_SIZE>,
}

impl Record {
    /// The frame as the crate `mavlink` holds it.
    pub fn raw(&self) -> MAVLinkMessageRaw {
        raw(&self.frame).unwrap_or(MAVLinkMessageRaw::V2(MAVLinkV2MessageRaw::new()))
    }

    /// The message.
    ///
    /// # Errors
    /// [`ParserError`] where the checksum holds, but the dialect ardupilotmega does not know the message or one of its
    /// values.
    pub fn message(&self) -> Result<(MavHeader, MavMessage), ParserError> {
        let raw = self.raw();
        let header = MavHeader {
            system_id: raw.system_id(),
            component_id: raw.component_id(),
            sequence: raw.sequence(),
        };
        MavMessage::parse(raw.version(), raw.message_id(), raw.payload())
            .map(|message| (header, message))
    }
}

/// The first bytes as a frame of the version they begin with, its checksum not looked at.
fn raw(bytes: &[u8]) -> Option<MAVLinkMessageRaw> {
    match *bytes.first()? {
        MAV_STX => {
            let mut raw = MAVLinkV1MessageRaw::new();
            copy(raw.as_mut_slice(), bytes);
            Some(MAVLinkMessageRaw::V1(raw))
        }
        MAV_STX_V2 => {
            let mut raw = MAVLinkV2MessageRaw::new();
            copy(raw.as_mut_slice(), bytes);
            let known = raw.incompatibility_flags() & !consts::v2::SUPPORTED_IFLAGS == 0;
            known.then_some(MAVLinkMessageRaw::V2(raw))
        }
        _ => None,
    }
}

fn copy(to: &mut [u8], from: &[u8]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to = *from);
}

/// Length of the frame at the start of `bytes`; `None` if there is none with a valid checksum.
fn frame_len(bytes: &[u8]) -> Option<usize> {
    let raw = raw(bytes)?;
    let len = match &raw {
        MAVLinkMessageRaw::V1(raw) => raw.raw_bytes().len(),
        MAVLinkMessageRaw::V2(raw) => raw.raw_bytes().len(),
    };
    (len <= bytes.len() && ArduPilotFrames::has_valid_crc(&raw)).then_some(len)
}

fn big_endian(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0, |time, &byte| time << 8 | u64::from(byte))
}

/// Time of the record at the start of `bytes`, if there is one.
fn next_time(bytes: &[u8]) -> Option<u64> {
    let (time, frame) = bytes.split_at_checked(TIME_SIZE)?;
    frame_len(frame).map(|_| big_endian(time)).filter(|&time| time < TIME_END)
}

/// Encoding of the times of the records in `bytes`, where it is certain that they are no big-endian microseconds.
///
/// A clock that was never set counts from 1970, so that a small number alone says little: in seconds it must also stand
/// still while dozens of messages pass.
fn wrong_times(bytes: &[u8]) -> Option<WrongTimes> {
    let mut times = Vec::new();
    let mut at = 0;
    while times.len() < CHECKED
        && let Some(rest) = bytes.get(at..)
        && rest.len() >= SHORTEST
    {
        let (time, frame) = rest.split_at(TIME_SIZE);
        match frame_len(frame) {
            Some(length) => {
                let reversed = time.iter().rev().fold(0, |t, &byte| t << 8 | u64::from(byte));
                times.push((big_endian(time), reversed));
                at += TIME_SIZE + length;
            }
            None => at += 1,
        }
    }
    let (first, last) = (times.first()?.0, times.last()?.0);
    let most = |test: &dyn Fn(u64, u64) -> bool| {
        times.iter().filter(|(time, reversed)| test(*time, *reversed)).count() * 4 > times.len() * 3
    };
    let years = |unit: u64| TIME_START / unit..TIME_END / unit;
    let in_unit = |unit: u64| most(&|time, _| years(unit).contains(&time));
    if most(&|time, reversed| !years(1).contains(&time) && years(1).contains(&reversed)) {
        Some(WrongTimes::LittleEndian)
    } else if most(&|time, _| {
        (TIME_START * 1000..=u64::MAX).contains(&time) && time / 1000 < TIME_END
    }) {
        Some(WrongTimes::Nanoseconds)
    } else if in_unit(1000) && last.abs_diff(first) < NEXT_STEP {
        Some(WrongTimes::Milliseconds)
    } else if in_unit(1_000_000) && last.abs_diff(first) < times.len() as u64 {
        Some(WrongTimes::Seconds)
    } else {
        None
    }
}

/// Why a log cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum TlogError {
    /// The file cannot be opened or read on.
    #[error("{}: byte {offset}: cannot read: {source}", path.display())]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Bytes read before.
        offset: u64,
        /// The system's reason.
        source: io::Error,
    },
    /// No message in the whole file.
    #[error("{}: bytes 0 to {length}: no MAVLink message with a time before it; {}", path.display(), advice(*bare))]
    NoMessages {
        /// Path of the file.
        path: PathBuf,
        /// Its length in bytes.
        length: u64,
        /// Whether it begins with a frame.
        bare: bool,
    },
    /// The times are not 8 bytes big-endian in microseconds.
    #[error("{}: the times before the messages are {found}; a telemetry log has microseconds since 1970, 8 bytes big-endian", path.display())]
    Times {
        /// Path of the file.
        path: PathBuf,
        /// Their encoding.
        found: WrongTimes,
    },
}

/// Another way to write times than that of telemetry logs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the words say it")]
pub enum WrongTimes {
    #[error("little-endian")]
    LittleEndian,
    #[error("in seconds")]
    Seconds,
    #[error("in milliseconds")]
    Milliseconds,
    #[error("in nanoseconds")]
    Nanoseconds,
}

fn advice(bare: bool) -> &'static str {
    if bare {
        "it holds frames without times, give the .tlog in place of the .raw file"
    } else {
        "give a telemetry log (.tlog) of a ground station"
    }
}

/// Reads records in order, over damaged places.
#[derive(Debug)]
pub struct Reader<R> {
    input: R,
    path: PathBuf,
    buffer: Vec<u8>,
    start: usize,
    /// Of `buffer[start]` in the file.
    offset: u64,
    ended: bool,
    bare: bool,
    last_time: Option<u64>,
    messages: u64,
    skipped: u64,
}

impl Reader<File> {
    /// Opens a log.
    ///
    /// # Errors
    /// [`TlogError::Read`].
    pub fn open(path: &Path) -> Result<Self, TlogError> {
        let opened = File::open(path);
        let failed = |source| TlogError::Read { path: path.into(), offset: 0, source };
        Ok(Self::new(opened.map_err(failed)?, path))
    }
}

impl<R: Read> Reader<R> {
    /// Reads from `input`, which errors call `path`.
    pub fn new(input: R, path: &Path) -> Self {
        Self {
            input,
            path: path.into(),
            buffer: Vec::new(),
            start: 0,
            offset: 0,
            ended: false,
            bare: false,
            last_time: None,
            messages: 0,
            skipped: 0,
        }
    }

    /// Messages read up to now.
    pub fn messages(&self) -> u64 {
        self.messages
    }

    /// Bytes up to now that belong to no message: damaged, cut, or of a dialect that is not known.
    pub fn skipped(&self) -> u64 {
        self.skipped
    }

    /// The next record; `None` at the end of the log.
    ///
    /// # Errors
    /// [`TlogError`]; what was read before stays valid.
    pub fn next_record(&mut self) -> Result<Option<Record>, TlogError> {
        let mut in_step = true;
        loop {
            self.fill()?;
            if self.offset == 0
                && let Some(found) = wrong_times(&self.buffer)
            {
                return Err(TlogError::Times { path: self.path.clone(), found });
            }
            let rest = self.buffer.get(self.start..).unwrap_or_default();
            if self.offset == 0 && self.messages == 0 {
                self.bare = frame_len(rest).is_some();
            }
            if rest.len() < SHORTEST {
                let left = rest.len();
                self.advance(left);
                self.skipped += left as u64;
                if self.messages == 0 {
                    let (path, length) = (self.path.clone(), self.offset);
                    return Err(TlogError::NoMessages { path, length, bare: self.bare });
                }
                return Ok(None);
            }
            let (time, frame) = rest.split_at(TIME_SIZE);
            let Some(length) = frame_len(frame) else {
                in_step = false;
                self.advance(1);
                self.skipped += 1;
                continue;
            };
            let time = big_endian(time);
            let record = TIME_SIZE + length;
            let near = |last: u64| {
                in_step
                    || time.abs_diff(last) <= TIME_STEP
                    || next_time(rest.get(record..).unwrap_or_default())
                        .is_some_and(|next| next.abs_diff(time) <= NEXT_STEP)
            };
            if time >= TIME_END || !self.last_time.is_none_or(near) {
                // A frame whose own time is lost.
                in_step = false;
                self.advance(TIME_SIZE + length);
                self.skipped += (TIME_SIZE + length) as u64;
                continue;
            }
            // No frame is longer than the longest.
            let frame = frame.get(..length).unwrap_or_default();
            let frame = heapless::Vec::from_slice(frame).unwrap_or_default();
            let record = Record { time_us: time as i64, offset: self.offset, frame };
            self.advance(TIME_SIZE + length);
            self.last_time = Some(time);
            self.messages += 1;
            return Ok(Some(record));
        }
    }

    fn advance(&mut self, bytes: usize) {
        self.start += bytes;
        self.offset += bytes as u64;
    }

    /// Makes sure that two of the longest records are in the buffer, or all there is.
    fn fill(&mut self) -> Result<(), TlogError> {
        while !self.ended && self.buffer.len() - self.start < 2 * LONGEST {
            self.buffer.drain(..self.start);
            self.start = 0;
            let kept = self.buffer.len();
            self.buffer.resize(kept + BLOCK, 0);
            let read = self.input.read(self.buffer.get_mut(kept..).unwrap_or_default());
            self.buffer.truncate(kept + *read.as_ref().unwrap_or(&0));
            match read {
                Ok(0) => self.ended = true,
                Ok(_) => {}
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(source) => {
                    let offset = self.offset + kept as u64;
                    return Err(TlogError::Read { path: self.path.clone(), offset, source });
                }
            }
        }
        Ok(())
    }
}

impl<R: Read> Iterator for Reader<R> {
    type Item = Result<Record, TlogError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.next_record().transpose()
    }
}

/// Adds a record to a log; `frame` is a whole frame, `time_us` in microseconds since 1970 (0 if below).
///
/// # Errors
/// Those of `output`.
pub fn write(output: &mut impl Write, time_us: i64, frame: &[u8]) -> io::Result<()> {
    // As one piece: a log is complete after every record.
    let mut record = heapless::Vec::<u8, LONGEST>::new();
    let time = u64::try_from(time_us).unwrap_or(0).to_be_bytes();
    let built = record.extend_from_slice(&time).and_then(|()| record.extend_from_slice(frame));
    built.map_err(|_| io::Error::other("the frame is longer than a MAVLink frame can be"))?;
    output.write_all(&record)
}

#[cfg(test)]
mod tests;
