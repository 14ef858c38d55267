//! Reading small files whose content is somebody else's: settings, parameters, keys.

use super::text;
use std::fs::{self, File};
use std::io::{self, Error, ErrorKind, Read};
use std::path::Path;
use std::string::String;
use std::vec::Vec;

/// Most bytes of a text file: settings, parameters, a key.
pub const TEXT: u64 = 1 << 20;

/// The whole content of a regular file of at most `most` bytes. Pipes and devices are refused without being opened: they
/// may never end.
///
/// # Errors
/// The system's; `InvalidInput` where it is no regular file; `FileTooLarge`.
pub fn read(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    if !fs::metadata(path)?.is_file() {
        return Err(Error::new(ErrorKind::InvalidInput, "not a regular file"));
    }
    let mut bytes = Vec::new();
    File::open(path)?.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        let reason = std::format!("more than {most} bytes, is it the right file?");
        return Err(Error::new(ErrorKind::FileTooLarge, reason));
    }
    Ok(bytes)
}

/// The same for text of at most [`TEXT`] bytes, in an encoding of [`text::decode`].
///
/// # Errors
/// As [`read`]; `InvalidData` for other encodings.
pub fn read_text(path: &Path) -> io::Result<String> {
    text::decode(read(path, TEXT)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_never_ends_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        fs::write(&file, "12345").unwrap();
        assert_eq!(read(&file, 5).unwrap(), b"12345");
        assert_eq!(read(&file, 4).unwrap_err().kind(), ErrorKind::FileTooLarge);
        assert_eq!(read(folder.path(), 9).unwrap_err().kind(), ErrorKind::InvalidInput);
        #[cfg(unix)]
        for device in ["/dev/full", "/dev/zero"] {
            assert_eq!(read(Path::new(device), 9).unwrap_err().kind(), ErrorKind::InvalidInput);
        }
    }
}
