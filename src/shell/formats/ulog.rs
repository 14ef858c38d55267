//! PX4's logs (ULog, `.ulg`): attitude and position as the MAVLink messages that a telemetry log has.
//!
//! A header of 16 bytes, then messages: size (u16), type (u8), content, little-endian. `F` declares a format, `A` gives it
//! a number, `D` is data of that number. Source: <https://docs.px4.io/main/en/dev_log/ulog_file_format.html>.

use super::flight_sample::{FlightLogError, FlightSample};
use std::collections::HashMap;
use std::path::Path;
use std::string::String;
use std::vec::Vec;

/// First bytes of a log.
pub const MAGIC: [u8; 7] = [0x55, 0x4C, 0x6F, 0x67, 0x01, 0x12, 0x35];
/// Bytes of the header: magic, version, time of the start.
const HEADER: usize = 16;
/// Deepest nesting of formats; PX4's own are two deep.
const DEPTH: usize = 4;
/// Most elements of an array that are listed.
const ELEMENTS: usize = 64;
/// Most fields that are looked at for one topic, those of formats within it counted each time; PX4's topics have at most
/// some hundred. Without a bound formats within formats take hours.
const FIELDS: usize = 4096;
/// Longest data of a topic: the size of a message has 16 bits.
const LONGEST: usize = 65_535;

/// Fields of a format: name, type, place in bytes.
type FormatFields = Vec<(String, String, usize)>;

/// Bytes of a basic type.
fn size(kind: &str) -> Option<usize> {
    Some(match kind {
        "int8_t" | "uint8_t" | "bool" | "char" => 1,
        "int16_t" | "uint16_t" => 2,
        "int32_t" | "uint32_t" | "float" => 4,
        "int64_t" | "uint64_t" | "double" => 8,
        _ => return None,
    })
}

/// Bytes that a format takes; `None` where it, or one within it, is not declared, or it is longer than any message. Each
/// field takes one of `left`.
fn length(
    formats: &HashMap<String, String>,
    name: &str,
    depth: usize,
    left: &mut usize,
) -> Option<usize> {
    if let Some(size) = size(name) {
        return Some(size);
    }
    let format = formats.get(name).filter(|_| depth < DEPTH)?;
    let mut sum = 0;
    for field in format.split(';').filter(|field| !field.trim().is_empty()) {
        *left = left.checked_sub(1)?;
        let (kind, count, _) = declaration(field)?;
        sum = extended(sum, length(formats, kind, depth + 1, left)?, count)?;
    }
    Some(sum)
}

/// A length with `count` elements of `one` byte more, where that is not too long.
fn extended(length: usize, one: usize, count: usize) -> Option<usize> {
    one.checked_mul(count)?.checked_add(length).filter(|&length| length <= LONGEST)
}

/// `type[count] name`: type, count, name.
fn declaration(field: &str) -> Option<(&str, usize, &str)> {
    let (kind, name) = field.trim().split_once(' ')?;
    match kind.split_once('[') {
        Some((kind, count)) => {
            let count = count.strip_suffix(']')?.parse().ok().filter(|&count| count <= 65_536)?;
            Some((kind, count, name))
        }
        None => Some((kind, 1, name)),
    }
}

/// The fields of basic types; `q[2]` is the third element of q.
fn fields(formats: &HashMap<String, String>, name: &str) -> Option<FormatFields> {
    let mut all = FormatFields::new();
    let (mut at, mut left) = (0, FIELDS);
    for field in formats.get(name)?.split(';').filter(|field| !field.trim().is_empty()) {
        left = left.checked_sub(1)?;
        let (kind, count, name) = declaration(field)?;
        let one = length(formats, kind, 0, &mut left)?;
        let end = extended(at, one, count)?;
        if size(kind).is_some() {
            left = left.checked_sub(count.min(ELEMENTS))?;
            for i in 0..count.min(ELEMENTS) {
                let name = if count == 1 { name.into() } else { std::format!("{name}[{i}]") };
                all.push((name, kind.into(), at + i * one));
            }
        }
        at = end;
    }
    Some(all)
}

fn number(kind: &str, bytes: &[u8]) -> Option<f64> {
    let array = |bytes: &[u8]| bytes.get(..8).and_then(|b| <[u8; 8]>::try_from(b).ok());
    Some(match kind {
        "float" => f32::from_le_bytes(bytes.get(..4)?.try_into().ok()?).into(),
        "double" => f64::from_le_bytes(array(bytes)?),
        "uint64_t" => u64::from_le_bytes(array(bytes)?) as f64,
        "int32_t" => i32::from_le_bytes(bytes.get(..4)?.try_into().ok()?).into(),
        _ => return None,
    })
}

/// Data of one subscription.
struct Topic {
    name: String,
    fields: FormatFields,
}

impl Topic {
    fn get(&self, data: &[u8], name: &str) -> Option<f64> {
        let (_, kind, at) = self.fields.iter().find(|(known, ..)| known == name)?;
        number(kind, data.get(*at..)?)
    }
}

/// Samples of a log, in its order.
///
/// # Errors
/// [`FlightLogError::Nothing`] where there is neither attitude nor position.
pub fn read(path: &Path, bytes: &[u8]) -> Result<Vec<FlightSample>, FlightLogError> {
    let mut formats = HashMap::new();
    let mut topics: HashMap<u16, Topic> = HashMap::new();
    let mut samples = Vec::new();
    let mut velocity = [0.0; 3];
    let mut at = HEADER;
    while let Some(&[low, high, kind]) = bytes.get(at..at + 3).and_then(|head| head.first_chunk()) {
        let end = at + 3 + usize::from(u16::from_le_bytes([low, high]));
        let Some(content) = bytes.get(at + 3..end) else { break };
        at = end;
        match kind {
            b'F' => {
                let text = String::from_utf8_lossy(content);
                if let Some((name, format)) = text.split_once(':') {
                    formats.insert(name.into(), format.into());
                }
            }
            b'A' => {
                // Instance (u8), number (u16), name; of several sensors the first one.
                let Some((&[instance, low, high], name)) = content.split_first_chunk() else {
                    continue;
                };
                let name = String::from_utf8_lossy(name).into_owned();
                if instance == 0
                    && let Some(fields) = fields(&formats, &name)
                {
                    topics.insert(u16::from_le_bytes([low, high]), Topic { name, fields });
                }
            }
            b'D' => {
                let Some((&id, data)) = content.split_first_chunk() else { continue };
                let Some(topic) = topics.get(&u16::from_le_bytes(id)) else { continue };
                let get = |name: &str| topic.get(data, name);
                let all = |names: [&str; 3]| -> Option<[f64; 3]> {
                    let [a, b, c] = names.map(get);
                    Some([a?, b?, c?])
                };
                let Some(time_us) = get("timestamp").and_then(FlightSample::time) else { continue };
                match topic.name.as_str() {
                    "vehicle_attitude" => {
                        if let (Some(w), Some([x, y, z])) =
                            (get("q[0]"), all(["q[1]", "q[2]", "q[3]"]))
                        {
                            let quaternion = [w, x, y, z];
                            samples.push(FlightSample::Attitude { time_us, quaternion });
                        }
                    }
                    "vehicle_local_position" => {
                        velocity = all(["vx", "vy", "vz"]).unwrap_or(velocity)
                    }
                    "vehicle_global_position" => {
                        if let Some(place) = all(["lat", "lon", "alt"]) {
                            samples.push(FlightSample::Position { time_us, place, velocity });
                        }
                    }
                    _ => {}
                }
            }
            _ => {}
        }
    }
    if samples.is_empty() {
        let wanted = "vehicle_attitude or vehicle_global_position";
        return Err(FlightLogError::Nothing { path: path.into(), wanted });
    }
    Ok(samples)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    fn message(kind: u8, content: &[u8]) -> Vec<u8> {
        let mut message = Vec::from((content.len() as u16).to_le_bytes());
        message.push(kind);
        message.extend(content);
        message
    }

    /// 50 attitudes and positions, 0.1 s apart.
    pub fn log() -> Vec<u8> {
        let mut log = Vec::from(MAGIC);
        log.push(1);
        log.extend(5_000_000u64.to_le_bytes());
        log.extend(message(b'B', &[0; 40]));
        for format in [
            "vehicle_attitude:uint64_t timestamp;uint64_t timestamp_sample;float[4] q;uint8_t[4] _padding0;",
            "vehicle_global_position:uint64_t timestamp;double lat;double lon;float alt;",
            "vehicle_local_position:uint64_t timestamp;bool[8] flags;inner_s inner;float vx;float vy;float vz;",
            "inner_s:int16_t a;int16_t b;",
        ] {
            log.extend(message(b'F', format.as_bytes()));
        }
        for (id, name) in [
            (3u16, "vehicle_attitude"),
            (4, "vehicle_global_position"),
            (5, "vehicle_local_position"),
        ] {
            let [low, high] = id.to_le_bytes();
            log.extend(message(b'A', &[&[0, low, high], name.as_bytes()].concat()));
            log.extend(message(b'A', &[&[1, 9, 0], name.as_bytes()].concat()));
        }
        for i in 0..50u64 {
            let time = (5_000_000 + i * 100_000).to_le_bytes();
            let q: Vec<u8> =
                [0.5f32, 0.5, -0.5, 0.5].iter().flat_map(|v| v.to_le_bytes()).collect();
            log.extend(message(b'D', &[&[3, 0], &time[..], &time, &q].concat()));
            let v: Vec<u8> = [3.0f32, 4.0, -0.5].iter().flat_map(|v| v.to_le_bytes()).collect();
            log.extend(message(b'D', &[&[5, 0], &time[..], &[0; 12], &v].concat()));
            let place = [47.3769f64.to_le_bytes(), 8.5417f64.to_le_bytes()].concat();
            let alt = 512.5f32.to_le_bytes();
            log.extend(message(b'D', &[&[4, 0], &time[..], &place, &alt].concat()));
            // The second instance is another estimate.
            log.extend(message(b'D', &[&[9, 0], &time[..], &[0; 40]].concat()));
        }
        log
    }

    #[test]
    fn attitudes_and_positions() {
        let samples = read(Path::new("a.ulg"), &log()).unwrap();
        assert_eq!(samples.len(), 100);
        let quaternion = [0.5, 0.5, -0.5, 0.5];
        assert_eq!(samples[0], FlightSample::Attitude { time_us: 5_000_000, quaternion });
        let (place, velocity) = ([47.3769, 8.5417, 512.5], [3.0, 4.0, -0.5]);
        assert_eq!(samples[1], FlightSample::Position { time_us: 5_000_000, place, velocity });
    }

    /// Formats of thousands of formats, four deep: seconds, where all combinations took hours.
    #[test]
    fn formats_within_formats_are_bounded() {
        let many = |kind: &str| std::format!("{kind} x;").repeat(9_000);
        let mut log = Vec::from(MAGIC);
        log.resize(HEADER, 0);
        for (name, within) in [("a", "b"), ("b", "c"), ("c", "d"), ("d", "e"), ("e", "bool")] {
            log.extend(message(b'F', std::format!("{name}:{}", many(within)).as_bytes()));
        }
        // Longer than any message, and more elements than there is memory for.
        let huge = "uint64_t timestamp;double[65536] x;";
        log.extend(message(b'F', std::format!("huge:{huge}").as_bytes()));
        for id in 0..2000u16 {
            let [low, high] = id.to_le_bytes();
            let name = if id % 2 == 0 { "a" } else { "huge" };
            log.extend(message(b'A', &[&[0, low, high], name.as_bytes()].concat()));
            log.extend(message(b'D', &[&[low, high][..], &[7; 40]].concat()));
        }
        let start = std::time::Instant::now();
        let error = read(Path::new("a.ulg"), &log).unwrap_err();
        assert!(matches!(error, FlightLogError::Nothing { .. }), "{error}");
        assert!(start.elapsed().as_secs() < 20, "{:?}", start.elapsed());
    }

    proptest! {
        #[test]
        fn damaged_logs_do_not_panic(changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..40), cut: prop::sample::Index) {
            let mut bytes = log();
            for (place, byte) in changes {
                let place = place.index(bytes.len());
                bytes[place] = byte;
            }
            bytes.truncate(cut.index(bytes.len()));
            let count = read(Path::new("a.ulg"), &bytes).map_or(0, |samples| samples.len());
            prop_assert!(count <= 200);
        }
    }
}
