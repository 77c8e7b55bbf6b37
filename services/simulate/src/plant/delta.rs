//! Delta plant by Kane's method over its bodies.
//!
//! Nothing here comes from the estimator's equations. Three upper arms, three forearm rods and the platform
//! are bodies with mass, centre of mass and rotational inertia. For every body the partial velocities
//! ∂v/∂θ̇ₖ and ∂ω/∂θ̇ₖ follow from the loop closure, and the joint equations are the bodies' Newton–Euler
//! equations projected on them (Kane 1985; Angeles' natural orthogonal complement):
//!
//!   M = Σ_b m ∂vᵀ∂v + ∂ωᵀ I ∂ω,   h = Σ_b ∂vᵀ m (a_b − g) + ∂ωᵀ I α_b − ∂vᵀ F,   a_b, α_b at θ̈ = 0.
//!
//! The platform is found by general trilateration (three spheres about the elbows, legs of any length), not
//! by the equal-leg elimination of the paper. The two rods of a parallelogram move alike and are one rod of
//! their common mass. Paper's M_KH is the special case of a rod whose mass sits half at either end:
//! m_f = 2 m2, ξ = 1/2, I_f = m_f l2² / 4.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | θ | joint angle, > 0 lowers the elbow; z up | rad |
//! | e, e′ | direction of the upper arm, ∂e/∂θ | – |
//! | s | elbow to platform | m |
//! | u = l1 e′ | ∂J′/∂θ | m/rad |

use super::{Dynamics, Loads, Unreachable};
use lacuna_interfaces::robot::{Geometry, Mass};
use lacuna_interfaces::{BadInput, Joints, RobotFile};
use nalgebra::Vector3;

type V3 = Vector3<f64>;

/// One upper arm, without the rotor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arm {
    /// Length l1 [m].
    pub length: f64,
    /// Inertia about the joint axis [kg m²].
    pub inertia: f64,
    /// First moment along the arm [kg m].
    pub moment_along: f64,
    /// First moment square to the arm, in the direction of increasing θ [kg m].
    pub moment_across: f64,
}

/// One forearm (both rods of the parallelogram).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Forearm {
    /// Length l2 [m].
    pub length: f64,
    /// Mass m_f [kg].
    pub mass: f64,
    /// Place of the centre of mass ξ, 0 at the elbow, 1 at the platform.
    pub centre: f64,
    /// Inertia I_f about the centre of mass, square to the rod [kg m²].
    pub inertia: f64,
}

/// Friction of the passive ball joints at both ends of a forearm.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BallFriction {
    /// Coulomb moment per joint end [Nm].
    pub coulomb: f64,
    /// Viscous coefficient per joint end [Nm s/rad].
    pub viscous: f64,
}

/// The whole mechanism.
#[derive(Debug, Clone, PartialEq)]
pub struct Delta {
    /// Radial direction of each leg, horizontal unit vectors.
    pub radial: [V3; 3],
    /// Base minus platform radius, r_a − r_b, per leg [m].
    pub offset: [f64; 3],
    /// Upper arms.
    pub arm: [Arm; 3],
    /// Forearms.
    pub forearm: [Forearm; 3],
    /// Platform mass [kg].
    pub platform_kg: f64,
    /// Mass at the platform that weighs without being inert [kg]: fitted models may have it, robots not.
    pub weighing_kg: f64,
    /// Friction of the ball joints.
    pub ball: BallFriction,
}

/// Below this angular speed [rad/s] a ball joint's Coulomb moment fades linearly: passive joints in a moving
/// mechanism never dwell there, and the joint drives own the sticking.
const BALL_FADE_RAD_S: f64 = 0.02;

/// Leg kinematics at one pose.
struct Legs {
    x: V3,
    /// Elbow to platform.
    s: [V3; 3],
    /// ∂J′/∂θ.
    u: [V3; 3],
    /// Direction of the upper arm.
    e: [V3; 3],
    /// ∂e/∂θ.
    de: [V3; 3],
    /// ∂x/∂θₖ.
    jacobian: [V3; 3],
    /// Columns of the inverse of the matrix with rows sᵢᵀ.
    inverse: [V3; 3],
}

impl Delta {
    /// The robot file's nominal mechanism: the paper's M_KH, corrected.
    ///
    /// # Errors
    /// [`BadInput`] if the robot is not a Delta.
    pub fn nominal(robot: &RobotFile) -> Result<Self, BadInput> {
        let (Some(g), Some(m)) = (&robot.geometry, &robot.mass) else {
            return Err(BadInput::new("robot: found no [geometry] and [mass]; expected a robot of kind \"delta\""));
        };
        Ok(Self::from_nominal(g, m))
    }

    fn from_nominal(g: &Geometry, m: &Mass) -> Self {
        let arm = Arm {
            length: g.l1,
            inertia: m.upper_arm * g.l1 * g.l1 / 3.0,
            moment_along: m.upper_arm * g.l1 / 2.0,
            moment_across: 0.0,
        };
        let mass = 2.0 * m.forearm_point;
        let forearm = Forearm { length: g.l2, mass, centre: 0.5, inertia: mass * g.l2 * g.l2 / 4.0 };
        let radial = g.alpha_deg.map(|deg| {
            let (sin, cos) = deg.to_radians().sin_cos();
            V3::new(cos, sin, 0.0)
        });
        Self {
            radial,
            offset: [g.ra - g.rb; 3],
            arm: [arm; 3],
            forearm: [forearm; 3],
            platform_kg: m.platform,
            weighing_kg: 0.0,
            ball: BallFriction::default(),
        }
    }

    /// Directions of the upper arms and their derivatives.
    fn arms(&self, q: &Joints) -> ([V3; 3], [V3; 3]) {
        let mut e = [V3::zeros(); 3];
        let mut de = [V3::zeros(); 3];
        for i in 0..3 {
            let (sin, cos) = q[i].sin_cos();
            let r = self.radial[i];
            e[i] = V3::new(r.x * cos, r.y * cos, -sin);
            de[i] = V3::new(-r.x * sin, -r.y * sin, -cos);
        }
        (e, de)
    }

    fn elbow(&self, i: usize, e: &V3) -> V3 {
        self.radial[i] * self.offset[i] + e * self.arm[i].length
    }

    /// Platform position: the lower intersection of the spheres about the elbows.
    ///
    /// # Errors
    /// [`Unreachable`] if they do not meet.
    pub fn forward(&self, q: &Joints) -> Result<V3, Unreachable> {
        let (e, _) = self.arms(q);
        self.trilaterate(&e).map(|(x, _)| x)
    }

    /// Platform position and its height below the elbows' plane.
    fn trilaterate(&self, e: &[V3; 3]) -> Result<(V3, f64), Unreachable> {
        let [p1, p2, p3] = [0, 1, 2].map(|i| self.elbow(i, &e[i]));
        let [r1, r2, r3] = [0, 1, 2].map(|i| self.forearm[i].length);
        let d = (p2 - p1).norm();
        let ex = (p2 - p1) / d;
        let i = ex.dot(&(p3 - p1));
        let across = p3 - p1 - ex * i;
        let j = across.norm();
        let ey = across / j;
        let ez = ex.cross(&ey);
        let x = (r1 * r1 - r2 * r2 + d * d) / (2.0 * d);
        let y = (r1 * r1 - r3 * r3 + i * i + j * j) / (2.0 * j) - i / j * x;
        let z2 = r1 * r1 - x * x - y * y;
        if z2.is_nan() || z2 <= 0.0 {
            return Err(Unreachable);
        }
        let z = z2.sqrt();
        let below = if ez.z > 0.0 { -z } else { z };
        Ok((p1 + ex * x + ey * y + ez * below, z))
    }

    fn legs(&self, q: &Joints) -> Result<Legs, Unreachable> {
        let (e, de) = self.arms(q);
        let (x, _) = self.trilaterate(&e)?;
        let s = [0, 1, 2].map(|i| x - self.elbow(i, &e[i]));
        let u = [0, 1, 2].map(|i| de[i] * self.arm[i].length);
        let cross = [s[1].cross(&s[2]), s[2].cross(&s[0]), s[0].cross(&s[1])];
        let det = s[0].dot(&cross[0]);
        if det.is_nan() || det.abs() <= 1e-12 {
            return Err(Unreachable);
        }
        let inverse = cross.map(|c| c / det);
        let jacobian = [0, 1, 2].map(|i| inverse[i] * s[i].dot(&u[i]));
        Ok(Legs { x, s, u, e, de, jacobian, inverse })
    }

    /// M and h; see the module's equations.
    ///
    /// # Errors
    /// [`Unreachable`] outside the workspace or where the legs are coplanar.
    pub fn dynamics(&self, q: &Joints, qd: &Joints, loads: &Loads, out: &mut Dynamics) -> Result<(), Unreachable> {
        let k = self.legs(q)?;
        let jac = &k.jacobian;
        let xd = jac[0] * qd[0] + jac[1] * qd[1] + jac[2] * qd[2];
        // Acceleration of the platform at θ̈ = 0 from the twice differentiated loops.
        let w = [0, 1, 2].map(|i| k.e[i] * (-self.arm[i].length * qd[i] * qd[i]));
        let sd = [0, 1, 2].map(|i| xd - k.u[i] * qd[i]);
        let mut xb = V3::zeros();
        for i in 0..3 {
            xb += k.inverse[i] * (k.s[i].dot(&w[i]) - sd[i].norm_squared());
        }
        let g = loads.gravity;
        let platform = self.platform_kg + loads.payload_kg;
        let wrench = xb * platform - g * (platform + self.weighing_kg) - loads.force + xd * (loads.drag * xd.norm());
        for a in 0..3 {
            for b in 0..=a {
                out.inertia[a][b] = platform * jac[a].dot(&jac[b]);
            }
            out.inertia[a][a] += self.arm[a].inertia;
            out.bias[a] =
                jac[a].dot(&wrench) - g.dot(&(k.de[a] * self.arm[a].moment_along - k.e[a] * self.arm[a].moment_across));
        }
        for i in 0..3 {
            self.add_forearm(i, &k, [&sd[i], &w[i], &xb], qd, &g, out);
        }
        for a in 0..3 {
            for b in 0..a {
                out.inertia[b][a] = out.inertia[a][b];
            }
        }
        out.tip = k.x;
        out.tip_velocity = xd;
        Ok(())
    }

    /// Adds forearm `i`: a rod with mass, centre of mass and transverse inertia, and its ball joints.
    /// `motion` is ṡ, the elbow's acceleration and the platform's acceleration, both at θ̈ = 0.
    fn add_forearm(&self, i: usize, k: &Legs, motion: [&V3; 3], qd: &Joints, g: &V3, out: &mut Dynamics) {
        let [sd, elbow_acc, platform_acc] = motion;
        let rod = &self.forearm[i];
        let l2 = rod.length * rod.length;
        // Partial velocities of the centre of mass and of the rod's rotation.
        let mut v = k.jacobian.map(|j| j * rod.centre);
        v[i] += k.u[i] * (1.0 - rod.centre);
        let mut ds = k.jacobian;
        ds[i] -= k.u[i];
        let turn = ds.map(|d| k.s[i].cross(&d) / l2);
        let acc = elbow_acc * (1.0 - rod.centre) + platform_acc * rod.centre - g;
        let alpha = k.s[i].cross(&(platform_acc - elbow_acc)) / l2;
        for a in 0..3 {
            for b in 0..=a {
                out.inertia[a][b] += rod.mass * v[a].dot(&v[b]) + rod.inertia * turn[a].dot(&turn[b]);
            }
            out.bias[a] += rod.mass * v[a].dot(&acc) + rod.inertia * turn[a].dot(&alpha);
        }
        if self.ball != BallFriction::default() {
            let omega = k.s[i].cross(sd) / l2;
            // The arm turns about the horizontal axis square to its radial direction; e′ = axis × e.
            let axis = k.e[i].cross(&k.de[i]);
            let at_elbow = omega - axis * qd[i];
            let moments = [self.ball_moment(&at_elbow), self.ball_moment(&omega)];
            for a in 0..3 {
                let mut relative = turn[a];
                if a == i {
                    relative -= axis;
                }
                out.bias[a] += relative.dot(&moments[0]) + turn[a].dot(&moments[1]);
            }
        }
    }

    fn ball_moment(&self, omega: &V3) -> V3 {
        let speed = omega.norm();
        omega * (self.ball.viscous + self.ball.coulomb / speed.max(BALL_FADE_RAD_S))
    }

    /// Potential energy [J].
    ///
    /// # Errors
    /// [`Unreachable`] outside the workspace.
    pub fn potential(&self, q: &Joints, loads: &Loads) -> Result<f64, Unreachable> {
        let k = self.legs(q)?;
        let mut moment = k.x * (self.platform_kg + self.weighing_kg + loads.payload_kg);
        for i in 0..3 {
            let elbow = self.elbow(i, &k.e[i]);
            let rod = &self.forearm[i];
            moment += (elbow * (1.0 - rod.centre) + k.x * rod.centre) * rod.mass;
            moment += k.e[i] * self.arm[i].moment_along + k.de[i] * self.arm[i].moment_across;
        }
        Ok(-loads.gravity.dot(&moment) - loads.force.dot(&k.x))
    }

    /// Smallest of: sine of the angle at each knee, conditioning of the three forearms, height under the
    /// elbows over the forearm's length. 0 where the pose does not exist.
    pub fn margin(&self, q: &Joints) -> f64 {
        let Ok(k) = self.legs(q) else { return 0.0 };
        let l: f64 = self.forearm.iter().map(|f| f.length).product();
        let mut margin = (k.s[0].dot(&k.s[1].cross(&k.s[2])).abs() / l) * 4.0;
        for i in 0..3 {
            let knee = k.s[i].dot(&k.u[i]).abs() / (self.forearm[i].length * self.arm[i].length);
            margin = margin.min(knee);
        }
        margin
    }

    /// Joint angles of a platform position, knees outward: each leg's circle about its joint axis cut with
    /// the forearm's sphere, by the angle between the plane's direction to the platform and the arm.
    ///
    /// # Errors
    /// [`Unreachable`] if a leg does not reach.
    pub fn inverse_kinematics(&self, x: &V3) -> Result<Joints, Unreachable> {
        let mut q = Joints::default();
        for i in 0..3 {
            let to = x - self.radial[i] * self.offset[i];
            let along = to.dot(&self.radial[i]);
            // In the leg's plane the target is (along, to.z); what is left is the forearm's out-of-plane part.
            let reach2 = along * along + to.z * to.z;
            let out_of_plane2 = to.norm_squared() - reach2;
            let l1 = self.arm[i].length;
            let in_plane2 = self.forearm[i].length.powi(2) - out_of_plane2;
            let cosine = (l1 * l1 + reach2 - in_plane2) / (2.0 * l1 * reach2.sqrt());
            if cosine.is_nan() || cosine.abs() > 1.0 {
                return Err(Unreachable);
            }
            // Angle of the target below the radial direction, less the triangle's angle: the outer knee.
            q[i] = (-to.z).atan2(along) - cosine.acos();
            if q[i] <= -std::f64::consts::PI {
                q[i] += std::f64::consts::TAU;
            }
        }
        Ok(q)
    }

    /// Joint motion of a platform motion (x, ẋ, ẍ).
    ///
    /// # Errors
    /// [`Unreachable`] if a leg does not reach, or its arm and forearm are in line.
    pub fn inverse_motion(&self, x: &V3, xd: &V3, xdd: &V3) -> Result<[Joints; 3], Unreachable> {
        let q = self.inverse_kinematics(x)?;
        let (e, de) = self.arms(&q);
        let (mut qd, mut qdd) = (Joints::default(), Joints::default());
        for i in 0..3 {
            let s = x - self.elbow(i, &e[i]);
            let u = de[i] * self.arm[i].length;
            let knee = s.dot(&u);
            if knee.is_nan() || knee.abs() <= 1e-9 {
                return Err(Unreachable);
            }
            qd[i] = s.dot(xd) / knee;
            let w = e[i] * (-self.arm[i].length * qd[i] * qd[i]);
            qdd[i] = ((xd - u * qd[i]).norm_squared() + s.dot(&(xdd - w))) / knee;
        }
        Ok([q, qd, qdd])
    }
}
