//! Forward simulation under the model, on data that the fit has not seen.
//!
//! A recording carries neither controller nor reference, so the loop cannot be closed as it was. The model is therefore
//! started at the measured state every 0.2 s, driven by the measured torque, and what it predicts is
//! held against the measured position a horizon later: the usual multi-step check. An error of the torque that the
//! inverse dynamics hide under a large torque elsewhere shows here as a joint that runs away.
//!
//! ```text
//! v⁺ = v + Δt M⁻¹ (τ − h(q, v) − f_v v − o − λ),   λ ∈ f_c Sgn v⁺      drift, kick, drift (Moreau's time stepping)
//! ```
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | M, h | inertia matrix and all other rigid-body torque, from the same regressor as the fit | kg m², Nm |
//! | f_v, f_c, o | friction of the model | Nm s/rad, Nm, Nm |
//! | τ | measured torque below the position band | Nm |

use crate::base::Structure;
use crate::columns::Term;
use crate::condition::{Plan, Stretch, condition};
use crate::split::Span;
use crate::stream::Stream;
use lacuna_interfaces::{Joints, MAX_JOINTS, Recording, RobotFile};
use lacuna_physics::{Motion, RigidBody};
use nalgebra::{DVector, SMatrix};
use rayon::prelude::*;
use serde::Serialize;

/// How far ahead is predicted [s].
pub const HORIZONS_S: [f64; 3] = [0.05, 0.1, 0.2];
/// The longest of them: a window.
const HORIZON_S: f64 = 0.2;
/// Recorded time around a window that the filters start in, in periods of the band.
const MARGIN: f64 = 3.0;
/// Most windows over all folds: more tells nothing new and costs time.
const MOST_WINDOWS: usize = 120;
/// Longest time step [s].
const STEP_S: f64 = 1e-3;
/// Sweeps over the joints that solve for their friction at most.
const SWEEPS: usize = 40;
/// A simulated joint this far from the measured one [rad; m] has run away.
const LOST: f64 = 10.0;

/// Root mean square position error per joint, horizon by horizon.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Predicted {
    /// `rms_rad[horizon][joint]` [rad; prismatic: m].
    pub rms_rad: Vec<Vec<f64>>,
    /// Windows behind it.
    pub windows: usize,
    /// Windows in which this model could not be simulated: its inertia matrix is not positive definite there, the pose
    /// leaves the workspace, or a joint runs away.
    pub failed: usize,
}

/// What a model predicts of the held-out motion.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Forward {
    /// How far ahead [s].
    pub horizons_s: Vec<f64>,
    /// The identified model.
    pub identified: Predicted,
    /// The robot file's own model, without friction; absent if it has no masses or cannot be simulated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nominal: Option<Predicted>,
    /// No model at all: the velocity stays as it is.
    pub held_velocity: Predicted,
}

/// A model that can be simulated.
struct Simulated<'a> {
    body: &'a dyn RigidBody,
    pi: Vec<f64>,
    f_v: Joints,
    f_c: Joints,
    offset: Joints,
}

impl<'a> Simulated<'a> {
    /// Of base parameters: what merged is zero, which is the same robot to every torque.
    fn of(body: &'a dyn RigidBody, structure: &Structure, beta: &DVector<f64>) -> Self {
        let mut model = Self { pi: vec![0.0; body.parameters().len()], ..Self::nominal(body) };
        for (base, value) in structure.base.iter().zip(beta.iter()) {
            match structure.columns[base.column].term {
                Term::Rigid(k) => model.pi[k] = *value,
                // Friction that feeds the motion is a fit's mistake, which a simulation would only magnify.
                Term::Viscous(j) => model.f_v[j] = value.max(0.0),
                Term::Coulomb(j) => model.f_c[j] = value.max(0.0),
                Term::Offset(j) => model.offset[j] = *value,
            }
        }
        model
    }

    fn nominal(body: &'a dyn RigidBody) -> Self {
        let none = Joints::default();
        Self { body, pi: body.nominal(), f_v: none, f_c: none, offset: none }
    }

    /// M and h at a state; `None` where there is none.
    fn dynamics(&self, q: &[f64], qd: &[f64]) -> Option<(Inertia, Joints)> {
        let n = q.len();
        let mut qdd = Joints::default();
        let mut rest = Joints::default();
        let mut with = Joints::default();
        let torque = |qdd: &[f64], tau: &mut [f64]| {
            self.body.torque(&Motion { q_rad: q, qd_rad_s: qd, qdd_rad_s2: qdd }, &self.pi, tau).ok()
        };
        torque(&qdd[..n], &mut rest[..n])?;
        // Joints not in use are unit masses of their own.
        let mut inertia = Inertia::identity();
        for i in 0..n {
            qdd[i] = 1.0;
            torque(&qdd[..n], &mut with[..n])?;
            qdd[i] = 0.0;
            (0..n).for_each(|j| inertia[(j, i)] = with[j] - rest[j]);
        }
        Some((inertia, rest))
    }
}

type Inertia = SMatrix<f64, MAX_JOINTS, MAX_JOINTS>;

/// State of a simulation.
#[derive(Clone, Copy)]
struct State {
    q: Joints,
    v: Joints,
    /// Acceleration of the last step, to look half a step ahead.
    a: Joints,
    /// Friction torque of the last step.
    lambda: Joints,
}

impl State {
    /// One step under the torques `tau`; `None` if the robot has no dynamics there.
    fn step(&mut self, model: &Simulated<'_>, tau: &Joints, n: usize, dt: f64) -> Option<()> {
        let half = 0.5 * dt;
        let mut v_half = Joints::default();
        for i in 0..n {
            self.q[i] += half * self.v[i];
            v_half[i] = self.v[i] + half * self.a[i];
        }
        let (inertia, rest) = model.dynamics(&self.q[..n], &v_half[..n])?;
        let inverse = inertia.cholesky()?.inverse();
        let before = self.v;
        let mut force = Joints::default();
        for i in 0..n {
            force[i] = tau[i] - rest[i] - model.f_v[i] * v_half[i] - model.offset[i] - self.lambda[i];
        }
        for i in 0..n {
            self.v[i] += dt * (0..n).map(|j| inverse[(i, j)] * force[j]).sum::<f64>();
        }
        for _ in 0..SWEEPS {
            let mut change = 0.0f64;
            for i in (0..n).filter(|&i| model.f_c[i] > 0.0) {
                let wanted = self.lambda[i] + self.v[i] / (dt * inverse[(i, i)]);
                let more = wanted.clamp(-model.f_c[i], model.f_c[i]) - self.lambda[i];
                (0..n).for_each(|j| self.v[j] -= dt * inverse[(j, i)] * more);
                self.lambda[i] += more;
                change = change.max(more.abs() / model.f_c[i]);
            }
            if change < 1e-10 {
                break;
            }
        }
        for i in 0..n {
            self.a[i] = (self.v[i] - before[i]) / dt;
            self.q[i] += half * self.v[i];
        }
        self.q[..n].iter().all(|q| q.is_finite()).then_some(())
    }
}

/// A piece of a stretch to predict, by its first sample.
struct Window {
    stretch: Stretch,
    first: usize,
}

impl Window {
    /// The window of `recording` from `from_s` on; `None` across a gap, with the drive off, or too close to an end.
    fn cut(recording: &Recording, robot: &RobotFile, plan: &Plan, from_s: f64) -> Option<Self> {
        let margin = MARGIN / plan.band_hz;
        let part = slice(recording, from_s - margin, from_s + HORIZON_S + margin);
        let conditioned = condition(&part, robot, plan).ok()?;
        conditioned.stretches.into_iter().find_map(|stretch| {
            let first = ((from_s - stretch.start_s) / stretch.period_s).ceil().max(0.0) as usize;
            let length = Self::samples(&stretch, HORIZON_S);
            let begins = stretch.time_s(first) < from_s + 2.0 * stretch.period_s;
            let on = stretch.usable.get(first..first + length + 2)?.iter().all(|u| *u);
            (begins && on).then_some(Self { stretch, first })
        })
    }

    fn at(columns: &[Vec<f64>], k: usize) -> Joints {
        let mut out = Joints::default();
        out.iter_mut().zip(columns).for_each(|(o, c)| *o = c.get(k).copied().unwrap_or(f64::NAN));
        out
    }

    /// Samples until a horizon.
    fn samples(stretch: &Stretch, horizon_s: f64) -> usize {
        (horizon_s / stretch.period_s).round() as usize
    }

    fn measured(&self, horizon_s: f64) -> Joints {
        Self::at(&self.stretch.q_rad, self.first + Self::samples(&self.stretch, horizon_s))
    }

    /// Position error at every horizon; `None` if the model cannot be simulated.
    fn errors(&self, model: &Simulated<'_>, n: usize) -> Option<[Joints; HORIZONS_S.len()]> {
        let Stretch { period_s, tau_nm, .. } = &self.stretch;
        let substeps = (period_s / STEP_S).ceil().max(1.0);
        let dt = period_s / substeps;
        let mut state = State {
            q: Self::at(&self.stretch.q_rad, self.first),
            v: Self::at(&self.stretch.qd_rad_s, self.first),
            a: Self::at(&self.stretch.qdd_rad_s2, self.first),
            lambda: Joints::default(),
        };
        (0..n).for_each(|i| state.lambda[i] = model.f_c[i] * if state.v[i] == 0.0 { 0.0 } else { state.v[i].signum() });
        let mut errors = [Joints::default(); HORIZONS_S.len()];
        let mut done = 0;
        for (error, horizon) in errors.iter_mut().zip(HORIZONS_S) {
            while done < Self::samples(&self.stretch, horizon) {
                let (a, b) = (Self::at(tau_nm, self.first + done), Self::at(tau_nm, self.first + done + 1));
                for s in 0..substeps as usize {
                    let share = (s as f64 + 0.5) / substeps;
                    let tau = std::array::from_fn(|i| a[i] + share * (b[i] - a[i]));
                    state.step(model, &tau, n, dt)?;
                }
                done += 1;
            }
            let measured = self.measured(horizon);
            for i in 0..n {
                error[i] = state.q[i] - measured[i];
                if error[i].is_nan() || error[i].abs() > LOST {
                    return None;
                }
            }
        }
        Some(errors)
    }

    fn held_velocity(&self, n: usize) -> [Joints; HORIZONS_S.len()] {
        let (q, v) = (Self::at(&self.stretch.q_rad, self.first), Self::at(&self.stretch.qd_rad_s, self.first));
        HORIZONS_S.map(|horizon| {
            let measured = self.measured(horizon);
            // The horizon in whole samples, as the measurement.
            let t = Self::samples(&self.stretch, horizon) as f64 * self.stretch.period_s;
            let mut error = Joints::default();
            (0..n).for_each(|i| error[i] = q[i] + v[i] * t - measured[i]);
            error
        })
    }
}

/// Sums of squares over windows.
#[derive(Debug, Clone, Default)]
struct Sums {
    squares: [Joints; HORIZONS_S.len()],
    windows: usize,
    failed: usize,
}

impl Sums {
    fn add(&mut self, errors: Option<[Joints; HORIZONS_S.len()]>) {
        let Some(errors) = errors else {
            self.failed += 1;
            return;
        };
        self.windows += 1;
        for (sums, errors) in self.squares.iter_mut().zip(errors) {
            sums.iter_mut().zip(errors).for_each(|(s, e)| *s += e * e);
        }
    }

    fn predicted(&self, n: usize) -> Option<Predicted> {
        let count = self.windows as f64;
        let rms = |sums: &Joints| sums[..n].iter().map(|s| (s / count).sqrt()).collect();
        (self.windows > 0).then(|| Predicted {
            rms_rad: self.squares.iter().map(rms).collect(),
            windows: self.windows,
            failed: self.failed,
        })
    }
}

/// A fit, and what it has not seen.
#[derive(Clone, Copy)]
pub(crate) struct Tested<'a> {
    pub(crate) spans: &'a [Span],
    /// Base parameters.
    pub(crate) beta: &'a DVector<f64>,
    /// Delay of the torque that the fit undoes, beside the plan's [s].
    pub(crate) shift_s: f64,
}

/// What the fits predict on data that they have not seen. `None` where nothing holds a window that the identified model
/// can be simulated in.
pub(crate) fn forward(stream: &Stream<'_>, tested: &[Tested<'_>]) -> Option<Forward> {
    let n = stream.structure.active.len();
    let most = MOST_WINDOWS.div_ceil(tested.len().max(1));
    let nominal = Simulated::nominal(stream.body);
    let has_masses = nominal.pi.iter().any(|p| *p != 0.0);
    let mut sums = [Sums::default(), Sums::default(), Sums::default()];
    for fit in tested {
        let identified = Simulated::of(stream.body, stream.structure, fit.beta);
        let torque_delay_s = stream.plan.torque_delay_s + fit.shift_s;
        let plan = Plan { torque_delay_s, bristle: false, ..stream.plan.clone() };
        let errors: Vec<_> = begins(stream.recordings, fit.spans, most)
            .par_iter()
            .filter_map(|&(r, from_s)| {
                let w = Window::cut(&stream.recordings[r], stream.robot, &plan, from_s)?;
                let nominal = has_masses.then(|| w.errors(&nominal, n));
                Some((w.errors(&identified, n), nominal, w.held_velocity(n)))
            })
            .collect();
        for (own, nominal, held) in errors {
            sums[0].add(own);
            nominal.into_iter().for_each(|e| sums[1].add(e));
            sums[2].add(Some(held));
        }
    }
    let [identified, nominal, held] = &sums;
    Some(Forward {
        horizons_s: HORIZONS_S.to_vec(),
        identified: identified.predicted(n)?,
        nominal: nominal.predicted(n),
        held_velocity: held.predicted(n)?,
    })
}

/// Recording and begin of windows end to end within `spans`, evenly thinned to `most`.
fn begins(recordings: &[Recording], spans: &[Span], most: usize) -> Vec<(usize, f64)> {
    let mut all = Vec::new();
    for span in spans {
        let Some(times) = recordings.get(span.recording).map(|r| &r.t_s) else { continue };
        let (Some(first), Some(last)) = (times.first(), times.last()) else { continue };
        let (from, to) = (span.from_s.max(*first), span.to_s.min(*last));
        let count = ((to - from) / HORIZON_S).floor().max(0.0) as usize;
        all.extend((0..count).map(|i| (span.recording, from + i as f64 * HORIZON_S)));
    }
    let step = all.len().div_ceil(most).max(1);
    all.into_iter().step_by(step).collect()
}

/// The samples of a recording from `from_s` to `to_s`.
fn slice(recording: &Recording, from_s: f64, to_s: f64) -> Recording {
    let range = recording.t_s.partition_point(|t| *t < from_s)..recording.t_s.partition_point(|t| *t <= to_s);
    let of = |c: &Vec<f64>| c.get(range.clone()).unwrap_or_default().to_vec();
    Recording {
        name: recording.name.clone(),
        joints: recording.joints.clone(),
        t_s: of(&recording.t_s),
        q_rad: recording.q_rad.iter().map(of).collect(),
        tau_nm: recording.tau_nm.iter().map(of).collect(),
        extra: recording.extra.iter().map(|(name, c)| (name.clone(), of(c))).collect(),
        repairs: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lacuna_interfaces::RobotFile;

    fn one_joint() -> Box<dyn RigidBody> {
        let text = "kind = \"serial\"\nname = \"wheel\"\njoints = [\"a\"]\n[env]\ngravity = [0.0, 0.0, 0.0]\n[[dh]]\na = 0.1\n\
            [[link]]\nmass = 1.0\ninertia = [0.0, 0.0, 0.0, 0.0, 0.0, 0.5]\nrotor_inertia = 0.3\n";
        lacuna_physics::build(&RobotFile::parse(text).unwrap(), None).unwrap()
    }

    fn run(model: &Simulated<'_>, v0: f64, tau: f64, seconds: f64) -> State {
        let mut state =
            State { q: Joints::default(), v: Joints::default(), a: Joints::default(), lambda: Joints::default() };
        state.v[0] = v0;
        let mut torque = Joints::default();
        torque[0] = tau;
        for _ in 0..(seconds / STEP_S).round() as usize {
            state.step(model, &torque, 1, STEP_S).unwrap();
        }
        state
    }

    #[test]
    fn a_wheel_with_viscous_friction_by_its_closed_form() {
        let body = one_joint();
        let mut model = Simulated::nominal(body.as_ref());
        model.f_v[0] = 2.0;
        let state = run(&model, 0.0, 3.0, 0.2);
        // The link's own inertia about the joint: 0.5 about its centre of mass in the link frame's origin, and the rotor.
        let inertia = model.dynamics(&[0.0], &[0.0]).unwrap().0[(0, 0)];
        assert!((inertia - 0.81).abs() < 1e-12, "0.5 + 0.3 + 1 kg at 0.1 m: {inertia}");
        let rate = 2.0 / inertia;
        let decay = (-rate * 0.2f64).exp();
        assert!((state.v[0] / (1.5 * (1.0 - decay)) - 1.0).abs() < 1e-4, "{}", state.v[0]);
        assert!((state.q[0] / (1.5 * (0.2 - (1.0 - decay) / rate)) - 1.0).abs() < 2e-3, "{}", state.q[0]);
    }

    #[test]
    fn coulomb_friction_brakes_and_then_holds() {
        let body = one_joint();
        let mut model = Simulated::nominal(body.as_ref());
        model.f_c[0] = 1.0;
        // Constant deceleration f_c/I from 0.5 rad/s: at rest after 0.405 s and 0.10125 rad, and there it stays.
        let state = run(&model, 0.5, 0.0, 0.6);
        assert_eq!(state.v[0], 0.0);
        assert!((state.q[0] - 0.5 * 0.25 * 0.81).abs() < 2e-4, "{}", state.q[0]);
        let pushed = run(&model, 0.0, 0.99, 0.5);
        assert_eq!((pushed.q[0], pushed.v[0]), (0.0, 0.0), "below f_c nothing moves");
        let moved = run(&model, 0.0, 1.81, 0.5);
        assert!((moved.v[0] - 0.5).abs() < 1e-6, "the excess of 0.81 Nm accelerates by 1 rad/s²: {}", moved.v[0]);
    }

    #[test]
    fn a_robot_that_cannot_move_is_no_result() {
        let body = one_joint();
        let model = Simulated { pi: vec![0.0; body.parameters().len()], ..Simulated::nominal(body.as_ref()) };
        let mut state =
            State { q: Joints::default(), v: Joints::default(), a: Joints::default(), lambda: Joints::default() };
        assert!(state.step(&model, &Joints::default(), 1, STEP_S).is_none());
    }
}
