//! Clients that are slow, many, or talk nonsense.

use super::{LONG, connect, get, quiet, start};
use lookout::shell::preview::Snapshot;
use lookout::shell::preview::snapshot::PictureView;
use proptest::prelude::*;
use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Most connections that the server keeps.
const MAX_CLIENTS: usize = 16;

/// Whether the server closes `stream` within [`LONG`], and when.
pub fn closed_after(mut stream: TcpStream, since: Instant) -> Duration {
    let mut byte = [0; 65536];
    loop {
        match stream.read(&mut byte) {
            Ok(0) => return since.elapsed(),
            Ok(_) => {}
            Err(error) if error.kind() == ErrorKind::ConnectionReset => return since.elapsed(),
            Err(error) => panic!("still open: {error}"),
        }
    }
}

#[test]
fn slow_clients_are_left_and_hold_up_nobody() {
    let preview = start(None);
    get(&preview, "/frame.jpg");
    let noise = (0..4_000_000u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let picture = PictureView { pixels: noise, width: 2000, height: 2000 };
    preview.publish(Snapshot { picture: Some(picture), ..quiet(1) });
    let since = Instant::now();
    let silent = connect(preview.address());
    let mut half = connect(preview.address());
    half.write_all(b"GET / HTTP/1.1\r\nHost: local").unwrap();
    let mut deaf = connect(preview.address());
    // Together more than sockets take unread.
    let asked = b"GET /frame.jpg HTTP/1.1\r\nHost: localhost\r\n\r\n".repeat(20);
    deaf.write_all(&asked).unwrap();
    let dripping = {
        let mut stream = connect(preview.address());
        std::thread::spawn(move || {
            let drops = b"GET / HTTP/1.1\r\n".iter().chain(std::iter::repeat(&b'x'));
            for drop in drops {
                if stream.write_all(&[*drop]).is_err() || since.elapsed() > LONG {
                    return since.elapsed();
                }
                sleep(Duration::from_millis(50));
            }
            unreachable!("drops never end")
        })
    };
    for frames in 2..50 {
        preview.publish(quiet(frames));
        let start = Instant::now();
        assert_eq!(get(&preview, "/state.json").json()["health"]["frames"], frames);
        assert!(start.elapsed() < Duration::from_secs(5));
        sleep(Duration::from_millis(20));
    }
    let seconds = |time: Duration| time.as_secs_f64();
    for (name, after) in [
        ("silent", closed_after(silent, since)),
        ("half", closed_after(half, since)),
        ("dripping", dripping.join().unwrap()),
    ] {
        assert!((4.5..20.0).contains(&seconds(after)), "{name} after {after:?}");
    }
    // It reads nothing before the time is over: the end of its answers was not sent.
    sleep((since + Duration::from_secs(12)).saturating_duration_since(Instant::now()));
    let mut bytes = Vec::new();
    let _ = deaf.read_to_end(&mut bytes);
    let head = String::from_utf8_lossy(&bytes[..400]).into_owned();
    let length = head.lines().find_map(|line| line.strip_prefix("Content-Length: ")).unwrap();
    let length = length.parse::<usize>().unwrap();
    assert!(bytes.len() < 20 * length, "{} of 20 times {length}", bytes.len());
}

#[test]
fn many_clients_take_no_more_than_the_places() {
    let preview = start(None);
    let all: Vec<TcpStream> = (0..10 * MAX_CLIENTS).map(|_| connect(preview.address())).collect();
    for frames in 1..=50 {
        preview.publish(quiet(frames));
    }
    assert_eq!(get(&preview, "/state.json").status, 200);
    let open = all.iter().filter(|stream| {
        stream.set_nonblocking(true).unwrap();
        let read = stream.peek(&mut [0]);
        matches!(read, Err(error) if error.kind() == ErrorKind::WouldBlock)
    });
    let open = open.count();
    assert!((1..=MAX_CLIENTS).contains(&open), "{open} open");
    // One that is served goes on while others come and go.
    let mut page = connect(preview.address());
    for _ in 0..50 {
        page.write_all(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
        let mut bytes = [0; 1000];
        let read = page.read(&mut bytes).unwrap();
        assert!(bytes[..read].starts_with(b"HTTP/1.1 200 "), "{read}");
        connect(preview.address());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn garbage_is_answered_or_left_and_the_next_is_served(
        bytes in prop_oneof![
            proptest::collection::vec(any::<u8>(), 1..20_000),
            "(GET|HEAD|get|G\u{e9}T) /[ -~]{0,40} HTTP/1.[019]\r\n([!-~]{0,9}: ?[ -~]{0,30}\r\n){0,60}\r\n".prop_map(String::into_bytes),
        ]
    ) {
        let preview = start(None);
        let mut stream = connect(preview.address());
        // Refused in the middle of it, the rest cannot be written.
        let _ = stream.write_all(&bytes);
        let _ = stream.shutdown(std::net::Shutdown::Write);
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        prop_assert!(answer.is_empty() || answer.starts_with(b"HTTP/1.1 "));
        prop_assert_eq!(get(&preview, "/state.json").status, 200);
    }
}
