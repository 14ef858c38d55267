//! The first line of a y4m stream, and how the samples of its frames lie.

use crate::shell::sources::interlaced::FieldOrder;
use core::str;
use std::format;
use std::string::String;

/// Largest width and height, pixels.
const SIDE: usize = 16_384;

/// Size, rate and samples of a stream.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header {
    /// Pixels in a row.
    pub width: usize,
    /// Number of rows of pixels.
    pub height: usize,
    /// Frames a second as a fraction; `None` where the stream does not say (`F0:0`, and `F0:1` of live sources).
    pub rate: Option<(u32, u32)>,
    /// Bits of a sample, 8 to 16. Above 8 it takes two bytes, the lower one first.
    pub depth: u32,
    /// Bytes behind the luma plane that are skipped.
    pub skipped: u64,
    /// Whether luma is black at 16 and white at 235, times 2^(depth - 8).
    pub limited_range: bool,
    /// The earlier field of an interlaced stream.
    pub interlaced: Option<FieldOrder>,
    /// Whether a line `FRAME` begins every frame.
    pub framed: bool,
}

impl Header {
    /// Parses a header line without its end.
    ///
    /// # Errors
    /// The field, what it is and what is expected.
    pub fn parse(line: &[u8]) -> Result<Self, String> {
        let fields = line
            .strip_prefix(b"YUV4MPEG2")
            .ok_or("it does not begin with YUV4MPEG2; is this a .y4m file?")?;
        let fields = str::from_utf8(fields).map_err(|_| "it is not text")?;
        let (mut width, mut height, mut rate) = (None, None, Some((25, 1)));
        let (mut samples, mut full_range, mut interlaced) = ("420", false, None);
        for field in fields.split_ascii_whitespace() {
            match field.split_at_checked(1) {
                Some(("W", value)) => width = Some(parse_side("width W", value)?),
                Some(("H", value)) => height = Some(parse_side("height H", value)?),
                Some(("F", value)) => rate = parse_rate(value)?,
                Some(("C", value)) => samples = value,
                Some(("X", value)) => full_range |= value.eq_ignore_ascii_case("COLORRANGE=FULL"),
                // Mixed streams say for each frame which field is the earlier one; nearly always the top one.
                Some(("I", "t" | "m")) => interlaced = Some(FieldOrder::Top),
                Some(("I", "b")) => interlaced = Some(FieldOrder::Bottom),
                // Aspect and comments do not change the samples.
                _ => {}
            }
        }
        let width = width.ok_or("width W is missing")?;
        let height = height.ok_or("height H is missing")?;
        let (chroma, depth) = layout(samples, width, height).ok_or_else(|| {
            format!(
                "colour space C is '{samples}', expected mono, 411, 420, 422 or 444, with 8 to 16 bits (as 420p10 or \
                 mono16); convert it with ffmpeg -pix_fmt gray"
            )
        })?;
        let bytes = if depth > 8 { 2 } else { 1 };
        Ok(Self {
            width,
            height,
            rate,
            depth,
            skipped: (chroma * bytes) as u64,
            limited_range: !samples.starts_with("mono") && !full_range,
            interlaced,
            framed: true,
        })
    }

    /// A stream of frames without any header: their size is known from elsewhere.
    pub fn raw(layout: RawLayout, width: usize, height: usize) -> Self {
        let skipped = match layout {
            RawLayout::Grey => 0,
            RawLayout::I420 | RawLayout::Nv12 => 2 * width.div_ceil(2) * height.div_ceil(2),
        };
        Self {
            width,
            height,
            rate: None,
            depth: 8,
            skipped: skipped as u64,
            limited_range: layout != RawLayout::Grey,
            interlaced: None,
            framed: false,
        }
    }

    /// A sample as full-range grey.
    #[expect(clippy::cast_possible_truncation, reason = "the quotient is at most 255")]
    pub fn grey(&self, sample: u16) -> u8 {
        let most = (1u32 << self.depth) - 1;
        let (black, range) = if self.limited_range {
            (16 << (self.depth - 8), 219 << (self.depth - 8))
        } else {
            (0, most)
        };
        let above = u32::from(sample).clamp(black, black + range) - black;
        // At most 65535 * 255.
        ((above * 255 + range / 2) / range) as u8
    }
}

/// Samples of frames that come without a header.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Deserialize)]
pub enum RawLayout {
    /// 8 bits of grey, full range.
    #[serde(rename = "GRAY8")]
    Grey,
    /// A plane of luma and two of chroma, 4:2:0, limited range.
    I420,
    /// A plane of luma and one of chroma, 4:2:0, limited range.
    #[serde(rename = "NV12")]
    Nv12,
}

/// Samples besides the luma, and bits of each.
fn layout(samples: &str, width: usize, height: usize) -> Option<(usize, u32)> {
    let (half, halves) = (width.div_ceil(2), height.div_ceil(2));
    if let Some(depth) = samples.strip_prefix("mono") {
        return Some((0, if depth.is_empty() { 8 } else { depth_of(depth)? }));
    }
    if samples == "444alpha" {
        return Some((3 * width * height, 8));
    }
    let planes = [
        ("420", half * halves),
        ("422", half * height),
        ("411", width.div_ceil(4) * height),
        ("444", width * height),
    ];
    let (plane, rest) =
        planes.into_iter().find_map(|(name, plane)| Some((plane, samples.strip_prefix(name)?)))?;
    let depth = match rest {
        "" => 8,
        "jpeg" | "mpeg2" | "paldv" if samples.starts_with("420") => 8,
        _ => depth_of(rest.strip_prefix('p')?)?,
    };
    Some((2 * plane, depth))
}

fn depth_of(text: &str) -> Option<u32> {
    text.parse().ok().filter(|depth| (9..=16).contains(depth))
}

fn parse_side(field: &str, value: &str) -> Result<usize, String> {
    value
        .parse()
        .ok()
        .filter(|side| (1..=SIDE).contains(side))
        .ok_or_else(|| format!("{field} is '{value}', expected a number from 1 to {SIDE}"))
}

fn parse_rate(value: &str) -> Result<Option<(u32, u32)>, String> {
    let parts = value.split_once(':').and_then(|(n, d)| Some((n.parse().ok()?, d.parse().ok()?)));
    match parts {
        Some((0, 0 | 1)) => Ok(None),
        Some((frames, seconds)) if frames > 0 && seconds > 0 => Ok(Some((frames, seconds))),
        _ => Err(format!("frame rate F is '{value}', expected for example 30:1")),
    }
}
