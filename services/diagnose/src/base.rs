//! What is in every model: mechanics, viscous and Coulomb friction, and what the robot file leaves open.

use crate::model::{BaseColumn, BaseRole};
use crate::scene::{Column, Raw, Scene};
use lacuna_estimation::filter::{Stencil, differentiate};
use lacuna_interfaces::RobotFile;
use lacuna_interfaces::robot::{Kind, Mass};
use lacuna_physics::RigidBody;
use lacuna_physics::delta::parameters::{GC, INERTIA, M_GR, M_IN};

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

    /// Residual with viscous and Coulomb friction over the torque, each joint by its own, root mean square.
    pub fn relative_error(&self, scene: &Scene) -> f64 {
        let power = |x: &[f64]| x.iter().map(|v| v * v).sum::<f64>().max(1e-30);
        let shares = (0..scene.joints).map(|j| {
            let of = |role: &BaseRole| self.columns.iter().find(|c| c.role == *role).map(|c| &c.column.part[j]);
            match (of(&BaseRole::Viscous(j)), of(&BaseRole::Coulomb(j))) {
                (Some(v), Some(c)) => two_column_rest(&self.target.part[j], v, c) / power(&self.torque.part[j]),
                _ => f64::INFINITY,
            }
        });
        (shares.sum::<f64>() / scene.joints as f64).sqrt()
    }

    /// Base whose dynamic parameters are fitted freely: the smallest set that the motion tells apart.
    pub fn free(scene: &Scene) -> Self {
        let torque_raw: Raw = scene.pieces.iter().map(|p| p.tau.clone()).collect();
        let torque = scene.column(torque_raw);
        let nominal = scene.pieces.iter().map(|p| vec![vec![0.0; p.len()]; scene.joints]).collect();
        let mut base = Self {
            target: torque.clone(),
            torque,
            nominal,
            stick: Raw::new(),
            width: vec![1e-4; scene.joints],
            columns: Vec::new(),
            nominal_base: false,
        };
        base.add_friction(scene);
        for j in 0..scene.joints {
            let raw = crate::scene::constant(scene, j);
            push(scene, &mut base.columns, BaseRole::Offset(j), raw);
        }
        let dynamic = parameter_columns(scene);
        let fixed: Vec<&Column> = base.columns.iter().map(|c| &c.column).collect();
        let keep = independent(&fixed, &dynamic);
        let symbols = scene.body.parameters();
        for (i, column) in dynamic.into_iter().enumerate().filter(|(i, _)| keep.contains(i)) {
            let role = BaseRole::Parameter(symbols[i].symbol.clone());
            base.columns.push(BaseColumn { role, raw: Raw::new(), column });
        }
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

/// Regressor columns of all dynamic parameters at the rows.
fn parameter_columns(scene: &Scene) -> Vec<Column> {
    let (n, p) = (scene.joints, scene.body.parameters().len());
    let mut out: Vec<Column> = vec![Column { part: vec![Vec::new(); n] }; p];
    for c in 0..p {
        let raw = scene.structure_raw(|piece, k, values| {
            let mut y = vec![0.0; n * p];
            if scene.with_motion(piece, k, |m| scene.body.regressor(m, &mut y)).is_ok() {
                for (j, v) in values.iter_mut().enumerate() {
                    *v = y[j * p + c];
                }
            }
        });
        out[c] = scene.column(raw);
    }
    out
}

/// Which of `columns` add something to `fixed` and to one another: largest remainder first, until what is
/// left of a column is below a hundredth of it.
fn independent(fixed: &[&Column], columns: &[Column]) -> Vec<usize> {
    const LEFT: f64 = 1e-4;
    let dot = |a: &Column, b: &Column| -> f64 {
        a.part.iter().zip(&b.part).map(|(x, y)| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>()).sum()
    };
    let all: Vec<&Column> = fixed.iter().copied().chain(columns).collect();
    let n = all.len();
    let size: Vec<f64> = all.iter().map(|c| dot(c, c).sqrt()).collect();
    let scale = |i: usize| if size[i] > 1e-9 { 1.0 / size[i] } else { 0.0 };
    let mut g = vec![vec![0.0; n]; n];
    for i in 0..n {
        for k in 0..=i {
            let v = dot(all[i], all[k]) * scale(i) * scale(k);
            g[i][k] = v;
            g[k][i] = v;
        }
    }
    // Gaussian elimination on the products: after a column is taken, the diagonal is what is left of the others.
    let eliminate = |g: &mut Vec<Vec<f64>>, i: usize| {
        let pivot = g[i][i];
        let row = g[i].clone();
        for k in 0..n {
            let f = g[k][i] / pivot;
            for c in 0..n {
                g[k][c] -= f * row[c];
            }
        }
    };
    for i in 0..fixed.len() {
        if g[i][i] > LEFT {
            eliminate(&mut g, i);
        }
    }
    let mut keep = Vec::new();
    loop {
        let best = (fixed.len()..n).filter(|i| !keep.contains(i)).max_by(|a, b| g[*a][*a].total_cmp(&g[*b][*b]));
        match best {
            Some(i) if g[i][i] > LEFT => {
                eliminate(&mut g, i);
                keep.push(i);
            }
            _ => break,
        }
    }
    keep.iter().map(|i| i - fixed.len()).collect()
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
            ("upper arm length", |r, f| {
                if let Some(g) = &mut r.geometry {
                    g.l1 *= f
                }
            }),
            ("forearm length", |r, f| {
                if let Some(g) = &mut r.geometry {
                    g.l2 *= f
                }
            }),
            ("radius difference", |r, f| {
                if let Some(g) = &mut r.geometry {
                    g.ra = g.rb + (g.ra - g.rb) * f
                }
            }),
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
