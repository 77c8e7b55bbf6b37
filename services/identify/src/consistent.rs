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
//! file's link, or where it has none a link of 1 kg and 0.1 m. As μ → 0 the determined part converges to the
//! constrained least-squares fit, within μ times the number of constraint dimensions.
//!
//! A general cone solver would bring BLAS and LAPACK along for 4 × 4 matrices (that is what clarabel's semidefinite
//! cones need); eighty variables and one log det per link do not.

use crate::base::Structure;
use crate::columns::Term;
use crate::fit::Solution;
use lacuna_interfaces::BadInput;
use lacuna_physics::RigidBody;
use nalgebra::{DMatrix, DVector};

/// μ at the end. In units of the weighted squared residual, whose minimum is about the number of rows.
const MU_END: f64 = 1e-3;
/// Factor by which μ falls from step to step.
const MU_STEP: f64 = 0.1;
/// Newton steps per μ.
const NEWTON_STEPS: usize = 60;

/// A symmetric matrix that must stay positive definite: constant-free and linear in the variables.
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
}

/// Fits with every link physically possible.
///
/// # Errors
/// [`BadInput`] if the iteration does not settle.
pub fn fit(body: &dyn RigidBody, structure: &Structure, solution: &Solution) -> Result<Consistent, BadInput> {
    let total = &solution.normal;
    let (a, c) = (total.xtx(), total.xty());
    let variables = structure.columns.len();
    let mut k = DMatrix::zeros(structure.base.len(), variables);
    for (b, base) in structure.base.iter().enumerate() {
        k[(b, base.column)] = 1.0;
        for &(column, factor) in &base.merged {
            k[(b, column)] = factor;
        }
    }
    // In π: ½ πᵀ H π − gᵀ π.
    let h = k.transpose() * &a * &k;
    let g = k.transpose() * &c;
    let cones = cones(body, structure);
    let mut x = DVector::zeros(variables);
    for cone in &cones {
        cone.start.iter().for_each(|&(v, value)| x[v] = value);
    }
    let mut mu = (0.5 * x.dot(&(&h * &x)) - g.dot(&x)).abs().max(1.0);
    loop {
        newton(&h, &g, &cones, mu, &mut x)?;
        if mu <= MU_END {
            break;
        }
        mu = (mu * MU_STEP).max(MU_END);
    }
    let beta = &k * &x;
    let misfit = |beta: &DVector<f64>| total.residual_sum(beta);
    Ok(Consistent {
        free: misfit(&solution.beta),
        constrained: misfit(&beta),
        beta,
        values: x.iter().copied().collect(),
    })
}

/// Minimises the objective at one μ, from a feasible start.
fn newton(h: &DMatrix<f64>, g: &DVector<f64>, cones: &[Cone], mu: f64, x: &mut DVector<f64>) -> Result<(), BadInput> {
    for _ in 0..NEWTON_STEPS {
        let mut gradient = h * &*x - g;
        let mut hessian = h.clone();
        for cone in cones {
            let p = cone.at(x);
            let inverse = p.try_inverse().ok_or_else(|| failed("a pseudo-inertia became singular"))?;
            let products: Vec<DMatrix<f64>> = cone.parts.iter().map(|(_, m)| &inverse * m).collect();
            for (i, (v, m)) in cone.parts.iter().enumerate() {
                gradient[*v] += mu * (cone.prior_inverse.component_mul(m).sum() - products[i].trace());
                for (j, (w, _)) in cone.parts.iter().enumerate() {
                    // ∂²(−log det P) = tr(P⁻¹ M_i P⁻¹ M_j)
                    hessian[(*v, *w)] += mu * products[i].component_mul(&products[j].transpose()).sum();
                }
            }
        }
        let step = scaled_solve(&hessian, &gradient).ok_or_else(|| failed("the Newton system is singular"))?;
        let decrement = gradient.dot(&step);
        if decrement.is_nan() {
            return Err(failed("the objective is not finite"));
        }
        if decrement <= 1e-9 * mu {
            return Ok(());
        }
        let now = objective(h, g, cones, mu, x).ok_or_else(|| failed("the start is not feasible"))?;
        let mut length = 1.0;
        let mut moved = false;
        while length > 1e-12 {
            let next = &*x - &step * length;
            if objective(h, g, cones, mu, &next).is_some_and(|v| v <= now - 1e-4 * length * decrement) {
                *x = next;
                moved = true;
                break;
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

/// The objective; `None` outside the cones.
fn objective(h: &DMatrix<f64>, g: &DVector<f64>, cones: &[Cone], mu: f64, x: &DVector<f64>) -> Option<f64> {
    let mut value = 0.5 * x.dot(&(h * x)) - g.dot(x);
    for cone in cones {
        let p = cone.at(x);
        let trace = cone.prior_inverse.component_mul(&p).sum();
        let chol = p.cholesky()?;
        let log_det = 2.0 * chol.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
        value += mu * (trace - log_det);
    }
    value.is_finite().then_some(value)
}

fn failed(why: &str) -> BadInput {
    BadInput::new(format!(
        "physically consistent fit: {why}; expected a solvable problem (check the robot file's masses)"
    ))
}

/// Mass [kg] and radius of gyration [m] of a link that the robot file says nothing of.
const UNKNOWN_LINK: (f64, f64) = (1.0, 0.1);
/// A rotor inertia or friction coefficient that nothing is known of.
const UNKNOWN_SCALAR: f64 = 0.1;

fn cones(body: &dyn RigidBody, structure: &Structure) -> Vec<Cone> {
    let find = |symbol: &str| structure.columns.iter().position(|c| c.symbol == symbol);
    let mut out = Vec::new();
    if body.as_serial().is_some() {
        for link in 1..=body.joint_count() {
            let names = ["Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz", "mx", "my", "mz", "m"];
            let found: Option<Vec<usize>> = names.iter().map(|n| find(&format!("{n}{link}"))).collect();
            if let Some(place) = found {
                out.push(pseudo_inertia(structure, &place));
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
            let prior = if column.nominal > 0.0 { column.nominal } else { UNKNOWN_SCALAR };
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

/// The 4 × 4 pseudo-inertia of a link; `place` holds the columns of Ixx, Ixy, Ixz, Iyy, Iyz, Izz, mx, my, mz, m.
fn pseudo_inertia(structure: &Structure, place: &[usize]) -> Cone {
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
    let (mass, radius) = UNKNOWN_LINK;
    let turning = 2.0 * mass * radius * radius;
    let unknown = [turning, 0.0, 0.0, turning, 0.0, turning, 0.0, 0.0, 0.0, mass];
    // A nominal link with no extent (a point mass, a thin rod) is on the cone's border: it gets a centimetre.
    let mut values = nominal;
    if values[9] > 0.0 {
        let extent = 2e-4 * values[9];
        for i in [0, 3, 5] {
            values[i] += extent;
        }
    }
    let usable = assemble(&values).cholesky().is_some();
    let start_values = if usable { values } else { unknown.to_vec() };
    let p0 = assemble(&start_values);
    Cone {
        size: 4,
        prior_inverse: p0.try_inverse().unwrap_or_else(|| DMatrix::identity(4, 4)),
        start: place.iter().copied().zip(start_values).collect(),
        parts,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scalar_problem_by_hand() {
        // ½ a x² − c x with x > 0 and c < 0: the free minimum is negative, the constrained one at the border.
        let cone = |prior: f64| Cone {
            size: 1,
            parts: vec![(0, DMatrix::from_element(1, 1, 1.0))],
            prior_inverse: DMatrix::from_element(1, 1, 1.0 / prior),
            start: vec![(0, prior)],
        };
        let (h, g) = (DMatrix::from_element(1, 1, 4.0), DVector::from_element(1, -2.0));
        let mut x = DVector::from_element(1, 1.0);
        let mu = 1e-3;
        newton(&h, &g, &[cone(1.0)], mu, &mut x).unwrap();
        // 4 x + 2 + μ (1 − 1/x) = 0
        let root = (-(2.0 + mu) + f64::sqrt((2.0 + mu) * (2.0 + mu) + 16.0 * mu)) / 8.0;
        assert!((x[0] / root - 1.0).abs() < 1e-4, "{} {root}", x[0]);
        let g = DVector::from_element(1, 2.0);
        newton(&h, &g, &[cone(1.0)], 1e-9, &mut x).unwrap();
        assert!((x[0] - 0.5).abs() < 1e-6, "inside, the free minimum c/a");
    }
}
