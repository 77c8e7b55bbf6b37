//! Effects that a simulated robot can truly have, written into the plant as physics: a Stribeck effect is a
//! level in the joint's contact, elasticity is a spring with a rotor before it, a rod is a body. None of this
//! knows the estimator's regressors.
//!
//! Ids and units are those of the diagnosis catalogue; effects of class [`Class::Unknown`] are in no catalogue.
//! One entry of [`REGISTRY`] per effect: parameters, how strengths are drawn, and how the plant gets it.

mod drive;
mod friction;
mod structure;
mod tip;
mod unknown;

use crate::plant::TrueRobot;
use crate::plant::robot::TipEvent;
use crate::random::Random;
use crate::reference::MotionLimits;
use lacuna_interfaces::robot::Kind;
use lacuna_interfaces::{BadInput, Joints, RobotFile};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// An effect with its strength.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrueEffect {
    /// Effect id.
    pub id: String,
    /// Joints by name; empty for effects of the structure, and for joint effects on all joints.
    #[serde(default)]
    pub joints: Vec<String>,
    /// Parameters by symbol, SI units.
    #[serde(default)]
    pub params: BTreeMap<String, f64>,
}

impl TrueEffect {
    /// An effect from literals, for tests and demos.
    pub fn new(id: &str, joints: &[&str], params: &[(&str, f64)]) -> Self {
        Self {
            id: id.to_owned(),
            joints: joints.iter().map(|j| (*j).to_owned()).collect(),
            params: params.iter().map(|(k, v)| ((*k).to_owned(), *v)).collect(),
        }
    }
}

/// Whether a diagnosis can be expected to name the effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Class {
    /// In the catalogue.
    Catalogue,
    /// In no catalogue: the right answer is "unknown".
    Unknown,
}

/// What an effect acts on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scope {
    /// Each of its joints alone.
    Joint,
    /// Two joints, in the order given.
    Pair,
    /// The whole robot.
    Structure,
}

/// A parameter of an effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// Symbol.
    pub symbol: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// Value where the configuration gives none; NaN: it must be given.
    pub default: f64,
    /// Lowest allowed value.
    pub low: f64,
    /// Highest allowed value.
    pub high: f64,
}

/// Shorthand for the registry's tables.
const fn parameter(symbol: &'static str, unit: &'static str, default: f64, low: f64, high: f64) -> Parameter {
    Parameter { symbol, unit, default, low, high }
}

/// A parameter that must be given.
const MUST: f64 = f64::NAN;

/// One effect of the registry.
pub struct Effect {
    /// Id.
    pub id: &'static str,
    /// Catalogue or unknown.
    pub class: Class,
    /// Ids that are as good an answer: the signals cannot tell them apart.
    pub also_accept: &'static [&'static str],
    /// What it acts on.
    pub scope: Scope,
    /// The kind of robot it needs, if not any.
    pub kind: Option<Kind>,
    /// The law in words.
    pub law: &'static str,
    /// Parameters.
    pub parameters: &'static [Parameter],
    /// Draws a strength for joint `i` (the first joint of a pair).
    draw: fn(&mut Random, &Scales, usize) -> Params,
    /// Writes it into the plant.
    apply: fn(&Values<'_>, &mut World<'_>) -> Result<(), BadInput>,
}

/// Parameters by symbol.
pub type Params = BTreeMap<String, f64>;

fn params(list: &[(&str, f64)]) -> Params {
    list.iter().map(|(k, v)| ((*k).to_owned(), *v)).collect()
}

/// Sizes that make a strength mean the same on a small and on a large robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Scales {
    /// Typical torque in motion [Nm].
    pub torque: Joints,
    /// Joint-space inertia, rotor included [kg m²].
    pub inertia: Joints,
    /// Rotor inertia [kg m²].
    pub rotor: Joints,
    /// Motion limits.
    pub limits: MotionLimits,
    /// Gear ratios.
    pub gear: Joints,
    /// Largest distance of the tip from the base [m] (Delta: the upper arm's length).
    pub reach: f64,
    /// A Delta's point mass at either end of a forearm, m2 [kg]; 0 for chains.
    pub forearm_point: f64,
}

impl Scales {
    /// Scales of a robot: at mid-range, torque of gravity and of 0.3 times the acceleration limit.
    ///
    /// # Errors
    /// [`BadInput`] if mid-range is not reachable or a joint has no inertia.
    pub fn of(robot: &RobotFile, nominal: &TrueRobot) -> Result<Self, BadInput> {
        let limits = MotionLimits::of(robot);
        let n = nominal.joints.len();
        let mut scales = Self {
            torque: Joints::default(),
            inertia: Joints::default(),
            rotor: Joints::default(),
            gear: Joints::default(),
            reach: 0.0,
            forearm_point: robot.mass.as_ref().map_or(0.0, |m| m.forearm_point),
            limits,
        };
        let mut q = Joints::default();
        for i in 0..n {
            q[i] = 0.5 * (limits.q_min[i] + limits.q_max[i]);
            scales.rotor[i] = nominal.joints[i].rotor;
            scales.gear[i] = nominal.joints[i].gear;
        }
        let (inertia, _) = nominal.inertia(&q)?;
        (0..n).for_each(|i| scales.inertia[i] = inertia[i][i]);
        let still = Joints::default();
        let loads = nominal.loads(0.0, &[]);
        let mut d = crate::plant::Dynamics::default();
        nominal.mechanism.dynamics(&q, &still, &loads, &mut d).map_err(|_| {
            BadInput::new("limits: mid-range is outside the workspace; expected limits around reachable poses")
        })?;
        for i in 0..n {
            scales.torque[i] = 0.5 * d.bias[i].abs() + 0.3 * scales.inertia[i] * limits.qdd_max[i];
        }
        scales.reach = match &nominal.mechanism {
            crate::plant::Mechanism::Delta(delta) => delta.arm[0].length,
            crate::plant::Mechanism::Serial(_) => d.tip.norm().max(0.1),
        };
        Ok(scales)
    }
}

/// Parameters of one effect, checked and completed.
struct Values<'a> {
    effect: &'a Effect,
    given: &'a Params,
    joints: Vec<usize>,
}

impl Values<'_> {
    fn get(&self, symbol: &str) -> f64 {
        debug_assert!(self.effect.parameters.iter().any(|p| p.symbol == symbol), "{}: {symbol}", self.effect.id);
        let default = || self.effect.parameters.iter().find(|p| p.symbol == symbol).map_or(0.0, |p| p.default);
        self.given.get(symbol).copied().unwrap_or_else(default)
    }
}

/// What effects may change.
struct World<'a> {
    truth: &'a mut TrueRobot,
    /// Per trajectory: what happens at the tip.
    events: &'a mut [Vec<TipEvent>],
    /// Per trajectory: duration [s] and times between which an object is carried.
    plans: &'a [(f64, Vec<(f64, f64)>)],
    scales: &'a Scales,
    random: Random,
}

/// Every effect.
pub fn registry() -> impl Iterator<Item = &'static Effect> {
    [friction::EFFECTS, drive::EFFECTS, structure::EFFECTS, tip::EFFECTS, unknown::EFFECTS].into_iter().flatten()
}

/// The effect with this id.
///
/// # Errors
/// [`BadInput`] naming the known ids.
pub fn find(id: &str) -> Result<&'static Effect, BadInput> {
    registry().find(|e| e.id == id).ok_or_else(|| {
        let known: Vec<&str> = registry().map(|e| e.id).collect();
        BadInput::new(format!("effect: found \"{id}\"; expected one of {}", known.join(", ")))
    })
}

/// Draws an effect of random strength; `severity` 1 is a usual strength, below is harder to see.
///
/// # Errors
/// [`BadInput`] if the id is unknown or the effect does not exist on this kind of robot.
pub fn draw_effect(
    id: &str,
    robot: &RobotFile,
    scales: &Scales,
    severity: f64,
    random: &mut Random,
) -> Result<TrueEffect, BadInput> {
    let effect = find(id)?;
    check_kind(effect, robot)?;
    let n = robot.joint_count();
    let name = |i: usize| robot.joints.get(i).cloned().unwrap_or_default();
    let (first, joints) = match effect.scope {
        Scope::Structure => (0, Vec::new()),
        Scope::Joint => {
            let i = random.index(n);
            (i, vec![name(i)])
        }
        Scope::Pair => {
            if n < 2 {
                return Err(BadInput::new(format!(
                    "effect \"{id}\": found a robot of one joint; expected two or more"
                )));
            }
            let i = random.index(n - 1);
            (i, vec![name(i), name(i + 1)])
        }
    };
    let mut params = (effect.draw)(random, scales, first);
    let grows = |p: &&Parameter| STRENGTHS.contains(&p.symbol) || (id == "encoder_offset" && p.symbol == "q_0");
    for p in effect.parameters.iter().filter(grows) {
        if let Some(v) = params.get_mut(p.symbol) {
            *v = (*v * severity).clamp(p.low, p.high);
        }
    }
    Ok(TrueEffect { id: id.to_owned(), joints, params })
}

/// Symbols that grow with severity; all others are shapes and places.
const STRENGTHS: &[&str] = &[
    "a_c",
    "f_sc",
    "a",
    "mu",
    "mu_v",
    "b",
    "tau_0",
    "a_s",
    "a_s2",
    "a_c2",
    "J",
    "I",
    "m_1",
    "m_2",
    "m",
    "m_x",
    "m_y",
    "m_z",
    "k_1",
    "k_3",
    "F",
    "height",
    "level",
    "peak",
    "limit",
    "amplitude",
    "tilt_1",
    "tilt_2",
    "dl",
    "dl_2",
    "D",
    "g",
    "c",
    "f_c",
    "f_v",
];

fn check_kind(effect: &Effect, robot: &RobotFile) -> Result<(), BadInput> {
    match effect.kind {
        Some(kind) if kind != robot.kind => Err(BadInput::new(format!(
            "effect \"{}\": found a robot of kind {:?}; expected {kind:?}",
            effect.id, robot.kind
        ))),
        _ => Ok(()),
    }
}

/// Where effects are written to.
#[derive(Debug)]
pub struct Target<'a> {
    /// The true robot.
    pub truth: &'a mut TrueRobot,
    /// Per trajectory: what happens at the tip.
    pub events: &'a mut [Vec<TipEvent>],
    /// Per trajectory: duration [s] and times between which an object is carried.
    pub plans: &'a [(f64, Vec<(f64, f64)>)],
}

/// Writes effects into the true robot and its tip events, all but number `left_out`. What an effect draws
/// depends on `seed` and its place in the list alone, so leaving one out does not change another.
///
/// # Errors
/// [`BadInput`] for an unknown id, joint or parameter, a missing or out-of-range value, or an effect that this
/// robot cannot have.
pub fn apply(
    effects: &[TrueEffect],
    robot: &RobotFile,
    scales: &Scales,
    target: Target<'_>,
    seed: u64,
    left_out: Option<usize>,
) -> Result<(), BadInput> {
    let Target { truth, events, plans } = target;
    let mut world = World { truth, events, plans, scales, random: Random::new(seed, 0) };
    for (k, given) in effects.iter().enumerate() {
        let place = |e: BadInput| BadInput { what: format!("effect[{k}]: {}", e.what), ..e };
        let effect = find(&given.id).map_err(place)?;
        check_kind(effect, robot).map_err(place)?;
        let joints = joints_of(effect, given, robot).map_err(place)?;
        check_parameters(effect, given).map_err(place)?;
        if left_out == Some(k) {
            continue;
        }
        world.random = Random::new(seed, STREAM + k as u64);
        (effect.apply)(&Values { effect, given: &given.params, joints }, &mut world).map_err(place)?;
    }
    Ok(())
}

/// First random stream of effects.
const STREAM: u64 = 1 << 22;

fn joints_of(effect: &Effect, given: &TrueEffect, robot: &RobotFile) -> Result<Vec<usize>, BadInput> {
    let mut joints = Vec::new();
    for name in &given.joints {
        let i = robot.joints.iter().position(|j| j == name).ok_or_else(|| {
            BadInput::new(format!("{}: found joint \"{name}\"; expected one of {}", effect.id, robot.joints.join(", ")))
        })?;
        if joints.contains(&i) {
            return Err(BadInput::new(format!("{}: joint \"{name}\" is given twice", effect.id)));
        }
        joints.push(i);
    }
    match effect.scope {
        Scope::Joint if joints.is_empty() => Ok((0..robot.joint_count()).collect()),
        Scope::Pair if joints.len() != 2 => {
            Err(BadInput::new(format!("{}: found {} joints; expected two", effect.id, joints.len())))
        }
        Scope::Structure if !joints.is_empty() => {
            Err(BadInput::new(format!("{}: found joints; expected none, it acts on the whole robot", effect.id)))
        }
        _ => Ok(joints),
    }
}

fn check_parameters(effect: &Effect, given: &TrueEffect) -> Result<(), BadInput> {
    for (symbol, &v) in &given.params {
        let Some(p) = effect.parameters.iter().find(|p| p.symbol == symbol) else {
            let known: Vec<&str> = effect.parameters.iter().map(|p| p.symbol).collect();
            return Err(BadInput::new(format!(
                "{}: found parameter \"{symbol}\"; expected {}",
                effect.id,
                known.join(", ")
            )));
        };
        if !(v >= p.low && v <= p.high) {
            return Err(BadInput::new(format!(
                "{}: found {symbol} = {v}; expected {} to {} {}",
                effect.id, p.low, p.high, p.unit
            )));
        }
    }
    match effect.parameters.iter().find(|p| p.default.is_nan() && !given.params.contains_key(p.symbol)) {
        Some(p) => Err(BadInput::new(format!("{}: found no \"{}\"; expected it in {}", effect.id, p.symbol, p.unit))),
        None => Ok(()),
    }
}
