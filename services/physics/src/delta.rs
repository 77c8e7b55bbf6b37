//! The Delta: three legs, a platform that only translates, massless-rod dynamics linear in twelve parameters.
//!
//! T = I θ̈ + G + Jᵀ (M γ − F) (M_KH, paper section 3, corrected by the errata of NOTATION.md); the grey box
//! M_Id scales the first two terms by ρ1 and ρ2 (paper eq. 6); forearms with distributed mass add the
//! elbow-platform coupling `m_JE` and make the platform's inertial and gravitational mass differ.
//!
//! What the paper prints and what holds (checked against bodies and constraints, `tests/golden.rs`):
//!
//! | paper | as printed | here |
//! |---|---|---|
//! | sections 2 and 3 | θ downward with r = r_a − r_b, then θ upward with r = r_b − r_a | θ > 0 lowers the elbow, r = r_a − r_b throughout |
//! | k_ii | lacks the factor l1 | k_i = −s_i·u_i |
//! | inverse kinematics | one solution a leg | two; both in [`LegAngles`] |
//! | forward kinematics | sign open | the intersection below the elbow plane |
//! | eq. 5 | I Θ, dots missing | I Θ̈ |
//! | m2 | the forearm at elbow and platform both | one rod of a leg at either end; uniform rods by [`Forearm`] |
//!
//! Kinematics are in [`kinematics`], the parameter vector in [`parameters`].

pub mod kinematics;
pub mod parameters;

use crate::rigid_body::{check_len, check_result};
use crate::{Evaluation, Motion, Parameter, RigidBody, Tip, TipMotion, Unreachable, Vec3};
pub use kinematics::{DeltaPose, DeltaState, LegAngles};
use lacuna_interfaces::{BadInput, RobotFile};
pub use parameters::{Forearm, PARAMETERS, grey_box};
use parameters::{GC, GS, INERTIA, M_GR, M_IN, M_JE};

/// A Delta robot: geometry, gravity and the linear parameters of its dynamics.
#[derive(Debug, Clone)]
pub struct Delta {
    l1: f64,
    l2: f64,
    /// Base radius minus platform radius [m].
    r: f64,
    cos_alpha: [f64; 3],
    sin_alpha: [f64; 3],
    gravity: Vec3,
    masses: lacuna_interfaces::robot::Mass,
    parameters: Vec<Parameter>,
}

impl Delta {
    /// The Delta that a robot file of kind "delta" describes.
    ///
    /// # Errors
    /// [`BadInput`] if the file does not pass [`RobotFile::validate`] or is of another kind.
    pub fn new(robot: &RobotFile) -> Result<Self, BadInput> {
        robot.validate()?;
        let (Some(g), Some(m)) = (&robot.geometry, &robot.mass) else {
            return Err(BadInput::new("kind: found \"serial\"; expected \"delta\" with [geometry] and [mass]"));
        };
        let alpha = g.alpha_deg.map(f64::to_radians);
        Ok(Self {
            l1: g.l1,
            l2: g.l2,
            r: g.ra - g.rb,
            cos_alpha: alpha.map(f64::cos),
            sin_alpha: alpha.map(f64::sin),
            gravity: Vec3::from(robot.env.gravity),
            masses: m.clone(),
            parameters: parameters::list(g.l1, m),
        })
    }

    /// Upper arm length l1 [m].
    pub fn l1_m(&self) -> f64 {
        self.l1
    }

    /// Forearm length l2 [m].
    pub fn l2_m(&self) -> f64 {
        self.l2
    }

    /// Base radius minus platform radius r = r_a − r_b [m].
    pub fn r_m(&self) -> f64 {
        self.r
    }

    /// The parameter vector of forearms with distributed mass instead of the robot file's point masses.
    pub fn distributed_forearms(&self, forearm: &Forearm) -> [f64; PARAMETERS] {
        parameters::distributed(self.l1, self.l2, &self.masses, forearm)
    }

    /// Y(q, q̇, q̈) π from the kinematics.
    //
    // Inlined by force here and in the kinematics: a DeltaState is 700 bytes, and returning it through calls
    // costs 40 of 135 ns in copies (measured with benches/dynamics.rs).
    #[inline(always)]
    fn torque_at(&self, state: &DeltaState, pi: &[f64; PARAMETERS]) -> [f64; 3] {
        let pose = &state.pose;
        let m_je = pi[M_JE];
        let mut f = pi[M_IN] * state.xdd - pi[M_GR] * self.gravity;
        if m_je != 0.0 {
            for k in 0..3 {
                f += m_je * state.elbow_acceleration(k);
            }
        }
        let per_l1 = 1.0 / self.l1;
        std::array::from_fn(|i| {
            pi[INERTIA + i] * state.qdd[i]
                - per_l1 * (pi[GC + i] * self.gravity.dot(&pose.u[i]) + pi[GS + i] * self.gravity.dot(&pose.w[i]))
                + m_je * pose.u[i].dot(&state.xdd)
                - pose.k[i] * pose.a_inv[i].dot(&f)
        })
    }

    /// Jᵀγ from the kinematics.
    #[inline(always)]
    fn payload_at(&self, state: &DeltaState) -> [f64; 3] {
        state.pose.transpose_times(&(state.xdd - self.gravity))
    }

    #[inline(always)]
    fn state_of(&self, motion: &Motion<'_>) -> Result<DeltaState, Unreachable> {
        self.state(three("q", motion.q_rad)?, three("qd", motion.qd_rad_s)?, three("qdd", motion.qdd_rad_s2)?)
    }
}

/// The slice as an array of three.
#[inline]
fn three<'a>(what: &'static str, values: &'a [f64]) -> Result<&'a [f64; 3], Unreachable> {
    values.try_into().map_err(|_| Unreachable::Shape { what, found: values.len(), expected: 3 })
}

#[inline]
fn pi_of(pi: &[f64]) -> Result<&[f64; PARAMETERS], Unreachable> {
    pi.try_into().map_err(|_| Unreachable::Shape { what: "pi", found: pi.len(), expected: PARAMETERS })
}

/// Writes a 3 × 3 matrix row by row.
fn write_rows(m: &crate::Mat3, out: &mut [f64]) -> Result<(), Unreachable> {
    check_len("jacobian", out.len(), 9)?;
    for (row, values) in out.chunks_exact_mut(3).enumerate() {
        for (column, v) in values.iter_mut().enumerate() {
            *v = m[(row, column)];
        }
    }
    Ok(())
}

impl RigidBody for Delta {
    fn joint_count(&self) -> usize {
        3
    }

    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    fn gravity_m_s2(&self) -> [f64; 3] {
        self.gravity.into()
    }

    fn with_gravity(&self, gravity_m_s2: [f64; 3]) -> Box<dyn RigidBody> {
        Box::new(Self { gravity: Vec3::from(gravity_m_s2), ..self.clone() })
    }

    fn torque(&self, motion: &Motion<'_>, pi: &[f64], tau: &mut [f64]) -> Result<(), Unreachable> {
        check_len("tau", tau.len(), 3)?;
        let pi = pi_of(pi)?;
        let state = self.state_of(motion)?;
        tau.copy_from_slice(&self.torque_at(&state, pi));
        check_result(tau)
    }

    fn regressor(&self, motion: &Motion<'_>, y: &mut [f64]) -> Result<(), Unreachable> {
        check_len("regressor", y.len(), 3 * PARAMETERS)?;
        let state = self.state_of(motion)?;
        let pose = &state.pose;
        let inertial = pose.transpose_times(&state.xdd);
        let weight = pose.transpose_times(&-self.gravity);
        let elbows: Vec3 = (0..3).map(|k| state.elbow_acceleration(k)).sum();
        let coupling = pose.transpose_times(&elbows);
        y.fill(0.0);
        for (i, row) in y.chunks_exact_mut(PARAMETERS).enumerate() {
            row[INERTIA + i] = state.qdd[i];
            row[GC + i] = -self.gravity.dot(&pose.u[i]) / self.l1;
            row[GS + i] = -self.gravity.dot(&pose.w[i]) / self.l1;
            row[M_IN] = inertial[i];
            row[M_GR] = weight[i];
            row[M_JE] = pose.u[i].dot(&state.xdd) + coupling[i];
        }
        check_result(y)
    }

    fn payload_column(&self, motion: &Motion<'_>, column: &mut [f64]) -> Result<(), Unreachable> {
        check_len("column", column.len(), 3)?;
        let state = self.state_of(motion)?;
        column.copy_from_slice(&self.payload_at(&state));
        check_result(column)
    }

    fn evaluate(&self, motion: &Motion<'_>, nominal: &[f64], rigid: &[f64]) -> Result<Evaluation, Unreachable> {
        let (nominal, rigid) = (pi_of(nominal)?, pi_of(rigid)?);
        let state = self.state_of(motion)?;
        let mut out = Evaluation::default();
        out.tau_nominal_nm[..3].copy_from_slice(&self.torque_at(&state, nominal));
        out.tau_rigid_nm[..3].copy_from_slice(&self.torque_at(&state, rigid));
        out.payload_column_nm_kg[..3].copy_from_slice(&self.payload_at(&state));
        check_result(&out.tau_nominal_nm)?;
        check_result(&out.tau_rigid_nm)?;
        check_result(&out.payload_column_nm_kg)?;
        Ok(out)
    }

    fn tip(&self, q_rad: &[f64]) -> Result<Tip, Unreachable> {
        let pose = self.pose(three("q", q_rad)?)?;
        Ok(Tip { position_m: pose.x.into(), rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] })
    }

    fn tip_motion(&self, motion: &Motion<'_>) -> Result<TipMotion, Unreachable> {
        let state = self.state_of(motion)?;
        Ok(TipMotion {
            position_m: state.pose.x.into(),
            velocity_m_s: state.xd.into(),
            acceleration_m_s2: state.xdd.into(),
        })
    }

    fn jacobian(&self, q_rad: &[f64], j: &mut [f64]) -> Result<(), Unreachable> {
        write_rows(&self.pose(three("q", q_rad)?)?.jacobian(), j)
    }

    fn jacobian_rate(&self, q_rad: &[f64], qd_rad_s: &[f64], j_rate: &mut [f64]) -> Result<(), Unreachable> {
        let state = self.state(three("q", q_rad)?, three("qd", qd_rad_s)?, &[0.0; 3])?;
        write_rows(&state.jacobian_rate(), j_rate)?;
        check_result(j_rate)
    }

    fn external_force(&self, q_rad: &[f64], force_n: [f64; 3], tau: &mut [f64]) -> Result<(), Unreachable> {
        check_len("tau", tau.len(), 3)?;
        let pose = self.pose(three("q", q_rad)?)?;
        tau.copy_from_slice(&pose.transpose_times(&-Vec3::from(force_n)));
        check_result(tau)
    }

    fn as_delta(&self) -> Option<&Delta> {
        Some(self)
    }
}
