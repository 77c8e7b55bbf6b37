//! Physically consistent parameters: every link has a positive definite pseudo-inertia, every rotor inertia and friction
//! coefficient is positive (Wensing, Kim, Slotine 2018; divergence as regulariser: Lee, Wensing, Park 2020).
//!
//! ```text
//! minimise  ½ βᵀAβ − cᵀβ + μ Σ_i [ tr(P0_i⁻¹ P_i) − log det P_i ],   β = K π,   P_i(π) = [ ½tr(I)1 − I   h ]
//!                                                                                   [ hᵀ             m ]
//! ```
//!
//! A = XᵀWX and c = XᵀWy are those of the free fit. The problem is convex in π; it is solved by Newton's method along a
//! decreasing μ (Boyd, Vandenberghe 2004, section 11.3). What the data do not determine settles near P0, the robot
//! file's link, or where it has none a link of guessed mass. As μ → 0 the determined part converges to the
//! constrained least-squares fit; how far it still is from there, its course along μ shows ([`Consistent::gap`]).
//!
//! Clarabel, the solver that one would take, has its semidefinite cone behind a feature that links BLAS and LAPACK from
//! the system (0.11: `sdp` → `blas`, `lapack`), which neither cargo nor a fresh machine brings along; the way out is to
//! compile OpenBLAS or a Fortran LAPACK, longer than all of this workspace, for 4 × 4 matrices and eighty variables. The gap
//! to the optimum is accounted for, and a test holds the optimum against Clarabel's own, from Python, where LAPACK comes
//! with the wheel.

use crate::base::Structure;
use crate::columns::Term;
use crate::fit::Solution;
use lacuna_interfaces::BadInput;
use lacuna_physics::RigidBody;
use nalgebra::{DMatrix, DVector};

/// μ at the end. In units of the weighted squared residual, whose minimum is about the number of rows: the fit is then
/// within a few hundredths per constraint dimension of the best one, thousands of rows against a few.
const MU_END: f64 = 0.01;
/// Weight with which a column that the free fit left out is held at its value, in units of its own curvature.
const HOLD: f64 = 100.0;
/// Factor by which μ falls from step to step.
const MU_STEP: f64 = 0.1;
/// Newton steps that settle what the data do not determine.
const SETTLE_STEPS: usize = 200;
/// Newton steps per μ.
const NEWTON_STEPS: usize = 60;

/// A symmetric matrix that must stay positive definite: constant-free and linear in the variables.
#[derive(Clone)]
struct Cone {
    size: usize,
    /// (variable, matrix): P = Σ variable · matrix.
    parts: Vec<(usize, DMatrix<f64>)>,
    /// P0⁻¹.
    prior_inverse: DMatrix<f64>,
    /// P0 in terms of the variables, to start from.
    start: Vec<(usize, f64)>,
}

impl Cone {
    fn at(&self, x: &DVector<f64>) -> DMatrix<f64> {
        self.parts.iter().fold(DMatrix::zeros(self.size, self.size), |p, (v, m)| p + m * x[*v])
    }
}

/// The constrained fit.
#[derive(Debug, Clone, PartialEq)]
pub struct Consistent {
    /// Base parameters β.
    pub beta: DVector<f64>,
    /// Value of every column of [`Structure::columns`], merged ones included: links that could exist.
    pub values: Vec<f64>,
    /// Weighted squared residual of the free fit.
    pub free: f64,
    /// And of this one.
    pub constrained: f64,
    /// The best constrained fit's is about this much lower at most, by the course of the fit along μ.
    pub gap: f64,
}

/// Fits with every link physically possible.
///
/// # Errors
/// [`BadInput`] if the iteration does not settle.
pub fn fit(body: &dyn RigidBody, structure: &Structure, solution: &Solution) -> Result<Consistent, BadInput> {
    let total = &solution.normal;
    let problem = Problem::of(body, structure, solution);
    let mut pi = DVector::zeros(structure.columns.len());
    for cone in &problem.cones {
        cone.start.iter().for_each(|&(v, value)| pi[v] = value);
    }
    let mut z = problem.coordinates.reduce(&pi);
    let beta = z.rows(0, structure.base.len()).into_owned();
    // Whole steps down to the end.
    let steps = (problem.misfit(&beta).abs().max(1.0) / MU_END).log10().ceil();
    let mut mu = MU_END * 10f64.powf(steps);
    // μ and the misfit there.
    let mut path: Vec<(f64, f64)> = Vec::new();
    loop {
        let before = z.clone();
        match problem.newton(mu, &mut z) {
            Ok(()) => path.push((mu, problem.misfit(&z.rows(0, structure.base.len()).into_owned()))),
            // A link driven onto the cone's border takes the last digits; what was reached before is a fit all the same.
            Err(_) if !path.is_empty() => {
                z = before;
                break;
            }
            Err(e) => return Err(e),
        }
        if mu <= 1.5 * MU_END {
            break;
        }
        mu *= MU_STEP;
    }
    problem.settle(&mut z)?;
    let dimensions: usize = problem.cones.iter().map(|cone| cone.size).sum();
    let beta = z.rows(0, structure.base.len()).into_owned();
    Ok(Consistent {
        free: total.residual_sum(&solution.beta),
        gap: 2.0 * left(&path, dimensions as f64),
        constrained: total.residual_sum(&beta),
        beta,
        values: problem.coordinates.expand(&z).iter().copied().collect(),
    })
}

/// How far the misfit at the end of the path is above its optimum: by the barrier, μ times the dimensions; by the trace term,
/// more where the best links are large against P0, and by a power of μ below one where they are without bound. Its falls from
/// step to step are then a geometric series (Aitken).
fn left(path: &[(f64, f64)], dimensions: f64) -> f64 {
    let series = match path {
        [.., (_, a), (_, b), (_, c)] if a > b && b > c && a - b > b - c => (b - c) * (b - c) / ((a - b) - (b - c)),
        _ => 0.0,
    };
    path.last().map_or(f64::INFINITY, |(mu, _)| series.max(mu * dimensions))
}

/// π = T z, with z the base parameters β followed by every other parameter: in z the data touch β alone, exactly, and no
/// digit of the rest is lost to it.
#[derive(Clone)]
struct Coordinates {
    t: DMatrix<f64>,
    /// Column of every z behind the base.
    others: Vec<usize>,
    base: Vec<(usize, Vec<(usize, f64)>)>,
}

impl Coordinates {
    fn of(structure: &Structure) -> Self {
        let base: Vec<(usize, Vec<(usize, f64)>)> =
            structure.base.iter().map(|b| (b.column, b.merged.clone())).collect();
        let others: Vec<usize> = (0..structure.columns.len()).filter(|c| !base.iter().any(|(b, _)| b == c)).collect();
        let mut t = DMatrix::zeros(structure.columns.len(), structure.columns.len());
        for (i, &c) in others.iter().enumerate() {
            t[(c, base.len() + i)] = 1.0;
        }
        for (b, (column, merged)) in base.iter().enumerate() {
            t[(*column, b)] = 1.0;
            for (c, factor) in merged {
                if let Some(i) = others.iter().position(|o| o == c) {
                    t[(*column, base.len() + i)] = -factor;
                }
            }
        }
        Self { t, others, base }
    }

    fn expand(&self, z: &DVector<f64>) -> DVector<f64> {
        &self.t * z
    }

    fn reduce(&self, pi: &DVector<f64>) -> DVector<f64> {
        let beta = self.base.iter().map(|(c, merged)| pi[*c] + merged.iter().map(|(d, k)| k * pi[*d]).sum::<f64>());
        let rest = self.others.iter().map(|&c| pi[c]);
        DVector::from_iterator(self.t.ncols(), beta.chain(rest))
    }
}

#[derive(Clone)]
struct Problem {
    a: DMatrix<f64>,
    c: DVector<f64>,
    cones: Vec<Cone>,
    coordinates: Coordinates,
}

impl Problem {
    fn of(body: &dyn RigidBody, structure: &Structure, solution: &Solution) -> Self {
        let (mut a, mut c) = (solution.normal.xtx(), solution.normal.xty());
        for u in &solution.unexcited {
            let hold = HOLD * a[(u.base, u.base)];
            a[(u.base, u.base)] += hold;
            c[u.base] += hold * solution.beta[u.base];
        }
        Self { a, c, cones: cones(body, structure, solution), coordinates: Coordinates::of(structure) }
    }

    /// ½ βᵀAβ − cᵀβ.
    fn misfit(&self, beta: &DVector<f64>) -> f64 {
        0.5 * beta.dot(&(&self.a * beta)) - self.c.dot(beta)
    }

    /// The objective; `None` outside the cones.
    fn objective(&self, mu: f64, z: &DVector<f64>) -> Option<f64> {
        let pi = self.coordinates.expand(z);
        let mut value = self.misfit(&z.rows(0, self.c.len()).into_owned());
        for cone in &self.cones {
            let p = cone.at(&pi);
            let trace = cone.prior_inverse.component_mul(&p).sum();
            let chol = p.cholesky()?;
            let log_det = 2.0 * chol.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
            value += mu * (trace - log_det);
        }
        value.is_finite().then_some(value)
    }

    /// Gradient and Hessian of the objective in z.
    fn derivatives(&self, mu: f64, z: &DVector<f64>) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let pi = self.coordinates.expand(z);
        let n = pi.len();
        let (mut g, mut h) = (DVector::zeros(n), DMatrix::zeros(n, n));
        for cone in &self.cones {
            let inverse = cone.at(&pi).try_inverse()?;
            let products: Vec<DMatrix<f64>> = cone.parts.iter().map(|(_, m)| &inverse * m).collect();
            for (i, (v, m)) in cone.parts.iter().enumerate() {
                g[*v] += mu * (cone.prior_inverse.component_mul(m).sum() - products[i].trace());
                for (j, (w, _)) in cone.parts.iter().enumerate() {
                    // ∂²(−log det P) = tr(P⁻¹ M_i P⁻¹ M_j)
                    h[(*v, *w)] += mu * products[i].component_mul(&products[j].transpose()).sum();
                }
            }
        }
        let t = &self.coordinates.t;
        let mut gradient = t.transpose() * g;
        let mut hessian = t.transpose() * h * t;
        let base = self.c.len();
        let beta = z.rows(0, base).into_owned();
        let slope = &self.a * &beta - &self.c;
        gradient.rows_mut(0, base).iter_mut().zip(slope.iter()).for_each(|(g, s)| *g += s);
        let mut corner = hessian.view_mut((0, 0), (base, base));
        corner += &self.a;
        Some((gradient, hessian))
    }

    /// Minimises the objective at one μ, from a feasible start.
    fn newton(&self, mu: f64, z: &mut DVector<f64>) -> Result<(), BadInput> {
        for _ in 0..NEWTON_STEPS {
            let (gradient, hessian) =
                self.derivatives(mu, z).ok_or_else(|| failed("a pseudo-inertia became singular"))?;
            let step = scaled_solve(&hessian, &gradient).ok_or_else(|| failed("the Newton system is singular"))?;
            let decrement = gradient.dot(&step);
            if decrement.is_nan() {
                return Err(failed("the objective is not finite"));
            }
            if decrement <= 1e-9 * mu {
                return Ok(());
            }
            let now = self.objective(mu, z).ok_or_else(|| failed("the start is not feasible"))?;
            let mut length = 1.0;
            let mut moved = false;
            while length > 1e-12 && !moved {
                let next = &*z - &step * length;
                if self.objective(mu, &next).is_some_and(|v| v <= now - 1e-4 * length * decrement) {
                    *z = next;
                    moved = true;
                }
                length *= 0.5;
            }
            // At rounding there is nothing left to gain.
            if !moved {
                return Ok(());
            }
        }
        Ok(())
    }
}

impl Problem {
    /// Moves what the data do not determine to the links closest to P0, with the base parameters as they are. Beside the
    /// data's curvature a divergence of this size is below rounding; alone it has all digits.
    fn settle(&self, z: &mut DVector<f64>) -> Result<(), BadInput> {
        let base = self.c.len();
        let free = z.len() - base;
        if free == 0 {
            return Ok(());
        }
        let alone = Self { a: DMatrix::zeros(base, base), c: DVector::zeros(base), ..self.clone() };
        for _ in 0..SETTLE_STEPS {
            let (gradient, hessian) =
                alone.derivatives(1.0, z).ok_or_else(|| failed("a pseudo-inertia became singular"))?;
            let (g, h) =
                (gradient.rows(base, free).into_owned(), hessian.view((base, base), (free, free)).into_owned());
            let step = scaled_solve(&h, &g).ok_or_else(|| failed("the Newton system is singular"))?;
            let decrement = g.dot(&step);
            let Some(now) = alone.objective(1.0, z).filter(|_| decrement > 1e-12) else { return Ok(()) };
            let try_length = |length: f64| {
                let mut next = z.clone();
                let mut rest = next.rows_mut(base, free);
                rest -= &step * length;
                let better = alone.objective(1.0, &next)? <= now - 1e-4 * length * decrement;
                better.then_some(next)
            };
            // At rounding there is nothing left to gain.
            let Some(next) = (0..40).find_map(|k| try_length(0.5f64.powi(k))) else { return Ok(()) };
            *z = next;
        }
        Ok(())
    }
}

/// Cholesky solution with the matrix scaled to a unit diagonal.
fn scaled_solve(matrix: &DMatrix<f64>, rhs: &DVector<f64>) -> Option<DVector<f64>> {
    let scale = matrix.diagonal().map(|d| if d > 0.0 { 1.0 / d.sqrt() } else { 1.0 });
    let n = matrix.nrows();
    let mut scaled = DMatrix::from_fn(n, n, |i, j| matrix[(i, j)] * scale[i] * scale[j]);
    // Variables that neither data nor prior know (offsets of a joint that never moves) stay where they are.
    for i in 0..n {
        scaled[(i, i)] += 1e-13;
    }
    let solved = scaled.cholesky()?.solve(&rhs.component_mul(&scale));
    Some(solved.component_mul(&scale))
}

fn failed(why: &str) -> BadInput {
    BadInput::new(format!(
        "physically consistent fit: {why}; expected a solvable problem (check the robot file's masses)"
    ))
}

/// Radius of gyration of a link that the robot file says nothing of [m].
const UNKNOWN_RADIUS: f64 = 0.1;
/// Lever by which its mass is guessed from the largest first moment found [m]; at least 1 kg.
const UNKNOWN_LEVER: f64 = 0.5;
/// A rotor inertia or friction coefficient that nothing is known of.
const UNKNOWN_SCALAR: f64 = 0.1;
/// The same of one that no torque tells from another parameter.
const UNKNOWN_MERGED: f64 = 1e-4;

fn cones(body: &dyn RigidBody, structure: &Structure, solution: &Solution) -> Vec<Cone> {
    let moments =
        structure.base.iter().enumerate().filter(|(_, b)| structure.columns[b.column].unit.starts_with("kg m"));
    let first = moments.filter(|(_, b)| !structure.columns[b.column].unit.contains("^2"));
    // Only of moments that the data tell from zero: noise would make a link of tons.
    let told = first.filter(|(i, _)| solution.excited.contains(i) && solution.beta[*i].abs() > solution.half_width(*i));
    let mass = told.map(|(i, _)| solution.beta[i].abs() / UNKNOWN_LEVER).fold(1.0, f64::max);
    let find = |symbol: &str| structure.columns.iter().position(|c| c.symbol == symbol);
    let mut out = Vec::new();
    if body.as_serial().is_some() {
        for link in 1..=body.joint_count() {
            let names = ["Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz", "mx", "my", "mz", "m"];
            let found: Option<Vec<usize>> = names.iter().map(|n| find(&format!("{n}{link}"))).collect();
            if let Some(place) = found {
                out.push(pseudo_inertia(structure, &place, mass));
            }
        }
    }
    for (v, column) in structure.columns.iter().enumerate() {
        let name = column.symbol.trim_end_matches(|c: char| c.is_ascii_digit());
        let positive = match column.term {
            Term::Viscous(_) | Term::Coulomb(_) => true,
            Term::Rigid(_) => ["Ia", "I", "m_in", "m_gr"].contains(&name),
            Term::Offset(_) => false,
        };
        if positive {
            // A rotor that merges with its link and that the robot file does not know belongs to the link.
            let merges = !structure.base.iter().any(|b| b.column == v);
            let unknown = if merges { UNKNOWN_MERGED } else { UNKNOWN_SCALAR };
            let prior = if column.nominal > 0.0 { column.nominal } else { unknown };
            out.push(Cone {
                size: 1,
                parts: vec![(v, DMatrix::from_element(1, 1, 1.0))],
                prior_inverse: DMatrix::from_element(1, 1, 1.0 / prior),
                start: vec![(v, prior)],
            });
        }
    }
    out
}

/// The 4 × 4 pseudo-inertia of a link; `place` holds the columns of Ixx, Ixy, Ixz, Iyy, Iyz, Izz, mx, my, mz, m; `mass` is
/// that of a link that the robot file says nothing of.
fn pseudo_inertia(structure: &Structure, place: &[usize], mass: f64) -> Cone {
    let unit = |entries: &[(usize, usize, f64)]| {
        let mut m = DMatrix::zeros(4, 4);
        for &(i, j, v) in entries {
            m[(i, j)] = v;
            m[(j, i)] = v;
        }
        m
    };
    // Σ = ½ tr(I) 1 − I, h, m.
    let shapes = [
        unit(&[(0, 0, -0.5), (1, 1, 0.5), (2, 2, 0.5)]),
        unit(&[(0, 1, -1.0)]),
        unit(&[(0, 2, -1.0)]),
        unit(&[(0, 0, 0.5), (1, 1, -0.5), (2, 2, 0.5)]),
        unit(&[(1, 2, -1.0)]),
        unit(&[(0, 0, 0.5), (1, 1, 0.5), (2, 2, -0.5)]),
        unit(&[(0, 3, 1.0)]),
        unit(&[(1, 3, 1.0)]),
        unit(&[(2, 3, 1.0)]),
        unit(&[(3, 3, 1.0)]),
    ];
    let nominal: Vec<f64> = place.iter().map(|&c| structure.columns[c].nominal).collect();
    let parts: Vec<(usize, DMatrix<f64>)> = place.iter().copied().zip(shapes).collect();
    let assemble =
        |values: &[f64]| parts.iter().zip(values).fold(DMatrix::zeros(4, 4), |p, ((_, m), v): (_, &f64)| p + m * *v);
    // A link of which the robot file gives mass and centre, but moments that no body has, keeps the former.
    let (mass, [x, y, z]) = if nominal[9] > 0.0 {
        (nominal[9], [nominal[6] / nominal[9], nominal[7] / nominal[9], nominal[8] / nominal[9]])
    } else {
        (mass, [0.0; 3])
    };
    let turning = 2.0 * UNKNOWN_RADIUS * UNKNOWN_RADIUS;
    let moments = [turning + y * y + z * z, -x * y, -x * z, turning + x * x + z * z, -y * z, turning + x * x + y * y];
    let unknown: Vec<f64> = moments.into_iter().chain([x, y, z, 1.0]).map(|v| mass * v).collect();
    // A nominal link with no extent (a point mass, a thin rod) is on the cone's border: it gets a centimetre.
    let mut values = nominal;
    if values[9] > 0.0 {
        let extent = 2e-4 * values[9];
        for i in [0, 3, 5] {
            values[i] += extent;
        }
    }
    let usable = assemble(&values).cholesky().is_some();
    let start_values = if usable { values } else { unknown };
    let p0 = assemble(&start_values);
    Cone {
        size: 4,
        prior_inverse: p0.try_inverse().unwrap_or_else(|| DMatrix::identity(4, 4)),
        start: place.iter().copied().zip(start_values).collect(),
        parts,
    }
}

#[cfg(test)]
mod tests;
