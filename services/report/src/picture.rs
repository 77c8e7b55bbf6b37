//! Static pictures for documents: standalone SVG, readable on light and dark pages.

use crate::data::TorqueTrace;
use crate::decimate::{finite_range, line_rows};
use crate::escape::{shortened, text};
use crate::identification::ErrorTable;
use crate::number::significant;
use std::fmt::Write as _;

const LEFT: f64 = 62.0;
const RIGHT: f64 = 16.0;
const TOP: f64 = 74.0;
const BOTTOM: f64 = 44.0;
const GAP: f64 = 14.0;
/// Points per curve of a panel: a panel is about 280 pixels wide.
const POINTS: usize = 420;

const STYLE: &str = "<style>\
text{font-family:system-ui,-apple-system,'Segoe UI',Roboto,Helvetica,Arial,'DejaVu Sans',sans-serif;font-size:12px;fill:#57606a}\
.t{font-size:15px;font-weight:600;fill:#1b1f24}.h{font-size:13px;font-weight:600;fill:#1b1f24}.b{font-weight:600;fill:#1b1f24}.o{paint-order:stroke;stroke:#fff;stroke-width:4px;stroke-linejoin:round}\
.bg{fill:#fff}.grid{stroke:#eaeef2}.zero{stroke:#afb8c1}.frame{stroke:#d8dee4;fill:none}\
.meas{stroke:#8c959f;stroke-width:2.4}.c0{stroke:#c2410c}.c1{stroke:#b07d00}.c2{stroke:#0b5cad}.c3{stroke:#7c3aed}\
.f0{fill:#c2410c}.f1{fill:#b07d00}.f2{fill:#0b5cad}.f3{fill:#7c3aed}\
.meas,.c0,.c1,.c2,.c3{fill:none;stroke-linejoin:round}\
@media (prefers-color-scheme:dark){text{fill:#9aa4af}.t,.h,.b{fill:#e6edf3}.bg{fill:#0f1419}.o{stroke:#0f1419}.grid{stroke:#222a32}.zero{stroke:#4a545f}.frame{stroke:#2b333c}\
.meas{stroke:#7d8894}.c0{stroke:#f2853d}.c1{stroke:#d9b13a}.c2{stroke:#5aa9ff}.c3{stroke:#b794f6}\
.f0{fill:#f2853d}.f1{fill:#d9b13a}.f2{fill:#5aa9ff}.f3{fill:#b794f6}}\
</style>";

/// What [`overlay_svg`] draws.
#[derive(Debug, Clone, Copy)]
pub struct OverlayPicture<'a> {
    /// Title above the picture; may be empty.
    pub title: &'a str,
    /// Unit of the torques.
    pub torque_unit: &'a str,
    /// Measured torque and models: per joint the same models in the same order (at most four are drawn),
    /// e.g. M_KH, M_Id, M_Id+F.
    pub trace: &'a TorqueTrace,
    /// Stretch of time to draw \[s\]; `None` for all of it.
    pub window_s: Option<(f64, f64)>,
}

/// Draws measured and modelled torque as small multiples: a row per joint, a column per model, the
/// standard deviation σ of the error in each panel (over the drawn stretch).
///
/// Standalone SVG of a few hundred kilobytes at most. Curves are thinned out keeping their extremes.
#[must_use]
pub fn overlay_svg(picture: &OverlayPicture<'_>) -> String {
    let joints = &picture.trace.joints;
    let columns = joints.iter().map(|j| j.models.len()).max().unwrap_or(0).min(4);
    if columns == 0 {
        return empty_svg("no torque to show");
    }
    let inside: Vec<usize> = rows_inside(&picture.trace.t_s, picture.window_s);
    let time: Vec<f64> = pick(&picture.trace.t_s, &inside);
    let Some(x_range) = finite_range(&time).filter(|(a, b)| b > a) else { return empty_svg("no time to show") };
    let (panel_w, panel_h) = ((940.0 - LEFT - RIGHT - GAP * (columns - 1) as f64) / columns as f64, 132.0);
    let width = 940.0;
    let height = TOP + joints.len() as f64 * (panel_h + GAP) - GAP + BOTTOM;
    let mut out = open_svg(width, height, picture.title);
    for (r, joint) in joints.iter().enumerate() {
        let top = TOP + r as f64 * (panel_h + GAP);
        let row = Row { top, width: panel_w, height: panel_h, x: x_range, last: r + 1 == joints.len() };
        let measured = pick(&joint.measured, &inside);
        let models: Vec<Vec<f64>> = joint.models.iter().take(columns).map(|m| pick(&m.values, &inside)).collect();
        row.draw(&mut out, (&joint.joint, picture.torque_unit), &time, &measured, &models);
    }
    headings(&mut out, picture, columns, panel_w);
    let _ = writeln!(
        out,
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">Time [s]</text></svg>",
        LEFT + (width - LEFT - RIGHT) / 2.0,
        height - 8.0
    );
    out
}

/// One joint of an overlay: its panels beside each other.
struct Row {
    top: f64,
    width: f64,
    height: f64,
    x: (f64, f64),
    last: bool,
}

impl Row {
    fn draw(&self, out: &mut String, names: (&str, &str), time: &[f64], measured: &[f64], models: &[Vec<f64>]) {
        let (joint, unit) = (text(&shortened(names.0, 18)), text(&shortened(names.1, 8)));
        // Head room for the error's label.
        let roomy = |(low, high): (f64, f64)| (low, high + 0.14 * (high - low));
        let all = models.iter().flatten().chain(measured);
        let Some(y) = finite_range(all).map(padded).map(roomy) else { return };
        let _ = write!(
            out,
            "<g transform=\"translate(15 {:.1}) rotate(-90)\"><text text-anchor=\"middle\"><tspan class=\"b\">{joint}</tspan> [{unit}]</text></g>",
            self.top + self.height / 2.0,
        );
        for (c, model) in models.iter().enumerate() {
            let left = LEFT + c as f64 * (self.width + GAP);
            let frame = Frame { left, top: self.top, width: self.width, height: self.height, x: self.x, y };
            frame.axes(out, c == 0, self.last);
            let _ = write!(
                out,
                "<path class=\"meas\" d=\"{}\"/><path class=\"c{c}\" stroke-width=\"1.3\" d=\"{}\"/>\
                 <text class=\"b o\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">σ {} {unit}</text>",
                frame.path(time, measured),
                frame.path(time, model),
                left + self.width - 6.0,
                self.top + 15.0,
                significant(deviation(measured, model), 3),
            );
        }
    }
}

/// Draws mean and standard deviation of each model's error, per joint, as the paper's Fig. 6: a dot at μ,
/// a bar from μ − σ to μ + σ.
#[must_use]
pub fn table_picture(table: &ErrorTable, torque_unit: &str) -> String {
    let ends = table.errors.iter().flatten().flat_map(|(m, s)| [m - s, m + s]).chain([0.0]).collect::<Vec<_>>();
    let (columns, rows) = (table.models.len().min(4), table.joints.len().min(table.errors.len()));
    if columns == 0 || rows == 0 {
        return empty_svg("no errors to show");
    }
    let y = finite_range(&ends).filter(|(a, b)| b > a).map_or((-1.0, 1.0), padded);
    let (width, height) = (640.0, 320.0);
    let mut out = open_svg(width, height, &table.caption);
    let frame = Frame {
        left: LEFT,
        top: TOP,
        width: width - LEFT - RIGHT,
        height: height - TOP - BOTTOM,
        x: (0.0, rows as f64),
        y,
    };
    frame.axes(&mut out, true, false);
    whiskers(&mut out, table, columns, &frame);
    let step = (width - LEFT - RIGHT) / columns as f64;
    for (c, model) in table.models.iter().take(columns).enumerate() {
        let x = LEFT + c as f64 * step;
        let _ = write!(
            out,
            "<circle class=\"f{c}\" cx=\"{:.1}\" cy=\"52\" r=\"4\"/><text x=\"{:.1}\" y=\"56\">{}</text>",
            x + 6.0,
            x + 16.0,
            symbol(model)
        );
    }
    let _ = writeln!(
        out,
        "<g transform=\"translate(15 {:.1}) rotate(-90)\"><text text-anchor=\"middle\">μ ± σ [{}]</text></g></svg>",
        TOP + frame.height / 2.0,
        text(&shortened(torque_unit, 8))
    );
    out
}

fn whiskers(out: &mut String, table: &ErrorTable, columns: usize, frame: &Frame) {
    for (r, (joint, errors)) in table.joints.iter().zip(&table.errors).enumerate() {
        for (c, &(mean, std)) in errors.iter().take(columns).enumerate() {
            if !(mean.is_finite() && std.is_finite()) {
                continue;
            }
            let at = frame.px(r as f64 + (c + 1) as f64 / (columns + 1) as f64);
            let (low, middle, high) = (frame.py(mean - std), frame.py(mean), frame.py(mean + std));
            let _ = write!(
                out,
                "<path class=\"c{c}\" stroke-width=\"2\" d=\"M{at:.1} {low:.1}V{high:.1}M{:.1} {low:.1}h10M{:.1} {high:.1}h10\"/><circle class=\"f{c}\" cx=\"{at:.1}\" cy=\"{middle:.1}\" r=\"4\"/>",
                at - 5.0,
                at - 5.0
            );
        }
        let _ = write!(
            out,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\" class=\"b\">{}</text>",
            frame.px(r as f64 + 0.5),
            frame.top + frame.height + 20.0,
            text(&shortened(joint, 18))
        );
    }
}

fn headings(out: &mut String, picture: &OverlayPicture<'_>, columns: usize, panel_w: f64) {
    let Some(joint) = picture.trace.joints.iter().find(|j| j.models.len() >= columns) else { return };
    for (c, model) in joint.models.iter().take(columns).enumerate() {
        let x = LEFT + c as f64 * (panel_w + GAP);
        let _ = write!(
            out,
            "<path class=\"c{c}\" stroke-width=\"2.4\" d=\"M{x:.1} 58h18\"/><text class=\"h\" x=\"{:.1}\" y=\"62\">{}</text>",
            x + 25.0,
            symbol(&model.name)
        );
    }
    let x = 940.0 - RIGHT;
    let _ = write!(
        out,
        "<path class=\"meas\" d=\"M{:.1} 22h18\"/><text x=\"{x:.1}\" y=\"26\" text-anchor=\"end\">measured</text>",
        x - 82.0
    );
}

/// A model's name with its subscript set low: `M_Id+F`.
fn symbol(name: &str) -> String {
    match name.split_once('_') {
        Some((letter, index)) if letter.chars().count() == 1 && !index.is_empty() => format!(
            "{}<tspan dy=\"3\" font-size=\"10\">{}</tspan>",
            text(letter),
            text(&shortened(index.trim_matches(['{', '}']), 20))
        ),
        _ => text(&shortened(name, 24)),
    }
}

/// A panel and its scales.
struct Frame {
    left: f64,
    top: f64,
    width: f64,
    height: f64,
    x: (f64, f64),
    y: (f64, f64),
}

impl Frame {
    fn px(&self, x: f64) -> f64 {
        self.left + (x - self.x.0) / (self.x.1 - self.x.0) * self.width
    }

    fn py(&self, y: f64) -> f64 {
        self.top + self.height - (y - self.y.0) / (self.y.1 - self.y.0) * self.height
    }

    fn axes(&self, out: &mut String, y_labels: bool, x_labels: bool) {
        let (right, bottom) = (self.left + self.width, self.top + self.height);
        for (value, label) in ticks(self.y, 5) {
            let y = self.py(value);
            let class = if value == 0.0 { "zero" } else { "grid" };
            let _ = write!(out, "<path class=\"{class}\" d=\"M{:.1} {y:.1}H{right:.1}\"/>", self.left);
            if y_labels {
                let x = self.left - 7.0;
                let _ = write!(out, "<text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"end\">{label}</text>", y + 4.0);
            }
        }
        if x_labels {
            for (value, label) in ticks(self.x, 5) {
                let x = self.px(value);
                let _ =
                    write!(out, "<text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{label}</text>", bottom + 17.0);
            }
        }
        let _ = write!(
            out,
            "<rect class=\"frame\" x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\"/>",
            self.left, self.top, self.width, self.height
        );
    }

    /// The curve as path data: extremes kept, gaps left open.
    fn path(&self, x: &[f64], y: &[f64]) -> String {
        let mut out = String::new();
        let mut pen_down = false;
        for row in line_rows(&[y], POINTS) {
            let (Some(&x), Some(&y)) = (x.get(row), y.get(row)) else { continue };
            if !(x.is_finite() && y.is_finite()) {
                pen_down = false;
                continue;
            }
            let _ = write!(out, "{}{:.1} {:.1}", if pen_down { 'L' } else { 'M' }, self.px(x), self.py(y));
            pen_down = true;
        }
        out
    }
}

/// Round tick values within a range, about `count` of them, with labels of equal precision.
fn ticks(range: (f64, f64), count: usize) -> Vec<(f64, String)> {
    let span = range.1 - range.0;
    if !(span.is_finite() && span > 0.0) {
        return Vec::new();
    }
    let raw = span / count.max(1) as f64;
    let power = 10_f64.powf(raw.log10().floor());
    let step = power * [1.0, 2.0, 5.0, 10.0].into_iter().find(|m| m * power >= raw * 0.999).unwrap_or(10.0);
    let decimals = usize::try_from((-step.log10().floor()).clamp(0.0, 9.0) as i64).unwrap_or(0);
    let first = (range.0 / step - 1e-9).ceil();
    (0..=count * 3)
        .map(|k| (first + k as f64) * step)
        .take_while(|v| *v <= range.1 + 1e-9 * span)
        .map(|v| if v.abs() < 1e-9 * step { 0.0 } else { v })
        .map(|v| (v, crate::number::fixed(v, decimals)))
        .collect()
}

fn padded((low, high): (f64, f64)) -> (f64, f64) {
    let margin = if high > low { 0.08 * (high - low) } else { 0.5 * high.abs().max(1.0) };
    (low - margin, high + margin)
}

fn rows_inside(t: &[f64], window: Option<(f64, f64)>) -> Vec<usize> {
    let within = |v: f64| window.is_none_or(|(from, to)| v >= from && v <= to);
    t.iter().enumerate().filter(|(_, v)| within(**v)).map(|(row, _)| row).collect()
}

fn pick(values: &[f64], rows: &[usize]) -> Vec<f64> {
    rows.iter().map(|&r| values.get(r).copied().unwrap_or(f64::NAN)).collect()
}

/// Standard deviation of `a − b` over the samples both have.
fn deviation(a: &[f64], b: &[f64]) -> f64 {
    let errors: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).filter(|e| e.is_finite()).collect();
    let n = errors.len() as f64;
    let mean = errors.iter().sum::<f64>() / n;
    (errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / n).sqrt()
}

fn open_svg(width: f64, height: f64, title: &str) -> String {
    let title = text(&shortened(title, 110));
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" width=\"{width:.0}\" height=\"{height:.0}\" role=\"img\">\
         <title>{title}</title>{STYLE}<rect class=\"bg\" width=\"100%\" height=\"100%\" rx=\"6\"/><text class=\"t\" x=\"16\" y=\"27\">{title}</text>"
    )
}

fn empty_svg(words: &str) -> String {
    format!("{}<text x=\"16\" y=\"52\">{}</text></svg>\n", open_svg(360.0, 80.0, ""), text(words))
}
