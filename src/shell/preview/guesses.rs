//! Limit on wrong tokens: twenty a minute from one address, after which no token from there is compared for the rest of it.
//! A page that asks again with the same wrong token guesses only once.

use std::net::IpAddr;
use std::string::String;
use std::time::{Duration, Instant};
use std::vec::Vec;

/// Wrong tokens from one address in [`SPAN`].
const MOST: u32 = 20;
const SPAN: Duration = Duration::from_secs(60);

/// Addresses that are remembered.
const ADDRESSES: usize = 256;

#[derive(Debug)]
struct Guesser {
    address: IpAddr,
    wrong: u32,
    last: String,
    since: Instant,
}

/// Wrong tokens by address.
#[derive(Debug, Default)]
pub struct Guesses {
    guessers: Vec<Guesser>,
}

impl Guesses {
    /// Whether a token from this address is compared at all.
    pub fn may_guess(&mut self, address: IpAddr, now: Instant) -> bool {
        self.guessers.retain(|guesser| now.saturating_duration_since(guesser.since) < SPAN);
        let known = self.guessers.iter().find(|guesser| guesser.address == address);
        match known {
            Some(guesser) => guesser.wrong < MOST,
            // More addresses than are remembered: somebody has a network of them.
            None => self.guessers.len() < ADDRESSES,
        }
    }

    /// Counts a wrong token.
    pub fn wrong(&mut self, address: IpAddr, token: &str, now: Instant) {
        match self.guessers.iter_mut().find(|guesser| guesser.address == address) {
            Some(guesser) if guesser.last == token => {}
            Some(guesser) => {
                guesser.wrong += 1;
                guesser.last = token.into();
            }
            None => {
                self.guessers.push(Guesser { address, wrong: 1, last: token.into(), since: now });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn twenty_a_minute_from_an_address() {
        let mut guesses = Guesses::default();
        let (one, other) = (IpAddr::from([10, 0, 0, 1]), IpAddr::from([10, 0, 0, 2]));
        let start = Instant::now();
        for guess in 0..20 {
            assert!(guesses.may_guess(one, start));
            for _ in 0..5 {
                guesses.wrong(one, &std::format!("guess {guess}"), start);
            }
        }
        assert!(!guesses.may_guess(one, start + SPAN / 2));
        assert!(guesses.may_guess(other, start), "others are not concerned");
        assert!(guesses.may_guess(one, start + SPAN));
    }
}
