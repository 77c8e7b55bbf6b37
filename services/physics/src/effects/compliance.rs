//! A spring between motor and link, with or without a gap: the shared part of elasticity and backlash.
//!
//! ```text
//! e = θ − q_link             deflection
//! M ë + T(e, ė) = F          link's equation, F = τ_link(θ − e, θ̇ − ė, θ̈)
//! T = k (e − b sgn e) + d ė  while abs e > b, else 0;   d = 2 ζ √(k M_ii)
//! Δτ = F − M ë − τ_link      what the motors feel of it, at the joints beside the soft ones too
//! ```
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | θ, q_link | motor angle at the joint side (what the encoder measures), link angle | rad |
//! | τ_link | torque of the link side if nothing gave way | Nm |
//! | M | link-side inertia matrix at the link's pose, motors held | kg m² |
//! | k, b, ζ | stiffness, half gap, damping ratio | Nm/rad, rad, 1 |
//!
//! F is evaluated where the link is, so gravity's change with the deflection is in it. The equation is
//! integrated by Newmark's average acceleration (β = 1/4, γ = 1/2: stable for any stiffness, second order) in
//! at least eight sub-steps a sample. At rest e follows from the static load.
//!
//! Feed it a motion free of noise (commanded or re-simulated): second derivatives of a measured angle shake
//! the spring with the encoder's noise. Reference: Spong 1987, J. Dyn. Syst. Meas. Control 109, 310-319.

use super::context::Mechanics;
use super::effect::Request;
use super::kernel::{ColumnSink, EffectSample, Kernel};
use lacuna_interfaces::{Joints, MAX_JOINTS};

/// Fewest sub-steps a sample.
const SUBSTEPS: f64 = 8.0;
/// Most sub-steps a sample.
const MOST_SUBSTEPS: f64 = 64.0;
/// Longest sub-step wanted [s].
const SUBSTEP_S: f64 = 1.25e-4;
/// A pause longer than this starts the link anew at its static deflection [s].
const LONGEST_STEP_S: f64 = 0.1;

type Matrix = [[f64; MAX_JOINTS]; MAX_JOINTS];

/// Deflections of the soft joints; index = position in the list of soft joints.
#[derive(Debug, Clone, Copy, Default)]
struct State {
    e: Joints,
    v: Joints,
    a: Joints,
    force: Joints,
}

impl State {
    /// Deflection and its rate `dt` later at the present acceleration.
    fn ahead(&self, dt: f64) -> Self {
        let e = std::array::from_fn(|i| self.e[i] + dt * (self.v[i] + 0.5 * dt * self.a[i]));
        Self { e, v: std::array::from_fn(|i| self.v[i] + dt * self.a[i]), ..*self }
    }
}

/// Stiffness [Nm/rad], damping ratio and half gap [rad] of every soft joint.
#[derive(Debug, Clone, Copy)]
struct Spring {
    k: f64,
    zeta: f64,
    gap: f64,
}

impl Spring {
    /// The state `dt` later, the load going straight from `from.force` to `load`.
    fn advance(&self, soft: &[usize], from: &State, m: &Matrix, load: &Joints, dt: f64) -> Option<State> {
        let steps = (dt / SUBSTEP_S).ceil().clamp(SUBSTEPS, MOST_SUBSTEPS);
        let h = dt / steps;
        let mut state = *from;
        for step in 1..=steps as u32 {
            let share = f64::from(step) / steps;
            let mut force = [0.0; MAX_JOINTS];
            for (i, &j) in soft.iter().enumerate() {
                force[i] = from.force[i] + share * (load[j] - from.force[i]);
            }
            state = self.substep(soft, &state, m, &force, h)?;
        }
        Some(state)
    }

    /// As [`Self::advance`] for one soft joint of link-side inertia `m` [kg m²]: the same steps without matrices.
    fn advance_one(&self, from: &State, m: f64, load: f64, dt: f64) -> Option<State> {
        let steps = (dt / SUBSTEP_S).ceil().clamp(SUBSTEPS, MOST_SUBSTEPS);
        let h = dt / steps;
        let d = 2.0 * self.zeta * (self.k * m).sqrt();
        let held = m + 0.5 * h * d + 0.25 * h * h * self.k;
        let flank_of = |e: f64| if e.abs() > self.gap { e.signum() } else { 0.0 };
        let (mut e, mut v, mut a) = (from.e[0], from.v[0], from.a[0]);
        for step in 1..=steps as u32 {
            let force = from.force[0] + f64::from(step) / steps * (load - from.force[0]);
            let (e_p, v_p) = (e + h * v + 0.25 * h * h * a, v + 0.5 * h * a);
            let mut flank = flank_of(e);
            for _ in 0..4 {
                a = match flank != 0.0 || self.gap == 0.0 {
                    true => (force - d * v_p - self.k * (e_p - self.gap * flank)) / held,
                    false => force / m,
                };
                e = e_p + 0.25 * h * h * a;
                let touching = flank_of(e);
                if touching == flank || self.gap == 0.0 {
                    break;
                }
                flank = touching;
            }
            v = v_p + 0.5 * h * a;
        }
        let first = |x: f64| std::array::from_fn(|i| if i == 0 { x } else { 0.0 });
        let to = State { e: first(e), v: first(v), a: first(a), force: first(load) };
        (e.is_finite() && v.is_finite()).then_some(to)
    }

    /// One Newmark step. Which flanks touch is not known before it: iterated until it fits.
    fn substep(&self, soft: &[usize], from: &State, m: &Matrix, force: &Joints, h: f64) -> Option<State> {
        let n = soft.len();
        let (e_p, v_p): (Joints, Joints) = (
            std::array::from_fn(|i| from.e[i] + h * from.v[i] + 0.25 * h * h * from.a[i]),
            std::array::from_fn(|i| from.v[i] + 0.5 * h * from.a[i]),
        );
        let mut flank = self.flanks(&from.e);
        let mut next = State { force: *force, ..State::default() };
        for _ in 0..4 {
            let mut a = [[0.0; MAX_JOINTS]; MAX_JOINTS];
            let mut rhs = *force;
            for (i, &j) in soft.iter().enumerate() {
                for c in 0..n {
                    a[i][c] = m[c][j];
                }
                if flank[i] != 0.0 || self.gap == 0.0 {
                    let d = 2.0 * self.zeta * (self.k * m[i][j]).sqrt();
                    a[i][i] += 0.5 * h * d + 0.25 * h * h * self.k;
                    rhs[i] -= d * v_p[i] + self.k * (e_p[i] - self.gap * flank[i]);
                }
            }
            next.a = solve(&mut a, rhs, n)?;
            for i in 0..n {
                next.e[i] = e_p[i] + 0.25 * h * h * next.a[i];
                next.v[i] = v_p[i] + 0.5 * h * next.a[i];
            }
            let touching = self.flanks(&next.e);
            if touching == flank {
                break;
            }
            flank = touching;
        }
        next.e[..n].iter().chain(&next.v[..n]).all(|x| x.is_finite()).then_some(next)
    }

    /// Which flank touches: the sign of e, 0 inside the gap.
    fn flanks(&self, e: &Joints) -> Joints {
        e.map(|e| if e.abs() > self.gap { e.signum() } else { 0.0 })
    }
}

/// The link behind springs at some joints.
#[derive(Debug)]
pub(super) struct Compliance {
    soft: Vec<usize>,
    mechanics: Mechanics,
    weightless: Mechanics,
    pi: Vec<f64>,
    spring: Spring,
    state: Option<State>,
}

impl Compliance {
    /// Springs of stiffness `k` [Nm/rad], damping ratio `zeta` and half gap `gap` [rad] at the joints asked for.
    pub(super) fn new(request: &Request<'_>, k: f64, zeta: f64, gap: f64) -> Self {
        Self {
            soft: request.joints.iter().copied().filter(|&j| j < MAX_JOINTS).collect(),
            mechanics: request.context.mechanics(),
            weightless: request.context.mechanics_under([0.0; 3]),
            pi: request.context.pi_link(),
            spring: Spring { k, zeta, gap },
            state: None,
        }
    }

    /// Column `s`: torques of all joints per unit of acceleration of soft joint `s`.
    fn inertia(&self, q: &Joints) -> Option<Matrix> {
        let mut m = [[0.0; MAX_JOINTS]; MAX_JOINTS];
        for (column, &j) in m.iter_mut().zip(&self.soft) {
            let mut unit = [0.0; MAX_JOINTS];
            unit[j] = 1.0;
            *column = self.weightless.torque(q, &[0.0; MAX_JOINTS], &unit, &self.pi)?;
            if column[j].is_nan() || column[j] <= 0.0 {
                return None;
            }
        }
        Some(m)
    }

    /// Link torque where the link is, other link-side loads included.
    fn force(&self, s: &EffectSample<'_>, state: &State, extra: &Joints) -> Option<Joints> {
        let (mut q, mut qd) = (*s.q_rad, *s.qd_rad_s);
        for (i, &j) in self.soft.iter().enumerate() {
            q[j] -= state.e[i];
            qd[j] -= state.v[i];
        }
        let mut f = self.mechanics.torque(&q, &qd, s.qdd_rad_s2, &self.pi)?;
        f.iter_mut().zip(extra).for_each(|(f, x)| *f += x);
        Some(f)
    }

    /// Deflection under a load that has acted for ever.
    fn at_rest(&self, load: &Joints) -> State {
        let mut state = State::default();
        for (i, &j) in self.soft.iter().enumerate() {
            let side = if load[j] == 0.0 { 0.0 } else { load[j].signum() };
            state.e[i] = self.spring.gap * side + load[j] / self.spring.k;
            state.force[i] = load[j];
        }
        state
    }

    fn step(&mut self, s: &EffectSample<'_>) -> Option<Joints> {
        let stiff = self.mechanics.torque(s.q_rad, s.qd_rad_s, s.qdd_rad_s2, &self.pi)?;
        let extra: Joints = std::array::from_fn(|j| s.tau_link_nm[j] - stiff[j]);
        let moving = s.dt_s > 0.0 && s.dt_s <= LONGEST_STEP_S;
        let from = self.state.take().filter(|_| moving);
        let mut q_link = *s.q_rad;
        for (i, &j) in self.soft.iter().enumerate() {
            q_link[j] -= from.map_or(0.0, |from| from.e[i]);
        }
        let m = self.inertia(&q_link)?;
        // The load depends on where the link gets to: it is taken where the present acceleration leads.
        let (load, state) = match (&from, self.soft.as_slice()) {
            (None, _) => {
                let load = self.force(s, &self.at_rest(s.tau_link_nm), &extra)?;
                (load, self.at_rest(&load))
            }
            (Some(from), soft) => {
                let load = self.force(s, &from.ahead(s.dt_s), &extra)?;
                let state = match *soft {
                    [j] => self.spring.advance_one(from, m[0][j], load[j], s.dt_s)?,
                    _ => self.spring.advance(soft, from, &m, &load, s.dt_s)?,
                };
                (load, state)
            }
        };
        self.state = Some(state);
        Some(std::array::from_fn(|j| {
            let inertial: f64 = m.iter().zip(&state.a).map(|(column, a)| column[j] * a).sum();
            load[j] - inertial - s.tau_link_nm[j]
        }))
    }
}

impl Kernel for Compliance {
    fn reset(&mut self) {
        self.state = None;
    }

    fn columns(&mut self, sample: &EffectSample<'_>, sink: &mut ColumnSink<'_>) {
        if let Some(tau) = self.step(sample) {
            sink.set_all(0, &tau);
        }
    }
}

/// Solves the first `n` rows of A x = b for a positive definite A by elimination; `None` if it is not.
fn solve(a: &mut Matrix, mut b: Joints, n: usize) -> Option<Joints> {
    for i in 0..n {
        let pivot = a[i][i];
        if pivot.is_nan() || pivot <= 0.0 {
            return None;
        }
        for r in i + 1..n {
            let f = a[r][i] / pivot;
            for c in i..n {
                a[r][c] -= f * a[i][c];
            }
            b[r] -= f * b[i];
        }
    }
    for i in (0..n).rev() {
        let known: f64 = (i + 1..n).map(|c| a[i][c] * b[c]).sum();
        b[i] = (b[i] - known) / a[i][i];
    }
    b[n..].fill(0.0);
    Some(b)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One soft joint is integrated without matrices: the steps are those of several joints that do not feel each other.
    #[test]
    fn one_soft_joint_moves_as_among_several() {
        for gap in [0.0, 4e-4] {
            let spring = Spring { k: 3000.0, zeta: 0.05, gap };
            let (mut one, mut two) = (State::default(), State::default());
            let inertia = [0.31, 0.17];
            let mut several = [[0.0; MAX_JOINTS]; MAX_JOINTS];
            (several[0][2], several[1][5]) = (inertia[0], inertia[1]);
            let mut largest = 0.0f64;
            for k in 0..2000 {
                let t = f64::from(k) * 1e-3;
                let load = 6.0 * (9.0 * t).sin() + 2.0 * (41.0 * t).cos();
                let mut loads = [0.0; MAX_JOINTS];
                (loads[2], loads[5]) = (load, -0.4 * load);
                one = spring.advance_one(&one, inertia[0], load, 1e-3).unwrap();
                two = spring.advance(&[2, 5], &two, &several, &loads, 1e-3).unwrap();
                largest = largest.max(one.e[0].abs());
                assert!((one.e[0] - two.e[0]).abs() < 1e-9 && (one.v[0] - two.v[0]).abs() < 1e-6, "sample {k}");
            }
            assert!(largest > 2e-3 + gap, "it moves: {largest} rad");
        }
    }
}
