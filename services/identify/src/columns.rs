//! The columns of the torque model: rigid-body parameters π, then f_v, f_c and offset of every joint.
//!
//! ```text
//! τ_j = Σ Y_jk(q, q̇, q̈) π_k + f_v,j q̇_j + f_c,j sgn q̇_j + o_j
//! ```

use lacuna_interfaces::BadInput;
use lacuna_physics::{Motion, RigidBody, Unreachable};
use serde::Serialize;

/// What a column multiplies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Term {
    /// Entry of π, by its index.
    Rigid(usize),
    /// Viscous friction of a joint.
    Viscous(usize),
    /// Coulomb friction of a joint.
    Coulomb(usize),
    /// Constant offset of a joint.
    Offset(usize),
}

/// One column.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    /// What it multiplies.
    pub term: Term,
    /// Symbol: the physics crate's for π, else `f_v1`, `f_c1`, `o1`.
    pub symbol: String,
    /// SI unit of the parameter.
    pub unit: String,
    /// Value that follows from the robot file; 0 for friction.
    pub nominal: f64,
    /// What it is, in words.
    pub meaning: String,
}

/// Which part of the torque is modelled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Signal {
    /// The torque columns: rigid body and friction.
    #[default]
    Motor,
    /// Torque columns minus the robot file's `columns.link_torque`: friction and rotor inertia alone, the link's
    /// mechanics having been measured.
    MotorMinusLink,
}

/// All columns of a robot, in the order in which they are admitted to the base: friction first, because its names
/// should survive; then per link the inertias and moments that usually remain, and last those that usually merge.
pub fn columns(body: &dyn RigidBody, signal: Signal, torque_unit: &str) -> Vec<Column> {
    let n = body.joint_count();
    let mut out = Vec::with_capacity(3 * n + body.parameters().len());
    for j in 0..n {
        for (term, name, unit, meaning) in [
            (Term::Coulomb(j), "f_c", torque_unit.to_owned(), "Coulomb friction"),
            (Term::Viscous(j), "f_v", format!("{torque_unit} s/rad"), "viscous friction"),
            (Term::Offset(j), "o", torque_unit.to_owned(), "constant offset"),
        ] {
            let (symbol, meaning) = (format!("{name}{}", j + 1), format!("joint {}: {meaning}", j + 1));
            out.push(Column { term, symbol, unit, nominal: 0.0, meaning });
        }
    }
    let mut rigid: Vec<(usize, usize)> = body
        .parameters()
        .iter()
        .enumerate()
        .filter(|(_, p)| signal == Signal::Motor || p.symbol.starts_with("Ia"))
        .map(|(k, p)| (k, place(&p.symbol)))
        .collect();
    // Links from the base outwards; a Delta keeps its own order, having no such prefixes.
    rigid.sort_by_key(|&(k, place)| {
        let link = if body.as_serial().is_some() { body.parameters()[k].joint.unwrap_or(0) } else { 0 };
        (link, place, k)
    });
    out.extend(rigid.into_iter().map(|(k, _)| {
        let p = &body.parameters()[k];
        // In a unit other than Nm a parameter is its SI value times the signal's unit per Nm.
        let unit = if torque_unit == "Nm" { p.unit.to_owned() } else { format!("{} {torque_unit}/Nm", p.unit) };
        Column { term: Term::Rigid(k), symbol: p.symbol.clone(), unit, nominal: p.nominal, meaning: p.meaning.clone() }
    }));
    out
}

/// Order of a serial link's parameters in the base.
fn place(symbol: &str) -> usize {
    const ORDER: [&str; 11] = ["Izz", "mx", "my", "Ixx", "Ixy", "Ixz", "Iyz", "Ia", "Iyy", "mz", "m"];
    let name = symbol.trim_end_matches(|c: char| c.is_ascii_digit());
    ORDER.iter().position(|o| *o == name).unwrap_or(ORDER.len())
}

/// Motion of all joints at one sample, with the sign of every velocity.
#[derive(Debug, Clone, Copy)]
pub struct Sample<'a> {
    /// Positions, velocities and accelerations.
    pub motion: Motion<'a>,
    /// Sign of the velocity, −1 to 1.
    pub sign: &'a [f64],
}

/// Evaluates columns of one robot without allocating.
#[derive(Debug)]
pub struct Evaluator<'a> {
    body: &'a dyn RigidBody,
    columns: &'a [Column],
    regressor: Vec<f64>,
    rigid: bool,
}

impl<'a> Evaluator<'a> {
    /// For the given columns of `body`.
    pub fn new(body: &'a dyn RigidBody, columns: &'a [Column]) -> Self {
        let rigid = columns.iter().any(|c| matches!(c.term, Term::Rigid(_)));
        Self { body, columns, regressor: vec![0.0; body.joint_count() * body.parameters().len()], rigid }
    }

    /// Computes the regressor of π at a sample.
    ///
    /// # Errors
    /// [`Unreachable`] where the robot has no torque.
    pub fn at(&mut self, sample: &Sample<'_>) -> Result<(), Unreachable> {
        if self.rigid { self.body.regressor(&sample.motion, &mut self.regressor) } else { Ok(()) }
    }

    /// Entry of joint `joint` and column `column` at the sample given last.
    pub fn entry(&self, sample: &Sample<'_>, joint: usize, column: usize) -> f64 {
        let own = |j: usize, v: f64| if j == joint { v } else { 0.0 };
        match self.columns[column].term {
            Term::Rigid(k) => self.regressor[joint * self.body.parameters().len() + k],
            Term::Viscous(j) => own(j, sample.motion.qd_rad_s[joint]),
            Term::Coulomb(j) => own(j, sample.sign[joint]),
            Term::Offset(j) => own(j, 1.0),
        }
    }
}

/// The error of a recording whose pose the robot cannot take.
pub(crate) fn unreachable(time_s: f64, error: Unreachable) -> BadInput {
    BadInput::new(format!(
        "t = {time_s:.4} s: {error}; expected poses that the robot file's geometry allows, in radians"
    ))
}
