//! Delta kinematics: θ > 0 lowers the elbow, z up, platform at z < 0, r = r_a − r_b.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | J'_i | elbow, moved inward by the platform radius: ((r + l1 cos θ) cos α, (r + l1 cos θ) sin α, −l1 sin θ) | m |
//! | s_i | forearm x − J'_i, length l2; A = (s1 s2 s3) | m |
//! | u_i, w_i | ∂J'_i/∂θ_i and ∂u_i/∂θ_i | m/rad, m/rad² |
//! | k_i | −s_i·u_i; K = diag(k) | m²/rad |
//! | J | −A⁻ᵀ K, ẋ = J θ̇ | m/rad |
//! | b_i | s_i·w_i θ̇_i² − \|ẋ − u_i θ̇_i\|²; Aᵀ ẍ = −K θ̈ + b | m²/s² |
//!
//! Source: paper section 3 with errata 1, 2 and 4 of NOTATION.md.

use super::Delta;
use crate::{Mat3, Unreachable, Vec3};

/// Poses whose normalised determinant |det A| / l2³ is below this are refused: there the platform's
/// acceleration carries the joints' noise a million times enlarged.
const SINGULAR: f64 = 1e-6;

/// Everything that depends on θ alone.
#[derive(Debug, Clone, Copy)]
pub struct DeltaPose {
    /// Platform position x [m].
    pub x: Vec3,
    /// Forearms s_i, the columns of A [m].
    pub s: [Vec3; 3],
    /// u_i = ∂J'_i/∂θ_i [m/rad].
    pub u: [Vec3; 3],
    /// w_i = ∂u_i/∂θ_i [m/rad²].
    pub w: [Vec3; 3],
    /// k_i, the diagonal of K [m²/rad].
    pub k: [f64; 3],
    /// Columns of A⁻ᵀ [1/m].
    pub a_inv: [Vec3; 3],
}

impl DeltaPose {
    /// Column i of J: −k_i times column i of A⁻ᵀ.
    #[inline]
    pub fn jacobian_column(&self, i: usize) -> Vec3 {
        -self.k[i] * self.a_inv[i]
    }

    /// J = −A⁻ᵀ K [m/rad].
    pub fn jacobian(&self) -> Mat3 {
        Mat3::from_columns(&[self.jacobian_column(0), self.jacobian_column(1), self.jacobian_column(2)])
    }

    /// Jᵀ f: joint torques of a force on the platform.
    #[inline]
    pub fn transpose_times(&self, f: &Vec3) -> [f64; 3] {
        std::array::from_fn(|i| -self.k[i] * self.a_inv[i].dot(f))
    }

    /// A⁻ᵀ v.
    #[inline]
    fn solve(&self, v: [f64; 3]) -> Vec3 {
        v[0] * self.a_inv[0] + v[1] * self.a_inv[1] + v[2] * self.a_inv[2]
    }
}

/// A pose with velocities and accelerations.
#[derive(Debug, Clone, Copy)]
pub struct DeltaState {
    /// Quantities of the pose.
    pub pose: DeltaPose,
    /// Joint velocities θ̇ [rad/s].
    pub qd: [f64; 3],
    /// Joint accelerations θ̈ [rad/s²].
    pub qdd: [f64; 3],
    /// Platform velocity ẋ = J θ̇ [m/s].
    pub xd: Vec3,
    /// Platform acceleration ẍ [m/s²].
    pub xdd: Vec3,
    /// b_i [m²/s²].
    pub b: [f64; 3],
}

impl DeltaState {
    /// Acceleration of elbow i: a_J = u θ̈ + w θ̇² [m/s²].
    #[inline]
    pub fn elbow_acceleration(&self, i: usize) -> Vec3 {
        self.qdd[i] * self.pose.u[i] + self.qd[i] * self.qd[i] * self.pose.w[i]
    }

    /// J̇ [m/(rad s)] from AᵀJ = −K: J̇ = −A⁻ᵀ (K̇ + Ȧᵀ J), with ṡ = ẋ − u θ̇ and k̇ = −(ṡ·u + s·w θ̇).
    pub fn jacobian_rate(&self) -> Mat3 {
        let pose = &self.pose;
        let j = pose.jacobian();
        let s_rate: [Vec3; 3] = std::array::from_fn(|i| self.xd - self.qd[i] * pose.u[i]);
        let column = |c: usize| {
            let mut rows = s_rate.map(|s| s.dot(&j.column(c)));
            rows[c] -= s_rate[c].dot(&pose.u[c]) + self.qd[c] * pose.s[c].dot(&pose.w[c]);
            -pose.solve(rows)
        };
        Mat3::from_columns(&[column(0), column(1), column(2)])
    }
}

/// Both solutions of one leg's inverse kinematics [rad], in (−π, π].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LegAngles {
    /// Elbow away from the robot's axis: the assembly Deltas are built in.
    pub knee_out: f64,
    /// Elbow towards the axis.
    pub knee_in: f64,
}

impl Delta {
    /// Forward kinematics and all quantities of the pose.
    ///
    /// The platform is the intersection of the three forearm spheres that lies below the elbow plane
    /// (erratum 4).
    ///
    /// # Errors
    /// [`Unreachable`] where the forearms do not meet, or lie in one plane, or θ is not finite.
    #[inline(always)]
    pub fn pose(&self, q: &[f64; 3]) -> Result<DeltaPose, Unreachable> {
        let mut elbow = [Vec3::zeros(); 3];
        let (mut u, mut w) = ([Vec3::zeros(); 3], [Vec3::zeros(); 3]);
        for i in 0..3 {
            let (sin, cos) = q[i].sin_cos();
            let (l1_cos, l1_sin) = (self.l1 * cos, self.l1 * sin);
            let radius = self.r + l1_cos;
            elbow[i] = Vec3::new(radius * self.cos_alpha[i], radius * self.sin_alpha[i], -l1_sin);
            u[i] = Vec3::new(-l1_sin * self.cos_alpha[i], -l1_sin * self.sin_alpha[i], -l1_cos);
            w[i] = Vec3::new(-l1_cos * self.cos_alpha[i], -l1_cos * self.sin_alpha[i], l1_sin);
        }
        let x = self.below(&elbow, q)?;
        let s = elbow.map(|e| x - e);
        let cross = [s[1].cross(&s[2]), s[2].cross(&s[0]), s[0].cross(&s[1])];
        let det = s[0].dot(&cross[0]);
        let volume = self.l2 * self.l2 * self.l2;
        if det.abs() <= SINGULAR * volume || det.is_nan() {
            return Err(Unreachable::Singular { determinant: det / volume, limit: SINGULAR });
        }
        let per_det = 1.0 / det;
        Ok(DeltaPose { x, s, u, w, k: std::array::from_fn(|i| -s[i].dot(&u[i])), a_inv: cross.map(|c| c * per_det) })
    }

    /// Point at distance l2 from all three elbows, below their plane.
    #[inline(always)]
    fn below(&self, elbow: &[Vec3; 3], q: &[f64; 3]) -> Result<Vec3, Unreachable> {
        let (e1, e2) = (elbow[1] - elbow[0], elbow[2] - elbow[0]);
        let normal = e1.cross(&e2);
        let normal_sq = normal.norm_squared();
        // a runs from the first elbow to the centre of the circle through all three.
        let a = (0.5 * e1.norm_squared() * e2.cross(&normal) + 0.5 * e2.norm_squared() * normal.cross(&e1)) / normal_sq;
        let height_sq = self.l2 * self.l2 - a.norm_squared();
        if height_sq.is_nan() || height_sq < 0.0 {
            if let Some(joint) = q.iter().position(|v| !v.is_finite()) {
                return Err(Unreachable::NotFinite { joint });
            }
            return Err(Unreachable::ForearmsTooShort { circumradius_m: a.norm(), l2_m: self.l2 });
        }
        let down = -normal.z.signum() * (height_sq / normal_sq).sqrt();
        Ok(elbow[0] + a + down * normal)
    }

    /// Pose with velocities and accelerations.
    ///
    /// # Errors
    /// As [`Delta::pose`]; also where θ̇ or θ̈ is not finite.
    #[inline(always)]
    pub fn state(&self, q: &[f64; 3], qd: &[f64; 3], qdd: &[f64; 3]) -> Result<DeltaState, Unreachable> {
        let pose = self.pose(q)?;
        let xd = pose.solve(std::array::from_fn(|i| -pose.k[i] * qd[i]));
        let b: [f64; 3] = std::array::from_fn(|i| {
            pose.s[i].dot(&pose.w[i]) * qd[i] * qd[i] - (xd - qd[i] * pose.u[i]).norm_squared()
        });
        let xdd = pose.solve(std::array::from_fn(|i| b[i] - pose.k[i] * qdd[i]));
        if !(xdd.x + xdd.y + xdd.z).is_finite() {
            let joint = (0..3).find(|&i| !(qd[i].is_finite() && qdd[i].is_finite())).unwrap_or(0);
            return Err(Unreachable::NotFinite { joint });
        }
        Ok(DeltaState { pose, qd: *qd, qdd: *qdd, xd, xdd, b })
    }

    /// Inverse kinematics: both angles of each leg for a platform position x [m].
    ///
    /// ℓ cos θ + p sin θ = n with ℓ = 2 l1 (r − X), p = 2 l1 z, n = l2² − l1² − r² − |x|² + 2 r X and
    /// X = x cos α + y sin α; θ = atan2(p, ℓ) ± acos(n / √(ℓ² + p²)), + for the knee outward.
    ///
    /// # Errors
    /// [`Unreachable::Leg`] with the first leg that does not reach x.
    pub fn inverse(&self, x: [f64; 3]) -> Result<[LegAngles; 3], Unreachable> {
        let x = Vec3::from(x);
        let mut out = [LegAngles { knee_out: 0.0, knee_in: 0.0 }; 3];
        for (leg, angles) in out.iter_mut().enumerate() {
            let along = x.x * self.cos_alpha[leg] + x.y * self.sin_alpha[leg];
            let (l, p) = (2.0 * self.l1 * (self.r - along), 2.0 * self.l1 * x.z);
            let n = self.l2 * self.l2 - self.l1 * self.l1 - self.r * self.r - x.norm_squared() + 2.0 * self.r * along;
            let cosine = n / l.hypot(p);
            if cosine.is_nan() || cosine.abs() > 1.0 {
                return Err(Unreachable::Leg { leg, cosine });
            }
            let (middle, half) = (p.atan2(l), cosine.acos());
            *angles = LegAngles { knee_out: wrap(middle + half), knee_in: wrap(middle - half) };
        }
        Ok(out)
    }
}

/// The angle in (−π, π].
fn wrap(angle: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    let a = angle.rem_euclid(TAU);
    if a > PI { a - TAU } else { a }
}
