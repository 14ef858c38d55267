//! `lookout merge` holds one clip at a time: its memory does not grow with the clips.
#![cfg(target_os = "linux")]

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

fn lookout(folder: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lookout"));
    command.args(args).current_dir(folder).env_remove("LOOKOUT_LOG");
    command
}

fn run(folder: &Path, args: &[&str]) {
    let output = lookout(folder, args).output().unwrap();
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
}

/// A run of `count` clips whose results are copies of that of `run`.
fn copies(folder: &Path, count: usize) -> String {
    let name = format!("run-{count}");
    let (from, to) = (folder.join("run"), folder.join(&name));
    fs::create_dir_all(to.join("clips")).unwrap();
    for entry in fs::read_dir(&from).unwrap().map(|entry| entry.unwrap().path()) {
        if entry.is_file() {
            fs::copy(&entry, to.join(entry.file_name().unwrap())).unwrap();
        }
    }
    let result = fs::read_dir(from.join("clips")).unwrap().next().unwrap().unwrap().path();
    let suffix =
        result.file_name().unwrap().to_str().unwrap().split_once('-').unwrap().1.to_owned();
    let text = fs::read_to_string(&result).unwrap();
    let mut manifest = String::from("clip,split,path,labels,telemetry,tags\n");
    for number in 0..count {
        let clip = text.replacen("\"clip\":\"a\"", &format!("\"clip\":\"c{number}\""), 1);
        fs::write(to.join(format!("clips/{number:016x}-{suffix}")), clip).unwrap();
        writeln!(manifest, "c{number},data,data/c{number},,,").unwrap();
    }
    fs::write(to.join("manifest.csv"), manifest).unwrap();
    name
}

/// Largest memory of a merge, kB.
fn peak(folder: &Path, run: &str) -> u64 {
    let mut child = lookout(folder, &["merge", run]).stdout(Stdio::null()).spawn().unwrap();
    let status = format!("/proc/{}/status", child.id());
    let mut peak = 0;
    loop {
        let text = fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let now = line.and_then(|line| line.split_whitespace().next()?.parse().ok());
        peak = peak.max(now.unwrap_or(0));
        if let Some(status) = child.try_wait().unwrap() {
            assert!(status.success());
            return peak;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn merging_many_clips_takes_the_memory_of_few() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let size = ["--width", "160", "--height", "120", "--fps", "10", "--seconds", "4"];
    run(folder, &[&["simulate", "--out", "data/a", "--kind", "crossing"][..], &size].concat());
    run(folder, &["manifest", "data", "--out=m.csv"]);
    run(folder, &["eval", "--manifest=m.csv", "--out=run", "--tracks", "--threshold=-8"]);
    let [few, many] = [50, 2000].map(|count| peak(folder, &copies(folder, count)));
    println!("peak of a merge of 50 clips: {few} kB, of 2000 clips: {many} kB");
    // With all results in memory it was more than 30 kB a clip.
    assert!(many < few + 1950 * 4, "{few} kB for 50 clips, {many} kB for 2000");
}
