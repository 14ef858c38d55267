//! Signatures of frames: who knows the key may command.
//!
//! A frame bears the time it was signed, in units of 10 µs since 2015, which must rise on every stream (system, component
//! and link), so that a recorded frame is worth nothing later. That must hold over a restart too, even on a board whose
//! clock starts in the past: a time ahead of the one in use is kept in a file, with the last time of every stream.
//!
//! | line of the file | content |
//! | --- | --- |
//! | first | a time that nothing was signed after |
//! | others | system, component and link of a stream, and the time of its last frame that counted |
//!
//! Which times are taken of others depends on our clock. Where it is plausible, a new stream may lag behind it by a minute
//! and no stream may be ahead by more than a day. Where it is not (a board without a clock of its own), the newest time heard
//! takes its place, and one larger step is taken.
//! Source: <https://mavlink.io/en/guide/message_signing.html>.

use crate::mavlink::component::Trust;
use crate::shell::support::keeper::Keeper;
use crate::shell::support::{atomic_file, bounded_file, lock};
use mavlink_core::{MAVLinkMessageRaw, MAVLinkV2MessageRaw, consts};
use std::collections::HashMap;
use std::fmt::Write;
use std::fs::File;
use std::io;
use std::path::Path;
use std::string::String;
use std::time::{SystemTime, UNIX_EPOCH};

/// 2015-01-01 in microseconds since 1970.
const EPOCH_US: u128 = 1_420_070_400_000_000;

const SECOND: u64 = 100_000;
/// Largest lag of a new stream, and half the time that the file is ahead.
const MINUTE: u64 = 60 * SECOND;
const HOUR: u64 = 60 * MINUTE;
/// Largest lead of a peer's time.
const DAY: u64 = 24 * HOUR;

/// 2025-01-01: a clock that is earlier was never set.
const EARLIEST: u64 = 315_619_200 * SECOND;
/// 2070-01-01: a time that is later is a mistake. Taken over, it would end the 48 bits of a signature's time soon.
const LATEST: u64 = 1_735_689_600 * SECOND;

/// Streams that are remembered; more than a vehicle has.
const STREAMS: usize = 256;

/// Messages that change something: the time of each is kept at once, so that a restart makes no old one valid.
/// PARAM_SET, COMMAND_INT, COMMAND_LONG.
const COMMANDS: [u32; 3] = [23, 75, 76];

/// System, component and link that a frame names.
type SignedStream = (u32, u8, u8);

/// The key, and the times of what was signed with it.
#[derive(Debug)]
pub struct Signing {
    key: [u8; 32],
    /// Of the last frame that we signed.
    time: u64,
    /// The newest time of others.
    heard: u64,
    streams: HashMap<SignedStream, u64>,
    /// Whether one step of more than a day is still taken.
    may_step: bool,
    /// Whether a frame of the far future was refused.
    refused_future: bool,
    file: Option<TimeFile>,
}

/// The file of times.
#[derive(Debug)]
struct TimeFile {
    keeper: Keeper,
    /// The time in its first line, once it is written.
    promised: u64,
    /// Held as long as the program runs.
    _lock: Option<File>,
}

/// The time of the system's clock in units of 10 µs since 2015; 0 before that.
pub fn clock() -> u64 {
    let unix = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_micros());
    u64::try_from(unix.saturating_sub(EPOCH_US) / 10).unwrap_or(LATEST).min(LATEST)
}

/// Reads a key: 64 hexadecimal digits in a text file that other users cannot read.
///
/// # Errors
/// The system's; `InvalidData` where the file holds something else; `PermissionDenied` where all users may read it.
pub fn read_key(path: &Path) -> io::Result<[u8; 32]> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        if std::fs::metadata(path)?.permissions().mode() & 0o007 != 0 {
            let reason = "every user of this machine can read the key; `chmod o= FILE`";
            return Err(io::Error::new(io::ErrorKind::PermissionDenied, reason));
        }
    }
    let text = bounded_file::read_text(path)?;
    let digits = text.trim().as_bytes();
    let mut key = [0; 32];
    let mut good = digits.len() == 64;
    for (byte, pair) in key.iter_mut().zip(digits.as_chunks::<2>().0) {
        let digit = |c: u8| char::from(c).to_digit(16).and_then(|digit| u8::try_from(digit).ok());
        match pair.map(digit).into() {
            (Some(high), Some(low)) => *byte = high * 16 + low,
            _ => good = false,
        }
    }
    let reason = "holds no key; write 64 hexadecimal digits into it";
    if good { Ok(key) } else { Err(io::Error::new(io::ErrorKind::InvalidData, reason)) }
}

/// Reads the file of times.
fn parse(text: &str) -> Option<(u64, HashMap<SignedStream, u64>)> {
    let time = |word: &str| word.parse().ok().filter(|&time: &u64| time <= LATEST);
    let mut lines = text.lines();
    let first = time(lines.next()?.trim())?;
    let stream = |line: &str| {
        let mut words = line.split_whitespace();
        let mut number = || words.next()?.parse::<u32>().ok();
        let system = number()?;
        let component = u8::try_from(number()?).ok()?;
        let link = u8::try_from(number()?).ok()?;
        Some(((system, component, link), time(words.next()?)?))
    };
    // Every line counts: of a lost one old frames could be played back.
    lines.take(STREAMS).map(stream).collect::<Option<_>>().map(|streams| (first, streams))
}

impl Signing {
    /// A key, and the file that keeps the times; ours goes on from the file, or from `clock` where that is later. Without a
    /// file nothing is kept over a restart.
    ///
    /// # Errors
    /// Where the file cannot be read, holds something else, or is used by another process. A file that cannot be written
    /// is only logged: see [`Signing::is_failing`].
    pub fn new(key: [u8; 32], file: Option<&Path>, clock: u64) -> io::Result<Self> {
        let Some(path) = file else {
            return Ok(Self::of(key, clock, 0, HashMap::new(), None));
        };
        let (kept, streams) = match bounded_file::read_text(path) {
            Ok(text) => parse(&text).ok_or_else(|| {
                let reason = "holds no signing times; delete it only together with the key";
                io::Error::new(io::ErrorKind::InvalidData, reason)
            })?,
            Err(error) if error.kind() == io::ErrorKind::NotFound => (0, HashMap::new()),
            Err(error) => return Err(error),
        };
        let mut beside = path.to_path_buf().into_os_string();
        beside.push(".lock");
        let lock = match lock::take(Path::new(&beside)) {
            Err(error) if error.kind() == io::ErrorKind::ResourceBusy => return Err(error),
            // Where no file can be made, none can be written by another either.
            lock => lock.ok(),
        };
        let file = TimeFile { keeper: Keeper::start(path)?, promised: 0, _lock: lock };
        let mut signing = Self::of(key, clock, kept, streams, Some(file));
        let ahead = signing.time.saturating_add(2 * MINUTE);
        match atomic_file::write(path, signing.text(ahead).as_bytes()) {
            Ok(()) => signing.promise(ahead, true),
            // Tried again, and logged, by the thread.
            Err(_) => signing.promise(ahead, false),
        }
        Ok(signing)
    }

    fn of(
        key: [u8; 32],
        clock: u64,
        kept: u64,
        streams: HashMap<SignedStream, u64>,
        file: Option<TimeFile>,
    ) -> Self {
        let heard = streams.values().copied().max().unwrap_or(kept);
        // A clock behind what was kept was set back by a power cut, unless this is a quick restart.
        let may_step =
            clock < EARLIEST || clock < kept.saturating_add(HOUR).min(LATEST) && kept > 0;
        let time = clock.max(kept);
        Self { key, time, heard, streams, may_step, refused_future: false, file }
    }

    fn text(&self, ahead: u64) -> String {
        let mut text = std::format!("{ahead}\n");
        for ((system, component, link), time) in &self.streams {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{system} {component} {link} {time}");
        }
        text
    }

    /// Has a time ahead of the one in use written, and those of the streams.
    fn promise(&mut self, ahead: u64, written: bool) {
        let text = self.text(ahead);
        if let Some(file) = &mut self.file {
            file.promised = ahead;
            if !written {
                file.keeper.keep(text.into_bytes(), ahead);
            }
        }
    }

    /// Whether the times cannot be written at present. Frames are signed all the same: silence would be worse than what
    /// may happen after a restart with a clock of the past.
    pub fn is_failing(&self) -> bool {
        self.file.as_ref().is_some_and(|file| file.keeper.is_failing())
    }

    /// Whether a rightly signed frame was refused since the last call because its time is more than a day ahead.
    pub fn take_refused_future(&mut self) -> bool {
        std::mem::take(&mut self.refused_future)
    }

    /// Signs a frame that was made with room for it, at `clock`.
    pub fn sign(&mut self, frame: &mut MAVLinkV2MessageRaw, link: u8, clock: u64) {
        self.time = clock.min(LATEST).max(self.time + 1);
        // In time for the slowest disk.
        if self.file.as_ref().is_some_and(|file| self.time + MINUTE >= file.promised) {
            self.promise(self.time + 2 * MINUTE, false);
        }
        *frame.signature_link_id_mut() = link;
        let time = self.time.to_le_bytes();
        let stamp = frame.signature_timestamp_bytes_mut().iter_mut();
        stamp.zip(time).for_each(|(byte, of_time)| *byte = of_time);
        let mut signature = [0; consts::v2::SIGNATURE_VALUE_SIZE];
        frame.calculate_signature(&self.key, &mut signature);
        frame.signature_value_mut().copy_from_slice(&signature);
    }

    /// The time that those of others are compared with.
    fn reference(&self, clock: u64) -> u64 {
        let plausible = clock >= EARLIEST && clock.saturating_add(DAY) >= self.heard;
        if plausible { clock } else { clock.max(self.heard) }
    }

    /// Checks the signature of a frame heard at `clock`, and its time.
    pub fn verify(&mut self, frame: &MAVLinkMessageRaw, clock: u64) -> Trust {
        let MAVLinkMessageRaw::V2(frame) = frame else { return Trust::Unsigned };
        if frame.incompatibility_flags() & consts::v2::IFLAG_SIGNED == 0 {
            return Trust::Unsigned;
        }
        let mut signature = [0; consts::v2::SIGNATURE_VALUE_SIZE];
        frame.calculate_signature(&self.key, &mut signature);
        // All bytes are compared: the time this takes says nothing.
        let wrong = signature.iter().zip(frame.signature_value()).fold(0, |d, (a, b)| d | (a ^ b));
        if wrong != 0 {
            return Trust::Forged;
        }
        let time = frame.signature_timestamp();
        let stream = (frame.system_id(), frame.component_id(), frame.signature_link_id());
        let reference = self.reference(clock);
        let known = self.streams.get(&stream);
        let late = match known {
            Some(&last) => time <= last,
            None => time.saturating_add(MINUTE) < reference || self.streams.len() >= STREAMS,
        };
        let ahead = time > reference.saturating_add(DAY);
        if time > LATEST || ahead && !self.may_step {
            self.refused_future = true;
            return Trust::Forged;
        }
        if late {
            return Trust::Forged;
        }
        if ahead {
            tracing::warn!("the signing time steps by more than a day, as a peer has it");
            self.may_step = false;
        }
        let news = known.is_none() || COMMANDS.contains(&frame.message_id());
        self.streams.insert(stream, time);
        self.heard = self.heard.max(time);
        // Others take ours only where it is not behind theirs.
        self.time = self.time.max(time);
        if news && self.file.is_some() {
            self.promise(self.time + 2 * MINUTE, false);
        }
        Trust::Signed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mavlink::dialect::{COMMAND_LONG_DATA, SYSTEM_TIME_DATA};
    use crate::mavlink::messages::Payload;
    use std::fs;
    use std::vec::Vec;

    const KEY: [u8; 32] = [7; 32];
    const NOW: u64 = EARLIEST + 1000 * DAY;

    fn frame() -> MAVLinkV2MessageRaw {
        Payload::new(&SYSTEM_TIME_DATA { time_unix_usec: 1, time_boot_ms: 2 }).frame(1, 2, 3, true)
    }

    fn signed(signing: &mut Signing, clock: u64) -> MAVLinkMessageRaw {
        let mut frame = frame();
        signing.sign(&mut frame, 4, clock);
        assert!(frame.has_valid_crc::<crate::mavlink::dialect::MavMessage>());
        MAVLinkMessageRaw::V2(frame)
    }

    fn new(clock: u64) -> Signing {
        Signing::new(KEY, None, clock).unwrap()
    }

    fn time(frame: &MAVLinkMessageRaw) -> u64 {
        match frame {
            MAVLinkMessageRaw::V2(frame) => frame.signature_timestamp(),
            MAVLinkMessageRaw::V1(_) => 0,
        }
    }

    #[test]
    fn what_one_signs_the_other_believes_once() {
        let (mut ours, mut theirs) = (new(NOW), new(NOW));
        let first = signed(&mut ours, NOW);
        assert_eq!(theirs.verify(&first, NOW), Trust::Signed);
        assert_eq!(theirs.verify(&first, NOW), Trust::Forged, "played back");
        // Faster than the clock ticks.
        assert_eq!(theirs.verify(&signed(&mut ours, NOW), NOW), Trust::Signed);
        let mut other = Signing::new([8; 32], None, NOW).unwrap();
        assert_eq!(theirs.verify(&signed(&mut other, NOW + 9), NOW), Trust::Forged);
        let plain = Payload::new(&COMMAND_LONG_DATA::default()).frame(1, 2, 3, false);
        assert_eq!(theirs.verify(&MAVLinkMessageRaw::V2(plain), NOW), Trust::Unsigned);
    }

    #[test]
    fn any_flipped_bit_is_found() {
        let (mut ours, mut theirs) = (new(NOW), new(NOW));
        let MAVLinkMessageRaw::V2(good) = signed(&mut ours, NOW) else { unreachable!() };
        let length = good.raw_bytes().len();
        for bit in 24..length * 8 {
            let mut bytes = good.into_inner();
            bytes[bit / 8] ^= 1 << (bit % 8);
            let bad = MAVLinkMessageRaw::V2(MAVLinkV2MessageRaw::from_bytes_unparsed(bytes));
            assert_ne!(theirs.verify(&bad, NOW), Trust::Signed, "bit {bit}");
        }
        assert_eq!(theirs.verify(&MAVLinkMessageRaw::V2(good), NOW), Trust::Signed);
    }

    #[test]
    fn a_new_stream_may_lag_a_minute() {
        for (lag, trust) in [(MINUTE - 1, Trust::Signed), (MINUTE + 2, Trust::Forged)] {
            assert_eq!(new(NOW).verify(&signed(&mut new(0), NOW - lag), NOW), trust, "{lag}");
        }
    }

    #[test]
    fn a_time_of_the_far_future_changes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        for future in [(1 << 48) - 5, NOW + 2 * DAY] {
            let file = folder.path().join(std::format!("{future}"));
            let mut ours = Signing::new(KEY, Some(&file), NOW).unwrap();
            let mut frame = frame();
            let mut peer = new(NOW);
            // As a peer whose clock is wrong signs; one that breaks the rules, too.
            peer.time = future - 1;
            peer.sign(&mut frame, 4, 0);
            let wrong = MAVLinkMessageRaw::V2(frame);
            assert_eq!(time(&wrong), future);
            assert_eq!(ours.verify(&wrong, NOW), Trust::Forged);
            assert!(ours.take_refused_future() && !ours.take_refused_future());
            let stamps: Vec<_> = (0..26).map(|_| time(&signed(&mut ours, NOW))).collect();
            assert!(stamps.windows(2).all(|pair| pair[0] < pair[1]), "{stamps:?}");
            assert!(stamps[25] < NOW + HOUR);
            assert_eq!(ours.verify(&signed(&mut new(NOW), NOW), NOW), Trust::Signed);
        }
    }

    #[test]
    fn our_clock_an_hour_ahead_for_a_while_keeps_nobody_out() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("time");
        let mut ours = Signing::new(KEY, Some(&file), NOW).unwrap();
        signed(&mut ours, NOW + HOUR);
        assert_eq!(ours.verify(&signed(&mut new(NOW), NOW), NOW), Trust::Signed);
        drop(ours);
        let mut ours = Signing::new(KEY, Some(&file), NOW + SECOND).unwrap();
        let mut other = new(NOW);
        let mut frame = Payload::new(&COMMAND_LONG_DATA::default()).frame(9, 9, 3, true);
        other.sign(&mut frame, 4, NOW + SECOND);
        assert_eq!(ours.verify(&MAVLinkMessageRaw::V2(frame), NOW + SECOND), Trust::Signed);
    }

    #[test]
    fn a_board_without_a_clock_steps_once() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("time");
        let mut ours = Signing::new(KEY, Some(&file), 0).unwrap();
        assert_eq!(ours.verify(&signed(&mut new(NOW), NOW), 0), Trust::Signed);
        assert!(time(&signed(&mut ours, 0)) > NOW, "and signs with that time");
        let mut frame = Payload::new(&COMMAND_LONG_DATA::default()).frame(9, 9, 3, true);
        new(0).sign(&mut frame, 4, NOW + 2 * DAY);
        assert_eq!(ours.verify(&MAVLinkMessageRaw::V2(frame), 0), Trust::Forged);
    }

    #[test]
    fn nothing_is_played_back_after_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("time");
        let mut ours = Signing::new(KEY, Some(&file), NOW).unwrap();
        let mut theirs = new(NOW);
        let mut command = |clock| {
            let mut frame = Payload::new(&COMMAND_LONG_DATA::default()).frame(255, 190, 3, true);
            theirs.sign(&mut frame, 4, clock);
            MAVLinkMessageRaw::V2(frame)
        };
        let (first, second) = (command(NOW), command(NOW + SECOND));
        for frame in [&first, &second] {
            assert_eq!(ours.verify(frame, NOW + SECOND), Trust::Signed);
        }
        // As after a `kill -9`: what the thread wrote within moments is all that there is.
        let start = std::time::Instant::now();
        let wanted = ours.streams[&(255, 190, 4)];
        while !fs::read_to_string(&file).unwrap().contains(&std::format!("255 190 4 {wanted}")) {
            assert!(start.elapsed() < std::time::Duration::from_secs(20));
        }
        let copy = folder.path().join("copy");
        fs::copy(&file, &copy).unwrap();
        let mut ours = Signing::new(KEY, Some(&copy), NOW + 2 * SECOND).unwrap();
        for frame in [&first, &second] {
            assert_eq!(ours.verify(frame, NOW + 2 * SECOND), Trust::Forged);
        }
        assert_eq!(ours.verify(&command(NOW + 2 * SECOND), NOW + 2 * SECOND), Trust::Signed);
    }

    #[test]
    fn keys_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("key");
        let write = |text: &str| {
            fs::write(&file, text).unwrap();
            #[cfg(unix)]
            fs::set_permissions(&file, std::os::unix::fs::PermissionsExt::from_mode(0o600))
                .unwrap();
        };
        write(&("0123456789abcdef".repeat(3) + "00000000000000FF\n"));
        let key = read_key(&file).unwrap();
        assert_eq!((key[0], key[7], key[31]), (0x01, 0xEF, 0xFF));
        for bad in ["", "0123", &"xy".repeat(32), &"0".repeat(65), &"é".repeat(32)] {
            write(bad);
            assert!(read_key(&file).is_err(), "{bad}");
        }
        #[cfg(unix)]
        {
            write(&"0".repeat(64));
            read_key(&file).unwrap();
            fs::set_permissions(&file, std::os::unix::fs::PermissionsExt::from_mode(0o644))
                .unwrap();
            assert_eq!(read_key(&file).unwrap_err().kind(), io::ErrorKind::PermissionDenied);
        }
    }

    #[test]
    fn time_rises_over_a_restart_though_the_clock_fell() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("time");
        let mut before = Signing::new(KEY, Some(&file), NOW).unwrap();
        let mut last = 0;
        for step in 0..40 {
            last = time(&signed(&mut before, NOW + step * MINUTE / 7));
        }
        assert!(Signing::new(KEY, Some(&file), NOW).is_err(), "one process at a time");
        drop(before);
        let mut after = Signing::new(KEY, Some(&file), 5).unwrap();
        let first = time(&signed(&mut after, 5));
        assert!(first > last && first < last + 3 * MINUTE, "{first} after {last}");
        drop(after);
        for garbage in ["garbage", "5\n1 2 3", "281474976710655"] {
            fs::write(&file, garbage).unwrap();
            assert!(Signing::new(KEY, Some(&file), NOW).is_err(), "{garbage}");
        }
    }

    #[test]
    fn without_a_file_to_write_it_signs_all_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let mut ours = Signing::new(KEY, Some(&folder.path().join("no/time")), NOW).unwrap();
        let first = time(&signed(&mut ours, NOW));
        assert!(time(&signed(&mut ours, NOW + 9 * MINUTE)) > first);
    }
}
