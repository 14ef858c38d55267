//! Links under input that never pauses, peers that come and go, questions without end.

use crate::live::{ACTIVE, Ground};
use crate::service::{Service, settings};
use crate::steady;
use lookout::mavlink::dialect::{HEARTBEAT_DATA, TIMESYNC_DATA};
use lookout::mavlink::messages::{Payload, status};
use std::fs;
use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// A port that nobody has; another may take it before we do, which the test then shows.
fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

fn with_link(ground: &Ground, link: &str) -> String {
    settings(ground).replacen("links = [", &format!("links = ['{link}', "), 1)
}

fn connect(port: u16) -> TcpStream {
    let start = Instant::now();
    loop {
        match TcpStream::connect(("127.0.0.1", port)) {
            Ok(stream) => return stream,
            Err(error) => assert!(start.elapsed() < Duration::from_secs(20), "{error}"),
        }
        thread::sleep(Duration::from_millis(20));
    }
}

/// The heartbeat of a ground station.
fn heartbeat() -> Vec<u8> {
    let data: HEARTBEAT_DATA =
        status::heartbeat(status::LookoutState::Watching, status::HeartbeatType::default());
    Payload::new(&data).frame(255, 190, 0, false).raw_bytes().into()
}

/// Writes `bytes` repeatedly, with a pause, until stopped.
fn flood(
    mut stream: TcpStream,
    bytes: Vec<u8>,
    pause: Duration,
    stop: &Arc<AtomicBool>,
) -> JoinHandle<()> {
    let stop = stop.clone();
    stream.set_write_timeout(Some(Duration::from_millis(200))).unwrap();
    thread::spawn(move || {
        while !stop.load(Ordering::Relaxed) {
            match stream.write(&bytes) {
                Err(e) if !matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                    return;
                }
                _ => thread::sleep(pause),
            }
        }
    })
}

/// Bytes that come within some time.
fn received(stream: &mut TcpStream, time: Duration) -> usize {
    stream.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
    let (start, mut count, mut buffer) = (Instant::now(), 0, [0; 4096]);
    while start.elapsed() < time {
        count += stream.read(&mut buffer).unwrap_or(0);
    }
    count
}

fn input_without_pause(bytes: Vec<u8>, pause: Duration) {
    let mut ground = Ground::default();
    let port = free_port();
    let link = format!("tcpin:127.0.0.1:{port}");
    let service = Service::start(&with_link(&ground, &link), |_, _| {});
    ground.wait_state(ACTIVE, 0);
    let mut peer = connect(port);
    let stop = Arc::<AtomicBool>::default();
    let flooding = flood(peer.try_clone().unwrap(), bytes, pause, &stop);
    thread::sleep(Duration::from_millis(300));
    // The link still speaks: heartbeats and health are some hundred bytes a second.
    let count = received(&mut peer, Duration::from_secs(4));
    assert!(count > 400, "{count} bytes");
    steady(&mut ground, 2);
    // Another link changes meanwhile: neither waits.
    let mut other = Ground::default();
    fs::write(Service::config(&service.folder), with_link(&other, &link)).unwrap();
    service.signal("HUP");
    let start = Instant::now();
    other.wait_state(ACTIVE, 0);
    assert!(start.elapsed() < Duration::from_secs(3), "{:?}", start.elapsed());
    let count = received(&mut peer, Duration::from_secs(2));
    assert!(count > 100, "{count} bytes after the reload");
    service.signal("TERM");
    let start = Instant::now();
    let (status, _, err, _) = service.ended();
    assert_eq!(status, Some(0), "{err}");
    assert!(start.elapsed() < Duration::from_secs(4), "{:?}", start.elapsed());
    stop.store(true, Ordering::Relaxed);
    flooding.join().unwrap();
}

#[test]
fn garbage_as_fast_as_it_goes() {
    let bytes = (0..65_536u32).map(|i| if i % 7 == 0 { 0xFD } else { ((i * 31) >> 3) as u8 });
    input_without_pause(bytes.collect(), Duration::ZERO);
}

#[test]
fn a_thousand_garbage_bytes_a_second() {
    input_without_pause(vec![0xFD], Duration::from_millis(1));
}

#[test]
fn questions_without_end_cost_no_heartbeat() {
    let data = TIMESYNC_DATA { tc1: 0, ts1: 7, target_system: 0, target_component: 0 };
    let frame = Payload::new(&data).frame(255, 190, 0, false);
    input_without_pause(frame.raw_bytes().repeat(100), Duration::from_millis(20));
}

#[test]
fn silent_callers_throw_nobody_out() {
    let mut ground = Ground::default();
    let port = free_port();
    let service =
        Service::start(&with_link(&ground, &format!("tcpin:127.0.0.1:{port}")), |_, _| {});
    ground.wait_state(ACTIVE, 0);
    let mut first = connect(port);
    first.write_all(&heartbeat()).unwrap();
    assert!(received(&mut first, Duration::from_secs(2)) > 40);
    let silent: Vec<_> = (0..6).map(|_| connect(port)).collect();
    first.write_all(&heartbeat()).unwrap();
    assert!(received(&mut first, Duration::from_secs(3)) > 60, "the first caller is served");
    drop(silent);
    // They are gone without a word; somebody new is served.
    let mut last = connect(port);
    assert!(received(&mut last, Duration::from_secs(2)) > 40);
    drop(service);
}

#[test]
fn a_byte_opens_no_stream_and_nobody_is_shut_out() {
    let mut ground = Ground::default();
    let port = free_port();
    let service =
        Service::start(&with_link(&ground, &format!("udpin:127.0.0.1:{port}")), |_, _| {});
    ground.wait_state(ACTIVE, 0);
    let socket = || {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.connect(("127.0.0.1", port)).unwrap();
        socket.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
        socket
    };
    let (station, others) = (socket(), (0..20).map(|_| socket()).collect::<Vec<_>>());
    let (start, mut heard, mut buffer) = (Instant::now(), 0, [0; 300]);
    while start.elapsed() < Duration::from_secs(4) {
        station.send(&heartbeat()).unwrap();
        for other in &others {
            other.send(&[0xFD]).unwrap();
        }
        while station.recv(&mut buffer).is_ok() {
            heard += 1;
        }
        thread::sleep(Duration::from_millis(50));
    }
    assert!(heard >= 10, "{heard} messages to the station");
    for other in &others {
        assert!(other.recv(&mut buffer).is_err(), "an answer to one byte");
    }
    drop(service);
}
