//! Plots as SVG.

use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::prelude::*;
use std::boxed::Box;
use std::error::Error;
use std::format;
use std::ops::Range;
use std::string::{String, ToString};
use std::vec::Vec;

/// Pixels of a plot.
const SIZE: (u32, u32) = (560, 400);

/// Colours that stand out on light and dark; the first is the detector's own.
pub const COLOURS: [(u8, u8, u8); 9] = [
    (224, 72, 16),
    (40, 125, 205),
    (45, 160, 80),
    (150, 90, 200),
    (200, 150, 20),
    (20, 150, 160),
    (205, 70, 130),
    (130, 135, 145),
    (120, 145, 30),
];

/// The colour of a method.
pub fn colour(method: usize) -> (u8, u8, u8) {
    COLOURS[method % COLOURS.len()]
}

/// Label and range of an axis.
#[derive(Debug, Clone)]
pub struct Axis {
    /// Label with the unit.
    pub label: &'static str,
    /// Values at its ends.
    pub range: Range<f64>,
    /// Where there are marks, and what they are called.
    pub ticks: Vec<(f64, String)>,
}

impl Axis {
    /// An axis from 0 to 1.
    pub fn share(label: &'static str) -> Self {
        let ticks = (0..=5).map(|i| f64::from(i) / 5.0).map(|v| (v, format!("{v:.1}"))).collect();
        Self { label, range: 0.0..1.0, ticks }
    }

    /// Powers of ten, of which it takes the logarithms.
    pub fn decades(label: &'static str, decades: Range<i32>) -> Self {
        let name = |d: i32| if d < 0 { format!("1e{d}") } else { 10i64.pow(d as u32).to_string() };
        let ticks = (decades.start..=decades.end).map(|d| (f64::from(d), name(d))).collect();
        Self { label, range: f64::from(decades.start)..f64::from(decades.end), ticks }
    }

    /// Groups side by side, at 0, 1, ..
    pub fn groups(label: &'static str, names: &[String]) -> Self {
        let ticks = names.iter().enumerate().map(|(i, name)| (i as f64, name.clone())).collect();
        Self { label, range: -0.5..names.len() as f64 - 0.5, ticks }
    }
}

impl Ranged for Axis {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let share = (value - self.range.start) / (self.range.end - self.range.start);
        limit.0 + (share * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        self.ticks.iter().map(|tick| tick.0).collect()
    }

    fn range(&self) -> Range<f64> {
        self.range.clone()
    }
}

impl ValueFormatter<f64> for Axis {
    fn format_ext(&self, value: &f64) -> String {
        let tick = self.ticks.iter().find(|tick| tick.0 == *value);
        tick.map_or(String::new(), |tick| tick.1.clone())
    }
}

/// Curve and style of a method.
#[derive(Debug, Clone, Default)]
pub struct Curve {
    /// Its number, for the colour.
    pub method: usize,
    /// Points (x, y) in the units of the axes.
    pub points: Vec<[f64; 2]>,
    /// Whether lines join them: not where they have no order.
    pub joined: bool,
    /// Intervals: x, low, high; each has a dot at the point of its number.
    pub bars: Vec<[f64; 3]>,
}

/// Draws lines into an SVG without fonts or addresses; colours of text and axes are the page's.
#[allow(clippy::expect_used, reason = "a plot in memory meets no fault")]
pub fn plot(x: &Axis, y: &Axis, lines: &[Curve]) -> String {
    let mut svg = String::new();
    draw(&mut svg, x, y, lines).expect("a plot in memory meets no fault");
    // Inside a page the name space is known; the page styles what is black.
    svg.replace(" xmlns=\"http://www.w3.org/2000/svg\"", "")
        .replace("\"#000000\"", "\"currentColor\"")
}

fn draw(svg: &mut String, x: &Axis, y: &Axis, lines: &[Curve]) -> Result<(), Box<dyn Error>> {
    let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    let mut chart = ChartBuilder::on(&root)
        .margin(12)
        .margin_right(28)
        .x_label_area_size(44)
        .y_label_area_size(52)
        .build_cartesian_2d(x.clone(), y.clone())?;
    chart
        .configure_mesh()
        .x_desc(x.label)
        .y_desc(y.label)
        .label_style(("sans-serif", 13))
        .axis_desc_style(("sans-serif", 14))
        .bold_line_style(RGBColor(128, 128, 128).mix(0.3))
        .light_line_style(TRANSPARENT)
        .axis_style(RGBColor(128, 128, 128))
        .draw()?;
    // The first method lies on top.
    for line in lines.iter().rev() {
        let (red, green, blue) = colour(line.method);
        let colour = RGBColor(red, green, blue);
        let style = colour.stroke_width(if line.method == 0 { 3 } else { 2 });
        let points = line.points.iter().map(|p| (p[0], p[1])).collect::<Vec<_>>();
        for (bar, point) in line.bars.iter().zip(&points) {
            let ends = [(bar[0], bar[1]), (bar[0], bar[2])];
            chart.draw_series([PathElement::new(ends, style)])?;
            chart.draw_series([Circle::new(*point, 4, colour.filled())])?;
        }
        if line.joined && points.len() > 1 {
            chart.draw_series([PathElement::new(points, style)])?;
        }
    }
    root.present()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;

    #[test]
    fn a_plot_needs_nothing_from_outside() {
        let line = Curve {
            method: 0,
            joined: true,
            points: vec![[0.0, 0.5], [1.0, 0.25]],
            bars: vec![[0.0, 0.4, 0.6], [1.0, 0.2, 0.3]],
        };
        let names = ["a<b".to_string(), "c & d".to_string()];
        let svg = plot(&Axis::groups("groups", &names), &Axis::share("share"), &[line]);
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"), "{svg}");
        assert!(!svg.contains("http") && !svg.contains("#000000"), "{svg}");
        assert!(svg.contains("a&lt;b") && svg.contains("c &amp; d"), "{svg}");
        assert_eq!(svg.matches("<circle").count(), 2);
        assert_eq!(svg.matches("stroke=\"#E04810\"").count(), 3, "two intervals and a line: {svg}");
    }

    #[test]
    fn decades_are_named() {
        let axis = Axis::decades("alarms", -1..2);
        let names: Vec<&str> = axis.ticks.iter().map(|t| t.1.as_str()).collect();
        assert_eq!(names, ["1e-1", "1", "10", "100"]);
    }
}
