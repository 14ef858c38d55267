//! Parsers that are private elsewhere, for the targets in `fuzz/`; no part of the interface.

use super::link::transport;
use super::preview::http::RequestLine;
use super::sources::v4l2::mjpeg::MjpegDecoder;
use mavlink_core::MAVLinkMessageRaw;
use std::vec;
use std::vec::Vec;

/// What one peer of a link sends.
#[derive(Debug, Default)]
pub struct LinkBytes(transport::PeerDecoder);

impl LinkBytes {
    /// The frames that are complete with `bytes`.
    pub fn receive(&mut self, bytes: &[u8]) -> Vec<MAVLinkMessageRaw> {
        let mut frames = Vec::new();
        self.0.decode(bytes, &mut |frame| {
            frames.push(frame);
            true
        });
        frames
    }

    /// Bytes that were not looked at.
    pub fn kept(&self) -> usize {
        self.0.waiting()
    }
}

/// Length of the request at the start of `bytes`; `None` where there is none.
pub fn http_request(bytes: &[u8]) -> Option<usize> {
    RequestLine::parse(bytes).ok().flatten().map(|(_, length)| length)
}

/// Grey pixels of a JPEG picture of `size`, width and height; `None` where it is damaged.
pub fn motion_jpeg(picture: &[u8], size: (usize, usize)) -> Option<Vec<u8>> {
    let mut pixels = vec![0; size.0 * size.1];
    MjpegDecoder::default().decode(picture, size, &mut pixels).ok().map(|()| pixels)
}
