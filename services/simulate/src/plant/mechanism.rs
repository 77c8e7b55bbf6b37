//! What the closed loop needs of a robot's mechanics.

use super::linalg::JointMatrix;
use crate::plant::{Delta, Serial};
use lacuna_interfaces::Joints;
use nalgebra::Vector3;

/// What acts on the mechanics from outside the joints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Loads {
    /// Gravity in the base frame [m/s²], tilt and base motion included.
    pub gravity: Vector3<f64>,
    /// Payload mass at the tip [kg], a point.
    pub payload_kg: f64,
    /// First moment of the payload in the tip's frame [kg m]; a Delta's platform does not turn and feels none.
    pub payload_moment: Vector3<f64>,
    /// External force on the tip, base frame [N].
    pub force: Vector3<f64>,
    /// Square-law drag coefficient of the tip [N s²/m²].
    pub drag: f64,
}

impl Loads {
    /// Gravity alone.
    pub fn gravity(gravity: [f64; 3]) -> Self {
        Self {
            gravity: gravity.into(),
            payload_kg: 0.0,
            payload_moment: Vector3::zeros(),
            force: Vector3::zeros(),
            drag: 0.0,
        }
    }
}

/// M(q) q̈ + h(q, q̇) = τ at one state, link side.
#[derive(Debug, Clone, Copy, Default)]
pub struct Dynamics {
    /// Inertia matrix M [kg m²].
    pub inertia: JointMatrix,
    /// Bias h: Coriolis, centrifugal, gravity, external forces [Nm].
    pub bias: Joints,
    /// Tip position [m], base frame.
    pub tip: Vector3<f64>,
    /// Tip velocity [m/s].
    pub tip_velocity: Vector3<f64>,
}

/// The pose does not exist: the legs do not reach each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Unreachable;

/// A robot's mechanics, rotors not included.
#[derive(Debug, Clone, PartialEq)]
pub enum Mechanism {
    /// Three-leg Delta.
    Delta(Box<Delta>),
    /// Open chain.
    Serial(Box<Serial>),
}

impl Mechanism {
    /// Number of joints.
    pub fn joints(&self) -> usize {
        match self {
            Self::Delta(_) => 3,
            Self::Serial(chain) => chain.joints(),
        }
    }

    /// M and h at (q, q̇).
    ///
    /// # Errors
    /// [`Unreachable`] outside the workspace.
    pub fn dynamics(&self, q: &Joints, qd: &Joints, loads: &Loads, out: &mut Dynamics) -> Result<(), Unreachable> {
        match self {
            Self::Delta(delta) => delta.dynamics(q, qd, loads, out),
            Self::Serial(chain) => {
                chain.dynamics(q, qd, loads, out);
                Ok(())
            }
        }
    }

    /// τ = M q̈ + h, for feed-forward and for the hidden share of a recording.
    ///
    /// # Errors
    /// [`Unreachable`] outside the workspace.
    pub fn inverse(&self, q: &Joints, qd: &Joints, qdd: &Joints, loads: &Loads) -> Result<Joints, Unreachable> {
        let mut d = Dynamics::default();
        self.dynamics(q, qd, loads, &mut d)?;
        let mut tau = d.bias;
        for i in 0..self.joints() {
            for j in 0..self.joints() {
                tau[i] += d.inertia[i][j] * qdd[j];
            }
        }
        Ok(tau)
    }

    /// Kinetic plus potential energy [J]; the potential's zero is the base origin's height.
    ///
    /// # Errors
    /// [`Unreachable`] outside the workspace.
    pub fn energy(&self, q: &Joints, qd: &Joints, loads: &Loads) -> Result<f64, Unreachable> {
        let mut d = Dynamics::default();
        self.dynamics(q, qd, loads, &mut d)?;
        let mut kinetic = 0.0;
        for i in 0..self.joints() {
            for j in 0..self.joints() {
                kinetic += 0.5 * qd[i] * d.inertia[i][j] * qd[j];
            }
        }
        let potential = match self {
            Self::Delta(delta) => delta.potential(q, loads)?,
            Self::Serial(chain) => chain.potential(q, loads),
        };
        Ok(kinetic + potential)
    }

    /// How far the pose is from the workspace's edge and from singularities, 0 (there) to about 1. Open
    /// chains have no edge: 1.
    pub fn margin(&self, q: &Joints) -> f64 {
        match self {
            Self::Delta(delta) => delta.margin(q),
            Self::Serial(_) => 1.0,
        }
    }
}
