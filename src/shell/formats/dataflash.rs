//! ArduPilot's own logs (DataFlash, `.bin`): attitude and position as the MAVLink messages that a telemetry log has.
//!
//! A record is 0xA3 0x95, a type, and the fields that an FMT record (type 128) declares for that type, little-endian.
//! Source: ArduPilot `libraries/AP_Logger/LogStructure.h`.

use super::flight_sample::{FlightLogError, FlightSample};
use std::collections::HashMap;
use std::path::Path;
use std::string::String;
use std::vec::Vec;

/// First bytes of every record.
pub const MAGIC: [u8; 2] = [0xA3, 0x95];
/// Type of the records that declare others, and their length with the head.
const FMT: u8 = 128;
const FMT_LENGTH: usize = 89;
/// Bytes before the fields.
const HEAD: usize = 3;

/// A declared record: where each field is, and of which kind.
struct RecordLayout {
    name: String,
    length: usize,
    fields: Vec<(String, u8, usize)>,
}

/// Bytes of a field of this kind; `None` for a kind that is not known.
fn size(kind: u8) -> Option<usize> {
    Some(match kind {
        b'b' | b'B' | b'M' => 1,
        b'h' | b'H' | b'c' | b'C' | b'g' => 2,
        b'i' | b'I' | b'e' | b'E' | b'L' | b'f' | b'n' => 4,
        b'd' | b'q' | b'Q' => 8,
        b'N' => 16,
        b'Z' | b'a' => 64,
        _ => return None,
    })
}

fn array<const N: usize>(bytes: &[u8]) -> Option<[u8; N]> {
    bytes.get(..N)?.try_into().ok()
}

/// Value of a field of this kind: centi-units as units, latitudes and longitudes in degrees times 10^7.
fn number(kind: u8, bytes: &[u8]) -> Option<f64> {
    Some(match kind {
        b'b' => i8::from_le_bytes(array(bytes)?).into(),
        b'B' | b'M' => (*bytes.first()?).into(),
        b'h' => i16::from_le_bytes(array(bytes)?).into(),
        b'H' => u16::from_le_bytes(array(bytes)?).into(),
        b'c' => f64::from(i16::from_le_bytes(array(bytes)?)) / 100.0,
        b'C' => f64::from(u16::from_le_bytes(array(bytes)?)) / 100.0,
        b'i' | b'L' => i32::from_le_bytes(array(bytes)?).into(),
        b'I' => u32::from_le_bytes(array(bytes)?).into(),
        b'e' => f64::from(i32::from_le_bytes(array(bytes)?)) / 100.0,
        b'E' => f64::from(u32::from_le_bytes(array(bytes)?)) / 100.0,
        b'f' => f32::from_le_bytes(array(bytes)?).into(),
        b'd' => f64::from_le_bytes(array(bytes)?),
        b'q' => i64::from_le_bytes(array(bytes)?) as f64,
        b'Q' => u64::from_le_bytes(array(bytes)?) as f64,
        _ => return None,
    })
}

fn text(bytes: &[u8]) -> String {
    let text = bytes.split(|&c| c == 0).next().unwrap_or_default();
    String::from_utf8_lossy(text).into_owned()
}

impl RecordLayout {
    /// From the fields of an FMT record: type, length, name (4), kinds (16), labels (64).
    fn parse(record: &[u8]) -> Option<(u8, Self)> {
        let (kind, length) = (*record.first()?, usize::from(*record.get(1)?));
        let (name, kinds) = (text(record.get(2..6)?), text(record.get(6..22)?));
        let labels = text(record.get(22..86)?);
        let mut at = 0;
        let mut fields = Vec::new();
        for (kind, label) in kinds.bytes().zip(labels.split(',')) {
            fields.push((label.trim().into(), kind, at));
            at += size(kind)?;
        }
        (length >= HEAD && at <= length - HEAD).then_some((kind, Self { name, length, fields }))
    }

    fn get(&self, fields: &[u8], label: &str) -> Option<f64> {
        let (_, kind, at) = self.fields.iter().find(|(known, ..)| known == label)?;
        number(*kind, fields.get(*at..)?)
    }
}

/// Records have no checksum: removes samples whose time is off by more than a minute from those before and after, which
/// agree.
fn drop_wild_times(samples: &mut Vec<FlightSample>) {
    const MINUTE_US: u64 = 60_000_000;
    let times: Vec<i64> = samples.iter().map(FlightSample::time_us).collect();
    let far = |a: i64, b: i64| a.abs_diff(b) > MINUTE_US;
    let mut at = 0..times.len();
    samples.retain(|_| {
        let Some(i) = at.next() else { return true };
        let around = times.get(i.saturating_sub(1)..).and_then(|times| times.first_chunk());
        let Some(&[before, time, after]) = around.filter(|_| i > 0) else { return true };
        far(before, after) || !far(time, before)
    });
}

/// Samples of a log, in its order.
///
/// # Errors
/// [`FlightLogError::Nothing`] where there is neither attitude nor position.
pub fn read(path: &Path, bytes: &[u8]) -> Result<Vec<FlightSample>, FlightLogError> {
    let mut layouts = HashMap::new();
    let mut samples = Vec::new();
    let mut velocity = [0.0; 3];
    let mut at = 0;
    while let Some((&[first, second, kind], rest)) =
        bytes.get(at..).and_then(|rest| rest.split_first_chunk::<HEAD>())
    {
        let layout = layouts.get(&kind);
        let length = match kind {
            FMT => Some(FMT_LENGTH),
            _ => layout.map(|layout: &RecordLayout| layout.length),
        };
        // Records have no checksum; one that the next does not follow at once is taken for damaged.
        let whole = length
            .filter(|_| [first, second] == MAGIC)
            .and_then(|length| rest.split_at_checked(length.saturating_sub(HEAD)))
            .filter(|(_, next)| next.iter().zip(MAGIC).all(|(&a, b)| a == b));
        let Some((fields, _)) = whole else {
            // Damaged, or of a type that was never declared: the next record is searched.
            at += 1;
            continue;
        };
        at += HEAD + fields.len();
        if kind == FMT {
            layouts.extend(RecordLayout::parse(fields));
            continue;
        }
        let Some(layout) = layout else { continue };
        let get = |label: &str| layout.get(fields, label);
        let first_core = get("C").or(get("I")).unwrap_or(0.0) == 0.0;
        let Some(time_us) = get("TimeUS").and_then(FlightSample::time) else { continue };
        match layout.name.as_str() {
            "ATT" => {
                if let (Some(roll), Some(pitch), Some(yaw)) =
                    (get("Roll"), get("Pitch"), get("Yaw"))
                {
                    let euler = [roll, pitch, yaw].map(f64::to_radians);
                    samples.push(FlightSample::from_euler(time_us, euler));
                }
            }
            // Estimates of the Kalman filters: north, east, down in m/s.
            "XKF1" | "NKF1" if first_core => {
                if let (Some(n), Some(e), Some(d)) = (get("VN"), get("VE"), get("VD")) {
                    velocity = [n, e, d];
                }
            }
            "POS" => {
                if let (Some(lat), Some(lng), Some(alt)) = (get("Lat"), get("Lng"), get("Alt")) {
                    let place = [lat / 1e7, lng / 1e7, alt];
                    samples.push(FlightSample::Position { time_us, place, velocity });
                }
            }
            _ => {}
        }
    }
    drop_wild_times(&mut samples);
    if samples.is_empty() {
        return Err(FlightLogError::Nothing { path: path.into(), wanted: "ATT or POS" });
    }
    Ok(samples)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::format;

    fn fmt(kind: u8, name: &str, kinds: &str, labels: &str) -> Vec<u8> {
        let length = HEAD + kinds.bytes().map(|kind| size(kind).unwrap()).sum::<usize>();
        let mut record = Vec::from([MAGIC[0], MAGIC[1], FMT, kind, length as u8]);
        for (text, length) in [(name, 4), (kinds, 16), (labels, 64)] {
            let end = record.len() + length;
            record.extend(text.bytes());
            record.resize(end, 0);
        }
        record
    }

    /// 50 attitudes and positions, 0.1 s apart; a damaged place after the tenth.
    pub fn log() -> Vec<u8> {
        let mut log = fmt(FMT, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns");
        log.extend(fmt(1, "ATT", "QccccCC", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw"));
        log.extend(fmt(2, "POS", "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt"));
        log.extend(fmt(3, "XKF1", "QBfff", "TimeUS,C,VN,VE,VD"));
        log.extend(fmt(4, "ODD", "QM", "TimeUS,Mode"));
        for i in 0..50u64 {
            let time = (5_000_000 + i * 100_000).to_le_bytes();
            log.extend([MAGIC[0], MAGIC[1], 1]);
            log.extend(time);
            for angle in [0i16, 300, 0, -1000, 0, 9000] {
                log.extend(angle.to_le_bytes());
            }
            for core in [0u8, 1] {
                log.extend([MAGIC[0], MAGIC[1], 3]);
                log.extend(time);
                log.push(core);
                for v in [3.0f32, 4.0, f32::from(core) * 100.0 - 0.5] {
                    log.extend(v.to_le_bytes());
                }
            }
            log.extend([MAGIC[0], MAGIC[1], 2]);
            log.extend(time);
            log.extend(473_769_000i32.to_le_bytes());
            log.extend(85_417_000i32.to_le_bytes());
            for v in [512.5f32, 0.0, 0.0] {
                log.extend(v.to_le_bytes());
            }
            if i == 10 {
                log.extend(b"\xA3\x95\x01 damaged \xA3\x95\x63");
            }
        }
        log
    }

    #[test]
    fn attitudes_and_positions() {
        let samples = read(Path::new("a.bin"), &log()).unwrap();
        let attitudes =
            samples.iter().filter(|s| matches!(s, FlightSample::Attitude { .. })).count();
        assert_eq!(attitudes, 50, "that of the damaged place is none");
        let want = FlightSample::from_euler(5_000_000, [3.0, -10.0, 90.0].map(f64::to_radians));
        assert_eq!(samples[0], want);
        let place = [47.3769, 8.5417, 512.5];
        let velocity = [3.0, 4.0, -0.5];
        assert_eq!(samples[1], FlightSample::Position { time_us: 5_000_000, place, velocity });
    }

    #[test]
    fn a_log_without_flight_is_named() {
        let error = read(Path::new("a.bin"), &fmt(1, "MSG", "QZ", "TimeUS,Message")).unwrap_err();
        assert!(format!("{error}").starts_with("a.bin: no ATT or POS"), "{error}");
    }

    /// A time that is none, as a double of any size.
    #[test]
    fn wild_times_are_left_out() {
        let mut log = fmt(FMT, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns");
        log.extend(fmt(1, "ATT", "dfff", "TimeUS,Roll,Pitch,Yaw"));
        for time in [f64::MIN, f64::MAX, f64::NAN, -1.0, 1e16, 5e6] {
            log.extend([MAGIC[0], MAGIC[1], 1]);
            log.extend(time.to_le_bytes());
            log.extend([0; 12]);
        }
        let samples = read(Path::new("a.bin"), &log).unwrap();
        assert_eq!(samples.iter().map(FlightSample::time_us).collect::<Vec<_>>(), [5_000_000]);
    }

    proptest! {
        #[test]
        fn damaged_logs_are_read_on(changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..40)) {
            let mut bytes = log();
            for (place, byte) in changes {
                let place = place.index(bytes.len());
                bytes[place] = byte;
            }
            let count = read(Path::new("a.bin"), &bytes).map_or(0, |samples| samples.len());
            prop_assert!(count <= 110);
        }
    }
}
