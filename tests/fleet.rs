//! Evaluation in shards: manifest, `eval --manifest --shard --out`, `merge`.
#![cfg(feature = "std")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

fn command(folder: &TempDir, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lookout"));
    command.args(args).current_dir(folder.path()).env_remove("LOOKOUT_LOG");
    command
}

fn run(folder: &TempDir, args: &[&str]) -> Output {
    command(folder, args).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Standard output of a run that succeeds.
fn printed(folder: &TempDir, args: &[&str]) -> String {
    let output = run(folder, args);
    assert!(output.status.success(), "{args:?}: {}", text(&output.stderr));
    text(&output.stdout)
}

/// What a run that ends with this status says.
fn complaint(folder: &TempDir, args: &[&str], status: i32) -> String {
    let output = run(folder, args);
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(status), "{args:?}: {said}");
    said
}

fn simulate(folder: &TempDir, clip: &str, kind: &str, seed: usize) {
    let size = ["--width", "160", "--height", "120", "--fps", "10", "--seconds", "1.6"];
    let which = ["simulate", "--out", clip, "--kind", kind, "--seed", &seed.to_string()];
    printed(folder, &[&which[..], &size].concat());
}

/// Two splits with four clips and two, one of them without a target, and a table beside one.
fn clips() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (seed, kind) in ["crossing", "hover", "collision", "none"].iter().enumerate() {
        simulate(&folder, &format!("one/{kind}"), kind, seed);
    }
    for seed in [7, 8] {
        simulate(&folder, &format!("two/{seed}"), "receding", seed);
    }
    fs::write(
        folder.path().join("two.csv"),
        "clip,kind,agitation,movers\n7,away,0.3,\n8,away,,2\n",
    )
    .unwrap();
    folder
}

/// Results in the folder of a run.
fn results(folder: &TempDir, run: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder.path().join(run).join("clips"));
    let paths = entries.into_iter().flatten().map(|entry| entry.unwrap().path());
    let mut paths: Vec<PathBuf> =
        paths.filter(|path| path.extension().unwrap() == "jsonl").collect();
    paths.sort();
    paths
}

fn modified(paths: &[PathBuf]) -> Vec<std::time::SystemTime> {
    paths.iter().map(|path| fs::metadata(path).unwrap().modified().unwrap()).collect()
}

#[test]
fn shards_of_which_one_was_killed_give_the_report_of_one_machine() {
    let folder = clips();
    let said = printed(&folder, &["manifest", "one", "two", "--out", "m.csv"]);
    assert_eq!(said, "m.csv: 6 clips\n");
    let manifest = fs::read_to_string(folder.path().join("m.csv")).unwrap();
    assert!(manifest.starts_with("clip,split,path,labels,telemetry,tags\n"), "{manifest}");
    assert!(manifest.contains(",two,two/7,two/7/gt.txt,two/7/"), "{manifest}");
    assert!(manifest.contains("kind=away;agitation=0.3"), "{manifest}");

    let shard = |index| {
        ["eval", "--manifest=m.csv", index, "--out=run", "--tracks", "--jobs=1"].map(str::to_owned)
    };
    let first = shard("--shard=0/2");
    let first: Vec<&str> = first.iter().map(String::as_str).collect();
    let mut child = command(&folder, &first).stderr(Stdio::null()).spawn().unwrap();
    let started = Instant::now();
    while results(&folder, "run").is_empty() {
        assert!(started.elapsed() < Duration::from_secs(240));
        std::thread::sleep(Duration::from_millis(2));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let before = results(&folder, "run");
    assert!(before.len() < 3, "it was killed before its end");
    let times = modified(&before);

    // The other shard is one of Slurm's; then nothing is complete yet.
    let output = command(&folder, &["eval", "--manifest=m.csv", "--out=run", "--tracks"])
        .envs([("SLURM_ARRAY_TASK_ID", "4"), ("SLURM_ARRAY_TASK_COUNT", "2")])
        .envs([("SLURM_ARRAY_TASK_MIN", "3"), ("SLURM_ARRAY_TASK_MAX", "4")])
        .output()
        .unwrap();
    let said = text(&output.stderr);
    assert!(output.status.success() && said.contains("shard 1/2: 3 clips measured"), "{said}");
    assert!(output.stdout.is_empty(), "no figures of a part");
    let missing = 3 - before.len();
    let said = complaint(&folder, &["merge", "run"], 1);
    assert!(said.contains(&format!("{missing} of 6 clips have no result yet (")), "{said}");

    // Again: what is there is not done twice.
    let output = run(&folder, &first);
    let said = text(&output.stderr);
    let expected = format!("shard 0/2: {missing} clips measured, {} were before", before.len());
    assert!(output.status.success() && said.contains(&expected), "{said}");
    assert_eq!(modified(&before), times);
    assert_eq!(results(&folder, "run").len(), 6);

    let one = ["eval", "one", "two", "--tracks"];
    let whole = printed(&folder, &one);
    assert!(whole.contains("All 2 splits together: 6 clips"), "{whole}");
    assert_eq!(printed(&folder, &["merge", "run"]), whole);
    let json = printed(&folder, &[&one[..], &["--json"]].concat());
    assert!(json.contains("\"low\":") && json.contains("\"without_target\":"), "{json}");
    assert_eq!(printed(&folder, &["merge", "run", "--json"]), json);

    // Other arguments begin anew, beside the results of these.
    let others = ["eval", "--manifest=m.csv", "--out=run", "--threshold=0", "--clips=two/7,two/8"];
    let said = text(&run(&folder, &others).stderr);
    assert!(said.contains("2 clips measured, 0 were before"), "{said}");
    assert_eq!(results(&folder, "run").len(), 8);
    let said = complaint(&folder, &["merge", "run"], 1);
    assert!(said.contains("4 of 6 clips have no result yet"), "{said}");
}

#[test]
fn what_can_never_be_measured_is_said_by_the_status() {
    let folder = tempfile::tempdir().unwrap();
    simulate(&folder, "data/good", "crossing", 1);
    simulate(&folder, "data/torn", "crossing", 2);
    printed(&folder, &["manifest", "data", "--out=m.csv"]);
    let frame = |number: usize| {
        let frames = folder.path().join("data/torn/frames");
        let mut paths: Vec<PathBuf> =
            fs::read_dir(frames).unwrap().map(|entry| entry.unwrap().path()).collect();
        paths.sort();
        paths.swap_remove(number)
    };
    let bytes = fs::read(frame(5)).unwrap();
    fs::write(frame(5), &bytes[..20]).unwrap();
    let eval = ["eval", "--manifest=m.csv", "--out=run"];
    for measured in [1, 0] {
        let said = complaint(&folder, &eval, 42);
        assert!(said.contains(&format!("{measured} clips measured")), "{said}");
        assert!(said.contains("lookout: torn: ") && said.contains("frame 6"), "{said}");
        assert!(said.contains("1 of 2 clips of this shard cannot be measured"), "{said}");
    }
    // As on one machine: it is listed, and the figures are of the others.
    let whole = run(&folder, &["eval", "data", "--json"]);
    let merged = run(&folder, &["merge", "run", "--json"]);
    assert_eq!((whole.status.code(), merged.status.code()), (Some(1), Some(1)));
    assert_eq!(text(&merged.stdout), text(&whole.stdout));
    assert_eq!(text(&merged.stderr), text(&whole.stderr));
    // Mended, it is another clip; the old result is not taken for it.
    fs::write(frame(5), &bytes).unwrap();
    assert!(run(&folder, &eval).status.success());
    let said = complaint(&folder, &["merge", "run"], 1);
    assert!(said.contains("torn: two results") && said.contains("remove that"), "{said}");

    // A clip that is not there now may be there at another time.
    fs::rename(folder.path().join("data/good"), folder.path().join("away")).unwrap();
    let said = complaint(&folder, &eval, 1);
    assert!(said.contains("1 of 2 clips of this shard could not be read"), "{said}");
}

#[test]
fn a_manifest_that_makes_no_sense_is_not_tried_again() {
    let folder = tempfile::tempdir().unwrap();
    let head = "clip,split,path,labels,telemetry,tags\n";
    for (rows, words) in [
        ("", "no clip in it"),
        ("a,one,x,,,\na,one,y,,,\n", "line 3: a second clip of the name a"),
        ("a,one,,,,\n", "line 2: clip or path is empty"),
        ("a,one,x,,,movers=many\n", "tag movers is 'many', expected a number"),
    ] {
        fs::write(folder.path().join("m.csv"), [head, rows].concat()).unwrap();
        let said = complaint(&folder, &["eval", "--manifest=m.csv", "--out=run"], 42);
        assert!(said.contains("m.csv line") && said.contains(words), "{said}");
    }
    fs::write(folder.path().join("m.csv"), [head, "a,one,x,,,\n"].concat()).unwrap();
    let said = complaint(&folder, &["eval", "--manifest=m.csv"], 1);
    assert!(said.contains("--out DIR"), "{said}");
    let output = command(&folder, &["eval", "--manifest=m.csv", "--out=run"])
        .env("JOB_COMPLETION_INDEX", "3")
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(42));
    assert!(text(&output.stderr).contains("JOB_COMPLETIONS"), "{}", text(&output.stderr));
    let said = complaint(&folder, &["merge", "nowhere"], 1);
    assert!(said.contains("run.json"), "{said}");
}

#[test]
fn clips_may_be_fetched() {
    let folder = tempfile::tempdir().unwrap();
    if Command::new("curl").arg("--version").output().is_err() {
        println!("skipped: there is no curl");
        return;
    }
    simulate(&folder, "data/a", "crossing", 1);
    let frames: Vec<PathBuf> = {
        let entries = fs::read_dir(folder.path().join("data/a/frames")).unwrap();
        let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
        paths.sort();
        paths
    };
    let mut stream = b"YUV4MPEG2 W160 H120 F10:1 Cmono\n".to_vec();
    for path in &frames {
        stream.extend(b"FRAME\n");
        stream.extend(image::open(path).unwrap().into_luma8().into_raw());
    }
    let mine = |name: &str| folder.path().join(name);
    fs::create_dir(mine("there")).unwrap();
    fs::write(mine("there/a.y4m"), stream).unwrap();
    fs::copy(mine("data/a/gt.txt"), mine("there/a.txt")).unwrap();
    let url = |path: &Path| format!("file://{}", path.display());
    let (video, labels) = (url(&mine("there/a.y4m")), url(&mine("there/a.txt")));
    let text = format!("clip,split,path,labels,telemetry,tags\na,there,{video},{labels},,\n");
    fs::write(mine("m.csv"), text).unwrap();
    printed(&folder, &["eval", "--manifest=m.csv", "--out=run"]);
    let merged = printed(&folder, &["merge", "run"]);
    assert_eq!(merged, printed(&folder, &["eval", "there"]));
    fs::remove_file(mine("there/a.y4m")).unwrap();
    let said = complaint(&folder, &["eval", "--manifest=m.csv", "--out=run"], 1);
    assert!(said.contains("a.y4m: cannot be fetched"), "{said}");
}

#[test]
fn flights_are_replayed_in_shards() {
    let folder = tempfile::tempdir().unwrap();
    for seed in [1, 2, 3] {
        simulate(&folder, &format!("data/{seed}"), "crossing", seed);
    }
    printed(&folder, &["manifest", "data", "--out=m.csv"]);
    let replay = ["replay", "--manifest=m.csv", "--out=run", "--min-precision=0.5"];
    let files = || {
        let entries = fs::read_dir(folder.path().join("run")).into_iter().flatten();
        let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
        paths.sort();
        paths
    };
    for (shard, measured) in [("--shard=0/2", 2), ("--shard=1/2", 1), ("--shard=0/1", 0)] {
        let output = run(&folder, &[&replay[..], &[shard]].concat());
        let said = text(&output.stderr);
        let expected =
            format!("{measured} clips measured, {} were before", 3 * (1 - measured.min(1)));
        assert!(output.status.success() && said.contains(&expected), "{said}");
    }
    assert_eq!(files().len(), 3);
    // Each is what the flight alone gives, with the log that lies beside it.
    let alone = ["replay", "data/2", "--tlog-in=data/2/flight.tlog", "--min-precision=0.5"];
    printed(&folder, &[&alone[..], &["--jsonl=2.jsonl"]].concat());
    let own = files()
        .into_iter()
        .find(|path| path.file_name().unwrap().to_string_lossy().starts_with("2-"));
    let lines = fs::read(own.unwrap()).unwrap();
    assert!(lines.iter().filter(|byte| **byte == b'\n').count() == 16);
    assert_eq!(lines, fs::read(folder.path().join("2.jsonl")).unwrap());
    // Other arguments are other files.
    let said = text(&run(&folder, &[&replay[..3], &["--threshold=3"]].concat()).stderr);
    assert!(said.contains("3 clips measured"), "{said}");
    assert_eq!(files().len(), 6);

    // A picture that is torn is said once and not tried again.
    let frames = folder.path().join("data/3/frames");
    let frame = fs::read_dir(frames).unwrap().map(|entry| entry.unwrap().path()).max().unwrap();
    let bytes = fs::read(&frame).unwrap();
    fs::write(&frame, &bytes[..20]).unwrap();
    for _ in 0..2 {
        let said = complaint(&folder, &replay, 42);
        assert!(said.contains("lookout: 3: ") && said.contains("1 of 3 clips"), "{said}");
    }
    assert!(files().iter().all(|path| path.extension().unwrap() != "new"), "{:?}", files());
    let said = complaint(&folder, &["replay", "--manifest=m.csv"], 2);
    assert!(said.contains("--out"), "{said}");
}

#[cfg(feature = "parquet")]
#[test]
fn parquet_gives_the_same_report() {
    let folder = clips();
    printed(&folder, &["manifest", "one", "two", "--out=m.csv"]);
    printed(&folder, &["manifest", "one", "two", "--out=m.parquet"]);
    let eval = |manifest: &str, out: &str, more: &[&str]| {
        let args = ["eval", "--manifest", manifest, "--out", out, "--tracks"];
        printed(&folder, &[&args[..], more].concat());
    };
    eval("m.csv", "lines", &[]);
    eval("m.parquet", "tables", &["--parquet", "--shard=0/2"]);
    eval("m.parquet", "tables", &["--parquet", "--shard=1/2"]);
    let files = fs::read_dir(folder.path().join("tables/clips")).unwrap();
    assert!(
        files.map(|file| file.unwrap().path()).all(|path| path.extension().unwrap() == "parquet")
    );
    for form in [&["--json"][..], &[]] {
        let merged = |run: &str| printed(&folder, &[&["merge", run][..], form].concat());
        assert_eq!(merged("tables"), merged("lines"));
    }
    let manifest = |run: &str| fs::read(folder.path().join(run).join("manifest.csv")).unwrap();
    assert_eq!(manifest("tables"), manifest("lines"));
}

#[cfg(not(feature = "parquet"))]
#[test]
fn without_parquet_its_files_are_named() {
    let folder = tempfile::tempdir().unwrap();
    simulate(&folder, "data/a", "crossing", 1);
    let said = complaint(&folder, &["manifest", "data", "--out=m.parquet"], 42);
    assert!(
        said.contains("m.parquet: this program has no Parquet") && said.contains(".csv"),
        "{said}"
    );
}
