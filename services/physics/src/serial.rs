//! Open chains of 1 to 8 revolute or prismatic joints, from classic DH rows or a URDF.
//!
//! Recursive Newton-Euler in link frames (Luh, Walker, Paul 1980; Featherstone 2008, ch. 5). Each link has
//! eleven linear parameters at its frame's origin, in this order:
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | `m` | mass | kg |
//! | `mx`, `my`, `mz` | first moments m c | kg m |
//! | `Ixx`, `Ixy`, `Ixz`, `Iyy`, `Iyz`, `Izz` | inertia about the frame's origin | kg m² |
//! | `Ia` | rotor and gear inertia at the joint side: Ia q̈ | kg m² (prismatic: kg) |
//!
//! The symbol ends with the 1-based number of the link (`Ixx3`). The frame is the DH frame at the end of the
//! row, or the URDF's child link frame; links behind fixed joints are merged into it.
//!
//! [`chain`] holds the geometry of a joint, [`dynamics`] the recursions, [`kinematics`] pose and Jacobian,
//! [`urdf`] the reader.

pub mod chain;
pub mod dynamics;
pub mod kinematics;
pub mod urdf;

use crate::rigid_body::{check_len, check_result};
use crate::{Evaluation, Motion, Parameter, RigidBody, Tip, TipMotion, Unreachable, Vec3};
use chain::{Joint, Placement, Segment};
pub use kinematics::Target;
use lacuna_interfaces::{BadInput, MAX_JOINTS, RobotFile};

/// Parameters per link.
pub const PER_LINK: usize = 11;
/// Index of the rotor inertia within a link's parameters.
const IA: usize = 10;

/// An open chain: geometry, gravity and the linear parameters of its dynamics.
#[derive(Debug, Clone)]
pub struct SerialChain {
    joints: Vec<Joint>,
    /// Tip frame in the last link's frame.
    tip: Placement,
    gravity: Vec3,
    parameters: Vec<Parameter>,
}

impl SerialChain {
    /// The chain that a robot file of kind "serial" describes; `urdf` is the text of the URDF it names.
    ///
    /// The tip is the last DH frame; of a URDF, the last link's frame, or the frame behind it as long as
    /// exactly one fixed joint leads on (a flange).
    ///
    /// # Errors
    /// [`BadInput`] if the robot file does not pass [`RobotFile::validate`], its URDF is not given, or the
    /// URDF does not hold the named joints as one chain.
    pub fn new(robot: &RobotFile, urdf: Option<&str>) -> Result<Self, BadInput> {
        robot.validate()?;
        let gravity = Vec3::from(robot.env.gravity);
        let (segments, tip) = match (&robot.urdf, urdf) {
            (Some(_), Some(text)) => urdf::read(text, &robot.joints)?,
            (Some(path), None) => {
                return Err(BadInput::new(format!("urdf: the robot file names {path}, whose text was not given")));
            }
            (None, _) if robot.dh.is_empty() => {
                return Err(BadInput::new("kind: found \"delta\"; expected \"serial\" with a urdf or [[dh]]"));
            }
            (None, _) => (chain::from_dh(robot), Placement::IDENTITY),
        };
        Ok(Self::assemble(segments, tip, gravity))
    }

    fn assemble(segments: Vec<Segment>, tip: Placement, gravity: Vec3) -> Self {
        let mut parameters = Vec::with_capacity(PER_LINK * segments.len());
        for (i, segment) in segments.iter().enumerate() {
            chain::push_parameters(i, segment, &mut parameters);
        }
        Self { joints: segments.iter().map(Joint::new).collect(), tip, gravity, parameters }
    }

    fn check_q(&self, q_rad: &[f64]) -> Result<(), Unreachable> {
        check_len("q", q_rad.len(), self.joints.len())?;
        finite(q_rad)
    }

    fn check_motion(&self, motion: &Motion<'_>) -> Result<(), Unreachable> {
        let n = self.joints.len();
        check_len("q", motion.q_rad.len(), n)?;
        check_len("qd", motion.qd_rad_s.len(), n)?;
        check_len("qdd", motion.qdd_rad_s2.len(), n)?;
        finite(motion.q_rad)?;
        finite(motion.qd_rad_s)?;
        finite(motion.qdd_rad_s2)
    }
}

#[inline]
fn finite(values: &[f64]) -> Result<(), Unreachable> {
    match values.iter().position(|v| !v.is_finite()) {
        Some(joint) => Err(Unreachable::NotFinite { joint }),
        None => Ok(()),
    }
}

impl RigidBody for SerialChain {
    fn joint_count(&self) -> usize {
        self.joints.len()
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
        self.check_motion(motion)?;
        check_len("pi", pi.len(), self.parameters.len())?;
        check_len("tau", tau.len(), self.joints.len())?;
        self.newton_euler(&self.sweep(motion), motion.qdd_rad_s2, pi, tau);
        check_result(tau)
    }

    fn regressor(&self, motion: &Motion<'_>, y: &mut [f64]) -> Result<(), Unreachable> {
        self.check_motion(motion)?;
        check_len("regressor", y.len(), self.parameters.len() * self.joints.len())?;
        self.fill_regressor(&self.sweep(motion), motion.qdd_rad_s2, y);
        check_result(y)
    }

    fn payload_column(&self, motion: &Motion<'_>, column: &mut [f64]) -> Result<(), Unreachable> {
        self.check_motion(motion)?;
        check_len("column", column.len(), self.joints.len())?;
        self.tip_mass(&self.sweep(motion), column);
        check_result(column)
    }

    fn evaluate(&self, motion: &Motion<'_>, nominal: &[f64], rigid: &[f64]) -> Result<Evaluation, Unreachable> {
        self.check_motion(motion)?;
        check_len("pi", nominal.len(), self.parameters.len())?;
        check_len("pi", rigid.len(), self.parameters.len())?;
        let n = self.joints.len().min(MAX_JOINTS);
        let links = self.sweep(motion);
        let mut out = Evaluation::default();
        self.newton_euler(&links, motion.qdd_rad_s2, nominal, &mut out.tau_nominal_nm[..n]);
        self.newton_euler(&links, motion.qdd_rad_s2, rigid, &mut out.tau_rigid_nm[..n]);
        self.tip_mass(&links, &mut out.payload_column_nm_kg[..n]);
        check_result(&out.tau_nominal_nm)?;
        check_result(&out.tau_rigid_nm)?;
        check_result(&out.payload_column_nm_kg)?;
        Ok(out)
    }

    fn tip(&self, q_rad: &[f64]) -> Result<Tip, Unreachable> {
        self.check_q(q_rad)?;
        let tip = self.tip_pose(q_rad);
        check_result(&tip.position_m)?;
        Ok(tip)
    }

    fn tip_motion(&self, motion: &Motion<'_>) -> Result<TipMotion, Unreachable> {
        self.check_motion(motion)?;
        let tip = self.tip_motion_at(motion);
        check_result(&tip.position_m)?;
        check_result(&tip.velocity_m_s)?;
        check_result(&tip.acceleration_m_s2)?;
        Ok(tip)
    }

    fn jacobian(&self, q_rad: &[f64], j: &mut [f64]) -> Result<(), Unreachable> {
        self.check_q(q_rad)?;
        check_len("jacobian", j.len(), 3 * self.joints.len())?;
        self.fill_jacobian(q_rad, j);
        check_result(j)
    }

    fn jacobian_rate(&self, q_rad: &[f64], qd_rad_s: &[f64], j_rate: &mut [f64]) -> Result<(), Unreachable> {
        self.check_q(q_rad)?;
        self.check_q(qd_rad_s)?;
        check_len("jacobian", j_rate.len(), 3 * self.joints.len())?;
        self.fill_jacobian_rate(q_rad, qd_rad_s, j_rate);
        check_result(j_rate)
    }

    fn external_force(&self, q_rad: &[f64], force_n: [f64; 3], tau: &mut [f64]) -> Result<(), Unreachable> {
        self.check_q(q_rad)?;
        check_len("tau", tau.len(), self.joints.len())?;
        self.fill_external_force(q_rad, Vec3::from(force_n), tau);
        check_result(tau)
    }

    fn as_serial(&self) -> Option<&SerialChain> {
        Some(self)
    }
}
