//! Tables as text for a terminal.

use std::borrow::ToOwned;
use std::string::String;
use std::vec;
use std::vec::Vec;

/// A table: the first column is words, the others are numbers and stand to the right.
#[derive(Debug, Clone, Default)]
pub struct Table {
    rows: Vec<Vec<String>>,
}

impl Table {
    /// With a first row of headings.
    pub fn new(heads: &[&str]) -> Self {
        let mut table = Self::default();
        table.row(heads);
        table
    }

    /// Appends a row; the first cell is its heading.
    pub fn row<T: AsRef<str>>(&mut self, cells: &[T]) {
        self.rows.push(cells.iter().map(|cell| cell.as_ref().to_owned()).collect());
    }

    /// Whether there is nothing but headings.
    pub fn is_empty(&self) -> bool {
        self.rows.len() < 2
    }

    /// The text, a line a row, without a line break at the end.
    pub fn text(&self) -> String {
        let columns = self.rows.iter().map(Vec::len).max().unwrap_or(0);
        let mut widths = vec![0; columns];
        for row in &self.rows {
            for (width, cell) in widths.iter_mut().zip(row) {
                *width = (*width).max(cell.chars().count());
            }
        }
        let line = |row: &Vec<String>| {
            let mut line = String::new();
            for (column, (cell, width)) in row.iter().zip(&widths).enumerate() {
                let space: String =
                    core::iter::repeat_n(' ', width - cell.chars().count()).collect();
                if column == 0 {
                    line += &(cell.clone() + &space);
                } else {
                    line += &("  ".to_owned() + &space + cell);
                }
            }
            line.trim_end().to_owned()
        };
        self.rows.iter().map(line).collect::<Vec<_>>().join("\n")
    }
}

/// A number with this many decimals, or a dash.
pub fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or("-".into(), |value| std::format!("{value:.digits$}"))
}

/// A number and its interval: `0.81 (0.75 to 0.86)`.
pub fn with_interval(
    value: Option<f64>,
    low: Option<f64>,
    high: Option<f64>,
    digits: usize,
) -> String {
    match (value, low, high) {
        (Some(_), Some(low), Some(high)) => {
            std::format!("{} ({low:.digits$} to {high:.digits$})", number(value, digits))
        }
        _ => number(value, digits),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_stand_left_and_numbers_right() {
        let mut table = Table::new(&["what", "a", "bb"]);
        assert!(table.is_empty());
        table.row(&["longer words", "1.25", "-"]);
        assert_eq!(table.text(), "what             a  bb\nlonger words  1.25   -");
        assert_eq!(with_interval(Some(0.5), Some(0.25), Some(0.75), 2), "0.50 (0.25 to 0.75)");
        assert_eq!(with_interval(Some(0.5), None, None, 1), "0.5");
        assert_eq!(number(None, 3), "-");
    }
}
