//! A telemetry log: what is read and what is skipped are the whole of it, and a record written again is the same.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lookout::shell::formats::tlog::{self, Reader};
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let mut reader = Reader::new(data, Path::new("log"));
    let mut read = 0;
    loop {
        let record = match reader.next_record() {
            Ok(Some(record)) => record,
            Ok(None) => break,
            // No log, or one of another kind of times, as its error says.
            Err(_) => return,
        };
        let _ = record.message();
        let mut again = Vec::new();
        tlog::write(&mut again, record.time_us, &record.frame).expect("memory takes it");
        let start = record.offset as usize;
        assert_eq!(again, &data[start..start + again.len()]);
        read += again.len() as u64;
    }
    assert_eq!(read + reader.skipped(), data.len() as u64);
});
