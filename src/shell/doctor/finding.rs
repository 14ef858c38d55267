//! Findings of `lookout doctor` and their severity.

use std::string::String;

/// Severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mark {
    /// As it should be.
    Good,
    /// Information, no fault.
    Note,
    /// Something is missing: the exit status says so.
    Missing,
}

/// Something that was found, in words.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// Severity: good, a note, or a fault.
    pub mark: Mark,
    /// Sentence for the user.
    pub text: String,
}

pub fn good(text: String) -> Finding {
    Finding { mark: Mark::Good, text }
}

pub fn note(text: String) -> Finding {
    Finding { mark: Mark::Note, text }
}
