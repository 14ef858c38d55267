//! Links under input that never pauses, peers that come and go, questions without end.

use crate::live::{ACTIVE, Ground};
use crate::service::{Service, settings};
use crate::{free_port, steady};
use lookout::mavlink::dialect::{HEARTBEAT_DATA, MavMessage, TIMESYNC_DATA};
use lookout::mavlink::messages::{Payload, status};
use mavlink_core::MavlinkReader;
use std::fs;
use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

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
    let (memory, files) = (service.memory(), service.files());
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
    let after = (service.memory(), service.files());
    assert!(after.0 < memory + 4000, "{memory} kB grew to {} kB", after.0);
    assert!(after.1 <= files + 4, "{files} files grew to {}", after.1);
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

/// 50 MB/s of garbage in datagrams: the system drops most of them, whoever sends often enough is heard between.
#[test]
fn fifty_megabytes_a_second_of_datagrams() {
    let mut ground = Ground::default();
    let port = free_port();
    let service =
        Service::start(&with_link(&ground, &format!("udpin:127.0.0.1:{port}")), |_, _| {});
    ground.wait_state(ACTIVE, 0);
    steady(&mut ground, 1);
    let memory = service.memory();
    let stop = Arc::<AtomicBool>::default();
    let stopped = stop.clone();
    let flooding = thread::spawn(move || {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let bytes: Vec<_> =
            (0..1400u32).map(|i| if i % 7 == 0 { 0xFD } else { ((i * 31) >> 3) as u8 }).collect();
        let (start, mut sent) = (Instant::now(), 0u64);
        while !stopped.load(Ordering::Relaxed) {
            while start.elapsed().as_micros() as u64 * 50 > sent {
                let _ = socket.send_to(&bytes, ("127.0.0.1", port));
                sent += bytes.len() as u64;
            }
            thread::sleep(Duration::from_millis(1));
        }
        sent as f64 / start.elapsed().as_secs_f64()
    });
    let station = UdpSocket::bind("127.0.0.1:0").unwrap();
    station.set_nonblocking(true).unwrap();
    let (start, mut heard) = (Instant::now(), 0);
    while start.elapsed() < Duration::from_secs(6) {
        for _ in 0..100 {
            let _ = station.send_to(&heartbeat(), ("127.0.0.1", port));
            while station.recv(&mut [0; 300]).is_ok() {
                heard += 1;
            }
            thread::sleep(Duration::from_millis(5));
        }
        steady(&mut ground, 1);
    }
    stop.store(true, Ordering::Relaxed);
    let rate = flooding.join().unwrap();
    println!("{:.0} MB/s sent, {heard} messages to the station", rate / 1e6);
    assert!(heard >= 10, "{heard} messages to the station");
    let after = service.memory();
    assert!(after < memory + 4000, "{memory} kB grew to {after} kB");
    service.signal("TERM");
    assert_eq!(service.ended().0, Some(0));
}

#[test]
fn a_link_that_vanishes_comes_back_without_old_messages() {
    let mut ground = Ground::default();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let service = Service::start(&with_link(&ground, &format!("tcpout:{address}")), |_, _| {});
    ground.wait_state(ACTIVE, 0);
    let (mut peer, _) = listener.accept().unwrap();
    assert!(received(&mut peer, Duration::from_secs(1)) > 0);
    // Gone so long that the pauses between two attempts are the longest.
    drop((peer, listener));
    steady(&mut ground, 8);
    let gone = ground.heard.len();
    let listener = TcpListener::bind(address).unwrap();
    let start = Instant::now();
    let (mut peer, _) = listener.accept().unwrap();
    let mut bytes = Vec::new();
    peer.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
    let mut buffer = [0; 4096];
    while bytes.is_empty() {
        // Two seconds, and one for a machine that is busy with other tests; likewise below.
        assert!(start.elapsed() < Duration::from_secs(3), "{:?}", start.elapsed());
        let read = peer.read(&mut buffer).unwrap_or(0);
        bytes.extend(&buffer[..read]);
    }
    let recovered = start.elapsed();
    println!("link back, messages {} ms later", recovered.as_millis());
    while start.elapsed() < Duration::from_secs(3) {
        let read = peer.read(&mut buffer).unwrap_or(0);
        bytes.extend(&buffer[..read]);
    }
    // The first that bears a time is of now: those of the other link have been as late since.
    steady(&mut ground, 2);
    let times = |message: &MavMessage| match message {
        MavMessage::NAMED_VALUE_FLOAT(value) => Some(value.time_boot_ms),
        _ => None,
    };
    let newest_before = ground.heard[..gone].iter().rev().find_map(|(_, _, m)| times(m)).unwrap();
    let mut reader = MavlinkReader::new(&bytes[..]);
    let mut first = None;
    while let Ok((_, message)) = reader.read_any_message::<MavMessage>() {
        first = first.or(times(&message));
    }
    let first = first.expect("a message with a time");
    assert!(first + 1200 > newest_before, "{first} ms is older than {newest_before} ms");
    service.signal("TERM");
    assert_eq!(service.ended().0, Some(0));
}

#[test]
fn a_second_instance_waits_for_the_port() {
    let mut grounds = [Ground::default(), Ground::default()];
    let port = free_port();
    let link = format!("udpin:127.0.0.1:{port}");
    let start = |ground: &mut Ground| {
        let service = Service::start(&with_link(ground, &link), |_, _| {});
        ground.wait_state(ACTIVE, 0);
        service
    };
    let [first, second] = grounds.each_mut().map(start);
    second.wait_log("Address already in use");
    for ground in &mut grounds {
        steady(ground, 4);
    }
    first.signal("TERM");
    assert_eq!(first.ended().0, Some(0));
    let station = UdpSocket::bind("127.0.0.1:0").unwrap();
    station.connect(("127.0.0.1", port)).unwrap();
    station.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
    let freed = Instant::now();
    // Nobody listens there for a moment, of which the system reports.
    while station.send(&heartbeat()).is_err() || station.recv(&mut [0; 300]).is_err() {
        assert!(freed.elapsed() < Duration::from_secs(3), "the port is not taken over");
        thread::sleep(Duration::from_millis(20));
    }
    println!("port free, taken over {} ms later", freed.elapsed().as_millis());
    steady(&mut grounds[1], 2);
}
