//! The bytes of a link: sockets and serial ports behind one interface.
//!
//! Reads wait a few milliseconds at most and then say `WouldBlock` or `TimedOut`, so that one thread can read and write.

use super::spec::Address;
use serialport::SerialPort;
use std::boxed::Box;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, ToSocketAddrs, UdpSocket};
use std::time::{Duration, Instant};
use std::vec::Vec;

/// How long a read waits.
const READ: Duration = Duration::from_millis(5);

/// A link that takes nothing for so long is broken.
const WRITE: Duration = Duration::from_millis(500);

/// How long a connection may take.
const CONNECT: Duration = Duration::from_secs(2);

/// Most peers that a `udpin` answers.
const PEERS: usize = 8;

/// A peer unheard for so long is gone.
const PEER: Duration = Duration::from_secs(10);

/// An open link.
#[derive(Debug)]
pub enum Transport {
    /// One peer, known beforehand.
    UdpOut(UdpSocket),
    /// Whoever speaks to us.
    UdpIn(UdpSocket, Vec<(SocketAddr, Instant)>),
    /// A connection.
    Tcp(TcpStream),
    /// A door, and the one who came in.
    TcpIn(TcpListener, Option<TcpStream>),
    /// A serial port.
    Serial(Box<dyn SerialPort>),
}

/// Whether a read gave nothing but the link is well.
pub fn is_idle(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}

fn idle() -> io::Error {
    ErrorKind::WouldBlock.into()
}

fn resolve(place: &str) -> io::Result<SocketAddr> {
    let none = || io::Error::new(ErrorKind::NotFound, "no address of this name");
    place.to_socket_addrs()?.next().ok_or_else(none)
}

fn tcp(stream: TcpStream) -> io::Result<TcpStream> {
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(READ))?;
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
        Ok(match address {
            Address::UdpOut(place) => {
                let peer = resolve(place)?;
                let any = if peer.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
                let socket = udp(resolve(any)?)?;
                socket.connect(peer)?;
                Self::UdpOut(socket)
            }
            Address::UdpIn(place) => Self::UdpIn(udp(resolve(place)?)?, Vec::new()),
            Address::TcpOut(place) => {
                Self::Tcp(tcp(TcpStream::connect_timeout(&resolve(place)?, CONNECT)?)?)
            }
            Address::TcpIn(place) => {
                let listener = TcpListener::bind(place)?;
                listener.set_nonblocking(true)?;
                Self::TcpIn(listener, None)
            }
            Address::Serial { device, baud } => {
                let port = serialport::new(device.as_str(), *baud).timeout(READ).open();
                Self::Serial(port.map_err(io::Error::from)?)
            }
        })
    }

    /// Sends a whole frame. To nobody where nobody is there yet.
    ///
    /// # Errors
    /// The system's; part of the frame may have gone, and the link is to be opened again.
    pub fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        match self {
            Self::UdpOut(socket) => match socket.send(frame) {
                // A datagram before nobody listened there.
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => Ok(()),
                sent => sent.map(drop),
            },
            Self::UdpIn(socket, peers) => {
                peers.retain(|(_, heard)| heard.elapsed() < PEER);
                // One peer that cannot be reached does not silence the others.
                peers.retain(|(peer, _)| socket.send_to(frame, peer).is_ok());
                Ok(())
            }
            Self::Tcp(stream) => stream.write_all(frame),
            Self::TcpIn(_, peer) => {
                if peer.as_mut().is_some_and(|stream| stream.write_all(frame).is_err()) {
                    *peer = None;
                }
                Ok(())
            }
            Self::Serial(port) => write_slowly(port, frame),
        }
    }
}

/// Writes to a port whose timeout is that of reads.
fn write_slowly(port: &mut Box<dyn SerialPort>, mut bytes: &[u8]) -> io::Result<()> {
    let start = Instant::now();
    while !bytes.is_empty() {
        match port.write(bytes) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(written) => bytes = &bytes[written..],
            Err(error) if is_idle(&error) && start.elapsed() < WRITE => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

impl Read for Transport {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::UdpOut(socket) => match socket.recv(buffer) {
                // An empty datagram is no end; a refused one was ours.
                Ok(0) => Err(idle()),
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => Err(idle()),
                read => read,
            },
            Self::UdpIn(socket, peers) => {
                let (read, peer) = socket.recv_from(buffer)?;
                match peers.iter_mut().find(|(known, _)| *known == peer) {
                    Some((_, heard)) => *heard = Instant::now(),
                    // Who does not speak MAVLink is not answered.
                    None if matches!(buffer[..read].first(), Some(0xFD | 0xFE)) => {
                        if peers.len() >= PEERS {
                            let oldest = (0..PEERS).min_by_key(|&i| peers[i].1).unwrap_or(0);
                            peers.swap_remove(oldest);
                        }
                        peers.push((peer, Instant::now()));
                    }
                    None => {}
                }
                if read == 0 { Err(idle()) } else { Ok(read) }
            }
            Self::Tcp(stream) => stream.read(buffer),
            Self::TcpIn(listener, peer) => {
                // The newest caller: the one before may have gone without a word.
                if let Ok((stream, _)) = listener.accept() {
                    *peer = Some(tcp(stream)?);
                }
                let Some(stream) = peer else {
                    std::thread::sleep(READ);
                    return Err(idle());
                };
                match stream.read(buffer) {
                    Err(error) if is_idle(&error) => Err(error),
                    Ok(read @ 1..) => Ok(read),
                    Ok(0) | Err(_) => {
                        *peer = None;
                        Err(idle())
                    }
                }
            }
            Self::Serial(port) => match port.read(buffer) {
                Ok(0) => Err(ErrorKind::UnexpectedEof.into()),
                read => read,
            },
        }
    }
}
