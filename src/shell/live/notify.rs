//! What a service tells its manager: ready, alive, how it is, about to end.
//!
//! Source of the protocol: sd_notify(3), datagrams of `NAME=VALUE` lines to the socket named by NOTIFY_SOCKET.

use crate::shell::support::clock::now_us;
use std::env;
use std::format;
#[cfg(unix)]
use std::os::unix::net::UnixDatagram;
use std::string::String;

/// The manager's socket; without a manager nothing is told.
#[derive(Debug, Default)]
pub struct Notify {
    #[cfg(unix)]
    socket: Option<UnixDatagram>,
    /// Microseconds after which the manager takes silence for a hang.
    watchdog_us: Option<i64>,
    fed_us: i64,
    status: String,
}

impl Notify {
    /// The manager that the environment names.
    pub fn from_environment() -> Self {
        let number = |name: &str| env::var(name).ok().and_then(|text| text.parse::<i64>().ok());
        let meant = number("WATCHDOG_PID").is_none_or(|pid| pid == i64::from(std::process::id()));
        Self {
            #[cfg(unix)]
            socket: env::var_os("NOTIFY_SOCKET").and_then(|path| match connect(&path) {
                Ok(socket) => Some(socket),
                Err(error) => {
                    tracing::warn!("NOTIFY_SOCKET {}: {error}", path.display());
                    None
                }
            }),
            watchdog_us: number("WATCHDOG_USEC").filter(|_| meant),
            fed_us: 0,
            status: String::new(),
        }
    }

    fn tell(&self, words: &str) {
        #[cfg(unix)]
        if let Some(socket) = &self.socket {
            // A manager that does not listen must not stop the lookout.
            let _ = socket.send(words.as_bytes());
        }
    }

    /// The work has begun.
    pub fn ready(&self) {
        self.tell("READY=1");
    }

    /// Settings are read again; [`Notify::ready`] follows.
    pub fn reloading(&self) {
        self.tell(&format!("RELOADING=1\nMONOTONIC_USEC={}", now_us()));
    }

    /// The end has begun.
    pub fn stopping(&self) {
        self.tell("STOPPING=1");
    }

    /// How it is, in one line; the same is not told twice.
    pub fn status(&mut self, words: String) {
        if words != self.status {
            self.tell(&format!("STATUS={words}"));
            self.status = words;
        }
    }

    /// Whether the watchdog is hungry: a third of its patience is over.
    pub fn is_hungry(&self) -> bool {
        self.watchdog_us.is_some_and(|patience| now_us() - self.fed_us >= patience / 3)
    }

    /// All is well.
    pub fn feed(&mut self) {
        self.tell("WATCHDOG=1");
        self.fed_us = now_us();
    }
}

#[cfg(unix)]
fn connect(path: &std::ffi::OsStr) -> std::io::Result<UnixDatagram> {
    let socket = UnixDatagram::unbound()?;
    socket.set_nonblocking(true)?;
    #[cfg(target_os = "linux")]
    if let Some(name) = path.as_encoded_bytes().strip_prefix(b"@") {
        use std::os::linux::net::SocketAddrExt;
        use std::os::unix::net::SocketAddr;
        socket.connect_addr(&SocketAddr::from_abstract_name(name)?)?;
        return Ok(socket);
    }
    socket.connect(path)?;
    Ok(socket)
}
