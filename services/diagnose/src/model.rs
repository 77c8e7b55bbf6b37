//! What a model consists of: base columns and terms.

use crate::scene::{Column, Raw};

/// A column that is always in the model.
#[derive(Debug, Clone)]
pub struct BaseColumn {
    /// What it is.
    pub role: BaseRole,
    /// At the full rate.
    pub raw: Raw,
    /// At the rows.
    pub column: Column,
}

/// Role of a base column.
#[derive(Debug, Clone, PartialEq)]
pub enum BaseRole {
    /// f_v of a joint.
    Viscous(usize),
    /// f_c of a joint.
    Coulomb(usize),
    /// Constant torque of a joint (only where the base is fitted freely).
    Offset(usize),
    /// A dynamic parameter of the robot, by symbol (only where the base is fitted freely).
    Parameter(String),
    /// A tolerance of the robot file: in units of its limit.
    Tolerance(String),
}

/// A term that was taken into the model.
#[derive(Debug, Clone)]
pub struct Atom {
    /// Index into the registry.
    pub family: usize,
    /// Joint it acts on; 0 for the structure.
    pub joint: usize,
    /// Shape parameters.
    pub shape: Vec<f64>,
    /// Columns at the full rate.
    pub raws: Vec<Raw>,
    /// Columns at the rows.
    pub columns: Vec<Column>,
    /// Acts in full, without an amplitude.
    pub fixed: bool,
    /// Times in which it acts, if it comes and goes: from, to since switch-on [s].
    pub carries: Vec<(f64, f64)>,
}

impl Atom {
    /// Number of fitted amplitudes.
    pub fn width(&self) -> usize {
        if self.fixed { 0 } else { self.columns.len() }
    }
}

/// Base and terms.
#[derive(Debug, Clone)]
pub struct Model {
    /// Always there.
    pub base: Vec<BaseColumn>,
    /// Tolerances that sit at their limit: base index and value.
    pub clamped: Vec<(usize, f64)>,
    /// Terms.
    pub atoms: Vec<Atom>,
}

impl Model {
    /// Base columns that are free.
    pub fn free_base(&self) -> Vec<usize> {
        (0..self.base.len()).filter(|i| !self.clamped.iter().any(|(c, _)| c == i)).collect()
    }

    /// Columns in the order of the coefficients.
    pub fn columns(&self) -> Vec<&Column> {
        let mut out: Vec<&Column> = self.free_base().into_iter().map(|i| &self.base[i].column).collect();
        out.extend(self.atoms.iter().filter(|a| !a.fixed).flat_map(|a| &a.columns));
        out
    }

    /// Columns with all tolerances free.
    pub fn all_columns(&self) -> Vec<&Column> {
        let mut out: Vec<&Column> = self.base.iter().map(|b| &b.column).collect();
        out.extend(self.atoms.iter().filter(|a| !a.fixed).flat_map(|a| &a.columns));
        out
    }

    /// Where the coefficients of atom `index` are.
    pub fn slots(&self, index: usize) -> std::ops::Range<usize> {
        let start = self.base.len() - self.clamped.len() + self.atoms[..index].iter().map(Atom::width).sum::<usize>();
        start..start + self.atoms[index].width()
    }
}
