//! Parts that the sections of the page are made of: tables, figures, numbers.

use crate::shell::evaluate::bootstrap::Interval;
use std::format;
use std::string::String;
use std::vec::Vec;

/// A length of time in a unit that suits it.
pub fn length(hours: f64) -> String {
    if hours >= 1.0 {
        format!("{hours:.2} hours")
    } else if hours * 60.0 >= 1.0 {
        format!("{:.1} minutes", hours * 60.0)
    } else {
        format!("{:.1} seconds", hours * 3600.0)
    }
}

/// A plot with a line below it.
pub fn figure(svg: &str, caption: &str) -> String {
    format!("<figure>{svg}<figcaption>{caption}</figcaption></figure>")
}

/// A table whose first `left` columns are words; the cells are HTML.
pub fn table(heads: &[String], left: usize, rows: impl Iterator<Item = Vec<String>>) -> String {
    let cells = |cells: &[String], tag: &str| {
        let cell = |(i, cell): (usize, &String)| {
            let class = if i < left { " class=\"left\"" } else { "" };
            // On a phone a row is a card, and each cell stands behind its heading.
            let head = heads.get(i).filter(|_| tag == "td");
            let head = head.map_or(String::new(), |head| format!(" data-head=\"{head}\""));
            format!("<{tag}{class}{head}>{cell}</{tag}>")
        };
        format!("<tr>{}</tr>\n", cells.iter().enumerate().map(cell).collect::<String>())
    };
    let body: String = rows.map(|row| cells(&row, "td")).collect();
    let heads = cells(heads, "th");
    format!(
        "<div class=\"scroll\"><table><thead>{heads}</thead><tbody>{body}</tbody></table></div>\n"
    )
}

/// A figure with its confidence interval in small letters.
pub fn interval(interval: &Interval) -> String {
    let value = number(interval.value, 3);
    match (interval.low, interval.high) {
        (Some(low), Some(high)) => format!("{value} <small>{low:.3} to {high:.3}</small>"),
        _ => value,
    }
}

/// A number, or a dash.
pub fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or("\u{2013}".into(), |value| format!("{value:.digits$}"))
}

/// `text` with the characters escaped that HTML gives a meaning.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
