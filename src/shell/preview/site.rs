//! Routes: the page, the state, the picture, the health for monitors.

use super::board::{Board, STALE, Shown};
use super::guesses::Guesses;
use super::http::{RequestLine, Response, Status};
use super::snapshot::{HealthView, Snapshot, StateView};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::format;
use std::net::IpAddr;
use std::string::{String, ToString};
use std::sync::Arc;
use std::time::{Duration, Instant};
use std::vec::Vec;
use subtle::ConstantTimeEq;

/// Quality of the pictures, of 100.
const QUALITY: u8 = 70;

const HEAD: &str = "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\n\
    <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
    <meta name=\"color-scheme\" content=\"light dark\">\n\
    <link rel=\"icon\" href=\"data:,\"><title>Lookout</title>\n";
const STYLE: &str = include_str!("page.css");
const BODY: &str = include_str!("page.html");
const SCRIPT: &str = include_str!("page.js");

/// Router: responses to requests, from the newest snapshot.
pub struct Site {
    board: Arc<Board>,
    token: Option<String>,
    guesses: Guesses,
    /// Where it listens, when others than this machine's own programs cannot get there.
    loopback: Option<IpAddr>,
    /// The whole page: one file, nothing from elsewhere.
    page: String,
    /// Content security policy of the page: its own script and style, requests to this server only.
    policy: String,
    /// The last picture that was requested, encoded.
    encoded: Option<(u64, Vec<u8>)>,
}

/// The state as it is sent.
#[derive(Serialize)]
struct Answered<'a> {
    #[serde(flatten)]
    snapshot: &'a Snapshot,
    /// Milliseconds since it was published.
    age_ms: u64,
}

impl Site {
    /// The site of a server that listens at `address`.
    pub fn new(board: Arc<Board>, token: Option<String>, address: IpAddr) -> Self {
        let page = format!(
            "{HEAD}<style>{STYLE}</style></head>\n{BODY}<script>{SCRIPT}</script>\n</html>\n"
        );
        let hash = |text: &str| STANDARD.encode(Sha256::digest(text));
        let policy = format!(
            "default-src 'none'; script-src 'sha256-{}'; style-src 'sha256-{}'; img-src data:; connect-src 'self'; \
             base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
            hash(SCRIPT),
            hash(STYLE)
        );
        let loopback = Some(address).filter(|address| address.is_loopback());
        Self { board, token, guesses: Guesses::default(), loopback, page, policy, encoded: None }
    }

    /// The answer to a request.
    pub fn answer(&mut self, request: &RequestLine, from: IpAddr) -> Response {
        if !matches!(request.method, "GET" | "HEAD") {
            let line = "405: this page only shows; use GET";
            return Response::text(Status::MethodNotAllowed, line).with("Allow", "GET, HEAD");
        }
        if !self.is_ours(request.host) {
            let line = "403: unknown host name; open this page at 127.0.0.1 or localhost";
            return Response::text(Status::Forbidden, line);
        }
        let answer: fn(&mut Self, &RequestLine) -> Response = match request.path {
            // No secret is in it; it asks for the token itself.
            "/" => return self.page(),
            "/register_service" => return Self::service(),
            "/state.json" => Self::state,
            "/frame.jpg" => Self::frame,
            "/healthz" => Self::health,
            _ => {
                let line =
                    "404: there are /, /state.json, /frame.jpg, /healthz and /register_service";
                return Response::text(Status::NotFound, line);
            }
        };
        let (now, needed) = (Instant::now(), self.token.is_some());
        if needed && !self.guesses.may_guess(from, now) {
            let line = "429: too many wrong tokens from this address; try again in a minute";
            return Response::text(Status::TooManyRequests, line).with("Retry-After", "60");
        }
        if !self.may_look(request) {
            if let Some(token) = given(request) {
                self.guesses.wrong(from, token, now);
            }
            let line = "401: give the token, as ?token=TOKEN or Authorization: Bearer TOKEN";
            return Response::text(Status::Unauthorized, line).with("WWW-Authenticate", "Bearer");
        }
        answer(self, request)
    }

    /// Whether the client asks for us by a name of this machine. A page from elsewhere whose name was made to lead here (DNS
    /// rebinding) asks by its own; where a token is needed, such a page has none.
    fn is_ours(&self, host: Option<&str>) -> bool {
        let Some(own) = self.loopback.filter(|_| self.token.is_none()) else { return true };
        let Some(host) = host else { return false };
        let port = |rest: &str| rest.is_empty() || rest.starts_with(':');
        let names = [
            "localhost".into(),
            "127.0.0.1".into(),
            "[::1]".into(),
            match own {
                IpAddr::V4(own) => own.to_string(),
                IpAddr::V6(own) => format!("[{own}]"),
            },
        ];
        let host = host.to_ascii_lowercase();
        names.iter().any(|name| host.strip_prefix(name.as_str()).is_some_and(port))
    }

    fn may_look(&self, request: &RequestLine) -> bool {
        let Some(token) = &self.token else { return true };
        let given = given(request).unwrap_or_default();
        // The time this takes says nothing about how much of a guess is right.
        given.as_bytes().ct_eq(token.as_bytes()).into()
    }

    fn page(&self) -> Response {
        Response::new(Status::Ok, "text/html; charset=utf-8", self.page.clone().into())
            .with("Content-Security-Policy", self.policy.as_str())
    }

    /// How BlueOS lists the page in its side bar: its helper asks every web server of the machine for this. Nothing secret
    /// is in it. Source: bluerobotics/BlueOS, `core/services/helper`, `ServiceMetadata`.
    fn service() -> Response {
        let body = serde_json::json!({
            "name": "Lookout",
            "description": "Watches for other aircraft through the vehicle's camera",
            "icon": "mdi-binoculars",
            "company": "The Lookout developers",
            "version": env!("CARGO_PKG_VERSION"),
            "webpage": "",
            "api": "",
            "works_in_relative_paths": true,
        });
        Response::new(Status::Ok, "application/json", body.to_string().into())
    }

    fn state(&mut self, _: &RequestLine) -> Response {
        let newest = self.board.read();
        let age_ms = u64::try_from(newest.age.as_millis()).unwrap_or(u64::MAX);
        let reading = Answered { snapshot: &newest.snapshot, age_ms };
        // Numbers and words only: nothing of it can fail to be written.
        let body = serde_json::to_vec(&reading).unwrap_or_default();
        Response::new(Status::Ok, "application/json", body)
    }

    /// The picture, and in a header field what was followed in it.
    fn frame(&mut self, request: &RequestLine) -> Response {
        let Some(shown) = self.board.look() else { return Response::empty(Status::NoContent) };
        let tag = format!("\"{}\"", shown.number);
        if request.if_none_match == Some(tag.as_str()) {
            return Response::empty(Status::NotModified).with("ETag", tag);
        }
        let Some(jpeg) = self.encode(&shown) else { return Response::empty(Status::NoContent) };
        let tracks = serde_json::to_string(&shown.tracks).unwrap_or_default();
        Response::new(Status::Ok, "image/jpeg", jpeg)
            .with("ETag", tag)
            .with("Lookout-Tracks", tracks)
    }

    /// The picture as JPEG, made once however many look.
    fn encode(&mut self, shown: &Shown) -> Option<Vec<u8>> {
        if let Some((number, jpeg)) = &self.encoded
            && *number == shown.number
        {
            return Some(jpeg.clone());
        }
        let start = Instant::now();
        let picture = &shown.picture;
        let mut jpeg = Vec::new();
        let side = |pixels: usize| u32::try_from(pixels).unwrap_or(u32::MAX);
        let (width, height) = (side(picture.width), side(picture.height));
        JpegEncoder::new_with_quality(&mut jpeg, QUALITY)
            .encode(&picture.pixels, width, height, ExtendedColorType::L8)
            .ok()?;
        self.board.encoded_in(start.elapsed());
        self.encoded = Some((shown.number, jpeg.clone()));
        Some(jpeg)
    }

    fn health(&mut self, _: &RequestLine) -> Response {
        let newest = self.board.read();
        match trouble(&newest.snapshot.health, newest.frame_age) {
            Some(trouble) => Response::text(Status::Unavailable, &trouble),
            None => {
                let rate = newest.snapshot.health.frames_per_second;
                Response::text(Status::Ok, &format!("watching: {rate:.1} frames a second"))
            }
        }
    }
}

/// The token of a request.
fn given<'a>(request: &RequestLine<'a>) -> Option<&'a str> {
    let bearer = request.authorization.and_then(|value| {
        let (scheme, token) = value.split_once(' ')?;
        scheme.eq_ignore_ascii_case("bearer").then_some(token.trim())
    });
    bearer.or_else(|| request.parameter("token"))
}

/// Reasons why nothing is watched.
fn trouble(health: &HealthView, frame_age: Option<Duration>) -> Option<String> {
    let Some(age) = frame_age else { return Some("starting: no frame yet".into()) };
    if health.state == StateView::CameraGone {
        return Some("camera gone".into());
    }
    if health.state == StateView::Slow {
        return Some("the detector is too slow".into());
    }
    if age >= STALE {
        return Some(format!("no frame for {} s", age.as_secs()));
    }
    if health.state == StateView::Blind || health.blind.any() {
        let reasons: Vec<&str> = health.reasons().collect();
        return Some(format!("blind: {}", reasons.join(", ")));
    }
    None
}
