//! The camera against the kernel's own test driver: `tests/vm/run` boots a machine that has it.
#![cfg(all(feature = "std", target_os = "linux"))]

#[allow(dead_code, reason = "frames alone are drawn")]
#[path = "common/golden.rs"]
mod golden;
#[allow(dead_code, reason = "every test binary uses a part of it")]
#[path = "common/live.rs"]
mod live;

use live::{ACTIVE, CRITICAL, Ground};
use lookout::mavlink::dialect::MavMessage;
use lookout::shell::sources::Frame;
use lookout::shell::sources::v4l2::{
    CameraSettings, DriverInfo, PixelFormat, V4l2Camera, V4l2Error,
};
use lookout::shell::support::clock::now_us;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use std::{fs, io, thread};

/// Long enough for a frame on an emulated processor.
const PATIENT: Duration = Duration::from_secs(5);
/// The driver's device, and the place where drivers are taken from their devices.
const DEVICE: &str = "vivid.0";
const DRIVER: &str = "/sys/bus/platform/drivers/vivid";

/// The only camera there is: one test at a time.
static CAMERA: Mutex<()> = Mutex::new(());

/// The video node of vivid.
struct Vivid {
    path: PathBuf,
    _only: MutexGuard<'static, ()>,
}

impl Vivid {
    fn find() -> Option<Self> {
        let only = CAMERA.lock().unwrap_or_else(PoisonError::into_inner);
        let nodes = fs::read_dir("/sys/class/video4linux").into_iter().flatten().flatten();
        let node = nodes.map(|node| node.path()).find(|node| {
            let name = fs::read_to_string(node.join("name")).unwrap_or_default();
            name.starts_with("vivid") && name.trim_end().ends_with("vid-cap")
        });
        let Some(node) = node else {
            eprintln!("skipped: no camera of the driver vivid; tests/vm/run has one");
            return None;
        };
        Some(Self { path: Path::new("/dev").join(node.file_name()?), _only: only })
    }

    fn try_open(&self, settings: &CameraSettings) -> Result<V4l2Camera, V4l2Error> {
        V4l2Camera::open(&self.path, settings)
    }

    fn open(&self, format: PixelFormat) -> V4l2Camera {
        self.try_open(&settings(Some(format))).unwrap()
    }

    fn refusal(&self, settings: &CameraSettings) -> String {
        let error = self.try_open(settings).unwrap_err();
        assert!(!error.is_gone(), "{error}");
        let text = error.to_string();
        text.strip_prefix(&format!("{}: ", self.path.display())).expect(&text).to_owned()
    }

    /// Opens the camera again and again, as the live loop does.
    fn reopen(&self) -> V4l2Camera {
        let start = Instant::now();
        loop {
            match self.try_open(&settings(Some(PixelFormat::Grey))) {
                Ok(camera) => return camera,
                Err(error) => assert!(error.is_gone() && start.elapsed() < PATIENT, "{error}"),
            }
            thread::sleep(Duration::from_millis(20));
        }
    }
}

/// A camera without the faults and pictures that another test may have left behind.
fn settings(format: Option<PixelFormat>) -> CameraSettings {
    let controls = [
        ("percentage_of_dropped_buffers", 0),
        // Time of the frame's start: its end is not yet when the frame is given out.
        ("timestamp_source", 1),
        ("osd_text_mode", 2),
        ("test_pattern", 0),
    ];
    let controls = controls.map(|(name, value)| (name.to_owned(), value));
    CameraSettings {
        width: 640,
        height: 360,
        rate: Some(25),
        format,
        controls: BTreeMap::from(controls),
    }
}

fn with_control(name: &str, value: i64) -> CameraSettings {
    let mut settings = settings(None);
    settings.controls.insert(name.to_owned(), value);
    settings
}

fn next(camera: &mut V4l2Camera, frame: &mut Frame) -> DriverInfo {
    camera.next(frame, PATIENT).unwrap()
}

/// Frames until that error, which must come soon.
fn until_error(camera: &mut V4l2Camera) -> V4l2Error {
    let mut frame = Frame::default();
    let start = Instant::now();
    while start.elapsed() < PATIENT {
        if let Err(error) = camera.next(&mut frame, PATIENT) {
            return error;
        }
    }
    panic!("frames go on");
}

#[test]
fn every_format_gives_frames_in_order() {
    let Some(vivid) = Vivid::find() else { return };
    for format in [PixelFormat::Grey, PixelFormat::Nv12, PixelFormat::Yuyv, PixelFormat::Uyvy] {
        let mut camera = vivid.open(format);
        assert_eq!(camera.format(), (format, 640, 360));
        assert_eq!(camera.rate(), Some((25, 1)));
        let mut frame = Frame::default();
        let mut last = next(&mut camera, &mut frame);
        let (start_us, place) = (frame.time_us, frame.pixels.as_ptr());
        let mut missing = 0;
        for _ in 0..25 {
            let (before_us, counted) = (frame.time_us, last.sequence);
            last = next(&mut camera, &mut frame);
            let step = last.sequence - counted;
            assert!(step >= 1, "{format}: {counted}, then {}", last.sequence);
            assert_eq!(step - 1, last.missed + last.passed_over, "{format}: {last:?}");
            assert_eq!(last.damaged, 0);
            assert_eq!(last.monotonic_us, Some(frame.time_us));
            assert!(frame.time_us > before_us);
            let age = now_us() - frame.time_us;
            assert!((0..1_000_000).contains(&age), "{format}: {age} us old");
            assert_eq!((frame.width, frame.height, frame.pixels.len()), (640, 360, 640 * 360));
            missing += step - 1;
        }
        assert_eq!(frame.pixels.as_ptr(), place, "memory is used again");
        let seconds = (frame.time_us - start_us) as f64 / 1e6;
        let rate = f64::from(25 + missing) / seconds;
        eprintln!("{format}: {rate:.2} frames a second, {missing} of {} not seen", 25 + missing);
        assert!((24.0..26.0).contains(&rate), "{format}: {rate} frames a second");
    }
}

#[test]
fn black_and_white_fill_the_range_in_every_format() {
    let Some(vivid) = Vivid::find() else { return };
    // Two of vivid's patterns. Its grey has the full range, the luma of its colours has the limited one.
    for (pattern, expected) in [(5, 0), (6, 255)] {
        for format in [PixelFormat::Grey, PixelFormat::Nv12, PixelFormat::Yuyv, PixelFormat::Uyvy] {
            let wanted = with_control("test_pattern", pattern);
            let mut camera =
                vivid.try_open(&CameraSettings { format: Some(format), ..wanted }).unwrap();
            let mut frame = Frame::default();
            next(&mut camera, &mut frame);
            let odd = frame.pixels.iter().find(|pixel| pixel.abs_diff(expected) > 1);
            assert_eq!(odd, None, "{format}: not {expected}");
        }
    }
}

#[test]
fn the_best_format_is_taken_and_the_impossible_refused() {
    let Some(vivid) = Vivid::find() else { return };
    let camera = vivid.try_open(&settings(None)).unwrap();
    assert_eq!(camera.format().0, PixelFormat::Grey);
    let busy = vivid.refusal(&settings(None));
    assert!(busy.starts_with("another program uses the camera"), "{busy}");
    drop(camera);
    let odd_size = CameraSettings { width: 641, ..settings(None) };
    assert_eq!(
        vivid.refusal(&odd_size),
        "the camera has no 641x360 in GREY; the nearest is 640x360"
    );
    let mjpeg = vivid.refusal(&settings(Some(PixelFormat::Mjpeg)));
    assert!(mjpeg.starts_with("the camera has no format MJPEG, only "), "{mjpeg}");
    assert!(mjpeg.contains("GREY"), "{mjpeg}");
    let unknown = vivid.refusal(&with_control("exposure_time_absolute", 1));
    assert!(unknown.starts_with("the camera has no control 'exposure_time_absolute', only "));
    assert!(unknown.contains("brightness, contrast"), "{unknown}");
    let bright = vivid.refusal(&with_control("Brightness", 256));
    assert_eq!(bright, "control 'brightness' cannot be 256: its range is 0 to 255");
    let twice = vivid.refusal(&with_control("Test Pattern", 5));
    assert!(twice.ends_with("it is set twice, by two spellings of its name"), "{twice}");
}

#[test]
fn controls_are_set_by_name_before_and_between_frames() {
    let Some(vivid) = Vivid::find() else { return };
    // A gain is only what the user wants once its automatic is off, which is set first although it comes later here.
    let mut wanted = with_control("gain", 77);
    wanted.controls.insert("gain_automatic".into(), 0);
    wanted.controls.insert("integer_64_bits".into(), 1 << 40);
    let mut camera = vivid.try_open(&wanted).unwrap();
    assert_eq!(camera.control("Gain").unwrap(), 77);
    assert_eq!(camera.control("Integer 64 Bits").unwrap(), 1 << 40);
    let names: Vec<&str> = camera.controls().iter().map(|control| control.name.as_str()).collect();
    for name in ["brightness", "gain", "test_pattern", "disconnect"] {
        assert!(names.contains(&name), "{name} is not in {names:?}");
    }
    let gain = camera.controls().iter().find(|control| control.name == "gain").unwrap();
    assert_eq!((gain.minimum, gain.maximum, gain.step), (0, 255, 1));
    // Darker while it runs: the pattern's white follows.
    let mut frame = Frame::default();
    camera.set_control("test_pattern", 6).unwrap();
    camera.set_control("brightness", 128).unwrap();
    let mut lightest = |camera: &mut V4l2Camera| {
        // The frames on their way are older.
        for _ in 0..6 {
            next(camera, &mut frame);
        }
        *frame.pixels.iter().max().unwrap()
    };
    let before = lightest(&mut camera);
    camera.set_control("BRIGHTNESS", 40).unwrap();
    assert_eq!(camera.control("brightness").unwrap(), 40);
    let after = lightest(&mut camera);
    assert!(after + 40 < before, "{before}, then {after}");
    camera.set_control("brightness", 128).unwrap();
}

#[test]
fn a_pause_is_waited_for_and_gone_on_after() {
    let Some(vivid) = Vivid::find() else { return };
    let mut camera = vivid.open(PixelFormat::Grey);
    let mut frame = Frame::default();
    next(&mut camera, &mut frame);
    camera.set_control("percentage_of_dropped_buffers", 100).unwrap();
    let short = Duration::from_millis(300);
    let mut missed = 0;
    let error = loop {
        match camera.next(&mut frame, short) {
            Ok(taken) => missed += taken.missed,
            Err(error) => break error,
        }
    };
    assert!(matches!(error, V4l2Error::Timeout) && !error.is_gone(), "{error}");
    let start = Instant::now();
    assert!(matches!(camera.next(&mut frame, short), Err(V4l2Error::Timeout)));
    assert!(start.elapsed() >= short && start.elapsed() < 3 * short, "{:?}", start.elapsed());
    camera.set_control("percentage_of_dropped_buffers", 0).unwrap();
    missed += next(&mut camera, &mut frame).missed;
    // 0.6 s of 25 frames a second.
    assert!((10..40).contains(&missed), "{missed} missed");
    next(&mut camera, &mut frame);
}

#[test]
fn frames_that_are_lost_or_damaged_are_counted() {
    let Some(vivid) = Vivid::find() else { return };
    let mut camera = vivid.open(PixelFormat::Yuyv);
    let mut frame = Frame::default();
    camera.set_control("percentage_of_dropped_buffers", 50).unwrap();
    let taken: Vec<DriverInfo> = (0..20).map(|_| next(&mut camera, &mut frame)).collect();
    let missed: u32 = taken.iter().map(|taken| taken.missed).sum();
    assert!(missed >= 5, "{missed} missed");
    camera.set_control("percentage_of_dropped_buffers", 0).unwrap();
    camera.set_control("inject_v4l2_buf_flag_error", 0).unwrap();
    let damaged: u32 = (0..8).map(|_| next(&mut camera, &mut frame).damaged).sum();
    assert_eq!(damaged, 1);
}

#[test]
fn the_newest_frame_wins() {
    let Some(vivid) = Vivid::find() else { return };
    let mut camera = vivid.open(PixelFormat::Grey);
    let mut frame = Frame::default();
    next(&mut camera, &mut frame);
    // All buffers fill meanwhile, and then nothing can be taken until they are given back.
    thread::sleep(Duration::from_millis(600));
    let taken = next(&mut camera, &mut frame);
    assert!(taken.passed_over >= 2, "{taken:?}");
    let taken = next(&mut camera, &mut frame);
    assert!(taken.missed >= 5, "{taken:?}");
    assert!(now_us() - frame.time_us < 200_000, "{} us old", now_us() - frame.time_us);
}

#[test]
fn a_camera_that_breaks_down_is_gone_and_works_when_opened_again() {
    let Some(vivid) = Vivid::find() else { return };
    for fault in ["disconnect", "inject_fatal_streaming_error"] {
        let mut camera = vivid.open(PixelFormat::Grey);
        next(&mut camera, &mut Frame::default());
        camera.set_control(fault, 1).unwrap();
        let error = until_error(&mut camera);
        assert!(matches!(error, V4l2Error::Gone { .. }) && error.is_gone(), "{fault}: {error}");
        let text = error.to_string();
        assert!(text.starts_with(&format!("{}: the camera is gone: ", vivid.path.display())));
        drop(camera);
        let mut camera = vivid.reopen();
        next(&mut camera, &mut Frame::default());
    }
}

fn bind(what: &str) -> io::Result<()> {
    fs::write(Path::new(DRIVER).join(what), DEVICE)
}

#[test]
fn a_camera_that_is_unplugged_comes_back() {
    let Some(vivid) = Vivid::find() else { return };
    let mut camera = vivid.open(PixelFormat::Grey);
    next(&mut camera, &mut Frame::default());
    // No frames, so that it is unplugged while one is waited for.
    camera.set_control("percentage_of_dropped_buffers", 100).unwrap();
    let unplugged = thread::spawn(move || {
        thread::sleep(Duration::from_millis(300));
        (Instant::now(), bind("unbind"))
    });
    let error = until_error(&mut camera);
    let noticed = Instant::now();
    let (unplugged, result) = unplugged.join().unwrap();
    if let Err(error) = result {
        eprintln!("skipped: the camera cannot be unplugged here: {error}");
        return;
    }
    assert!(error.is_gone(), "{error}");
    let delay = noticed.saturating_duration_since(unplugged);
    eprintln!("noticed {delay:?} after the driver was unbound");
    assert!(delay < Duration::from_secs(1), "{delay:?}");
    drop(camera);
    assert!(!vivid.path.exists());
    let error = vivid.try_open(&settings(None)).unwrap_err();
    assert!(matches!(error, V4l2Error::Open { .. }) && error.is_gone(), "{error}");
    bind("bind").unwrap();
    let mut camera = vivid.reopen();
    next(&mut camera, &mut Frame::default());
}

/// The program on this camera, its settings in `folder`.
fn program(vivid: &Vivid, ground: &Ground, folder: &Path) -> Child {
    let config = folder.join("lookout.toml");
    // A moving picture: one that stands still is a frozen camera.
    let text = format!(
        "source = 'v4l2:{}'\nlinks = ['{}']\nthreads = 1\n[camera]\nwidth = 320\nheight = 180\nrate = 5\n\
         format = 'YUYV'\n[camera.controls]\ntimestamp_source = 1\nhorizontal_movement = 5\ntest_pattern = 0\n\
         percentage_of_dropped_buffers = 0\n",
        vivid.path.display(),
        ground.link(),
    );
    fs::write(&config, text).unwrap();
    let mut program = Command::new(env!("CARGO_BIN_EXE_lookout"));
    program.arg("run").arg("--config").arg(&config).stdout(Stdio::piped()).spawn().unwrap()
}

#[test]
fn a_second_instance_waits_for_the_camera() {
    let Some(vivid) = Vivid::find() else { return };
    let mut ground = Ground::default();
    let folder = tempfile::tempdir().unwrap();
    let first = vivid.reopen();
    let mut second = program(&vivid, &ground, folder.path());
    ground.wait("boot", |m| matches!(m, MavMessage::HEARTBEAT(h) if h.system_status as u8 == 1));
    // Long enough for the longest pause between two attempts.
    let (count, _) = ground.beats(Duration::from_secs(6));
    assert!(count >= 3, "{count} heartbeats");
    drop(first);
    let free = Instant::now();
    ground.wait_state(ACTIVE, 0);
    eprintln!("camera free, watching {} ms later", free.elapsed().as_millis());
    second.kill().unwrap();
    second.wait().unwrap();
}

#[test]
fn the_program_watches_and_gets_over_an_unplugged_camera() {
    let Some(vivid) = Vivid::find() else { return };
    let mut ground = Ground::default();
    let folder = tempfile::tempdir().unwrap();
    let program = program(&vivid, &ground, folder.path());
    ground.wait_state(ACTIVE, 0);
    if let Err(error) = bind("unbind") {
        eprintln!("the camera cannot be unplugged here: {error}");
    } else {
        ground.wait_state(CRITICAL, 0);
        bind("bind").unwrap();
        ground.wait_state(ACTIVE, 0);
    }
    // Some seconds of pictures that can be looked at.
    for _ in 0..3 {
        ground.wait_state(ACTIVE, 0);
    }
    let id = program.id().to_string();
    assert!(Command::new("kill").args(["-TERM", &id]).status().unwrap().success());
    let output = program.wait_with_output().unwrap();
    let printed = String::from_utf8(output.stdout).unwrap();
    eprintln!("{printed}");
    assert_eq!(output.status.code(), Some(0));
    let frames: u32 = printed.split_once(" frames looked at").unwrap().0.parse().unwrap();
    assert!(frames >= 5, "{printed}");
}
