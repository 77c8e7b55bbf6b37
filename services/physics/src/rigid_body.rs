//! The one interface to a robot's rigid-body mechanics, and how it is made from a robot file.

use crate::{Delta, SerialChain, delta};
use lacuna_interfaces::model::RigidBodyModel;
use lacuna_interfaces::robot::Kind;
use lacuna_interfaces::{BadInput, Joints, RobotFile};
use thiserror::Error;

/// Position, velocity and acceleration of all joints at one instant; each slice has one entry per joint.
#[derive(Debug, Clone, Copy)]
pub struct Motion<'a> {
    /// Joint positions q [rad] (prismatic: m).
    pub q_rad: &'a [f64],
    /// Joint velocities q̇ [rad/s] (prismatic: m/s).
    pub qd_rad_s: &'a [f64],
    /// Joint accelerations q̈ [rad/s²] (prismatic: m/s²).
    pub qdd_rad_s2: &'a [f64],
}

/// One entry of the linear parameter vector π.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// Symbol, unique within a robot; the key in a model file (`I1`, `gc2`, `m_in`; serial: `Ixx3`, `mx3`, `Ia3`).
    pub symbol: String,
    /// SI unit.
    pub unit: &'static str,
    /// Value that follows from the robot file.
    pub nominal: f64,
    /// Joint or link it belongs to (0-based); `None` for the structure as a whole.
    pub joint: Option<usize>,
    /// What it is, in words.
    pub meaning: String,
}

/// Why a model has no answer for a pose.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum Unreachable {
    /// Delta, forward kinematics: the three forearms cannot meet in one point.
    #[error(
        "no platform position: the elbows lie on a circle of radius {circumradius_m:.6} m; expected less than the forearm length {l2_m:.6} m"
    )]
    ForearmsTooShort {
        /// Radius of the circle through the elbows [m].
        circumradius_m: f64,
        /// Forearm length [m].
        l2_m: f64,
    },
    /// Delta, inverse kinematics: the platform position is beyond the reach of a leg.
    #[error("leg {}: the position is out of its reach: cosine {cosine:.6}; expected -1 to 1", leg + 1)]
    Leg {
        /// Leg (0-based).
        leg: usize,
        /// n / √(ℓ² + p²), beyond ±1 where no elbow angle exists.
        cosine: f64,
    },
    /// Delta: the forearms lie in one plane, the platform's motion does not follow from the joints'.
    #[error("singular pose: normalised forearm determinant {determinant:.3e}; expected magnitude above {limit:.0e}")]
    Singular {
        /// det(s1 s2 s3) / l2³.
        determinant: f64,
        /// Smallest magnitude that is accepted.
        limit: f64,
    },
    /// A joint value is NaN or infinite.
    #[error("joint {}: found a value that is not finite", joint + 1)]
    NotFinite {
        /// Joint (0-based).
        joint: usize,
    },
    /// The values are finite but so large that the result is not.
    #[error("the result is not finite: the motion or the parameters are too large to be calculated with")]
    Overflow,
    /// A slice has the wrong number of entries.
    #[error("{what}: found {found} entries; expected {expected}")]
    Shape {
        /// Which slice.
        what: &'static str,
        /// Entries found.
        found: usize,
        /// Entries expected.
        expected: usize,
    },
    /// Serial, inverse kinematics: the iteration stopped short of the target.
    #[error("no joint position found: {error_m:.3e} m and {error_rad:.3e} rad off after {iterations} iterations")]
    NoConvergence {
        /// Iterations made.
        iterations: usize,
        /// Remaining distance [m].
        error_m: f64,
        /// Remaining rotation [rad]; 0 if only a position was asked for.
        error_rad: f64,
    },
}

/// Pose of the platform (Delta) or of the tip frame (serial) in the base frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tip {
    /// Position [m].
    pub position_m: [f64; 3],
    /// Rotation matrix, row by row: base coordinates = R · tip coordinates. The identity for a Delta, whose
    /// platform only translates.
    pub rotation: [[f64; 3]; 3],
}

/// Motion of the platform (Delta) or of the tip (serial) in the base frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TipMotion {
    /// Position [m].
    pub position_m: [f64; 3],
    /// Velocity J q̇ [m/s].
    pub velocity_m_s: [f64; 3],
    /// Acceleration J q̈ + J̇ q̇ [m/s²], gravity not included.
    pub acceleration_m_s2: [f64; 3],
}

/// Torques of two parameter vectors and the payload column at one motion, from one kinematic pass.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Evaluation {
    /// Torque of the first parameter vector [Nm]; 0 beyond the joints in use.
    pub tau_nominal_nm: Joints,
    /// Torque of the second parameter vector [Nm].
    pub tau_rigid_nm: Joints,
    /// ∂τ/∂m_p [Nm/kg].
    pub payload_column_nm_kg: Joints,
}

/// Rigid-body mechanics of a robot with n joints and p linear dynamic parameters.
///
/// Nothing here allocates except [`RigidBody::with_gravity`]. Every slice length is checked
/// ([`Unreachable::Shape`]); after an error the output slices hold no particular values.
pub trait RigidBody: std::fmt::Debug + Send + Sync {
    /// Number of joints n.
    fn joint_count(&self) -> usize;

    /// The full linear parameter vector π: p entries in the order of `pi` and of the regressor's columns.
    /// Not all of them are identifiable from torques; finding the base set is identification's work.
    fn parameters(&self) -> &[Parameter];

    /// Gravity in the base frame [m/s²].
    fn gravity_m_s2(&self) -> [f64; 3];

    /// The same robot under another gravity vector [m/s²] (a tilted base). τ is linear in it.
    fn with_gravity(&self, gravity_m_s2: [f64; 3]) -> Box<dyn RigidBody>;

    /// Inverse dynamics: `tau` = Y(q, q̇, q̈) `pi` [Nm], n entries.
    ///
    /// # Errors
    /// [`Unreachable`] where the pose has no torque, a value is not finite or a slice has the wrong length.
    fn torque(&self, motion: &Motion<'_>, pi: &[f64], tau: &mut [f64]) -> Result<(), Unreachable>;

    /// Regressor Y: n × p, row-major, in the units [Nm] per unit of the parameter.
    ///
    /// # Errors
    /// As [`RigidBody::torque`].
    fn regressor(&self, motion: &Motion<'_>, y: &mut [f64]) -> Result<(), Unreachable>;

    /// ∂τ/∂m_p [Nm/kg], n entries: Jᵀγ with γ = ẍ − g at the platform or tip (NOTATION.md, payload).
    ///
    /// # Errors
    /// As [`RigidBody::torque`].
    fn payload_column(&self, motion: &Motion<'_>, column: &mut [f64]) -> Result<(), Unreachable>;

    /// Torques of two parameter vectors and the payload column, sharing the kinematics: what the torque
    /// stage needs of every sample.
    ///
    /// # Errors
    /// As [`RigidBody::torque`].
    fn evaluate(&self, motion: &Motion<'_>, nominal: &[f64], rigid: &[f64]) -> Result<Evaluation, Unreachable>;

    /// Pose of the platform or tip.
    ///
    /// # Errors
    /// As [`RigidBody::torque`].
    fn tip(&self, q_rad: &[f64]) -> Result<Tip, Unreachable>;

    /// Position, velocity and acceleration of the platform or tip.
    ///
    /// # Errors
    /// As [`RigidBody::torque`].
    fn tip_motion(&self, motion: &Motion<'_>) -> Result<TipMotion, Unreachable>;

    /// Translational Jacobian J: 3 × n, row-major, base frame; ẋ = J q̇ [m/rad; prismatic: 1].
    ///
    /// # Errors
    /// As [`RigidBody::torque`].
    fn jacobian(&self, q_rad: &[f64], j: &mut [f64]) -> Result<(), Unreachable>;

    /// Time derivative J̇ of the translational Jacobian: 3 × n, row-major; ẍ = J q̈ + J̇ q̇.
    ///
    /// # Errors
    /// As [`RigidBody::torque`].
    fn jacobian_rate(&self, q_rad: &[f64], qd_rad_s: &[f64], j_rate: &mut [f64]) -> Result<(), Unreachable>;

    /// Motor torque [Nm] that a force F [N, base frame] exerted by the surroundings on the platform or tip
    /// calls for: −Jᵀ F, to be added to [`RigidBody::torque`] (a weight hung on the tip is F = m g).
    ///
    /// # Errors
    /// As [`RigidBody::torque`].
    fn external_force(&self, q_rad: &[f64], force_n: [f64; 3], tau: &mut [f64]) -> Result<(), Unreachable>;

    /// The Delta behind this interface, if it is one.
    fn as_delta(&self) -> Option<&Delta> {
        None
    }

    /// The serial chain behind this interface, if it is one.
    fn as_serial(&self) -> Option<&SerialChain> {
        None
    }

    /// The robot file's values of π.
    fn nominal(&self) -> Vec<f64> {
        self.parameters().iter().map(|p| p.nominal).collect()
    }
}

/// Makes the mechanics that a robot file describes. `urdf` is the text of the URDF it names, if it names one.
///
/// # Errors
/// [`BadInput`] if the robot file or the URDF cannot be used; the URDF's errors carry its line.
pub fn build(robot: &RobotFile, urdf: Option<&str>) -> Result<Box<dyn RigidBody>, BadInput> {
    Ok(match robot.kind {
        Kind::Delta => Box::new(Delta::new(robot)?),
        Kind::Serial => Box::new(SerialChain::new(robot, urdf)?),
    })
}

/// π as a model file's `[rigid_body]` has it: ρ1 and ρ2 of a Delta's grey box, or values by symbol; what the
/// model does not give keeps the robot file's value.
///
/// # Errors
/// [`BadInput`] for ρ1 or ρ2 of a robot that is not a Delta, for both ways at once, for a value that is not
/// finite and for an unknown symbol, with the symbols that exist.
pub fn parameters_of(body: &dyn RigidBody, model: &RigidBodyModel) -> Result<Vec<f64>, BadInput> {
    let mut pi = body.nominal();
    if model.rho1.is_some() || model.rho2.is_some() {
        if !model.parameters.is_empty() {
            return Err(BadInput::new("rigid_body: found rho1 or rho2 together with parameters; expected one way"));
        }
        let (rho1, rho2) = (model.rho1.unwrap_or(1.0), model.rho2.unwrap_or(1.0));
        finite_value("rho1", rho1)?;
        finite_value("rho2", rho2)?;
        let nominal: Option<&[f64; delta::PARAMETERS]> = pi.as_slice().try_into().ok();
        let (Some(_), Some(nominal)) = (body.as_delta(), nominal) else {
            return Err(BadInput::new(
                "rigid_body: found rho1 or rho2, which a Delta has; expected parameters by symbol",
            ));
        };
        return Ok(delta::grey_box(nominal, rho1, rho2).to_vec());
    }
    for (symbol, &value) in &model.parameters {
        finite_value(symbol, value)?;
        let Some(slot) = body.parameters().iter().position(|p| &p.symbol == symbol) else {
            let known: Vec<&str> = body.parameters().iter().map(|p| p.symbol.as_str()).collect();
            return Err(BadInput::new(format!(
                "rigid_body.parameters: found \"{symbol}\"; expected symbols among {}",
                known.join(", ")
            )));
        };
        pi[slot] = value;
    }
    Ok(pi)
}

fn finite_value(symbol: &str, value: f64) -> Result<(), BadInput> {
    if value.is_finite() {
        return Ok(());
    }
    Err(BadInput::new(format!("rigid_body: {symbol} = {value}; expected a finite number")))
}

/// Refuses a result that overflowed.
#[inline]
pub(crate) fn check_result(values: &[f64]) -> Result<(), Unreachable> {
    // Without early exit, so that the compiler can look at several at once: a regressor has hundreds.
    if values.iter().fold(true, |all, v| all & v.is_finite()) { Ok(()) } else { Err(Unreachable::Overflow) }
}

/// Refuses a slice of the wrong length.
#[inline]
pub(crate) fn check_len(what: &'static str, found: usize, expected: usize) -> Result<(), Unreachable> {
    if found == expected { Ok(()) } else { Err(Unreachable::Shape { what, found, expected }) }
}
