//! Recursive Newton-Euler, regressor and tip mass, all from one outward sweep.
//!
//! | symbol | meaning (link frame) | unit |
//! |---|---|---|
//! | ω, α | angular velocity and acceleration of the link | rad/s, rad/s² |
//! | a | acceleration of the link's origin minus gravity | m/s² |
//! | f = m a + α × mc + ω × (ω × mc) | force on the link | N |
//! | n = I α + ω × I ω + mc × a | moment on the link about its origin | Nm |

use super::{IA, PER_LINK, SerialChain};
use crate::{Mat3, Motion, Vec3};
use lacuna_interfaces::MAX_JOINTS;
use lacuna_interfaces::robot::JointType;

/// Motion of one link in its own frame, and its placement in the previous link's frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Link {
    rotation: Mat3,
    /// Point on the joint's axis in the previous link's frame [m].
    point: Vec3,
    omega: Vec3,
    alpha: Vec3,
    a: Vec3,
}

impl Link {
    const AT_REST: Self = Self {
        rotation: Mat3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        point: Vec3::new(0.0, 0.0, 0.0),
        omega: Vec3::new(0.0, 0.0, 0.0),
        alpha: Vec3::new(0.0, 0.0, 0.0),
        a: Vec3::new(0.0, 0.0, 0.0),
    };

    /// Acceleration of a point fixed to the link, relative to its origin.
    #[inline]
    fn around(&self, p: &Vec3) -> Vec3 {
        self.alpha.cross(p) + self.omega.cross(&self.omega.cross(p))
    }
}

/// One link after the other; those beyond the chain's joints are unused.
pub(super) type Links = [Link; MAX_JOINTS];

impl SerialChain {
    /// Outward sweep. The base accelerates by −g, which makes gravity act on every link.
    #[inline]
    pub(super) fn sweep(&self, motion: &Motion<'_>) -> Links {
        let mut links = [Link::AT_REST; MAX_JOINTS];
        let mut base = Link { a: -self.gravity, ..Link::AT_REST };
        let rates = motion.q_rad.iter().zip(motion.qd_rad_s).zip(motion.qdd_rad_s2);
        for ((joint, ((&q, &qd), &qdd)), link) in self.joints.iter().zip(rates).zip(&mut links) {
            let (rotation, point) = joint.place(q);
            let mut omega = rotation.tr_mul(&base.omega);
            let mut alpha = rotation.tr_mul(&base.alpha);
            let mut a = rotation.tr_mul(&(base.a + base.around(&point)));
            match joint.kind {
                JointType::Revolute => {
                    alpha += omega.cross(&joint.axis) * qd + joint.axis * qdd;
                    omega += joint.axis * qd;
                }
                JointType::Prismatic => a += omega.cross(&joint.axis) * (2.0 * qd) + joint.axis * qdd,
            }
            *link = Link { rotation, point, omega, alpha, a };
            link.a += link.around(&joint.arm);
            base = *link;
        }
        links
    }

    /// Inward sweep: torques from each link's force and moment about its origin.
    #[inline]
    fn inward(&self, links: &Links, tau: &mut [f64], mut wrench: impl FnMut(usize, &Link) -> (Vec3, Vec3)) {
        let (mut force, mut moment) = (Vec3::zeros(), Vec3::zeros());
        for i in (0..self.joints.len()).rev() {
            let (joint, link) = (&self.joints[i], &links[i]);
            let (f, n) = wrench(i, link);
            force += f;
            moment += n + joint.arm.cross(&force);
            tau[i] = match joint.kind {
                JointType::Revolute => joint.axis.dot(&moment),
                JointType::Prismatic => joint.axis.dot(&force),
            };
            force = link.rotation * force;
            moment = link.rotation * moment + link.point.cross(&force);
        }
    }

    /// τ = Y π by recursion.
    #[inline]
    pub(super) fn newton_euler(&self, links: &Links, qdd: &[f64], pi: &[f64], tau: &mut [f64]) {
        self.inward(links, tau, |i, link| wrench(&pi[i * PER_LINK..], link));
        for (i, tau) in tau.iter_mut().enumerate() {
            *tau += pi[i * PER_LINK + IA] * qdd[i];
        }
    }

    /// Torques of a unit point mass at the tip.
    #[inline]
    pub(super) fn tip_mass(&self, links: &Links, column: &mut [f64]) {
        let last = self.joints.len() - 1;
        self.inward(links, column, |i, link| {
            if i < last {
                return (Vec3::zeros(), Vec3::zeros());
            }
            let f = link.a + link.around(&self.tip.position);
            (f, self.tip.position.cross(&f))
        });
    }

    /// Y row by row, n × 11 n. Link i contributes to joint j ≤ i through the joint's twist (v, w) at the
    /// link's origin: τ_j = v·f + w·n, column by column without forming f and n.
    pub(super) fn fill_regressor(&self, links: &Links, qdd: &[f64], y: &mut [f64]) {
        let n = self.joints.len();
        let width = PER_LINK * n;
        y.fill(0.0);
        for j in 0..n {
            let joint = &self.joints[j];
            let (mut v, mut w) = match joint.kind {
                JointType::Revolute => (joint.axis.cross(&joint.arm), joint.axis),
                JointType::Prismatic => (joint.axis, Vec3::zeros()),
            };
            let row = &mut y[j * width..(j + 1) * width];
            row[j * PER_LINK + IA] = qdd[j];
            for i in j..n {
                let link = &links[i];
                if i > j {
                    let v_axis = link.rotation.tr_mul(&(v + w.cross(&link.point)));
                    w = link.rotation.tr_mul(&w);
                    v = v_axis + w.cross(&self.joints[i].arm);
                }
                link_columns(link, &v, &w, &mut row[i * PER_LINK..i * PER_LINK + IA]);
            }
        }
    }
}

/// Force and moment about the origin that the motion of a link with parameters `pi` takes.
#[inline]
fn wrench(pi: &[f64], link: &Link) -> (Vec3, Vec3) {
    let &[m, mx, my, mz, xx, xy, xz, yy, yz, zz, ..] = pi else { return (Vec3::zeros(), Vec3::zeros()) };
    let mc = Vec3::new(mx, my, mz);
    let times_inertia = |v: &Vec3| {
        Vec3::new(xx * v.x + xy * v.y + xz * v.z, xy * v.x + yy * v.y + yz * v.z, xz * v.x + yz * v.y + zz * v.z)
    };
    let f = m * link.a + link.around(&mc);
    let n = times_inertia(&link.alpha) + link.omega.cross(&times_inertia(&link.omega)) + mc.cross(&link.a);
    (f, n)
}

/// Ten columns of v·f + w·n. With h = w × ω: v·f is v·a for m and Bᵀv for mc, B = [α]× + [ω]×²;
/// w·n is a × w for mc and w·Iα + h·Iω for the inertia.
#[inline]
fn link_columns(link: &Link, v: &Vec3, w: &Vec3, out: &mut [f64]) {
    let (o, al) = (&link.omega, &link.alpha);
    let h = w.cross(o);
    // Bᵀ v = v × α + ω × (ω × v), because [ω]×² is symmetric.
    let moment = v.cross(al) + o.cross(&o.cross(v)) + link.a.cross(w);
    let columns = [
        v.dot(&link.a),
        moment.x,
        moment.y,
        moment.z,
        w.x * al.x + h.x * o.x,
        w.x * al.y + w.y * al.x + h.x * o.y + h.y * o.x,
        w.x * al.z + w.z * al.x + h.x * o.z + h.z * o.x,
        w.y * al.y + h.y * o.y,
        w.y * al.z + w.z * al.y + h.y * o.z + h.z * o.y,
        w.z * al.z + h.z * o.z,
    ];
    out.copy_from_slice(&columns);
}
