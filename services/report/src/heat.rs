//! A map over two variables as inline SVG: sign by colour, size by strength, the figure on pointing.

use crate::blocks::HeatMap;
use crate::decimate::finite_range;
use crate::escape::{shortened, text};
use crate::number::{compact, significant};
use std::fmt::Write as _;

/// Most cells along one side: more cannot be told apart on a screen.
const MOST: usize = 60;
const LEFT: f64 = 64.0;
const TOP: f64 = 8.0;
const WIDTH: f64 = 600.0;
const HEIGHT: f64 = 260.0;

/// The map as a `<figure>`.
pub(crate) fn heat_map(map: &HeatMap) -> String {
    let caption = text(&shortened(&map.caption, 300));
    let columns = map.rows.iter().map(Vec::len).max().unwrap_or(0).min(MOST);
    let rows = map.rows.len().min(MOST);
    let largest = finite_range(map.rows.iter().flatten()).map_or(0.0, |(low, high)| low.abs().max(high.abs()));
    if columns == 0 || largest <= 0.0 {
        return format!("<p class=\"note\">{caption}: nothing to map.</p>\n");
    }
    let (w, h) = (WIDTH / columns as f64, HEIGHT / rows as f64);
    let mut cells = String::new();
    for (r, row) in map.rows.iter().take(rows).enumerate() {
        for c in 0..columns {
            let value = row.get(c).copied().unwrap_or(f64::NAN);
            let (x, y) = (LEFT + c as f64 * w, TOP + HEIGHT - (r + 1) as f64 * h);
            let (class, strength) = if !value.is_finite() {
                ("none", 1.0)
            } else if value < 0.0 {
                ("minus", -value / largest)
            } else {
                ("plus", value / largest)
            };
            let _ = write!(
                cells,
                "<rect class=\"{class}\" x=\"{x:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill-opacity=\"{strength:.2}\"><title>{}</title></rect>",
                (w - 0.6).max(0.4),
                (h - 0.6).max(0.4),
                significant(value, 2)
            );
        }
    }
    let label = |x: f64, y: f64, anchor: &str, words: &str| {
        format!("<text x=\"{x}\" y=\"{y}\" text-anchor=\"{anchor}\">{}</text>", text(&shortened(words, 80)))
    };
    let (right, bottom, middle) = (LEFT + WIDTH, TOP + HEIGHT, TOP + HEIGHT / 2.0);
    let axes = [
        label(LEFT, bottom + 17.0, "start", &compact(map.x_range.0)),
        label(LEFT + WIDTH / 2.0, bottom + 17.0, "middle", &map.x_label),
        label(right, bottom + 17.0, "end", &compact(map.x_range.1)),
        label(LEFT - 8.0, bottom, "end", &compact(map.y_range.0)),
        label(LEFT - 8.0, TOP + 10.0, "end", &compact(map.y_range.1)),
        format!("<g transform=\"translate(16 {middle}) rotate(-90)\">{}</g>", label(0.0, 0.0, "middle", &map.y_label)),
    ]
    .concat();
    format!(
        "<figure class=\"heat\"><figcaption>{caption}</figcaption><svg viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"{caption}\">{cells}{axes}</svg>\
         <p class=\"note\">{}: up to {} in size; orange positive, blue negative, grey without data.</p></figure>\n",
        right + 8.0,
        bottom + 26.0,
        text(&shortened(&map.value_label, 80)),
        significant(largest, 2)
    )
}
