//! Signatures of frames: who knows the key may command.
//!
//! A frame bears the time it was signed, in units of 10 µs since 2015, which must rise on every stream (system, component
//! and link), so that a frame recorded once is worth nothing later. That time must rise over a restart too, even on a
//! board whose clock starts in the past: a minute ahead of what is used stands in a file.
//! Source: <https://mavlink.io/en/guide/message_signing.html>.

use crate::mavlink::component::Trust;
use mavlink_core::{MAVLinkMessageRaw, MAVLinkV2MessageRaw, consts};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::string::ToString;
use std::time::{SystemTime, UNIX_EPOCH};
use std::{fs, io};

/// 2015-01-01 in microseconds since 1970.
const EPOCH_US: u128 = 1_420_070_400_000_000;

/// A minute: how far a new stream may lag, and how far ahead the file is.
const MINUTE: u64 = 6_000_000;

/// Streams that are remembered; more than a vehicle has.
const STREAMS: usize = 256;

/// The largest time, 48 bits.
const LAST: u64 = (1 << 48) - 1;

/// The key, and the times of what was signed with it.
#[derive(Debug)]
pub struct Signing {
    key: [u8; 32],
    time: u64,
    /// What the file promises that nothing was signed beyond.
    promised: u64,
    file: Option<PathBuf>,
    streams: HashMap<(u32, u8, u8), u64>,
}

/// The time of the system's clock in units of 10 µs since 2015; 0 before that.
pub fn clock() -> u64 {
    let unix = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_micros());
    (unix.saturating_sub(EPOCH_US) / 10).min(LAST.into()) as u64
}

/// Reads a key: 64 hexadecimal digits in a text file.
///
/// # Errors
/// The system's, and where the file holds something else.
pub fn read_key(path: &Path) -> io::Result<[u8; 32]> {
    let text = fs::read_to_string(path)?;
    let digits = text.trim().as_bytes();
    let mut key = [0; 32];
    let mut good = digits.len() == 64;
    for (byte, pair) in key.iter_mut().zip(digits.chunks_exact(2)) {
        let digit = |c: u8| char::from(c).to_digit(16);
        match (digit(pair[0]), digit(pair[1])) {
            (Some(high), Some(low)) => *byte = (high * 16 + low) as u8,
            _ => good = false,
        }
    }
    let reason = "holds no key; write 64 hexadecimal digits into it";
    if good { Ok(key) } else { Err(io::Error::new(io::ErrorKind::InvalidData, reason)) }
}

impl Signing {
    /// A key, and the file that keeps the time of signing; that time goes on from the file, or from `clock` where it
    /// is later. Without a file nothing is kept over a restart.
    ///
    /// # Errors
    /// Where the file can be read or written neither, or holds no time: with an unknown time, old frames could be
    /// played back.
    pub fn new(key: [u8; 32], file: Option<&Path>, clock: u64) -> io::Result<Self> {
        let kept = match file.map(fs::read_to_string) {
            None => 0,
            Some(Ok(text)) => {
                text.trim().parse().ok().filter(|&time| time <= LAST).ok_or_else(|| {
                    io::Error::new(
                        io::ErrorKind::InvalidData,
                        "holds no signing time; delete it only together with the key",
                    )
                })?
            }
            Some(Err(error)) if error.kind() == io::ErrorKind::NotFound => 0,
            Some(Err(error)) => return Err(error),
        };
        let time = clock.max(kept);
        let file = file.map(PathBuf::from);
        let mut signing = Self { key, time, promised: 0, file, streams: HashMap::new() };
        signing.promise()?;
        Ok(signing)
    }

    /// Writes a time ahead of the one in use.
    fn promise(&mut self) -> io::Result<()> {
        let ahead = (self.time + MINUTE).min(LAST);
        if let Some(file) = &self.file {
            crate::shell::support::atomic_file::write(file, ahead.to_string().as_bytes())?;
        }
        self.promised = ahead;
        Ok(())
    }

    /// Signs a frame that was made with room for it, at `clock`.
    ///
    /// # Errors
    /// When the time cannot be written to its file; the frame is signed, but must not be sent.
    pub fn sign(
        &mut self,
        frame: &mut MAVLinkV2MessageRaw,
        link: u8,
        clock: u64,
    ) -> io::Result<()> {
        self.time = clock.min(LAST).max((self.time + 1).min(LAST));
        if self.time >= self.promised {
            self.promise()?;
        }
        *frame.signature_link_id_mut() = link;
        let time = self.time.to_le_bytes();
        frame.signature_timestamp_bytes_mut().copy_from_slice(&time[..6]);
        let mut signature = [0; consts::v2::SIGNATURE_VALUE_SIZE];
        frame.calculate_signature(&self.key, &mut signature);
        frame.signature_value_mut().copy_from_slice(&signature);
        Ok(())
    }

    /// What the signature of a frame heard at `clock` is worth.
    pub fn verify(&mut self, frame: &MAVLinkMessageRaw, clock: u64) -> Trust {
        let MAVLinkMessageRaw::V2(frame) = frame else { return Trust::Unsigned };
        if frame.incompatibility_flags() & consts::v2::IFLAG_SIGNED == 0 {
            return Trust::Unsigned;
        }
        let mut signature = [0; consts::v2::SIGNATURE_VALUE_SIZE];
        frame.calculate_signature(&self.key, &mut signature);
        // All bytes are looked at: the time this takes tells nothing.
        let wrong = signature.iter().zip(frame.signature_value()).fold(0, |d, (a, b)| d | (a ^ b));
        let time = frame.signature_timestamp();
        let stream = (frame.system_id(), frame.component_id(), frame.signature_link_id());
        let now = self.time.max(clock);
        let late = match self.streams.get(&stream) {
            Some(&last) => time <= last,
            None => time.saturating_add(MINUTE) < now || self.streams.len() >= STREAMS,
        };
        if wrong != 0 || late {
            return Trust::Forged;
        }
        self.streams.insert(stream, time);
        // A peer whose clock is right may set ours on; it holds the key.
        self.time = self.time.max(time);
        Trust::Signed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mavlink::dialect::{COMMAND_LONG_DATA, SYSTEM_TIME_DATA};
    use crate::mavlink::messages::Payload;

    const KEY: [u8; 32] = [7; 32];
    const NOW: u64 = 1_000_000_000;

    fn frame() -> MAVLinkV2MessageRaw {
        Payload::new(&SYSTEM_TIME_DATA { time_unix_usec: 1, time_boot_ms: 2 }).frame(1, 2, 3, true)
    }

    fn signed(signing: &mut Signing, clock: u64) -> MAVLinkMessageRaw {
        let mut frame = frame();
        signing.sign(&mut frame, 4, clock).unwrap();
        assert!(frame.has_valid_crc::<crate::mavlink::dialect::MavMessage>());
        MAVLinkMessageRaw::V2(frame)
    }

    fn new(clock: u64) -> Signing {
        Signing::new(KEY, None, clock).unwrap()
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
        let mut theirs = new(NOW);
        assert_eq!(theirs.verify(&signed(&mut new(0), NOW - MINUTE), NOW), Trust::Signed);
        let mut theirs = new(NOW);
        assert_eq!(theirs.verify(&signed(&mut new(0), NOW - MINUTE - 1), NOW), Trust::Forged);
    }

    #[test]
    fn keys_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("key");
        fs::write(&file, "0123456789abcdef".repeat(3) + "00000000000000FF\n").unwrap();
        let key = read_key(&file).unwrap();
        assert_eq!((key[0], key[7], key[31]), (0x01, 0xEF, 0xFF));
        for bad in ["", "0123", &"xy".repeat(32), &"0".repeat(65), &"é".repeat(32)] {
            fs::write(&file, bad).unwrap();
            assert!(read_key(&file).is_err(), "{bad}");
        }
    }

    #[test]
    fn time_rises_over_a_restart_though_the_clock_fell() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("time");
        let time = |frame: &MAVLinkMessageRaw| match frame {
            MAVLinkMessageRaw::V2(frame) => frame.signature_timestamp(),
            MAVLinkMessageRaw::V1(_) => 0,
        };
        let mut before = Signing::new(KEY, Some(&file), NOW).unwrap();
        let mut last = 0;
        for step in 0..40 {
            last = time(&signed(&mut before, NOW + step * MINUTE / 7));
        }
        let mut after = Signing::new(KEY, Some(&file), 5).unwrap();
        let first = time(&signed(&mut after, 5));
        assert!(first > last && first < last + 2 * MINUTE, "{first} after {last}");
        fs::write(&file, "garbage").unwrap();
        assert!(Signing::new(KEY, Some(&file), NOW).is_err());
    }
}
