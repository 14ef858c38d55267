//! Log of the service: a thread of its own writes lines to standard error.
//!
//! If standard error blocks or fails (a full disk, a reader that left or stopped reading), nothing waits and nothing fails:
//! lines that find no room are dropped and counted.

use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};
use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};
use std::vec::Vec;
use tracing_subscriber::fmt::MakeWriter;

/// Lines that wait to be written at most.
const WAITING: usize = 256;

#[derive(Debug, Default)]
struct LogCounts {
    /// Lines handed over, and lines of these that the thread is done with.
    taken: AtomicU64,
    done: AtomicU64,
    lost: AtomicU64,
}

/// Takes lines; a clone is the same log.
#[derive(Debug, Clone)]
pub struct Log {
    lines: Sender<Vec<u8>>,
    counts: Arc<LogCounts>,
}

impl Log {
    /// Starts the thread that writes to standard error.
    ///
    /// # Errors
    /// The system's, where there is no thread.
    pub fn start() -> io::Result<Self> {
        Self::to(io::stderr())
    }

    fn to(out: impl Write + Send + 'static) -> io::Result<Self> {
        let (lines, taken) = bounded(WAITING);
        let counts = Arc::<LogCounts>::default();
        let log = Self { lines, counts: counts.clone() };
        let write = move || write(&taken, &counts, out);
        thread::Builder::new().name("log".into()).spawn(write)?;
        Ok(log)
    }

    /// Waits until everything is written, at most `timeout`.
    pub fn drain(&self, timeout: Duration) {
        let until = Instant::now() + timeout;
        let open = || {
            let [taken, done] =
                [&self.counts.taken, &self.counts.done].map(|n| n.load(Ordering::SeqCst));
            done < taken
        };
        while open() && Instant::now() < until {
            thread::sleep(Duration::from_millis(2));
        }
    }
}

fn write(lines: &Receiver<Vec<u8>>, counts: &LogCounts, mut out: impl Write) {
    for line in lines {
        let lost = counts.lost.swap(0, Ordering::SeqCst);
        if lost > 0 {
            // A log that cannot be written has nobody to complain to, here and below.
            let _ = writeln!(out, "{lost} lines of this log are lost: it was read too slowly");
        }
        let _ = out.write_all(&line).and_then(|()| out.flush());
        counts.done.fetch_add(1, Ordering::SeqCst);
    }
}

impl Write for Log {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        self.counts.taken.fetch_add(1, Ordering::SeqCst);
        if let Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) =
            self.lines.try_send(line.into())
        {
            self.counts.lost.fetch_add(1, Ordering::SeqCst);
            self.counts.done.fetch_add(1, Ordering::SeqCst);
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl<'a> MakeWriter<'a> for Log {
    type Writer = Self;

    fn make_writer(&'a self) -> Self {
        self.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;

    /// Takes bytes only while nobody holds it.
    #[derive(Clone, Default)]
    struct Slow(Arc<Mutex<Vec<u8>>>);

    impl Write for Slow {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().unwrap().extend(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn nobody_waits_for_a_reader() {
        let out = Slow::default();
        let mut log = Log::to(out.clone()).unwrap();
        let held = out.0.lock().unwrap();
        for _ in 0..1000 {
            log.write_all(b"line\n").unwrap();
        }
        log.drain(Duration::from_millis(10));
        drop(held);
        log.drain(Duration::from_secs(20));
        log.write_all(b"end\n").unwrap();
        log.drain(Duration::from_secs(20));
        let text = std::string::String::from_utf8(out.0.lock().unwrap().clone()).unwrap();
        let lines = text.lines().filter(|line| *line == "line").count();
        assert!((WAITING..=WAITING + 1).contains(&lines), "{lines}");
        // In one message or in two: the thread may have written its first line while others were lost already.
        let lost = text.lines().filter_map(|line| {
            line.strip_suffix(" lines of this log are lost: it was read too slowly")
        });
        let lost: usize = lost.map(|count| count.parse::<usize>().unwrap()).sum();
        assert_eq!(lost, 1000 - lines, "{text}");
        assert!(text.ends_with("end\n"), "{text}");
    }
}
