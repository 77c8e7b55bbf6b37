//! What is in every model: mechanics, viscous and Coulomb friction, and what the robot file leaves open.

use crate::scene::{Column, Raw, Scene};
use crate::search::{BaseColumn, BaseRole};
use lacuna_estimation::filter::{Stencil, differentiate};
use lacuna_interfaces::RobotFile;
use lacuna_interfaces::robot::{Kind, Mass};
use lacuna_physics::delta::parameters::{GC, INERTIA, M_GR, M_IN};
use lacuna_physics::RigidBody;

/// Torque to be explained and the base columns.
pub struct Base {
    /// Recorded torque less `nominal`, at the rows.
    pub target: Column,
    /// Recorded torque, at the rows.
    pub torque: Column,
    /// Rigid-body torque of the robot file (zero if the base is fitted freely), full rate.
    pub nominal: Raw,
    /// Friction state of each joint, −1 to 1, full rate.
    pub stick: Raw,
    /// Travel over which each joint's friction turns round [rad].
    pub width: Vec<f64>,
    /// Columns.
    pub columns: Vec<BaseColumn>,
    /// Whether the robot file's masses are used.
    pub nominal_base: bool,
}

/// State of a bristle that bends over `width` before it slides: s ← clip(s + Δθ/width).
pub fn bristle(q: &[f64], width: f64) -> Vec<f64> {
    let mut s: f64 = 0.0;
    let mut last = q.first().copied().unwrap_or(0.0);
    q.iter()
        .map(|&x| {
            s = (s + (x - last) / width).clamp(-1.0, 1.0);
            last = x;
            s
        })
        .collect()
}

/// Friction states of all joints at the given widths.
pub fn sticks(scene: &Scene, width: &[f64]) -> Raw {
    scene.pieces.iter().map(|p| (0..scene.joints).map(|j| bristle(&p.q[j], width[j])).collect()).collect()
}

/// One joint's signals alone.
fn only(scene: &Scene, all: &Raw, j: usize) -> Raw {
    all.iter()
        .map(|p| {
            let mut out = vec![Vec::new(); scene.joints];
            out[j].clone_from(&p[j]);
            out
        })
        .collect()
}

fn push(scene: &Scene, out: &mut Vec<BaseColumn>, role: BaseRole, raw: Raw) {
    let column = scene.column(raw.clone());
    out.push(BaseColumn { role, raw, column });
}

impl Base {
    /// Base on the robot file's masses.
    pub fn nominal(scene: &Scene) -> Self {
        let nominal = scene.rigid_raw(scene.body.as_ref(), &scene.pi);
        let torque_raw: Raw = scene.pieces.iter().map(|p| p.tau.clone()).collect();
        let difference: Raw = torque_raw
            .iter()
            .zip(&nominal)
            .map(|(a, b)| a.iter().zip(b).map(|(x, y)| x.iter().zip(y).map(|(x, y)| x - y).collect()).collect())
            .collect();
        let mut base = Self {
            target: scene.column(difference),
            torque: scene.column(torque_raw),
            nominal,
            stick: Raw::new(),
            width: vec![1e-4; scene.joints],
            columns: Vec::new(),
            nominal_base: true,
        };
        base.add_friction(scene);
        base.add_tolerances(scene);
        base
    }

    fn add_friction(&mut self, scene: &Scene) {
        let speeds: Raw = scene.pieces.iter().map(|p| p.qd.clone()).collect();
        for j in 0..scene.joints {
            self.width[j] = fit_width(scene, &self.target, &speeds, j);
        }
        self.stick = sticks(scene, &self.width);
        for j in 0..scene.joints {
            push(scene, &mut self.columns, BaseRole::Viscous(j), only(scene, &speeds, j));
            push(scene, &mut self.columns, BaseRole::Coulomb(j), only(scene, &self.stick, j));
        }
    }

    fn add_tolerances(&mut self, scene: &Scene) {
        for (name, robot, pi) in variants(scene) {
            let raw = match &robot {
                Some(file) => match lacuna_physics::build(file, scene.urdf.as_deref()) {
                    Ok(body) => {
                        let pi = body.nominal();
                        difference(&scene.rigid_raw(body.as_ref() as &dyn RigidBody, &pi), &self.nominal)
                    }
                    Err(_) => continue,
                },
                None => difference(&scene.rigid_raw(scene.body.as_ref(), &pi), &self.nominal),
            };
            push(scene, &mut self.columns, BaseRole::Tolerance(name), raw);
        }
        // A drive that stamps its torque half a sample early or late.
        let dt = 1.0 / scene.rate_hz;
        let late: Raw = self
            .nominal
            .iter()
            .map(|p| {
                p.iter()
                    .map(|s| match differentiate(s, dt, Stencil::Seven, 1) {
                        Ok(d) => d.iter().map(|v| -v * 0.5 * dt).collect(),
                        Err(_) => vec![0.0; s.len()],
                    })
                    .collect()
            })
            .collect();
        push(scene, &mut self.columns, BaseRole::Tolerance(crate::search::DELAY.into()), late);
    }
}

fn difference(a: &Raw, b: &Raw) -> Raw {
    a.iter()
        .zip(b)
        .map(|(a, b)| a.iter().zip(b).map(|(x, y)| x.iter().zip(y).map(|(x, y)| x - y).collect()).collect())
        .collect()
}

/// Robots at the upper end of each tolerance: another file, or other parameters.
fn variants(scene: &Scene) -> Vec<(String, Option<RobotFile>, Vec<f64>)> {
    let tol = &scene.robot.tolerance;
    let mut out = Vec::new();
    if scene.robot.kind == Kind::Delta {
        if let Some(mass) = &scene.robot.mass {
            out.extend(delta_masses(scene, mass).into_iter().map(|(name, pi)| (name, None, pi)));
        }
        type Change = fn(&mut RobotFile, f64);
        let lengths: [(&str, Change); 3] = [
            ("upper arm length", |r, f| if let Some(g) = &mut r.geometry { g.l1 *= f }),
            ("forearm length", |r, f| if let Some(g) = &mut r.geometry { g.l2 *= f }),
            ("radius difference", |r, f| if let Some(g) = &mut r.geometry { g.ra = g.rb + (g.ra - g.rb) * f }),
        ];
        for (name, change) in lengths {
            let mut file = scene.robot.clone();
            change(&mut file, 1.0 + tol.length);
            out.push((name.to_owned(), Some(file), Vec::new()));
        }
        return out;
    }
    let parameters = scene.body.parameters();
    for j in 0..scene.joints {
        // Mass with all that follows from it; where its centre is; the rotor.
        for (name, symbols) in [
            ("mass", &["m", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz"][..]),
            ("centre", &["mx", "my", "mz"][..]),
            ("rotor", &["Ia"][..]),
        ] {
            let mut pi = scene.pi.clone();
            for (v, p) in pi.iter_mut().zip(parameters) {
                if symbols.iter().any(|s| p.symbol == format!("{s}{}", j + 1)) {
                    *v *= 1.0 + tol.mass;
                }
            }
            if pi != scene.pi {
                out.push((format!("link {} {name}", j + 1), None, pi));
            }
        }
    }
    out
}

/// Parameters of a Delta with each mass of each leg at the upper end of its tolerance.
fn delta_masses(scene: &Scene, mass: &Mass) -> Vec<(String, Vec<f64>)> {
    let tol = scene.robot.tolerance.mass;
    let l1 = scene.body.as_delta().map_or(0.0, lacuna_physics::Delta::l1_m);
    let mut out = Vec::new();
    let mut push = |name: String, changes: &[(usize, f64)]| {
        let mut pi = scene.pi.clone();
        for (slot, by) in changes {
            if let Some(v) = pi.get_mut(*slot) {
                *v += tol * by;
            }
        }
        if pi != scene.pi {
            out.push((name, pi));
        }
    };
    push("platform mass".into(), &[(M_IN, mass.platform), (M_GR, mass.platform)]);
    for i in 0..3 {
        let (arm, fore) = (mass.upper_arm, mass.forearm_point);
        push(format!("upper arm {} mass", i + 1), &[(INERTIA + i, arm / 3.0 * l1 * l1), (GC + i, arm / 2.0 * l1)]);
        push(
            format!("forearm {} mass", i + 1),
            &[(INERTIA + i, fore * l1 * l1), (GC + i, fore * l1), (M_IN, fore), (M_GR, fore)],
        );
        push(format!("rotor {} inertia", i + 1), &[(INERTIA + i, mass.rotor_inertia)]);
    }
    out
}

/// Travel of the bristle that fits best with viscous friction beside it.
fn fit_width(scene: &Scene, target: &Column, speeds: &Raw, j: usize) -> f64 {
    let y = &target.part[j];
    let v = scene.column(only(scene, speeds, j)).part[j].clone();
    let mut best = (f64::INFINITY, 1e-4);
    for width in [2e-5, 1e-4, 3e-4, 1e-3, 3e-3] {
        let states: Raw = scene
            .pieces
            .iter()
            .map(|p| {
                let mut out = vec![Vec::new(); scene.joints];
                out[j] = bristle(&p.q[j], width);
                out
            })
            .collect();
        let s = &scene.column(states).part[j];
        let rest = two_column_rest(y, &v, s);
        if rest < best.0 * 0.999 {
            best = (rest, width);
        }
    }
    best.1
}

/// Residual sum of squares of y on two columns.
fn two_column_rest(y: &[f64], a: &[f64], b: &[f64]) -> f64 {
    let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
    let (aa, ab, bb, ya, yb) = (dot(a, a), dot(a, b), dot(b, b), dot(y, a), dot(y, b));
    let det = aa * bb - ab * ab;
    if det <= 1e-12 * aa * bb {
        return dot(y, y);
    }
    let (ca, cb) = ((ya * bb - yb * ab) / det, (yb * aa - ya * ab) / det);
    dot(y, y) - ca * ya - cb * yb
}
