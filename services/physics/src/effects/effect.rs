//! An effect: its description, and how a kernel is made of it.

use super::columns::{Columns, Track};
use super::context::EffectContext;
use super::kernel::Kernel;
use super::specification::{Memory, OwningStage, ParameterSpec, Regime, Robots, Role, Scope, Side};
use super::term::TermState;
use lacuna_interfaces::BadInput;
use lacuna_interfaces::robot::Kind;
use std::collections::BTreeMap;

/// One entry of the catalogue.
#[derive(Debug)]
pub struct Effect {
    /// Catalogue id, the one name in model files, findings and docs.
    pub id: &'static str,
    /// A few words for reports.
    pub title: &'static str,
    /// The torque the drive must add, in symbols.
    pub law: &'static str,
    /// What happens physically, in words, with what must be known to read the numbers right.
    pub words: &'static str,
    /// Literature.
    pub reference: &'static str,
    /// Parameters, amplitudes first.
    pub parameters: &'static [ParameterSpec],
    /// What it acts on.
    pub scope: Scope,
    /// Robots that can have it.
    pub robots: Robots,
    /// What it remembers.
    pub memory: Memory,
    /// Where along the drive train it acts.
    pub side: Side,
    /// Stage of the pipeline it belongs to.
    pub stage: OwningStage,
    /// True if with amplitudes in bounds it never gives power to the robot (at every sample by itself).
    pub dissipative: bool,
    /// Ids that motor-side position and torque cannot tell from it at all.
    pub exact_group: &'static [&'static str],
    /// Ids that ordinary recordings hardly tell from it.
    pub practical_group: &'static [&'static str],
    /// Situations in which it must show.
    pub appears: &'static [Regime],
    /// Situations in which it must not.
    pub vanishes: &'static [Regime],
    /// Makes the kernel; joints and shape parameters are checked before.
    pub(super) build: fn(&Request<'_>) -> Result<Box<dyn Kernel>, BadInput>,
}

/// What a kernel is made from: checked joints and shape parameters.
#[derive(Debug)]
pub struct Request<'a> {
    /// Joints it acts on, 0-based, in the order given. Empty for the structure; all for a drive effect that
    /// names none.
    pub joints: &'a [usize],
    /// The robot.
    pub context: &'a EffectContext<'a>,
    given: &'a BTreeMap<String, f64>,
    shapes: &'a [(&'static str, f64)],
}

impl Request<'_> {
    /// Value of a shape parameter of the effect; NaN for a symbol it does not have.
    pub fn shape(&self, symbol: &str) -> f64 {
        self.shapes.iter().find(|(s, _)| *s == symbol).map_or(f64::NAN, |(_, v)| *v)
    }

    /// Value of a parameter, amplitudes included, if the model gives it.
    pub fn given(&self, symbol: &str) -> Option<f64> {
        self.given.get(symbol).copied()
    }
}

impl Effect {
    /// Amplitudes that exist for a kind of robot, in column order. An effect without any has one column whose
    /// factor is 1.
    pub fn amplitudes(&self, kind: Kind) -> impl Iterator<Item = &'static ParameterSpec> {
        self.parameters.iter().filter(move |p| p.role == Role::Amplitude && p.robots.include(kind))
    }

    /// Shape parameters that exist for a kind of robot.
    pub fn shapes(&self, kind: Kind) -> impl Iterator<Item = &'static ParameterSpec> {
        self.parameters.iter().filter(move |p| p.role == Role::Shape && p.robots.include(kind))
    }

    /// Number of columns for a kind of robot.
    pub fn column_count(&self, kind: Kind) -> usize {
        self.amplitudes(kind).count().max(1)
    }

    /// All ids it may be confused with, exactly or practically.
    pub fn group(&self) -> impl Iterator<Item = &'static str> {
        self.exact_group.iter().chain(self.practical_group).copied()
    }

    /// The kernel for 0-based `joints` with the shape parameters of `parameters` (amplitudes in it are
    /// checked but not used).
    ///
    /// # Errors
    /// [`BadInput`] if the robot cannot have the effect, the joints do not fit its scope, a symbol is unknown
    /// or missing, or a value is out of bounds.
    pub fn kernel(
        &self,
        joints: &[usize],
        parameters: &BTreeMap<String, f64>,
        context: &EffectContext<'_>,
    ) -> Result<Box<dyn Kernel>, BadInput> {
        context.check()?;
        let kind = context.robot.kind;
        if !self.robots.include(kind) {
            let (id, robots) = (self.id, self.robots.as_str());
            return Err(BadInput::new(format!("{id}: the robot is not {robots}; expected one, nothing else has it")));
        }
        let joints = self.check_joints(joints, context.joint_count())?;
        self.check_symbols(parameters, kind)?;
        let mut shapes = Vec::new();
        for spec in self.shapes(kind) {
            shapes.push((spec.symbol, self.value(spec, parameters)?));
        }
        (self.build)(&Request { joints: &joints, context, given: parameters, shapes: &shapes })
            .map_err(|e| BadInput { what: format!("{}: {}", self.id, e.what), ..e })
    }

    /// The effect with all parameters fixed, ready to run.
    ///
    /// # Errors
    /// As [`Effect::kernel`]; also if no amplitude is given at all.
    pub fn term(
        &'static self,
        joints: &[usize],
        parameters: &BTreeMap<String, f64>,
        context: &EffectContext<'_>,
    ) -> Result<TermState, BadInput> {
        let kernel = self.kernel(joints, parameters, context)?;
        let kind = context.robot.kind;
        let mut factors = Vec::new();
        for spec in self.amplitudes(kind) {
            factors.push(self.value(spec, parameters)?);
        }
        let symbols: Vec<&str> = self.amplitudes(kind).map(|s| s.symbol).collect();
        if !symbols.is_empty() && !symbols.iter().any(|s| parameters.contains_key(*s)) {
            let expected = symbols.join(", ");
            return Err(BadInput::new(format!("{}: found no amplitude; expected at least one of {expected}", self.id)));
        }
        if factors.is_empty() {
            factors.push(1.0);
        }
        Ok(TermState::new(self, kernel, factors, context.joint_count()))
    }

    /// The effect's columns along a recording with the shape parameters of `parameters` fixed.
    ///
    /// # Errors
    /// As [`Effect::kernel`]; also if the signals of `track` differ in length.
    pub fn columns(
        &self,
        joints: &[usize],
        parameters: &BTreeMap<String, f64>,
        context: &EffectContext<'_>,
        track: &Track<'_>,
    ) -> Result<Columns, BadInput> {
        let mut kernel = self.kernel(joints, parameters, context)?;
        let symbols = self.amplitudes(context.robot.kind).map(|s| s.symbol).collect();
        Columns::along(kernel.as_mut(), symbols, context.joint_count(), track)
    }

    fn check_joints(&self, joints: &[usize], n: usize) -> Result<Vec<usize>, BadInput> {
        let refuse = |found: String, expected: &str| {
            Err(BadInput::new(format!("{}: joints: found {found}; expected {expected}", self.id)))
        };
        for (k, &j) in joints.iter().enumerate() {
            if j >= n {
                return refuse(format!("number {}", j + 1), &format!("1 to {n}"));
            }
            if joints[..k].contains(&j) {
                return refuse(format!("number {} twice", j + 1), "each joint once");
            }
        }
        match self.scope {
            Scope::Joint if joints.is_empty() => refuse("none".into(), "at least one: it acts on joints"),
            Scope::Pair if joints.len() != 2 => {
                refuse(joints.len().to_string(), "two: the joint that feels it, and the joint whose motor it feels")
            }
            Scope::Structure if !joints.is_empty() && joints.len() != n => {
                refuse(joints.len().to_string(), "none: it acts on the whole structure")
            }
            Scope::Structure => Ok(Vec::new()),
            Scope::Drive if joints.is_empty() => Ok((0..n).collect()),
            Scope::Joint | Scope::Pair | Scope::Drive => Ok(joints.to_vec()),
        }
    }

    fn check_symbols(&self, parameters: &BTreeMap<String, f64>, kind: Kind) -> Result<(), BadInput> {
        for symbol in parameters.keys() {
            if !self.parameters.iter().any(|p| p.symbol == symbol && p.robots.include(kind)) {
                let known: Vec<&str> =
                    self.parameters.iter().filter(|p| p.robots.include(kind)).map(|p| p.symbol).collect();
                return Err(BadInput::new(format!(
                    "{}: found parameter \"{symbol}\"; expected {}",
                    self.id,
                    known.join(", ")
                )));
            }
        }
        // Amplitudes are checked here too, so that a kernel is never made of a file that a term would refuse.
        for spec in self.parameters.iter().filter(|p| parameters.contains_key(p.symbol)) {
            self.value(spec, parameters)?;
        }
        Ok(())
    }

    /// The value given, else the default. A multiple amplitude that is not given is 0.
    fn value(&self, spec: &ParameterSpec, parameters: &BTreeMap<String, f64>) -> Result<f64, BadInput> {
        let (id, symbol, unit) = (self.id, spec.symbol, spec.unit);
        let Some(&v) = parameters.get(symbol) else {
            return spec.default.ok_or_else(|| {
                BadInput::new(format!("{id}: found no {symbol}; expected it in {unit}: {}", spec.meaning))
            });
        };
        if v.is_finite() && (spec.lower..=spec.upper).contains(&v) {
            return Ok(v);
        }
        let (lower, upper) = (spec.lower, spec.upper);
        Err(BadInput::new(format!("{id}: {symbol}: found {v}; expected {lower} to {upper} {unit}")))
    }
}
