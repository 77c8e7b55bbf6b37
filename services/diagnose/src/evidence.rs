//! What a report shows beside the findings: torques and residuals along the recordings, on rows that were not fitted.

use crate::families::Context;
use crate::findings::Findings;
use crate::forward::Forward;
use crate::proof::Proof;
use crate::report::Material;
use crate::scene::{Column, Piece};
use crate::split::Stretch;
use crate::unknown::since_reversal;
use lacuna_interfaces::Repair;

/// Material of the report.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Evidence {
    /// Recordings whose rows were judged.
    pub traces: Vec<Trace>,
    /// What the black box is.
    pub black_box: String,
    /// Band of torque and regressors [Hz].
    pub band_hz: f64,
    /// Speed below which a joint's rows do not count [rad/s].
    pub slow_rad_s: Vec<f64>,
    /// Rows that count, over all joints.
    pub rows: usize,
    /// What the model was chosen and fitted on.
    pub train: Vec<Stretch>,
    /// What it was judged on; empty: `train`, part by part in turn.
    pub test: Vec<Stretch>,
    /// Number of folds of `train`.
    pub folds: usize,
    /// Error that noise alone would leave, over the torque.
    pub noise_relative: f64,
    /// Forward simulation with the findings off and on, where it can be made.
    pub forward: Option<Forward>,
    /// What a simulator contains and how it compares, as label and words.
    pub simulator: Vec<(String, String)>,
    /// What a reader should beware of, in words.
    pub warnings: Vec<String>,
}

/// One stretch of a recording; all vectors run along `t_s`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Trace {
    /// File name.
    pub recording: String,
    /// Time on the recording's clock [s].
    pub t_s: Vec<f64>,
    /// Joints.
    pub joints: Vec<JointTrace>,
}

/// One joint of a [`Trace`]. Torques are filtered, and NaN where a row does not count.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct JointTrace {
    /// Recorded torque.
    pub measured: Vec<f64>,
    /// Base model's.
    pub before: Vec<f64>,
    /// Model's with all findings.
    pub after: Vec<f64>,
    /// Base's and black box's.
    pub black_box: Vec<f64>,
    /// Position [rad].
    pub q_rad: Vec<f64>,
    /// Velocity [rad/s].
    pub qd_rad_s: Vec<f64>,
    /// Further variables that a region is given in, by name.
    pub variables: Vec<(String, Vec<f64>)>,
}

/// Most stretches that are shown; the ones with the largest residual come first then.
const MOST: usize = 16;

impl Evidence {
    /// Gathers what there is to see.
    pub(crate) fn new(m: &Material<'_>, ctx: &Context<'_>, proof: &Proof<'_>, findings: &Findings) -> Self {
        let scene = proof.scene;
        let wanted = variables(findings);
        // Load is known along the recordings that the model was fitted to only.
        let load = m.test.is_none().then_some(&ctx.link);
        let power = |p: &Piece| -> f64 {
            let of = |part: &Vec<f64>| part.get(p.rows.clone()).unwrap_or_default().iter().map(|v| v * v).sum::<f64>();
            proof.before.part.iter().map(of).sum()
        };
        let mut picked: Vec<usize> = (0..scene.pieces.len()).collect();
        if picked.len() > MOST {
            picked.sort_by(|a, b| power(&scene.pieces[*b]).total_cmp(&power(&scene.pieces[*a])));
            picked.truncate(MOST);
            picked.sort_unstable();
        }
        let traces = picked.into_iter().map(|i| trace(proof, i, &wanted, load)).collect();
        let noise = &findings.baseline.noise_floor_nm;
        let size = proof.blocks.rms_each(&proof.squares(&proof.torque));
        Self {
            traces,
            black_box: proof.rival_words.clone(),
            band_hz: scene.band_hz,
            slow_rad_s: scene.slow_rad_s.clone(),
            rows: scene.mask.iter().flatten().filter(|m| **m).count(),
            folds: m.scene.folds.len(),
            noise_relative: proof.relative(noise, &size),
            ..Self::default()
        }
    }
}

/// Variables beyond angle and velocity that a region is given in.
fn variables(findings: &Findings) -> Vec<String> {
    let located = findings.mismatch.r#where.iter().flat_map(|w| &w.region);
    let found = findings.findings.iter().flat_map(|f| &f.region);
    let unknown = findings.unknown.r#where.iter().flat_map(|w| &w.region);
    let mut out: Vec<String> = Vec::new();
    for region in located.chain(found).chain(unknown) {
        if !matches!(region.variable.as_str(), "q_rad" | "qd_rad_s") && !out.contains(&region.variable) {
            out.push(region.variable.clone());
        }
    }
    out
}

fn trace(proof: &Proof<'_>, index: usize, wanted: &[String], load: Option<&crate::scene::Raw>) -> Trace {
    let scene = proof.scene;
    let piece = &scene.pieces[index];
    let at = |k: usize| piece.t0_s + k as f64 / scene.rate_hz;
    let samples: Vec<usize> = (0..piece.rows.len()).map(|i| i * scene.stride).collect();
    let joint = |j: usize| {
        let counted = |row: usize| scene.mask[j][row];
        let value = |c: &Column, row: usize| c.part.get(j).and_then(|p| p.get(row)).copied().unwrap_or(0.0);
        let measured = |row: usize| if counted(row) { value(&proof.torque, row) } else { f64::NAN };
        let model = |left: &Column| piece.rows.clone().map(|row| measured(row) - value(left, row)).collect();
        let along = |signal: &[f64]| -> Vec<f64> {
            samples.iter().map(|k| signal.get(*k).copied().unwrap_or(f64::NAN)).collect()
        };
        let variables = wanted.iter().filter_map(|name| {
            let values = match name.as_str() {
                "qdd_rad_s2" => along(&piece.qdd[j]),
                "since_reversal_rad" => along(&since_reversal(&piece.q[j], &piece.qd[j])),
                "temperature_degc" => along(piece.temperature.get(j)?),
                "load_nm" => along(load?.get(index)?.get(j)?),
                _ => return None,
            };
            Some((name.clone(), values))
        });
        JointTrace {
            measured: piece.rows.clone().map(measured).collect(),
            before: model(&proof.before),
            after: model(&proof.after),
            black_box: model(&proof.rival),
            q_rad: along(&piece.q[j]),
            qd_rad_s: along(&piece.qd[j]),
            variables: variables.collect(),
        }
    };
    Trace {
        recording: scene.names.get(piece.recording).cloned().unwrap_or_default(),
        t_s: samples.iter().map(|k| at(*k)).collect(),
        joints: (0..scene.joints).map(joint).collect(),
    }
}

/// What was repaired, the stretches of one file together.
pub(crate) fn repairs(m: &Material<'_>) -> Vec<Repair> {
    let mut out: Vec<Repair> = Vec::new();
    for repair in m.scene.repairs.iter().chain(m.test.iter().flat_map(|t| &t.scene.repairs)) {
        match out.iter_mut().find(|r| r.file == repair.file && r.kind == repair.kind && r.signal == repair.signal) {
            Some(same) => same.count += repair.count,
            None => out.push(repair.clone()),
        }
    }
    out
}
