//! Pose, Jacobian, its rate and inverse kinematics of a serial chain, in the base frame.
//!
//! Column j of J is z_j × (x − p_j) for a revolute joint with axis z_j through p_j, and z_j for a prismatic
//! one; J̇ is its derivative term by term.

use super::SerialChain;
use super::chain::Placement;
use crate::{Mat3, Motion, Tip, TipMotion, Unreachable, Vec3};
use lacuna_interfaces::robot::JointType;
use lacuna_interfaces::{Joints, MAX_JOINTS};
use nalgebra::{Matrix6, SMatrix, Vector6};

/// What inverse kinematics shall reach.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Target {
    /// The tip's position [m], whatever its orientation.
    Position([f64; 3]),
    /// Position and orientation.
    Pose(Tip),
}

/// A joint's axis in the base frame.
#[derive(Debug, Clone, Copy)]
struct Axis {
    kind: JointType,
    /// Direction z.
    z: Vec3,
    /// Point p on it [m].
    p: Vec3,
    /// ż [1/s].
    z_rate: Vec3,
    /// ṗ [m/s].
    p_rate: Vec3,
}

impl Axis {
    const NONE: Self = Self {
        kind: JointType::Revolute,
        z: Vec3::new(0.0, 0.0, 0.0),
        p: Vec3::new(0.0, 0.0, 0.0),
        z_rate: Vec3::new(0.0, 0.0, 0.0),
        p_rate: Vec3::new(0.0, 0.0, 0.0),
    };

    /// Velocity of point `x` per unit of joint speed.
    fn column(&self, x: &Vec3) -> Vec3 {
        match self.kind {
            JointType::Revolute => self.z.cross(&(x - self.p)),
            JointType::Prismatic => self.z,
        }
    }

    /// Its time derivative when `x` moves with `x_rate`.
    fn column_rate(&self, x: &Vec3, x_rate: &Vec3) -> Vec3 {
        match self.kind {
            JointType::Revolute => self.z_rate.cross(&(x - self.p)) + self.z.cross(&(x_rate - self.p_rate)),
            JointType::Prismatic => self.z_rate,
        }
    }
}

/// All axes and the tip in the base frame.
struct World {
    axes: [Axis; MAX_JOINTS],
    tip: Placement,
    tip_rate: Vec3,
}

/// Remaining distance and rotation below which inverse kinematics is done.
const IK_TOLERANCE: f64 = 1e-10;
const IK_ITERATIONS: usize = 200;

impl SerialChain {
    /// Base-frame kinematics; `qd` may be empty for zero velocity.
    fn world(&self, q: &[f64], qd: &[f64]) -> World {
        let mut axes = [Axis::NONE; MAX_JOINTS];
        let mut link = Placement::IDENTITY;
        let (mut omega, mut velocity) = (Vec3::zeros(), Vec3::zeros());
        for (i, (joint, slot)) in self.joints.iter().zip(&mut axes).enumerate() {
            let rate = qd.get(i).copied().unwrap_or(0.0);
            let (rotation, point) = joint.place(q[i]);
            let p = link.position + link.rotation * point;
            let rotation = link.rotation * rotation;
            let z = rotation * joint.axis;
            let p_rate = velocity + omega.cross(&(p - link.position));
            *slot = Axis { kind: joint.kind, z, p, z_rate: omega.cross(&z), p_rate };
            let arm = rotation * joint.arm;
            velocity = p_rate;
            match joint.kind {
                JointType::Revolute => omega += z * rate,
                JointType::Prismatic => velocity += z * rate,
            }
            velocity += omega.cross(&arm);
            link = Placement { rotation, position: p + arm };
        }
        let tip = link.then(&self.tip);
        World { axes, tip_rate: velocity + omega.cross(&(tip.position - link.position)), tip }
    }

    pub(super) fn tip_pose(&self, q: &[f64]) -> Tip {
        tip_of(&self.world(q, &[]).tip)
    }

    pub(super) fn tip_motion_at(&self, motion: &Motion<'_>) -> TipMotion {
        let world = self.world(motion.q_rad, motion.qd_rad_s);
        let x = world.tip.position;
        let rates = motion.qd_rad_s.iter().zip(motion.qdd_rad_s2);
        let acceleration = world.axes.iter().zip(rates).fold(Vec3::zeros(), |sum, (axis, (qd, qdd))| {
            sum + axis.column(&x) * *qdd + axis.column_rate(&x, &world.tip_rate) * *qd
        });
        TipMotion { position_m: x.into(), velocity_m_s: world.tip_rate.into(), acceleration_m_s2: acceleration.into() }
    }

    pub(super) fn fill_jacobian(&self, q: &[f64], j: &mut [f64]) {
        let world = self.world(q, &[]);
        self.write_columns(j, |axis| axis.column(&world.tip.position), &world);
    }

    pub(super) fn fill_jacobian_rate(&self, q: &[f64], qd: &[f64], j_rate: &mut [f64]) {
        let world = self.world(q, qd);
        self.write_columns(j_rate, |axis| axis.column_rate(&world.tip.position, &world.tip_rate), &world);
    }

    fn write_columns(&self, out: &mut [f64], column: impl Fn(&Axis) -> Vec3, world: &World) {
        let n = self.joints.len();
        for (i, axis) in world.axes[..n].iter().enumerate() {
            let c = column(axis);
            for row in 0..3 {
                out[row * n + i] = c[row];
            }
        }
    }

    pub(super) fn fill_external_force(&self, q: &[f64], force: Vec3, tau: &mut [f64]) {
        let world = self.world(q, &[]);
        for (tau, axis) in tau.iter_mut().zip(&world.axes) {
            *tau = -axis.column(&world.tip.position).dot(&force);
        }
    }

    /// Numerical inverse kinematics by damped Newton steps (Levenberg-Marquardt) from `start_rad`; metres and
    /// radians weigh alike. Joint limits are not looked at, and another start may lead to another solution.
    /// Entries beyond the chain's joints are 0.
    ///
    /// # Errors
    /// [`Unreachable::NoConvergence`] with what is left of the error; [`Unreachable::Shape`] or
    /// [`Unreachable::NotFinite`] for a start that does not fit.
    pub fn inverse(&self, target: &Target, start_rad: &[f64]) -> Result<Joints, Unreachable> {
        self.check_q(start_rad)?;
        let n = self.joints.len();
        let mut q: Joints = [0.0; MAX_JOINTS];
        q[..n].copy_from_slice(start_rad);
        let mut damping: f64 = 1e-3;
        let mut world = self.world(&q, &[]);
        let mut error = error_to(&world.tip, target);
        for _ in 0..IK_ITERATIONS {
            if error.norm() < IK_TOLERANCE {
                return Ok(q);
            }
            let step = self.newton_step(&world, target, &error, damping);
            let mut trial = q;
            trial.iter_mut().zip(&step).for_each(|(q, d)| *q += d);
            let trial_world = self.world(&trial, &[]);
            let trial_error = error_to(&trial_world.tip, target);
            if trial_error.norm() < error.norm() {
                (q, world, error) = (trial, trial_world, trial_error);
                damping = (damping * 0.1).max(1e-12);
            } else {
                damping = (damping * 10.0).min(1e6);
            }
        }
        Err(Unreachable::NoConvergence {
            iterations: IK_ITERATIONS,
            error_m: error.fixed_rows::<3>(0).norm(),
            error_rad: error.fixed_rows::<3>(3).norm(),
        })
    }

    /// Jᵀ (J Jᵀ + λ 1)⁻¹ e.
    fn newton_step(&self, world: &World, target: &Target, error: &Vector6<f64>, damping: f64) -> Joints {
        let mut j = SMatrix::<f64, 6, MAX_JOINTS>::zeros();
        for (i, axis) in world.axes[..self.joints.len()].iter().enumerate() {
            j.fixed_view_mut::<3, 1>(0, i).copy_from(&axis.column(&world.tip.position));
            if let (Target::Pose(_), JointType::Revolute) = (target, axis.kind) {
                j.fixed_view_mut::<3, 1>(3, i).copy_from(&axis.z);
            }
        }
        let normal = j * j.transpose() + Matrix6::identity() * damping;
        let solved = normal.cholesky().map_or_else(Vector6::zeros, |c| c.solve(error));
        (j.transpose() * solved).into()
    }
}

/// Position error [m] and rotation vector [rad] from the tip to the target.
fn error_to(tip: &Placement, target: &Target) -> Vector6<f64> {
    let (position, turn) = match target {
        Target::Position(p) => (Vec3::from(*p), Vec3::zeros()),
        Target::Pose(goal) => {
            let goal_rotation = Mat3::from_fn(|r, c| goal.rotation[r][c]);
            (Vec3::from(goal.position_m), rotation_vector(&(goal_rotation * tip.rotation.transpose())))
        }
    };
    let d = position - tip.position;
    Vector6::new(d.x, d.y, d.z, turn.x, turn.y, turn.z)
}

/// Axis times angle of a rotation, to full precision everywhere: R = c 1 + (1 − c) a aᵀ + s [a]×, whose
/// skew part is exact for small angles and whose symmetric part is exact for large ones. (The arc cosine of
/// the trace alone has only half the digits near 0.)
fn rotation_vector(r: &Mat3) -> Vec3 {
    let skew = 0.5 * Vec3::new(r.m32 - r.m23, r.m13 - r.m31, r.m21 - r.m12);
    let (s, c) = (skew.norm(), 0.5 * (r.trace() - 1.0));
    if c > 0.0 {
        return if s > 0.0 { skew * (s.atan2(c) / s) } else { Vec3::zeros() };
    }
    let outer = 0.5 * (r + r.transpose()) - c * Mat3::identity();
    let longest = (0..3).max_by(|&a, &b| outer.column(a).norm_squared().total_cmp(&outer.column(b).norm_squared()));
    let axis = outer.column(longest.unwrap_or(0)).try_normalize(1e-9).unwrap_or_else(Vec3::z);
    axis * s.atan2(c).copysign(axis.dot(&skew))
}

fn tip_of(place: &Placement) -> Tip {
    let r = &place.rotation;
    Tip {
        position_m: place.position.into(),
        rotation: std::array::from_fn(|row| std::array::from_fn(|column| r[(row, column)])),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against nalgebra's exponential of the vector, from zero to half a turn.
    #[test]
    fn rotation_vector_is_the_inverse_of_the_exponential() {
        let axis = Vec3::new(0.48, -0.6, 0.64);
        for angle in [0.0, 1e-12, 1e-9, 1e-5, 0.3, 1.5, 3.0, std::f64::consts::PI - 1e-4, std::f64::consts::PI] {
            let r = nalgebra::Rotation3::new(axis * angle);
            let found = rotation_vector(r.matrix());
            let back = nalgebra::Rotation3::new(found);
            assert!((back.matrix() - r.matrix()).norm() < 1e-14, "{angle}");
            assert!((found.norm() - angle).abs() < 1e-14 + 1e-12 * angle, "{angle} {}", found.norm());
        }
    }
}
