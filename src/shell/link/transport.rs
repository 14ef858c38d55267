//! The bytes of a link: sockets and serial ports behind one interface.
//!
//! Every read is bounded in bytes and waits a few milliseconds at most, so that one thread can read and write whatever
//! comes in. Each peer has a decoder of its own: what one sends cannot hide a frame of another.

use super::spec::Address;
use crate::mavlink::dialect::ArduPilotFrames;
use mavlink_core::{MAVLinkMessageRaw, MavlinkReader};
use serialport::SerialPort;
use std::boxed::Box;
use std::collections::VecDeque;
use std::fmt;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, ToSocketAddrs, UdpSocket};
use std::time::{Duration, Instant};
use std::vec::Vec;

/// Timeout of a read.
const READ: Duration = Duration::from_millis(5);

/// Timeout of a read of one of several TCP peers.
const READ_ONE: Duration = Duration::from_millis(1);

/// Time after which a link that takes nothing counts as broken.
const WRITE: Duration = Duration::from_millis(500);

/// Timeout of connecting.
const CONNECT: Duration = Duration::from_secs(2);

/// Bytes of one read at most; a UDP datagram that is longer is cut.
const BYTES: usize = 4096;

/// Bytes that a decoder reads ahead.
const DECODED: usize = 1024;

/// Most senders that a `udpin` knows, and most callers of a `tcpin`.
const SENDERS: usize = 16;
const CALLERS: usize = 4;

/// Time after which a peer without a valid frame counts as gone.
const GONE: Duration = Duration::from_secs(10);

/// Bytes that were received and not decoded yet; at their end there are none for now.
#[derive(Default)]
struct Received(VecDeque<u8>);

impl Read for Received {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.0.is_empty() { Err(idle()) } else { self.0.read(buffer) }
    }
}

/// Finds the frames in what one peer sends.
pub struct PeerDecoder {
    reader: MavlinkReader<Received>,
    /// When the last frame came that was accepted.
    heard: Option<Instant>,
}

impl fmt::Debug for PeerDecoder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Decoder").field("heard", &self.heard).finish_non_exhaustive()
    }
}

impl Default for PeerDecoder {
    fn default() -> Self {
        let reader = MavlinkReader::with_capacity(DECODED, Received::default());
        Self { reader, heard: None }
    }
}

impl PeerDecoder {
    /// Hands the frames that are complete with `bytes` to `accept`.
    pub fn decode(&mut self, bytes: &[u8], accept: &mut Accept) {
        self.reader.get_mut().0.extend(bytes);
        while let Ok(frame) = self.reader.read_any_raw_message_with_dialect(&ArduPilotFrames) {
            if accept(frame) {
                self.heard = Some(Instant::now());
            }
        }
    }

    /// Bytes that were received and not looked at; those of a frame that is not complete are not among them.
    pub fn waiting(&self) -> usize {
        self.reader.get_ref().0.len()
    }

    fn is_heard(&self) -> bool {
        self.heard.is_some_and(|heard| heard.elapsed() < GONE)
    }
}

/// Takes a frame with a right checksum; `false` where it is refused, as for its signature.
pub type Accept<'a> = dyn FnMut(MAVLinkMessageRaw) -> bool + 'a;

/// A sender of datagrams.
#[derive(Debug)]
pub struct UdpPeer {
    address: SocketAddr,
    decoder: PeerDecoder,
    last: Instant,
}

/// A connection that was accepted.
#[derive(Debug)]
pub struct TcpPeer {
    stream: TcpStream,
    decoder: PeerDecoder,
    since: Instant,
}

/// Socket or device of a link.
#[derive(Debug)]
enum Medium {
    /// Datagrams to and from one peer that is known beforehand.
    UdpOut(UdpSocket, PeerDecoder),
    /// Datagrams of whoever speaks to us.
    UdpIn(UdpSocket, Vec<UdpPeer>),
    /// A TCP connection.
    Tcp(TcpStream, PeerDecoder),
    /// Connections that come in.
    TcpIn(TcpListener, Vec<TcpPeer>),
    /// A serial port.
    Serial(Box<dyn SerialPort>, PeerDecoder),
}

/// An open link.
#[derive(Debug)]
pub struct Transport {
    medium: Medium,
    buffer: Box<[u8]>,
}

/// Whether a read gave nothing but the link is well.
fn is_idle(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}

fn idle() -> io::Error {
    ErrorKind::WouldBlock.into()
}

fn resolve(place: &str) -> io::Result<SocketAddr> {
    let none = || io::Error::new(ErrorKind::NotFound, "no address of this name");
    place.to_socket_addrs()?.next().ok_or_else(none)
}

fn tcp(stream: TcpStream, read: Duration) -> io::Result<TcpStream> {
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(read))?;
    stream.set_write_timeout(Some(WRITE))?;
    stream.set_nodelay(true)?;
    Ok(stream)
}

impl Transport {
    /// Opens a link.
    ///
    /// # Errors
    /// The system's, as when nobody listens there or the device is missing.
    pub fn open(address: &Address) -> io::Result<Self> {
        let udp = |place: SocketAddr| -> io::Result<UdpSocket> {
            let socket = UdpSocket::bind(place)?;
            socket.set_read_timeout(Some(READ))?;
            Ok(socket)
        };
        let medium = match address {
            Address::UdpOut(place) => {
                let peer = resolve(place)?;
                let any = if peer.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
                let socket = udp(resolve(any)?)?;
                socket.connect(peer)?;
                Medium::UdpOut(socket, PeerDecoder::default())
            }
            Address::UdpIn(place) => Medium::UdpIn(udp(resolve(place)?)?, Vec::new()),
            Address::TcpOut(place) => {
                let stream = TcpStream::connect_timeout(&resolve(place)?, CONNECT)?;
                Medium::Tcp(tcp(stream, READ)?, PeerDecoder::default())
            }
            Address::TcpIn(place) => {
                let listener = TcpListener::bind(place)?;
                listener.set_nonblocking(true)?;
                Medium::TcpIn(listener, Vec::new())
            }
            Address::Serial { device, baud } => {
                let port = serialport::new(device.as_str(), *baud).timeout(READ).open();
                Medium::Serial(port.map_err(io::Error::from)?, PeerDecoder::default())
            }
        };
        Ok(Self { medium, buffer: std::vec![0; BYTES].into() })
    }

    /// Sends a whole frame. To nobody where nobody is there yet.
    ///
    /// # Errors
    /// The system's; part of the frame may have gone, and the link must be opened again.
    pub fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        match &mut self.medium {
            Medium::UdpOut(socket, _) => match socket.send(frame) {
                // A datagram before nobody listened there.
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => Ok(()),
                sent => sent.map(drop),
            },
            Medium::UdpIn(socket, senders) => {
                // Only who sent a valid frame of late: a forged address must not get a stream for one byte. One peer
                // that cannot be reached does not silence the others.
                for sender in senders.iter().filter(|sender| sender.decoder.is_heard()) {
                    let _ = socket.send_to(frame, sender.address);
                }
                Ok(())
            }
            Medium::Tcp(stream, _) => stream.write_all(frame),
            Medium::TcpIn(_, callers) => {
                callers.retain_mut(|caller| caller.stream.write_all(frame).is_ok());
                Ok(())
            }
            Medium::Serial(port, _) => write_slowly(port, frame),
        }
    }

    /// Reads once, at most 4096 bytes of each peer, and hands every complete frame to `accept`. `false` where nothing came.
    ///
    /// # Errors
    /// The system's, and `UnexpectedEof` at the end of a connection.
    pub fn receive(&mut self, accept: &mut Accept) -> io::Result<bool> {
        let buffer = &mut self.buffer;
        let (read, decoder) = match &mut self.medium {
            Medium::UdpOut(socket, decoder) => match socket.recv(buffer) {
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => return Ok(false),
                // An empty datagram is no end.
                Ok(0) => return Ok(true),
                read => (read, decoder),
            },
            Medium::UdpIn(socket, senders) => match socket.recv_from(buffer) {
                Ok((read, address)) => match sender(senders, address) {
                    Some(sender) => (Ok(read), &mut sender.decoder),
                    None => return Ok(true),
                },
                Err(error) if is_idle(&error) => return Ok(false),
                Err(error) => return Err(error),
            },
            Medium::Tcp(stream, decoder) => (stream.read(buffer).and_then(not_the_end), decoder),
            Medium::TcpIn(listener, callers) => return call(listener, callers, buffer, accept),
            Medium::Serial(port, decoder) => (port.read(buffer).and_then(not_the_end), decoder),
        };
        match read {
            Ok(read) => decoder.decode(buffer.get(..read).unwrap_or_default(), accept),
            Err(error) if is_idle(&error) => return Ok(false),
            Err(error) => return Err(error),
        }
        Ok(true)
    }
}

fn not_the_end(read: usize) -> io::Result<usize> {
    if read == 0 { Err(ErrorKind::UnexpectedEof.into()) } else { Ok(read) }
}

/// The sender of this address. A new one takes the place of the one without a valid frame that spoke longest ago; there
/// is none where all are heard.
fn sender(senders: &mut Vec<UdpPeer>, address: SocketAddr) -> Option<&mut UdpPeer> {
    let now = Instant::now();
    let known = senders.iter().position(|sender| sender.address == address);
    let place = match known {
        Some(place) => place,
        None => {
            if senders.len() >= SENDERS {
                let unheard = senders.iter().enumerate().filter(|(_, s)| !s.decoder.is_heard());
                let oldest = unheard.min_by_key(|(_, sender)| sender.last)?.0;
                senders.swap_remove(oldest);
            }
            senders.push(UdpPeer { address, decoder: PeerDecoder::default(), last: now });
            senders.len() - 1
        }
    };
    let sender = senders.get_mut(place)?;
    sender.last = now;
    Some(sender)
}

/// Takes new callers, and reads once from each one. A new one takes the place of one that was not heard for some time, or
/// is refused.
fn call(
    listener: &TcpListener,
    callers: &mut Vec<TcpPeer>,
    buffer: &mut [u8],
    accept: &mut Accept,
) -> io::Result<bool> {
    for _ in 0..CALLERS {
        let Ok((stream, _)) = listener.accept() else { break };
        if callers.len() >= CALLERS {
            let silent =
                |caller: &TcpPeer| !caller.decoder.is_heard() && caller.since.elapsed() >= GONE;
            let Some(oldest) = callers.iter().position(silent) else { continue };
            callers.remove(oldest);
        }
        if let Ok(stream) = tcp(stream, READ_ONE) {
            callers.push(TcpPeer {
                stream,
                decoder: PeerDecoder::default(),
                since: Instant::now(),
            });
        }
    }
    let mut any = false;
    callers.retain_mut(|caller| match caller.stream.read(buffer).and_then(not_the_end) {
        Ok(read) => {
            any = true;
            caller.decoder.decode(buffer.get(..read).unwrap_or_default(), accept);
            true
        }
        Err(error) => is_idle(&error),
    });
    if callers.is_empty() {
        std::thread::sleep(READ);
    }
    Ok(any)
}

/// Writes to a port whose timeout is that of reads.
fn write_slowly(port: &mut Box<dyn SerialPort>, mut bytes: &[u8]) -> io::Result<()> {
    let start = Instant::now();
    while !bytes.is_empty() {
        match port.write(bytes) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(written) => bytes = bytes.get(written..).unwrap_or_default(),
            Err(error) if is_idle(&error) && start.elapsed() < WRITE => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}
