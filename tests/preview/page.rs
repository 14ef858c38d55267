//! The page in a browser, on a phone's screen and on a large one: it says what was published.

use super::browser::Browser;
use super::{picture, quiet, start, warning};
use lookout::mavlink::messages::Blind;
use lookout::shell::preview::snapshot::{LinkState, ParameterLine, StateView, TrackView};
use lookout::shell::preview::{Preview, Snapshot};
use lookout::tracking::traffic::AlertLevel;
use serde_json::{Value, json};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// A lookout that publishes the same again and again, frame by frame, as long as there is something to publish.
struct Loop {
    preview: Arc<Preview>,
    subject: Arc<Mutex<Option<Snapshot>>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Loop {
    fn start(preview: Preview) -> Self {
        let preview = Arc::new(preview);
        let subject = Arc::<Mutex<Option<Snapshot>>>::default();
        let stop = Arc::<AtomicBool>::default();
        let (publisher, source, end) = (preview.clone(), subject.clone(), stop.clone());
        let thread = thread::spawn(move || {
            let mut frames = 0;
            while !end.load(Ordering::Relaxed) {
                if let Some(mut snapshot) = source.lock().unwrap().clone() {
                    if snapshot.health.state != StateView::CameraGone {
                        frames += 1;
                        snapshot.picture = publisher.wants_picture().then(picture);
                    }
                    snapshot.health.frames = frames;
                    publisher.publish(snapshot);
                }
                thread::sleep(Duration::from_millis(40));
            }
        });
        Self { preview, subject, stop, thread: Some(thread) }
    }

    fn show(&self, snapshot: impl Into<Option<Snapshot>>) {
        *self.subject.lock().unwrap() = snapshot.into();
    }

    fn address(&self) -> String {
        format!("http://{}/", self.preview.address())
    }
}

impl Drop for Loop {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.take().unwrap().join().unwrap();
    }
}

/// Texts that are hard to read.
const FAINT: &str = include_str!("faint.js");

/// Boxes drawn over the picture in pixels of the page: id, left, top, width, height of what is inside the outline.
const BOXES: &str = r##"[...document.querySelectorAll("#boxes g")].map((g) => {
  const [canvas, box] = [document.getElementById("picture"), g.querySelector(".line")].map((e) => e.getBoundingClientRect());
  const scale = document.getElementById("picture").width / canvas.width;
  return [Number(g.dataset.id), (box.left - canvas.left) * scale, (box.top - canvas.top) * scale, box.width * scale, box.height * scale];
})"##;

fn rows(browser: &mut Browser, id: &str) -> Value {
    browser.value(&format!(
        "[...document.querySelectorAll('#{id} tbody tr')].map((r) => [...r.cells].map((c) => c.innerText))"
    ))
}

/// Checks for every screen: nothing is cut off at the side, every text can be read.
fn fits(browser: &mut Browser, name: &str) {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("preview-{name}.png"));
    browser.photograph(&path);
    let wider = "document.documentElement.scrollWidth - document.documentElement.clientWidth";
    assert_eq!(browser.value(wider), 0, "{name}: wider than the screen");
    let cut = r#"[...document.querySelectorAll("main *")].filter((e) => e.getBoundingClientRect().right > document.documentElement.clientWidth + 1).map((e) => e.outerHTML)"#;
    assert_eq!(browser.value(cut), json!([]), "{name}: cut off");
    assert_eq!(browser.value(FAINT), json!([]), "{name}: too faint");
}

#[test]
fn the_page_says_what_was_published() {
    let Some(mut browser) = Browser::start() else { return };
    let lookout = Loop::start(start(None));
    browser.screen(390, 844, true, "light");
    browser.open(&lookout.address());
    browser.reads("level", "Not watching");
    browser.reads("fault", "Starting: no frame yet.");

    lookout.show(quiet(0));
    browser.reads("level", "No alert");
    browser.reads("detail", "No object followed.");
    browser.until("document.getElementById('fault').hidden", true);
    browser.until("document.getElementById('caption').innerText", "");
    for (id, text) in [
        ("state", "watching"),
        ("camera", "/dev/video0, 640x480 GREY"),
        ("rate", "25.0 frames a second"),
        ("autopilot", "ArduPilot 4.6, system 1"),
        ("nothing", "None followed."),
    ] {
        browser.reads(id, text);
    }
    browser
        .until("/^\\d+ seen, 3 dropped$/.test(document.getElementById('frames').innerText)", true);
    let latency =
        json!([["exposure to frame", "8.1 ms", "11.0 ms"], ["detector", "21.5 ms", "34.3 ms"]]);
    assert_eq!(rows(&mut browser, "latency"), latency);
    let links = json!([
        ["serial:/dev/ttyAMA0:921600", "up", "5120", "0"],
        ["udpout:192.168.2.1:14550", "down", "12", "7"]
    ]);
    assert_eq!(rows(&mut browser, "links"), links);
    // The picture itself: sky, ground, and the dark thing in the sky.
    for (x, y) in [(20, 20), (300, 230), (206, 63)] {
        let grey = format!(
            "(() => {{ const pixel = new OffscreenCanvas(1, 1).getContext('2d'); \
             pixel.drawImage(document.getElementById('picture'), {}, {}); \
             return pixel.getImageData(0, 0, 1, 1).data[0]; }})()",
            -x, -y
        );
        let shown = browser.value(&grey).as_u64().unwrap() as u8;
        let published = picture().pixels[y as usize * super::WIDTH + x as usize];
        assert!(shown.abs_diff(published) < 12, "at {x}, {y}: {shown}, published {published}");
    }
    fits(&mut browser, "phone-quiet");

    lookout.show(warning(0));
    browser.reads("level", "Warning");
    browser.reads("detail", "Object 7: 9.3° right, 12.0° up, about 84 ± 59 m, contact in 6.0 s");
    browser.until("document.title", "Warning – Lookout");
    let colour = "getComputedStyle(document.getElementById('banner')).backgroundColor";
    assert_eq!(browser.value(colour), "rgb(179, 0, 27)");
    let objects = json!([
        ["7warning", "9.3° right, 12.0° up", "84 ± 59 m", "6.0 s", "3.46"],
        ["12traffic", "22.0° left, 1.5° down", "–", "–", "0.50"]
    ]);
    assert_eq!(rows(&mut browser, "objects"), objects);
    browser.until("document.querySelectorAll('#boxes g').length", 2);
    let boxes = browser.value(BOXES);
    for (drawn, track) in boxes.as_array().unwrap().iter().zip(warning(0).tracks) {
        let drawn: Vec<f64> =
            drawn.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
        let [left, top, width, height] = track.rect;
        let scale = super::WIDTH as f64 / 390.0;
        assert_eq!(drawn[0], f64::from(track.id));
        // Around the box, at a distance of a few pixels of the screen.
        let gaps =
            [left - drawn[1], top - drawn[2], (drawn[3] - width) / 2.0, (drawn[4] - height) / 2.0];
        assert!(gaps.iter().all(|gap| (2.0..8.0).contains(&(gap / scale))), "{gaps:?}");
    }
    // On the map: 9.25 degrees right of the nose at 84.2 of 100 m, and one to the left at the rim.
    let marks = browser.value(
        "[...document.querySelectorAll('#map .track')].map((g) => [g.dataset.id, g.classList.contains('far'), g.querySelector('.mark').getAttribute('transform')])",
    );
    assert_eq!(marks[1][0], "7");
    assert_eq!(marks[1][1], false);
    let place =
        marks[1][2].as_str().unwrap().trim_matches(|c: char| !c.is_ascii_digit() && c != '-');
    let place: Vec<f64> = place.split(' ').map(|v| v.parse().unwrap()).collect();
    let (sine, cosine) = 9.25f64.to_radians().sin_cos();
    assert!(
        (place[0] - 84.2 * sine).abs() < 0.01 && (place[1] + 84.2 * cosine).abs() < 0.01,
        "{place:?}"
    );
    assert_eq!((&marks[0][0], &marks[0][1]), (&json!("12"), &json!(true)));
    fits(&mut browser, "phone-warning");
    browser.screen(390, 844, true, "dark");
    fits(&mut browser, "phone-warning-dark");
    for (scheme, name) in [("light", "desktop-warning"), ("dark", "desktop-warning-dark")] {
        browser.screen(1280, 800, false, scheme);
        browser.until("innerWidth", 1280);
        fits(&mut browser, name);
    }
    let mut caution = warning(0);
    caution.level = lookout::tracking::traffic::AlertLevel::Caution;
    caution.tracks[1].level = caution.level;
    lookout.show(caution);
    browser.reads("level", "Caution");
    fits(&mut browser, "desktop-caution-dark");

    // NaN is not shown as a number, and names are escaped.
    let mut odd = warning(0);
    odd.health.frames_per_second = f64::NAN;
    odd.tracks[1].azimuth_deg = Some(f64::NAN);
    odd.autopilot = Some("<b>one</b> & another".into());
    lookout.show(odd);
    browser.reads("autopilot", "<b>one</b> & another");
    browser.reads("rate", "–");
    browser.reads("detail", "Object 7: –, 12.0° up, about 84 ± 59 m, contact in 6.0 s");

    let mut blind = quiet(0);
    blind.health.state = StateView::Blind;
    blind.health.blind = Blind::DARK.and(Blind::COVERED);
    lookout.show(blind);
    browser.reads("fault", "Blind: too dark, covered or frozen.");
    browser.reads("level", "Not watching");
    let mut gone = quiet(0);
    gone.health.state = StateView::CameraGone;
    lookout.show(gone);
    browser.reads("fault", "Camera gone: no pictures come.");
    browser.reads("state", "camera gone");
    browser.until(
        "/^No new picture for \\d+ s$/.test(document.getElementById('caption').innerText)",
        true,
    );

    browser.screen(390, 844, true, "light");
    lookout.show(warning(0));
    browser.reads("level", "Warning");
    browser.until("document.getElementById('fault').hidden", true);
    lookout.show(None);
    let fault =
        |words: &str| format!("/^{words}/.test(document.getElementById('fault').innerText)");
    browser.until(&fault("The lookout stands still: nothing new for [2-9] s\\.$"), true);
    browser.reads("level", "Unknown");
    lookout.show(quiet(0));
    browser.reads("level", "No alert");
    assert_eq!(browser.complaints, Vec::<String>::new());

    lookout.show(warning(0));
    browser.reads("level", "Warning");
    drop(lookout);
    browser.until(&fault("No connection for [2-9] s\\. What is shown is old\\.$"), true);
    browser.reads("level", "Unknown");
    assert_eq!(browser.value("document.getElementById('all').className"), "old");
    fits(&mut browser, "phone-no-connection");
}

/// Pairs of texts within these elements that lie on one another, and texts outside of the element.
fn label_faults(browser: &mut Browser, id: &str) -> Value {
    browser.value(&format!(
        r##"(() => {{
  const around = document.getElementById("{id}").getBoundingClientRect();
  const texts = [...document.querySelectorAll("#{id} text[data-id]")].map((e) => [e.textContent, e.getBoundingClientRect()]);
  const over = (a, b) => a.left < b.right - 1 && b.left < a.right - 1 && a.top < b.bottom - 1 && b.top < a.bottom - 1;
  const faults = [];
  texts.forEach(([name, a], i) => {{
    texts.slice(i + 1).forEach(([other, b]) => {{ if (over(a, b)) faults.push(`${{name}} on ${{other}}`); }});
    if (a.left < around.left - 1 || a.right > around.right + 1 || a.top < around.top - 1 || a.bottom > around.bottom + 1) faults.push(`${{name}} outside`);
  }});
  return texts.length ? faults : ["no texts"];
}})()"##
    ))
}

/// Objects close together, in a corner, at the edge and alone.
fn crowd() -> Snapshot {
    let mut snapshot = warning(0);
    let template = snapshot.tracks[1].clone();
    let levels = [AlertLevel::Warning, AlertLevel::Caution, AlertLevel::Traffic, AlertLevel::None];
    snapshot.tracks = (0..12u16)
        .map(|i| {
            let at = f64::from(i);
            let rect = match i {
                0..6 => [150.0 + at * 9.0, 100.0 + at * 2.0, 12.0, 6.0],
                6..9 => [300.0 - at, 2.0 + at, 12.0, 6.0],
                _ => [at, 225.0 - at, 14.0, 7.0],
            };
            let level = levels[usize::from(i) % 4];
            let azimuth_deg = Some((rect[0] - 160.0) / 160.0 * 31.0);
            TrackView { id: 9990 + i, rect, level, azimuth_deg, ..template.clone() }
        })
        .collect();
    snapshot
}

#[test]
fn labels_do_not_overlap_and_cards_are_full() {
    let Some(mut browser) = Browser::start() else { return };
    let lookout = Loop::start(start(None));
    lookout.show(crowd());
    browser.screen(390, 844, true, "light");
    browser.open(&lookout.address());
    for (width, height, phone) in
        [(390, 844, true), (360, 640, true), (1280, 800, false), (1920, 1080, false)]
    {
        browser.screen(width, height, phone, "light");
        browser.until("innerWidth", width);
        browser.until("document.querySelectorAll('#boxes g').length", 12);
        // The picture after the change of the screen.
        thread::sleep(Duration::from_millis(700));
        for id in ["boxes", "map"] {
            assert_eq!(label_faults(&mut browser, id), json!([]), "{id} at {width}x{height}");
        }
        fits(&mut browser, &format!("crowd-{width}"));
    }
    lookout.show(warning(0));
    for (width, height, phone) in [(390, 844, true), (1280, 800, false), (1920, 1080, false)] {
        browser.screen(width, height, phone, "light");
        browser.until("innerWidth", width);
        browser.until("document.querySelectorAll('#objects tbody tr').length", 2);
        // The part of each card below its content; a drawing counts as far as it is drawn.
        let empty = r##"[...document.querySelectorAll("main > section")].filter((e) => !e.hidden).map((card) => {
  const box = card.getBoundingClientRect();
  const ends = [...card.children].filter((e) => !e.hidden).map((e) => e.getBoundingClientRect().bottom);
  const map = card.querySelector("#map")?.getBoundingClientRect();
  const unused = map ? Math.max(map.height - map.width, 0) : 0;
  return [card.innerText.slice(0, 20), (box.bottom - Math.max(...ends) + unused) / box.height];
}).filter(([, share]) => share > 0.2)"##;
        assert_eq!(browser.value(empty), json!([]), "{width}x{height}");
    }
}

#[test]
fn links_and_autopilot_that_do_not_answer_stand_out() {
    let Some(mut browser) = Browser::start() else { return };
    let lookout = Loop::start(start(None));
    let mut snapshot = quiet(0);
    snapshot.links[1].state = LinkState::Silent;
    snapshot.autopilot = None;
    snapshot.parameters = vec![
        ParameterLine { name: "LK_WINGSPAN", value: 0.35, range: [0.0625, 100.0] },
        ParameterLine { name: "LK_TEXT", value: 1.0, range: [0.0, 1.0] },
    ];
    lookout.show(snapshot.clone());
    browser.screen(390, 844, true, "light");
    browser.open(&lookout.address());
    browser.reads("autopilot", "none heard");
    let missing = "No autopilot heard: no traffic is on its map or that of a ground station.";
    browser.reads("fault", missing);
    browser.reads("level", "No alert");
    assert_eq!(rows(&mut browser, "links")[1][1], "no answer");
    let parameters = json!([["LK_WINGSPAN", "0.35", "0.0625 to 100"], ["LK_TEXT", "1", "0 to 1"]]);
    assert_eq!(rows(&mut browser, "parameters"), parameters);
    fits(&mut browser, "phone-no-autopilot");
    snapshot.autopilot = Some("system 1".into());
    snapshot.autopilot_lost = true;
    lookout.show(snapshot.clone());
    browser.reads("autopilot", "system 1lost");
    browser.until("document.getElementById('fault').innerText.startsWith('Autopilot lost')", true);
    // Back, and a page without links needs none.
    snapshot.autopilot_lost = false;
    lookout.show(snapshot.clone());
    browser.until("document.getElementById('fault').hidden", true);
    snapshot.autopilot = None;
    snapshot.links.clear();
    lookout.show(snapshot);
    browser.reads("autopilot", "none heard");
    browser.until("document.getElementById('fault').hidden", true);
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
fn a_silent_gimbal_and_a_slow_detector_stand_out() {
    let Some(mut browser) = Browser::start() else { return };
    let lookout = Loop::start(start(None));
    let mut silent = warning(0);
    silent.off_map = Some("no GIMBAL_DEVICE_ATTITUDE_STATUS came within 0.3 s".into());
    silent.field_of_view_deg = 0.0;
    for track in &mut silent.tracks {
        (track.azimuth_deg, track.elevation_deg) = (None, None);
    }
    lookout.show(silent);
    browser.screen(390, 844, true, "light");
    browser.open(&lookout.address());
    // It still warns, and shows no direction that is not known.
    browser.reads("level", "Warning");
    let words = "Traffic is not on the map: no GIMBAL_DEVICE_ATTITUDE_STATUS came within 0.3 s.";
    browser.reads("fault", words);
    browser.until("document.querySelectorAll('#map .mark').length", 0);
    assert_eq!(rows(&mut browser, "objects")[0][1], "–, –");
    fits(&mut browser, "phone-gimbal");
    let advice = "the detector is too slow for these frames: 4000x3000 takes 1900 ms";
    let mut slow = quiet(0);
    slow.health.advice = Some(advice.into());
    lookout.show(slow.clone());
    browser.until("document.getElementById('fault').innerText.startsWith('The detector is')", true);
    browser.reads("level", "No alert");
    slow.health.state = StateView::Slow;
    lookout.show(slow);
    browser.reads("level", "Not watching");
    browser.reads("state", "too slow");
    browser.until("document.getElementById('fault').innerText.includes('4000x3000')", true);
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[test]
fn the_page_asks_for_the_token() {
    const TOKEN: &str = "a-token-of-enough-letters";
    let Some(mut browser) = Browser::start() else { return };
    let lookout = Loop::start(start(Some(TOKEN)));
    lookout.show(quiet(0));
    browser.screen(390, 844, true, "dark");
    browser.open(&lookout.address());
    browser.reads("fault", "This page asks for a token.");
    fits(&mut browser, "phone-token");
    assert_eq!(browser.value("document.getElementById('all').hidden"), true);
    let enter = |token: &str| {
        format!(
            "document.getElementById('token').value = '{token}'; document.querySelector('#key button').click()"
        )
    };
    browser.value(&enter("no-token-at-all-but-long"));
    browser.reads("fault", "Wrong token.");
    browser.value(&enter(TOKEN));
    browser.reads("level", "No alert");
    browser.until("document.getElementById('all').hidden", false);
    browser.until("document.getElementById('caption').innerText", "");

    // By the address, and out of it at once.
    browser.value("sessionStorage.clear()");
    browser.open(&format!("{}?token={TOKEN}", lookout.address()));
    browser.reads("level", "No alert");
    assert_eq!(browser.value("location.href"), lookout.address().as_str());
    let refused = |complaint: &String| complaint.contains("401");
    assert!(browser.complaints.iter().all(refused), "{:?}", browser.complaints);
}
