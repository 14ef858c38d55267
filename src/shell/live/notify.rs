//! Messages to the service manager: ready, watchdog, status, stopping.
//!
//! Source of the protocol: sd_notify(3), datagrams of `NAME=VALUE` lines to the socket named by NOTIFY_SOCKET.

use crate::shell::support::clock::now_us;
use std::env;
use std::format;
#[cfg(unix)]
use std::os::unix::net::UnixDatagram;
use std::string::String;

/// The manager's socket; without one nothing is sent.
#[derive(Debug, Default)]
pub struct Notify {
    #[cfg(unix)]
    socket: Option<UnixDatagram>,
    /// WATCHDOG_USEC: silence after which the manager restarts the service, microseconds.
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

    fn send(&self, words: &str) {
        #[cfg(unix)]
        if let Some(socket) = &self.socket {
            // A manager that does not listen must not stop the lookout.
            let _ = socket.send(words.as_bytes());
        }
    }

    /// The service is ready.
    pub fn ready(&self) {
        self.send("READY=1");
    }

    /// A reload begins; [`Notify::ready`] ends it.
    pub fn reloading(&self) {
        self.send(&format!("RELOADING=1\nMONOTONIC_USEC={}", now_us()));
    }

    /// Sends `STOPPING=1` to the service manager.
    pub fn stopping(&self) {
        self.send("STOPPING=1");
    }

    /// State in one line; sent where it differs from the last one.
    pub fn status(&mut self, words: String) {
        if words != self.status {
            self.send(&format!("STATUS={words}"));
            self.status = words;
        }
    }

    /// Whether a third of WATCHDOG_USEC has passed since the last [`Notify::feed`].
    pub fn is_due(&self) -> bool {
        self.watchdog_us.is_some_and(|patience| now_us() - self.fed_us >= patience / 3)
    }

    /// Sends `WATCHDOG=1` to the service manager.
    pub fn feed(&mut self) {
        self.send("WATCHDOG=1");
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
