//! A Delta whose legs differ in length: what an error of length does to the torque.
//!
//! The equations of [`crate::delta`] with l1 and l2 of each leg its own. The platform no longer stands above
//! the centre of the circle through the elbows: with e_i = E_i − E_0, its foot a in their plane solves
//! a·e_i = (|e_i|² + l2_0² − l2_i²) / 2.

use crate::delta::parameters::{GC, GS, INERTIA, M_GR, M_IN, M_JE};
use crate::delta::{DeltaPose, DeltaState, PARAMETERS};
use crate::{Delta, RigidBody, Vec3};
use lacuna_interfaces::robot::Geometry;
use lacuna_interfaces::{Joints, MAX_JOINTS};

/// Three legs with lengths of their own.
#[derive(Debug, Clone, Copy)]
pub(super) struct Legs {
    pub(super) l1: [f64; 3],
    pub(super) l2: [f64; 3],
    r: f64,
    alpha: [(f64, f64); 3],
    gravity: Vec3,
}

impl Legs {
    /// Legs as the robot file has them, all alike.
    pub(super) fn new(delta: &Delta, geometry: &Geometry) -> Self {
        Self {
            l1: [delta.l1_m(); 3],
            l2: [delta.l2_m(); 3],
            r: delta.r_m(),
            alpha: geometry.alpha_deg.map(|a| a.to_radians().sin_cos()),
            gravity: Vec3::from(delta.gravity_m_s2()),
        }
    }

    fn pose(&self, q: &Joints) -> Option<DeltaPose> {
        let (mut elbow, mut u, mut w) = ([Vec3::zeros(); 3], [Vec3::zeros(); 3], [Vec3::zeros(); 3]);
        for i in 0..3 {
            let ((sin, cos), (sin_a, cos_a)) = (q[i].sin_cos(), self.alpha[i]);
            let (lc, ls) = (self.l1[i] * cos, self.l1[i] * sin);
            elbow[i] = Vec3::new((self.r + lc) * cos_a, (self.r + lc) * sin_a, -ls);
            u[i] = Vec3::new(-ls * cos_a, -ls * sin_a, -lc);
            w[i] = Vec3::new(-lc * cos_a, -lc * sin_a, ls);
        }
        let x = self.platform(&elbow)?;
        let s = elbow.map(|e| x - e);
        let cross = [s[1].cross(&s[2]), s[2].cross(&s[0]), s[0].cross(&s[1])];
        let det = s[0].dot(&cross[0]);
        if det.is_nan() || det.abs() < 1e-6 * self.l2[0].powi(3) {
            return None;
        }
        Some(DeltaPose { x, s, u, w, k: std::array::from_fn(|i| -s[i].dot(&u[i])), a_inv: cross.map(|c| c / det) })
    }

    fn platform(&self, elbow: &[Vec3; 3]) -> Option<Vec3> {
        let (e1, e2) = (elbow[1] - elbow[0], elbow[2] - elbow[0]);
        let normal = e1.cross(&e2);
        let half = |e: &Vec3, i: usize| 0.5 * (e.norm_squared() + self.l2[0].powi(2) - self.l2[i].powi(2));
        let foot = (half(&e1, 1) * e2.cross(&normal) + half(&e2, 2) * normal.cross(&e1)) / normal.norm_squared();
        let height_sq = self.l2[0].powi(2) - foot.norm_squared();
        if height_sq.is_nan() || height_sq < 0.0 {
            return None;
        }
        Some(elbow[0] + foot - normal.normalize() * normal.z.signum() * height_sq.sqrt())
    }

    /// Inverse dynamics with parameters π; `None` where the pose does not exist.
    pub(super) fn torque(&self, q: &Joints, qd: &Joints, qdd: &Joints, pi: &[f64; PARAMETERS]) -> Option<Joints> {
        let pose = self.pose(q)?;
        let times = |v: [f64; 3]| v[0] * pose.a_inv[0] + v[1] * pose.a_inv[1] + v[2] * pose.a_inv[2];
        let xd = times(std::array::from_fn(|i| -pose.k[i] * qd[i]));
        let b: [f64; 3] = std::array::from_fn(|i| {
            pose.s[i].dot(&pose.w[i]) * qd[i] * qd[i] - (xd - qd[i] * pose.u[i]).norm_squared()
        });
        let xdd = times(std::array::from_fn(|i| b[i] - pose.k[i] * qdd[i]));
        let state = DeltaState { pose, qd: [qd[0], qd[1], qd[2]], qdd: [qdd[0], qdd[1], qdd[2]], xd, xdd, b };
        let elbows: Vec3 = (0..3).map(|i| state.elbow_acceleration(i)).sum();
        let force = pi[M_IN] * xdd - pi[M_GR] * self.gravity + pi[M_JE] * elbows;
        let carried = pose.transpose_times(&force);
        let mut tau = [0.0; MAX_JOINTS];
        for i in 0..3 {
            let weight = pi[GC + i] * self.gravity.dot(&pose.u[i]) + pi[GS + i] * self.gravity.dot(&pose.w[i]);
            tau[i] = pi[INERTIA + i] * qdd[i] - weight / self.l1[i] + pi[M_JE] * pose.u[i].dot(&xdd) + carried[i];
        }
        tau.iter().all(|t| t.is_finite()).then_some(tau)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Motion;
    use lacuna_interfaces::RobotFile;

    const ROBOT: &str = "kind = \"delta\"\nname = \"d\"\n[geometry]\nl1 = 0.35\nl2 = 0.88\nra = 0.2\nrb = 0.05\n\
        [mass]\nplatform = 1.1\nupper_arm = 1.8\nforearm_point = 0.22\nrotor_inertia = 0.06\n";

    fn legs() -> (Delta, Legs) {
        let robot = RobotFile::parse(ROBOT).unwrap();
        let delta = Delta::new(&robot).unwrap();
        let legs = Legs::new(&delta, robot.geometry.as_ref().unwrap());
        (delta, legs)
    }

    fn wide(v: [f64; 3]) -> Joints {
        let mut out = [0.0; MAX_JOINTS];
        out[..3].copy_from_slice(&v);
        out
    }

    #[test]
    fn equal_legs_are_the_delta() {
        let (delta, legs) = legs();
        let pi = [0.12, 0.13, 0.14, 0.3, 0.31, 0.32, 0.01, 0.02, 0.03, 1.7, 1.8, 0.05];
        for k in 0..50 {
            let x = f64::from(k);
            let q = [0.3 * x.sin(), 0.3 + 0.3 * (1.3 * x).cos(), 0.2 * (0.7 * x).sin()];
            let qd = [2.0 * x.cos(), (2.1 * x).sin(), -1.0];
            let qdd = [20.0 * (3.0 * x).sin(), 5.0, -7.0 * x.cos()];
            let mut tau = [0.0; 3];
            delta.torque(&Motion { q_rad: &q, qd_rad_s: &qd, qdd_rad_s2: &qdd }, &pi, &mut tau).unwrap();
            let own = legs.torque(&wide(q), &wide(qd), &wide(qdd), &pi).unwrap();
            for i in 0..3 {
                assert!((own[i] - tau[i]).abs() < 1e-11, "sample {k} joint {i}: {} {}", own[i], tau[i]);
            }
        }
    }

    /// With unequal legs the motors' power is still the change of energy: kinetic and potential energy are
    /// written down from the geometry alone, their rate by differences.
    #[test]
    fn unequal_legs_balance_energy() {
        let (_, mut legs) = legs();
        legs.l1 = [0.36, 0.34, 0.352];
        legs.l2 = [0.87, 0.89, 0.885];
        let (inertia, moment, platform) = (0.12, 0.3, 1.7);
        let mut pi = [0.0; PARAMETERS];
        pi[INERTIA..GC].fill(inertia);
        pi[GC..GS].fill(moment);
        (pi[M_IN], pi[M_GR]) = (platform, platform);
        let motion = |t: f64| -> (Joints, Joints, Joints) {
            let f = [1.3, 2.1, 1.7];
            (
                std::array::from_fn(|i| if i < 3 { 0.3 + 0.25 * (f[i] * t + i as f64).sin() } else { 0.0 }),
                std::array::from_fn(|i| if i < 3 { 0.25 * f[i] * (f[i] * t + i as f64).cos() } else { 0.0 }),
                std::array::from_fn(|i| if i < 3 { -0.25 * f[i] * f[i] * (f[i] * t + i as f64).sin() } else { 0.0 }),
            )
        };
        let energy = |t: f64| -> f64 {
            let h = 1e-5;
            let x = |t: f64| legs.pose(&motion(t).0).unwrap().x;
            let xd = (x(t + h) - x(t - h)) / (2.0 * h);
            let (q, qd, _) = motion(t);
            let arms: f64 = (0..3).map(|i| 0.5 * inertia * qd[i] * qd[i] - 9.81 * moment * q[i].sin()).sum();
            arms + 0.5 * platform * xd.norm_squared() + 9.81 * platform * x(t).z
        };
        for k in 0..40 {
            let t = 0.1 * f64::from(k);
            let (q, qd, qdd) = motion(t);
            let tau = legs.torque(&q, &qd, &qdd, &pi).unwrap();
            let power: f64 = tau.iter().zip(&qd).map(|(a, b)| a * b).sum();
            let h = 1e-4;
            let rate = (energy(t + h) - energy(t - h)) / (2.0 * h);
            assert!((power - rate).abs() < 1e-5 * (1.0 + power.abs()), "t {t}: {power} {rate}");
            let pose = legs.pose(&q).unwrap();
            for i in 0..3 {
                assert!((pose.s[i].norm() - legs.l2[i]).abs() < 1e-12);
            }
        }
    }
}
