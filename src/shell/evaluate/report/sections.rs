//! Sections of the page about use: reliability, false reports, range of detection, registration.

use super::elements::{figure, length, number, table};
use super::figures::{IOUS, LOOSE, ReportFigures};
use super::plot::{Axis, Curve, plot};
use crate::shell::evaluate::ranges::SpanRanges;
use std::format;
use std::string::{String, ToString};
use std::vec;
use std::vec::Vec;

/// All of them; those without figures are left out.
pub fn page(figures: &ReportFigures) -> String {
    [
        reliability(figures),
        without_target(figures),
        ranges(&figures.in_use.ranges),
        registration(figures),
    ]
    .concat()
}

fn heads(names: &[&str]) -> Vec<String> {
    names.iter().map(ToString::to_string).collect()
}

/// A number with its interval in small letters.
fn with_interval(value: Option<f64>, low: Option<f64>, high: Option<f64>, digits: usize) -> String {
    let value_text = number(value, digits);
    match (value, low, high) {
        (Some(_), Some(low), Some(high)) => {
            format!("{value_text} <small>{low:.digits$} to {high:.digits$}</small>")
        }
        _ => value_text,
    }
}

fn reliability(figures: &ReportFigures) -> String {
    if figures.in_use.reliability.is_empty() {
        return String::new();
    }
    let row = |row: &crate::shell::evaluate::reliability::ReliabilityRow| {
        let found = row.found;
        vec![
            format!("{:.2}", row.stated),
            format!("{:.3}", row.score),
            row.detections.to_string(),
            with_interval(found.value, found.low, found.high, 3),
            number(row.recall, 3),
        ]
    };
    let points = figures.in_use.reliability.iter().filter_map(|row| {
        let value = row.found.value?;
        let (low, high) = (row.found.low.unwrap_or(value), row.found.high.unwrap_or(value));
        Some(([row.stated, value], [row.stated, low, high]))
    });
    let (points, bars): (Vec<_>, Vec<_>) = points.unzip();
    let found = Curve { method: 0, joined: true, points, bars };
    let honest =
        Curve { method: 7, joined: true, points: vec![[0.0, 0.0], [1.0, 1.0]], ..Curve::default() };
    let (x, y) = (Axis::share("precision stated"), Axis::share("precision found"));
    let svg = plot(&x, &y, &[found, honest]);
    let names = ["Precision stated", "Score from", "Detections", "Precision found", "Recall"];
    format!(
        "<h2>Reliability</h2>\n<p class=\"note\">The model states for each score which share of the detections of that score or \
         more is right (--min-precision). Found on these clips at IoU {}; the diagonal is what it promises.</p>\n{}\
         <div class=\"plots\">{}</div>\n",
        IOUS[LOOSE],
        table(&heads(&names), 1, figures.in_use.reliability.iter().map(row)),
        figure(&svg, "Precision stated and found"),
    )
}

fn without_target(figures: &ReportFigures) -> String {
    let Some(quiet) = &figures.in_use.without_target else { return String::new() };
    let rows = quiet.rows().into_iter().map(|(name, rate)| {
        let interval = with_interval(rate.per_hour, rate.low, rate.high, 1);
        vec![name, rate.events.to_string(), interval]
    });
    let score = quiet
        .score
        .map_or(String::new(), |score| format!(" Detections count from score {score:.3} on."));
    format!(
        "<h2>False reports where nothing flies</h2>\n<p class=\"note\">{} clips, {}.{score} Intervals: 95 %, Poisson; too narrow \
         for detections, of which one object gives many.</p>\n{}",
        quiet.clips,
        length(quiet.hours),
        table(&heads(&["Event", "Events", "An hour"]), 1, rows),
    )
}

fn ranges(groups: &[SpanRanges]) -> String {
    let Some(first) = groups.first() else { return String::new() };
    let names: Vec<String> = first.bins.iter().map(|bin| bin.name()).collect();
    let line = |(number, group): (usize, &SpanRanges)| {
        let points = group.bins.iter().enumerate();
        let points = points.filter_map(|(x, bin)| Some([x as f64, bin.tracked?])).collect();
        Curve { method: number, joined: true, points, bars: Vec::new() }
    };
    let lines: Vec<Curve> = groups.iter().enumerate().map(line).collect();
    let svg = plot(&Axis::groups("distance (m)", &names), &Axis::share("P(track)"), &lines);
    let key = |(i, group): (usize, &SpanRanges)| {
        let (r, g, b) = super::plot::colour(i);
        format!(
            "<span class=\"key\"><i style=\"background:rgb({r},{g},{b})\"></i>{}</span>",
            group.name
        )
    };
    let keys: String = groups.iter().enumerate().map(key).collect();
    let rows = groups.iter().map(|group| {
        vec![
            group.name.to_string(),
            group.targets.to_string(),
            group.tracked.to_string(),
            number(group.first_track_m, 0),
            number(group.farthest_m, 0),
        ]
    });
    let columns = ["Target", "Targets", "Tracked", "First track (m, median)", "Farthest track (m)"];
    format!(
        "<h2>Range of detection</h2>\n<p class=\"note\">Share of the frames of targets at a distance in which a confirmed track was \
         on them, by the target\u{2019}s span (truth.csv, camera.json).</p>\n<p>{keys}</p><div class=\"plots\">{}</div>\n{}",
        figure(&svg, "Probability of a confirmed track over distance"),
        table(&heads(&columns), 1, rows),
    )
}

fn registration(figures: &ReportFigures) -> String {
    let Some(registration) = figures.in_use.registration.filter(|r| r.frames > 0) else {
        return String::new();
    };
    let row = vec![
        registration.frames.to_string(),
        number(registration.share_registered, 4),
        number(registration.residual_without, 2),
        number(registration.residual, 2),
        number(registration.residual_95, 2),
    ];
    let names = [
        "Frames",
        "Share registered",
        "Difference without (grey levels, median)",
        "With registration (median)",
        "With registration (95 % below)",
    ];
    format!(
        "<h2>Registration</h2>\n<p class=\"note\">Mean absolute difference of a frame to the one before it, over the registered \
         frames; movement, parallax and noise stay in it.</p>\n{}",
        table(&heads(&names), 0, [row].into_iter()),
    )
}
