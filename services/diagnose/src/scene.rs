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

use crate::split::Split;
use lacuna_estimation::filter::{
    Interpolation, SpikeRule, Stencil, ZeroPhase, differentiate, noise_sd, regular_grid, remove_spikes, resample,
    segments,
};
use lacuna_estimation::stats;
use lacuna_interfaces::{BadInput, Recording, Repair, RepairKind, RobotFile};
use lacuna_physics::{Motion, RigidBody};
use std::ops::Range;

/// Fewest folds; fewer recordings than this are cut.
pub const MIN_FOLDS: usize = 5;
/// Highest rate of the analysis [Hz]; faster recordings are thinned out.
const MAX_RATE_HZ: f64 = 1000.0;
/// Widest band [Hz].
const MAX_BAND_HZ: f64 = 40.0;
/// Narrowest band that is chosen without being asked for [Hz].
const MIN_BAND_HZ: f64 = 8.0;

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
        let rate_hz = common_rate(recordings)?;
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
            raw.extend(cut(robot, recording, i, global, rate_hz, &mut repairs)?);
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
            None => choose_band(body.as_ref(), &pi, &raw, rate_hz),
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

    /// Row rate [Hz].
    pub fn row_rate_hz(&self) -> f64 {
        self.rate_hz / self.stride as f64
    }

    /// Recordings of one number as a fold; without numbers whole recordings, too few of them cut.
    fn make_folds(&self, recordings: usize, numbers: &[usize]) -> Vec<Range<usize>> {
        if numbers.len() == recordings && !numbers.is_empty() {
            let own = |n: usize| self.pieces.iter().filter(move |p| numbers.get(p.recording) == Some(&n));
            let ends = |n: usize| Some(own(n).next()?.rows.start..own(n).next_back()?.rows.end);
            return (0..=numbers.iter().copied().max().unwrap_or(0)).filter_map(ends).collect();
        }
        let mut whole: Vec<Range<usize>> = Vec::new();
        for r in 0..recordings {
            let mut own = self.pieces.iter().filter(|p| p.recording == r);
            if let Some(first) = own.next() {
                let end = own.next_back().map_or(first.rows.end, |p| p.rows.end);
                whole.push(first.rows.start..end);
            }
        }
        if whole.len() >= MIN_FOLDS {
            return whole;
        }
        // Too few recordings: cut them, the longer ones into more parts.
        let target = self.rows as f64 / (MIN_FOLDS + 1) as f64;
        let mut out = Vec::new();
        for r in whole {
            let parts = ((r.len() as f64 / target).round() as usize).max(1);
            for k in 0..parts {
                out.push(r.start + k * r.len() / parts..r.start + (k + 1) * r.len() / parts);
            }
        }
        out
    }

    /// Speed below which friction is in doubt: a small share of the typical speed, above the encoder's noise.
    fn slow_speed(&self, j: usize) -> f64 {
        let mut speeds: Vec<f64> =
            self.pieces.iter().flat_map(|p| p.qd[j].iter().map(|v| v.abs())).filter(|v| *v > 1e-4).collect();
        let typical = stats::quantile_in_place(&mut speeds, 0.75);
        if typical.is_finite() { (0.04 * typical).clamp(1e-3, 0.05) } else { 0.05 }
    }

    /// Rows of joint `j` that count: drive on, faster than the slow speed, 25 ms away from slower samples.
    fn moving(&self, j: usize) -> Vec<bool> {
        let margin = (0.025 * self.rate_hz).round() as usize;
        let edge = (3.0 * self.rate_hz / self.band_hz).round() as usize;
        let mut mask = vec![false; self.rows];
        for piece in &self.pieces {
            let n = piece.len();
            let mut ok = vec![true; n];
            for k in 0..n {
                if piece.qd[j][k].abs() < self.slow_rad_s[j] || !piece.enabled[k] {
                    ok[k.saturating_sub(margin)..(k + margin + 1).min(n)].fill(false);
                }
            }
            for (i, row) in piece.rows.clone().enumerate() {
                let k = i * self.stride;
                mask[row] = ok[k] && k >= edge && k + edge < n;
            }
        }
        mask
    }

    /// Rows count above these speeds from now on [rad/s].
    pub fn count_above(&mut self, slow_rad_s: &[f64]) {
        self.slow_rad_s = slow_rad_s.to_vec();
        self.mask = (0..self.joints).map(|j| self.moving(j)).collect();
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
        Column { part }
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

fn common_rate(recordings: &[Recording]) -> Result<f64, BadInput> {
    let mut rates: Vec<f64> = recordings.iter().filter_map(Recording::median_period_s).map(|dt| 1.0 / dt).collect();
    let rate = stats::median_in_place(&mut rates);
    if !(rate.is_finite() && rate > 1.0) {
        return Err(BadInput::new("recordings: found no usable sample rate; expected at least one recording"));
    }
    Ok(rate.min(MAX_RATE_HZ))
}

/// Cuts a recording at gaps, repairs spikes and puts it on the common grid.
fn cut(
    robot: &RobotFile,
    recording: &Recording,
    index: usize,
    global_s: f64,
    rate_hz: f64,
    repairs: &mut Vec<Repair>,
) -> Result<Vec<Piece>, BadInput> {
    let joints = recording.q_rad.len();
    repairs.extend(recording.repairs.iter().cloned());
    let mut tau = recording.tau_nm.clone();
    for (j, signal) in tau.iter_mut().enumerate() {
        let count = remove_spikes(signal, &SpikeRule::default()).len() as u64;
        if count > 0 {
            let signal = format!("tau{}", j + 1);
            repairs.push(Repair { file: recording.name.clone(), kind: RepairKind::Spike, signal, count });
        }
    }
    let column = |name: &String| recording.extra.get(name).cloned();
    let temperature: Vec<Vec<f64>> = match robot.columns.temperature.as_slice() {
        [] => {
            (1..=joints).filter_map(|j| column(&format!("temp{j}")).or_else(|| column(&format!("x_temp{j}")))).collect()
        }
        names => names.iter().filter_map(column).collect(),
    };
    let temperature = if temperature.len() == joints { temperature } else { Vec::new() };
    let enabled = robot.columns.enabled.as_ref().and_then(column);
    let native = recording.median_period_s().map_or(rate_hz, |dt| 1.0 / dt);
    let gap = 8.0 / native;
    let mut out = Vec::new();
    for range in segments(&recording.t_s, gap) {
        let t = &recording.t_s[range.clone()];
        let (Some(first), Some(last)) = (t.first(), t.last()) else { continue };
        if (last - first) * rate_hz < 64.0 {
            continue;
        }
        let grid = regular_grid(*first, *last, 1.0 / rate_hz);
        let even = t.len() == grid.len() && t.iter().zip(&grid).all(|(a, b)| (a - b).abs() < 0.02 / rate_hz);
        let fit = |x: &[f64], how| -> Result<Vec<f64>, BadInput> {
            let x = &x[range.clone()];
            if even {
                return Ok(x.to_vec());
            }
            if native > 1.5 * rate_hz {
                // Thinning out: low-pass first, or what is above folds down.
                let smooth = ZeroPhase::butterworth(4, 0.4 * rate_hz, native).and_then(|f| f.apply(x))?;
                return Ok(resample(t, &smooth, &grid, how)?);
            }
            Ok(resample(t, x, &grid, how)?)
        };
        let all = |signals: &[Vec<f64>], how| signals.iter().map(|s| fit(s, how)).collect::<Result<Vec<_>, _>>();
        let on = match &enabled {
            Some(e) => fit(e, Interpolation::Linear)?.iter().map(|v| *v > 0.999).collect(),
            None => vec![true; grid.len()],
        };
        out.push(Piece {
            recording: index,
            t0_s: *first,
            global_s: global_s + first - recording.t_s.first().unwrap_or(first),
            q: all(&recording.q_rad, Interpolation::Cubic)?,
            qd: vec![Vec::new(); joints],
            qdd: vec![Vec::new(); joints],
            tau: all(&tau, Interpolation::Linear)?,
            temperature: all(&temperature, Interpolation::Linear)?,
            enabled: on,
            rows: 0..0,
        });
    }
    Ok(out)
}

/// The band in which the encoder's noise, twice differentiated and times the inertia, stays below half the
/// torque's noise: (2πf)² = ½ √5 σ_τ / (M σ_q).
fn choose_band(body: &dyn RigidBody, pi: &[f64], pieces: &[Piece], rate_hz: f64) -> f64 {
    let n = body.joint_count();
    let mut band = MAX_BAND_HZ;
    let top = (rate_hz / 6.0).min(MAX_BAND_HZ);
    for j in 0..n {
        let sd = |signals: &dyn Fn(&Piece) -> &Vec<f64>| {
            let mut all: Vec<f64> = pieces.iter().filter_map(|p| noise_sd(signals(p)).ok()).collect();
            stats::median_in_place(&mut all)
        };
        let sd_q = sd(&|p| &p.q[j]);
        let sd_tau = sd(&|p| &p.tau[j]);
        let inertia = inertia_of(body, pi, pieces, j, rate_hz);
        let f = (0.5 * 5f64.sqrt() * sd_tau / (inertia * sd_q)).sqrt() / std::f64::consts::TAU;
        if f.is_finite() {
            band = band.min(f);
        }
    }
    band.clamp(MIN_BAND_HZ.min(top), top)
}

/// Own inertia of joint `j` at its median pose; if the robot file has no masses, from the torque's size.
fn inertia_of(body: &dyn RigidBody, pi: &[f64], pieces: &[Piece], j: usize, rate_hz: f64) -> f64 {
    let n = body.joint_count();
    let q: Vec<f64> = (0..n)
        .map(|i| stats::median(&pieces.iter().flat_map(|p| p.q[i].iter().copied().step_by(50)).collect::<Vec<_>>()))
        .collect();
    let zero = vec![0.0; n];
    let mut unit = zero.clone();
    unit[j] = 1.0;
    let (mut with, mut without) = (zero.clone(), zero.clone());
    let a = body.torque(&Motion { q_rad: &q, qd_rad_s: &zero, qdd_rad_s2: &unit }, pi, &mut with);
    let b = body.torque(&Motion { q_rad: &q, qd_rad_s: &zero, qdd_rad_s2: &zero }, pi, &mut without);
    if a.is_ok() && b.is_ok() && with[j] - without[j] > 1e-9 {
        return with[j] - without[j];
    }
    // The slope of the torque over second differences of a tenth of a second, slow enough to be motion rather
    // than noise. Gravity and friction bias it; a band needs no more than its order of magnitude.
    let step = ((0.1 * rate_hz).round() as usize).max(1);
    let (mut up, mut down) = (0.0, 0.0);
    for p in pieces {
        let mean = stats::mean(&p.tau[j]);
        for (w, tau) in p.q[j].windows(2 * step + 1).zip(&p.tau[j][step.min(p.len())..]) {
            let bend = (w[0] + w[2 * step] - 2.0 * w[step]) * (rate_hz / step as f64).powi(2);
            up += bend * (tau - mean);
            down += bend * bend;
        }
    }
    (up / f64::max(down, 1e-30)).abs().max(1e-12)
}
