//! The result of one clip as a file: a line of JSON about the clip, then a line for each detection
//! (`[frame,left,top,width,height,score]`) and each frame's time in the detector (`{"ms":1.5}`). With the feature `parquet`
//! it may be a Parquet file of the same contents (`table`).
//!
//! Numbers read back as they were written, to the last bit, so that figures of files are those of a run.

use super::FleetError;
use super::form::{ResultForm, is_parquet};
use super::parts::{Head, OutcomeParts};
use super::table;
use crate::shell::error::Error;
use crate::shell::evaluate::clip_run::ClipResult;
use crate::shell::evaluate::facts::Facts;
use crate::shell::evaluate::matching::DetectionRecord;
use crate::shell::formats::clips::{Clip, GroundTruth};
use crate::shell::formats::seqinfo::SeqInfo;
use crate::shell::support::file_error::FileError;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::string::String;
use std::vec::Vec;
use std::{format, vec};

/// Result or failure of one clip, as its file in `clips/` keeps it.
#[derive(Debug)]
pub struct ClipOutcome {
    /// The clip; its files are not looked for again.
    pub clip: Clip,
    /// Facts of the clip from its table or manifest.
    pub facts: Facts,
    /// The measurements, or why there are none and never will be.
    pub result: Result<ClipResult, String>,
}

impl ClipOutcome {
    /// A clip of which nothing is known but that it can never be measured.
    pub fn broken(clip: &str, reason: &str) -> Self {
        let clip = Clip {
            name: clip.into(),
            directory: PathBuf::new(),
            input: PathBuf::new(),
            ground_truth: GroundTruth::default(),
            info: SeqInfo::default(),
        };
        Self { clip, facts: Facts::default(), result: Err(reason.into()) }
    }
}

/// The clip's name alone.
#[derive(Debug, Deserialize)]
struct Name {
    clip: String,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(untagged)]
enum OutcomeLine {
    Found(u64, f64, f64, f64, f64, f64),
    Time { ms: f64 },
}

/// Takes an outcome apart.
fn parts(outcome: ClipOutcome) -> OutcomeParts {
    let ClipOutcome { clip, facts, result } = outcome;
    let (result, broken) = match result {
        Ok(result) => (result, None),
        Err(reason) => (ClipResult::default(), Some(reason)),
    };
    let head = Head {
        clip: clip.name,
        broken,
        facts,
        ground_truth: clip.ground_truth,
        frames: result.frames,
        size: result.size,
        rate: result.rate,
        scan: result.scan,
        registration: result.registration,
        textures: result.textures,
        tracks: result.tracks,
    };
    (head, result.found, result.times_ms)
}

/// The bytes of a file.
///
/// # Errors
/// [`FleetError::NoParquet`] where the program cannot write the form.
pub fn encode(outcome: ClipOutcome, form: ResultForm) -> Result<Vec<u8>, Error> {
    match form {
        ResultForm::Lines => Ok(lines(parts(outcome))),
        ResultForm::Parquet => table::encode_outcome(&parts(outcome)),
    }
}

#[allow(clippy::expect_used, reason = "numbers and names always make JSON")]
fn lines((head, found, times_ms): OutcomeParts) -> Vec<u8> {
    let found = found.iter().map(|found| {
        let [left, top, width, height] = found.rect;
        OutcomeLine::Found(found.frame, left, top, width, height, found.score)
    });
    let times = times_ms.iter().map(|&ms| OutcomeLine::Time { ms });
    let json = "numbers and names always make JSON";
    let mut bytes = serde_json::to_vec(&head).expect(json);
    for line in found.chain(times) {
        bytes.push(b'\n');
        serde_json::to_writer(&mut bytes, &line).expect(json);
    }
    bytes.push(b'\n');
    bytes
}

/// Reads a file; times are left there.
///
/// # Errors
/// [`FileError::Read`], or [`FleetError::Result`] for another file.
pub fn read(path: &Path) -> Result<ClipOutcome, Error> {
    let (head, found) = if is_parquet(path) {
        let (head, found) = table::read_outcome(path)?;
        (parse::<Head>(path, head.as_bytes())?, found)
    } else {
        let mut lines = open(path)?;
        let head: Head = parse(path, &next(path, &mut lines)?)?;
        let mut found = Vec::new();
        loop {
            let line = next(path, &mut lines)?;
            if line.is_empty() {
                break;
            }
            if let OutcomeLine::Found(frame, left, top, width, height, score) = parse(path, &line)?
            {
                found.push(DetectionRecord { frame, rect: [left, top, width, height], score });
            }
        }
        (head, found)
    };
    let result = ClipResult {
        found,
        frames: head.frames,
        size: head.size,
        rate: head.rate,
        scan: head.scan,
        registration: head.registration,
        textures: head.textures,
        tracks: head.tracks,
        ..ClipResult::default()
    };
    let clip = Clip { ground_truth: head.ground_truth, ..ClipOutcome::broken(&head.clip, "").clip };
    let result = head.broken.map_or(Ok(result), Err);
    Ok(ClipOutcome { clip, facts: head.facts, result })
}

/// The head of a file as JSON.
fn head(path: &Path) -> Result<Vec<u8>, Error> {
    match is_parquet(path) {
        true => Ok(table::read_head(path)?.into_bytes()),
        false => next(path, &mut open(path)?),
    }
}

/// The name of the clip that a file is of.
///
/// # Errors
/// As [`read`].
pub fn name(path: &Path) -> Result<String, Error> {
    Ok(parse::<Name>(path, &head(path)?)?.clip)
}

/// Whether a file says that its clip can never be measured.
///
/// # Errors
/// As [`read`].
pub fn broken(path: &Path) -> Result<Option<String>, Error> {
    #[derive(Deserialize)]
    struct BrokenHead {
        broken: Option<String>,
    }
    Ok(parse::<BrokenHead>(path, &head(path)?)?.broken)
}

fn open(path: &Path) -> Result<BufReader<File>, Error> {
    Ok(BufReader::new(File::open(path).map_err(Error::read(path))?))
}

fn next(path: &Path, lines: &mut BufReader<File>) -> Result<Vec<u8>, Error> {
    let mut line = Vec::new();
    lines.read_until(b'\n', &mut line).map_err(Error::read(path))?;
    Ok(line)
}

fn parse<'a, T: Deserialize<'a>>(path: &Path, line: &'a [u8]) -> Result<T, Error> {
    serde_json::from_slice(line).map_err(|error| {
        let reason = format!("not the result of a clip: {error}");
        Error::verb(FleetError::Result { path: path.into(), reason })
    })
}

/// A hash of what a clip's result depends on: its name, its facts, its labels and frames, and the files `more`.
///
/// # Errors
/// [`FileError::Read`].
pub fn content(clip: &Clip, facts: &Facts, more: &[PathBuf]) -> Result<String, FileError> {
    let mut hash = Sha256::new();
    let about = serde_json::to_vec(&(&clip.name, facts, &clip.ground_truth)).unwrap_or_default();
    hash.update(about);
    let mut files: Vec<PathBuf> = vec![clip.input.clone()];
    if clip.input.is_dir() {
        files = fs::read_dir(&clip.input)
            .and_then(|entries| entries.map(|entry| Ok(entry?.path())).collect::<io::Result<_>>())
            .map_err(FileError::read(&clip.input))?;
        files.retain(|path| path.is_file());
        files.sort();
    }
    for name in ["camera.json", "truth.csv", "seqinfo.ini"] {
        files.extend(Some(clip.directory.join(name)).filter(|path| path.is_file()));
    }
    files.extend_from_slice(more);
    let mut buffer = vec![0; 1 << 20];
    for path in files {
        hash.update(path.file_name().unwrap_or_default().as_encoded_bytes());
        let mut file = File::open(&path).map_err(FileError::read(&path))?;
        loop {
            let length = file.read(&mut buffer).map_err(FileError::read(&path))?;
            hash.update((length as u64).to_le_bytes());
            if length == 0 {
                break;
            }
            hash.update(&buffer[..length]);
        }
    }
    Ok(hex(&hash.finalize()[..8]))
}

/// The same of words, where there are no contents.
pub fn content_of_words(words: &str) -> String {
    hex(&Sha256::digest(words.as_bytes())[..8])
}

/// Bytes as hexadecimal digits.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::path::Path;
    use std::string::ToString;

    fn clip(text: &str) -> Clip {
        Clip {
            name: "a/b".into(),
            directory: PathBuf::new(),
            input: PathBuf::new(),
            ground_truth: GroundTruth::parse(text, Path::new("gt.txt")).unwrap(),
            info: SeqInfo::default(),
        }
    }

    proptest! {
        #[test]
        fn numbers_read_back_to_the_last_bit(
            rects: Vec<[i32; 4]>, score in -1e3..1e3f64, rate in 1e-3..1e3f64, textures in prop::collection::vec(0.0..255.0f64, 0..9),
        ) {
            let found: Vec<DetectionRecord> = rects.iter().zip(1..).map(|(rect, frame)| {
                DetectionRecord { frame, rect: rect.map(|v| f64::from(v) / 16.0), score: score / frame as f64 }
            }).collect();
            let clip = clip("1,1,0.3,0.7,20.1,20\n3,2,1,1,9,9,1,4\n");
            let result = ClipResult {
                found: found.clone(), frames: 7, rate: Some(rate), textures: textures.clone(),
                times_ms: vec![1.5; 7], ..ClipResult::default()
            };
            let facts = Facts { rate, kind: Some("hover".into()), ..Facts::default() };
            let outcome = ClipOutcome { clip: clip.clone(), facts: facts.clone(), result: Ok(result) };
            let file = tempfile::NamedTempFile::new().unwrap();
            fs::write(file.path(), encode(outcome, ResultForm::Lines).unwrap()).unwrap();
            let back = read(file.path()).unwrap();
            prop_assert_eq!(name(file.path()).unwrap(), "a/b");
            prop_assert_eq!(back.clip.ground_truth, clip.ground_truth);
            prop_assert_eq!(back.facts, facts);
            let back = back.result.unwrap();
            prop_assert_eq!(back.found, found);
            prop_assert_eq!((back.frames, back.rate), (7, Some(rate)));
            prop_assert_eq!(back.textures, textures);
        }
    }

    #[test]
    fn a_file_cut_short_is_named() {
        let file = tempfile::NamedTempFile::new().unwrap();
        for text in ["", "{\"clip\":\"a\"", "[1]\n"] {
            fs::write(file.path(), text).unwrap();
            let error = read(file.path()).unwrap_err().to_string();
            assert!(
                error.contains("not the result of a clip") && error.contains("remove"),
                "{error}"
            );
        }
    }

    #[test]
    fn contents_are_of_labels_and_frames() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("video.y4m");
        let of = |bytes: &str, labels: &str, kind: Option<&str>| {
            fs::write(&path, bytes).unwrap();
            let clip =
                Clip { input: path.clone(), directory: folder.path().into(), ..clip(labels) };
            content(&clip, &Facts { kind: kind.map(Into::into), ..Facts::default() }, &[]).unwrap()
        };
        let first = of("abc", "", None);
        assert_eq!(first.len(), 16);
        assert_eq!(of("abc", "", None), first);
        let others =
            [of("abd", "", None), of("abc", "1,1,1,1,9,9\n", None), of("abc", "", Some("x"))];
        assert!(others.iter().all(|other| *other != first), "{others:?}");
        fs::remove_file(&path).unwrap();
        assert!(content(&Clip { input: path, ..clip("") }, &Facts::default(), &[]).is_err());
    }
}
