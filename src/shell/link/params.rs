//! The file of parameters that ground stations set: text, one line `NAME VALUE` for each parameter.

use crate::mavlink::component::parameters::{Parameter, Parameters};
use crate::shell::support::{atomic_file, bounded_file};
use std::fmt::Write;
use std::io;
use std::path::Path;
use std::string::String;

/// Reads the file; the defaults where there is none. A line with an unknown parameter or a value out of range is logged and
/// left out: an old file must not keep the lookout on the ground.
///
/// # Errors
/// As [`bounded_file::read`], where there is a file.
pub fn load(path: &Path) -> io::Result<Parameters> {
    let mut parameters = Parameters::default();
    let text = match bounded_file::read(path, bounded_file::TEXT) {
        Ok(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(parameters),
        Err(error) => return Err(error),
    };
    for (number, line) in text.lines().enumerate() {
        let line = line.split('#').next().unwrap_or_default().trim();
        if line.is_empty() {
            continue;
        }
        let mut words = line.split_whitespace();
        let parameter = words.next().and_then(|name| Parameter::from_name(name.as_bytes()));
        let value = words.next().and_then(|value| value.parse().ok());
        let taken = match (parameter, value) {
            (Some(parameter), Some(value)) => parameters.set(parameter, value),
            _ => false,
        };
        if !taken {
            let number = number + 1;
            tracing::warn!(
                "{} line {number}: '{line}' is no parameter and value; left out",
                path.display()
            );
        }
    }
    Ok(parameters)
}

/// Writes all parameters, whole at any time.
///
/// # Errors
/// The system's.
pub fn save(path: &Path, parameters: &Parameters) -> io::Result<()> {
    atomic_file::write(path, text(parameters).as_bytes())
}

/// All parameters as text.
pub fn text(parameters: &Parameters) -> String {
    let mut text = String::new();
    for parameter in Parameter::all() {
        // The shortest digits that give the same number again.
        let _ = writeln!(text, "{} {}", parameter.name(), parameters.wire(parameter));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::fs;
    use std::vec::Vec;

    #[test]
    fn what_is_kept_comes_back_exactly() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("params.txt");
        assert_eq!(load(&file).unwrap(), Parameters::default());
        let mut parameters = Parameters::default();
        assert!(parameters.set(Parameter::Wingspan, 0.35) && parameters.set(Parameter::Text, 0.0));
        save(&file, &parameters).unwrap();
        assert_eq!(load(&file).unwrap(), parameters);
        // A write that lost its power half way.
        fs::write(folder.path().join("params.txt.new"), "LK_WIN").unwrap();
        assert_eq!(load(&file).unwrap(), parameters);
    }

    #[test]
    fn what_is_not_understood_is_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("params.txt");
        fs::write(
            &file,
            "# kept\nLK_OLD 3\nLK_WINGSPAN 900\nLK_TEXT NaN\nLK_ADSB_HZ 4 # fast\n\u{fffd}",
        )
        .unwrap();
        let mut want = Parameters::default();
        want.set(Parameter::AdsbRate, 4.0);
        assert_eq!(load(&file).unwrap(), want);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn any_bytes_are_read(bytes: Vec<u8>) {
            let folder = tempfile::tempdir().unwrap();
            let file = folder.path().join("params.txt");
            fs::write(&file, &bytes).unwrap();
            prop_assert!(load(&file).is_ok());
        }
    }
}
