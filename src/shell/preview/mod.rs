//! The page for a look at a running lookout: picture, alert, health, latency, bearings.
//!
//! A small HTTP server on a thread of its own. Clients and their requests are bounded in number, size and time, whatever
//! they do; the detector's loop hands over a snapshot and never waits.

mod board;
pub mod snapshot;

use board::Board;
pub use snapshot::Snapshot;
use std::io;
use std::net::{SocketAddr, TcpListener};
use std::string::String;
use std::sync::Arc;

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
        /// The address.
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
        /// The address.
        address: SocketAddr,
        /// The system's reason.
        source: io::Error,
    },
}

/// The running server; dropped, it ends.
pub struct Preview {
    address: SocketAddr,
    board: Arc<Board>,
    listener: TcpListener,
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
        Ok(Self { address, board: Arc::default(), listener })
    }

    /// Where it listens.
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

/// Whether a token is long enough and can stand in an address as it is.
fn is_token(token: &str) -> bool {
    let plain = |c: u8| c.is_ascii_alphanumeric() || b"-._~".contains(&c);
    (TOKEN..=256).contains(&token.len()) && token.bytes().all(plain)
}
