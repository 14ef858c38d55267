//! Bytes as they come over a serial line, for the reader of MAVLink frames.

use embedded_io::{ErrorType, Read};

/// Bytes given at once at most.
const ROOM: usize = 64;

/// The bytes that were not read yet.
#[derive(Debug)]
pub struct Feed {
    bytes: [u8; ROOM],
    start: usize,
    end: usize,
}

impl Feed {
    /// No byte.
    pub const fn new() -> Self {
        Self { bytes: [0; ROOM], start: 0, end: 0 }
    }

    /// Takes as many of `bytes` as there is room for once all before them are read; gives the others back.
    pub fn fill<'a>(&mut self, bytes: &'a [u8]) -> &'a [u8] {
        let (taken, rest) = bytes.split_at(bytes.len().min(ROOM));
        for (place, byte) in self.bytes.iter_mut().zip(taken) {
            *place = *byte;
        }
        (self.start, self.end) = (0, taken.len());
        rest
    }
}

impl ErrorType for Feed {
    type Error = core::convert::Infallible;
}

impl Read for Feed {
    /// 0 where all is read, whatever may come later.
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Self::Error> {
        let waiting = self.bytes.get(self.start..self.end).unwrap_or_default();
        let number = waiting.len().min(buffer.len());
        for (place, byte) in buffer.iter_mut().zip(waiting) {
            *place = *byte;
        }
        self.start += number;
        Ok(number)
    }
}
