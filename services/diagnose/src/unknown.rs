//! What no named effect explains: found by a black box on the folds left out, mapped over the variable that
//! explains most of it.

use crate::boost::{Binned, Settings, fit_predict};
use crate::families::Context;
use crate::findings::{Map, Region};
use crate::scene::Column;
use crate::search::Search;
use lacuna_estimation::stats;
use rayon::prelude::*;

/// How far back the black box sees [s].
const LAGS_S: [f64; 3] = [0.01, 0.04, 0.15];

/// What a black box sees of one joint.
pub struct Features {
    /// Names as in [`Region`].
    pub names: Vec<String>,
    /// Values at all rows.
    pub values: Vec<Vec<f64>>,
}

/// What a black box takes off a residual.
#[derive(Debug, Clone)]
pub struct Explained {
    /// Residual sum of squares before, per joint.
    pub before: Vec<f64>,
    /// After, on folds left out, per joint.
    pub after: Vec<f64>,
    /// Share of folds that gain, per joint.
    pub folds: Vec<f64>,
}

impl Search<'_> {
    /// Features of joint `j` at all rows.
    pub fn features(&self, ctx: &Context<'_>, j: usize) -> Features {
        let scene = self.scene;
        let index = |p: &crate::scene::Piece| scene.pieces.iter().position(|q| q.rows == p.rows).unwrap_or(0);
        let mut names = Vec::new();
        let mut values = Vec::new();
        let mut push = |name: String, v: Vec<f64>| {
            names.push(name);
            values.push(v);
        };
        push("q_rad".into(), scene.at_rows(|p, k| p.q[j][k]));
        push("qd_rad_s".into(), scene.at_rows(|p, k| p.qd[j][k]));
        push("qdd_rad_s2".into(), scene.at_rows(|p, k| p.qdd[j][k]));
        // Friction and springs remember: a rival that sees the moment alone would lose for nothing.
        for lag_s in LAGS_S {
            let back = |k: usize| k.saturating_sub((lag_s * scene.rate_hz).round() as usize);
            let ms = 1e3 * lag_s;
            push(format!("qd_rad_s {ms} ms before"), scene.at_rows(|p, k| p.qd[j][back(k)]));
            push(format!("qdd_rad_s2 {ms} ms before"), scene.at_rows(|p, k| p.qdd[j][back(k)]));
            push(format!("load_nm {ms} ms before"), scene.at_rows(|p, k| ctx.link[index(p)][j][back(k)]));
        }
        push("load_nm".into(), scene.at_rows(|p, k| ctx.link[index(p)][j][k]));
        let travel: Vec<Vec<f64>> = scene.pieces.iter().map(|p| since_reversal(&p.q[j], &p.qd[j])).collect();
        push("since_reversal_rad".into(), scene.at_rows(|p, k| travel[index(p)][k]));
        if scene.pieces.iter().all(|p| p.temperature.len() > j) {
            push("temperature_degc".into(), scene.at_rows(|p, k| p.temperature[j][k]));
        }
        for i in (0..scene.joints).filter(|i| *i != j && i.abs_diff(j) <= 2) {
            let name = &scene.robot.joints[i];
            push(format!("q_rad {name}"), scene.at_rows(|p, k| p.q[i][k]));
            push(format!("qd_rad_s {name}"), scene.at_rows(|p, k| p.qd[i][k]));
        }
        Features { names, values }
    }

    /// What boosting takes off `residual` on folds it was not fitted to.
    pub fn black_box(&self, ctx: &Context<'_>, residual: &Column) -> Explained {
        let n = self.scene.joints;
        let features: Vec<Binned> =
            (0..n).into_par_iter().map(|j| Binned::new(&self.features(ctx, j).values)).collect();
        let folds = &self.scene.folds;
        let jobs: Vec<(usize, usize)> = (0..n).flat_map(|j| (0..folds.len()).map(move |f| (j, f))).collect();
        let results: Vec<(usize, f64, f64)> = jobs
            .into_par_iter()
            .map(|(j, f)| {
                let y = &residual.part[j];
                let mask = &self.scene.mask[j];
                let train: Vec<usize> = (0..self.scene.rows).filter(|r| mask[*r] && !folds[f].contains(r)).collect();
                let p = fit_predict(&features[j], y, &train, &Settings::default());
                let (mut before, mut after) = (0.0, 0.0);
                for r in folds[f].clone().filter(|r| mask[*r]) {
                    before += y[r] * y[r];
                    after += (y[r] - p[r]).powi(2);
                }
                (j, before, after)
            })
            .collect();
        let mut out = Explained { before: vec![0.0; n], after: vec![0.0; n], folds: vec![0.0; n] };
        for (j, before, after) in results {
            out.before[j] += before;
            out.after[j] += after;
            out.folds[j] += f64::from(u8::from(after < before)) / folds.len() as f64;
        }
        out
    }

    /// The single variable over which binned means explain most of a joint's residual: share explained, its
    /// name, and the map.
    pub fn map(&self, ctx: &Context<'_>, residual: &Column, j: usize) -> Option<(f64, Map, Region)> {
        let features = self.features(ctx, j);
        let mask = &self.scene.mask[j];
        let rows: Vec<usize> = (0..self.scene.rows).filter(|r| mask[*r]).collect();
        let y = &residual.part[j];
        let qd = &features.values[1];
        let total: f64 = rows.iter().map(|r| y[*r] * y[*r]).sum();
        let own: Vec<usize> = (0..features.names.len()).filter(|i| !features.names[*i].contains(' ')).collect();
        let mut best: Option<(f64, usize, Vec<Cell>)> = None;
        for i in own {
            let cells = cells(&features.values[i], y, qd, &rows);
            let share = cells.iter().map(Cell::explained).sum::<f64>() / total.max(1e-30);
            if best.as_ref().is_none_or(|b| share > b.0) {
                best = Some((share, i, cells));
            }
        }
        let (share, i, cells) = best?;
        let region = region(&features.names[i], &cells)?;
        let map = Map {
            joint: self.scene.robot.joints[j].clone(),
            variable: features.names[i].clone(),
            at: cells.iter().map(|c| 0.5 * (c.low + c.high)).collect(),
            forward_nm: cells.iter().map(|c| c.mean(0)).collect(),
            backward_nm: cells.iter().map(|c| c.mean(1)).collect(),
        };
        Some((share, map, region))
    }
}

/// Path since the last change of direction [rad].
pub fn since_reversal(q: &[f64], qd: &[f64]) -> Vec<f64> {
    let mut out = Vec::with_capacity(q.len());
    let (mut from, mut way) = (q.first().copied().unwrap_or(0.0), 0.0);
    for (x, v) in q.iter().zip(qd) {
        if *v != 0.0 && v.signum() != way {
            way = v.signum();
            from = *x;
        }
        out.push((x - from).abs());
    }
    out
}

/// Rows of one bin, forwards (0) and backwards (1).
struct Cell {
    low: f64,
    high: f64,
    sum: [f64; 2],
    power: f64,
    count: [f64; 2],
}

impl Cell {
    fn mean(&self, way: usize) -> Option<f64> {
        (self.count[way] >= 5.0).then(|| self.sum[way] / self.count[way])
    }

    /// Power that the means explain, less what the means of noise would.
    fn explained(&self) -> f64 {
        let total = (self.count[0] + self.count[1]).max(1.0);
        (0..2)
            .filter(|w| self.count[*w] > 0.0)
            .map(|w| self.sum[w] * self.sum[w] / self.count[w] - self.power / total)
            .sum()
    }
}

/// Forty bins of equal width over the middle 98 % of a variable.
fn cells(x: &[f64], y: &[f64], qd: &[f64], rows: &[usize]) -> Vec<Cell> {
    let all: Vec<f64> = rows.iter().map(|r| x[*r]).collect();
    let (low, high) = (stats::quantile(&all, 0.01), stats::quantile(&all, 0.99));
    let count = 40;
    let width = (high - low) / count as f64;
    let mut out: Vec<Cell> = (0..count)
        .map(|i| Cell {
            low: low + i as f64 * width,
            high: low + (i + 1) as f64 * width,
            sum: [0.0; 2],
            power: 0.0,
            count: [0.0; 2],
        })
        .collect();
    for r in rows {
        let at = ((x[*r] - low) / width.max(1e-30)).floor();
        if at < 0.0 || at >= count as f64 {
            continue;
        }
        let cell = &mut out[at as usize];
        let way = usize::from(qd[*r] < 0.0);
        cell.sum[way] += y[*r];
        cell.count[way] += 1.0;
        cell.power += y[*r] * y[*r];
    }
    out
}

/// The shortest run of bins that holds 70 % of the residual's power above the common level.
fn region(name: &str, cells: &[Cell]) -> Option<Region> {
    let density: Vec<f64> = cells.iter().map(|c| c.power / (c.count[0] + c.count[1]).max(1.0)).collect();
    let common = stats::quantile(&density, 0.2);
    let excess: Vec<f64> =
        cells.iter().zip(&density).map(|(c, d)| ((d - common) * (c.count[0] + c.count[1])).max(0.0)).collect();
    let total: f64 = excess.iter().sum();
    let mut best: Option<(usize, usize)> = None;
    for a in 0..cells.len() {
        let mut sum = 0.0;
        for b in a..cells.len() {
            sum += excess[b];
            if sum >= 0.7 * total {
                if best.is_none_or(|(x, y)| b - a < y - x) {
                    best = Some((a, b));
                }
                break;
            }
        }
    }
    let (a, b) = best?;
    Some(Region { variable: name.to_owned(), low: cells[a].low, high: cells[b].high })
}
