//! The robot as effects see it.

use super::kernel::EffectSample;
use crate::{Delta, Motion, RigidBody, TipMotion};
use lacuna_interfaces::robot::{JointType, Kind};
use lacuna_interfaces::{BadInput, Joints, MAX_JOINTS, RobotFile};

/// What an effect may know of the robot when its kernel is made.
#[derive(Debug, Clone, Copy)]
pub struct EffectContext<'a> {
    /// The robot file.
    pub robot: &'a RobotFile,
    /// Text of the URDF that the robot file names, if it names one.
    pub urdf: Option<&'a str>,
    /// Its mechanics.
    pub body: &'a dyn RigidBody,
    /// Linear parameters π in use, as `body.parameters()` lists them.
    pub pi: &'a [f64],
}

impl EffectContext<'_> {
    /// Number of joints.
    pub fn joint_count(&self) -> usize {
        self.body.joint_count().min(MAX_JOINTS)
    }

    /// Checks that robot file, mechanics and parameters belong together.
    ///
    /// # Errors
    /// [`BadInput`] with both numbers.
    pub fn check(&self) -> Result<(), BadInput> {
        let (file, body) = (self.robot.joint_count(), self.body.joint_count());
        if file != body {
            return Err(BadInput::new(format!("joints: the robot file names {file}; expected {body}")));
        }
        let (found, expected) = (self.pi.len(), self.body.parameters().len());
        if found != expected {
            return Err(BadInput::new(format!("pi: found {found} parameters; expected {expected}")));
        }
        Ok(())
    }

    /// Motor turns per joint turn; 1 where the robot file does not say.
    pub fn gear_ratio(&self, joint: usize) -> f64 {
        self.robot.drive.gear_ratio.as_ref().and_then(|g| g.get(joint)).unwrap_or(1.0)
    }

    /// True if `joint` slides instead of turning.
    pub fn is_prismatic(&self, joint: usize) -> bool {
        match self.robot.dh.get(joint) {
            Some(row) => row.joint == JointType::Prismatic,
            // A URDF: the chain says so in the unit of the rotor inertia.
            None => self.index_of("Ia", joint).is_some_and(|k| self.body.parameters()[k].unit == "kg"),
        }
    }

    /// Index in π of parameter `symbol` of `joint`.
    pub fn index_of(&self, symbol: &str, joint: usize) -> Option<usize> {
        let name = format!("{symbol}{}", joint + 1);
        self.body.parameters().iter().position(|p| p.symbol == name)
    }

    /// Rotor and gear inertia at the joint side [kg m²]: what accelerates with the motor and does not load
    /// the gear. A serial arm has it in π; a Delta's π holds only the sum with the arm, so there it is the
    /// robot file's.
    pub fn rotor_inertia_kg_m2(&self) -> Joints {
        std::array::from_fn(|j| match self.robot.kind {
            Kind::Delta if j < self.joint_count() => self.robot.mass.as_ref().map_or(0.0, |m| m.rotor_inertia),
            Kind::Delta => 0.0,
            Kind::Serial => self.index_of("Ia", j).and_then(|k| self.pi.get(k)).copied().unwrap_or(0.0),
        })
    }

    /// π without the rotors.
    pub fn pi_link(&self) -> Vec<f64> {
        let mut pi = self.pi.to_vec();
        let symbol = match self.robot.kind {
            Kind::Delta => "I",
            Kind::Serial => "Ia",
        };
        for (j, rotor) in self.rotor_inertia_kg_m2().into_iter().enumerate().take(self.joint_count()) {
            if let Some(slot) = self.index_of(symbol, j).and_then(|k| pi.get_mut(k)) {
                *slot -= rotor;
            }
        }
        pi
    }

    /// The mechanics for a kernel to keep.
    pub(super) fn mechanics(&self) -> Mechanics {
        self.mechanics_under(self.body.gravity_m_s2())
    }

    /// The same under another gravity [m/s²].
    pub(super) fn mechanics_under(&self, gravity_m_s2: [f64; 3]) -> Mechanics {
        Mechanics { n: self.joint_count(), body: self.body.with_gravity(gravity_m_s2) }
    }

    /// The Delta, for effects that only a Delta has.
    pub(super) fn delta(&self) -> Result<Delta, BadInput> {
        self.body.as_delta().cloned().ok_or_else(|| BadInput::new("found a serial arm; expected a Delta"))
    }
}

/// A robot's mechanics over [`Joints`]; `None` where a pose has no answer.
#[derive(Debug)]
pub(super) struct Mechanics {
    n: usize,
    body: Box<dyn RigidBody>,
}

impl Mechanics {
    /// Made of another body (a perturbed robot).
    pub(super) fn of(body: Box<dyn RigidBody>) -> Self {
        Self { n: body.joint_count().min(MAX_JOINTS), body }
    }

    /// Y(q, q̇, q̈) π.
    #[inline]
    pub(super) fn torque(&self, q: &Joints, qd: &Joints, qdd: &Joints, pi: &[f64]) -> Option<Joints> {
        let mut tau = [0.0; MAX_JOINTS];
        self.body.torque(&self.motion(q, qd, qdd), pi, &mut tau[..self.n]).ok()?;
        Some(tau)
    }

    /// ∂τ/∂m_p.
    pub(super) fn payload_column(&self, s: &EffectSample<'_>) -> Option<Joints> {
        let mut tau = [0.0; MAX_JOINTS];
        let motion = self.motion(s.q_rad, s.qd_rad_s, s.qdd_rad_s2);
        self.body.payload_column(&motion, &mut tau[..self.n]).ok()?;
        Some(tau)
    }

    /// −Jᵀ F.
    pub(super) fn external_force(&self, q: &Joints, force_n: [f64; 3]) -> Option<Joints> {
        let mut tau = [0.0; MAX_JOINTS];
        self.body.external_force(&q[..self.n], force_n, &mut tau[..self.n]).ok()?;
        Some(tau)
    }

    /// Motion of platform or tip.
    pub(super) fn tip_motion(&self, s: &EffectSample<'_>) -> Option<TipMotion> {
        self.body.tip_motion(&self.motion(s.q_rad, s.qd_rad_s, s.qdd_rad_s2)).ok()
    }

    fn motion<'a>(&self, q: &'a Joints, qd: &'a Joints, qdd: &'a Joints) -> Motion<'a> {
        Motion { q_rad: &q[..self.n], qd_rad_s: &qd[..self.n], qdd_rad_s2: &qdd[..self.n] }
    }
}
