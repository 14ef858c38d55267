//! A headless Chromium, driven over its debugging pipe (Chrome DevTools Protocol).

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// How long the browser may take for anything, on a busy machine.
const PATIENCE: Duration = Duration::from_secs(30);

/// A running browser with one page; closed when dropped.
pub struct Browser {
    child: Child,
    orders: ChildStdin,
    messages: Receiver<Value>,
    number: u64,
    session: Option<String>,
    /// Errors and warnings of the page and its console.
    pub complaints: Vec<String>,
    _home: TempDir,
}

impl Browser {
    /// Nothing where there is no Chromium; says so.
    pub fn start() -> Option<Self> {
        let names = ["chromium", "chromium-browser", "google-chrome"];
        let runs = |name: &&str| Command::new(name).arg("--version").output().is_ok();
        let Some(name) = names.into_iter().find(runs) else {
            eprintln!("skipped: no chromium");
            return None;
        };
        let home = TempDir::new().unwrap();
        // The pipe is at 3 and 4 for the browser; the shell puts it there.
        let mut child = Command::new("sh")
            .args(["-c", r#"exec "$0" "$@" 3<&0 4>&1 </dev/null >/dev/null 2>&1"#, name])
            .args([
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-quic",
                "--no-first-run",
            ])
            .args([
                "--disable-background-networking",
                "--disable-component-update",
                "--disable-sync",
            ])
            .args(["--disable-dev-shm-usage", "--hide-scrollbars", "--remote-debugging-pipe"])
            .arg(format!("--user-data-dir={}", home.path().display()))
            .arg("about:blank")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let orders = child.stdin.take().unwrap();
        let output = child.stdout.take().unwrap();
        let (sender, messages) = channel();
        thread::spawn(move || {
            for message in BufReader::new(output).split(0) {
                let Ok(message) = message else { return };
                let message = serde_json::from_slice(&message).unwrap();
                if sender.send(message).is_err() {
                    return;
                }
            }
        });
        let complaints = Vec::new();
        let mut browser =
            Self { child, orders, messages, number: 0, session: None, complaints, _home: home };
        let target = browser.call("Target.createTarget", json!({"url": "about:blank"}));
        let attach = json!({"targetId": target["targetId"], "flatten": true});
        let session = browser.call("Target.attachToTarget", attach);
        browser.session = session["sessionId"].as_str().map(str::to_owned);
        for domain in ["Page", "Runtime", "Log"] {
            browser.call(&format!("{domain}.enable"), json!({}));
        }
        Some(browser)
    }

    /// Gives an order and waits for its result.
    pub fn call(&mut self, method: &str, parameters: Value) -> Value {
        self.number += 1;
        let mut order = json!({"id": self.number, "method": method, "params": parameters});
        if let Some(session) = &self.session {
            order["sessionId"] = json!(session);
        }
        self.orders.write_all(format!("{order}\0").as_bytes()).unwrap();
        loop {
            let message = self.messages.recv_timeout(PATIENCE);
            let mut message = message.unwrap_or_else(|error| panic!("{method}: {error}"));
            if message["id"] == self.number {
                assert!(message["error"].is_null(), "{method}: {}", message["error"]);
                return message["result"].take();
            }
            self.note(&message);
        }
    }

    fn note(&mut self, event: &Value) {
        let entry = &event["params"];
        match event["method"].as_str() {
            Some("Runtime.exceptionThrown") => self.complaints.push(entry.to_string()),
            Some("Runtime.consoleAPICalled") => self.complaints.push(entry["args"].to_string()),
            Some("Log.entryAdded") if entry["entry"]["level"] != "verbose" => {
                self.complaints.push(entry["entry"].to_string());
            }
            _ => {}
        }
    }

    /// Opens a page and waits until it is there.
    pub fn open(&mut self, address: &str) {
        let result = self.call("Page.navigate", json!({"url": address}));
        assert!(result["errorText"].is_null(), "{address}: {result}");
        self.until("document.readyState", "complete");
    }

    /// A screen of this size in CSS pixels, light or dark, of a phone or not.
    pub fn screen(&mut self, width: u32, height: u32, phone: bool, scheme: &str) {
        let scale = if phone { 2 } else { 1 };
        self.call(
            "Emulation.setDeviceMetricsOverride",
            json!({"width": width, "height": height, "deviceScaleFactor": scale, "mobile": phone}),
        );
        let features = json!([{"name": "prefers-color-scheme", "value": scheme}]);
        self.call("Emulation.setEmulatedMedia", json!({"features": features}));
    }

    /// The value of a JavaScript expression.
    pub fn value(&mut self, expression: &str) -> Value {
        let parameters =
            json!({"expression": expression, "returnByValue": true, "awaitPromise": true});
        let mut result = self.call("Runtime.evaluate", parameters);
        assert!(result["exceptionDetails"].is_null(), "{expression}: {result}");
        result["result"]["value"].take()
    }

    /// Waits until a JavaScript expression is `expected`.
    pub fn until(&mut self, expression: &str, expected: impl Into<Value>) {
        let expected = expected.into();
        let end = Instant::now() + PATIENCE;
        loop {
            let value = self.value(expression);
            if value == expected {
                return;
            }
            let text = |b: &mut Self| b.value("document.body.innerText");
            assert!(
                Instant::now() < end,
                "{expression} is {value}, not {expected}, on\n{}",
                text(self)
            );
            thread::sleep(Duration::from_millis(50));
        }
    }

    /// Text of the element of this `id`, as soon as it is this one.
    pub fn reads(&mut self, id: &str, text: &str) {
        self.until(&format!("document.getElementById('{id}').innerText"), text);
    }

    /// Writes the whole page as PNG.
    pub fn photograph(&mut self, path: &Path) {
        let parameters = json!({"captureBeyondViewport": true});
        let picture = self.call("Page.captureScreenshot", parameters);
        let bytes = STANDARD.decode(picture["data"].as_str().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        self.number += 1;
        let order = json!({"id": self.number, "method": "Browser.close"});
        let _ = self.orders.write_all(format!("{order}\0").as_bytes());
        let end = Instant::now() + Duration::from_secs(5);
        while Instant::now() < end {
            if let Ok(Some(_)) = self.child.try_wait() {
                return;
            }
            thread::sleep(Duration::from_millis(20));
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
