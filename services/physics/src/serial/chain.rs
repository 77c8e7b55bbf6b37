//! Geometry of a chain: placements, bodies, and the joint as the recursions use it.

use super::{IA, PER_LINK};
use crate::{Mat3, Parameter, Vec3};
use lacuna_interfaces::RobotFile;
use lacuna_interfaces::robot::{JointType, LinkInertia};

/// A frame in another frame: outer coordinates = R · inner coordinates + p.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    /// Rotation R.
    pub rotation: Mat3,
    /// Origin p [m].
    pub position: Vec3,
}

impl Placement {
    /// The frame itself.
    pub const IDENTITY: Self =
        Self { rotation: Mat3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), position: Vec3::new(0.0, 0.0, 0.0) };

    /// A frame given in this one, seen from this one's outer frame.
    #[must_use]
    pub fn then(&self, inner: &Self) -> Self {
        Self { rotation: self.rotation * inner.rotation, position: self.position + self.rotation * inner.position }
    }
}

/// Rotation about a coordinate axis: 0 = x, 1 = y, 2 = z.
pub(super) fn about(axis: usize, angle: f64) -> Mat3 {
    let (s, c) = angle.sin_cos();
    match axis {
        0 => Mat3::new(1.0, 0.0, 0.0, 0.0, c, -s, 0.0, s, c),
        1 => Mat3::new(c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c),
        _ => Mat3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0),
    }
}

/// Mass, first moment and inertia of a rigid body about a frame's origin, in that frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Body {
    /// Mass [kg].
    pub mass: f64,
    /// First moment m c [kg m].
    pub moment: Vec3,
    /// Inertia about the origin [kg m²].
    pub inertia: Mat3,
}

impl Body {
    /// No body.
    pub const NONE: Self = Self {
        mass: 0.0,
        moment: Vec3::new(0.0, 0.0, 0.0),
        inertia: Mat3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    };

    /// From mass, centre of mass [m] and the inertia about it [kg m²].
    pub fn new(mass: f64, com: Vec3, inertia_com: Mat3) -> Self {
        let s = com.cross_matrix();
        Self { mass, moment: mass * com, inertia: inertia_com - mass * s * s }
    }

    /// The same body seen from the outer frame of `place`.
    #[must_use]
    pub fn seen_through(&self, place: &Placement) -> Self {
        let r = &place.rotation;
        let t = place.position.cross_matrix();
        let turned = r * self.moment;
        let s = turned.cross_matrix();
        Self {
            mass: self.mass,
            moment: turned + self.mass * place.position,
            inertia: r * self.inertia * r.transpose() - t * s - s * t - self.mass * t * t,
        }
    }

    /// Both bodies joined rigidly; same frame.
    #[must_use]
    pub fn with(&self, other: &Self) -> Self {
        Self { mass: self.mass + other.mass, moment: self.moment + other.moment, inertia: self.inertia + other.inertia }
    }
}

/// One joint and the link behind it, as described: `before` and `after` are fixed, between them the joint
/// turns about or slides along `axis`.
#[derive(Debug, Clone)]
pub struct Segment {
    /// Revolute or prismatic.
    pub kind: JointType,
    /// Joint frame in the previous link's frame.
    pub before: Placement,
    /// Unit axis in the joint frame.
    pub axis: Vec3,
    /// Link frame in the moved joint frame.
    pub after: Placement,
    /// The link's body in its own frame.
    pub body: Body,
    /// Rotor inertia at the joint side [kg m²; prismatic: kg].
    pub rotor: f64,
}

/// One joint as the recursions use it.
///
/// The link's rotation in the previous link's frame is R(q) = R₀ + R_s sin q + R_c cos q (Rodrigues with the
/// fixed rotations multiplied in), so an axis in any direction costs no more than one along z.
#[derive(Debug, Clone)]
pub(super) struct Joint {
    pub(super) kind: JointType,
    rotation: [Mat3; 3],
    /// A point on the axis at q = 0, previous link's frame [m].
    point: Vec3,
    /// Direction of sliding in the previous link's frame; zero for a revolute joint.
    slide: Vec3,
    /// From the point on the axis to the link's origin, link frame [m].
    pub(super) arm: Vec3,
    /// Unit axis, link frame.
    pub(super) axis: Vec3,
}

impl Joint {
    pub(super) fn new(segment: &Segment) -> Self {
        let Segment { kind, before, axis, after, .. } = segment;
        let fixed = |m: Mat3| before.rotation * m * after.rotation;
        let along = axis * axis.transpose();
        let to_link = after.rotation.transpose();
        let (rotation, slide) = match kind {
            JointType::Revolute => {
                ([fixed(along), fixed(axis.cross_matrix()), fixed(Mat3::identity() - along)], Vec3::zeros())
            }
            JointType::Prismatic => ([fixed(Mat3::identity()), Mat3::zeros(), Mat3::zeros()], before.rotation * axis),
        };
        Self {
            kind: *kind,
            rotation,
            point: before.position,
            slide,
            arm: to_link * after.position,
            axis: to_link * axis,
        }
    }

    /// Rotation of the link in the previous link's frame, and the point on the axis there [m].
    #[inline]
    pub(super) fn place(&self, q: f64) -> (Mat3, Vec3) {
        match self.kind {
            JointType::Revolute => {
                let (sin, cos) = q.sin_cos();
                (self.rotation[0] + self.rotation[1] * sin + self.rotation[2] * cos, self.point)
            }
            JointType::Prismatic => (self.rotation[0], self.point + self.slide * q),
        }
    }
}

/// Segments of a chain of classic DH rows: Rz(q + offset) Tz(d) Tx(a) Rx(alpha), sliding along z if prismatic.
pub(super) fn from_dh(robot: &RobotFile) -> Vec<Segment> {
    let unknown = LinkInertia::default();
    robot
        .dh
        .iter()
        .enumerate()
        .map(|(i, row)| {
            let link = robot.link.get(i).unwrap_or(&unknown);
            let [xx, xy, xz, yy, yz, zz] = link.inertia;
            Segment {
                kind: row.joint,
                before: Placement { rotation: about(2, row.offset), position: Vec3::zeros() },
                axis: Vec3::z(),
                after: Placement { rotation: about(0, row.alpha), position: Vec3::new(row.a, 0.0, row.d) },
                body: Body::new(link.mass, Vec3::from(link.com), Mat3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)),
                rotor: link.rotor_inertia,
            }
        })
        .collect()
}

/// Appends the eleven parameters of link `i`.
pub(super) fn push_parameters(i: usize, segment: &Segment, out: &mut Vec<Parameter>) {
    let Body { mass, moment, inertia } = &segment.body;
    let ia_unit = match segment.kind {
        JointType::Revolute => "kg m^2",
        JointType::Prismatic => "kg",
    };
    let rows: [(&str, &str, f64, &str); PER_LINK] = [
        ("m", "kg", *mass, "mass"),
        ("mx", "kg m", moment.x, "first moment along x"),
        ("my", "kg m", moment.y, "first moment along y"),
        ("mz", "kg m", moment.z, "first moment along z"),
        ("Ixx", "kg m^2", inertia.m11, "inertia xx about the frame's origin"),
        ("Ixy", "kg m^2", inertia.m12, "inertia xy about the frame's origin"),
        ("Ixz", "kg m^2", inertia.m13, "inertia xz about the frame's origin"),
        ("Iyy", "kg m^2", inertia.m22, "inertia yy about the frame's origin"),
        ("Iyz", "kg m^2", inertia.m23, "inertia yz about the frame's origin"),
        ("Izz", "kg m^2", inertia.m33, "inertia zz about the frame's origin"),
        ("Ia", ia_unit, segment.rotor, "rotor and gear inertia at the joint side"),
    ];
    debug_assert_eq!(rows[IA].0, "Ia");
    for (symbol, unit, nominal, meaning) in rows {
        out.push(Parameter {
            symbol: format!("{symbol}{}", i + 1),
            unit,
            nominal,
            joint: Some(i),
            meaning: format!("link {}: {meaning}", i + 1),
        });
    }
}
