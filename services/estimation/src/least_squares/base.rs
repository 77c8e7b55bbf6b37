//! Which columns of a regressor the data tell apart (Gautier 1991: base inertial parameters by QR).

use crate::error::{EstimationError, all_finite};
use nalgebra::DMatrix;

/// In which order columns are admitted to the base.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pivoting {
    /// Always the column with the largest share independent of those admitted: the best-conditioned base.
    Largest,
    /// In the order given, skipping dependent ones: the base prefers the first columns, so that a user's
    /// favourite parameters keep their names.
    InOrder,
}

/// A column that is a combination of the base.
#[derive(Debug, Clone, PartialEq)]
pub struct Dependent {
    /// Its index.
    pub column: usize,
    /// (base column, factor): X_column = Σ factor · X_base, entries below 1e-9 of the column's length left
    /// out. The base parameter absorbs factor times this column's parameter.
    pub combination: Vec<(usize, f64)>,
}

/// The minimal identifiable set.
#[derive(Debug, Clone, PartialEq)]
pub struct BaseParameters {
    /// Columns of the base, in the order they were admitted.
    pub independent: Vec<usize>,
    /// Columns that merge into the base.
    pub dependent: Vec<Dependent>,
    /// Columns that are zero: the data do not excite them at all.
    pub zero: Vec<usize>,
    /// Condition number of the base columns, scaled to unit length.
    pub condition: f64,
}

impl BaseParameters {
    /// Number of independent columns.
    pub fn rank(&self) -> usize {
        self.independent.len()
    }
}

/// Finds the minimal identifiable set of the columns of `x`: rows × p, or the triangular factor of it
/// ([`super::Tsqr::regressor_factor`]), which has the same column dependences.
///
/// A column is dependent if the part of it outside the span of those admitted is below `tolerance` of its
/// length. The tolerance is about digits ([`super::RANK_TOLERANCE`]); what the noise hides is a matter of the
/// covariance.
///
/// # Errors
/// [`EstimationError`] for a value that is not finite or a tolerance outside 0 to 1.
pub fn base_parameters(
    x: &DMatrix<f64>,
    tolerance: f64,
    pivoting: Pivoting,
) -> Result<BaseParameters, EstimationError> {
    all_finite("regressor", x.as_slice())?;
    if !(tolerance > 0.0 && tolerance < 1.0) {
        return Err(EstimationError::Setting { what: "tolerance", found: tolerance, expected: "above 0, below 1" });
    }
    // A tall matrix has the dependences of its R, which is small.
    let mut columns = if x.nrows() > x.ncols() { x.clone().qr().r() } else { x.clone() };
    let p = columns.ncols();
    let scale: Vec<f64> = (0..p).map(|j| columns.column(j).norm()).collect();
    let top = scale.iter().copied().fold(0.0, f64::max);
    let is_zero = |j: usize| scale[j] <= 1e-14 * top || scale[j] == 0.0;
    let zero: Vec<usize> = (0..p).filter(|&j| is_zero(j)).collect();
    let mut open: Vec<usize> = (0..p).filter(|&j| !is_zero(j)).collect();
    for &j in &open {
        columns.column_mut(j).scale_mut(1.0 / scale[j]);
    }
    let original = columns.clone();
    let mut independent: Vec<usize> = Vec::new();
    while let Some(place) = next_column(&columns, &open, tolerance, pivoting) {
        let j = open.remove(place);
        independent.push(j);
        project_out(&mut columns, &original, &independent, &open);
    }
    let base = original.select_columns(&independent);
    let condition = condition_of(&base);
    let dependent = combinations(&original, &base, &independent, &open, &scale);
    Ok(BaseParameters { independent, dependent, zero, condition })
}

/// Place in `open` of the column to admit next, if any is independent.
fn next_column(columns: &DMatrix<f64>, open: &[usize], tolerance: f64, pivoting: Pivoting) -> Option<usize> {
    let left = |place: &usize| columns.column(open[*place]).norm();
    let mut candidates = (0..open.len()).filter(|place| left(place) > tolerance);
    match pivoting {
        Pivoting::InOrder => candidates.next(),
        Pivoting::Largest => {
            let mut best: Option<usize> = None;
            for place in candidates {
                // Strictly larger, so that equal columns are admitted in their order.
                if best.is_none_or(|b| left(&place) > left(&b) * (1.0 + 1e-12)) {
                    best = Some(place);
                }
            }
            best
        }
    }
}

/// Removes the newest base column's direction from the open columns; twice, so that the rest stays orthogonal to rounding.
fn project_out(columns: &mut DMatrix<f64>, original: &DMatrix<f64>, independent: &[usize], open: &[usize]) {
    let Some((&newest, earlier)) = independent.split_last() else { return };
    // Orthonormal directions of the base are kept in place of its columns.
    let mut direction = original.column(newest).into_owned();
    for _ in 0..2 {
        for &e in earlier {
            let share = columns.column(e).dot(&direction);
            direction.axpy(-share, &columns.column(e), 1.0);
        }
    }
    let length = direction.norm();
    direction.scale_mut(1.0 / length);
    columns.set_column(newest, &direction);
    for _ in 0..2 {
        for &j in open {
            let share = direction.dot(&columns.column(j));
            columns.column_mut(j).axpy(-share, &direction, 1.0);
        }
    }
}

fn condition_of(base: &DMatrix<f64>) -> f64 {
    if base.ncols() == 0 {
        return f64::NAN;
    }
    let singular = base.singular_values();
    singular.max() / singular.min()
}

fn combinations(
    original: &DMatrix<f64>,
    base: &DMatrix<f64>,
    independent: &[usize],
    open: &[usize],
    scale: &[f64],
) -> Vec<Dependent> {
    if independent.is_empty() {
        return Vec::new();
    }
    let qr = base.clone().qr();
    let (q, r) = (qr.q(), qr.r());
    open.iter()
        .map(|&j| {
            let mut z = q.transpose() * original.column(j);
            let solved = r.solve_upper_triangular_mut(&mut z);
            let combination = independent
                .iter()
                .zip(z.iter())
                .filter(|(_, share)| solved && share.abs() > 1e-9)
                .map(|(&b, share)| (b, share * scale[j] / scale[b]))
                .collect();
            Dependent { column: j, combination }
        })
        .collect()
}
