//! What a model consists of: base columns and terms.

use crate::scene::{Column, Raw};
use crate::tolerance::DELAY;
use std::sync::Arc;

/// A column that is always in the model.
#[derive(Debug, Clone)]
pub struct BaseColumn {
    /// What it is.
    pub role: BaseRole,
    /// At the full rate.
    pub raw: Raw,
    /// At the rows.
    pub column: Column,
    /// Prior precision of its coefficient about 0 (0: none).
    pub precision: f64,
}

/// Role of a base column.
#[derive(Debug, Clone, PartialEq)]
pub enum BaseRole {
    /// f_v of a joint.
    Viscous(usize),
    /// f_c of a joint.
    Coulomb(usize),
    /// Inertia of a joint's rotor (only where the link's torque is measured).
    Rotor(usize),
    /// Lag of a joint's torque sensor [s].
    SensorLag(usize),
    /// Constant torque of a joint (only where the base is fitted freely).
    Offset(usize),
    /// A dynamic parameter of the robot, by symbol (only where the base is fitted freely).
    Parameter(String),
    /// A tolerance of the robot file: in units of its limit.
    Tolerance(String),
}

impl BaseRole {
    /// Whether its torque goes through the link, past the rotor's friction.
    pub fn on_link(&self) -> bool {
        match self {
            Self::Parameter(_) => true,
            Self::Tolerance(name) => name != DELAY,
            _ => false,
        }
    }

    /// Where its coefficient must be held: tolerances at ± `limit`, friction that would drive at 0.
    pub fn held_at(&self, value: f64, limit: f64) -> Option<f64> {
        match self {
            Self::Tolerance(_) if value.abs() > limit => Some(value.signum()),
            Self::Viscous(_) | Self::Coulomb(_) if value < 0.0 => Some(0.0),
            _ => None,
        }
    }
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
    /// Acts in full, without an amplitude that is fitted.
    pub fixed: bool,
    /// Amplitudes that its columns hold already, if it was fitted once and then held.
    pub amplitude: Vec<f64>,
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
    pub base: Arc<[BaseColumn]>,
    /// Columns that sit at their limit: base index and value.
    pub clamped: Vec<(usize, f64)>,
    /// Terms.
    pub atoms: Vec<Atom>,
}

impl Model {
    /// A base without terms.
    pub fn new(base: &[BaseColumn]) -> Self {
        Self { base: base.into(), clamped: Vec::new(), atoms: Vec::new() }
    }

    /// Without some of its terms.
    #[must_use]
    pub fn without(&self, gone: &[usize]) -> Self {
        let stays = self.atoms.iter().enumerate().filter(|(i, _)| !gone.contains(i));
        Self {
            base: Arc::clone(&self.base),
            clamped: self.clamped.clone(),
            atoms: stays.map(|(_, a)| a.clone()).collect(),
        }
    }

    /// Holds the base columns whose coefficients left their limits; false if all are within.
    pub fn clamp(&mut self, beta: &[f64]) -> bool {
        let free = self.free_base();
        let over = free.iter().zip(beta).filter_map(|(i, b)| self.base[*i].role.held_at(*b, 1.0).map(|v| (*i, v)));
        let over: Vec<(usize, f64)> = over.collect();
        self.clamped.extend(&over);
        self.clamped.sort_by_key(|(i, _)| *i);
        !over.is_empty()
    }

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

    /// Index and coefficient of every base column, held ones included.
    pub fn base_values<'a>(&'a self, beta: &'a [f64]) -> impl Iterator<Item = (usize, f64)> + 'a {
        let free = self.free_base().into_iter().zip(beta.iter().copied());
        free.chain(self.clamped.iter().copied())
    }

    /// Where the coefficients of atom `index` are.
    pub fn slots(&self, index: usize) -> std::ops::Range<usize> {
        let start = self.base.len() - self.clamped.len() + self.atoms[..index].iter().map(Atom::width).sum::<usize>();
        start..start + self.atoms[index].width()
    }
}
