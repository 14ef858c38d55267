//! Messages of ROS 2 as they stand in files: OMG's Common Data Representation.

use std::string::String;

/// Reads values one behind the other; each is aligned to its size, counted from the end of the header.
#[derive(Debug)]
pub struct Cdr<'a> {
    bytes: &'a [u8],
    at: usize,
    little_endian: bool,
}

impl<'a> Cdr<'a> {
    /// A message with its header of four bytes; none for other bytes.
    pub fn new(bytes: &'a [u8]) -> Option<Self> {
        let (&[0, representation, _, _], bytes) = bytes.split_first_chunk()? else { return None };
        // Plain CDR, 0 and 1, and plain CDR 2, 6 and 7; these differ for numbers of eight bytes alone.
        let known = matches!(representation, 0 | 1 | 6 | 7);
        known.then_some(Self { bytes, at: 0, little_endian: representation & 1 == 1 })
    }

    fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let taken = self.bytes.get(self.at..)?.get(..length)?;
        self.at += length;
        Some(taken)
    }

    /// Reads one byte; `None` at the end.
    pub fn byte(&mut self) -> Option<u8> {
        self.take(1)?.first().copied()
    }

    /// Reads an aligned 32-bit number in the stream's byte order; `None` at the end.
    pub fn word(&mut self) -> Option<u32> {
        self.at = self.at.next_multiple_of(4);
        let bytes = *self.take(4)?.first_chunk()?;
        Some(if self.little_endian { u32::from_le_bytes(bytes) } else { u32::from_be_bytes(bytes) })
    }

    /// A sequence of bytes.
    pub fn bytes(&mut self) -> Option<&'a [u8]> {
        let length = usize::try_from(self.word()?).ok()?;
        self.take(length)
    }

    /// A text, which ends with a zero.
    pub fn text(&mut self) -> Option<String> {
        let bytes = self.bytes()?;
        let text = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        Some(String::from_utf8_lossy(text).into_owned())
    }

    /// The time of a `std_msgs/Header`, nanoseconds; the frame's name is passed over.
    pub fn header(&mut self) -> Option<i64> {
        let (seconds, nanoseconds) = (self.word()?.cast_signed(), self.word()?);
        self.text()?;
        Some(i64::from(seconds) * 1_000_000_000 + i64::from(nanoseconds))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn values_are_aligned_and_of_either_order() {
        let little = [0, 1, 0, 0, 2, 0, 0, 0, 3, 0, 0, 0, 2, 0, 0, 0, b'a', 0, 9, 0, 7, 0, 0, 0];
        let big = [0, 0, 0, 0, 0, 0, 0, 2, 0, 0, 0, 3, 0, 0, 0, 2, b'a', 0, 9, 0, 0, 0, 0, 7];
        for bytes in [little, big] {
            let mut cdr = Cdr::new(&bytes).unwrap();
            assert_eq!(cdr.header(), Some(2_000_000_003));
            assert_eq!((cdr.byte(), cdr.word(), cdr.word()), (Some(9), Some(7), None));
        }
        for other in [&[][..], &[0, 1, 0], &[1, 1, 0, 0], &[0, 3, 0, 0]] {
            assert!(Cdr::new(other).is_none());
        }
        let long: Vec<u8> = [&[0, 1, 0, 0][..], &u32::MAX.to_le_bytes()].concat();
        assert_eq!(Cdr::new(&long).unwrap().bytes(), None);
    }
}
