//! Serial plant by composite rigid bodies in screw algebra, everything in the base frame.
//!
//! The estimator runs Newton–Euler in link frames with 3-vectors. Here every joint is a screw
//! S = (axis; −axis × point), every body a spatial inertia about the base origin, and
//!
//!   v_i = v_{i−1} + S_i q̇_i,   a_i = a_{i−1} + v_i × S_i q̇_i (a_0 = −g),   f_i = I_i a_i + v_i ×* I_i v_i,
//!   M_ij = S_iᵀ (Σ_{k ≥ j} I_k) S_j for i ≤ j,   h_i = S_iᵀ Σ_{k ≥ i} f_k
//!
//! (Featherstone 2008, chapters 5 and 6, with one common frame, so that no coordinate transforms are left).

use super::urdf;
use super::{Dynamics, Loads};
use lacuna_interfaces::robot::{DhRow, JointType, LinkInertia};
use lacuna_interfaces::{BadInput, Joints, MAX_JOINTS, RobotFile};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

type V3 = Vector3<f64>;

/// A body by its linear inertial parameters, in the body's frame. Parameters that were fitted to torques need
/// not belong to any real body; the chain's equations hold for them all the same.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Body {
    /// Mass [kg].
    pub mass: f64,
    /// First moment, mass times centre of mass [kg m].
    pub moment: V3,
    /// Inertia about the frame's origin [kg m²].
    pub inertia: Matrix3<f64>,
}

impl Default for Body {
    fn default() -> Self {
        Self { mass: 0.0, moment: V3::zeros(), inertia: Matrix3::zeros() }
    }
}

/// a·b 1 − (a bᵀ + b aᵀ)/2: the inertia that unit mass products at a and b make.
fn spread(a: &V3, b: &V3) -> Matrix3<f64> {
    Matrix3::identity() * a.dot(b) - (a * b.transpose() + b * a.transpose()) * 0.5
}

impl Body {
    /// From mass, centre of mass [m] and the inertia about it [kg m²].
    pub fn new(mass: f64, com: V3, about_com: Matrix3<f64>) -> Self {
        Self { mass, moment: com * mass, inertia: about_com + spread(&com, &com) * mass }
    }

    /// The body as seen from a frame in which its own frame is placed at `at`.
    #[must_use]
    pub fn placed(&self, at: &Isometry3<f64>) -> Self {
        let r = at.rotation.to_rotation_matrix();
        let p = at.translation.vector;
        let turned = r * self.moment;
        Self {
            mass: self.mass,
            moment: turned + p * self.mass,
            inertia: r.matrix() * self.inertia * r.matrix().transpose()
                + spread(&p, &turned) * 2.0
                + spread(&p, &p) * self.mass,
        }
    }

    /// Both bodies fixed to each other.
    #[must_use]
    pub fn merged(&self, other: &Self) -> Self {
        Self { mass: self.mass + other.mass, moment: self.moment + other.moment, inertia: self.inertia + other.inertia }
    }

    /// Momentum (angular about the origin, linear) of the body under a twist.
    fn times(&self, v: &Screw) -> Screw {
        Screw {
            angular: self.inertia * v.angular + self.moment.cross(&v.linear),
            linear: v.linear * self.mass - self.moment.cross(&v.angular),
        }
    }
}

/// One joint and the body it moves.
#[derive(Debug, Clone, PartialEq)]
pub struct Link {
    /// Joint frame in the parent body's frame at q = 0.
    pub place: Isometry3<f64>,
    /// Joint axis in the joint frame, unit.
    pub axis: V3,
    /// Slides instead of turning.
    pub prismatic: bool,
    /// Body, in the frame that moves with the joint.
    pub body: Body,
}

/// The chain.
#[derive(Debug, Clone, PartialEq)]
pub struct Serial {
    /// Joints and bodies from the base outwards, 1 to 8.
    pub links: Vec<Link>,
    /// Tip frame in the last body's frame.
    pub tip: Isometry3<f64>,
    /// Per joint: the frame that the robot's description places the body in, in the body's frame. DH rows
    /// describe a link in the frame at its end, a URDF in the joint's own.
    pub described_in: Vec<Isometry3<f64>>,
}

/// Twist or wrench as (angular, linear) about the base origin.
#[derive(Debug, Clone, Copy)]
struct Screw {
    angular: V3,
    linear: V3,
}

impl Screw {
    fn zero() -> Self {
        Self { angular: V3::zeros(), linear: V3::zeros() }
    }

    fn plus(&self, other: &Self, scale: f64) -> Self {
        Self { angular: self.angular + other.angular * scale, linear: self.linear + other.linear * scale }
    }

    fn dot(&self, other: &Self) -> f64 {
        self.angular.dot(&other.angular) + self.linear.dot(&other.linear)
    }

    /// Twist × twist.
    fn cross_twist(&self, m: &Self) -> Self {
        Self {
            angular: self.angular.cross(&m.angular),
            linear: self.angular.cross(&m.linear) + self.linear.cross(&m.angular),
        }
    }

    /// Twist ×* wrench (angular: moment, linear: force).
    fn cross_wrench(&self, f: &Self) -> Self {
        Self {
            angular: self.angular.cross(&f.angular) + self.linear.cross(&f.linear),
            linear: self.angular.cross(&f.linear),
        }
    }
}

/// The chain's geometry at one pose.
struct Pose {
    screws: [Screw; MAX_JOINTS],
    /// Bodies about the base origin.
    bodies: [Body; MAX_JOINTS],
    tip: Isometry3<f64>,
}

impl Serial {
    /// Number of joints.
    pub fn joints(&self) -> usize {
        self.links.len()
    }

    /// The robot file's nominal chain and its rotor inertias.
    ///
    /// # Errors
    /// [`BadInput`] if the robot is not serial, its URDF is missing or cannot be used.
    pub fn nominal(robot: &RobotFile, urdf: Option<&str>) -> Result<(Self, Vec<f64>), BadInput> {
        if robot.urdf.is_some() {
            let text = urdf.ok_or_else(|| {
                BadInput::new("robot: the file names a URDF; expected its text together with the robot file")
            })?;
            return urdf::chain(text, &robot.joints);
        }
        if robot.dh.is_empty() {
            return Err(BadInput::new("robot: found no [[dh]]; expected a robot of kind \"serial\""));
        }
        let mut links = Vec::new();
        let mut rotors = Vec::new();
        let mut described_in = Vec::new();
        let mut before = Isometry3::identity();
        for (i, row) in robot.dh.iter().enumerate() {
            let link = robot.link.get(i).cloned().unwrap_or_default();
            let (turn, fixed) = dh_frames(row);
            links.push(Link {
                place: before * turn,
                axis: V3::z(),
                prismatic: row.joint == JointType::Prismatic,
                body: dh_body(&link).placed(&fixed),
            });
            rotors.push(link.rotor_inertia);
            described_in.push(fixed);
            before = fixed;
        }
        Ok((Self { links, tip: before, described_in }, rotors))
    }

    fn pose(&self, q: &Joints, loads: &Loads) -> Pose {
        let mut pose =
            Pose { screws: [Screw::zero(); MAX_JOINTS], bodies: [Body::default(); MAX_JOINTS], tip: self.tip };
        let mut frame = Isometry3::identity();
        for (i, link) in self.links.iter().enumerate().take(MAX_JOINTS) {
            let joint = frame * link.place;
            let axis = joint.rotation * link.axis;
            if link.prismatic {
                pose.screws[i] = Screw { angular: V3::zeros(), linear: axis };
                frame = joint * Translation3::from(link.axis * q[i]);
            } else {
                pose.screws[i] = Screw { angular: axis, linear: joint.translation.vector.cross(&axis) };
                frame = joint * UnitQuaternion::from_scaled_axis(link.axis * q[i]);
            }
            pose.bodies[i] = link.body.placed(&frame);
        }
        pose.tip = frame * self.tip;
        if loads.payload_kg != 0.0 || loads.payload_moment != V3::zeros() {
            let mut payload = Body { mass: loads.payload_kg, moment: loads.payload_moment, ..Body::default() };
            if payload.mass > 0.0 {
                payload.inertia = spread(&payload.moment, &payload.moment) / payload.mass;
            }
            if let Some(last) = pose.bodies.get_mut(self.links.len().saturating_sub(1)) {
                *last = last.merged(&payload.placed(&pose.tip));
            }
        }
        pose
    }

    /// M and h; see the module's equations.
    pub fn dynamics(&self, q: &Joints, qd: &Joints, loads: &Loads, out: &mut Dynamics) {
        let n = self.links.len().min(MAX_JOINTS);
        let pose = self.pose(q, loads);
        let mut v = Screw::zero();
        let mut a = Screw { angular: V3::zeros(), linear: -loads.gravity };
        let mut wrench = [Screw::zero(); MAX_JOINTS];
        for i in 0..n {
            let s = &pose.screws[i];
            v = v.plus(s, qd[i]);
            a = a.plus(&v.cross_twist(s), qd[i]);
            let momentum = pose.bodies[i].times(&v);
            wrench[i] = pose.bodies[i].times(&a).plus(&v.cross_wrench(&momentum), 1.0);
        }
        let tip = pose.tip.translation.vector;
        let tip_velocity = v.linear + v.angular.cross(&tip);
        let force = loads.force - tip_velocity * (loads.drag * tip_velocity.norm());
        if let Some(last) = wrench.get_mut(n.saturating_sub(1)) {
            *last = last.plus(&Screw { angular: tip.cross(&force), linear: force }, -1.0);
        }
        let mut composite = Body::default();
        let mut total = Screw::zero();
        for j in (0..n).rev() {
            composite = composite.merged(&pose.bodies[j]);
            total = total.plus(&wrench[j], 1.0);
            out.bias[j] = pose.screws[j].dot(&total);
            let momentum = composite.times(&pose.screws[j]);
            for i in 0..=j {
                let m = pose.screws[i].dot(&momentum);
                out.inertia[i][j] = m;
                out.inertia[j][i] = m;
            }
        }
        out.tip = tip;
        out.tip_velocity = tip_velocity;
    }

    /// Potential energy [J].
    pub fn potential(&self, q: &Joints, loads: &Loads) -> f64 {
        let pose = self.pose(q, loads);
        let moment: V3 = pose.bodies.iter().map(|b| b.moment).sum();
        -loads.gravity.dot(&moment) - loads.force.dot(&pose.tip.translation.vector)
    }
}

/// Classic DH row: the part before the joint's motion, and Tz(d) Tx(a) Rx(alpha) after it.
fn dh_frames(row: &DhRow) -> (Isometry3<f64>, Isometry3<f64>) {
    let turn =
        Isometry3::from_parts(Translation3::identity(), UnitQuaternion::from_axis_angle(&V3::z_axis(), row.offset));
    let fixed = Isometry3::from_parts(
        Translation3::new(row.a, 0.0, row.d),
        UnitQuaternion::from_axis_angle(&V3::x_axis(), row.alpha),
    );
    (turn, fixed)
}

fn dh_body(link: &LinkInertia) -> Body {
    let [xx, xy, xz, yy, yz, zz] = link.inertia;
    Body::new(link.mass, link.com.into(), Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz))
}

/// Placement from a URDF `origin`: xyz and fixed-axis roll, pitch, yaw.
pub(super) fn placement(xyz: [f64; 3], rpy: [f64; 3]) -> Isometry3<f64> {
    let rotation = Rotation3::from_euler_angles(rpy[0], rpy[1], rpy[2]);
    Isometry3::from_parts(Translation3::from(V3::from(xyz)), UnitQuaternion::from_rotation_matrix(&rotation))
}
