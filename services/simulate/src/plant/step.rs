//! One time step of the true robot.
//!
//! Drift–kick–drift: positions advance half a step, the forces there change the velocities, positions
//! advance the other half. Second order, symplectic without friction, one evaluation of the mechanics a
//! step. Velocity-dependent forces are taken at a velocity extrapolated to the middle.
//!
//! Friction levels are solved with the kick (Moreau's time stepping): for every contact with direction d,
//!
//!   v⁺ = v + Δt M⁻¹ (τ − h − Σ d λ),   λ ∈ level · Sgn(dᵀ v⁺),
//!
//! by projected Gauss–Seidel. A joint within its level stands exactly still, however stiff the rest is.

use super::friction::{BristleState, Contact};
use super::linalg::{JointMatrix, invert_spd};
use super::robot::{TipEvent, TrueRobot};
use super::{Dynamics, Unreachable};
use lacuna_interfaces::{Joints, MAX_JOINTS};

const DOFS: usize = 2 * MAX_JOINTS;
const CONTACTS: usize = 2 * MAX_JOINTS;
/// Gauss–Seidel sweeps at most; chains of sliding joints agree after two or three.
const SWEEPS: usize = 60;

/// Velocities of links (0 … 7) and of motors behind a spring (8 … 15).
type Velocities = [f64; DOFS];

/// A friction level along one or two velocities.
#[derive(Debug, Clone, Copy, Default)]
struct Level {
    /// (velocity, coefficient); a coefficient of 0 is not there.
    along: [(usize, f64); 2],
    positive: f64,
    negative: f64,
}

/// Positions and velocities in the middle of a step.
struct Middle {
    t: f64,
    q: Joints,
    motor: Joints,
    qd: Joints,
    v: Velocities,
}

/// What acts during a step.
struct Forces {
    force: Velocities,
    levels: [Level; CONTACTS],
    /// Levels in use.
    contacts: usize,
    /// Torque that each spring passes to its link; none: rigid.
    passed: [Option<f64>; MAX_JOINTS],
    /// Smooth friction and torques on the motors.
    resisting: Joints,
}

/// The robot in motion.
#[derive(Debug, Clone)]
pub struct Stepper<'a> {
    robot: &'a TrueRobot,
    /// What happens at the tip.
    events: &'a [TipEvent],
    /// Time since the drives were switched on cold, at trajectory time 0 [s].
    warm_offset_s: f64,
    dt: f64,
    /// Link angles.
    q: Joints,
    /// Motor angles at the joint side; equal to `q` behind a rigid transmission.
    motor: Joints,
    v: Velocities,
    /// Acceleration of the last step.
    a: Velocities,
    bristle: [BristleState; MAX_JOINTS],
    hysteresis: Vec<Vec<BristleState>>,
    /// Torque that each transmission passed to its link in the last step.
    load: Joints,
    lambda: [f64; CONTACTS],
    dynamics: Dynamics,
}

impl<'a> Stepper<'a> {
    /// The robot at rest with its motors at `motor` [rad]; springs hold their static load.
    ///
    /// # Errors
    /// [`Unreachable`] if the pose does not exist.
    pub fn at_rest(
        robot: &'a TrueRobot,
        events: &'a [TipEvent],
        warm_offset_s: f64,
        dt: f64,
        motor: &Joints,
    ) -> Result<Self, Unreachable> {
        let mut q = *motor;
        let mut dynamics = Dynamics::default();
        let still = Joints::default();
        let loads = robot.loads(0.0, events);
        let mut load = Joints::default();
        // The springs' sag changes the pose, which changes the load: a contraction, since springs are stiff.
        for _ in 0..20 {
            robot.mechanism.dynamics(&q, &still, &loads, &mut dynamics)?;
            for (i, joint) in robot.joints.iter().enumerate() {
                load[i] = dynamics.bias[i];
                if let Some(spring) = &joint.transmission {
                    for torque in joint.torque.iter().filter(|t| t.on_link()) {
                        load[i] += torque.at(q[i]);
                    }
                    q[i] = motor[i] - spring.deflection(load[i]);
                }
            }
        }
        let hysteresis =
            robot.joints.iter().map(|j| vec![BristleState::default(); j.friction.hysteresis.len()]).collect();
        Ok(Self {
            robot,
            events,
            warm_offset_s,
            dt,
            q,
            motor: *motor,
            v: [0.0; DOFS],
            a: [0.0; DOFS],
            bristle: Default::default(),
            hysteresis,
            load,
            lambda: [0.0; CONTACTS],
            dynamics,
        })
    }

    /// Sets the link velocities (and the motors' with them), for tests and free motion.
    pub fn set_velocity(&mut self, v: &Joints) {
        self.v[..MAX_JOINTS].copy_from_slice(v);
        self.v[MAX_JOINTS..].copy_from_slice(v);
    }

    /// Motor angles at the joint side [rad].
    pub fn motor(&self) -> &Joints {
        &self.motor
    }

    /// Link angles [rad].
    pub fn link(&self) -> &Joints {
        &self.q
    }

    /// Motor speed of joint `i` at the joint side [rad/s].
    pub fn motor_speed(&self, i: usize) -> f64 {
        self.v[self.motor_dof(i)]
    }

    /// Link speeds [rad/s].
    pub fn link_speed(&self) -> Joints {
        let mut v = Joints::default();
        v.copy_from_slice(&self.v[..MAX_JOINTS]);
        v
    }

    fn motor_dof(&self, i: usize) -> usize {
        match self.robot.joints.get(i) {
            Some(j) if j.transmission.is_some() => MAX_JOINTS + i,
            _ => i,
        }
    }

    /// Advances by one step from time `t` under the torques `drive` [Nm] that the motors deliver.
    ///
    /// # Errors
    /// [`Unreachable`] if the robot leaves its workspace or its inertia matrix degenerates.
    pub fn step(&mut self, t: f64, drive: &Joints) -> Result<(), Unreachable> {
        let n = self.robot.joints.len();
        let middle = self.middle(t);
        let loads = self.robot.loads(middle.t, self.events);
        self.robot.mechanism.dynamics(&middle.q, &middle.qd, &loads, &mut self.dynamics)?;
        let mut forces = self.forces(&middle, drive);
        let mut inverse = Inverse { link: self.dynamics.inertia, motor: Joints::default(), n };
        for (i, joint) in self.robot.joints.iter().enumerate() {
            if joint.transmission.is_some() {
                inverse.motor[i] = 1.0 / joint.rotor;
            } else {
                inverse.link[i][i] += joint.rotor;
            }
        }
        self.add_couplings(&middle.v, &mut inverse.link, &mut forces);
        inverse.link = invert_spd(&inverse.link, n).ok_or(Unreachable)?;
        let mut next = self.v;
        inverse.add(&mut next, &forces.force, self.dt);
        self.solve_friction(&inverse, &forces.levels[..forces.contacts], &mut next);
        self.advance(&next, drive, &forces);
        if self.v[..n].iter().all(|v| v.is_finite()) { Ok(()) } else { Err(Unreachable) }
    }

    /// Half a step ahead: positions drift, velocities are extrapolated by the last acceleration.
    fn middle(&self, t: f64) -> Middle {
        let half = 0.5 * self.dt;
        let mut m = Middle { t: t + half, q: self.q, motor: self.motor, qd: Joints::default(), v: self.v };
        for (v, a) in m.v.iter_mut().zip(&self.a) {
            *v += half * a;
        }
        m.qd.copy_from_slice(&m.v[..MAX_JOINTS]);
        for i in 0..self.robot.joints.len() {
            m.q[i] += half * self.v[i];
            m.motor[i] += half * self.v[self.motor_dof(i)];
        }
        m
    }

    /// All smooth forces and all friction levels of the joints; `self.dynamics` is that of the middle.
    fn forces(&self, middle: &Middle, drive: &Joints) -> Forces {
        let n = self.robot.joints.len();
        let mut f = Forces {
            force: [0.0; DOFS],
            levels: [Level::default(); CONTACTS],
            contacts: n,
            passed: [None; MAX_JOINTS],
            resisting: Joints::default(),
        };
        for i in 0..n {
            let m = self.motor_dof(i);
            (f.passed[i], f.resisting[i]) = self.joint_force(i, middle, &mut f.levels[i]);
            f.force[i] -= self.dynamics.bias[i] + self.link_torque(i, middle.q[i]);
            f.force[m] += drive[i] - f.resisting[i];
            if let Some(passed) = f.passed[i] {
                f.force[i] += passed;
                f.force[m] -= passed;
            }
        }
        self.add_cross_ripples(&middle.q, &mut f.force);
        f
    }

    /// Takes over the new velocities: the second half of the drift, loads and bristles.
    fn advance(&mut self, next: &Velocities, drive: &Joints, forces: &Forces) {
        let half = 0.5 * self.dt;
        for (i, joint) in self.robot.joints.iter().enumerate() {
            let m = self.motor_dof(i);
            let moved = half * (self.v[m] + next[m]);
            self.motor[i] += moved;
            if m == i {
                self.q[i] = self.motor[i];
            } else {
                self.q[i] += half * (self.v[i] + next[i]);
            }
            self.load[i] = forces.passed[i].unwrap_or_else(|| {
                let rotor = joint.rotor * (next[i] - self.v[i]) / self.dt;
                drive[i] - forces.resisting[i] - self.lambda[i] - rotor
            });
            if let Some(bristle) = &joint.friction.presliding {
                self.bristle[i] = bristle.moved(&self.bristle[i], moved);
            }
            for (state, h) in self.hysteresis[i].iter_mut().zip(&joint.friction.hysteresis) {
                *state = h.bristle.moved(state, moved);
            }
        }
        for (k, a) in self.a.iter_mut().enumerate() {
            *a = (next[k] - self.v[k]) / self.dt;
        }
        self.v = *next;
    }

    /// Spring torque to the link (if there is a spring), smooth torque on the motor, and the friction level.
    fn joint_force(&self, i: usize, middle: &Middle, level: &mut Level) -> (Option<f64>, f64) {
        let Middle { t, q, motor, v, .. } = middle;
        let joint = &self.robot.joints[i];
        let m = self.motor_dof(i);
        let passed = joint.transmission.map(|s| s.torque(motor[i] - q[i], v[m] - v[i]));
        let contact = Contact { q: motor[i], v: v[m], load: self.load[i], warm_s: self.warm_offset_s + *t };
        let mut torque = joint.friction.drag(&contact);
        for term in joint.torque.iter().filter(|term| !term.on_link()) {
            torque += term.at(motor[i]);
        }
        let half_way = 0.5 * self.dt * self.v[m];
        let (positive, negative) = joint.friction.levels(&contact);
        level.along = [(m, 1.0), (m, 0.0)];
        match &joint.friction.presliding {
            Some(bristle) => {
                let state = bristle.moved(&self.bristle[i], half_way);
                let side = if v[m] >= 0.0 { positive } else { negative };
                torque += bristle.torque(&state, side, v[m]);
            }
            None => (level.positive, level.negative) = (positive, negative),
        }
        for (state, h) in self.hysteresis[i].iter().zip(&joint.friction.hysteresis) {
            torque += h.bristle.torque(&h.bristle.moved(state, half_way), h.limit, v[m]);
        }
        (passed, torque)
    }

    fn link_torque(&self, i: usize, q: f64) -> f64 {
        self.robot.joints[i].torque.iter().filter(|t| t.on_link()).map(|t| t.at(q)).sum()
    }

    fn add_cross_ripples(&self, q: &Joints, force: &mut Velocities) {
        for r in &self.robot.cross_ripples {
            let [i, j] = r.joints;
            let wave = r.amplitude * (r.waves[0] * q[i] + r.waves[1] * q[j] + r.phase).sin();
            force[i] -= wave;
            force[j] -= wave * r.waves[1] / r.waves[0];
        }
    }

    /// Adds coupled motors: inertia, viscous force and a contact each.
    fn add_couplings(&self, v: &Velocities, inertia: &mut JointMatrix, forces: &mut Forces) {
        for c in self.robot.couplings.iter().take(CONTACTS - forces.contacts) {
            let along = [(c.motor, 1.0), (c.felt, c.ratio)];
            for (a, ca) in along {
                for (b, cb) in along {
                    inertia[a][b] += c.inertia * ca * cb;
                }
            }
            let speed = v[c.motor] + c.ratio * v[c.felt];
            for (a, ca) in along {
                forces.force[a] -= ca * c.viscous * speed;
            }
            forces.levels[forces.contacts] = Level { along, positive: c.coulomb, negative: c.coulomb };
            forces.contacts += 1;
        }
    }

    /// Finds λ of every contact and subtracts its impulse from `v`.
    fn solve_friction(&mut self, inverse: &Inverse, levels: &[Level], v: &mut Velocities) {
        let dt = self.dt;
        let mut compliance = [0.0; CONTACTS];
        for (k, level) in levels.iter().enumerate() {
            // Start from the last step's torque, within the present level.
            self.lambda[k] = self.lambda[k].clamp(-level.negative, level.positive);
            let mut unit: Velocities = [0.0; DOFS];
            level.along.iter().for_each(|&(dof, c)| unit[dof] += c);
            let mut moved: Velocities = [0.0; DOFS];
            inverse.add(&mut moved, &unit, dt);
            compliance[k] = level.speed(&moved);
            inverse.add(v, &unit, -dt * self.lambda[k]);
        }
        for _ in 0..SWEEPS {
            let mut change = 0.0f64;
            for (k, level) in levels.iter().enumerate() {
                if level.positive == 0.0 && level.negative == 0.0 {
                    continue;
                }
                let old = self.lambda[k];
                let new = (old + level.speed(v) / compliance[k]).clamp(-level.negative, level.positive);
                if new != old {
                    let mut unit: Velocities = [0.0; DOFS];
                    level.along.iter().for_each(|&(dof, c)| unit[dof] += c);
                    inverse.add(v, &unit, -dt * (new - old));
                    self.lambda[k] = new;
                    change = change.max((new - old).abs() / (level.positive + level.negative));
                }
            }
            if change < 1e-12 {
                break;
            }
        }
    }
}

impl Level {
    fn speed(&self, v: &Velocities) -> f64 {
        self.along.iter().map(|&(dof, c)| c * v[dof]).sum()
    }
}

/// M⁻¹ of links and motors.
struct Inverse {
    link: JointMatrix,
    motor: Joints,
    n: usize,
}

impl Inverse {
    /// v += M⁻¹ f · scale.
    fn add(&self, v: &mut Velocities, f: &Velocities, scale: f64) {
        for i in 0..self.n {
            let s: f64 = (0..self.n).map(|j| self.link[i][j] * f[j]).sum();
            v[i] += s * scale;
            v[MAX_JOINTS + i] += self.motor[i] * f[MAX_JOINTS + i] * scale;
        }
    }
}
