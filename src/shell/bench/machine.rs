//! The processor that a measurement ran on.

use std::fs;
use std::string::{String, ToString};

/// Name of the processor as the operating system gives it: the model of a board where the processor itself has no name, the
/// architecture where nothing has.
pub fn processor() -> String {
    let text = |path| fs::read_to_string(path).unwrap_or_default();
    named(&text("/proc/cpuinfo"), &text("/proc/device-tree/model"))
        .unwrap_or(std::env::consts::ARCH)
        .to_string()
}

/// The first name in Linux' description of the processors, or else the board's.
fn named<'a>(processors: &'a str, board: &'a str) -> Option<&'a str> {
    let value = |line: &'a str| {
        let (key, value) = line.split_once(':')?;
        (key.trim() == "model name").then_some(value.trim())
    };
    let name = processors.lines().find_map(value);
    // The text of a device tree ends with a zero.
    name.or(Some(board.trim_end_matches('\0').trim())).filter(|name| !name.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processors_and_boards_have_names() {
        let desktop = "processor\t: 0\nmodel\t\t: 17\nmodel name\t: AMD EPYC\nprocessor\t: 1\nmodel name\t: B\n";
        assert_eq!(named(desktop, ""), Some("AMD EPYC"));
        let board = "processor\t: 0\nCPU part\t: 0xd0b\n";
        assert_eq!(named(board, "Raspberry Pi 5 Model B\0"), Some("Raspberry Pi 5 Model B"));
        assert_eq!(named(board, ""), None);
        assert!(!processor().is_empty());
    }
}
