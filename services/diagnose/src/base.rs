//! What is in every model: mechanics, viscous and Coulomb friction, and what the robot file leaves open.

use crate::model::{BaseColumn, BaseRole, Model};
use crate::scene::{Column, Raw, Scene};
use crate::tolerance::{self, Tolerance};
use rayon::prelude::*;

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
    /// What the robot file leaves open, as far as it has a column.
    pub tolerances: Vec<Tolerance>,
    /// Whether the robot file's masses are used.
    pub nominal_base: bool,
    /// Whether `nominal` is the torque that sensors behind the gears measured.
    pub measured_load: bool,
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
pub(crate) fn only(scene: &Scene, all: &Raw, j: usize) -> Raw {
    all.iter()
        .map(|p| {
            let mut out = vec![Vec::new(); scene.joints];
            out[j].clone_from(&p[j]);
            out
        })
        .collect()
}

pub(crate) fn push(scene: &Scene, out: &mut Vec<BaseColumn>, role: BaseRole, raw: Raw) {
    let column = scene.column(raw.clone());
    out.push(BaseColumn { role, raw, column, precision: 0.0 });
}

impl Base {
    /// Base on the robot file's masses.
    pub fn nominal(scene: &Scene) -> Self {
        let mut base = Self::bare(scene, true, false);
        base.fit_friction(scene);
        base.add_tolerances(scene);
        base
    }

    /// This base on other recordings: the same columns, with the travel of the friction states fitted here.
    pub fn on(&self, scene: &Scene) -> Self {
        let mut base = Self::bare(scene, self.nominal_base, self.measured_load);
        base.width.clone_from(&self.width);
        base.add_friction(scene);
        if self.measured_load {
            base.add_transmission(scene);
            return base;
        }
        if self.nominal_base {
            base.add_tolerances(scene);
            return base;
        }
        base.add_offsets(scene);
        let symbols = scene.body.parameters();
        let mut dynamic: Vec<Option<Column>> = parameter_columns(scene).into_iter().map(Some).collect();
        for own in &self.columns {
            let BaseRole::Parameter(name) = &own.role else { continue };
            let at = symbols.iter().position(|s| s.symbol == *name);
            let column = at.and_then(|i| dynamic.get_mut(i)?.take());
            let column = column.unwrap_or_else(|| Column::new(vec![Vec::new(); scene.joints]));
            base.columns.push(BaseColumn { role: own.role.clone(), raw: Raw::new(), column, precision: own.precision });
        }
        base
    }

    /// Torques without columns.
    pub(crate) fn bare(scene: &Scene, nominal_base: bool, measured_load: bool) -> Self {
        let torque_raw: Raw = scene.pieces.iter().map(|p| p.tau.clone()).collect();
        let nominal = if measured_load {
            scene.pieces.iter().map(|p| p.sensor.clone()).collect()
        } else if nominal_base {
            scene.rigid_raw(scene.body.as_ref(), &scene.pi)
        } else {
            scene.pieces.iter().map(|p| vec![vec![0.0; p.len()]; scene.joints]).collect()
        };
        let target = scene.column(difference(&torque_raw, &nominal));
        Self {
            // Behind a sensor it is the drive train's own torque that is in question, not what passes through it.
            torque: if measured_load { target.clone() } else { scene.column(torque_raw) },
            target,
            nominal,
            stick: Raw::new(),
            width: vec![1e-4; scene.joints],
            columns: Vec::new(),
            tolerances: Vec::new(),
            nominal_base,
            measured_load,
        }
    }

    /// Residual with viscous and Coulomb friction over the torque: each joint by its own, and of these the upper median,
    /// since one joint with much left out says nothing about the masses of the others.
    pub fn relative_error(&self, scene: &Scene) -> f64 {
        let power = |x: &[f64]| x.iter().map(|v| v * v).sum::<f64>().max(1e-30);
        let share = |j: usize| {
            let of = |role: &BaseRole| self.columns.iter().find(|c| c.role == *role).map(|c| &c.column.part[j]);
            match (of(&BaseRole::Viscous(j)), of(&BaseRole::Coulomb(j))) {
                (Some(v), Some(c)) => two_column_rest(&self.target.part[j], v, c) / power(&self.torque.part[j]),
                _ => f64::INFINITY,
            }
        };
        let mut shares: Vec<f64> = (0..scene.joints).map(share).collect();
        shares.sort_by(f64::total_cmp);
        shares.get(scene.joints / 2).map_or(f64::INFINITY, |s| s.sqrt())
    }

    /// Base whose dynamic parameters are fitted freely: the smallest set that the motion tells apart.
    pub fn free(scene: &Scene) -> Self {
        let mut base = Self::bare(scene, false, false);
        base.fit_friction(scene);
        base.add_offsets(scene);
        let dynamic = parameter_columns(scene);
        let fixed: Vec<&Column> = base.columns.iter().map(|c| &c.column).collect();
        let keep = independent(&fixed, &dynamic);
        let symbols = scene.body.parameters();
        for (i, column) in dynamic.into_iter().enumerate().filter(|(i, _)| keep.contains(i)) {
            let role = BaseRole::Parameter(symbols[i].symbol.clone());
            base.columns.push(BaseColumn { role, raw: Raw::new(), column, precision: 0.0 });
        }
        base.fit_widths(scene);
        base.hold_weakly(scene);
        base
    }

    /// Fits the travel of each joint's friction state once more, now beside all other columns: against the whole torque
    /// of an arm, gravity and inertia hide what happens at a reversal.
    fn fit_widths(&mut self, scene: &Scene) {
        for _ in 0..2 {
            let columns: Vec<&Column> = self.columns.iter().map(|c| &c.column).collect();
            let coulomb = |j| self.columns.iter().position(|c| c.role == BaseRole::Coulomb(j));
            let own: Vec<Option<usize>> = (0..scene.joints).map(coulomb).collect();
            match self.better_widths(scene, (&columns, &own), &self.target, &|_| 0.0) {
                Some(width) => self.set_widths(scene, &width),
                None => return,
            }
        }
    }

    /// Travels of the friction states [rad] that fit `target` better beside `columns`, of which `own` are the Coulomb
    /// columns of the joints; none if no sum of squares falls by more than `least` of its joint's mean square, and by
    /// more than a small share of itself.
    pub(crate) fn better_widths(
        &self,
        scene: &Scene,
        (columns, own): (&[&Column], &[Option<usize>]),
        target: &Column,
        least: &(dyn Fn(usize) -> f64 + Sync),
    ) -> Option<Vec<f64>> {
        let parts: Vec<&[Vec<f64>]> = columns.iter().map(|c| c.part.as_slice()).collect();
        let weight = joint_weights(&parts, &target.part)?;
        let best = |(j, own): (usize, &Option<usize>)| -> Option<f64> {
            let others: Vec<&[Vec<f64>]> =
                parts.iter().enumerate().filter(|(i, _)| Some(*i) != *own).map(|(_, c)| *c).collect();
            let fit = Beside::new(&others, &target.part, &weight)?;
            let gain = |width: f64| fit.gain(j, &state(scene, j, width));
            let now = gain(self.width[j]);
            // In units of the mean square that is left: how much friction explains in all is no measure for this.
            let rows = target.part[j].len() as f64;
            let enough = now + least(j).max(WIDTH_SHARE * rows);
            let (gain, width) = WIDTHS.into_iter().map(|w| (gain(w), w)).max_by(|a, b| a.0.total_cmp(&b.0))?;
            (own.is_some() && gain > enough).then_some(width)
        };
        let found: Vec<Option<f64>> = own.par_iter().enumerate().map(best).collect();
        let merged = found.iter().zip(&self.width).map(|(new, old)| new.unwrap_or(*old)).collect();
        found.iter().any(Option::is_some).then_some(merged)
    }

    /// Takes other travels of the friction states [rad].
    pub(crate) fn set_widths(&mut self, scene: &Scene, width: &[f64]) {
        self.width = width.to_vec();
        self.stick = sticks(scene, &self.width);
        for j in 0..scene.joints {
            let raw = only(scene, &self.stick, j);
            if let Some(own) = self.columns.iter_mut().find(|c| c.role == BaseRole::Coulomb(j)) {
                own.column = scene.column(raw.clone());
                own.raw = raw;
            }
        }
    }

    /// Gives every column of a freely fitted base a weak prior: a coefficient whose torque is as large as all the
    /// torque there is costs half a nat. Where the motion excites a column that is nothing; where a fold left
    /// out is the only one to excite it, it keeps the others from extrapolating without bounds.
    pub(crate) fn hold_weakly(&mut self, scene: &Scene) {
        let power = |x: &[f64]| x.iter().map(|v| v * v).sum::<f64>();
        for column in &mut self.columns {
            let joints: Vec<usize> = (0..scene.joints).filter(|j| !column.column.part[*j].is_empty()).collect();
            let shares =
                joints.iter().map(|j| power(&column.column.part[*j]) / power(&self.torque.part[*j]).max(1e-30));
            column.precision = shares.fold(0.0, f64::max);
        }
    }

    pub(crate) fn fit_friction(&mut self, scene: &Scene) {
        let speeds: Raw = scene.pieces.iter().map(|p| p.qd.clone()).collect();
        for j in 0..scene.joints {
            self.width[j] = fit_width(scene, &self.target, &speeds, j);
        }
        self.add_friction(scene);
    }

    pub(crate) fn add_offsets(&mut self, scene: &Scene) {
        for j in 0..scene.joints {
            let raw = crate::scene::constant(scene, j);
            push(scene, &mut self.columns, BaseRole::Offset(j), raw);
        }
    }

    fn add_friction(&mut self, scene: &Scene) {
        let speeds: Raw = scene.pieces.iter().map(|p| p.qd.clone()).collect();
        self.stick = sticks(scene, &self.width);
        for j in 0..scene.joints {
            push(scene, &mut self.columns, BaseRole::Viscous(j), only(scene, &speeds, j));
            push(scene, &mut self.columns, BaseRole::Coulomb(j), only(scene, &self.stick, j));
        }
    }

    fn add_tolerances(&mut self, scene: &Scene) {
        for tolerance in tolerance::all(scene) {
            if let Some(raw) = tolerance.raw(scene, &self.nominal) {
                push(scene, &mut self.columns, BaseRole::Tolerance(tolerance.name.clone()), raw);
                self.tolerances.push(tolerance);
            }
        }
    }

    /// What a model's base adds to the robot file: parameters, lengths and delay of all its tolerances.
    pub fn departure(&self, scene: &Scene, model: &Model, beta: &[f64]) -> Tolerance {
        let mut out = Tolerance::none(scene);
        for (i, value) in model.base_values(beta) {
            if let BaseRole::Tolerance(name) = &model.base[i].role
                && let Some(t) = self.tolerances.iter().find(|t| &t.name == name)
            {
                out.add(t, value);
            }
        }
        out
    }
}

fn difference(a: &Raw, b: &Raw) -> Raw {
    let one = |(x, y): (&Vec<f64>, &Vec<f64>)| x.iter().zip(y).map(|(x, y)| x - y).collect();
    a.iter().zip(b).map(|(a, b)| a.iter().zip(b).map(one).collect()).collect()
}

/// Regressor columns of all dynamic parameters at the rows.
fn parameter_columns(scene: &Scene) -> Vec<Column> {
    let (n, p) = (scene.joints, scene.body.parameters().len());
    let mut out: Vec<Column> = vec![Column::new(vec![Vec::new(); n]); p];
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

/// Share of what is left at a joint that another travel must take off.
const WIDTH_SHARE: f64 = 0.05;
/// Travels that are tried [rad].
const WIDTHS: [f64; 8] = [2e-5, 5e-5, 1e-4, 2e-4, 4e-4, 8e-4, 1.6e-3, 3.2e-3];

/// Joint `j`'s friction state at a width, at the rows.
fn state(scene: &Scene, j: usize, width: f64) -> Vec<f64> {
    let one = |p: &crate::scene::Piece| {
        let mut out = vec![Vec::new(); scene.joints];
        out[j] = bristle(&p.q[j], width);
        out
    };
    let states: Raw = scene.pieces.iter().map(one).collect();
    std::mem::take(&mut scene.column(states).part[j])
}

/// Travel of the bristle that fits best with viscous friction beside it.
fn fit_width(scene: &Scene, target: &Column, speeds: &Raw, j: usize) -> f64 {
    let y = &target.part[j];
    let v = scene.column(only(scene, speeds, j)).part[j].clone();
    let mut best = (f64::INFINITY, 1e-4);
    for width in WIDTHS {
        let rest = two_column_rest(y, &v, &state(scene, j, width));
        if rest < best.0 * 0.999 {
            best = (rest, width);
        }
    }
    best.1
}

fn dot(x: &[f64], y: &[f64]) -> f64 {
    x.iter().zip(y).map(|(x, y)| x * y).sum()
}

/// One over each joint's mean square residual on `columns`.
fn joint_weights(columns: &[&[Vec<f64>]], target: &[Vec<f64>]) -> Option<Vec<f64>> {
    let mean_square = |v: &[f64]| (dot(v, v) / v.len().max(1) as f64).max(1e-12);
    let first: Vec<f64> = target.iter().map(|y| 1.0 / mean_square(y)).collect();
    let beta = Beside::new(columns, target, &first)?.coefficients;
    let rest = target.iter().enumerate().map(|(j, y)| {
        let mut rest = y.clone();
        for (column, b) in columns.iter().zip(beta.iter()) {
            // A column that does not act on a joint has no rows there.
            rest.iter_mut().zip(&column[j]).for_each(|(r, x)| *r -= b * x);
        }
        1.0 / mean_square(&rest)
    });
    Some(rest.collect())
}

/// A weighted least-squares fit on some columns, to ask what one more would gain.
struct Beside<'a> {
    columns: &'a [&'a [Vec<f64>]],
    target: &'a [Vec<f64>],
    weight: &'a [f64],
    factor: nalgebra::Cholesky<f64, nalgebra::Dyn>,
    coefficients: nalgebra::DVector<f64>,
}

impl<'a> Beside<'a> {
    fn new(columns: &'a [&'a [Vec<f64>]], target: &'a [Vec<f64>], weight: &'a [f64]) -> Option<Self> {
        let n = columns.len();
        let product = |a: &[Vec<f64>], b: &[Vec<f64>]| -> f64 {
            a.iter().zip(b).zip(weight).map(|((x, y), w)| w * dot(x, y)).sum()
        };
        let mut gram =
            nalgebra::DMatrix::from_fn(n, n, |r, c| if c <= r { product(columns[r], columns[c]) } else { 0.0 });
        for r in 0..n {
            // Columns that the motion hardly tells apart are held, not resolved.
            gram[(r, r)] = gram[(r, r)] * (1.0 + 1e-9) + 1e-12;
            for c in 0..r {
                gram[(c, r)] = gram[(r, c)];
            }
        }
        let right = nalgebra::DVector::from_fn(n, |r, _| product(columns[r], target));
        let factor = gram.cholesky()?;
        let coefficients = factor.solve(&right);
        Some(Self { columns, target, weight, factor, coefficients })
    }

    /// By how much the weighted sum of squares falls if joint `j` gets `column` besides.
    fn gain(&self, j: usize, column: &[f64]) -> f64 {
        let w = self.weight[j];
        let along = nalgebra::DVector::from_fn(self.columns.len(), |r, _| w * dot(&self.columns[r][j], column));
        let left = w * dot(column, column) - along.dot(&self.factor.solve(&along));
        let toward = w * dot(column, &self.target[j]) - along.dot(&self.coefficients);
        if left > 1e-9 * w * dot(column, column) { toward * toward / left } else { 0.0 }
    }
}

/// Residual sum of squares of y on two columns.
fn two_column_rest(y: &[f64], a: &[f64], b: &[f64]) -> f64 {
    let (aa, ab, bb, ya, yb) = (dot(a, a), dot(a, b), dot(b, b), dot(y, a), dot(y, b));
    let det = aa * bb - ab * ab;
    if det <= 1e-12 * aa * bb {
        return dot(y, y);
    }
    let (ca, cb) = ((ya * bb - yb * ab) / det, (yb * aa - ya * ab) / det);
    dot(y, y) - ca * ya - cb * yb
}
