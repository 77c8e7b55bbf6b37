//! What a report is made of: plain data, no markup. Every string is taken as text and escaped on output.

use crate::chart::Chart;
use crate::number;
use serde::{Deserialize, Serialize};

/// How a statement is to be taken. Shown as a word and a colour, never as a colour alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Tone {
    /// For information.
    #[default]
    Neutral,
    /// As it should be.
    Good,
    /// Look before relying on it.
    Caution,
    /// Something is missing or wrong.
    Problem,
}

impl Tone {
    pub(crate) fn class(self) -> &'static str {
        match self {
            Self::Neutral => "neutral",
            Self::Good => "good",
            Self::Caution => "caution",
            Self::Problem => "problem",
        }
    }
}

/// A whole report. [`Report::to_html`] writes it as one self-contained file.
#[derive(Debug, Clone, Default)]
pub struct Report {
    /// What was done to what: "Identification of delta_d3".
    pub title: String,
    /// The line above the verdict: "Verdict", "No mismatch found".
    pub verdict_label: String,
    /// One or two sentences a controls engineer would say.
    pub verdict: String,
    /// How the verdict is to be taken.
    pub tone: Tone,
    /// The few figures that matter, shown large below the verdict.
    pub figures: Vec<Figure>,
    /// Label and value of what the report is about: robot, recordings, band.
    pub facts: Vec<(String, String)>,
    /// The sections in reading order; they make the table of contents.
    pub sections: Vec<Section>,
}

/// One figure shown large: "Torque error, held out | 6.2 % | was 18.4 % with the nominal model".
#[derive(Debug, Clone, Default)]
pub struct Figure {
    /// What it is.
    pub label: String,
    /// The figure, formatted, with unit.
    pub value: String,
    /// What to compare it with; may be empty.
    pub note: String,
}

/// A section with a heading.
#[derive(Debug, Clone, Default)]
pub struct Section {
    /// Heading.
    pub title: String,
    /// Contents in reading order.
    pub blocks: Vec<Block>,
}

impl Section {
    /// A section of the given blocks.
    #[must_use]
    pub fn new(title: &str, blocks: Vec<Block>) -> Self {
        Self { title: title.to_owned(), blocks }
    }
}

/// A piece of a section.
#[derive(Debug, Clone)]
pub enum Block {
    /// Running text.
    Paragraph(String),
    /// Set off from the text: a warning, a remark.
    Notice {
        /// How to take it.
        tone: Tone,
        /// The remark, in words.
        text: String,
    },
    /// An unordered list.
    List(Vec<String>),
    /// A formula in plain notation; `_x` and `^x` become sub- and superscripts.
    Equation(String),
    /// A table.
    Table(Table),
    /// A chart that zooms.
    Chart(Chart),
    /// Charts side by side where the page is wide enough.
    Charts(Vec<Chart>),
    /// Horizontal bars.
    Bars(Bars),
    /// A map over two variables.
    HeatMap(HeatMap),
    /// Blocks that open on demand.
    Details {
        /// The line that is always visible.
        summary: String,
        /// Open from the start.
        open: bool,
        /// What unfolds.
        blocks: Vec<Block>,
    },
    /// A framed group with a heading and a short remark at its right: one finding.
    Card {
        /// Heading.
        title: String,
        /// Remark beside the heading ("probability 0.97"); may be empty.
        tag: String,
        /// Contents.
        blocks: Vec<Block>,
    },
}

impl Block {
    /// Running text.
    #[must_use]
    pub fn text(text: impl Into<String>) -> Self {
        Self::Paragraph(text.into())
    }

    /// A notice that asks for attention.
    #[must_use]
    pub fn caution(text: impl Into<String>) -> Self {
        Self::Notice { tone: Tone::Caution, text: text.into() }
    }
}

/// A table. At most [`Table::ROWS`] rows are shown; the rest is counted.
#[derive(Debug, Clone, Default)]
pub struct Table {
    /// What the table shows.
    pub caption: String,
    /// Column headings. Write the unit in brackets: "RMS \[Nm\]".
    pub columns: Vec<String>,
    /// Rows; missing cells stay empty, cells beyond the last column are dropped.
    pub rows: Vec<Vec<Cell>>,
    /// A remark below the table; may be empty.
    pub note: String,
}

impl Table {
    /// Most rows shown: more is a data file, not a table.
    pub const ROWS: usize = 400;

    /// An empty table with caption and column headings.
    #[must_use]
    pub fn new(caption: &str, columns: &[&str]) -> Self {
        let columns = columns.iter().map(|&c| c.to_owned()).collect();
        Self { caption: caption.to_owned(), columns, ..Self::default() }
    }

    /// Adds a row.
    pub fn push(&mut self, row: Vec<Cell>) {
        self.rows.push(row);
    }

    /// The same table with a remark below.
    #[must_use]
    pub fn with_note(mut self, note: &str) -> Self {
        note.clone_into(&mut self.note);
        self
    }
}

/// A cell. Numbers align right, text left.
#[derive(Debug, Clone, PartialEq)]
pub enum Cell {
    /// Text.
    Text(String),
    /// A name that heads its row.
    Head(String),
    /// A symbol or formula: `f_v`.
    Math(String),
    /// A number; the numbers of a column are written with the same number of decimals.
    Value(f64),
    /// A number that stands out: the result. Written as [`Cell::Value`].
    StrongValue(f64),
    /// A number, already formatted.
    Number(String),
    /// A number, already formatted, that stands out.
    Strong(String),
    /// Text that asks for attention.
    Flag(Tone, String),
    /// Nothing to show.
    Empty,
}

impl Cell {
    /// A text cell.
    #[must_use]
    pub fn text(text: impl Into<String>) -> Self {
        Self::Text(text.into())
    }

    /// A number; its column decides the decimals.
    #[must_use]
    pub fn number(value: f64) -> Self {
        Self::Value(value)
    }

    /// A number that stands out; its column decides the decimals.
    #[must_use]
    pub fn strong(value: f64) -> Self {
        Self::StrongValue(value)
    }

    /// A number, or a dash.
    #[must_use]
    pub fn optional(value: Option<f64>) -> Self {
        Self::number(value.unwrap_or(f64::NAN))
    }

    /// A share as per cent.
    #[must_use]
    pub fn percent(share: f64) -> Self {
        Self::Number(number::percent(share))
    }
}

/// Horizontal bars from zero to the longest, each with its figure in words and numbers beside it.
#[derive(Debug, Clone, Default)]
pub struct Bars {
    /// What the bars show.
    pub caption: String,
    /// The bars, in order.
    pub bars: Vec<Bar>,
    /// The value that fills the whole width; the largest bar where not given.
    pub full_scale: Option<f64>,
}

/// One bar.
#[derive(Debug, Clone, Default)]
pub struct Bar {
    /// What it is.
    pub label: String,
    /// Its length; negative and not finite lengths show as zero.
    pub value: f64,
    /// Interval, drawn as a whisker.
    pub interval: Option<(f64, f64)>,
    /// The figure as text, with unit.
    pub text: String,
    /// Colour, the same as of the curves of that role.
    pub role: crate::chart::Role,
}

/// A map of a value over two variables: where the unexplained residual sits.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct HeatMap {
    /// What the map shows.
    pub caption: String,
    /// Horizontal variable with unit: "Angle \[rad\]".
    pub x_label: String,
    /// Vertical variable with unit.
    pub y_label: String,
    /// The mapped value with unit: "Mean residual \[Nm\]".
    pub value_label: String,
    /// First and last edge of the horizontal bins.
    pub x_range: (f64, f64),
    /// First and last edge of the vertical bins.
    pub y_range: (f64, f64),
    /// One row of cells per vertical bin, from the lowest up; NaN where there is no data.
    pub rows: Vec<Vec<f64>>,
}
