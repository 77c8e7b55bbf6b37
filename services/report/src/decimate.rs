//! Fewer points, the same picture: what a chart loses may not be what its reader looks for.
//!
//! A recording has up to millions of samples, a screen about a thousand columns. [`line_rows`] keeps, in
//! each of equally many bins, the rows at which any series reaches its minimum or maximum: every kept
//! point is a true sample, and a single-sample spike always survives. [`binned`] condenses a residual
//! over velocity or angle to its mean and the range of 90 % of the samples per bin.

/// Rows to keep so that at most about `limit` rows remain: ascending, each a true sample.
///
/// Per bin and series the rows of the smallest and largest finite value are kept; the first and last row
/// always are. A bin in which no series has a finite value keeps its first row, so that a gap stays a
/// gap. Rows beyond the shortest series are not considered.
#[must_use]
pub fn line_rows(series: &[&[f64]], limit: usize) -> Vec<usize> {
    let rows = series.iter().map(|s| s.len()).min().unwrap_or(0);
    if rows <= limit.max(2) {
        return (0..rows).collect();
    }
    let bins = (limit / (2 * series.len()).max(1)).max(1);
    let mut keep = Vec::with_capacity(bins * 2 * series.len() + 2);
    keep.push(0);
    for bin in 0..bins {
        let (from, to) = (bin * rows / bins, (bin + 1) * rows / bins);
        let before = keep.len();
        for values in series {
            if let Some((low, high)) = extremes(values, from, to) {
                keep.extend([low, high]);
            }
        }
        if keep.len() == before {
            keep.push(from);
        }
    }
    keep.push(rows - 1);
    keep.sort_unstable();
    keep.dedup();
    keep
}

/// Row numbers of the smallest and the largest finite value in `from..to`.
fn extremes(values: &[f64], from: usize, to: usize) -> Option<(usize, usize)> {
    let mut found: Option<((usize, f64), (usize, f64))> = None;
    for (offset, &value) in values.get(from..to)?.iter().enumerate() {
        if !value.is_finite() {
            continue;
        }
        let here = (from + offset, value);
        found = Some(match found {
            None => (here, here),
            Some((low, high)) => (if value < low.1 { here } else { low }, if value > high.1 { here } else { high }),
        });
    }
    found.map(|(low, high)| (low.0, high.0))
}

/// Rows before which time jumps by more than 20 times the median step, or backwards: a line drawn across
/// would claim samples that do not exist.
#[must_use]
pub fn breaks(x: &[f64]) -> Vec<usize> {
    let mut steps: Vec<f64> = x.windows(2).map(|w| w[1] - w[0]).filter(|d| d.is_finite() && *d > 0.0).collect();
    if steps.is_empty() {
        return Vec::new();
    }
    let middle = steps.len() / 2;
    let (_, median, _) = steps.select_nth_unstable_by(middle, f64::total_cmp);
    let longest = 20.0 * *median;
    x.windows(2).enumerate().filter(|(_, w)| w[1] - w[0] > longest || w[1] < w[0]).map(|(i, _)| i + 1).collect()
}

/// Mean and central 90 % range of `y` in one bin of `x`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bin {
    /// Centre of the bin, in the unit of `x`.
    pub centre: f64,
    /// Samples in the bin.
    pub count: usize,
    /// Mean of `y`.
    pub mean: f64,
    /// 5 % quantile of `y`.
    pub p05: f64,
    /// 95 % quantile of `y`.
    pub p95: f64,
}

/// Condenses the pairs `(x, y)` into at most `bins` equally wide bins over `range`; pairs that are not
/// finite are left out, as are bins with fewer than `least` samples (their mean is noise).
#[must_use]
pub fn binned(x: &[f64], y: &[f64], range: (f64, f64), bins: usize, least: usize) -> Vec<Bin> {
    let (low, high) = range;
    let width = (high - low) / bins.max(1) as f64;
    if !(width.is_finite() && width > 0.0) {
        return Vec::new();
    }
    let mut content: Vec<Vec<f64>> = vec![Vec::new(); bins.max(1)];
    for (&x, &y) in x.iter().zip(y) {
        if !(x.is_finite() && y.is_finite() && x >= low && x <= high) {
            continue;
        }
        // `high` itself belongs to the last bin; the cast truncates a number known to be in range.
        let index = (((x - low) / width) as usize).min(bins.max(1) - 1);
        if let Some(bin) = content.get_mut(index) {
            bin.push(y);
        }
    }
    let condense = |(index, mut values): (usize, Vec<f64>)| {
        if values.len() < least.max(1) {
            return None;
        }
        values.sort_unstable_by(f64::total_cmp);
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let centre = low + (index as f64 + 0.5) * width;
        Some(Bin { centre, count: values.len(), mean, p05: quantile(&values, 0.05), p95: quantile(&values, 0.95) })
    };
    content.into_iter().enumerate().filter_map(condense).collect()
}

fn quantile(sorted: &[f64], share: f64) -> f64 {
    let place = share * sorted.len().saturating_sub(1) as f64;
    let (below, part) = (place.floor() as usize, place.fract());
    match (sorted.get(below), sorted.get(below + 1)) {
        (Some(a), Some(b)) => a + (b - a) * part,
        (Some(a), None) => *a,
        _ => f64::NAN,
    }
}

/// Smallest and largest finite value, if there is one.
#[must_use]
pub fn finite_range<'a>(values: impl IntoIterator<Item = &'a f64>) -> Option<(f64, f64)> {
    values.into_iter().filter(|v| v.is_finite()).fold(None, |found, &v| match found {
        None => Some((v, v)),
        Some((low, high)) => Some((f64::min(low, v), f64::max(high, v))),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn one_spike_in_a_million_survives() {
        let mut quiet: Vec<f64> = (0..1_000_000).map(|i| (f64::from(i) * 1e-3).sin()).collect();
        quiet[654_321] = -40.0;
        let flat = vec![0.0; quiet.len()];
        let rows = line_rows(&[&flat, &quiet], 1000);
        assert!(rows.len() <= 1002, "{}", rows.len());
        assert!(rows.contains(&654_321));
        assert_eq!((rows.first(), rows.last()), (Some(&0), Some(&999_999)));
    }

    #[test]
    fn a_gap_stays_a_gap() {
        let values: Vec<f64> = (0..10_000).map(|i| if (4000..6000).contains(&i) { f64::NAN } else { 1.0 }).collect();
        let rows = line_rows(&[&values], 100);
        assert!(rows.iter().any(|&r| values[r].is_nan()));
    }

    #[test]
    fn nothing_in_nothing_out() {
        assert!(line_rows(&[], 10).is_empty());
        assert!(line_rows(&[&[]], 10).is_empty());
        assert!(binned(&[], &[], (0.0, 1.0), 10, 1).is_empty());
        assert!(binned(&[1.0], &[1.0], (1.0, 1.0), 10, 1).is_empty());
        assert!(breaks(&[]).is_empty());
        assert_eq!(finite_range(&[f64::NAN]), None);
    }

    #[test]
    fn pauses_and_restarts_are_breaks() {
        assert_eq!(breaks(&[0.0, 0.1, 0.2, 5.0, 5.1, 0.0, 0.1]), vec![3, 5]);
    }

    #[test]
    fn bins_hold_the_statistics_of_a_straight_line() {
        // y = x, uniform: each bin's mean is its centre, and 90 % of the samples span 90 % of its width.
        let x: Vec<f64> = (0..10_000).map(|i| f64::from(i) / 9999.0).collect();
        for bin in binned(&x, &x, (0.0, 1.0), 10, 5) {
            assert!((bin.mean - bin.centre).abs() < 2e-4, "{bin:?}");
            assert!((bin.p95 - bin.p05 - 0.09).abs() < 3e-4, "{bin:?}");
            assert!((990..=1010).contains(&bin.count), "{bin:?}");
        }
    }

    proptest! {
        /// Whatever the data, the extremes of every series are among the rows kept, in order.
        #[test]
        fn extremes_survive(
            values in prop::collection::vec((prop::num::f64::ANY, -10.0..10.0_f64), 0..3000),
            limit in 4_usize..500,
        ) {
            let (a, b): (Vec<f64>, Vec<f64>) = values.into_iter().unzip();
            let rows = line_rows(&[&a, &b], limit);
            prop_assert!(rows.windows(2).all(|w| w[0] < w[1]));
            prop_assert!(rows.len() <= limit.max(2) + 6);
            for series in [&a, &b] {
                let kept: Vec<f64> = rows.iter().map(|&r| series[r]).collect();
                prop_assert_eq!(finite_range(series), finite_range(&kept));
            }
        }
    }
}
