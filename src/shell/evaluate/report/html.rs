//! The report as one page: style, plots and pictures inside.

use super::elements::{escape, figure, interval, length, number, table};
use super::figures::{Breakdown, IOUS, MethodFigures, ReportFigures, limit_name};
use super::gallery::{Mistake, PER_CLIP};
use super::plot::{self, Axis, Curve, plot};
use super::regressors;
use super::sections;
use crate::shell::evaluate::bootstrap::{FEWEST_CLIPS, Interval};
use crate::shell::evaluate::score::FALSE_ALARMS;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use std::format;
use std::string::{String, ToString};
use std::vec;
use std::vec::Vec;

/// The report as an HTML page.
pub fn page(figures: &ReportFigures) -> String {
    let sections = [
        precision(figures),
        collisions(figures),
        false_alarms(figures),
        breakdowns(figures),
        operating_points(figures),
        sections::page(figures),
        regressors::section(figures.regressors.as_ref()),
        gallery(figures),
        method(figures),
    ]
    .concat();
    // Few clips have no intervals.
    let small = match sections.contains("<small>") {
        true => format!(
            "<p class=\"note\">Small: {:.0} % confidence interval.</p>\n",
            figures.bootstrap.level * 100.0
        ),
        false => String::new(),
    };
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width\">\
         <title>Lookout: {data}</title><style>{}</style></head>\n<body>{}{small}{sections}</body></html>\n",
        include_str!("style.css"),
        head(figures),
        data = escape(&figures.data),
    )
}

fn head(figures: &ReportFigures) -> String {
    let flights = &figures.flights;
    let without = match flights.clips_without_target {
        0 => String::new(),
        clips => format!(
            " Of these, {clips} {} ({}) without a target.",
            if clips == 1 { "is" } else { "are" },
            length(flights.hours_without_target)
        ),
    };
    format!(
        "<h1>Lookout: detection on {}</h1>\n<p>{} clips, {} frames ({}), {} targets, {} boxes on birds.{}</p>\n<p>{}</p>\n",
        escape(&figures.data),
        flights.clips,
        flights.frames,
        length(flights.hours),
        flights.targets,
        flights.bird_boxes,
        without,
        legend(figures),
    )
}

fn legend(figures: &ReportFigures) -> String {
    let key = |(i, method): (usize, &MethodFigures)| {
        let (r, g, b) = plot::colour(i);
        let name = escape(&method.name);
        format!("<span class=\"key\"><i style=\"background:rgb({r},{g},{b})\"></i>{name}</span>")
    };
    figures.methods.iter().enumerate().map(key).collect()
}

fn precision(figures: &ReportFigures) -> String {
    let mut heads = vec!["Method".to_string()];
    heads.extend(IOUS.map(|iou| format!("AveP (IoU {iou})")));
    let paired = figures.methods.len() > 1;
    let name = figures.methods.first().map_or(String::new(), |first| escape(&first.name));
    if paired {
        heads.extend(IOUS.map(|iou| format!("{name} less this (IoU {iou})")));
    }
    heads.push("Time per frame (ms, median)".into());
    let row = |method: &MethodFigures| {
        let mut cells = vec![escape(&method.name)];
        cells.extend(method.at_iou.iter().map(|at| interval(&at.average_precision)));
        if paired {
            cells.extend(method.at_iou.iter().map(|at| {
                at.first_less_this.map_or("\u{2013}".into(), |difference| interval(&difference))
            }));
        }
        cells.push(number(method.median_ms_per_frame, 1));
        cells
    };
    let curves = (0..IOUS.len()).map(|i| {
        let line = |m: usize, method: &MethodFigures| Curve {
            method: m,
            points: method.at_iou[i].precision_recall.clone(),
            joined: true,
            bars: Vec::new(),
        };
        let svg = plot(&Axis::share("recall"), &Axis::share("precision"), &lines(figures, line));
        figure(&svg, &format!("Precision and recall, IoU {}", IOUS[i]))
    });
    let table = table(&heads, 1, figures.methods.iter().map(row));
    format!(
        "<h2>Average precision</h2>\n{table}<p class=\"note\">Time: in this run, other clips at \
         the same time; \u{201c}\u{2013}\u{201d}: not known.</p>\n<div class=\"plots\">{}</div>\n",
        curves.collect::<String>(),
    )
}

fn collisions(figures: &ReportFigures) -> String {
    let Some(collisions) = &figures.collisions else { return String::new() };
    let name = figures.methods.first().map_or(String::new(), |first| escape(&first.name));
    let mut heads = vec!["Method".to_string()];
    heads.extend(IOUS.map(|iou| format!("AveP (IoU {iou})")));
    heads.extend(IOUS.map(|iou| format!("{name} less this (IoU {iou})")));
    let rows = collisions.methods.iter().map(|method| {
        let mut cells = vec![escape(&method.name)];
        cells.extend(method.average_precision.iter().map(interval));
        cells.extend((0..IOUS.len()).map(|i| {
            let less = method.first_less_this.as_ref().map(|less| interval(&less[i]));
            less.unwrap_or("\u{2013}".into())
        }));
        cells
    });
    format!(
        "<h2>On a collision course</h2>\n<p class=\"note\">The {} flights of this kind alone ({}, {} targets): what is \
         going to hit the camera hardly moves in its picture.</p>\n{}",
        collisions.clips,
        length(collisions.hours),
        collisions.targets,
        table(&heads, 1, rows),
    )
}

fn false_alarms(figures: &ReportFigures) -> String {
    let mut heads = vec!["Method".to_string()];
    for iou in IOUS {
        heads.extend(FALSE_ALARMS.map(|n| format!("{n} per 1000 (IoU {iou})")));
    }
    let row = |method: &MethodFigures| {
        let recalls =
            method.at_iou.iter().flat_map(|at| &at.recall_at_false_alarms_per_1000_frames);
        [escape(&method.name)].into_iter().chain(recalls.map(interval)).collect()
    };
    let curves = (0..IOUS.len()).map(|i| {
        let hourly =
            |method: &MethodFigures| method.at_iou[i].recall_at_false_alarms_per_hour.clone();
        // The first decade is that of one false alarm in all.
        let start = (1.0 / figures.flights.hours.max(1e-9)).log10().floor() as i32;
        let most = figures.methods.iter().flat_map(hourly).map(|p| p[0]).fold(1.0, f64::max);
        let decades = start..(most.log10().ceil() as i32).max(start + 1);
        let line = |m: usize, method: &MethodFigures| {
            let low = f64::from(start);
            let place = |p: [f64; 2]| [if p[0] > 0.0 { p[0].log10().max(low) } else { low }, p[1]];
            Curve {
                method: m,
                joined: true,
                points: hourly(method).into_iter().map(place).collect(),
                bars: vec![],
            }
        };
        let x = Axis::decades("false alarms per hour", decades);
        let svg = plot(&x, &Axis::share("recall"), &lines(figures, line));
        figure(&svg, &format!("Recall against false alarms per hour, IoU {}", IOUS[i]))
    });
    format!(
        "<h2>Recall at few false alarms</h2>\n<p class=\"note\">Recall where there are at most so many false alarms in 1000 frames. \
         In the plots, recall without any false alarm stands at the left edge.</p>\n{}<div class=\"plots\">{}</div>\n",
        table(&heads, 1, figures.methods.iter().map(row)),
        curves.collect::<String>(),
    )
}

fn breakdowns(figures: &ReportFigures) -> String {
    let count = figures.methods.first().map_or(0, |method| method.breakdowns.len());
    let parts: String = (0..count).map(|i| breakdown(figures, i)).collect();
    format!(
        "<h2>By groups of targets</h2>\n<p class=\"note\">Found and false alarms: at the method\u{2019}s score of {} false alarms in \
         1000 frames of the whole split (IoU {}). A false alarm is in the group of its own size or contrast, or of its clip; by class \
         all false alarms count in every row.</p>\n{parts}",
        FALSE_ALARMS[1], IOUS[1],
    )
}

fn breakdown(figures: &ReportFigures, which: usize) -> String {
    let all: Vec<&Breakdown> = figures.methods.iter().map(|m| &m.breakdowns[which]).collect();
    let mut heads = vec!["Group".to_string(), "Method".into(), "Clips".into(), "Targets".into()];
    heads.extend(IOUS.map(|iou| format!("AveP (IoU {iou})")));
    heads.extend(["Found".into(), "False alarms".into()]);
    let groups = &all[0].groups;
    let rows = (0..groups.len()).flat_map(|g| {
        let row = move |(m, breakdown): (usize, &&Breakdown)| {
            let group = &breakdown.groups[g];
            let first = if m == 0 { escape(&group.name) } else { String::new() };
            let mut cells = vec![first, escape(&figures.methods[m].name)];
            cells.extend([group.clips.to_string(), group.targets.to_string()]);
            cells.extend(group.average_precision.iter().map(interval));
            cells.extend([group.found.to_string(), group.false_alarms.to_string()]);
            cells
        };
        all.iter().enumerate().map(row).collect::<Vec<_>>()
    });
    let names: Vec<String> = groups.iter().map(|group| group.name.clone()).collect();
    let plots = (0..IOUS.len()).map(|i| {
        let line = |m: usize, _: &MethodFigures| {
            // Side by side, so that intervals do not hide each other.
            let shift = (m as f64 - (all.len() - 1) as f64 / 2.0) * 0.5 / all.len() as f64;
            let joined = !["kind", "class"].contains(&all[m].by);
            let mut line = Curve { method: m, joined, ..Curve::default() };
            for (g, group) in all[m].groups.iter().enumerate() {
                let Interval { value: Some(value), low, high } = group.average_precision[i] else {
                    continue;
                };
                let x = g as f64 + shift;
                line.points.push([x, value]);
                line.bars.push([x, low.unwrap_or(value), high.unwrap_or(value)]);
            }
            line
        };
        let svg =
            plot(&Axis::groups(all[0].by, &names), &Axis::share("AveP"), &lines(figures, line));
        figure(&svg, &format!("AveP by {}, IoU {}", all[0].by, IOUS[i]))
    });
    format!(
        "<h3>{}</h3>\n<div class=\"plots\">{}</div>\n{}",
        escape(all[0].heading),
        plots.collect::<String>(),
        table(&heads, 2, rows),
    )
}

fn operating_points(figures: &ReportFigures) -> String {
    let heads = [
        "Method",
        "False alarms allowed",
        "Score from",
        "Recall",
        "False alarms",
        "False alarms per hour",
        "Detections on birds",
        "The same per 1000 bird boxes",
        "False alarms without a target",
        "The same per hour",
    ];
    let rows = figures.methods.iter().flat_map(|method| {
        method.operating_points.iter().enumerate().map(move |(i, point)| {
            vec![
                if i == 0 { escape(&method.name) } else { String::new() },
                limit_name(point.limit_per_1000_frames),
                number(point.threshold, 3),
                number(point.recall, 3),
                point.false_alarms.to_string(),
                number(Some(point.false_alarms_per_hour), 0),
                point.bird_detections.to_string(),
                number(point.bird_detections_per_1000_bird_boxes, 1),
                point.false_alarms_without_target.to_string(),
                number(point.false_alarms_without_target_per_hour, 0),
            ]
        })
    });
    format!(
        "<h2>Birds, and flight without a target</h2>\n<p class=\"note\">Matched at IoU {}. On a bird is a detection with half of its area on \
         the bird\u{2019}s box; it is no false alarm, as in the scorer. There are {} boxes on birds, and {} \
         ({} clips) without a target.</p>\n{}",
        IOUS[1],
        figures.flights.bird_boxes,
        length(figures.flights.hours_without_target),
        figures.flights.clips_without_target,
        table(&heads.map(ToString::to_string), 2, rows),
    )
}

fn gallery(figures: &ReportFigures) -> String {
    let name = figures.methods.first().map_or(String::new(), |first| escape(&first.name));
    let strips = |strips: &[Mistake]| {
        let inside: String = strips.iter().map(strip).collect();
        if inside.is_empty() {
            "<p>None.</p>\n".into()
        } else {
            format!("<div class=\"gallery\">{inside}</div>\n")
        }
    };
    format!(
        "<h2>Worst misses of {name}</h2>\n<p class=\"note\">Targets found at no score (IoU {}), size times contrast decides; at most \
         {PER_CLIP} of a clip. The window around the box, twice as large, in the frame (right) and the frames before it; none of them \
         is shifted.</p>\n{}<h2>Surest false alarms of {name}</h2>\n<p class=\"note\">At most {PER_CLIP} of a clip.</p>\n{}",
        IOUS[1],
        strips(&figures.misses),
        strips(&figures.false_alarms),
    )
}

fn strip(strip: &Mistake) -> String {
    let [left, top, width, height] = strip.mark.map(|share| share * 100.0);
    let colour = if strip.score.is_some() { "rgb(235,60,40)" } else { "rgb(60,190,80)" };
    let what = match (strip.score, strip.class) {
        (Some(score), _) => format!("score {score:.3}"),
        (None, class) => class.unwrap_or("target").into(),
    };
    format!(
        "<figure><div class=\"strip\"><img alt=\"\" src=\"data:image/png;base64,{}\"><b style=\"left:{left:.2}%;top:{top:.2}%;\
         width:{width:.2}%;height:{height:.2}%;border-color:{colour}\"></b></div><figcaption>{}, frame {}: {what}, {:.0}\u{d7}{:.0} px, \
         contrast {:.0}</figcaption></figure>\n",
        STANDARD.encode(&strip.png),
        escape(&strip.clip),
        strip.frame,
        strip.r#box[2],
        strip.r#box[3],
        strip.contrast,
    )
}

fn method(figures: &ReportFigures) -> String {
    let bootstrap = &figures.bootstrap;
    format!(
        "<h2>How this was measured</h2>\n<p>The surest detection of a frame chooses first; it finds the free target with the largest \
         intersection over union (IoU), if that reaches the threshold. Birds, targets cut by the frame\u{2019}s edge and targets under 8 px \
         are ignored, and what lies on them with half of its area. The first 3 frames of a clip are left out. AveP is the area under the \
         interpolated precision-recall curve of all clips together.</p>\n<p>Intervals: the middle {:.0} % of {} draws of {} with \
         replacement (seed {}), the same draws for all methods; none where fewer \
         than {FEWEST_CLIPS} clips have such targets. Contrast: mean absolute difference of the box\u{2019}s pixels to the mean of \
         a ring of half the box\u{2019}s longer side around it. Hours of flight: frames by the frame rate in camera.json, else 30 a \
         second.</p>\n<p>Made by lookout {}. The same figures stand in report.json.</p>\n",
        bootstrap.level * 100.0,
        bootstrap.resamples,
        bootstrap.over,
        bootstrap.seed,
        figures.lookout,
    )
}

fn lines(figures: &ReportFigures, line: impl Fn(usize, &MethodFigures) -> Curve) -> Vec<Curve> {
    figures.methods.iter().enumerate().map(|(m, method)| line(m, method)).collect()
}
