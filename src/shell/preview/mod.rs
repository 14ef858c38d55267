//! The page for a look at a running lookout: picture, alert, health, latency, bearings.
//!
//! A small HTTP server on a thread of its own. Clients and their requests are bounded in number, size and time, whatever
//! they do; the detector's loop hands over a snapshot and never waits.
//!
//! | address | what is there |
//! | --- | --- |
//! | `/` | the page, one file without anything from elsewhere |
//! | `/state.json` | the newest [`Snapshot`] without its picture, and its age |
//! | `/frame.jpg` | the newest picture; what was followed in it stands in the field `Lookout-Tracks` |
//! | `/healthz` | for monitors: 200 while it watches, else 503 and the reason |
//! | `/register_service` | for BlueOS: name, version and icon of the page |
//!
//! The page asks for pictures one by one, the next when the last has come: over a bad link there are fewer of them, but none
//! is late, as it would be in a stream. HTTP is read by the crate `httparse` and sockets are waited for by `mio`; servers that
//! give every connection a thread, or that have no deadlines, would let any client take what the detector needs.

mod board;
mod guesses;
pub(super) mod http;
mod server;
mod site;
pub mod snapshot;

use board::Board;
use server::Server;
use site::Site;
pub use snapshot::Snapshot;
use std::net::{SocketAddr, TcpListener};
use std::string::String;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::{fmt, io};

/// Fewest characters of a token.
const TOKEN: usize = 16;

/// Why there is no page.
#[derive(Debug, thiserror::Error)]
pub enum PreviewError {
    /// Others reach the address, and nothing keeps them out.
    #[error(
        "preview {address}: others can reach this address; give a preview_token of {TOKEN} or more characters, or \
        listen at 127.0.0.1"
    )]
    NoToken {
        /// Address to listen on.
        address: SocketAddr,
    },
    /// A token that is easily guessed, or cannot stand in an address.
    #[error(
        "preview_token: write {TOKEN} to 256 characters, of letters, digits, '-', '.', '_' and '~'"
    )]
    Token,
    /// The system refuses the address, or a thread.
    #[error("preview {address}: {source}; take another port, or leave preview out")]
    Start {
        /// Address to listen on.
        address: SocketAddr,
        /// The system's reason.
        source: io::Error,
    },
}

/// The running server; dropped, it ends.
pub struct Preview {
    address: SocketAddr,
    board: Arc<Board>,
    stop: Arc<AtomicBool>,
    waker: mio::Waker,
    thread: Option<JoinHandle<()>>,
}

impl Preview {
    /// Starts the server at `address`; port 0 takes a free one. With `token` only who gives it sees anything.
    ///
    /// # Errors
    /// [`PreviewError`]: an address that others reach wants a token.
    pub fn start(address: SocketAddr, token: Option<String>) -> Result<Self, PreviewError> {
        match &token {
            Some(token) if !is_token(token) => return Err(PreviewError::Token),
            None if !address.ip().is_loopback() => return Err(PreviewError::NoToken { address }),
            _ => {}
        }
        let start = |source| PreviewError::Start { address, source };
        let listener = TcpListener::bind(address).map_err(start)?;
        let address = listener.local_addr().map_err(start)?;
        let board = Arc::<Board>::default();
        let stop = Arc::<AtomicBool>::default();
        let site = Site::new(board.clone(), token, address.ip());
        let (server, waker) = Server::new(listener, site, stop.clone()).map_err(start)?;
        let serve = move || {
            if let Err(error) = server.run() {
                tracing::error!(
                    "preview {address}: {error}; the page is gone, the lookout goes on"
                );
            }
        };
        let thread = thread::Builder::new().name("preview".into()).spawn(serve).map_err(start)?;
        Ok(Self { address, board, stop, waker, thread: Some(thread) })
    }

    /// Address on which the server listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Whether the next snapshot should bring its picture: somebody looked of late, and the last picture is old enough.
    pub fn wants_picture(&self) -> bool {
        self.board.wants_picture()
    }

    /// Shows `snapshot` from now on in place of the one before. Never waits for a client.
    pub fn publish(&self, snapshot: Snapshot) {
        self.board.publish(snapshot);
    }
}

impl Drop for Preview {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // A thread that cannot be woken is left to itself; one that panicked has said so.
        if let (Ok(()), Some(thread)) = (self.waker.wake(), self.thread.take()) {
            let _ = thread.join();
        }
    }
}

impl fmt::Debug for Preview {
    /// Without the token.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Preview").field("address", &self.address).finish_non_exhaustive()
    }
}

/// Whether a token is long enough and can stand in an address as it is.
pub fn is_token(token: &str) -> bool {
    let plain = |c: u8| c.is_ascii_alphanumeric() || b"-._~".contains(&c);
    (TOKEN..=256).contains(&token.len()) && token.bytes().all(plain)
}
