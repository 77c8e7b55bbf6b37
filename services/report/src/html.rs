//! Writing a [`Report`] as one HTML file: everything inlined, nothing fetched, every string escaped.
//!
//! The file's content security policy forbids every request and every script but the two inlined ones,
//! which it names by hash: even a hole in the escaping would not run.

use crate::blocks::{Bars, Block, Cell, Figure, Report, Section, Table};
use crate::chart::{Chart, MAX_ROWS};
use crate::escape::{json, math, shortened, text};
use crate::heat::heat_map;
use crate::number::{common_decimals, fixed, significant};
use base64::Engine as _;
use sha2::{Digest as _, Sha256};
use std::fmt::Write as _;

const UPLOT_JS: &str = include_str!("../assets/uplot.min.js");
const UPLOT_CSS: &str = include_str!("../assets/uplot.min.css");
const REPORT_JS: &str = include_str!("../assets/report.js");
const REPORT_CSS: &str = include_str!("../assets/report.css");

/// Largest file written, in bytes: it has to pass through e-mail and open at once.
pub const MAX_BYTES: usize = 5_000_000;
/// Rows per chart and blocks per section, tried in turn until the file is small enough. No rows: charts are
/// left out; no blocks: the verdict is all that is left.
const LIMITS: [(usize, usize); 9] = [
    (MAX_ROWS + 2, usize::MAX),
    (4000, usize::MAX),
    (2000, usize::MAX),
    (1000, usize::MAX),
    (400, usize::MAX),
    (150, usize::MAX),
    (0, usize::MAX),
    (0, 40),
    (0, 0),
];
/// Characters shown of any one name or cell.
const LONGEST_CELL: usize = 300;
/// Characters shown of any one paragraph.
const LONGEST_TEXT: usize = 4000;
/// Items shown of any one list.
const LONGEST_LIST: usize = 200;

impl Report {
    /// Writes the report as one HTML document of less than [`MAX_BYTES`].
    ///
    /// The same report gives the same bytes. Charts are thinned out evenly where the file would become
    /// too large, keeping the extremes; a report that is too large even so loses its charts, then the ends of
    /// its sections, and says so.
    #[must_use]
    pub fn to_html(&self) -> String {
        let mut page = String::new();
        for (rows, blocks) in LIMITS {
            page = Writer::new(rows, blocks).document(self);
            if page.len() < MAX_BYTES {
                break;
            }
        }
        page
    }
}

/// Collects the charts' data while the markup is written.
struct Writer {
    row_limit: usize,
    block_limit: usize,
    specs: Vec<String>,
    tables: usize,
}

impl Writer {
    fn new(row_limit: usize, block_limit: usize) -> Self {
        Self { row_limit, block_limit, specs: Vec::new(), tables: 0 }
    }

    fn document(mut self, report: &Report) -> String {
        let mut body = self.header(report);
        for (index, section) in report.sections.iter().take(LONGEST_LIST).enumerate() {
            self.section(&mut body, index, section);
        }
        let data = json(&format!("[{}]", self.specs.join(",")));
        let policy = format!(
            "default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{}' 'sha256-{}'; base-uri 'none'; form-action 'none'",
            digest(UPLOT_JS),
            digest(REPORT_JS)
        );
        format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta http-equiv=\"Content-Security-Policy\" content=\"{policy}\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <meta name=\"color-scheme\" content=\"light dark\">\n\
             <meta name=\"generator\" content=\"lacuna {version}\">\n<title>{title}</title>\n\
             <style>{UPLOT_CSS}</style>\n<style>{REPORT_CSS}</style>\n</head>\n<body>\n\
             <a class=\"skip\" href=\"#main\">Skip to the report</a>\n<div class=\"page\">\n{nav}\
             <main id=\"main\">\n{body}</main>\n{footer}</div>\n\
             <script type=\"application/json\" id=\"chart-data\">{data}</script>\n\
             <script>{UPLOT_JS}</script>\n<script>{REPORT_JS}</script>\n</body>\n</html>\n",
            version = env!("CARGO_PKG_VERSION"),
            title = name(&report.title),
            nav = contents(&report.sections),
            footer = footer(),
        )
    }

    fn header(&self, report: &Report) -> String {
        let mut out = format!("<header>\n<h1>{}</h1>\n", name(&report.title));
        let label = if report.verdict_label.is_empty() { "Verdict" } else { &report.verdict_label };
        let _ = writeln!(
            out,
            "<div class=\"verdict {}\"><p class=\"label\">{}</p><p class=\"words\">{}</p></div>",
            report.tone.class(),
            name(label),
            prose(&report.verdict)
        );
        if !report.figures.is_empty() {
            out.push_str("<dl class=\"figures\">\n");
            for Figure { label, value, note } in report.figures.iter().take(LONGEST_LIST) {
                let _ = writeln!(
                    out,
                    "<div><dt>{}</dt><dd>{}<small>{}</small></dd></div>",
                    name(label),
                    name(value),
                    name(note)
                );
            }
            out.push_str("</dl>\n");
        }
        if !report.facts.is_empty() {
            out.push_str("<dl class=\"facts\">\n");
            for (label, value) in report.facts.iter().take(LONGEST_LIST) {
                let _ = writeln!(out, "<dt>{}</dt><dd>{}</dd>", name(label), prose(value));
            }
            out.push_str("</dl>\n");
        }
        out.push_str("<noscript><p class=\"note\">The charts need JavaScript (inlined in this file, nothing is fetched). All figures are in the tables.</p></noscript>\n</header>\n");
        out
    }

    fn section(&mut self, out: &mut String, index: usize, section: &Section) {
        let _ = writeln!(
            out,
            "<section id=\"s{n}\" aria-labelledby=\"h{n}\">\n<h2 id=\"h{n}\">{}</h2>",
            name(&section.title),
            n = index + 1
        );
        let shown = section.blocks.len().min(self.block_limit);
        self.blocks(out, section.blocks.get(..shown).unwrap_or_default());
        if shown < section.blocks.len() {
            let more = section.blocks.len() - shown;
            let _ = writeln!(out, "<p class=\"note\">{more} more parts left out to keep this file under 5 MB.</p>");
        }
        out.push_str("</section>\n");
    }

    fn blocks(&mut self, out: &mut String, blocks: &[Block]) {
        for block in blocks {
            self.block(out, block);
        }
    }

    fn block(&mut self, out: &mut String, block: &Block) {
        match block {
            Block::Paragraph(words) => {
                let _ = writeln!(out, "<p>{}</p>", prose(words));
            }
            Block::Notice { tone, text } => {
                let word = match tone {
                    crate::Tone::Neutral => "Note",
                    crate::Tone::Good => "Good",
                    crate::Tone::Caution => "Caution",
                    crate::Tone::Problem => "Problem",
                };
                let _ = writeln!(
                    out,
                    "<p class=\"notice {}\" role=\"note\"><b>{word}.</b> {}</p>",
                    tone.class(),
                    prose(text)
                );
            }
            Block::List(items) => list(out, items),
            Block::Equation(formula) => {
                let _ = writeln!(out, "<div class=\"eq\">{}</div>", math(&shortened(formula, LONGEST_TEXT)));
            }
            Block::Table(table) => self.table(out, table),
            Block::Chart(chart) => self.chart(out, chart),
            Block::Charts(charts) => {
                out.push_str("<div class=\"charts\">\n");
                for chart in charts {
                    self.chart(out, chart);
                }
                out.push_str("</div>\n");
            }
            Block::Bars(group) => bars(out, group),
            Block::HeatMap(map) => out.push_str(&heat_map(map)),
            Block::Details { summary, open, blocks } => {
                let open = if *open { " open" } else { "" };
                let _ = writeln!(out, "<details{open}><summary>{}</summary>", name(summary));
                self.blocks(out, blocks);
                out.push_str("</details>\n");
            }
            Block::Card { title, tag, blocks } => {
                let _ = writeln!(
                    out,
                    "<article class=\"card\"><header><h3>{}</h3><span>{}</span></header>",
                    name(title),
                    name(tag)
                );
                self.blocks(out, blocks);
                out.push_str("</article>\n");
            }
        }
    }

    fn chart(&mut self, out: &mut String, chart: &Chart) {
        let title = name(&chart.title);
        if chart.is_empty() || self.row_limit == 0 {
            let reason = if chart.is_empty() { "no samples to show" } else { "left out to keep this file under 5 MB" };
            let _ = writeln!(out, "<p class=\"note\">{title}: {reason}.</p>");
            return;
        }
        let spec = serde_json::to_string(&chart.spec(self.row_limit)).unwrap_or_else(|_| "null".to_owned());
        let _ = writeln!(
            out,
            "<figure><figcaption><span>{title}</span><button type=\"button\" hidden>Reset zoom</button></figcaption>\
             <div class=\"plot\" data-chart=\"{index}\" tabindex=\"0\" role=\"group\" style=\"min-height:{height}px\" \
             aria-label=\"{label}. Keys: plus and minus zoom, arrows move, 0 resets.\"></div>{note}</figure>",
            index = self.specs.len(),
            height = u32::from(chart.height()) + 24,
            label = text(&shortened(&chart.description(), LONGEST_CELL)),
            note = note(&chart.note),
        );
        self.specs.push(spec);
    }

    fn table(&mut self, out: &mut String, table: &Table) {
        self.tables += 1;
        let id = self.tables;
        let _ = writeln!(
            out,
            "<div class=\"tablebox\" tabindex=\"0\" role=\"region\" aria-labelledby=\"t{id}\">\n<table>\n<caption id=\"t{id}\">{}</caption>\n<thead><tr>",
            name(&table.caption)
        );
        for (index, column) in table.columns.iter().enumerate() {
            let class = if table.is_numeric(index) { " class=\"n\"" } else { "" };
            let _ = write!(out, "<th scope=\"col\"{class}>{}</th>", math(&shortened(column, LONGEST_CELL)));
        }
        out.push_str("</tr></thead>\n<tbody>\n");
        let decimals: Vec<Option<usize>> = (0..table.columns.len()).map(|c| table.decimals(c)).collect();
        for row in table.rows.iter().take(Table::ROWS) {
            out.push_str("<tr>");
            for (index, decimals) in decimals.iter().enumerate() {
                cell(out, row.get(index).unwrap_or(&Cell::Empty), *decimals);
            }
            out.push_str("</tr>\n");
        }
        out.push_str("</tbody>\n</table>\n");
        if table.rows.len() > Table::ROWS {
            let _ = writeln!(out, "<p class=\"note\">… and {} more rows.</p>", table.rows.len() - Table::ROWS);
        }
        let _ = writeln!(out, "{}</div>", note(&table.note));
    }
}

impl Table {
    fn is_numeric(&self, column: usize) -> bool {
        let mut cells = self.rows.iter().filter_map(|r| r.get(column)).filter(|c| **c != Cell::Empty).peekable();
        cells.peek().is_some()
            && cells.all(|c| matches!(c, Cell::Number(_) | Cell::Strong(_) | Cell::Value(_) | Cell::StrongValue(_)))
    }

    /// Decimals the numbers of a column share; `None` where they are too far apart for one notation.
    fn decimals(&self, column: usize) -> Option<usize> {
        let value = |row: &Vec<Cell>| match row.get(column) {
            Some(Cell::Value(v) | Cell::StrongValue(v)) => Some(*v),
            _ => None,
        };
        common_decimals(self.rows.iter().filter_map(value))
    }
}

fn cell(out: &mut String, cell: &Cell, decimals: Option<usize>) {
    let written = |v: f64| decimals.map_or_else(|| significant(v, 3), |d| fixed(v, d));
    let _ = match cell {
        Cell::Value(value) => write!(out, "<td class=\"n\">{}</td>", written(*value)),
        Cell::StrongValue(value) => write!(out, "<td class=\"n s\">{}</td>", written(*value)),
        Cell::Text(words) => write!(out, "<td>{}</td>", name(words)),
        Cell::Head(words) => write!(out, "<th scope=\"row\">{}</th>", name(words)),
        Cell::Math(formula) => {
            write!(out, "<td><span class=\"math\">{}</span></td>", math(&shortened(formula, LONGEST_CELL)))
        }
        Cell::Number(number) => write!(out, "<td class=\"n\">{}</td>", name(number)),
        Cell::Strong(number) => write!(out, "<td class=\"n s\">{}</td>", name(number)),
        Cell::Flag(tone, words) => write!(out, "<td><span class=\"flag {}\">{}</span></td>", tone.class(), name(words)),
        Cell::Empty => write!(out, "<td></td>"),
    };
}

fn bars(out: &mut String, group: &Bars) {
    let ends = group.bars.iter().flat_map(|b| [b.value, b.interval.map_or(0.0, |i| i.1)]);
    let largest = ends.filter(|v| v.is_finite()).fold(0.0_f64, f64::max);
    let scale = group.full_scale.filter(|s| s.is_finite() && *s > 0.0).unwrap_or(largest);
    let place = |value: f64| {
        let share = if scale > 0.0 && value.is_finite() { (value / scale).clamp(0.0, 1.0) } else { 0.0 };
        100.0 * share
    };
    let _ = writeln!(out, "<figure><figcaption>{}</figcaption><div class=\"bars\">", name(&group.caption));
    for bar in group.bars.iter().take(LONGEST_LIST) {
        let whisker = bar.interval.filter(|(low, high)| low.is_finite() && high.is_finite()).map_or_else(
            String::new,
            |(low, high)| {
                let (from, to) = (place(low), place(high));
                format!("<i class=\"whisker\" style=\"left:{from:.2}%;width:{:.2}%\"></i>", (to - from).max(0.0))
            },
        );
        let _ = writeln!(
            out,
            "<span class=\"label\">{}</span><span class=\"track\"><i class=\"fill\" style=\"width:{:.2}%;--c:var(--{})\"></i>{whisker}</span><span>{}</span>",
            name(&bar.label),
            place(bar.value),
            bar.role.name(),
            name(&bar.text)
        );
    }
    out.push_str("</div></figure>\n");
}

fn list(out: &mut String, items: &[String]) {
    out.push_str("<ul>\n");
    for item in items.iter().take(LONGEST_LIST) {
        let _ = writeln!(out, "<li>{}</li>", prose(item));
    }
    if items.len() > LONGEST_LIST {
        let _ = writeln!(out, "<li>… and {} more.</li>", items.len() - LONGEST_LIST);
    }
    out.push_str("</ul>\n");
}

fn contents(sections: &[Section]) -> String {
    let mut out = String::from("<nav aria-label=\"Contents\"><ol>\n<li><a href=\"#main\">Verdict</a></li>\n");
    for (index, section) in sections.iter().take(LONGEST_LIST).enumerate() {
        let _ = writeln!(out, "<li><a href=\"#s{}\">{}</a></li>", index + 1, name(&section.title));
    }
    out.push_str("</ol></nav>\n");
    out
}

fn footer() -> String {
    format!(
        "<footer><p>Written by lacuna {}. Drag across a chart to zoom, double-click or press 0 to reset, click a name in the legend to hide its curve. This file is complete: it loads nothing. Charts drawn by uPlot 1.6.32, © 2022 Leon Sorokin, MIT licence.</p></footer>\n",
        env!("CARGO_PKG_VERSION")
    )
}

fn note(words: &str) -> String {
    if words.is_empty() { String::new() } else { format!("<p class=\"note\">{}</p>", prose(words)) }
}

fn name(raw: &str) -> String {
    text(&shortened(raw, LONGEST_CELL))
}

fn prose(raw: &str) -> String {
    text(&shortened(raw, LONGEST_TEXT))
}

/// A script's hash as the content security policy wants it.
fn digest(script: &str) -> String {
    base64::engine::general_purpose::STANDARD.encode(Sha256::digest(script.as_bytes()))
}
