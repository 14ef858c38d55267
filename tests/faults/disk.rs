//! Recordings: killed, on a full disk, in a place that is not there, among the folders of others.

use crate::live::{ACTIVE, Ground, listed};
use crate::service::{Service, lookout, settings};
use crate::steady;
use std::fs;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};

/// Replays a segment as it says itself; the number of its pictures.
fn replayed(segment: &Path) -> usize {
    let text = fs::read_to_string(segment.join("replay.txt")).unwrap();
    let words: Vec<&str> = text.split_whitespace().skip(1).collect();
    let output = lookout(&words).current_dir(segment).output().unwrap();
    let err = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{}: {err}", segment.display());
    listed(&segment.join("frames")).iter().filter(|f| f.extension().unwrap() == "png").count()
}

#[test]
fn killed_at_any_moment() {
    let mut ground = Ground::default();
    let text = format!("record = 'FOLDER/record'\nevent_log = 'FOLDER/log'\n{}", settings(&ground));
    let mut folder = tempfile::tempdir().unwrap();
    for round in 0..4u64 {
        let service = Service::start_in(folder, &text, |_, _| {});
        ground.wait_state(ACTIVE, 0);
        // Moments that fall anywhere between two frames.
        thread::sleep(Duration::from_millis(300 + 137 * round));
        folder = service.kill();
    }
    let segments = listed(&folder.path().join("record"));
    assert_eq!(segments.len(), 4, "{segments:?}");
    let frames: Vec<_> = segments.iter().map(|segment| replayed(segment)).collect();
    assert!(frames.iter().all(|&frames| frames >= 2), "{frames:?}");
    assert_eq!(listed(&folder.path().join("log")).len(), 1, "no empty folder for every start");
}

/// Whether this user may mount a file system of its own.
fn can_mount() -> bool {
    let status = Command::new("unshare").args(["-Urm", "true"]).status();
    let can = status.is_ok_and(|status| status.success());
    if !can {
        println!("skipped: no file systems of its own for this user");
    }
    can
}

/// A service with a disk of 3 MB at FOLDER/disk, mounted `rw` or `ro`, and that disk as seen from outside.
fn on_a_small_disk(ground: &Ground, how: &str) -> (Service, PathBuf) {
    let text = format!("record = 'FOLDER/disk/record'\n{}", settings(ground));
    let service = Service::start(&text, |command, folder| {
        let disk = folder.join("disk");
        fs::create_dir(&disk).unwrap();
        let run: Vec<_> = std::iter::once(command.get_program())
            .chain(command.get_args())
            .map(Into::into)
            .collect();
        let run: Vec<std::ffi::OsString> = run;
        let mut inside = Command::new("unshare");
        let mount = format!("mount -t tmpfs -o size=3m,{how} none \"$0\" && exec \"$@\"");
        inside.args(["-Urm", "sh", "-c", &mount]).arg(&disk).args(run);
        inside.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped());
        *command = inside;
    });
    let disk = service.folder.path().join("disk");
    let disk = PathBuf::from(format!("/proc/{}/root{}", service.child.id(), disk.display()));
    (service, disk)
}

#[test]
fn a_disk_that_is_full_for_seconds() {
    if !can_mount() {
        return;
    }
    let mut ground = Ground::default();
    let (service, disk) = on_a_small_disk(&ground, "rw");
    ground.wait_state(ACTIVE, 0);
    steady(&mut ground, 2);
    let record = disk.join("record");
    let frames = || listed(&record.join("000001/frames")).len();
    // Somebody else takes what is left.
    let other = disk.join("other");
    fs::write(&other, vec![0; 4 << 20]).unwrap_err();
    ground.wait_text("recording stopped");
    let before = frames();
    steady(&mut ground, 3);
    assert_eq!(listed(&record).len(), 1, "{:?}", listed(&record));
    fs::remove_file(&other).unwrap();
    ground.wait_text("recording goes on");
    steady(&mut ground, 2);
    let segments = listed(&record);
    assert_eq!(segments.len(), 2, "{segments:?}");
    assert_eq!(frames(), before, "what was recorded before stays");
    // Outside of the service the disk is gone: it is copied while it runs.
    let copy = service.folder.path().join("copy");
    let copied = Command::new("cp").arg("-r").args([&record, &copy]).status().unwrap();
    assert!(copied.success());
    let log = service.log.lock().unwrap().clone();
    assert_eq!(log.matches("recording stopped").count(), 1, "{log}");
    service.signal("TERM");
    let (status, _, err, folder) = service.ended();
    assert_eq!(status, Some(0), "{err}");
    assert!(replayed(&folder.path().join("copy/000001")) >= 10);
}

#[test]
fn a_read_only_disk() {
    if !can_mount() {
        return;
    }
    let mut ground = Ground::default();
    let (service, disk) = on_a_small_disk(&ground, "ro");
    ground.wait_text("recording stopped");
    ground.wait_state(ACTIVE, 0);
    service.wait_log("Read-only file system");
    steady(&mut ground, 4);
    let id = service.child.id().to_string();
    let mut mount = Command::new("nsenter");
    mount.args(["-t", &id, "-U", "--preserve-credentials", "-m", "mount", "-o", "remount,rw"]);
    assert!(mount.arg(service.folder.path().join("disk")).status().unwrap().success());
    let start = Instant::now();
    ground.wait_text("recording goes on");
    assert!(start.elapsed() < Duration::from_secs(3), "{:?}", start.elapsed());
    steady(&mut ground, 2);
    assert!(!listed(&disk.join("record")).is_empty());
}

#[test]
fn a_small_disk_keeps_the_newest() {
    if !can_mount() {
        return;
    }
    let mut ground = Ground::default();
    let (service, disk) = on_a_small_disk(&ground, "rw");
    ground.wait_state(ACTIVE, 0);
    let record = disk.join("record");
    // New segments, by new sizes of the picture, until the first has given way.
    let file = Service::config(&service.folder);
    let start = Instant::now();
    while !record.join("000001").exists() {
        assert!(start.elapsed() < Duration::from_secs(20));
        thread::sleep(Duration::from_millis(50));
    }
    let mut round = 0;
    while record.join("000001").exists() {
        assert!(start.elapsed() < Duration::from_secs(60));
        round += 1;
        let text = fs::read_to_string(&file).unwrap();
        let width = format!("width = {}\n", 320 + 16 * (round % 2));
        let lines = text.lines().map(|l| if l.starts_with("width") { width.trim() } else { l });
        let lines: Vec<_> = lines.collect();
        fs::write(&file, lines.join("\n")).unwrap();
        service.signal("HUP");
        thread::sleep(Duration::from_millis(1500));
    }
    steady(&mut ground, 2);
    assert!(listed(&record).len() >= 2, "{:?}", listed(&record));
    assert!(!service.log.lock().unwrap().contains("recording stopped"));
}

#[test]
fn outputs_that_cannot_be_opened_are_tried_again() {
    let mut ground = Ground::default();
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let text = format!(
        "record = 'FOLDER/way/record'\nevent_log = 'FOLDER/way/log'\npreview = '{}'\n\
         parameters = '/dev/full'\n{}",
        taken.local_addr().unwrap(),
        settings(&ground)
    );
    let service =
        Service::start(&text, |_, folder| fs::write(folder.join("way"), "a file").unwrap());
    // It is said at once, before the first frame was looked at.
    ground.wait_text("recording stopped");
    ground.wait_state(ACTIVE, 0);
    for words in ["event log: ", "recording: ", "page: ", "/dev/full: not a regular file"] {
        service.wait_log(words);
    }
    fs::remove_file(service.folder.path().join("way")).unwrap();
    drop(taken);
    for words in ["event log: open", "recording: open", "page: open"] {
        service.wait_log(words);
    }
    ground.wait_text("recording goes on");
    // Taken away while it runs, it is made anew.
    let record = service.folder.path().join("way/record");
    let start = Instant::now();
    // A file may be written into it meanwhile.
    while fs::remove_dir_all(&record).is_err() {
        assert!(start.elapsed() < Duration::from_secs(10));
    }
    while !record.exists() {
        assert!(start.elapsed() < Duration::from_secs(10));
        thread::sleep(Duration::from_millis(50));
    }
    steady(&mut ground, 2);
}

#[test]
fn folders_of_others_stay_and_a_second_instance_waits() {
    let mut ground = Ground::default();
    let text = format!("record = 'FOLDER'\nrecord_minutes = 1\n{}", settings(&ground));
    let service = Service::start(&text, |_, folder| {
        for own in ["100", "2025"] {
            fs::create_dir(folder.join(own)).unwrap();
            fs::write(folder.join(own).join("DSC1.JPG"), "a picture").unwrap();
        }
    });
    ground.wait_state(ACTIVE, 0);
    let mut other = Ground::default();
    let folder = service.folder.path().display();
    let text = format!("record = '{folder}'\n{}", settings(&other));
    let second = Service::start(&text, |_, _| {});
    other.wait_state(ACTIVE, 0);
    second.wait_log("used by another lookout");
    steady(&mut ground, 3);
    let picture = |name: &str| service.folder.path().join(name).join("DSC1.JPG");
    assert!(picture("100").exists() && picture("2025").exists());
    let segments = listed(service.folder.path());
    assert_eq!(segments.iter().filter(|s| s.join("replay.txt").exists()).count(), 1);
}
