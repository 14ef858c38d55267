//! The live page: its server over real sockets, well-meant and not, and the page itself in a browser.
#![cfg(feature = "std")]

mod browser;
mod hostile;
mod page;

use lookout::mavlink::messages::Blind;
use lookout::shell::preview::snapshot::{
    HealthView, Latency, LinkState, LinkView, PictureView, StateView, TrackView,
};
use lookout::shell::preview::{Preview, PreviewError, Snapshot};
use lookout::tracking::traffic::AlertLevel;
use serde_json::{Value, json};
use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Nothing here takes longer, even on a busy machine.
const LONG: Duration = Duration::from_secs(30);

const WIDTH: usize = 320;
const HEIGHT: usize = 240;

/// A free port of this machine.
pub fn start(token: Option<&str>) -> Preview {
    Preview::start(([127, 0, 0, 1], 0).into(), token.map(str::to_owned)).unwrap()
}

/// Sky above ground, and something dark where [`warning`] has its first box.
pub fn picture() -> PictureView {
    let grey = |i: usize| {
        let (x, y) = (i % WIDTH, i / WIDTH);
        match (x, y) {
            (200..212, 60..66) => 30,
            _ if y > 170 + x / 16 => 70 + ((x / 7 + y / 5) % 3) as u8 * 8,
            _ => 210 - (y / 4) as u8,
        }
    };
    PictureView { pixels: (0..WIDTH * HEIGHT).map(grey).collect(), width: WIDTH, height: HEIGHT }
}

/// All is well and nothing is there.
pub fn quiet(frames: u64) -> Snapshot {
    Snapshot {
        picture: None,
        time_us: frames as i64 * 40_000,
        health: HealthView {
            state: StateView::Watching,
            blind: Blind::NO,
            frames,
            dropped: 3,
            frames_per_second: 24.96,
            camera: "/dev/video0, 640x480 GREY".into(),
            advice: None,
        },
        latency: vec![
            Latency { stage: "exposure to frame".into(), p50_ms: 8.14, p99_ms: 11.0 },
            Latency { stage: "detector".into(), p50_ms: 21.5, p99_ms: 34.25 },
        ],
        links: vec![
            LinkView {
                name: "serial:/dev/ttyAMA0:921600".into(),
                state: LinkState::Up,
                sent: 5120,
                dropped: 0,
            },
            LinkView {
                name: "udpout:192.168.2.1:14550".into(),
                state: LinkState::Down,
                sent: 12,
                dropped: 7,
            },
        ],
        autopilot: Some("ArduPilot 4.6, system 1".into()),
        field_of_view_deg: 62.0,
        ..Snapshot::default()
    }
}

/// One object on a collision course, one farther off.
pub fn warning(frames: u64) -> Snapshot {
    let near = TrackView {
        id: 7,
        rect: [200.0, 60.0, 12.0, 6.0],
        level: AlertLevel::Warning,
        confirmed: true,
        azimuth_deg: Some(9.25),
        elevation_deg: Some(12.0),
        range_m: Some(84.2),
        range_sigma_m: Some(59.1),
        time_to_contact_s: Some(6.04),
        score: 3.456,
        ..TrackView::default()
    };
    let far = TrackView {
        id: 12,
        rect: [40.5, 90.25, 10.0, 5.0],
        level: AlertLevel::Traffic,
        confirmed: true,
        coasting: true,
        azimuth_deg: Some(-22.0),
        elevation_deg: Some(-1.5),
        score: 0.5,
        ..TrackView::default()
    };
    Snapshot { tracks: vec![far, near], level: AlertLevel::Warning, ..quiet(frames) }
}

/// An answer, taken apart.
#[derive(Debug)]
struct Answer {
    status: u16,
    head: String,
    body: Vec<u8>,
}

impl Answer {
    fn field(&self, name: &str) -> Option<&str> {
        let fields = self.head.lines().filter_map(|line| line.split_once(": "));
        fields.into_iter().find(|(key, _)| *key == name).map(|(_, value)| value)
    }

    fn text(&self) -> &str {
        std::str::from_utf8(&self.body).unwrap()
    }

    fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap()
    }
}

fn connect(address: SocketAddr) -> TcpStream {
    let stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(LONG)).unwrap();
    stream
}

/// Sends `request` as it is and reads until the server closes.
fn exchange(address: SocketAddr, request: &[u8]) -> Vec<u8> {
    let mut stream = connect(address);
    // The server may close before it has read everything.
    let _ = stream.write_all(request);
    let mut bytes = Vec::new();
    match stream.read_to_end(&mut bytes) {
        Err(error) if error.kind() != ErrorKind::ConnectionReset => panic!("{error}"),
        _ => bytes,
    }
}

/// Asks for `path`; `fields` are whole lines.
fn ask(address: SocketAddr, method: &str, path: &str, fields: &[&str]) -> Answer {
    let host = format!("Host: {address}");
    let fields = if fields.iter().any(|f| f.starts_with("Host")) {
        fields.to_vec()
    } else {
        [&[host.as_str()], fields].concat()
    };
    let lines = fields.join("\r\n");
    let request = format!("{method} {path} HTTP/1.1\r\n{lines}\r\nConnection: close\r\n\r\n");
    let bytes = exchange(address, request.as_bytes());
    let end = bytes.windows(4).position(|w| w == b"\r\n\r\n").unwrap_or_else(|| panic!("no head"));
    let head = String::from_utf8(bytes[..end].to_vec()).unwrap();
    let status = head.split(' ').nth(1).unwrap().parse().unwrap();
    Answer { status, head, body: bytes[end + 4..].to_vec() }
}

fn get(preview: &Preview, path: &str) -> Answer {
    ask(preview.address(), "GET", path, &[])
}

#[test]
fn every_address_answers_and_keeps_safe() {
    let preview = start(None);
    let address = preview.address();
    for (method, path, status, kind) in [
        ("GET", "/", 200, Some("text/html; charset=utf-8")),
        ("GET", "/?token=none-needed-here", 200, Some("text/html; charset=utf-8")),
        ("GET", "/state.json", 200, Some("application/json")),
        ("GET", "/frame.jpg", 204, None),
        ("GET", "/healthz", 503, Some("text/plain; charset=utf-8")),
        ("GET", "/../etc/passwd", 404, Some("text/plain; charset=utf-8")),
        ("GET", "/state.json/", 404, Some("text/plain; charset=utf-8")),
        ("POST", "/", 405, Some("text/plain; charset=utf-8")),
        ("DELETE", "/state.json", 405, Some("text/plain; charset=utf-8")),
    ] {
        let answer = ask(address, method, path, &[]);
        assert_eq!(answer.status, status, "{method} {path}");
        assert_eq!(answer.field("Content-Type"), kind, "{method} {path}");
        assert_eq!(answer.field("Cache-Control"), Some("no-store"));
        assert_eq!(answer.field("X-Content-Type-Options"), Some("nosniff"));
        assert_eq!(answer.field("Cross-Origin-Resource-Policy"), Some("same-origin"));
        if kind == Some("text/plain; charset=utf-8") {
            assert_eq!(answer.text().lines().count(), 1, "{method} {path}");
        }
    }
    assert_eq!(ask(address, "PUT", "/", &[]).field("Allow"), Some("GET, HEAD"));
    let page = get(&preview, "/");
    let policy = page.field("Content-Security-Policy").unwrap();
    assert!(policy.starts_with("default-src 'none'; script-src 'sha256-"), "{policy}");
    for outside in ["http://", "https://", "src=", "@import", "url("] {
        // The name of a kind of elements is no address.
        let text = page.text().replace("http://www.w3.org/2000/svg", "");
        assert!(!text.contains(outside), "{outside}");
    }
    let head = ask(address, "HEAD", "/", &[]);
    assert_eq!((head.status, head.body.len()), (200, 0));
    assert_eq!(head.field("Content-Length"), page.field("Content-Length"));
}

#[test]
fn blueos_finds_the_page() {
    let preview = start(Some("a-token-of-enough-letters"));
    let service = get(&preview, "/register_service").json();
    for key in ["name", "description", "icon", "company", "version", "webpage", "api"] {
        assert!(service[key].is_string(), "{key}: {service}");
    }
    assert_eq!(
        (&service["name"], &service["works_in_relative_paths"]),
        (&json!("Lookout"), &json!(true))
    );
    assert_eq!(service["version"], env!("CARGO_PKG_VERSION"));
}

#[test]
fn the_state_is_the_newest_published() {
    let preview = start(None);
    assert_eq!(get(&preview, "/state.json").json()["health"]["state"], "starting");
    for frames in 1..=500 {
        preview.publish(warning(frames));
    }
    let mut state = get(&preview, "/state.json").json();
    let age = state["age_ms"].take().as_u64().unwrap();
    assert!(age < LONG.as_millis() as u64, "{age}");
    let track = |id: u16, rect: [f64; 4], level: &str, coasting: bool| json!({"id": id, "rect": rect, "level": level, "confirmed": true, "coasting": coasting});
    let mut far = track(12, [40.5, 90.25, 10.0, 5.0], "traffic", true);
    let mut near = track(7, [200.0, 60.0, 12.0, 6.0], "warning", false);
    let merge = |a: &mut Value, b: Value| {
        a.as_object_mut().unwrap().extend(b.as_object().unwrap().clone());
    };
    merge(
        &mut far,
        json!({"azimuth_deg": -22.0, "elevation_deg": -1.5, "range_m": null, "range_sigma_m": null, "callsign": "", "muted": false, "time_to_contact_s": null, "score": 0.5}),
    );
    merge(
        &mut near,
        json!({"azimuth_deg": 9.25, "elevation_deg": 12.0, "range_m": 84.2, "range_sigma_m": 59.1, "callsign": "", "muted": false, "time_to_contact_s": 6.04, "score": 3.456}),
    );
    let expected = json!({
        "age_ms": null,
        "time_us": 20_000_000,
        "tracks": [far, near],
        "level": "warning",
        "health": {
            "state": "watching", "blind": [], "frames": 500, "dropped": 3, "frames_per_second": 24.96,
            "camera": "/dev/video0, 640x480 GREY", "advice": null,
        },
        "latency": [
            {"stage": "exposure to frame", "p50_ms": 8.14, "p99_ms": 11.0},
            {"stage": "detector", "p50_ms": 21.5, "p99_ms": 34.25},
        ],
        "autopilot_lost": false,
        "off_map": null,
        "parameters": [],
        "links": [
            {"name": "serial:/dev/ttyAMA0:921600", "state": "up", "sent": 5120, "dropped": 0},
            {"name": "udpout:192.168.2.1:14550", "state": "down", "sent": 12, "dropped": 7},
        ],
        "autopilot": "ArduPilot 4.6, system 1",
        "field_of_view_deg": 62.0,
        "camera_azimuth_deg": 0.0,
    });
    assert_eq!(state, expected);
}

#[test]
fn monitors_are_told_whether_it_watches() {
    let preview = start(None);
    let health = || {
        let answer = get(&preview, "/healthz");
        (answer.status, answer.text().trim_end().to_owned())
    };
    assert_eq!(health(), (503, "starting: no frame yet".into()));
    preview.publish(quiet(1));
    assert_eq!(health(), (200, "watching: 25.0 frames a second".into()));
    let mut blind = quiet(2);
    blind.health.state = StateView::Blind;
    blind.health.blind = Blind::GLARE.and(Blind::BLUR);
    preview.publish(blind);
    assert_eq!(health(), (503, "blind: glare, blurred".into()));
    let mut gone = quiet(2);
    gone.health.state = StateView::CameraGone;
    preview.publish(gone);
    assert_eq!(health(), (503, "camera gone".into()));
    preview.publish(quiet(3));
    assert_eq!(health().0, 200);
    // A loop that speaks on about the same frame does not watch, whatever it says.
    let end = Instant::now() + Duration::from_millis(2100);
    while Instant::now() < end {
        preview.publish(quiet(3));
        sleep(Duration::from_millis(50));
    }
    let (status, line) = health();
    assert!(status == 503 && line.starts_with("no frame for "), "{line}");
}

#[test]
fn the_picture_is_the_one_published() {
    let preview = start(None);
    assert!(!preview.wants_picture(), "nobody looks");
    assert_eq!(get(&preview, "/frame.jpg").status, 204);
    assert!(preview.wants_picture());
    // Again and again: a busy machine may pause just here for longer than the pause between pictures.
    let rests = (0..20).any(|_| {
        preview.publish(Snapshot { picture: Some(picture()), ..warning(1) });
        !preview.wants_picture()
    });
    assert!(rests, "not yet again");
    // A snapshot without a picture keeps the picture before, and the boxes in it.
    preview.publish(quiet(2));
    let answer = get(&preview, "/frame.jpg");
    assert_eq!((answer.status, answer.field("Content-Type")), (200, Some("image/jpeg")));
    let tracks: Value = serde_json::from_str(answer.field("Lookout-Tracks").unwrap()).unwrap();
    assert_eq!(tracks[1]["rect"], json!([200.0, 60.0, 12.0, 6.0]));
    let shown = image::load_from_memory(&answer.body).unwrap();
    assert_eq!(shown.color(), image::ColorType::L8);
    let shown = shown.into_luma8();
    assert_eq!(shown.dimensions(), (WIDTH as u32, HEIGHT as u32));
    let apart = |(a, b): (&u8, &u8)| u32::from(a.abs_diff(*b));
    let errors: Vec<u32> = shown.as_raw().iter().zip(&picture().pixels).map(apart).collect();
    let mean = f64::from(errors.iter().sum::<u32>()) / errors.len() as f64;
    assert!(mean < 2.0, "{mean}");
    assert!(*errors.iter().max().unwrap() < 60);

    let tag = answer.field("ETag").unwrap();
    let again = |tag: &str| {
        let field = format!("If-None-Match: {tag}");
        ask(preview.address(), "GET", "/frame.jpg", &[&field]).status
    };
    assert_eq!((again(tag), again("\"0\"")), (304, 200));
    sleep(Duration::from_millis(100));
    assert!(preview.wants_picture(), "the pause is over");
    preview.publish(Snapshot { picture: Some(picture()), ..quiet(3) });
    assert_eq!(again(tag), 200, "the next picture");
    // A picture of another size than it says is none.
    for (width, height) in [(0, 0), (WIDTH + 1, HEIGHT), (usize::MAX, usize::MAX), (70_000, 1)] {
        let pixels = vec![0; if height == 1 { width } else { 9 }];
        let broken = PictureView { pixels, width, height };
        preview.publish(Snapshot { picture: Some(broken), ..quiet(4) });
        assert_eq!(get(&preview, "/frame.jpg").body.len(), answer.body.len());
    }
    sleep(Duration::from_secs(2));
    assert_eq!(get(&preview, "/frame.jpg").status, 204, "an old picture is none");
    sleep(Duration::from_millis(3100));
    assert!(!preview.wants_picture(), "nobody looks any more");
}

#[test]
fn others_need_the_token() {
    const TOKEN: &str = "abcdefgh-0123.XYZ~_";
    let anywhere: SocketAddr = ([0, 0, 0, 0], 0).into();
    let refused =
        |token: Option<&str>| Preview::start(anywhere, token.map(str::to_owned)).unwrap_err();
    assert!(matches!(refused(None), PreviewError::NoToken { .. }));
    assert!(refused(None).to_string().starts_with("preview 0.0.0.0:0: others can reach"));
    for bad in
        ["", "fifteen-letters", "sixteen letters!", "sixteen-letters\u{e9}", &"a".repeat(257)]
    {
        assert!(matches!(refused(Some(bad)), PreviewError::Token), "{bad}");
    }

    let preview = Preview::start(anywhere, Some(TOKEN.into())).unwrap();
    assert!(!format!("{preview:?}").contains(TOKEN));
    let address: SocketAddr = ([127, 0, 0, 1], preview.address().port()).into();
    // By whatever name the vehicle has there.
    let status = |path: &str, fields: &[&str]| {
        let answer = ask(address, "GET", path, &[&["Host: drone.local:8090"], fields].concat());
        assert!(
            !answer.head.contains(TOKEN) && !answer.body.windows(19).any(|w| w == TOKEN.as_bytes())
        );
        answer.status
    };
    assert_eq!(status("/", &[]), 200, "the page asks for the token");
    for path in ["/state.json", "/healthz"] {
        let open = if path == "/healthz" { 503 } else { 200 };
        let query = |token: &str| status(&format!("{path}?a=b&token={token}"), &[]);
        assert_eq!(query(TOKEN), open);
        assert_eq!(query(""), 401);
        assert_eq!(query(&TOKEN[..18]), 401);
        assert_eq!(query(&format!("{TOKEN}a")), 401);
        assert_eq!(query(&TOKEN.to_lowercase()), 401);
        assert_eq!(status(path, &[]), 401);
        assert_eq!(status(path, &[&format!("Authorization: bearer {TOKEN}")]), open);
        assert_eq!(status(path, &["Authorization: Bearer wrong"]), 401);
        assert_eq!(status(path, &[&format!("Authorization: Basic {TOKEN}")]), 401);
    }
    assert_eq!(status("/frame.jpg", &[]), 401);
    assert!(!preview.wants_picture(), "who may not look has not looked");
    let answer = ask(address, "GET", "/state.json", &[]);
    assert_eq!(answer.field("WWW-Authenticate"), Some("Bearer"));
}

#[test]
fn guesses_are_limited() {
    const TOKEN: &str = "a-token-of-enough-letters";
    let preview = start(Some(TOKEN));
    let status = |token: &str| get(&preview, &format!("/state.json?token={token}")).status;
    assert_eq!(status(TOKEN), 200);
    // A page goes on asking with what was entered.
    assert!((0..50).all(|_| status("wrong") == 401));
    assert!((0..19).all(|guess| status(&format!("guess-{guess}")) == 401));
    assert_eq!(status("another"), 429);
    assert_eq!(status(TOKEN), 429, "not even compared");
}

#[test]
fn a_name_made_to_lead_here_is_refused() {
    let preview = start(None);
    let port = preview.address().port();
    let status = |host: &str| {
        ask(preview.address(), "GET", "/state.json", &[&format!("Host: {host}")]).status
    };
    for ours in
        ["127.0.0.1", "localhost", "LocalHost:1", "[::1]:8090", &format!("127.0.0.1:{port}")]
    {
        assert_eq!(status(ours), 200, "{ours}");
    }
    for other in
        ["", "evil.example", "127.0.0.1.evil.example", "localhost.evil.example:80", "10.0.0.7"]
    {
        assert_eq!(status(other), 403, "{other}");
    }
    let none = exchange(preview.address(), b"GET / HTTP/1.0\r\n\r\n");
    assert!(none.starts_with(b"HTTP/1.1 403 "));
}

#[test]
fn requests_follow_on_one_connection() {
    let preview = start(None);
    let one = "GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n";
    let last = "GET /none HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
    let bytes = exchange(preview.address(), [one, one, last, one].concat().as_bytes());
    let text = String::from_utf8(bytes).unwrap();
    let statuses: Vec<&str> = text.matches("HTTP/1.1 ").collect();
    assert_eq!(statuses.len(), 3, "{text}");
    assert!(text.contains("404 Not Found"));
}

#[test]
fn dropped_it_ends() {
    let preview = start(None);
    let address = preview.address();
    let held = connect(address);
    let start = Instant::now();
    drop(preview);
    assert!(start.elapsed() < Duration::from_secs(2));
    assert!(TcpStream::connect(address).is_err());
    hostile::closed_after(held, start);
    let again = Preview::start(address, None).unwrap();
    let taken = Preview::start(address, None).unwrap_err();
    assert!(taken.to_string().starts_with(&format!("preview {address}: ")), "{taken}");
    assert_eq!(get(&again, "/").status, 200);
}
