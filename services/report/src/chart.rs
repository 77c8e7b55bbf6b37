//! Charts: from whole recordings to the few thousand numbers a screen can show.

use crate::decimate::{binned, breaks, finite_range, line_rows};
use base64::Engine as _;
use serde::Serialize;

/// Rows a line chart holds after construction; writing the report may reduce them further.
pub(crate) const MAX_ROWS: usize = 8000;
/// Bins of a residual over velocity, angle or another variable.
const BINS: usize = 48;
/// Fewest samples for which a bin's mean and range are shown.
const LEAST_IN_BIN: usize = 8;
/// Single samples drawn per series behind the bins.
const DOTS: usize = 900;

/// What a curve stands for. The same role has the same colour in every chart, table bar and legend.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Role {
    /// What the robot did.
    Measured,
    /// The model before; the residual before.
    Before,
    /// The model after; the residual after.
    #[default]
    After,
    /// The black box beside.
    BlackBox,
    /// Any other model, by position.
    Other(u8),
}

impl Role {
    /// Name of the colour variable in the style sheet.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Measured => "measured",
            Self::Before => "before",
            Self::After => "after",
            Self::BlackBox => "blackbox",
            Self::Other(k) => ["other1", "other2", "other3"][usize::from(k % 3)],
        }
    }
}

/// An axis: what, and in which unit.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Axis {
    label: String,
    unit: String,
}

impl Axis {
    /// Quantity and unit, e.g. `Axis::new("Time", "s")`; an empty unit is left out.
    #[must_use]
    pub fn new(label: &str, unit: &str) -> Self {
        Self { label: label.to_owned(), unit: unit.to_owned() }
    }

    pub(crate) fn title(&self) -> String {
        if self.unit.is_empty() { self.label.clone() } else { format!("{} [{}]", self.label, self.unit) }
    }
}

/// One curve over the chart's x.
#[derive(Debug, Clone, Copy)]
pub struct Curve<'a> {
    /// Name in the legend.
    pub name: &'a str,
    /// What it stands for.
    pub role: Role,
    /// One value per x; values that are not finite leave a gap.
    pub values: &'a [f64],
    /// Visible from the start, or only after a click in the legend.
    pub shown: bool,
}

/// Samples of one residual, to be condensed over `x`.
#[derive(Debug, Clone, Copy)]
pub struct Cloud<'a> {
    /// Name in the legend.
    pub name: &'a str,
    /// What it stands for.
    pub role: Role,
    /// The variable the residual is shown over.
    pub x: &'a [f64],
    /// The residual.
    pub y: &'a [f64],
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Style {
    Line,
    Points,
    /// Edge of a band: no line, not in the legend, follows the series before it.
    Edge,
}

#[derive(Debug, Clone)]
struct Series {
    name: String,
    role: Role,
    style: Style,
    shown: bool,
    /// NaN is a gap; +∞ means "nothing at this x", which does not break a line.
    values: Vec<f64>,
}

#[derive(Debug, Clone, Serialize)]
struct Region {
    low: f64,
    high: f64,
    label: String,
}

/// A chart that zooms: lines over time, or a residual condensed over a variable.
#[derive(Debug, Clone)]
pub struct Chart {
    pub(crate) title: String,
    pub(crate) note: String,
    x_axis: Axis,
    y_axis: Axis,
    x: Vec<f64>,
    series: Vec<Series>,
    regions: Vec<Region>,
    sync: String,
    height: u16,
    reducible: bool,
}

impl Chart {
    /// Curves over a common x, usually time. Long recordings are reduced so that the smallest and largest
    /// sample of every stretch remain; pauses in the recording interrupt the lines.
    ///
    /// Rows beyond the shortest curve and rows whose x is not finite are dropped; an x that runs backwards
    /// is sorted.
    #[must_use]
    pub fn lines(title: &str, x_axis: Axis, y_axis: Axis, x: &[f64], curves: &[Curve<'_>]) -> Self {
        let values: Vec<&[f64]> = curves.iter().map(|c| c.values).collect();
        let length = values.iter().map(|v| v.len()).fold(x.len(), usize::min);
        let x = x.get(..length).unwrap_or_default();
        let values: Vec<&[f64]> = values.into_iter().map(|v| v.get(..length).unwrap_or_default()).collect();
        let mut rows = line_rows(&values, MAX_ROWS);
        rows.retain(|&r| x.get(r).is_some_and(|v| v.is_finite()));
        let at = |r: usize| x.get(r).copied().unwrap_or(f64::NAN);
        let backwards = rows.windows(2).any(|w| matches!(w, [a, b] if at(*b) < at(*a)));
        if backwards {
            rows.sort_by(|&a, &b| at(a).total_cmp(&at(b)));
        }
        let pauses = if backwards { Vec::new() } else { breaks(x) };
        let places = with_pauses(&rows, &pauses);
        let place_x = |place: &Place| match *place {
            Place::Row(r) => at(r),
            Place::Pause(r) => 0.5 * (at(r.saturating_sub(1)) + at(r)),
        };
        let pick = |values: &[f64]| places.iter().map(|p| p.value(values)).collect();
        Self {
            title: title.to_owned(),
            note: String::new(),
            x_axis,
            y_axis,
            x: places.iter().map(place_x).collect(),
            series: curves
                .iter()
                .zip(&values)
                .map(|(c, v)| Series {
                    name: c.name.to_owned(),
                    role: c.role,
                    style: Style::Line,
                    shown: c.shown,
                    values: pick(v),
                })
                .collect(),
            regions: Vec::new(),
            sync: String::new(),
            height: 230,
            reducible: true,
        }
    }

    /// Residuals over a variable: the mean per bin as a line, the middle 90 % of the samples as a band,
    /// single samples as dots. Samples far outside the bulk of the variable (0.05 % at either end, where
    /// they would stretch the axis to more than twice its width) are not shown, and the note says so.
    #[must_use]
    pub fn binned(title: &str, x_axis: Axis, y_axis: Axis, clouds: &[Cloud<'_>]) -> Self {
        let mut chart = Self {
            title: title.to_owned(),
            note: "Line: mean in the bin. Shaded: the middle 90 % of the samples. Dots: single samples.".to_owned(),
            x_axis,
            y_axis,
            x: Vec::new(),
            series: Vec::new(),
            regions: Vec::new(),
            sync: String::new(),
            height: 250,
            reducible: false,
        };
        let Some((range, cut)) = bulk_range(clouds) else { return chart };
        if cut {
            chart.note.push_str(" A few samples far outside this range are not shown.");
        }
        let condensed: Vec<_> = clouds.iter().map(|c| binned(c.x, c.y, range, BINS, LEAST_IN_BIN)).collect();
        let edges = condensed.iter().flatten().flat_map(|b| [b.p05, b.p95]).collect::<Vec<_>>();
        let Some((low, high)) = finite_range(&edges) else { return chart };
        let margin = 0.35 * (high - low);
        let mut builder = Merged::default();
        for cloud in clouds {
            builder.dots(cloud, range, (low - margin, high + margin));
        }
        for (cloud, bins) in clouds.iter().zip(&condensed) {
            let mut line = |style, value: fn(&crate::decimate::Bin) -> f64| {
                builder.add(cloud, style, bins.iter().map(|b| (b.centre, value(b))));
            };
            line(Style::Line, |b| b.mean);
            line(Style::Edge, |b| b.p95);
            line(Style::Edge, |b| b.p05);
        }
        (chart.x, chart.series) = builder.aligned();
        chart
    }

    /// Shades `low..high` of x and names it. Edges that are not finite reach to the end of the axis.
    #[must_use]
    pub fn with_region(mut self, low: f64, high: f64, label: &str) -> Self {
        let low = if low.is_finite() { low } else { f64::MIN };
        let high = if high.is_finite() { high } else { f64::MAX };
        self.regions.push(Region { low, high, label: label.to_owned() });
        self
    }

    /// Zooms together with all charts of the same group.
    #[must_use]
    pub fn synced(mut self, group: &str) -> Self {
        group.clone_into(&mut self.sync);
        self
    }

    /// Adds a remark below the chart.
    #[must_use]
    pub fn with_note(mut self, note: &str) -> Self {
        note.clone_into(&mut self.note);
        self
    }

    /// Whether there is anything to draw.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.x.is_empty() || !self.series.iter().any(|s| s.values.iter().any(|v| v.is_finite()))
    }

    /// What the chart shows, in words, for those who do not see it.
    pub(crate) fn description(&self) -> String {
        let names: Vec<&str> = self.series.iter().filter(|s| s.style == Style::Line).map(|s| s.name.as_str()).collect();
        format!("{}: {} over {}. Curves: {}.", self.title, self.y_axis.title(), self.x_axis.title(), names.join(", "))
    }

    pub(crate) fn height(&self) -> u16 {
        self.height
    }

    /// What the script draws, with at most about `limit` rows.
    pub(crate) fn spec(&self, limit: usize) -> Spec<'_> {
        let values: Vec<&[f64]> = self.series.iter().map(|s| s.values.as_slice()).collect();
        let rows = if self.reducible { line_rows(&values, limit) } else { (0..self.x.len()).collect() };
        let pick = |values: &[f64]| -> Vec<f64> { rows.iter().filter_map(|&r| values.get(r).copied()).collect() };
        let x = pick(&self.x);
        let origin = x.first().copied().unwrap_or(0.0);
        let offsets: Vec<f64> = x.iter().map(|v| v - origin).collect();
        Spec {
            title: &self.title,
            x: &self.x_axis,
            y: &self.y_axis,
            sync: &self.sync,
            height: self.height,
            origin,
            xs: packed(&offsets),
            series: self
                .series
                .iter()
                .map(|s| SeriesSpec {
                    name: &s.name,
                    role: s.role.name(),
                    style: s.style,
                    shown: s.shown,
                    values: packed(&pick(&s.values)),
                })
                .collect(),
            regions: &self.regions,
        }
    }
}

/// A chart as the script in the report reads it.
#[derive(Debug, Serialize)]
pub(crate) struct Spec<'a> {
    title: &'a str,
    x: &'a Axis,
    y: &'a Axis,
    sync: &'a str,
    height: u16,
    /// x of the first row; `xs` counts from it, so that single precision resolves absolute times too.
    origin: f64,
    xs: String,
    series: Vec<SeriesSpec<'a>>,
    regions: &'a [Region],
}

#[derive(Debug, Serialize)]
struct SeriesSpec<'a> {
    name: &'a str,
    role: &'static str,
    style: Style,
    shown: bool,
    values: String,
}

/// Little-endian single precision in base64: 5.3 characters a number with seven digits.
fn packed(values: &[f64]) -> String {
    let bytes: Vec<u8> = values.iter().flat_map(|&v| (v as f32).to_le_bytes()).collect();
    base64::engine::general_purpose::STANDARD.encode(bytes)
}

/// A place on the x axis of a line chart: a sample, or the middle of the pause before a sample.
enum Place {
    Row(usize),
    Pause(usize),
}

impl Place {
    /// Infinite samples become gaps as well: +∞ has a meaning of its own in [`Series`].
    fn value(&self, values: &[f64]) -> f64 {
        match *self {
            Self::Row(r) => values.get(r).copied().filter(|v| v.is_finite()).unwrap_or(f64::NAN),
            Self::Pause(_) => f64::NAN,
        }
    }
}

fn with_pauses(rows: &[usize], pauses: &[usize]) -> Vec<Place> {
    let mut places = Vec::with_capacity(rows.len() + pauses.len().min(rows.len()));
    let mut pauses = pauses.iter().peekable();
    for &row in rows {
        let mut pause = None;
        while let Some(&next) = pauses.next_if(|&&p| p <= row) {
            pause = Some(next);
        }
        // One interruption between two kept samples is enough, and none before the first.
        if let (Some(pause), false) = (pause, places.is_empty()) {
            places.push(Place::Pause(pause));
        }
        places.push(Place::Row(row));
    }
    places
}

/// The range of x that is worth an axis, and whether samples lie outside it.
fn bulk_range(clouds: &[Cloud<'_>]) -> Option<((f64, f64), bool)> {
    let mut all: Vec<f64> = clouds.iter().flat_map(|c| c.x.iter().copied()).filter(|v| v.is_finite()).collect();
    let (first, last) = finite_range(&all)?;
    let tail = all.len() / 2000;
    let high_rank = all.len() - 1 - tail;
    let (_, &mut low, _) = all.select_nth_unstable_by(tail, f64::total_cmp);
    let (_, &mut high, _) = all.select_nth_unstable_by(high_rank, f64::total_cmp);
    let cut = high > low && last - first > 2.0 * (high - low);
    let range = if cut { (low, high) } else { (first, last) };
    (range.1 > range.0).then_some((range, cut))
}

/// Series with x of their own, brought onto one ascending x as the chart library needs it.
#[derive(Default)]
struct Merged {
    series: Vec<(Series, Vec<(f64, f64)>)>,
}

impl Merged {
    fn add(&mut self, cloud: &Cloud<'_>, style: Style, points: impl Iterator<Item = (f64, f64)>) {
        let name = if style == Style::Points { format!("{}, samples", cloud.name) } else { cloud.name.to_owned() };
        let series = Series { name, role: cloud.role, style, shown: true, values: Vec::new() };
        self.series.push((series, points.collect()));
    }

    /// Adds single samples: at a fixed stride, so that the dots are as dense as the data are.
    fn dots(&mut self, cloud: &Cloud<'_>, x_range: (f64, f64), y_range: (f64, f64)) {
        let within = |v: f64, (low, high): (f64, f64)| v >= low && v <= high;
        let inside: Vec<(f64, f64)> = cloud
            .x
            .iter()
            .copied()
            .zip(cloud.y.iter().copied())
            .filter(|&(x, y)| within(x, x_range) && within(y, y_range))
            .collect();
        let stride = inside.len().div_ceil(DOTS).max(1);
        self.add(cloud, Style::Points, inside.into_iter().step_by(stride));
    }

    fn aligned(self) -> (Vec<f64>, Vec<Series>) {
        let mut x: Vec<f64> = self.series.iter().flat_map(|(_, points)| points.iter().map(|p| p.0)).collect();
        x.sort_unstable_by(f64::total_cmp);
        x.dedup();
        let place = |(mut series, points): (Series, Vec<(f64, f64)>)| {
            series.values = vec![f64::INFINITY; x.len()];
            for (at, value) in points {
                if let Ok(row) = x.binary_search_by(|v| v.total_cmp(&at))
                    && let Some(slot) = series.values.get_mut(row)
                {
                    *slot = value;
                }
            }
            series
        };
        let series = self.series.into_iter().map(place).collect();
        (x, series)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unpacked(text: &str) -> Vec<f32> {
        let bytes = base64::engine::general_purpose::STANDARD.decode(text).expect("base64");
        bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
    }

    fn curve(values: &[f64]) -> Curve<'_> {
        Curve { name: "τ", role: Role::Measured, values, shown: true }
    }

    fn lines(x: &[f64], values: &[f64]) -> Chart {
        Chart::lines("t", Axis::new("Time", "s"), Axis::new("Torque", "Nm"), x, &[curve(values)])
    }

    #[test]
    fn absolute_times_keep_their_resolution() {
        let x: Vec<f64> = (0..1000).map(|i| 1.7e9 + f64::from(i) * 0.001).collect();
        let chart = lines(&x, &vec![1.0; 1000]);
        let spec = chart.spec(MAX_ROWS);
        let back = unpacked(&spec.xs);
        assert_eq!(back.len(), 1000);
        for (i, offset) in back.iter().enumerate() {
            assert!((spec.origin + f64::from(*offset) - x[i]).abs() < 1e-5);
        }
    }

    #[test]
    fn pauses_interrupt_the_line_and_infinities_do_too() {
        let x = [0.0, 0.1, 0.2, 9.0, 9.1, 9.2];
        let chart = lines(&x, &[1.0, 2.0, 3.0, 4.0, f64::INFINITY, 6.0]);
        assert_eq!(chart.x, [0.0, 0.1, 0.2, 4.6, 9.0, 9.1, 9.2]);
        let gaps: Vec<bool> = chart.series[0].values.iter().map(|v| v.is_nan()).collect();
        assert_eq!(gaps, [false, false, false, true, false, true, false]);
    }

    #[test]
    fn time_that_runs_backwards_is_sorted_and_unequal_lengths_are_cut() {
        let chart = lines(&[1.0, 0.0, f64::NAN, 2.0, 3.0], &[10.0, 0.0, 5.0, 20.0]);
        assert_eq!(chart.x, [0.0, 1.0, 2.0]);
        assert_eq!(chart.series[0].values, [0.0, 10.0, 20.0]);
    }

    #[test]
    fn a_spike_survives_both_reductions() {
        let x: Vec<f64> = (0..200_000).map(|i| f64::from(i) * 1e-3).collect();
        let mut y: Vec<f64> = x.iter().map(|t| t.sin()).collect();
        y[123_457] = 77.0;
        let chart = lines(&x, &y);
        assert!(chart.x.len() <= MAX_ROWS + 4);
        let spec = chart.spec(100);
        let values = unpacked(&spec.series[0].values);
        assert!(values.len() <= 104 && values.contains(&77.0));
    }

    #[test]
    fn binned_residuals_show_mean_and_range() {
        let x: Vec<f64> = (0..4800).map(|i| f64::from(i) / 4800.0).collect();
        let y: Vec<f64> = x.iter().enumerate().map(|(i, x)| x + if i % 2 == 0 { 0.1 } else { -0.1 }).collect();
        let cloud = Cloud { name: "before", role: Role::Before, x: &x, y: &y };
        let chart = Chart::binned("r", Axis::new("Velocity", "rad/s"), Axis::new("Residual", "Nm"), &[cloud]);
        let mean = chart.series.iter().find(|s| s.style == Style::Line).expect("a mean line");
        let points: Vec<(f64, f64)> =
            chart.x.iter().zip(&mean.values).filter(|(_, v)| v.is_finite()).map(|(x, v)| (*x, *v)).collect();
        assert_eq!(points.len(), BINS);
        assert!(points.iter().all(|(x, v)| (x - v).abs() < 1e-3), "mean of x ± 0.1 is x");
        assert!(chart.x.windows(2).all(|w| w[0] < w[1]));
    }

    #[test]
    fn nothing_to_draw_is_empty_not_a_panic() {
        assert!(lines(&[], &[]).is_empty());
        assert!(lines(&[0.0, 1.0], &[f64::NAN, f64::NAN]).is_empty());
        let axis = || Axis::new("a", "");
        assert!(Chart::binned("r", axis(), axis(), &[]).is_empty());
        let constant = Cloud { name: "c", role: Role::After, x: &[1.0; 50], y: &[1.0; 50] };
        assert!(Chart::binned("r", axis(), axis(), &[constant]).is_empty());
        assert!(Chart::lines("t", axis(), axis(), &[0.0], &[]).is_empty());
        let _ = lines(&[], &[]).spec(0);
    }
}
