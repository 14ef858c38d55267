//! Every frame as a line of JSON in a UDP datagram: for programs on board or on the ground that do not speak MAVLink.
//!
//! The line is that of `lookout replay --jsonl`, with `time_us` in microseconds since 1970. A datagram that nobody takes is
//! lost; nothing waits for it.

use super::worker::ProcessedFrame;
use super::writer::Writer;
use crate::shell::formats::detections;
use crate::shell::support::clock;
use crate::tracking::traffic::Traffic;
use std::io::{self, ErrorKind};
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs, UdpSocket};
use std::string::String;

/// Lines that wait to be sent at most: two seconds of a fast camera.
const WAITING: usize = 120;

/// `HOST:PORT` of `udp:HOST:PORT`.
///
/// # Errors
/// The reason, for the settings.
pub fn address(text: &str) -> Result<&str, String> {
    let wrong = || String::from("expected udp:HOST:PORT");
    let place = text.strip_prefix("udp:").ok_or_else(wrong)?;
    let (host, port) = place.rsplit_once(':').ok_or_else(wrong)?;
    let good = !host.is_empty() && port.parse::<u16>().is_ok_and(|port| port > 0);
    good.then_some(place).ok_or_else(wrong)
}

/// Sends lines to one address.
#[derive(Debug)]
pub struct JsonStream(Writer<String>);

impl JsonStream {
    /// Starts the thread that sends; the host's name is looked up there, again until it is known.
    ///
    /// # Errors
    /// The system's, where there is no thread.
    pub fn open(place: &str) -> io::Result<Self> {
        let (place, mut socket) = (String::from(place), None);
        let send = move |line: String| {
            let socket = match &mut socket {
                Some(socket) => socket,
                none => none.insert(connect(&place)?),
            };
            match socket.send(line.as_bytes()) {
                // Nobody listens there yet, or no longer.
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => Ok(()),
                sent => sent.map(drop),
            }
        };
        Ok(Self(Writer::start("json", WAITING, send)?))
    }

    /// Takes a frame, its number in the run, and what is followed in it.
    pub fn see(&mut self, seen: &ProcessedFrame, tracks: &[Traffic], number: u64) {
        let time_us = seen.frame.time_us + clock::unix_offset_us();
        let mut line = detections::json_line(number, time_us, &seen.found, Some(tracks));
        // A datagram has a length of its own.
        line.truncate(line.trim_end().len());
        self.0.hand(line);
    }
}

fn connect(place: &str) -> io::Result<UdpSocket> {
    let to = place.to_socket_addrs()?.next();
    let to = to.ok_or_else(|| io::Error::new(ErrorKind::NotFound, "no address of that name"))?;
    let any: SocketAddr = match to {
        SocketAddr::V4(_) => (Ipv4Addr::UNSPECIFIED, 0).into(),
        SocketAddr::V6(_) => (Ipv6Addr::UNSPECIFIED, 0).into(),
    };
    let socket = UdpSocket::bind(any)?;
    socket.connect(to)?;
    Ok(socket)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_in_words() {
        assert_eq!(address("udp:127.0.0.1:9000"), Ok("127.0.0.1:9000"));
        assert_eq!(address("udp:[::1]:9000"), Ok("[::1]:9000"));
        assert_eq!(address("udp:ground.local:9000"), Ok("ground.local:9000"));
        for wrong in ["127.0.0.1:9000", "tcp:a:1", "udp:9000", "udp::9000", "udp:a:0", "udp:a:x"] {
            assert!(address(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_stream_without_a_listener_goes_on() {
        let listener = UdpSocket::bind("127.0.0.1:0").unwrap();
        let place = std::format!("{}", listener.local_addr().unwrap());
        drop(listener);
        let mut stream = JsonStream::open(&place).unwrap();
        for _ in 0..3 {
            assert!(stream.0.hand("{}".into()));
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
        let listener = UdpSocket::bind(&place).unwrap();
        listener.set_read_timeout(Some(std::time::Duration::from_secs(20))).unwrap();
        stream.0.hand("{}".into());
        // The answer of the port that was closed may still cost one.
        stream.0.hand("{}".into());
        let mut bytes = [0; 9];
        assert_eq!(listener.recv(&mut bytes).unwrap(), 2);
    }
}
