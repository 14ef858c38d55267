//! Requests of the preview page: the parser never reads beyond the request that it returns.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lookout::shell::fuzzing;

fuzz_target!(|data: &[u8]| {
    let mut rest = data;
    while let Some(length) = fuzzing::http_request(rest) {
        assert!(0 < length && length <= rest.len());
        assert_eq!(fuzzing::http_request(&rest[..length]), Some(length));
        rest = &rest[length..];
    }
});
