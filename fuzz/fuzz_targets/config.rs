//! The configuration file: what is accepted is accepted again as it is printed.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lookout::shell::live::config::{self, ServiceConfig};
use std::path::Path;

fuzz_target!(|text: &str| {
    let path = Path::new("lookout.toml");
    let Ok(config) = ServiceConfig::parse(path, text) else { return };
    // The only value that is not printed.
    if config.preview_token.is_some() {
        return;
    }
    let printed = config::print(Some(&config));
    let again =
        ServiceConfig::parse(path, &printed).unwrap_or_else(|error| panic!("{error}\n{printed}"));
    assert!(config.changes(&again).is_empty(), "{printed}");
});
