//! The same message again and again, logged once a minute.

use std::borrow::ToOwned;
use std::string::String;
use std::time::{Duration, Instant};

/// Time after which a message that stays the same is logged again.
const SPAN: Duration = Duration::from_secs(60);

/// The message that was logged last.
#[derive(Debug, Default)]
pub struct Repeats {
    last: Option<(String, Instant)>,
}

impl Repeats {
    /// Whether `text` is to be logged at `now`: it differs from the one before, or that was a minute ago.
    pub fn is_news(&mut self, text: &str, now: Instant) -> bool {
        let known = self.last.as_ref().is_some_and(|(last, since)| {
            last == text && now.saturating_duration_since(*since) < SPAN
        });
        if !known {
            self.last = Some((text.to_owned(), now));
        }
        !known
    }

    /// The next message is news, whatever it is.
    pub fn forget(&mut self) {
        self.last = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn once_a_minute_or_when_it_changes() {
        let (mut repeats, start) = (Repeats::default(), Instant::now());
        let mut news = |text, seconds| repeats.is_news(text, start + Duration::from_secs(seconds));
        assert!(news("gone", 0) && !news("gone", 1) && !news("gone", 59));
        assert!(news("gone", 60) && !news("gone", 61));
        assert!(news("refused", 62) && news("gone", 63));
        repeats.forget();
        assert!(repeats.is_news("gone", start + Duration::from_secs(63)));
    }
}
