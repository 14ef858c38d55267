//! The page's section about the trials.

use super::super::elements::{escape, figure, number, table};
use super::super::plot::{self, Axis, Curve, plot};
use super::figures::{ErrorBreakdown, ErrorSpread, RegressorFigures};
use super::trials::WAYS;
use std::format;
use std::string::{String, ToString};
use std::vec::Vec;

/// The section of the page; nothing where nothing was tried.
pub fn section(figures: Option<&RegressorFigures>) -> String {
    let Some(figures) = figures else { return String::new() };
    let percent = |share: f64| format!("{:.1} %", share * 100.0);
    let moves: Vec<String> = figures
        .moves
        .iter()
        .enumerate()
        .map(|(moves, &share)| format!("{moves}: {}", percent(share)))
        .collect();
    let centred: Vec<String> = figures
        .share_centred
        .iter()
        .map(|way| format!("{} {}", way.way, percent(way.share)))
        .collect();
    let key = |(i, way): (usize, &&str)| {
        let (r, g, b) = plot::colour(i);
        format!("<span class=\"key\"><i style=\"background:rgb({r},{g},{b})\"></i>{way}</span>")
    };
    format!(
        "<h2>Algorithm 1 alone</h2>\n<p class=\"note\">{} cubes of {} clips, frames and starts drawn at random (seed {}): a window off \
         the target\u{2019}s centre in the newest frame, placed in the frames before it along the background\u{2019}s motion alone, \
         by the regressors (ours), and by pyramidal Lucas-Kanade flow of the target\u{2019}s patch (LK). Off centre: from the window\u{2019}s \
         middle to the target\u{2019}s centre in that slice; the flow keeps what the start was off. Motion: how wrong the window\u{2019}s \
         motion since the newest frame is. Labels are whole pixels. Relative: in lengths of the target.</p>\n\
         <p>Ours came to rest before n_max moves in every slice of {} of the cubes, in {} of the slices. Moves a slice: {:.2} in the \
         mean ({}). Every slice is within {} lengths of the target: {}. LK was found in {} of the older slices; where not, the \
         background\u{2019}s motion stands.</p>\n<p>{}</p>\n<div class=\"plots\">{}{}</div>\n{}",
        figures.cubes,
        figures.clips,
        figures.seed,
        percent(figures.share_settled),
        percent(figures.share_slices_settled),
        figures.mean_moves,
        moves.join(", "),
        figures.centred_within,
        centred.join(", "),
        percent(figures.share_followed),
        WAYS.iter().enumerate().map(key).collect::<String>(),
        curve(figures, "start", "start (lengths of the target)"),
        curve(figures, "size", "longer side (pixels)"),
        figures.breakdowns.iter().map(breakdown).collect::<String>(),
    )
}

/// Median of what slices are off centre, up to 90 %, by the groups of a breakdown.
fn curve(figures: &RegressorFigures, by: &str, label: &'static str) -> String {
    let Some(breakdown) = figures.breakdowns.iter().find(|b| b.by == by) else {
        return String::new();
    };
    let names: Vec<String> = breakdown.groups.iter().map(|group| group.name.clone()).collect();
    let line = |way: usize| {
        let mut line = Curve { method: way, joined: true, ..Curve::default() };
        for (g, group) in breakdown.groups.iter().enumerate() {
            let ErrorSpread { median: Some(median), p90: Some(p90) } =
                group.ways[way].centre_relative
            else {
                continue;
            };
            let x = g as f64 + (way as f64 - 1.0) * 0.15;
            // The axis ends at a length of the target.
            line.points.push([x, median.min(1.0)]);
            line.bars.push([x, median.min(1.0), p90.min(1.0)]);
        }
        line
    };
    let lines: Vec<Curve> = (0..WAYS.len()).map(line).collect();
    let svg = plot(&Axis::groups(label, &names), &Axis::share("off centre (lengths)"), &lines);
    figure(&svg, &format!("Off centre in older slices by {by}: median, up to 90 %"))
}

fn breakdown(breakdown: &ErrorBreakdown) -> String {
    let heads = [
        "Group",
        "Placed by",
        "Slices",
        "Off centre, px: median",
        "90 %",
        "Relative: median",
        "90 %",
        "Motion, px: median",
        "90 %",
        "Relative: median",
        "90 %",
    ];
    let rows = breakdown.groups.iter().filter(|group| group.slices > 0).flat_map(|group| {
        group.ways.iter().enumerate().map(move |(i, way)| {
            let first = if i == 0 { escape(&group.name) } else { String::new() };
            let mut cells = [first, way.way.to_string(), group.slices.to_string()].to_vec();
            let pairs = [way.centre_px, way.centre_relative, way.motion_px, way.motion_relative];
            for (pair, digits) in pairs.into_iter().zip([2, 3, 2, 3]) {
                cells.extend([number(pair.median, digits), number(pair.p90, digits)]);
            }
            cells
        })
    });
    format!(
        "<h3>{}</h3>\n{}",
        escape(breakdown.heading),
        table(&heads.map(ToString::to_string), 2, rows)
    )
}
