//! The true robot: mechanics, drives and sensors with everything that is wrong with them.

use super::friction::JointFriction;
use super::linalg::{JointMatrix, invert_spd};
use super::{Delta, Loads, Mechanism, Serial};
use lacuna_interfaces::robot::Kind;
use lacuna_interfaces::{BadInput, Joints, RobotFile};
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Spring between motor and link, with or without play.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transmission {
    /// Stiffness [Nm/rad].
    pub stiffness: f64,
    /// Damping [Nm s/rad].
    pub damping: f64,
    /// Half of the play [rad].
    pub half_gap: f64,
}

impl Transmission {
    /// Torque on the link for the motor ahead by `ahead` [rad] and faster by `faster` [rad/s].
    pub fn torque(&self, ahead: f64, faster: f64) -> f64 {
        let pressed = ahead.abs() - self.half_gap;
        if self.half_gap > 0.0 && pressed <= 0.0 {
            return 0.0;
        }
        let torque = self.stiffness * pressed * ahead.signum() + self.damping * faster;
        // Flanks push, they do not pull.
        if self.half_gap > 0.0 && torque * ahead < 0.0 { 0.0 } else { torque }
    }

    /// Motor ahead of the link [rad] when the spring holds `torque` at rest.
    pub fn deflection(&self, torque: f64) -> f64 {
        torque / self.stiffness + self.half_gap * torque.signum()
    }
}

/// A torque that the drive must add, as a function of where the joint is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum JointTorque {
    /// Constant [Nm].
    Offset(f64),
    /// a_s sin(order θ) + a_c cos(order θ).
    Ripple {
        /// a_s [Nm].
        sine: f64,
        /// a_c [Nm].
        cosine: f64,
        /// Periods per 2π of the joint.
        order: f64,
    },
    /// The same of order 1, on the link.
    GravitySpring {
        /// a_s [Nm].
        sine: f64,
        /// a_c [Nm].
        cosine: f64,
    },
    /// k1 Δ + k3 Δ³, Δ = θ − θ_c, on the link.
    Cable {
        /// k1 [Nm/rad].
        linear: f64,
        /// k3 [Nm/rad³].
        cubic: f64,
        /// θ_c [rad].
        centre: f64,
    },
}

impl JointTorque {
    /// The torque at angle `q` [Nm].
    pub fn at(&self, q: f64) -> f64 {
        match *self {
            Self::Offset(c) => c,
            Self::Ripple { sine, cosine, order } => {
                let (sin, cos) = (order * q).sin_cos();
                sine * sin + cosine * cos
            }
            Self::GravitySpring { sine, cosine } => sine * q.sin() + cosine * q.cos(),
            Self::Cable { linear, cubic, centre } => {
                let d = q - centre;
                linear * d + cubic * d * d * d
            }
        }
    }

    /// True if it acts on the link rather than on the motor.
    pub fn on_link(&self) -> bool {
        matches!(self, Self::GravitySpring { .. } | Self::Cable { .. })
    }
}

/// Torque constant that falls above a knee: the drive reports u = τ (1 + a ((|τ| − τ_k)/τ_k)^p).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Saturation {
    /// Knee τ_k [Nm].
    pub knee: f64,
    /// Strength a.
    pub strength: f64,
    /// Order p: 1 a kink, 2 a bend.
    pub order: f64,
}

impl Saturation {
    /// Torque delivered for a reported one: the law solved for τ.
    pub fn delivered(&self, u: f64) -> f64 {
        let over = u.abs() / self.knee - 1.0;
        if over <= 0.0 {
            return u;
        }
        // (1 + x)(1 + a x^p) = 1 + over, x the delivered excess; between 0 and `over` the left side rises.
        // Bisection needs no slope, which is infinite at the knee for p < 1.
        let (mut low, mut high) = (0.0, over);
        for _ in 0..60 {
            let x = 0.5 * (low + high);
            if (1.0 + x) * (1.0 + self.strength * x.powf(self.order)) > 1.0 + over {
                high = x;
            } else {
                low = x;
            }
        }
        u.signum() * self.knee * (1.0 + 0.5 * (low + high))
    }
}

/// One joint's drive.
#[derive(Debug, Clone, PartialEq)]
pub struct JointDrive {
    /// Rotor and gear inertia at the joint side [kg m²].
    pub rotor: f64,
    /// Spring or play to the link; none: rigid.
    pub transmission: Option<Transmission>,
    /// Friction, at the motor.
    pub friction: JointFriction,
    /// Further torques.
    pub torque: Vec<JointTorque>,
    /// Real over nominal torque constant.
    pub torque_constant: f64,
    /// Saturation of the torque constant.
    pub saturation: Option<Saturation>,
    /// Homing error: reading minus truth [rad].
    pub encoder_offset: f64,
    /// Motor turns per joint turn; 1 where the robot file does not say.
    pub gear: f64,
}

impl JointDrive {
    /// Torque at the joint for a logged (executed) command.
    pub fn delivered(&self, command: f64) -> f64 {
        self.torque_constant * self.saturation.map_or(command, |s| s.delivered(command))
    }
}

/// Motor `motor` turns by q_motor + ratio · q_felt: its inertia and friction are felt on both joints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coupling {
    /// Joint of the motor.
    pub motor: usize,
    /// Joint that moves the motor along.
    pub felt: usize,
    /// Ratio.
    pub ratio: f64,
    /// Inertia [kg m²].
    pub inertia: f64,
    /// f_v [Nm s/rad].
    pub viscous: f64,
    /// f_c [Nm].
    pub coulomb: f64,
}

/// Torque of a potential in two joints: −∂/∂θ of (A/k) cos(a θ_i + b θ_j + φ).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CrossRipple {
    /// The joints.
    pub joints: [usize; 2],
    /// Waves per radian of each.
    pub waves: [f64; 2],
    /// Amplitude on the first joint [Nm].
    pub amplitude: f64,
    /// Phase [rad].
    pub phase: f64,
}

/// Base that shakes: acceleration amplitude · sin(2π f t), a horizontal inertial force on everything.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shake {
    /// Acceleration [m/s²].
    pub amplitude: f64,
    /// Frequency [Hz].
    pub frequency: f64,
    /// Direction in the base plane [rad].
    pub direction: f64,
}

/// Something that happens at the tip for a while.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TipEvent {
    /// A payload is carried.
    Payload {
        /// Picked at [s].
        on: f64,
        /// Placed at [s].
        off: f64,
        /// Mass [kg].
        mass: f64,
        /// First moment off the wrist's axis, tip frame (Delta: at t = 0) [kg m].
        moment: [f64; 3],
        /// Speed of the wrist on a Delta [rad/s]; a serial arm turns its own.
        wrist_rad_s: f64,
    },
    /// A half-sine push.
    Push {
        /// Begins at [s].
        on: f64,
        /// Lasts [s].
        duration: f64,
        /// Peak force, base frame [N].
        force: [f64; 3],
    },
}

impl TipEvent {
    fn add(&self, t: f64, turning: bool, loads: &mut Loads) {
        match *self {
            Self::Payload { on, off, mass, moment, wrist_rad_s } => {
                if !(on..off).contains(&t) {
                    return;
                }
                loads.payload_kg += mass;
                let [x, y, _] = moment;
                if turning {
                    loads.payload_moment += Vector3::from(moment);
                } else {
                    // The wrist turns at constant speed: the platform feels the centrifugal force.
                    let (sin, cos) = (wrist_rad_s * t).sin_cos();
                    loads.force +=
                        Vector3::new(cos * x - sin * y, sin * x + cos * y, 0.0) * (wrist_rad_s * wrist_rad_s);
                }
            }
            Self::Push { on, duration, force } => {
                let phase = (t - on) / duration;
                if (0.0..1.0).contains(&phase) {
                    loads.force += Vector3::from(force) * (phase * TAU / 2.0).sin();
                }
            }
        }
    }
}

/// Everything that is true of the robot.
#[derive(Debug, Clone, PartialEq)]
pub struct TrueRobot {
    /// Mechanics without rotors.
    pub mechanism: Mechanism,
    /// Drives.
    pub joints: Vec<JointDrive>,
    /// Coupled wrist axes.
    pub couplings: Vec<Coupling>,
    /// Ripples over two joints.
    pub cross_ripples: Vec<CrossRipple>,
    /// Gravity in the true base frame [m/s²].
    pub gravity: Vector3<f64>,
    /// Square-law drag of the tip [N s²/m²].
    pub air_drag: f64,
    /// Shaking of the base.
    pub shake: Vec<Shake>,
    /// Torque log late against the position log [s].
    pub torque_delay: f64,
}

impl TrueRobot {
    /// The robot exactly as its file says, without friction. `urdf` is the text of the URDF the file names.
    /// A URDF knows no rotors; [`TrueRobot::inertia`] tells whether the robot can be simulated without.
    ///
    /// # Errors
    /// [`BadInput`] if the file does not describe a robot with inertia.
    pub fn nominal(robot: &RobotFile, urdf: Option<&str>) -> Result<Self, BadInput> {
        robot.validate()?;
        let (mechanism, rotors) = match robot.kind {
            Kind::Delta => {
                let rotor = robot.mass.as_ref().map_or(0.0, |m| m.rotor_inertia);
                (Mechanism::Delta(Box::new(Delta::nominal(robot)?)), vec![rotor; 3])
            }
            Kind::Serial => {
                let (chain, rotors) = Serial::nominal(robot, urdf)?;
                (Mechanism::Serial(Box::new(chain)), rotors)
            }
        };
        let joints = rotors
            .into_iter()
            .enumerate()
            .map(|(i, rotor)| JointDrive {
                rotor,
                transmission: None,
                friction: JointFriction::default(),
                torque: Vec::new(),
                torque_constant: 1.0,
                saturation: None,
                encoder_offset: 0.0,
                gear: robot.drive.gear_ratio.as_ref().and_then(|g| g.get(i)).unwrap_or(1.0),
            })
            .collect();
        Ok(Self {
            mechanism,
            joints,
            couplings: Vec::new(),
            cross_ripples: Vec::new(),
            gravity: robot.env.gravity.into(),
            air_drag: 0.0,
            shake: Vec::new(),
            torque_delay: 0.0,
        })
    }

    /// Loads at time `t` of a trajectory with the given events.
    pub fn loads(&self, t: f64, events: &[TipEvent]) -> Loads {
        let mut loads = Loads {
            gravity: self.gravity,
            payload_kg: 0.0,
            payload_moment: Vector3::zeros(),
            force: Vector3::zeros(),
            drag: self.air_drag,
        };
        let turning = matches!(self.mechanism, Mechanism::Serial(_));
        for event in events {
            event.add(t, turning, &mut loads);
        }
        for s in &self.shake {
            let (sin, cos) = s.direction.sin_cos();
            loads.gravity += Vector3::new(cos, sin, 0.0) * (s.amplitude * (TAU * s.frequency * t).sin());
        }
        loads
    }

    /// Inertia matrix at `q`, rotors included [kg m²], and its inverse.
    ///
    /// # Errors
    /// [`BadInput`] if the pose does not exist, or a joint has next to no inertia that is its own.
    pub fn inertia(&self, q: &Joints) -> Result<(JointMatrix, JointMatrix), BadInput> {
        let n = self.joints.len();
        let mut d = super::Dynamics::default();
        self.mechanism
            .dynamics(q, &Joints::default(), &self.loads(0.0, &[]), &mut d)
            .map_err(|_| BadInput::new(format!("pose {:?} does not exist", &q[..n])))?;
        self.joints.iter().enumerate().for_each(|(i, joint)| d.inertia[i][i] += joint.rotor);
        let most = (0..n).map(|i| d.inertia[i][i]).fold(0.0, f64::max);
        let none = |i: usize, found: f64| {
            BadInput::new(format!(
                "joint {}: found an inertia of {found:.1e} kg m², others up to {most:.1e}; a simulation needs links with inertia, or rotor inertia ([[link]] tables of the robot file, or rotor_inertia of the simulation)",
                i + 1
            ))
        };
        for i in 0..n {
            if d.inertia[i][i].is_nan() || d.inertia[i][i] <= LEAST_INERTIA * most {
                return Err(none(i, d.inertia[i][i]));
            }
        }
        let inverse = invert_spd(&d.inertia, n).ok_or_else(|| {
            BadInput::new("found an inertia matrix that is not positive definite; expected a robot that can move")
        })?;
        // What a joint feels while all others give way.
        match (0..n).find(|&i| 1.0 / inverse[i][i] <= LEAST_INERTIA * most) {
            Some(i) => Err(none(i, 1.0 / inverse[i][i])),
            None => Ok((d.inertia, inverse)),
        }
    }
}

/// Smallest inertia of a joint, as a share of the largest, with which a time step of a fraction of a
/// millisecond still makes sense.
const LEAST_INERTIA: f64 = 1e-6;
