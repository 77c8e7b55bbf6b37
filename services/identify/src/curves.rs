//! Curves and bins of the report, from the rows that were kept for it.

use crate::fit::draft::Data;
use crate::hold_out::{Held, nominal_beta};
use crate::outcome::{JointCurves, ReportData};
use crate::stream::Class;
use crate::sums::Shown;
use nalgebra::DVector;

/// Most points of a curve.
const CURVE_POINTS: usize = crate::sums::MOST_SHOWN;
/// Bins of the residual over velocity.
const BINS: usize = 40;
/// Rows that a bin needs.
const BIN_ROWS: f64 = 5.0;

/// Torque and model of a joint at a row.
struct Point {
    measured: f64,
    model: f64,
    nominal: f64,
    qd: f64,
    class: Class,
}

fn point(data: Data<'_>, held: &Held, shown: &Shown, j: usize) -> Point {
    let layout = &data.stream.layout[j];
    let (fitted, _) = held.of_cell(shown.cell);
    let chosen = fitted.chosen(data.stream, shown.recording, j);
    let (row, class, qd) = &shown.joints[j];
    let sum = |mixture: Vec<(usize, f64)>| mixture.iter().map(|&(i, f)| f * f64::from(row[i])).sum::<f64>();
    let measured = sum(chosen.y(layout));
    let model = |beta: &DVector<f64>| measured - sum(chosen.residual(layout, beta.as_slice()));
    let (nominal, model) = (model(&nominal_beta(data.stream.structure)), model(fitted.beta()));
    Point { measured, model, nominal, qd: f64::from(*qd), class: *class }
}

pub(crate) fn report(data: Data<'_>, held: &Held) -> ReportData {
    let all = &data.sums.shown;
    let picked: Vec<&Shown> = all.iter().step_by(all.len().div_ceil(CURVE_POINTS).max(1)).collect();
    let mut recordings: Vec<(f64, String)> = Vec::new();
    let mut time_s = Vec::with_capacity(picked.len());
    let (mut offset, mut last): (f64, Option<&Shown>) = (0.0, None);
    for shown in &picked {
        if last.is_none_or(|l| l.recording != shown.recording) {
            // Recordings follow each other one row apart.
            let own = &data.stream.prepared[shown.recording];
            let end = last.map_or(0.0, |l| offset + l.time_s + own.row_period_s());
            offset = end - shown.time_s;
            recordings.push((end, own.name.clone()));
        }
        time_s.push(offset + shown.time_s);
        last = Some(shown);
    }
    ReportData {
        torque_unit: data.stream.robot.torque_unit.symbol().to_owned(),
        time_s,
        recordings,
        held_out: picked.iter().map(|s| held.of_cell(s.cell).1).collect(),
        joints: (0..data.stream.layout.len()).map(|j| curves(data, held, j, &picked)).collect(),
    }
}

fn curves(data: Data<'_>, held: &Held, j: usize, picked: &[&Shown]) -> JointCurves {
    let points: Vec<Point> = picked.iter().map(|s| point(data, held, s, j)).collect();
    let (bin_qd_rad_s, bin_residual_nm, bin_std_nm) = binned(data, held, j);
    let has_masses = data.stream.structure.base.iter().any(|b| b.nominal != 0.0);
    JointCurves {
        joint: data.stream.robot.joints[j].clone(),
        measured_nm: points.iter().map(|p| p.measured as f32).collect(),
        model_nm: points.iter().map(|p| p.model as f32).collect(),
        nominal_nm: if has_masses { points.iter().map(|p| p.nominal as f32).collect() } else { Vec::new() },
        qd_rad_s: points.iter().map(|p| p.qd as f32).collect(),
        counted: points.iter().map(|p| p.class >= Class::Counted).collect(),
        bin_qd_rad_s,
        bin_residual_nm,
        bin_std_nm,
    }
}

/// Mean and standard deviation of the residual in bins of velocity, over the counted rows that were kept.
fn binned(data: Data<'_>, held: &Held, j: usize) -> (Vec<f32>, Vec<f32>, Vec<f32>) {
    let most = data.sums.survey[j].fastest;
    let mut sums = [[0.0f64; 3]; BINS];
    if most > 0.0 {
        let points = data.sums.shown.iter().map(|s| point(data, held, s, j));
        for p in points.filter(|p| p.class >= Class::Counted) {
            let place = (p.qd / most + 1.0) * 0.5 * BINS as f64;
            let bin = &mut sums[(place as usize).min(BINS - 1)];
            let e = p.measured - p.model;
            bin[0] += 1.0;
            bin[1] += e;
            bin[2] += e * e;
        }
    }
    let (mut centre, mut mean, mut spread) = (Vec::new(), Vec::new(), Vec::new());
    for (i, [count, sum, square]) in sums.iter().enumerate().filter(|(_, s)| s[0] >= BIN_ROWS) {
        let m = sum / count;
        centre.push((((i as f64 + 0.5) / BINS as f64 * 2.0 - 1.0) * most) as f32);
        mean.push(m as f32);
        spread.push((square / count - m * m).max(0.0).sqrt() as f32);
    }
    (centre, mean, spread)
}
