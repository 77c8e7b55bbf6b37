//! Recordings made ready for regression: one rate, repaired, exact derivatives, one filter for everything.
//!
//! Positions are low-passed (zero phase) at twice the band and differentiated with the seven-point stencil.
//! Torques and every regressor are low-passed at the band with the same filter and kept at about five times
//! the band (only the same filter on both sides reaches the sensor floor).
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | piece | stretch of a recording without a gap | |
//! | row | one sample after the filter, at the row rate | |
//! | fold | rows left out together; at least [`MIN_FOLDS`] | |

mod band;
mod cut;
mod rows;

use crate::split::Split;
use crate::whiten::Whitening;

use lacuna_estimation::filter::{Stencil, ZeroPhase, differentiate};
use lacuna_interfaces::{BadInput, Recording, Repair, RobotFile};
use lacuna_physics::{Motion, RigidBody};
pub use rows::MIN_FOLDS;
use std::ops::Range;
use std::sync::OnceLock;

/// A stretch of one recording on a regular grid.
#[derive(Debug, Clone)]
pub struct Piece {
    /// Index of the recording it came from.
    pub recording: usize,
    /// Time of the first sample in its recording [s].
    pub t0_s: f64,
    /// Time of the first sample since the robot was switched on [s].
    pub global_s: f64,
    /// Positions [joint][sample] [rad].
    pub q: Vec<Vec<f64>>,
    /// Velocities [rad/s].
    pub qd: Vec<Vec<f64>>,
    /// Accelerations [rad/s²].
    pub qdd: Vec<Vec<f64>>,
    /// Torques as recorded, repaired [Nm].
    pub tau: Vec<Vec<f64>>,
    /// Temperatures [°C]; empty if not recorded.
    pub temperature: Vec<Vec<f64>>,
    /// Link-side encoder positions of the first joints [rad]; empty if not recorded.
    pub link_q: Vec<Vec<f64>>,
    /// Torques of the joint torque sensors [Nm]; empty unless every joint has one.
    pub sensor: Vec<Vec<f64>>,
    /// Whether the drive was on.
    pub enabled: Vec<bool>,
    /// Where its rows are.
    pub rows: Range<usize>,
}

impl Piece {
    /// Number of samples.
    pub fn len(&self) -> usize {
        self.enabled.len()
    }

    /// True if there is no sample.
    pub fn is_empty(&self) -> bool {
        self.enabled.is_empty()
    }
}

/// Rows of one joint set: `part[joint]` is empty where the column is zero.
#[derive(Debug, Clone, Default)]
pub struct Column {
    /// Rows per joint.
    pub part: Vec<Vec<f64>>,
    /// The same through a whitening filter, once it was asked for.
    white: OnceLock<Vec<Vec<f64>>>,
}

impl Column {
    /// Of rows per joint.
    pub fn new(part: Vec<Vec<f64>>) -> Self {
        Self { part, white: OnceLock::new() }
    }

    /// Rows through the filter of a search; it is that of one search all the time.
    pub(crate) fn white(&self, whitening: &Whitening) -> &[Vec<f64>] {
        self.white.get_or_init(|| whitening.apply(&self.part))
    }

    /// Rows to be changed.
    pub(crate) fn rows_mut(&mut self) -> &mut Vec<Vec<f64>> {
        self.white = OnceLock::new();
        &mut self.part
    }

    /// Every row times `factor`.
    pub(crate) fn scale(&mut self, factor: f64) {
        self.rows_mut().iter_mut().flatten().for_each(|v| *v *= factor);
    }
}

/// Signals at the full rate before the filter: `[piece][joint]`, empty where zero.
pub type Raw = Vec<Vec<Vec<f64>>>;

/// Everything the candidates are computed from.
pub struct Scene {
    /// The robot file.
    pub robot: RobotFile,
    /// Text of its URDF.
    pub urdf: Option<String>,
    /// Its mechanics.
    pub body: Box<dyn RigidBody>,
    /// Dynamic parameters of the robot file.
    pub pi: Vec<f64>,
    /// Joints.
    pub joints: usize,
    /// Rate of the pieces [Hz].
    pub rate_hz: f64,
    /// Band of torque and regressors [Hz].
    pub band_hz: f64,
    /// Samples per row.
    pub stride: usize,
    /// The stretches.
    pub pieces: Vec<Piece>,
    /// Names of the recordings.
    pub names: Vec<String>,
    /// Number of rows.
    pub rows: usize,
    /// Rows of each fold.
    pub folds: Vec<Range<usize>>,
    /// Which rows count, per joint.
    pub mask: Vec<Vec<bool>>,
    /// Rows in which contacts are looked for.
    pub quiet: Vec<bool>,
    /// Speed below which a joint's friction is in doubt [rad/s].
    pub slow_rad_s: Vec<f64>,
    /// What was repaired.
    pub repairs: Vec<Repair>,
    filter: ZeroPhase,
}

/// How the recordings are to be conditioned; `None` is chosen from the data.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Conditioning {
    /// Band of torque and regressors [Hz].
    pub band_hz: Option<f64>,
    /// Speed above which a joint counts as moving [rad/s].
    pub moving_rad_s: Option<f64>,
    /// Time at which each recording starts since the robot was switched on [s].
    pub start_s: Vec<f64>,
    /// What trains and what tests.
    pub split: Split,
    /// Number of the fold of each recording, rising from 0; empty: chosen from the recordings.
    pub folds: Vec<usize>,
}

impl Scene {
    /// Conditions `recordings` of the robot.
    ///
    /// # Errors
    /// [`BadInput`] if there is nothing to analyse or a recording cannot be used.
    pub fn new(
        robot: &RobotFile,
        urdf: Option<&str>,
        recordings: &[Recording],
        how: &Conditioning,
    ) -> Result<Self, BadInput> {
        let body = lacuna_physics::build(robot, urdf)?;
        let pi = body.nominal();
        let joints = robot.joint_count();
        let rate_hz = cut::common_rate(recordings)?;
        let mut repairs = Vec::new();
        let mut raw = Vec::new();
        let mut clock = 0.0;
        for (i, recording) in recordings.iter().enumerate() {
            if recording.q_rad.len() != joints || recording.tau_nm.len() != joints {
                return Err(BadInput::new(format!("found {} joints; expected {joints}", recording.q_rad.len()))
                    .in_file(&recording.name));
            }
            let global = how.start_s.get(i).copied().unwrap_or(clock);
            clock = global + recording.duration_s();
            raw.extend(cut::cut(robot, recording, i, global, rate_hz, &mut repairs)?);
        }
        if raw.is_empty() {
            return Err(BadInput::new(
                "recordings: found no stretch of at least 64 regular samples; expected one at least",
            ));
        }
        let band_hz = match how.band_hz {
            Some(f) if f > 0.0 && f < 0.45 * rate_hz => f,
            Some(f) => {
                return Err(BadInput::new(format!("band: found {f} Hz; expected 0 to {:.1} Hz", 0.45 * rate_hz)));
            }
            None => band::choose(body.as_ref(), &pi, &raw, rate_hz),
        };
        let stride = ((rate_hz / (5.0 * band_hz)).round() as usize).max(1);
        let position_filter = ZeroPhase::butterworth(4, (2.0 * band_hz).min(0.45 * rate_hz), rate_hz)?;
        let filter = ZeroPhase::butterworth(4, band_hz, rate_hz)?;
        let mut rows = 0;
        for piece in &mut raw {
            for j in 0..joints {
                position_filter.apply_in_place(&mut piece.q[j])?;
                piece.qd[j] = differentiate(&piece.q[j], 1.0 / rate_hz, Stencil::Seven, 1)?;
                piece.qdd[j] = differentiate(&piece.q[j], 1.0 / rate_hz, Stencil::Seven, 2)?;
            }
            for link in &mut piece.link_q {
                position_filter.apply_in_place(link)?;
            }
            let n = piece.len().div_ceil(stride);
            piece.rows = rows..rows + n;
            rows += n;
        }
        let mut scene = Self {
            robot: robot.clone(),
            urdf: urdf.map(str::to_owned),
            body,
            pi,
            joints,
            rate_hz,
            band_hz,
            stride,
            pieces: raw,
            names: recordings.iter().map(|r| r.name.clone()).collect(),
            rows,
            folds: Vec::new(),
            mask: Vec::new(),
            quiet: vec![true; rows],
            slow_rad_s: Vec::new(),
            repairs,
            filter,
        };
        scene.folds = scene.make_folds(recordings.len(), &how.folds);
        scene.slow_rad_s = (0..joints).map(|j| how.moving_rad_s.unwrap_or_else(|| scene.slow_speed(j))).collect();
        scene.mask = (0..joints).map(|j| scene.moving(j)).collect();
        for j in 0..joints {
            if scene.mask[j].iter().filter(|m| **m).count() < 20 {
                return Err(BadInput::new(format!(
                    "joint {}: found hardly any motion above {:.3} rad/s; expected recordings in which it moves",
                    scene.robot.joints[j], scene.slow_rad_s[j]
                )));
            }
        }
        Ok(scene)
    }

    /// Whether every joint's torque was measured behind the gear too.
    pub fn has_sensors(&self) -> bool {
        self.pieces.iter().all(|p| p.sensor.len() == self.joints)
    }

    /// Row rate [Hz].
    pub fn row_rate_hz(&self) -> f64 {
        self.rate_hz / self.stride as f64
    }

    /// Low-passes a full-rate signal as torques and regressors are; false if it cannot be.
    pub fn smooth(&self, signal: &mut [f64]) -> bool {
        self.filter.apply_in_place(signal).is_ok()
    }

    /// Rows within these stretches (time since switch-on, from, to) stop counting; contacts are not looked for
    /// within 0.3 s of them.
    pub fn blank(&mut self, stretches: &[(f64, f64)]) {
        for piece in &self.pieces {
            for (i, row) in piece.rows.clone().enumerate() {
                let t = piece.global_s + (i * self.stride) as f64 / self.rate_hz;
                if stretches.iter().any(|(a, b)| (*a..=*b).contains(&t)) {
                    self.mask.iter_mut().for_each(|m| m[row] = false);
                }
                if stretches.iter().any(|(a, b)| (a - 0.23..=b + 0.23).contains(&t)) {
                    self.quiet[row] = false;
                }
            }
        }
    }

    /// Which rows count, and where it is quiet, to be restored by [`Self::count_again`].
    pub fn counting(&self) -> (Vec<Vec<bool>>, Vec<bool>) {
        (self.mask.clone(), self.quiet.clone())
    }

    /// Undoes what [`Self::blank`] did since.
    pub fn count_again(&mut self, (mask, quiet): &(Vec<Vec<bool>>, Vec<bool>)) {
        self.mask.clone_from(mask);
        self.quiet.clone_from(quiet);
    }

    /// Filters signals and keeps the rows; rows that do not count become 0.
    pub fn column(&self, raw: Raw) -> Column {
        let mut part = vec![Vec::new(); self.joints];
        for (piece, mut signals) in self.pieces.iter().zip(raw) {
            let mut views: Vec<&mut [f64]> =
                signals.iter_mut().filter(|s| !s.is_empty()).map(Vec::as_mut_slice).collect();
            if self.filter.apply_columns(&mut views).is_err() {
                // A candidate that is not finite somewhere explains nothing there.
                for v in &mut views {
                    v.iter_mut().filter(|x| !x.is_finite()).for_each(|x| *x = 0.0);
                }
                let _ = self.filter.apply_columns(&mut views);
            }
            for (j, s) in signals.iter().enumerate() {
                if s.is_empty() {
                    continue;
                }
                let rows = &mut part[j];
                if rows.is_empty() {
                    *rows = vec![0.0; self.rows];
                }
                for (i, row) in piece.rows.clone().enumerate() {
                    if self.mask[j][row] {
                        rows[row] = s[i * self.stride];
                    }
                }
            }
        }
        Column::new(part)
    }

    /// Column of one joint from a function of piece and sample.
    pub fn joint_column(&self, j: usize, f: impl Fn(&Piece, usize) -> f64) -> Column {
        self.column(
            self.pieces
                .iter()
                .map(|p| {
                    let mut out = vec![Vec::new(); self.joints];
                    out[j] = (0..p.len()).map(|k| f(p, k)).collect();
                    out
                })
                .collect(),
        )
    }

    /// Column of all joints from a function of piece and sample that writes one value per joint.
    pub fn structure_column(&self, f: impl Fn(&Piece, usize, &mut [f64])) -> Column {
        self.column(self.structure_raw(f))
    }

    /// Signals of all joints from a function of piece and sample.
    pub fn structure_raw(&self, f: impl Fn(&Piece, usize, &mut [f64])) -> Raw {
        self.pieces
            .iter()
            .map(|p| {
                let mut out = vec![vec![0.0; p.len()]; self.joints];
                let mut values = vec![0.0; self.joints];
                for k in 0..p.len() {
                    values.fill(0.0);
                    f(p, k, &mut values);
                    for (o, v) in out.iter_mut().zip(&values) {
                        o[k] = *v;
                    }
                }
                out
            })
            .collect()
    }

    /// Calls `f` with the motion at a sample.
    pub fn with_motion<T>(&self, p: &Piece, k: usize, f: impl FnOnce(&Motion<'_>) -> T) -> T {
        let mut q = [0.0; lacuna_interfaces::MAX_JOINTS];
        let mut qd = q;
        let mut qdd = q;
        let n = self.joints;
        for j in 0..n {
            q[j] = p.q[j][k];
            qd[j] = p.qd[j][k];
            qdd[j] = p.qdd[j][k];
        }
        f(&Motion { q_rad: &q[..n], qd_rad_s: &qd[..n], qdd_rad_s2: &qdd[..n] })
    }

    /// Torques of `pi` along the recordings, at the full rate.
    pub fn rigid_raw(&self, body: &dyn RigidBody, pi: &[f64]) -> Raw {
        self.structure_raw(|p, k, out| {
            self.with_motion(p, k, |m| {
                if body.torque(m, pi, out).is_err() {
                    out.fill(0.0);
                }
            });
        })
    }

    /// Piece and sample of a row.
    pub fn place(&self, row: usize) -> Option<(&Piece, usize)> {
        let piece = self.pieces.iter().find(|p| p.rows.contains(&row))?;
        Some((piece, (row - piece.rows.start) * self.stride))
    }

    /// A full-rate signal of joint `j` at every row, unfiltered.
    pub fn at_rows(&self, f: impl Fn(&Piece, usize) -> f64) -> Vec<f64> {
        let mut out = vec![0.0; self.rows];
        for p in &self.pieces {
            for (i, row) in p.rows.clone().enumerate() {
                out[row] = f(p, i * self.stride);
            }
        }
        out
    }
}

/// A constant of one at joint `j`, full rate.
pub fn constant(scene: &Scene, j: usize) -> Raw {
    scene
        .pieces
        .iter()
        .map(|p| {
            let mut out = vec![Vec::new(); scene.joints];
            out[j] = vec![1.0; p.len()];
            out
        })
        .collect()
}
