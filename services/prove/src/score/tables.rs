//! The scorecard of many judged cases.

use super::{Fate, Improvement, Judged, Match, Reliability};
use crate::section::{Aim, Figure, Section, Table, short};
use lacuna_estimation::stats::median;
use std::collections::BTreeMap;

/// Adds scorecard, tables and failures of `cases` to `section`.
pub fn section(section: &mut Section, cases: &[Judged]) {
    section.figures.extend(naming(cases));
    section.figures.extend(unknowns(cases));
    section.figures.extend(by_share(cases));
    section.figures.extend(models(cases));
    section.figures.extend(numbers(cases));
    section.figures.push(seconds(cases));
    section.tables.push(by_effect(cases));
    section.tables.push(reliability(cases));
    section.tables.push(parameters(cases));
    section.failures.extend(cases.iter().filter(|c| !c.perfect()).map(|c| format!("{}: {}", c.name, c.line)));
}

fn count<T>(items: impl Iterator<Item = T>, what: impl Fn(&T) -> bool) -> usize {
    items.filter(|i| what(i)).count()
}

fn naming(cases: &[Judged]) -> Vec<Figure> {
    let clean = || cases.iter().filter(|c| c.clean());
    let other = || cases.iter().filter(|c| !c.clean());
    let fates = || cases.iter().flat_map(|c| &c.fates);
    let said: usize = cases.iter().map(|c| c.findings.len()).sum();
    let wrong: usize = cases.iter().map(Judged::wrong).sum();
    let several = || other().filter(|c| c.fates.len() > 1);
    vec![
        Figure::share(
            "diagnoses that ended without findings.json",
            count(cases.iter(), |c| c.error.is_some()),
            cases.len(),
            Aim::Most(0.0),
        ),
        Figure::share(
            "false alarms on clean recordings",
            count(clean(), |c| !c.findings.is_empty()),
            clean().count(),
            Aim::Most(0.01),
        ),
        Figure::share(
            "mismatch detected where something is hidden",
            count(other(), |c| c.detected),
            other().count(),
            Aim::None,
        ),
        Figure::share(
            "top-1: first finding names something hidden, or its group",
            count(other(), |c| c.first != Match::No),
            other().count(),
            Aim::Least(0.95),
        ),
        Figure::share("top-1 by name alone", count(other(), |c| c.first == Match::Name), other().count(), Aim::None),
        Figure::share(
            "recall: hidden effects that are named, or in a named group",
            count(fates(), |f| f.fit != Match::No),
            fates().count(),
            Aim::Least(0.9),
        ),
        Figure::share(
            "recall with all joints right",
            count(fates(), |f| f.fit != Match::No && f.joints),
            fates().count(),
            Aim::None,
        ),
        Figure::share("precision: findings that are not wrong names", said - wrong, said, Aim::Least(0.95)),
        Figure::share("all right, nothing else said", count(other(), |c| c.perfect()), other().count(), Aim::None),
        Figure::share(
            "the same with two or three effects at once",
            count(several(), |c| c.perfect()),
            several().count(),
            Aim::None,
        ),
    ]
}

fn unknowns(cases: &[Judged]) -> Vec<Figure> {
    let outside = || cases.iter().flat_map(|c| &c.fates).filter(|f| f.unknown);
    let inside = || cases.iter().filter(|c| c.fates.iter().all(|f| !f.unknown) && !c.clean());
    vec![
        Figure::share(
            "effects outside the catalogue flagged as unknown",
            count(outside(), |f| f.fit != Match::No),
            outside().count(),
            Aim::Least(0.95),
        ),
        Figure::share(
            "catalogue effects alone, called unknown",
            count(inside(), |c| c.unknown),
            inside().count(),
            Aim::Most(0.05),
        ),
    ]
}

/// Bands of an effect's share in the residual: words, from, below, aim by name, aim by name or group.
const BANDS: [(&str, f64, f64, Aim, Aim); 3] = [
    ("≥ 30 % of the residual", 0.3, f64::INFINITY, Aim::Least(0.95), Aim::None),
    ("10–30 % of the residual", 0.1, 0.3, Aim::Least(0.8), Aim::Least(0.95)),
    ("< 10 % of the residual", 0.0, 0.1, Aim::None, Aim::None),
];

fn by_share(cases: &[Judged]) -> Vec<Figure> {
    let known = || cases.iter().flat_map(|c| &c.fates).filter(|f| !f.unknown && f.share.is_some());
    if known().count() == 0 {
        return Vec::new();
    }
    let mut figures = Vec::new();
    for (words, from, below, by_name, by_group) in BANDS {
        let band = || known().filter(|f| f.share.is_some_and(|s| s >= from && s < below));
        let name = |what: &str| format!("effects with {words}: {what}");
        figures.push(Figure::share(&name("named"), count(band(), |f| f.fit == Match::Name), band().count(), by_name));
        figures.push(Figure::share(
            &name("named, or in a named group"),
            count(band(), |f| f.fit != Match::No),
            band().count(),
            by_group,
        ));
    }
    figures
}

fn middle(measure: &str, values: &[f64], digits: usize, unit: &str, aim: Aim) -> Figure {
    let finite: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    let m = if finite.is_empty() { f64::NAN } else { median(&finite) };
    let worst = finite.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let least = finite.iter().copied().fold(f64::INFINITY, f64::min);
    let text = format!(
        "median {}{unit} of {} (from {}{unit} to {}{unit})",
        short(m, digits),
        finite.len(),
        short(least, digits),
        short(worst, digits)
    );
    Figure::new(measure, m, text, aim)
}

fn models(cases: &[Judged]) -> Vec<Figure> {
    let hidden = || cases.iter().filter(|c| !c.clean());
    let gains: Vec<Improvement> = hidden().filter_map(|c| c.improvement).collect();
    let ratio: Vec<f64> = gains.iter().map(|g| g.ratio()).collect();
    let share: Vec<f64> = gains.iter().map(|g| g.share()).collect();
    let named = || hidden().filter(|c| !c.findings.is_empty()).filter_map(|c| c.black_box);
    vec![
        middle("held-out residual over what the true model leaves", &ratio, 3, "", Aim::None),
        middle("share of the true model's improvement reached, held out", &share, 3, "", Aim::Least(0.95)),
        // Sixteen of eighteen, as asked.
        Figure::share(
            "named model at least as good as the black box, held out",
            count(named(), |(m, b)| m <= b),
            named().count(),
            Aim::Least(0.889),
        ),
    ]
}

fn numbers(cases: &[Judged]) -> Vec<Figure> {
    let error = Reliability::of(cases.iter()).error;
    let all = || cases.iter().flat_map(|c| &c.coverage);
    let masses: Vec<f64> = cases.iter().flat_map(|c| &c.weighed).map(|w| 100.0 * w.mass_error.abs()).collect();
    let picks: Vec<f64> = cases.iter().flat_map(|c| &c.weighed).map(|w| w.pick_error_s.abs()).collect();
    let covered = || cases.iter().flat_map(|c| &c.weighed).filter_map(|w| w.covered);
    vec![
        Figure::new("probabilities: expected calibration error", error, short(error, 3), Aim::Most(0.05)),
        Figure::share(
            "95 % intervals that hold the true parameter",
            count(all(), |c| c.covers()),
            all().count(),
            Aim::Within(0.92, 0.97),
        ),
        middle("payload: error of the mass", &masses, 2, " %", Aim::Most(3.0)),
        middle("payload: error of the pick's time", &picks, 2, " s", Aim::Most(1.0)),
        Figure::share(
            "payload: 95 % intervals that hold the mass",
            count(covered(), |c| *c),
            covered().count(),
            Aim::None,
        ),
    ]
}

fn seconds(cases: &[Judged]) -> Figure {
    let all: Vec<f64> = cases.iter().map(|c| c.seconds).collect();
    middle("run time of a diagnosis", &all, 3, " s", Aim::None)
}

fn by_effect(cases: &[Judged]) -> Table {
    let mut by_id: BTreeMap<(bool, &str), Vec<&Fate>> = BTreeMap::new();
    for fate in cases.iter().flat_map(|c| &c.fates) {
        by_id.entry((fate.unknown, &fate.id)).or_default().push(fate);
    }
    let head = ["hidden effect", "cases", "named", "named or in group", "joints right", "≥ 30 %", "10–30 %", "< 10 %"];
    let mut table = Table::new("By hidden effect (the last three: named or in group, by share of the residual)", &head);
    for ((unknown, id), fates) in by_id {
        let found = |f: &&&Fate| f.fit != Match::No;
        let band = |from: f64, below: f64| {
            let inside = || fates.iter().filter(|f| f.share.is_some_and(|s| s >= from && s < below));
            match inside().count() {
                0 => "-".to_owned(),
                n => format!("{} of {n}", inside().filter(found).count()),
            }
        };
        let name = if unknown { format!("{id} (not in the catalogue)") } else { id.to_owned() };
        let mut row = vec![name, fates.len().to_string()];
        row.push(count(fates.iter(), |f| f.fit == Match::Name).to_string());
        row.push(fates.iter().filter(found).count().to_string());
        row.push(count(fates.iter(), |f| f.joints).to_string());
        row.extend(BANDS.iter().map(|b| band(b.1, b.2)));
        table.rows.push(row);
    }
    table
}

fn reliability(cases: &[Judged]) -> Table {
    let head = ["probability said", "findings", "mean probability", "share right"];
    let mut table = Table::new("Reliability of probabilities (named findings)", &head);
    for (low, high, count, mean, right) in Reliability::of(cases.iter()).bins.into_iter().filter(|b| b.2 > 0) {
        let share = short(right as f64 / count as f64, 3);
        table.rows.push(vec![format!("{low} to {high}"), count.to_string(), short(mean, 3), share]);
    }
    table
}

fn parameters(cases: &[Judged]) -> Table {
    let mut by_name: BTreeMap<&str, Vec<&super::Coverage>> = BTreeMap::new();
    for c in cases.iter().flat_map(|c| &c.coverage) {
        by_name.entry(&c.what).or_default().push(c);
    }
    let head = ["parameter", "fitted", "interval holds truth", "median error", "median half-width over value"];
    let mut table = Table::new("Parameters against truth", &head);
    for (name, list) in by_name {
        let mut errors: Vec<f64> = list.iter().map(|c| 100.0 * c.relative_error()).collect();
        errors.retain(|v| v.is_finite());
        let mut widths: Vec<f64> = list.iter().map(|c| 50.0 * (c.ci95[1] - c.ci95[0]) / c.value.abs()).collect();
        widths.retain(|v| v.is_finite());
        let percent = |v: &[f64]| if v.is_empty() { "-".to_owned() } else { format!("{} %", short(median(v), 2)) };
        let held = count(list.iter(), |c| c.covers());
        table.rows.push(vec![
            name.to_owned(),
            list.len().to_string(),
            held.to_string(),
            percent(&errors),
            percent(&widths),
        ]);
    }
    table
}
