//! What a robot file leaves open: masses, lengths and the drive's time stamps within its `[tolerance]`.
//!
//! A tolerance is a direction: changes of the dynamic parameters, of a Delta's lengths and of the torque's delay at
//! the upper end of the tolerance. Its column is Δτ = Y Δπ + ∂τ/∂l1 Δl1 + ∂τ/∂l2 Δl2 − D dτ/dt; a model file says the
//! same with `[rigid_body]` parameters, `link_length` and `torque_delay`.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | Δπ | change of the dynamic parameters | |
//! | Δl1, Δl2 | longer upper arms and forearms, all legs alike | m |
//! | D | delay of the torque | s |
//!
//! The radius difference r is no term of its own. A Delta that is larger by 1 + ε in all its lengths moves the
//! platform by as much more: τ = Y π with m_in and m_JE (1 + ε)² and m_gr (1 + ε). So r (1 + ε) is that robot with its arms
//! and forearms shortened again.

use crate::scene::{Raw, Scene};
use lacuna_estimation::filter::{Stencil, differentiate};
use lacuna_interfaces::robot::Kind;
use lacuna_physics::delta::parameters::{GC, INERTIA, M_GR, M_IN, M_JE};
use lacuna_physics::effects::{self, EffectContext, Track};
use nalgebra::{Matrix3, Vector3};
use std::collections::BTreeMap;

/// Name of the tolerance of half a sample of delay.
pub const DELAY: &str = "torque delay";

/// A direction in which the robot may differ from its file, or the sum of several.
#[derive(Debug, Clone, PartialEq)]
pub struct Tolerance {
    /// What it is.
    pub name: String,
    /// Change of the dynamic parameters.
    pub pi: Vec<f64>,
    /// Change of all upper arms [m].
    pub dl: f64,
    /// Change of all forearms [m].
    pub dl_2: f64,
    /// Delay of the torque [s].
    pub delay_s: f64,
}

impl Tolerance {
    /// No change.
    pub fn none(scene: &Scene) -> Self {
        Self { name: String::new(), pi: vec![0.0; scene.pi.len()], dl: 0.0, dl_2: 0.0, delay_s: 0.0 }
    }

    fn named(scene: &Scene, name: &str) -> Self {
        Self { name: name.to_owned(), ..Self::none(scene) }
    }

    /// With parameters `slot` changed by `by`.
    fn with(mut self, changes: &[(usize, f64)]) -> Self {
        for (slot, by) in changes {
            if let Some(v) = self.pi.get_mut(*slot) {
                *v += by;
            }
        }
        self
    }

    /// Adds `value` times `other`.
    pub fn add(&mut self, other: &Self, value: f64) {
        self.pi.iter_mut().zip(&other.pi).for_each(|(a, b)| *a += value * b);
        self.dl += value * other.dl;
        self.dl_2 += value * other.dl_2;
        self.delay_s += value * other.delay_s;
    }

    fn is_nothing(&self) -> bool {
        self.pi.iter().all(|v| *v == 0.0) && self.dl == 0.0 && self.dl_2 == 0.0 && self.delay_s == 0.0
    }

    /// Its torque along the recordings, full rate; `None` if a robot of these lengths cannot be.
    pub fn raw(&self, scene: &Scene, nominal: &Raw) -> Option<Raw> {
        let mut out = scene.rigid_raw(scene.body.as_ref(), &self.pi);
        if self.dl != 0.0 || self.dl_2 != 0.0 {
            self.add_lengths(scene, &mut out)?;
        }
        if self.delay_s != 0.0 {
            let dt = 1.0 / scene.rate_hz;
            for (out, of) in out.iter_mut().flatten().zip(nominal.iter().flatten()) {
                if let Ok(rate) = differentiate(of, dt, Stencil::Seven, 1) {
                    out.iter_mut().zip(rate).for_each(|(v, r)| *v -= self.delay_s * r);
                }
            }
        }
        Some(out)
    }

    fn add_lengths(&self, scene: &Scene, out: &mut Raw) -> Option<()> {
        let effect = effects::find("link_length")?;
        let context = EffectContext {
            robot: &scene.robot,
            urdf: scene.urdf.as_deref(),
            body: scene.body.as_ref(),
            pi: &scene.pi,
        };
        let joints: Vec<usize> = (0..scene.joints).collect();
        for (piece, out) in scene.pieces.iter().zip(out) {
            let t_s: Vec<f64> = (0..piece.len()).map(|k| k as f64 / scene.rate_hz).collect();
            let track = Track {
                t_s: &t_s,
                start_s: piece.global_s,
                q_rad: &piece.q,
                qd_rad_s: &piece.qd,
                qdd_rad_s2: &piece.qdd,
                // Lengths know no friction and no loads.
                direction: &piece.qd,
                ramp_rad_s: 0.01,
                tau_link_nm: &piece.qd,
                tau_drive_nm: &piece.qd,
                temperature_degc: &[],
                resets: &[],
            };
            let columns = effect.columns(&joints, &BTreeMap::new(), &context, &track).ok()?;
            for (c, factor) in [self.dl, self.dl_2].into_iter().enumerate().take(columns.count()) {
                for (j, out) in out.iter_mut().enumerate() {
                    out.iter_mut().zip(columns.column(c, j)).for_each(|(v, x)| *v += factor * x);
                }
            }
        }
        Some(())
    }
}

/// All tolerances of the scene's robot, each at its upper end.
pub fn all(scene: &Scene) -> Vec<Tolerance> {
    let mut out = match scene.robot.kind {
        Kind::Delta => delta(scene),
        Kind::Serial => serial(scene),
    };
    // A drive that stamps its torque half a sample early or late.
    out.push(Tolerance { delay_s: 0.5 / scene.rate_hz, ..Tolerance::named(scene, DELAY) });
    out.retain(|t| !t.is_nothing());
    out
}

/// Each mass of each leg, and the three lengths.
fn delta(scene: &Scene) -> Vec<Tolerance> {
    let tol = &scene.robot.tolerance;
    let mut out = Vec::new();
    let (Some(mass), Some(geometry)) = (&scene.robot.mass, &scene.robot.geometry) else { return out };
    let named = |name: &str| Tolerance::named(scene, name);
    let (l1, l2) = (geometry.l1, geometry.l2);
    let (arm, fore) = (tol.mass * mass.upper_arm, tol.mass * mass.forearm_point);
    let platform = tol.mass * mass.platform;
    out.push(named("platform mass").with(&[(M_IN, platform), (M_GR, platform)]));
    for i in 0..3 {
        let leg = i + 1;
        out.push(
            named(&format!("upper arm {leg} mass"))
                .with(&[(INERTIA + i, arm / 3.0 * l1 * l1), (GC + i, arm / 2.0 * l1)]),
        );
        out.push(named(&format!("forearm {leg} mass")).with(&[
            (INERTIA + i, fore * l1 * l1),
            (GC + i, fore * l1),
            (M_IN, fore),
            (M_GR, fore),
        ]));
        out.push(named(&format!("rotor {leg} inertia")).with(&[(INERTIA + i, tol.mass * mass.rotor_inertia)]));
    }
    out.push(Tolerance { dl: tol.length * l1, ..named("upper arm length") });
    out.push(Tolerance { dl_2: tol.length * l2, ..named("forearm length") });
    let e = tol.length;
    let at = |slot: usize| scene.pi.get(slot).copied().unwrap_or(0.0);
    // What a shorter arm takes off its inertia and moment stays on: the radius alone changes.
    let inertia = 2.0 * e * (mass.upper_arm / 3.0 + mass.forearm_point) * l1 * l1;
    let moment = e * (mass.upper_arm / 2.0 + mass.forearm_point) * l1;
    let mut radius = named("radius difference").with(&[
        (M_IN, 2.0 * e * at(M_IN)),
        (M_GR, e * at(M_GR)),
        (M_JE, 2.0 * e * at(M_JE)),
    ]);
    for i in 0..3 {
        radius = radius.with(&[(INERTIA + i, inertia), (GC + i, moment)]);
    }
    out.push(Tolerance { dl: -e * l1, dl_2: -e * l2, ..radius });
    out
}

/// Link by link: mass with all that follows from it, where its centre is (with Steiner's part of the inertia), its
/// inertia about the centre, and the rotor.
fn serial(scene: &Scene) -> Vec<Tolerance> {
    const INERTIAS: [(&str, usize, usize); 6] =
        [("Ixx", 0, 0), ("Ixy", 0, 1), ("Ixz", 0, 2), ("Iyy", 1, 1), ("Iyz", 1, 2), ("Izz", 2, 2)];
    let tol = scene.robot.tolerance.mass;
    let parameters = scene.body.parameters();
    let mut out = Vec::new();
    for j in 0..scene.joints {
        let slot = |symbol: &str| parameters.iter().position(|p| p.symbol == format!("{symbol}{}", j + 1));
        let value = |symbol: &str| slot(symbol).and_then(|i| scene.pi.get(i)).copied().unwrap_or(0.0);
        let (mass, moment) = (value("m"), Vector3::new(value("mx"), value("my"), value("mz")));
        // m (c·c 1 − c cᵀ), from the first moment m c.
        let steiner = if mass > 0.0 {
            (Matrix3::identity() * moment.norm_squared() - moment * moment.transpose()) / mass
        } else {
            Matrix3::zeros()
        };
        let link = |name: &str, changes: Vec<(&str, f64)>| {
            let changes: Vec<(usize, f64)> =
                changes.into_iter().filter_map(|(s, v)| Some((slot(s)?, tol * v))).collect();
            Tolerance::named(scene, &format!("link {} {name}", j + 1)).with(&changes)
        };
        let moments = [("mx", moment.x), ("my", moment.y), ("mz", moment.z)];
        let about = |f: &dyn Fn(f64, f64) -> f64| -> Vec<(&'static str, f64)> {
            INERTIAS.iter().map(|(s, r, c)| (*s, f(value(s), steiner[(*r, *c)]))).collect()
        };
        let mut all = vec![("m", mass)];
        all.extend(moments);
        all.extend(about(&|whole, _| whole));
        let mut centre = moments.to_vec();
        centre.extend(about(&|_, steiner| 2.0 * steiner));
        out.push(link("mass", all));
        out.push(link("centre", centre));
        out.push(link("inertia", about(&|whole, steiner| whole - steiner)));
        out.push(link("rotor", vec![("Ia", value("Ia"))]));
    }
    out
}
