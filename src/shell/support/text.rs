//! Text files as people's programs write them.

use std::io;
use std::path::Path;
use std::string::String;
use std::vec::Vec;

/// Reads a text of any length; see [`decode`].
///
/// # Errors
/// The system's; [`io::ErrorKind::InvalidData`] for other encodings.
pub fn read_text(path: &Path) -> io::Result<String> {
    decode(std::fs::read(path)?)
}

/// The text of bytes in UTF-8, with or without a byte-order mark, or in UTF-16 with one, as Windows' tools write it.
///
/// # Errors
/// [`io::ErrorKind::InvalidData`] for other encodings.
pub fn decode(bytes: Vec<u8>) -> io::Result<String> {
    let invalid = || io::Error::new(io::ErrorKind::InvalidData, "not a text in UTF-8 or UTF-16");
    let wide = |text: &[u8], from: fn([u8; 2]) -> u16| {
        let (pairs, rest) = text.as_chunks();
        let units: Vec<u16> = pairs.iter().map(|pair| from(*pair)).collect();
        if rest.is_empty() { String::from_utf16(&units).ok() } else { None }
    };
    match bytes.as_slice() {
        [0xef, 0xbb, 0xbf, text @ ..] => String::from_utf8(text.to_vec()).map_err(|_| invalid()),
        [0xff, 0xfe, text @ ..] => wide(text, u16::from_le_bytes).ok_or_else(invalid),
        [0xfe, 0xff, text @ ..] => wide(text, u16::from_be_bytes).ok_or_else(invalid),
        _ => String::from_utf8(bytes).map_err(|_| invalid()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_mark_is_read_and_taken_off() {
        let text = "fps: 30, caf\u{e9} \u{1f600}";
        let utf16: Vec<u16> = std::iter::once(0xfeff).chain(text.encode_utf16()).collect();
        let forms: [Vec<u8>; 4] = [
            text.into(),
            [&[0xef, 0xbb, 0xbf], text.as_bytes()].concat(),
            utf16.iter().flat_map(|unit| unit.to_le_bytes()).collect(),
            utf16.iter().flat_map(|unit| unit.to_be_bytes()).collect(),
        ];
        for bytes in forms {
            assert_eq!(decode(bytes).unwrap(), text);
        }
        for bad in [&b"caf\xe9"[..], b"\xff\xfea", b"\xff\xfe\x00\xd8", b"\xef\xbb\xbf\xff"] {
            assert_eq!(decode(bad.into()).unwrap_err().kind(), io::ErrorKind::InvalidData);
        }
        assert_eq!(decode(Vec::new()).unwrap(), "");
    }
}
