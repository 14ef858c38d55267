use super::*;
use crate::mavlink::component::parameters::Parameters;
use crate::mavlink::component::{Component, ComponentConfig, Priority};
use crate::mavlink::dialect::{ArduPilotFrames, SYSTEM_TIME_DATA};
use crate::mavlink::messages::Payload;
use mavlink_core::MavlinkReader;
use proptest::prelude::*;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream, UdpSocket};

const WAIT: Duration = Duration::from_secs(20);

fn spec(text: &str) -> LinkSpec {
    text.parse().unwrap()
}

fn payload(number: u32) -> Payload {
    Payload::new(&SYSTEM_TIME_DATA { time_unix_usec: 1, time_boot_ms: number })
}

fn message(number: u32, to: Destination) -> Outgoing {
    let priority = Priority::Urgent;
    Outgoing { to, priority, system_id: 1, component_id: 196, payload: payload(number) }
}

fn frame(number: u32) -> Vec<u8> {
    payload(number).frame(42, 1, 0, false).raw_bytes().into()
}

fn number(frame: &MAVLinkMessageRaw) -> u32 {
    let payload = frame.payload();
    u32::from_le_bytes(core::array::from_fn(|i| payload.get(8 + i).copied().unwrap_or(0)))
}

/// A port that nobody has; another may take it before we do, which the test then shows.
fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

fn eventually(mut holds: impl FnMut() -> bool) {
    let start = Instant::now();
    while !holds() {
        assert!(start.elapsed() < WAIT, "not within {WAIT:?}");
        thread::sleep(Duration::from_millis(5));
    }
}

fn hear(links: &mut Links, want: u32) -> u8 {
    let start = Instant::now();
    loop {
        assert!(start.elapsed() < WAIT, "{want} was not heard");
        if let Some(inbound) = links.receive(Duration::from_millis(50))
            && number(&inbound.frame) == want
        {
            return inbound.link;
        }
    }
}

/// The numbers of the frames in bytes.
fn numbers(bytes: &[u8]) -> Vec<u32> {
    let mut reader = MavlinkReader::new(bytes);
    let mut found = Vec::new();
    while let Ok(frame) = reader.read_any_raw_message_with_dialect(&ArduPilotFrames) {
        found.push(number(&frame));
    }
    found
}

#[test]
fn udp_both_ways() {
    let peer = UdpSocket::bind("127.0.0.1:0").unwrap();
    peer.set_read_timeout(Some(WAIT)).unwrap();
    let out = std::format!("udpout:{}", peer.local_addr().unwrap());
    let port = free_port();
    let mut links = Links::open(&[spec(&out), spec(&std::format!("udpin:127.0.0.1:{port}"))]);
    eventually(|| links.status(0).connected && links.status(1).connected);
    links.send(&message(5, Destination::Link(0)), 0);
    let mut bytes = [0; 300];
    let (read, ours) = peer.recv_from(&mut bytes).unwrap();
    assert_eq!(numbers(&bytes[..read]), [5]);
    // Two frames and some noise in a datagram.
    let together = [frame(6), std::vec![0xFD, 3, 9], frame(7)].concat();
    peer.send_to(&together, ours).unwrap();
    assert_eq!(hear(&mut links, 6), 0);
    assert_eq!(hear(&mut links, 7), 0);
    // udpin answers everyone it heard of late.
    let callers: Vec<_> = (0..3).map(|_| UdpSocket::bind("127.0.0.1:0").unwrap()).collect();
    for (number, caller) in (10..).zip(&callers) {
        caller.set_read_timeout(Some(WAIT)).unwrap();
        caller.send_to(&frame(number), ("127.0.0.1", port)).unwrap();
        assert_eq!(hear(&mut links, number), 1);
    }
    links.send(&message(20, Destination::Link(1)), 0);
    for caller in &callers {
        let read = caller.recv(&mut bytes).unwrap();
        assert_eq!(numbers(&bytes[..read]), [20]);
    }
}

#[test]
fn sequences_count_for_each_link() {
    let peers: Vec<_> = (0..2).map(|_| UdpSocket::bind("127.0.0.1:0").unwrap()).collect();
    let specs: Vec<_> =
        peers.iter().map(|p| spec(&std::format!("udpout:{}", p.local_addr().unwrap()))).collect();
    let mut links = Links::open(&specs);
    eventually(|| (0..2).all(|link| links.status(link).connected));
    for (number, to) in
        [Destination::All, Destination::Link(0), Destination::All].into_iter().enumerate()
    {
        links.send(&message(number as u32, to), 0);
    }
    for (peer, want) in peers.iter().zip([&[(0, 0), (1, 1), (2, 2)][..], &[(0, 0), (1, 2)]]) {
        peer.set_read_timeout(Some(WAIT)).unwrap();
        for (sequence, number) in want {
            let mut bytes = [0; 300];
            let read = peer.recv(&mut bytes).unwrap();
            assert_eq!((bytes[0], bytes[4]), (0xFD, *sequence), "MAVLink 2, in order");
            assert_eq!(numbers(&bytes[..read]), [*number]);
        }
    }
}

#[test]
fn tcp_is_cut_and_comes_back() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = free_port();
    let mut links = Links::open(&[
        spec(&std::format!("tcpout:{}", listener.local_addr().unwrap())),
        spec(&std::format!("tcpin:127.0.0.1:{port}")),
        spec(&std::format!("tcpout:127.0.0.1:{}", free_port())),
        spec("serial:/nonexistent/device:57600"),
    ]);
    for round in 0..2 {
        let (mut peer, _) = listener.accept().unwrap();
        peer.write_all(&frame(100 + round)).unwrap();
        assert_eq!(hear(&mut links, 100 + round), 0);
        links.send(&message(200 + round, Destination::All), 0);
        let mut bytes = std::vec![0; frame(200).len()];
        peer.set_read_timeout(Some(WAIT)).unwrap();
        peer.read_exact(&mut bytes).unwrap();
        assert_eq!(numbers(&bytes), [200 + round], "only what is new");
        drop(peer);
        eventually(|| !links.status(0).connected || links.status(0).opened > round + 1);
        // Meanwhile the others work: one that waits for a caller,
        let mut caller = TcpStream::connect(("127.0.0.1", port)).unwrap();
        caller.write_all(&frame(150 + round)).unwrap();
        assert_eq!(hear(&mut links, 150 + round), 1);
        links.send(&message(250 + round, Destination::Link(1)), 0);
        caller.set_read_timeout(Some(WAIT)).unwrap();
        caller.read_exact(&mut bytes).unwrap();
        assert_eq!(numbers(&bytes), [250 + round]);
        // and those that cannot connect harm nobody.
        assert!(!links.status(2).connected && !links.status(3).connected);
    }
}

#[cfg(unix)]
#[test]
fn serial_through_a_pseudo_terminal() {
    use serialport::{SerialPort, TTYPort};
    let (mut master, slave) = TTYPort::pair().unwrap();
    let device = slave.name().unwrap();
    drop(slave);
    master.set_timeout(Duration::from_millis(200)).unwrap();
    let mut links = Links::open(&[spec(&std::format!("serial:{device}:57600"))]);
    eventually(|| links.status(0).connected);
    master.write_all(&[0x55; 100]).unwrap();
    master.write_all(&frame(1)).unwrap();
    assert_eq!(hear(&mut links, 1), 0);
    links.send(&message(2, Destination::All), 0);
    let mut bytes = std::vec![0; frame(2).len()];
    let start = Instant::now();
    let mut got = 0;
    while got < bytes.len() && start.elapsed() < WAIT {
        got += master.read(&mut bytes[got..]).unwrap_or(0);
    }
    assert_eq!(numbers(&bytes), [2]);
    // Pulled out: seen, and nothing else happens.
    drop(master);
    eventually(|| !links.status(0).connected);
    links.send(&message(3, Destination::All), 0);
}

#[test]
fn nobody_reads_and_nobody_waits() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let mut links = Links::open(&[LinkSpec {
        bytes_per_second: 100_000_000,
        ..spec(&std::format!("tcpout:{}", listener.local_addr().unwrap()))
    }]);
    let (_peer, _) = listener.accept().unwrap();
    eventually(|| links.status(0).connected);
    let start = Instant::now();
    for i in 0..200_000 {
        links.send(&message(i, Destination::All), i64::from(i) * 100);
    }
    assert!(start.elapsed() < Duration::from_secs(15), "{:?}", start.elapsed());
    assert!(links.status(0).dropped > 0);
}

#[test]
fn signed_frames_are_trusted_others_not() {
    let port = free_port();
    let key = [9; 32];
    let signing = || Some(Signing::new(key, None, signing::clock()).unwrap());
    let here = spec(&std::format!("udpin:127.0.0.1:{port}"));
    let mut ours = Links::open_signed(&[here], signing());
    eventually(|| ours.status(0).connected);
    let there = [spec(&std::format!("udpout:127.0.0.1:{port}"))];
    let trust = |ours: &mut Links, want: u32| loop {
        let inbound = ours.receive(WAIT).expect("a frame");
        if number(&inbound.frame) == want {
            return inbound.trust;
        }
    };
    for (number, signing, want) in [
        (1, signing(), Trust::Signed),
        (2, None, Trust::Unsigned),
        (3, Some(Signing::new([1; 32], None, signing::clock()).unwrap()), Trust::Forged),
    ] {
        let mut theirs = Links::open_signed(&there, signing);
        eventually(|| theirs.status(0).connected);
        theirs.send(&message(number, Destination::All), 0);
        assert_eq!(trust(&mut ours, number), want);
    }
}

#[test]
fn a_thousand_garbage_bytes_a_second_and_a_flood() {
    let port = free_port();
    let mut links = Links::open(&[spec(&std::format!("udpin:127.0.0.1:{port}"))]);
    eventually(|| links.status(0).connected);
    let peer = UdpSocket::bind("127.0.0.1:0").unwrap();
    let mut state = 1u32;
    let mut component = Component::new(ComponentConfig::default(), Parameters::default(), 0);
    for i in 0..2000u32 {
        let garbage: Vec<u8> = (0..100)
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                if state >> 28 == 0 { 0xFD } else { (state >> 24) as u8 }
            })
            .collect();
        peer.send_to(&garbage, ("127.0.0.1", port)).unwrap();
        let whole = frame(i);
        peer.send_to(&whole[..whole.len() / 2], ("127.0.0.1", port)).unwrap();
        while let Some(inbound) = links.receive(Duration::ZERO) {
            component.receive(inbound.link, &inbound.frame, inbound.trust, inbound.time_us);
        }
    }
    // The system drops datagrams of a flood too: what counts is that the link still hears.
    let start = Instant::now();
    let mut heard = false;
    while !heard && start.elapsed() < WAIT {
        peer.send_to(&frame(4_000_000), ("127.0.0.1", port)).unwrap();
        let inbound = links.receive(Duration::from_millis(20));
        heard = inbound.is_some_and(|inbound| number(&inbound.frame) == 4_000_000);
    }
    assert!(heard);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]
    /// Whole frames between any bytes are found, whatever those begin.
    #[test]
    fn frames_are_found_in_garbage(parts in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..60), 1..8)) {
        let mut bytes = Vec::new();
        for (number, part) in parts.iter().enumerate() {
            bytes.extend(part);
            bytes.extend(frame(number as u32 + 1));
        }
        bytes.extend([0; 600]);
        let mut found = numbers(&bytes);
        found.retain(|number| (1..=parts.len() as u32).contains(number));
        prop_assert_eq!(found, (1..=parts.len() as u32).collect::<Vec<_>>());
    }

    /// Truncated frames are no frames.
    #[test]
    fn truncation_is_no_frame(keep in 0usize..20) {
        let whole = frame(9);
        prop_assert!(numbers(&whole[..keep.min(whole.len() - 1)]).is_empty());
    }
}
