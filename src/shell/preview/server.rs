//! The server: one thread, a bounded number of connections, a deadline for each step of each of them.
//!
//! No connection can hold up another one: sockets never block, and each gets a bounded piece of work a turn. When all places
//! are taken a newcomer gets the place of the one that was served longest ago.

use super::http::{MAX_REQUEST, RequestLine, Response};
use super::site::Site;
use mio::net::{TcpListener, TcpStream};
use mio::{Events, Interest, Poll, Registry, Token, Waker};
use std::io::{self, ErrorKind, Read, Write};
use std::net::{IpAddr, Shutdown};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use std::vec::Vec;

/// Most connections at once.
pub const MAX_CLIENTS: usize = 16;

/// How long a request may take to arrive.
const REQUEST: Duration = Duration::from_secs(5);

/// How long an answer may take to leave.
const ANSWER: Duration = Duration::from_secs(10);

/// How long a connection stays open with nothing asked.
const IDLE: Duration = Duration::from_secs(10);

/// How long what a client still says is read after the last answer: closed before, the answer could be lost.
const LEAVING: Duration = Duration::from_secs(1);

/// After the system refused a connection, as when it is out of files.
const REFUSED: Duration = Duration::from_millis(200);

/// Everything but the listener and the sockets is asked anyway: who woke us does not matter.
const ANY: Token = Token(0);

/// The server's own side.
pub struct Server {
    poll: Poll,
    listener: TcpListener,
    clients: Vec<Connection>,
    site: Site,
    stop: Arc<AtomicBool>,
}

impl Server {
    /// A bound server, to be [run](Self::run); the waker ends its waiting, to look at `stop`.
    ///
    /// # Errors
    /// The system's.
    pub fn new(
        listener: std::net::TcpListener,
        site: Site,
        stop: Arc<AtomicBool>,
    ) -> io::Result<(Self, Waker)> {
        listener.set_nonblocking(true)?;
        let mut listener = TcpListener::from_std(listener);
        let poll = Poll::new()?;
        poll.registry().register(&mut listener, ANY, Interest::READABLE)?;
        let waker = Waker::new(poll.registry(), ANY)?;
        Ok((Self { poll, listener, clients: Vec::new(), site, stop }, waker))
    }

    /// Serves until `stop`.
    ///
    /// # Errors
    /// The system's, when it cannot wait for connections any more.
    pub fn run(mut self) -> io::Result<()> {
        let mut events = Events::with_capacity(2 * MAX_CLIENTS);
        let mut timeout = None;
        loop {
            match self.poll.poll(&mut events, timeout) {
                Err(error) if error.kind() != ErrorKind::Interrupted => return Err(error),
                _ => {}
            }
            if self.stop.load(Ordering::Relaxed) {
                return Ok(());
            }
            let now = Instant::now();
            timeout = self.accept(now);
            let site = &mut self.site;
            self.clients.retain_mut(|client| {
                let wait = match client.turn(site, now) {
                    NextStep::Gone => return false,
                    NextStep::More => Duration::ZERO,
                    NextStep::Wait => client.deadline.saturating_duration_since(now),
                };
                timeout = Some(timeout.map_or(wait, |timeout| timeout.min(wait)));
                true
            });
        }
    }

    /// Accepts connections; returns the time after which to try again without an event.
    fn accept(&mut self, now: Instant) -> Option<Duration> {
        for _ in 0..MAX_CLIENTS {
            match self.listener.accept() {
                Ok((stream, _)) => {
                    if self.clients.len() == MAX_CLIENTS
                        && let Some((oldest, _)) =
                            self.clients.iter().enumerate().min_by_key(|(_, client)| client.served)
                    {
                        self.clients.swap_remove(oldest);
                    }
                    self.clients.extend(Connection::new(stream, self.poll.registry(), now));
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => return None,
                // A client that left before we looked is no trouble; what else there may be does not pass at once.
                Err(error) if error.kind() == ErrorKind::ConnectionAborted => {}
                Err(_) => return Some(REFUSED),
            }
        }
        Some(Duration::ZERO)
    }
}

/// A connection.
struct Connection {
    stream: TcpStream,
    from: IpAddr,
    step: Step,
    deadline: Instant,
    /// When it came, or got its last answer.
    served: Instant,
    /// Received bytes of an incomplete request, at most [`MAX_REQUEST`].
    request: Vec<u8>,
}

enum Step {
    /// Waits for the end of a request.
    Reading,
    /// A response is being sent.
    Writing { answer: Vec<u8>, sent: usize, close: bool },
    /// Reads until the client has closed, too.
    Leaving,
}

/// Next step for a client.
enum NextStep {
    /// Wait for an event of its socket.
    Wait,
    /// It wants another turn.
    More,
    /// Close the connection.
    Gone,
}

impl Connection {
    /// Nothing where the system does not let us watch it.
    fn new(mut stream: TcpStream, registry: &Registry, now: Instant) -> Option<Self> {
        registry.register(&mut stream, ANY, Interest::READABLE | Interest::WRITABLE).ok()?;
        stream.set_nodelay(true).ok()?;
        let (from, deadline) = (stream.peer_addr().ok()?.ip(), now + REQUEST);
        Some(Self { stream, from, step: Step::Reading, deadline, served: now, request: Vec::new() })
    }

    /// One step on the way, or as far as the socket lets it go.
    fn turn(&mut self, site: &mut Site, now: Instant) -> NextStep {
        if now >= self.deadline {
            return NextStep::Gone;
        }
        let done = match &self.step {
            Step::Reading => self.read(site, now),
            Step::Writing { .. } => self.write(now),
            Step::Leaving => self.leave(),
        };
        done.unwrap_or_else(|error| match error.kind() {
            ErrorKind::WouldBlock => NextStep::Wait,
            ErrorKind::Interrupted => NextStep::More,
            _ => NextStep::Gone,
        })
    }

    fn read(&mut self, site: &mut Site, now: Instant) -> io::Result<NextStep> {
        loop {
            let (answer, close) = match RequestLine::parse(&self.request) {
                Ok(None) => {
                    self.fill(now)?;
                    continue;
                }
                Ok(Some((request, length))) => {
                    let close = request.close;
                    let bytes = site
                        .answer(&request, self.from)
                        .into_bytes(close, request.method == "HEAD");
                    self.request.drain(..length);
                    (bytes, close)
                }
                Err(status) => {
                    let answer = Response::text(status, "no HTTP request, or too long a one");
                    (answer.into_bytes(true, false), true)
                }
            };
            self.step = Step::Writing { answer, sent: 0, close };
            self.deadline = now + ANSWER;
            return self.write(now);
        }
    }

    /// Reads once, at least a byte.
    fn fill(&mut self, now: Instant) -> io::Result<()> {
        let mut bytes = [0; MAX_REQUEST];
        let room = MAX_REQUEST.saturating_sub(self.request.len());
        let read = self.stream.read(bytes.get_mut(..room).unwrap_or_default())?;
        if read == 0 {
            return Err(ErrorKind::UnexpectedEof.into());
        }
        if self.request.is_empty() {
            self.deadline = self.deadline.min(now + REQUEST);
        }
        self.request.extend(bytes.iter().take(read));
        Ok(())
    }

    fn write(&mut self, now: Instant) -> io::Result<NextStep> {
        let Step::Writing { answer, sent, close } = &mut self.step else {
            return Ok(NextStep::More);
        };
        while *sent < answer.len() {
            match self.stream.write(answer.get(*sent..).unwrap_or_default())? {
                0 => return Err(ErrorKind::WriteZero.into()),
                written => *sent += written,
            }
        }
        self.served = now;
        if *close {
            self.stream.shutdown(Shutdown::Write)?;
            self.step = Step::Leaving;
            self.deadline = now + LEAVING;
        } else {
            self.step = Step::Reading;
            self.deadline = now + IDLE;
        }
        Ok(NextStep::More)
    }

    fn leave(&mut self) -> io::Result<NextStep> {
        match self.stream.read(&mut [0; MAX_REQUEST])? {
            0 => Ok(NextStep::Gone),
            _ => Ok(NextStep::More),
        }
    }
}
