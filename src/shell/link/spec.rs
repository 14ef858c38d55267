//! A link in words: `udpout:HOST:PORT`, `udpin:HOST:PORT`, `tcpout:HOST:PORT`, `tcpin:HOST:PORT`, `serial:DEV:BAUD`.

use std::fmt;
use std::str::FromStr;
use std::string::{String, ToString};

/// Address of the other end of a link, or of our own end where it is called.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Address {
    /// Sends UDP datagrams to `HOST:PORT`, receives those that come back.
    UdpOut(String),
    /// Receives UDP datagrams at `HOST:PORT`; sends to everyone who sent a valid frame within the last 10 s.
    UdpIn(String),
    /// Connects to `HOST:PORT`.
    TcpOut(String),
    /// Accepts up to four connections at `HOST:PORT`.
    TcpIn(String),
    /// A serial port.
    Serial {
        /// The device, as `/dev/ttyAMA0`.
        device: String,
        /// Bits a second.
        baud: u32,
    },
}

/// A link and its bandwidth.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LinkSpec {
    /// Address of the other end, or our own.
    pub address: Address,
    /// Bytes a second for everything but answers, see [`super::budget::Budget`]. Half of the capacity of a serial port, 20 000
    /// elsewhere.
    pub bytes_per_second: u32,
}

/// Error of a link specification.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "link '{text}': {reason}; write udpout:HOST:PORT, udpin:HOST:PORT, tcpout:HOST:PORT, tcpin:HOST:PORT or serial:DEVICE:BAUD"
)]
pub struct LinkSpecError {
    /// The specification as given.
    pub text: String,
    /// The part that is missing or wrong.
    pub reason: &'static str,
}

impl FromStr for LinkSpec {
    type Err = LinkSpecError;

    fn from_str(text: &str) -> Result<Self, LinkSpecError> {
        let error = |reason| LinkSpecError { text: text.into(), reason };
        let (kind, place) = text.split_once(':').ok_or(error("no kind before a colon"))?;
        let (host, last) = place.rsplit_once(':').ok_or(error("two colons are needed"))?;
        if host.is_empty() {
            return Err(error("no host or device"));
        }
        let port = || match last.parse::<u16>() {
            Ok(1..) => Ok(place.to_string()),
            _ => Err(error("the port is no number from 1 to 65535")),
        };
        let mut bytes_per_second = 20_000;
        let address = match kind {
            "udpout" => Address::UdpOut(port()?),
            "udpin" => Address::UdpIn(port()?),
            "tcpout" => Address::TcpOut(port()?),
            "tcpin" => Address::TcpIn(port()?),
            "serial" => {
                let baud = last.parse().ok().filter(|baud| (1200..=12_000_000).contains(baud));
                let baud: u32 =
                    baud.ok_or(error("the baud rate is no number from 1200 to 12000000"))?;
                // Ten bits a byte; the other half is left to the autopilot's own needs for this port.
                bytes_per_second = baud / 20;
                Address::Serial { device: host.into(), baud }
            }
            _ => return Err(error("unknown kind")),
        };
        Ok(Self { address, bytes_per_second })
    }
}

impl fmt::Display for LinkSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.address {
            Address::UdpOut(place) => write!(f, "udpout:{place}"),
            Address::UdpIn(place) => write!(f, "udpin:{place}"),
            Address::TcpOut(place) => write!(f, "tcpout:{place}"),
            Address::TcpIn(place) => write!(f, "tcpin:{place}"),
            Address::Serial { device, baud } => write!(f, "serial:{device}:{baud}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn words_and_back() {
        for text in [
            "udpout:127.0.0.1:14550",
            "udpin:0.0.0.0:14540",
            "tcpout:autopilot.local:5760",
            "tcpin:[::1]:5762",
            "serial:/dev/ttyAMA0:57600",
            "serial:/dev/serial/by-id/usb:1-1:921600",
        ] {
            assert_eq!(text.parse::<LinkSpec>().unwrap().to_string(), text);
        }
        assert_eq!("serial:/dev/ttyS0:57600".parse::<LinkSpec>().unwrap().bytes_per_second, 2880);
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (text, reason) in [
            ("", "kind"),
            ("udpin", "kind"),
            ("udpin:14550", "two colons"),
            ("udpout:host:0", "port"),
            ("udpout:host:99999", "port"),
            ("udpout::14550", "host"),
            ("serial:/dev/x:fast", "baud"),
            ("can:a:1", "unknown"),
        ] {
            let error = text.parse::<LinkSpec>().unwrap_err().to_string();
            assert!(error.contains(reason), "{text}: {error}");
        }
    }

    proptest! {
        #[test]
        fn any_words_are_an_error_or_a_link(text in ".{0,40}") {
            if let Ok(spec) = text.parse::<LinkSpec>() {
                prop_assert_eq!(spec.to_string().parse::<LinkSpec>().unwrap(), spec);
            }
        }
    }
}
