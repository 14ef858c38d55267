//! The page under a thousand connections, requests that never end, foreign names and guesses, while the watch goes on.

use crate::live::{ACTIVE, Ground};
use crate::service::{Service, settings};
use crate::{free_port, steady};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

/// Answer to a request: its first line; empty where the connection was closed or nothing came for a second.
fn ask(port: u16, host: &str, path: &str) -> String {
    let Ok(mut stream) = TcpStream::connect(("127.0.0.1", port)) else { return String::new() };
    stream.set_read_timeout(Some(Duration::from_secs(1))).unwrap();
    let request = format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
    let mut answer = Vec::new();
    if stream.write_all(request.as_bytes()).is_ok() {
        let _ = stream.read_to_end(&mut answer);
    }
    String::from_utf8_lossy(&answer).lines().next().unwrap_or_default().to_owned()
}

#[test]
fn a_thousand_connections_and_slow_requests() {
    // Room for the callers in this process.
    let Rlimit { maximum, .. } = getrlimit(Resource::Nofile);
    let wanted = maximum.map_or(4096, |maximum| maximum.min(4096));
    setrlimit(Resource::Nofile, Rlimit { current: Some(wanted), maximum }).unwrap();
    let mut ground = Ground::default();
    let port = free_port();
    let text = format!("preview = '127.0.0.1:{port}'\n{}", settings(&ground));
    let service = Service::start(&text, |_, _| {});
    ground.wait_state(ACTIVE, 0);
    assert_eq!(ask(port, "localhost", "/state.json"), "HTTP/1.1 200 OK");
    steady(&mut ground, 2);
    let (memory, files) = (service.memory(), service.files());
    let mut callers: Vec<_> =
        (0..1000).map(|_| TcpStream::connect(("127.0.0.1", port)).unwrap()).collect();
    let start = Instant::now();
    let mut most = files;
    while start.elapsed() < Duration::from_secs(6) {
        // All of them ask, a byte at a time, and never come to the end.
        for (caller, byte) in callers.iter_mut().zip(b"GET / HTTP/1.1\r\n".iter().cycle()) {
            let _ = caller.write(&[*byte]);
        }
        steady(&mut ground, 1);
        most = most.max(service.files());
    }
    assert!(most <= files + 20, "{files} files grew to {most}");
    drop(callers);
    let start = Instant::now();
    while ask(port, "localhost", "/state.json") != "HTTP/1.1 200 OK" {
        assert!(start.elapsed() < Duration::from_secs(2), "it does not recover");
    }
    let after = service.memory();
    assert!(after < memory + 4000, "{memory} kB grew to {after} kB");
}

#[test]
fn foreign_names_and_guesses() {
    let mut ground = Ground::default();
    let port = free_port();
    let plain = format!("preview = '127.0.0.1:{port}'\n{}", settings(&ground));
    let service = Service::start(&plain, |_, _| {});
    ground.wait_state(ACTIVE, 0);
    for host in ["evil.example", "127.0.0.1.evil.example", "10.0.0.7", ""] {
        assert!(ask(port, host, "/state.json").starts_with("HTTP/1.1 403 "), "{host}");
    }
    steady(&mut ground, 1);
    drop(service);
    let port = free_port();
    let text = format!(
        "preview = '127.0.0.1:{port}'\npreview_token = 'a-token-of-enough-letters'\n{}",
        settings(&ground)
    );
    let service = Service::start(&text, |_, _| {});
    ground.wait_state(ACTIVE, 0);
    let memory = service.memory();
    let guess = |number: u32| ask(port, "localhost", &format!("/state.json?token=guess-{number}"));
    let (mut refused, start) = (0, Instant::now());
    for number in 0..2000 {
        let answer = guess(number);
        assert!(["401", "429"].iter().any(|status| answer.contains(status)), "{answer}");
        refused += u32::from(answer.contains("429"));
    }
    assert!(refused >= 1900 || start.elapsed() > Duration::from_secs(60), "{refused} refused");
    steady(&mut ground, 2);
    assert!(service.memory() < memory + 4000, "{memory} kB grew");
}
