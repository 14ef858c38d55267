//! As much of HTTP/1.1 as the page needs: requests without a body, short answers (RFC 9112).

use std::string::String;
use std::vec::Vec;

/// Most bytes of a request; browsers send less than 2000.
pub const MAX_REQUEST: usize = 8192;

/// Most header fields of a request.
const MAX_FIELDS: usize = 48;

/// The request line.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct RequestLine<'a> {
    /// Method of the request, as `GET`.
    pub method: &'a str,
    /// The part of the target before a question mark.
    pub path: &'a str,
    /// The part after it.
    pub query: &'a str,
    /// The host the client believes to speak to.
    pub host: Option<&'a str>,
    /// Credentials of the header `Authorization`.
    pub authorization: Option<&'a str>,
    /// The tag of the picture that the client has.
    pub if_none_match: Option<&'a str>,
    /// Whether the connection ends with the answer: the client wants it, or sends a body that nobody reads.
    pub close: bool,
}

impl<'a> RequestLine<'a> {
    /// The request at the start of `bytes` and its length; nothing where its end is not there yet.
    ///
    /// # Errors
    /// The status to answer with when it is no request.
    pub fn parse(bytes: &'a [u8]) -> Result<Option<(Self, usize)>, Status> {
        let mut fields = [httparse::EMPTY_HEADER; MAX_FIELDS];
        let mut parsed = httparse::Request::new(&mut fields);
        let length = match parsed.parse(bytes) {
            Ok(httparse::Status::Complete(length)) => length,
            Ok(httparse::Status::Partial) if bytes.len() < MAX_REQUEST => return Ok(None),
            Ok(httparse::Status::Partial) | Err(httparse::Error::TooManyHeaders) => {
                return Err(Status::TooLarge);
            }
            Err(_) => return Err(Status::BadRequest),
        };
        let target = parsed.path.unwrap_or_default();
        let (path, query) = target.split_once('?').unwrap_or((target, ""));
        let mut request =
            Self { method: parsed.method.unwrap_or_default(), path, query, ..Self::default() };
        request.close = parsed.version == Some(0);
        for field in parsed.headers.iter() {
            let Ok(value) = std::str::from_utf8(field.value).map(str::trim) else {
                continue;
            };
            let is = |name: &str| field.name.eq_ignore_ascii_case(name);
            if is("host") {
                // Of two hosts nobody knows which one is meant.
                if request.host.replace(value).is_some() {
                    return Err(Status::BadRequest);
                }
            } else if is("authorization") {
                request.authorization = Some(value);
            } else if is("if-none-match") {
                request.if_none_match = Some(value);
            } else if is("connection") {
                let mut words = value.split(',');
                request.close |= words.any(|word| word.trim().eq_ignore_ascii_case("close"));
            } else if is("transfer-encoding") || is("content-length") && value != "0" {
                request.close = true;
            }
        }
        Ok(Some((request, length)))
    }

    /// The value of `name` in the query, as it stands there.
    pub fn parameter(&self, name: &str) -> Option<&'a str> {
        let mut pairs = self.query.split('&').filter_map(|pair| pair.split_once('='));
        pairs.find(|(key, _)| *key == name).map(|(_, value)| value)
    }
}

/// How a request ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// 200.
    Ok,
    /// There is nothing to show yet.
    NoContent,
    /// The client has it.
    NotModified,
    /// 400: not a request.
    BadRequest,
    /// The token is missing or wrong.
    Unauthorized,
    /// Asked for under a name that is not ours.
    Forbidden,
    /// 404.
    NotFound,
    /// Nothing can be changed here.
    MethodNotAllowed,
    /// A request that is too long.
    TooLarge,
    /// Too many wrong tokens.
    TooManyRequests,
    /// The lookout does not watch.
    Unavailable,
}

impl Status {
    /// Number and words of the status line.
    fn line(self) -> &'static str {
        match self {
            Self::Ok => "200 OK",
            Self::NoContent => "204 No Content",
            Self::NotModified => "304 Not Modified",
            Self::BadRequest => "400 Bad Request",
            Self::Unauthorized => "401 Unauthorized",
            Self::Forbidden => "403 Forbidden",
            Self::NotFound => "404 Not Found",
            Self::MethodNotAllowed => "405 Method Not Allowed",
            Self::TooManyRequests => "429 Too Many Requests",
            Self::TooLarge => "431 Request Header Fields Too Large",
            Self::Unavailable => "503 Service Unavailable",
        }
    }
}

/// A response with its headers.
#[derive(Debug)]
pub struct Response {
    /// Status code and its phrase.
    pub status: Status,
    /// Header fields, values without line ends.
    pub fields: Vec<(&'static str, String)>,
    /// Bytes after the header.
    pub body: Vec<u8>,
}

/// Fields of every answer: nothing is kept by caches, nothing is guessed, no other site takes it into its own pages.
const SAFE: &str = "Cache-Control: no-store\r\n\
    X-Content-Type-Options: nosniff\r\n\
    Referrer-Policy: no-referrer\r\n\
    Cross-Origin-Resource-Policy: same-origin\r\n";

impl Response {
    /// An answer of this type.
    pub fn new(status: Status, kind: &str, body: Vec<u8>) -> Self {
        Self { status, fields: Vec::from([("Content-Type", kind.into())]), body }
    }

    /// One line of text.
    pub fn text(status: Status, line: &str) -> Self {
        Self::new(status, "text/plain; charset=utf-8", [line.as_bytes(), b"\n"].concat())
    }

    /// No content at all.
    pub fn empty(status: Status) -> Self {
        Self { status, fields: Vec::new(), body: Vec::new() }
    }

    /// With one more field.
    pub fn with(mut self, name: &'static str, value: impl Into<String>) -> Self {
        self.fields.push((name, value.into()));
        self
    }

    /// The bytes to send; without the body for a HEAD request.
    pub fn into_bytes(self, close: bool, head: bool) -> Vec<u8> {
        let mut text = std::format!("HTTP/1.1 {}\r\n{SAFE}", self.status.line());
        let mut field = |name: &str, value: &str| {
            text.extend([name, ": ", value, "\r\n"]);
        };
        self.fields.iter().for_each(|(name, value)| field(name, value));
        if !matches!(self.status, Status::NoContent | Status::NotModified) {
            field("Content-Length", &std::format!("{}", self.body.len()));
        }
        if close {
            field("Connection", "close");
        }
        text.push_str("\r\n");
        let mut bytes = text.into_bytes();
        if !head {
            bytes.extend(self.body);
        }
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_browsers_request() {
        let bytes = b"GET /frame.jpg?a=1&token=x%20=y HTTP/1.1\r\nHOST: localhost:8090 \r\n\
            If-None-Match: \"7\"\r\nAuthorization: Bearer abc\r\n\r\nGET";
        let (request, length) = RequestLine::parse(bytes).unwrap().unwrap();
        assert_eq!(length, bytes.len() - 3);
        assert_eq!((request.method, request.path), ("GET", "/frame.jpg"));
        assert_eq!(request.parameter("token"), Some("x%20=y"));
        assert_eq!(request.parameter("tok"), None);
        assert_eq!(request.host, Some("localhost:8090"));
        assert_eq!(request.if_none_match, Some("\"7\""));
        assert_eq!(request.authorization, Some("Bearer abc"));
        assert!(!request.close);
        for end in 0..length {
            assert_eq!(RequestLine::parse(&bytes[..end]), Ok(None), "{end}");
        }
    }

    #[test]
    fn connections_that_end() {
        for (text, close) in [
            ("GET / HTTP/1.0\r\n\r\n", true),
            ("GET / HTTP/1.1\r\nConnection: a, Close\r\n\r\n", true),
            ("GET / HTTP/1.1\r\nContent-Length: 0\r\n\r\n", false),
            ("POST / HTTP/1.1\r\nContent-Length: 3\r\n\r\n", true),
            ("POST / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n", true),
        ] {
            let (request, _) = RequestLine::parse(text.as_bytes()).unwrap().unwrap();
            assert_eq!(request.close, close, "{text}");
        }
    }

    #[test]
    fn no_requests() {
        let two = "GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n";
        let many = std::format!("GET / HTTP/1.1\r\n{}\r\n", "a: b\r\n".repeat(MAX_FIELDS + 1));
        let long = std::format!("GET /{}", "a".repeat(MAX_REQUEST));
        for (text, status) in [
            ("\0\x01\r\n\r\n", Status::BadRequest),
            ("GET / HTTP/7\r\n\r\n", Status::BadRequest),
            (two, Status::BadRequest),
            (&many, Status::TooLarge),
            (&long[..MAX_REQUEST], Status::TooLarge),
        ] {
            assert_eq!(RequestLine::parse(text.as_bytes()), Err(status), "{text}");
        }
    }

    #[test]
    fn an_answer_in_bytes() {
        let sent = |close, head| {
            let response = Response::text(Status::NotFound, "no").with("Allow", "GET");
            String::from_utf8(response.into_bytes(close, head)).unwrap()
        };
        let text = sent(false, false);
        assert!(text.starts_with("HTTP/1.1 404 Not Found\r\n"), "{text}");
        assert!(text.contains("\r\nAllow: GET\r\nContent-Length: 3\r\n\r\nno\n"), "{text}");
        assert!(sent(true, true).ends_with("Content-Length: 3\r\nConnection: close\r\n\r\n"));
        let empty = String::from_utf8(Response::empty(Status::NoContent).into_bytes(false, false));
        assert!(!empty.unwrap().contains("Content-Length"));
    }

    proptest! {
        #[test]
        fn whatever_comes_is_a_request_or_none(bytes: Vec<u8>, tail in "[ -~\r\n]{0,200}") {
            for bytes in [bytes, std::format!("GET /{tail}\r\n\r\n").into_bytes()] {
                if let Ok(Some((request, length))) = RequestLine::parse(&bytes) {
                    prop_assert!(length <= bytes.len());
                    let _ = request.parameter("token");
                }
            }
        }
    }
}
