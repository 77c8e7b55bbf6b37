//! Results in a form that a terminal, a document and a program can show.

use crate::{Options, Part};
use serde::Serialize;
use std::fmt::Write as _;

/// One part of the proof.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Section {
    /// Short name, as on the command line.
    pub part: String,
    /// Title.
    pub title: String,
    /// The command that makes it.
    pub command: String,
    /// Why there are no results, if there are none.
    pub skipped: Option<String>,
    /// Under which conditions, one sentence each.
    pub conditions: Vec<String>,
    /// The scorecard.
    pub figures: Vec<Figure>,
    /// Further tables.
    pub tables: Vec<Table>,
    /// Every case that was not answered right, one line each.
    pub failures: Vec<String>,
}

/// One line of the scorecard.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figure {
    /// What is measured.
    pub measure: String,
    /// The figure; `None` if there was nothing to measure it on.
    pub value: Option<f64>,
    /// The figure in words, with what it is counted from.
    pub text: String,
    /// What is asked.
    pub aim: String,
    /// Whether it is reached; `None` without an aim or without a figure.
    pub reached: Option<bool>,
}

/// What a figure must be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Aim {
    /// Nothing is asked.
    None,
    /// At least this.
    Least(f64),
    /// At most this.
    Most(f64),
    /// From this to that.
    Within(f64, f64),
}

impl Aim {
    fn judged(self, value: f64) -> Option<bool> {
        match self {
            Self::None => None,
            Self::Least(a) => Some(value >= a),
            Self::Most(a) => Some(value <= a),
            Self::Within(a, b) => Some(value >= a && value <= b),
        }
    }

    fn words(self) -> String {
        match self {
            Self::None => String::new(),
            Self::Least(a) => format!("≥ {a}"),
            Self::Most(a) => format!("≤ {a}"),
            Self::Within(a, b) => format!("{a} to {b}"),
        }
    }
}

impl Figure {
    /// A figure with its words; a value that is not finite counts as not measured.
    pub fn new(measure: &str, value: f64, text: String, aim: Aim) -> Self {
        let value = value.is_finite().then_some(value);
        let text = if value.is_some() { text } else { "nothing to measure it on".to_owned() };
        let reached = value.and_then(|v| aim.judged(v));
        Self { measure: measure.to_owned(), value, text, aim: aim.words(), reached }
    }

    /// A share of counted cases, with its 95 % interval.
    pub fn share(measure: &str, hits: usize, of: usize, aim: Aim) -> Self {
        let share = hits as f64 / of as f64;
        let (low, high) = wilson(hits, of);
        Self::new(measure, share, format!("{share:.3} ({hits} of {of}; 95 % interval {low:.2} to {high:.2})"), aim)
    }
}

/// 95 % interval of a share (Wilson 1927): right also near 0 and 1, and for few cases.
pub fn wilson(hits: usize, of: usize) -> (f64, f64) {
    if of == 0 {
        return (0.0, 1.0);
    }
    let (n, z) = (of as f64, 1.959_964);
    let p = hits as f64 / n;
    let centre = p + z * z / (2.0 * n);
    let half = z * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
    let scale = 1.0 + z * z / n;
    (((centre - half) / scale).max(0.0), ((centre + half) / scale).min(1.0))
}

/// A table; the first column is text.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Table {
    /// Title.
    pub title: String,
    /// Column heads.
    pub head: Vec<String>,
    /// Cells.
    pub rows: Vec<Vec<String>>,
}

impl Table {
    /// A table without rows.
    pub fn new(title: &str, head: &[&str]) -> Self {
        Self { title: title.to_owned(), head: head.iter().map(|h| (*h).to_owned()).collect(), rows: Vec::new() }
    }

    fn markdown(&self) -> String {
        let cell = |c: &String| c.replace('|', "\\|").replace('\n', " ");
        let row = |cells: &[String]| format!("| {} |\n", cells.iter().map(cell).collect::<Vec<_>>().join(" | "));
        let mut out = format!("**{}**\n\n", self.title);
        out += &row(&self.head);
        out += &format!("|{}\n", "---|".repeat(self.head.len()));
        out + &self.rows.iter().map(|r| row(r)).collect::<String>()
    }

    fn text(&self) -> String {
        let width = |k: usize| {
            let cells = self.rows.iter().filter_map(|r| r.get(k)).chain(self.head.get(k));
            cells.map(|c| c.chars().count()).max().unwrap_or(0)
        };
        let line = |cells: &[String]| {
            let padded =
                cells.iter().enumerate().map(|(k, c)| format!("{c}{}", " ".repeat(width(k) - c.chars().count())));
            format!("  {}\n", padded.collect::<Vec<_>>().join("  ").trim_end())
        };
        let rows: String = self.rows.iter().map(|r| line(r)).collect();
        format!("{}\n{}{rows}", self.title, line(&self.head))
    }
}

impl Section {
    /// A section that could not be made, with the reason.
    pub fn skipped(part: Part, title: &str, options: &Options, why: String) -> Self {
        let (title, command) = (title.to_owned(), options.command(part));
        Self { part: part.name().to_owned(), title, command, skipped: Some(why), ..Self::default() }
    }

    fn scorecard(&self) -> Table {
        let mut table = Table::new("Scorecard", &["measure", "found", "aim", ""]);
        for f in &self.figures {
            let verdict = match f.reached {
                None => "",
                Some(true) => "reached",
                Some(false) => "MISSED",
            };
            table.rows.push(vec![f.measure.clone(), f.text.clone(), f.aim.clone(), verdict.to_owned()]);
        }
        table
    }

    fn all_tables(&self) -> Vec<Table> {
        let scorecard = (!self.figures.is_empty()).then(|| self.scorecard());
        scorecard.into_iter().chain(self.tables.iter().cloned()).collect()
    }

    /// For a terminal.
    pub fn text(&self) -> String {
        let mut out = format!("{}\n{}\n", self.title, "=".repeat(self.title.chars().count()));
        if let Some(why) = &self.skipped {
            out += &format!("SKIPPED: {why}\n");
            return out;
        }
        for c in &self.conditions {
            out += &format!("{c}\n");
        }
        for table in self.all_tables() {
            out += &format!("\n{}", table.text());
        }
        out += &format!("\n{}\n", failures_head(self.failures.len()));
        for f in &self.failures {
            out += &format!("  {f}\n");
        }
        out
    }

    /// For a document.
    pub fn markdown(&self) -> String {
        let mut out = format!("## {}\n\n`{}`\n\n", self.title, self.command);
        if let Some(why) = &self.skipped {
            out += &format!("SKIPPED: {why}\n");
            return out;
        }
        for c in &self.conditions {
            out += &format!("- {c}\n");
        }
        for table in self.all_tables() {
            out += &format!("\n{}", table.markdown());
        }
        // Writing to a String cannot fail.
        let _ = write!(out, "\n**{}**\n\n", failures_head(self.failures.len()));
        for f in &self.failures {
            let _ = writeln!(out, "- {}", f.replace('|', "\\|"));
        }
        out
    }
}

fn failures_head(n: usize) -> String {
    if n == 0 { "No failures.".to_owned() } else { format!("Every failure ({n}):") }
}

/// A number with `digits` significant digits, without an exponent where it can be read without.
pub fn short(v: f64, digits: usize) -> String {
    if !v.is_finite() {
        return "-".to_owned();
    }
    if v == 0.0 {
        return "0".to_owned();
    }
    let size = v.abs().log10().floor() as i32;
    if !(-5..7).contains(&size) {
        return format!("{v:.*e}", digits.saturating_sub(1));
    }
    let decimals = (digits as i32 - 1 - size).max(0) as usize;
    format!("{v:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wilson_agrees_with_published_values() {
        // Newcombe 1998, table I: 81 of 263, and 0 of 20.
        let (low, high) = wilson(81, 263);
        assert!((low - 0.2553).abs() < 1e-4 && (high - 0.3662).abs() < 1e-4, "{low} {high}");
        let (low, high) = wilson(0, 20);
        assert!(low == 0.0 && (high - 0.1611).abs() < 1e-4, "{low} {high}");
        assert_eq!(wilson(0, 0), (0.0, 1.0));
    }

    #[test]
    fn a_figure_is_held_against_its_aim() {
        let f = Figure::share("top-1", 19, 20, Aim::Least(0.95));
        assert_eq!((f.value, f.reached), (Some(0.95), Some(true)));
        assert!(f.text.contains("19 of 20"), "{}", f.text);
        assert_eq!(Figure::share("top-1", 18, 20, Aim::Least(0.95)).reached, Some(false));
        assert_eq!(Figure::new("cover", 0.93, String::new(), Aim::Within(0.92, 0.97)).reached, Some(true));
        let none = Figure::share("top-1", 0, 0, Aim::Least(0.95));
        assert_eq!((none.value, none.reached), (None, None));
    }

    #[test]
    fn both_forms_hold_every_cell_and_every_failure() {
        let mut table = Table::new("By effect", &["effect", "named"]);
        table.rows.push(vec!["a|b".to_owned(), "3 of 4".to_owned()]);
        let section = Section {
            title: "Part".to_owned(),
            command: "lacuna prove part".to_owned(),
            conditions: vec!["On two cores.".to_owned()],
            figures: vec![Figure::share("recall", 1, 2, Aim::Least(0.9))],
            tables: vec![table],
            failures: vec!["case_7: missed".to_owned()],
            ..Section::default()
        };
        let (text, markdown) = (section.text(), section.markdown());
        for part in ["On two cores.", "recall", "1 of 2", "MISSED", "3 of 4", "case_7: missed", "Every failure (1)"] {
            assert!(text.contains(part) && markdown.contains(part), "{part}");
        }
        assert!(markdown.contains("| a\\|b | 3 of 4 |") && markdown.contains("`lacuna prove part`"));
        let skipped = Section { skipped: Some("no recordings".to_owned()), ..Section::default() };
        assert!(skipped.text().contains("SKIPPED: no recordings") && skipped.markdown().contains("SKIPPED"));
    }

    #[test]
    fn numbers_are_short() {
        for (v, words) in [(0.123_45, "0.123"), (12.345, "12.3"), (0.0, "0"), (1.5e-9, "1.50e-9"), (-2.5, "-2.50")] {
            assert_eq!(short(v, 3), words);
        }
        assert_eq!(short(f64::NAN, 3), "-");
    }
}
