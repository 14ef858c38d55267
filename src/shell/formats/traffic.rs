//! Traffic as JSON and in words.

use crate::tracking::traffic::{AlertLevel, Direction, Estimate, Traffic};
use serde::Serialize;
use std::string::String;
use std::{format, vec::Vec};

/// One object that is followed, as it stands in a line of JSON: radians, metres, seconds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrafficLine {
    id: u16,
    level: &'static str,
    confirmed: bool,
    coasting: bool,
    /// Left, top, width, height in pixels.
    r#box: [f64; 4],
    /// Forward, right, down.
    body: [f64; 3],
    /// North, east, down.
    ned: Option<[f64; 3]>,
    direction_sigma: f64,
    /// Value and standard deviation, here and below.
    rate: [f64; 2],
    range: Option<[f64; 2]>,
    velocity: Option<[f64; 3]>,
    time_to_contact: Option<[f64; 2]>,
    closest: Option<[f64; 2]>,
}

impl From<&Traffic> for TrafficLine {
    fn from(t: &Traffic) -> Self {
        let pair = |e: Estimate| [e.value, e.sigma].map(|v| round(v.to_num(), 4));
        let unit = |d: Direction| [d.x, d.y, d.z].map(|v| round(v.to_num(), 6));
        let rect = t.rect;
        Self {
            id: t.id,
            level: name(t.level),
            confirmed: t.confirmed,
            coasting: t.coasting,
            r#box: [rect.x, rect.y, rect.width, rect.height].map(|v| v.to_num()),
            body: unit(t.body),
            ned: t.ned.map(unit),
            direction_sigma: round(t.direction_sigma.to_num(), 5),
            rate: pair(t.rate),
            range: t.range.map(pair),
            velocity: t.velocity.map(|v| v.map(|v| round(v.to_num(), 3))),
            time_to_contact: t.time_to_contact.map(pair),
            closest: t.closest.map(pair),
        }
    }
}

/// All of a frame.
pub fn lines(traffic: &[Traffic]) -> Vec<TrafficLine> {
    traffic.iter().map(TrafficLine::from).collect()
}

/// The word for a level.
pub fn name(level: AlertLevel) -> &'static str {
    match level {
        AlertLevel::None => "none",
        AlertLevel::Traffic => "traffic",
        AlertLevel::Caution => "caution",
        AlertLevel::Warning => "warning",
    }
}

/// `track 3 is warning: 2.1 degrees right, 0.4 degrees down, contact in 4.5 s (+-0.8), range about 21 m (+-15)`.
/// The direction is left out unless it is `pointed` ([`Health::pointed`](crate::mavlink::messages::Health::pointed)).
pub fn in_words(t: &Traffic, pointed: bool) -> String {
    let degrees = |v: crate::math::real::Real| v.to_num::<f64>().to_degrees();
    let right = side(degrees(t.body.azimuth()), "right", "left");
    let up = side(degrees(t.body.elevation()), "up", "down");
    let estimate = |e: Estimate, digits: usize| {
        let [value, sigma] = [e.value, e.sigma].map(|v| v.to_num::<f64>());
        format!("{value:.digits$} (+-{sigma:.digits$})")
    };
    let contact = t.time_to_contact.map_or("contact not foreseen".into(), |time| {
        format!("contact in {} s", estimate(time, 1))
    });
    let range = t.range.map_or(String::new(), |range| {
        format!(", range about {} m if its span is as assumed", estimate(range, 0))
    });
    let direction =
        if pointed { format!("{right}, {up}") } else { "where from the vehicle is unknown".into() };
    format!("track {} is {}: {direction}, {contact}{range}", t.id, name(t.level))
}

/// An angle with the side to which it goes.
fn side(degrees: f64, positive: &str, negative: &str) -> String {
    let name = if degrees < 0.0 { negative } else { positive };
    format!("{:.1} degrees {name}", degrees.abs())
}

fn round(value: f64, digits: i32) -> f64 {
    let scale = 10f64.powi(digits);
    (value * scale).round() / scale
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_have_a_side() {
        assert_eq!(side(-20.1, "right", "left"), "20.1 degrees left");
        assert_eq!(side(0.4, "up", "down"), "0.4 degrees up");
        assert_eq!(side(0.0, "right", "left"), "0.0 degrees right");
    }
}
