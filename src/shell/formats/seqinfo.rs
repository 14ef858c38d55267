//! `seqinfo.ini` of the MOTChallenge: where a sequence's pictures are, how many, how large, at which rate.

use std::borrow::ToOwned;
use std::path::{Path, PathBuf};
use std::string::String;
use std::{format, fs, io};

/// Values of the file; `None` where it has none.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SeqInfo {
    /// `imDir`: folder of the pictures.
    pub directory: Option<String>,
    /// `frameRate`: frames a second.
    pub frame_rate: Option<f64>,
    /// `seqLength`: number of frames.
    pub length: Option<u64>,
    /// `imWidth` and `imHeight`: size of the frames, pixels.
    pub size: Option<(u32, u32)>,
}

/// Why a `seqinfo.ini` cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum SeqInfoError {
    /// The file cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// A value that is not understood.
    #[error("{}:{line}: {key} is '{value}', expected {expected}", path.display())]
    Value {
        /// Path of the file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// Key at fault.
        key: &'static str,
        /// Text of the value.
        value: String,
        /// The expected form.
        expected: &'static str,
    },
}

impl SeqInfo {
    /// The file in a clip's folder; nothing is known without it.
    ///
    /// # Errors
    /// [`SeqInfoError`] naming line and key.
    pub fn beside(directory: &Path) -> Result<Self, SeqInfoError> {
        let path = directory.join("seqinfo.ini");
        match fs::read(&path) {
            Ok(bytes) => Self::parse(&String::from_utf8_lossy(&bytes), &path),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Self::default()),
            Err(source) => Err(SeqInfoError::Read { path, source }),
        }
    }

    /// Reads the text; `path` names it in errors.
    ///
    /// # Errors
    /// [`SeqInfoError::Value`].
    pub fn parse(text: &str, path: &Path) -> Result<Self, SeqInfoError> {
        let mut info = Self::default();
        let (mut width, mut height) = (None, None);
        for (index, line) in text.lines().enumerate() {
            let Some((key, value)) = line.split_once('=') else { continue };
            let (key, value) = (key.trim(), value.trim());
            let wrong = |key, expected| SeqInfoError::Value {
                path: path.into(),
                line: index + 1,
                key,
                value: value.to_owned(),
                expected,
            };
            let count = |key| value.parse::<u32>().map_err(|_| wrong(key, "a whole number"));
            match key.to_ascii_lowercase().as_str() {
                "imdir" => {
                    // A folder inside the clip, not one of elsewhere.
                    let inside = !value.is_empty()
                        && Path::new(value).components().all(|c| {
                            matches!(
                                c,
                                std::path::Component::Normal(_) | std::path::Component::CurDir
                            )
                        });
                    if !inside {
                        return Err(wrong("imDir", "a folder inside the sequence's"));
                    }
                    info.directory = Some(value.to_owned());
                }
                "framerate" => {
                    let rate = value.parse::<f64>().ok().filter(|v| (1e-3..=1e6).contains(v));
                    info.frame_rate =
                        Some(rate.ok_or_else(|| wrong("frameRate", "frames a second"))?);
                }
                "seqlength" => info.length = Some(u64::from(count("seqLength")?)),
                "imwidth" => width = Some(count("imWidth")?),
                "imheight" => height = Some(count("imHeight")?),
                _ => {}
            }
        }
        info.size = width.zip(height);
        Ok(info)
    }

    /// The text of the file, with the pictures in `directory`.
    pub fn to_text(&self, name: &str) -> String {
        let mut text = format!("[Sequence]\nname={name}\n");
        if let Some(directory) = &self.directory {
            text += &format!("imDir={directory}\n");
        }
        if let Some(rate) = self.frame_rate {
            text += &format!("frameRate={rate}\n");
        }
        if let Some(length) = self.length {
            text += &format!("seqLength={length}\n");
        }
        if let Some((width, height)) = self.size {
            text += &format!("imWidth={width}\nimHeight={height}\n");
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn values_and_errors_by_line() {
        let text = "[Sequence]\r\nname=A\r\nimDir=img1\r\nframeRate=29.97\r\nseqLength=525\r\nimWidth=1920\r\nimHeight=1080\r\nimExt=.jpg\r\n";
        let info = SeqInfo::parse(text, Path::new("a/seqinfo.ini")).unwrap();
        let expected = SeqInfo {
            directory: Some("img1".into()),
            frame_rate: Some(29.97),
            length: Some(525),
            size: Some((1920, 1080)),
        };
        assert_eq!(info, expected);
        assert_eq!(SeqInfo::parse(&info.to_text("A"), Path::new("")).unwrap(), expected);
        for (text, message) in [
            ("\nframeRate=0", "a/seqinfo.ini:2: frameRate is '0', expected frames a second"),
            ("seqLength=many", "a/seqinfo.ini:1: seqLength is 'many', expected a whole number"),
            ("imDir=../x", "a/seqinfo.ini:1: imDir is '../x', expected a folder inside"),
        ] {
            let error = SeqInfo::parse(text, Path::new("a/seqinfo.ini")).unwrap_err().to_string();
            assert!(error.starts_with(message), "{error}");
        }
    }
}
