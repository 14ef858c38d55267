//! Inputs as people have them: names that are no text, folders with rates, streams that begin in the middle.
#![cfg(all(feature = "std", unix))]

use std::ffi::OsStr;
use std::fs;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use std::process::{Command, Output};

fn lookout(args: &[&OsStr]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lookout"));
    command.args(args).env_remove("LOOKOUT_LOG").output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// `false` where there is no ffmpeg, which is said.
fn ffmpeg(args: &[&str], to: &Path) -> bool {
    let made = Command::new("ffmpeg").args(["-v", "error", "-y"]).args(args).arg(to).status();
    let made = made.is_ok_and(|status| status.success());
    if !made {
        eprintln!("skipped: ffmpeg is not installed, or cannot make {}", to.display());
    }
    made
}

const PICTURE: &str = "testsrc=size=160x120:rate=25:duration=0.6";

#[test]
fn names_that_are_no_text() {
    let folder = tempfile::tempdir().unwrap();
    let clip = folder.path().join(OsStr::from_bytes(b"set/caf\xe9"));
    fs::create_dir_all(&clip).unwrap();
    let video = clip.join("video.mp4");
    if !ffmpeg(&["-f", "lavfi", "-i", PICTURE], &video) {
        return;
    }
    fs::write(clip.join("gt.txt"), "1,1,10,10,20,20,1,1,1\n").unwrap();
    let single = folder.path().join(OsStr::from_bytes(b"caf\xe9.mp4"));
    fs::copy(&video, &single).unwrap();
    let output = lookout(&["replay".as_ref(), single.as_os_str()]);
    assert!(
        output.status.success() && text(&output.stderr).contains("15 frames"),
        "{}",
        text(&output.stderr)
    );
    let output = lookout(&[
        "bench".as_ref(),
        "--input".as_ref(),
        single.as_os_str(),
        "--passes".as_ref(),
        "1".as_ref(),
    ]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let output = lookout(&["eval".as_ref(), folder.path().join("set").as_os_str()]);
    assert!(output.status.success(), "{}", text(&output.stderr));
}

/// Times of the lines of JSON that a replay writes.
fn times(input: &Path, more: &[&str]) -> Vec<i64> {
    let folder = tempfile::tempdir().unwrap();
    let lines = folder.path().join("lines.jsonl");
    let mut args =
        vec!["replay".as_ref(), input.as_os_str(), "--jsonl".as_ref(), lines.as_os_str()];
    args.extend(more.iter().map(OsStr::new));
    let output = lookout(&args);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let lines = fs::read_to_string(lines).unwrap();
    let time = |line| {
        serde_json::from_str::<serde_json::Value>(line).unwrap()["time_us"].as_i64().unwrap()
    };
    lines.lines().map(time).collect()
}

#[test]
fn a_browser_s_recording_keeps_its_frames_and_times() {
    let folder = tempfile::tempdir().unwrap();
    let video = folder.path().join("browser.webm");
    // Frames 50 ms and 30 ms apart in turn.
    let vary = "setpts='(N*40+10*mod(N,2))/1000/TB'";
    let source = "testsrc=size=160x120:rate=1000:duration=0.04";
    if !ffmpeg(
        &["-f", "lavfi", "-i", source, "-vf", vary, "-vsync", "passthrough", "-c:v", "libvpx"],
        &video,
    ) {
        return;
    }
    let found = times(&video, &[]);
    assert_eq!(found.len(), 40);
    for (n, time_us) in (0i64..).zip(found) {
        let wanted = (n * 40 + 10 * (n % 2)) * 1000;
        // The file counts milliseconds.
        assert!((time_us - wanted).abs() <= 1000, "frame {n}: {time_us}, not {wanted}");
    }
}

#[test]
fn a_folder_has_the_rate_of_its_camera_or_of_the_command_line() {
    let folder = tempfile::tempdir().unwrap();
    for number in 1..=3u8 {
        let path = folder.path().join(format!("{number}.png"));
        image::GrayImage::from_fn(160, 120, |x, y| image::Luma([(x * y) as u8 ^ number]))
            .save(path)
            .unwrap();
    }
    assert_eq!(times(folder.path(), &[]), [0, 33_333, 66_666]);
    assert_eq!(times(folder.path(), &["--fps", "20"]), [0, 50_000, 100_000]);
    fs::write(
        folder.path().join("camera.json"),
        r#"{"width":160,"height":120,"fx":90,"fy":90,"cx":80,"cy":60,"fps":10}"#,
    )
    .unwrap();
    assert_eq!(times(folder.path(), &[]), [0, 100_000, 200_000]);
    assert_eq!(times(folder.path(), &["--fps", "20"]), [0, 50_000, 100_000]);
}

#[test]
fn a_stream_that_begins_between_key_frames_ends_with_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let (whole, joined) = (folder.path().join("whole.h264"), folder.path().join("joined.h264"));
    let source = "testsrc=size=160x120:rate=25:duration=2";
    let codec = ["-c:v", "libx264", "-g", "20", "-bf", "0", "-f", "h264"];
    if !ffmpeg(&[&["-f", "lavfi", "-i", source], &codec[..]].concat(), &whole) {
        return;
    }
    let bytes = fs::read(&whole).unwrap();
    let is_slice = |w: &[u8]| w[..3] == [0, 0, 1] && w[3] & 0x1f == 1;
    let cut = bytes.windows(4).enumerate().filter(|(_, w)| is_slice(w)).nth(9).unwrap().0;
    fs::write(&joined, &bytes[cut..]).unwrap();
    let output = lookout(&["replay".as_ref(), joined.as_os_str()]);
    let said = text(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(said.contains("WARN") && said.contains("begins between key frames"), "{said}");
    // Key frames are 0, 20 and 40 of 50: the rest after the first is there.
    assert!(said.contains("30 frames"), "{said}");
}

#[test]
fn ten_bits_and_interlaced_rows_are_read() {
    let folder = tempfile::tempdir().unwrap();
    for format in ["yuv420p10le", "gray16le", "yuv411p", "yuv422p12le", "gray10le"] {
        let path = folder.path().join(format!("{format}.y4m"));
        let more = ["-pix_fmt", format, "-strict", "-1", "-f", "yuv4mpegpipe"];
        if !ffmpeg(&[&["-f", "lavfi", "-i", PICTURE], &more[..]].concat(), &path) {
            return;
        }
        // The same picture as ffmpeg itself converts it, to a grey level.
        let grey = folder.path().join("grey.raw");
        assert!(ffmpeg(
            &["-i", path.to_str().unwrap(), "-pix_fmt", "gray", "-f", "rawvideo"],
            &grey
        ));
        let wanted = fs::read(&grey).unwrap();
        use ::lookout::shell::sources::FrameSource as _;
        let mut source = ::lookout::shell::sources::open(&path).unwrap();
        let mut frame = ::lookout::shell::sources::Frame::default();
        let mut count = 0;
        while source.next_frame(&mut frame).unwrap() {
            let wanted = &wanted[count * 160 * 120..][..160 * 120];
            let worst = frame.pixels.iter().zip(wanted).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
            assert!(worst <= 1, "{format}: {worst}");
            count += 1;
        }
        assert_eq!(count, 15);
    }
}
