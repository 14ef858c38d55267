use super::*;
use crate::mavlink::dialect::{HEARTBEAT_DATA, PARAM_VALUE_DATA, SYSTEM_TIME_DATA};
use mavlink_core::Dialect;
use proptest::prelude::*;
use std::string::ToString;
use std::vec;

const START: i64 = 1_767_225_600_000_000;

fn header(sequence: u8) -> MavHeader {
    MavHeader { system_id: 3, component_id: 1, sequence }
}

/// A frame of number `index`, in both versions and many lengths.
fn frame(index: usize) -> Vec<u8> {
    let time = SYSTEM_TIME_DATA { time_unix_usec: index as u64 * 0xfd_fe01, time_boot_ms: 9 };
    let message = match index % 3 {
        0 => MavMessage::HEARTBEAT(HEARTBEAT_DATA::default()),
        1 => MavMessage::SYSTEM_TIME(time),
        _ => MavMessage::PARAM_VALUE(PARAM_VALUE_DATA::default()),
    };
    if index % 4 == 3 {
        let mut raw = MAVLinkV1MessageRaw::new();
        raw.serialize_message(header(index as u8), &message);
        raw.raw_bytes().to_vec()
    } else {
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.serialize_message(header(index as u8), &message);
        raw.raw_bytes().to_vec()
    }
}

/// A log of `count` records, 10 ms apart, and where each begins.
fn log(count: usize) -> (Vec<u8>, Vec<u64>) {
    let (mut bytes, mut offsets) = (Vec::new(), Vec::new());
    for index in 0..count {
        offsets.push(bytes.len() as u64);
        write(&mut bytes, START + index as i64 * 10_000, &frame(index)).unwrap();
    }
    (bytes, offsets)
}

fn reader(bytes: &[u8]) -> Reader<&[u8]> {
    Reader::new(bytes, Path::new("flight.tlog"))
}

fn read(bytes: &[u8]) -> (Vec<Record>, u64) {
    let mut reader = reader(bytes);
    let records = reader.by_ref().map_while(Result::ok).collect();
    (records, reader.skipped())
}

#[test]
fn what_is_written_is_read() {
    let (bytes, offsets) = log(2000);
    let (records, skipped) = read(&bytes);
    assert_eq!((records.len(), skipped), (2000, 0));
    for (index, (record, offset)) in records.iter().zip(offsets).enumerate() {
        assert_eq!(record.time_us, START + index as i64 * 10_000);
        assert_eq!((record.offset, &record.frame[..]), (offset, &frame(index)[..]));
        let (found, message) = record.message().unwrap();
        assert_eq!(found, header(index as u8));
        assert_eq!(message.message_id(), [0, 2, 22][index % 3]);
    }
}

#[test]
fn the_form_is_that_of_ground_stations() {
    let mut bytes = Vec::new();
    write(&mut bytes, 0x0006_4751_2345_6789, &[0xfd, 1, 2]).unwrap();
    assert_eq!(bytes, [0, 6, 0x47, 0x51, 0x23, 0x45, 0x67, 0x89, 0xfd, 1, 2]);
    assert!(write(&mut bytes, 0, &[0; MAX_FRAME_SIZE + 1]).is_err());
}

#[test]
fn records_after_a_damaged_place_are_found() {
    let (bytes, offsets) = log(300);
    let hole = offsets[100] as usize..offsets[110] as usize;
    let mut damaged = bytes.clone();
    for (at, byte) in damaged[hole.clone()].iter_mut().enumerate() {
        *byte = [0xfd, 0x09, 0xfe, 0x00][at % 4];
    }
    let (records, skipped) = read(&damaged);
    assert_eq!((records.len(), skipped), (290, hole.len() as u64));
    // Whatever is taken out: only what it touches is lost, and times stay those of their messages.
    for cut in [1, 7, 8, 9, 25, 300] {
        let from = offsets[50] as usize + 3;
        let cut_bytes = [&bytes[..from], &bytes[from + cut..]].concat();
        let (records, _) = read(&cut_bytes);
        let touched = offsets.iter().filter(|&&o| o as usize >= from && (o as usize) < from + cut);
        assert!(records.len() >= 300 - 2 - touched.count(), "{cut}: {}", records.len());
        for record in records {
            let index = (record.time_us - START) / 10_000;
            assert_eq!(&record.frame[..], &frame(index as usize)[..], "{cut}");
        }
    }
}

#[test]
fn a_cut_end_loses_one_record() {
    let (bytes, offsets) = log(50);
    for end in offsets[48] as usize + 1..bytes.len() {
        let whole = offsets.iter().skip(1).filter(|&&o| o as usize <= end).count();
        let (records, skipped) = read(&bytes[..end]);
        assert_eq!(records.len(), whole);
        assert_eq!(skipped, end as u64 - offsets[whole]);
    }
}

#[test]
fn what_is_no_log_is_named() {
    let error = |bytes: &[u8]| reader(bytes).next_record().unwrap_err().to_string();
    let empty = "flight.tlog: bytes 0 to 0: no MAVLink message with a time before it; \
        give a telemetry log (.tlog) of a ground station";
    assert_eq!(error(&[]), empty);
    assert!(error(&[0xfd; 5000]).starts_with("flight.tlog: bytes 0 to 5000: no MAVLink message"));
    assert!(error(&frame(0)).ends_with("give the .tlog in place of the .raw file"));
    let missing = Reader::open(Path::new("/nowhere/a.tlog")).err().unwrap().to_string();
    assert!(missing.starts_with("/nowhere/a.tlog: byte 0: cannot read: "), "{missing}");
}

#[test]
fn a_clock_that_jumps_behind_a_damaged_place_keeps_the_rest() {
    let mut bytes = Vec::new();
    for index in 0..12usize {
        // Set from 1970 to today after the fourth record, where bytes are damaged too.
        let time = if index < 4 { index as i64 * 500_000 } else { START + index as i64 * 500_000 };
        if index == 4 {
            bytes.extend([0xfd, 9, 9, 9]);
        }
        write(&mut bytes, time, &frame(index)).unwrap();
    }
    let (records, skipped) = read(&bytes);
    assert_eq!((records.len(), skipped), (12, 4));
}

#[test]
fn times_in_another_form_are_refused() {
    let log = |count: i64, time: &dyn Fn(i64) -> [u8; 8]| {
        let mut bytes = Vec::new();
        for index in 0..count {
            bytes.extend(time(START + index * 100_000));
            bytes.extend(frame(index as usize));
        }
        bytes
    };
    let in_unit = |divisor: i64| move |us: i64| (us / divisor).to_be_bytes();
    for (count, time, word) in [
        (40, &(|us: i64| us.to_le_bytes()) as &dyn Fn(i64) -> [u8; 8], "little-endian"),
        (3, &|us: i64| us.to_le_bytes(), "little-endian"),
        (40, &in_unit(1000), "in milliseconds"),
        (40, &in_unit(1_000_000), "in seconds"),
        (40, &|us: i64| (us as u64 * 1000).to_be_bytes(), "in nanoseconds"),
    ] {
        let bytes = log(count, time);
        let error = reader(&bytes).next_record().unwrap_err().to_string();
        assert!(error.contains(&std::format!("are {word};")), "{error}");
    }
    // A clock that was never set is no other unit, at any time since its start.
    for since in [0, 5_000_000, 960_000_000, 3_600_000_000] {
        let bytes = log(40, &|us: i64| (us - START + since).to_be_bytes());
        assert_eq!(read(&bytes).0.len(), 40);
    }
}

/// Gives some bytes, then fails.
struct BrokenReader<'a>(&'a [u8]);

impl Read for BrokenReader<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.0.read(buffer)?;
        if count == 0 { Err(io::Error::other("bad sector")) } else { Ok(count) }
    }
}

#[test]
fn a_failing_disk_names_the_byte() {
    let (bytes, _) = log(3);
    let mut reader = Reader::new(BrokenReader(&bytes), Path::new("flight.tlog"));
    let error = reader.next_record().unwrap_err().to_string();
    assert_eq!(error, std::format!("flight.tlog: byte {}: cannot read: bad sector", bytes.len()));
}

proptest! {
    /// Whatever is done to a log: no panic, bytes are records or counted as skipped, records in order.
    #[test]
    fn damaged_logs_are_read_on(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..40),
        inserted in (any::<prop::sample::Index>(), prop::collection::vec(any::<u8>(), 0..600)),
        cut in any::<prop::sample::Index>(),
    ) {
        let (mut bytes, _) = log(60);
        for (place, byte) in changes {
            let place = place.index(bytes.len());
            bytes[place] = byte;
        }
        let place = inserted.0.index(bytes.len());
        bytes.splice(place..place, inserted.1);
        bytes.truncate(cut.index(bytes.len()) + 1);
        let (records, skipped) = read(&bytes);
        let taken: usize = records.iter().map(|record| TIME_SIZE + record.frame.len()).sum();
        // A log without any message ends in an error, its bytes all skipped.
        prop_assert_eq!(taken as u64 + skipped, bytes.len() as u64);
        prop_assert!(records.is_sorted_by(|a, b| a.offset < b.offset));
        for record in &records {
            let _ = record.message();
        }
    }

    /// Garbage alone: no panic, hardly ever a record.
    #[test]
    fn garbage_is_no_log(bytes in prop::collection::vec(prop_oneof![Just(0xfdu8), Just(0xfe), any::<u8>()], 0..4000)) {
        let (records, _) = read(&bytes);
        prop_assert!(records.len() <= 1);
    }

    /// Payloads that no sender would make, under a checksum that holds.
    #[test]
    fn strange_payloads_do_not_panic(id in prop_oneof![0u32..600, 10_000..12_000u32], flags in 0u8..4, payload in prop::collection::vec(any::<u8>(), 0..256)) {
        let mut frame = vec![MAV_STX_V2, payload.len() as u8, flags, 0, 0, 1, 1];
        if flags & 2 != 0 {
            frame.extend([0; 3]);
        }
        frame.extend(&id.to_le_bytes()[..3]);
        frame.extend(&payload);
        let known = ArduPilotFrames.extra_crc(id);
        let crc = mavlink_core::calculate_crc(&frame[1..], known.unwrap_or(0));
        frame.extend(crc.to_le_bytes());
        if flags & 1 != 0 {
            frame.extend([7; 13]);
        }
        prop_assert_eq!(frame_len(&frame), known.map(|_| frame.len()));
        if known.is_none() {
            return Ok(());
        }
        let mut log = Vec::new();
        write(&mut log, START, &frame).unwrap();
        let (records, skipped) = read(&log);
        prop_assert_eq!((records.len(), skipped), (1, 0));
        let _ = records[0].message();
    }
}
