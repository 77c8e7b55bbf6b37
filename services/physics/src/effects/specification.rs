//! The words an effect is described with.

use lacuna_interfaces::robot::Kind;

/// What an effect acts on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scope {
    /// Each joint by itself; several joints share the parameters.
    Joint,
    /// Two joints: the first feels the second.
    Pair,
    /// The drives: those named, or all if none is named.
    Drive,
    /// The structure as a whole; no joint is named.
    Structure,
}

impl Scope {
    /// The word in reports and in the docs.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Joint => "joint",
            Self::Pair => "pair",
            Self::Drive => "drive",
            Self::Structure => "structure",
        }
    }
}

/// What the torque depends on besides the motion at this instant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Memory {
    /// Nothing.
    None,
    /// Time since switch-on, or a temperature.
    Slow,
    /// A state that is driven by the motion.
    State,
    /// Times at which something begins and ends.
    Events,
}

impl Memory {
    /// The word in reports and in the docs.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Slow => "slow",
            Self::State => "state",
            Self::Events => "events",
        }
    }
}

/// Where between platform and torque sensor the effect acts; terms run in this order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Side {
    /// At the link or behind it: it loads the gear.
    Link,
    /// In motor and gear.
    Transmission,
    /// In the drive's own account of its torque.
    Drive,
}

/// Stage of the pipeline that an effect belongs to, for findings. (On the stream all terms run in the
/// friction stage, the first that has motion, rigid-body torque and temperature together.)
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OwningStage {
    /// Measurement.
    Source,
    /// Rigid-body torque.
    Torque,
    /// Friction.
    Friction,
    /// Payload and contact.
    Payload,
}

impl OwningStage {
    /// Name of the stage.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Source => "source",
            Self::Torque => "torque",
            Self::Friction => "friction",
            Self::Payload => "payload",
        }
    }
}

/// Robots that an effect or a parameter exists for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Robots {
    /// Every robot.
    Any,
    /// Deltas.
    Delta,
    /// Serial arms.
    Serial,
}

impl Robots {
    /// True if `kind` is among them.
    pub const fn include(self, kind: Kind) -> bool {
        matches!((self, kind), (Self::Any, _) | (Self::Delta, Kind::Delta) | (Self::Serial, Kind::Serial))
    }

    /// The word in the docs.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Any => "any robot",
            Self::Delta => "a Delta",
            Self::Serial => "a serial arm",
        }
    }
}

/// A situation in which an effect shows, or in which it cannot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Regime {
    /// All joints stand still.
    Rest,
    /// Steady sliding at a few hundredths of a radian per second.
    SlowSliding,
    /// Steady sliding at more than one radian per second, long after any reversal.
    FastSliding,
    /// Slow small movements to and fro.
    Reversals,
    /// Quick movements to and fro, with acceleration.
    Shaking,
    /// Sliding while the link asks for no torque.
    SlidingUnloaded,
    /// Sliding long after switch-on, at the reference temperature.
    SlidingWarm,
    /// The drive's torque is far below its rating.
    LowTorque,
    /// All joints stand still and nothing weighs anything.
    WeightlessRest,
    /// The structure has no mass.
    Massless,
    /// Outside the times of the event.
    OutsideEvent,
}

impl Regime {
    /// In words, for the docs.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Rest => "at rest",
            Self::SlowSliding => "slow steady sliding",
            Self::FastSliding => "fast steady sliding",
            Self::Reversals => "slow reversals",
            Self::Shaking => "quick movements to and fro",
            Self::SlidingUnloaded => "sliding without load",
            Self::SlidingWarm => "sliding when warm",
            Self::LowTorque => "torques far below the rating",
            Self::WeightlessRest => "at rest without gravity",
            Self::Massless => "a structure without mass",
            Self::OutsideEvent => "outside the event",
        }
    }
}

/// Role of a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// The torque is linear in it: it is the factor of a column.
    Amplitude,
    /// Anything else: it shapes the columns and is searched on a grid, then refined.
    Shape,
}

/// One parameter of an effect.
#[derive(Debug, Clone, Copy)]
pub struct ParameterSpec {
    /// Symbol, the key in a model file.
    pub symbol: &'static str,
    /// SI unit; Nm stands for the robot file's torque unit (and for N at prismatic joints).
    pub unit: &'static str,
    /// What it is, in words.
    pub meaning: &'static str,
    /// Factor of a column, or shape.
    pub role: Role,
    /// Physical bounds: a value outside is refused.
    pub lower: f64,
    /// Upper bound.
    pub upper: f64,
    /// Value if a model file does not give it; `None`: it must be given.
    pub default: Option<f64>,
    /// A size as seen on industrial robots.
    pub typical: f64,
    /// Where a search starts (shape parameters that are searched).
    pub grid: &'static [f64],
    /// Robots it exists for.
    pub robots: Robots,
}

impl ParameterSpec {
    /// An amplitude that a model file must give.
    pub const fn amplitude(
        symbol: &'static str,
        unit: &'static str,
        meaning: &'static str,
        bounds: (f64, f64),
        typical: f64,
    ) -> Self {
        Self {
            symbol,
            unit,
            meaning,
            role: Role::Amplitude,
            lower: bounds.0,
            upper: bounds.1,
            default: None,
            typical,
            grid: &[],
            robots: Robots::Any,
        }
    }

    /// A shape parameter that a model file must give.
    pub const fn shape(
        symbol: &'static str,
        unit: &'static str,
        meaning: &'static str,
        bounds: (f64, f64),
        typical: f64,
    ) -> Self {
        let amplitude = Self::amplitude(symbol, unit, meaning, bounds, typical);
        Self { role: Role::Shape, ..amplitude }
    }

    /// The same with a value for files that do not give it.
    #[must_use]
    pub const fn or(self, default: f64) -> Self {
        Self { default: Some(default), ..self }
    }

    /// The same with the values a search starts from.
    #[must_use]
    pub const fn searched(self, grid: &'static [f64]) -> Self {
        Self { grid, ..self }
    }

    /// The same for some robots only.
    #[must_use]
    pub const fn only(self, robots: Robots) -> Self {
        Self { robots, ..self }
    }
}

/// An amplitude of either sign and any size.
pub const ANY: (f64, f64) = (-1e9, 1e9);
/// An amplitude that cannot be negative.
pub const NOT_NEGATIVE: (f64, f64) = (0.0, 1e9);
/// A time on the recording's clock.
pub const ANY_TIME: (f64, f64) = (f64::NEG_INFINITY, f64::INFINITY);
