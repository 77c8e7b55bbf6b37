//! Friction of one joint: a level that opposes motion (it may hold a joint still), smooth drag, and bristles
//! with a state.
//!
//! The level is a pair of bounds; the time step finds the torque within them (sticking) or at one of them
//! (sliding), so that Coulomb friction is exact: no smoothed sign, no artificial creep.

/// Low-speed excess that fades with speed: (f_s − f_c) exp(−(θ̇/v_s)²).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stribeck {
    /// f_s − f_c [Nm].
    pub excess: f64,
    /// v_s [rad/s].
    pub speed: f64,
}

/// a |θ̇|^p.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Power {
    /// a [Nm (s/rad)^p].
    pub coefficient: f64,
    /// p.
    pub exponent: f64,
}

/// Friction that follows the load: μ |τ_link| sgn θ̇ + μ_v |τ_link| θ̇.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoadFriction {
    /// μ.
    pub coulomb: f64,
    /// μ_v [s/rad].
    pub viscous: f64,
}

/// Excess viscous friction of a cold drive: b exp(−t/τ_w) θ̇.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thermal {
    /// b [Nm s/rad].
    pub excess: f64,
    /// τ_w [s].
    pub time_constant: f64,
}

/// A dent: the level is raised by height · exp(−((θ − at)/width)²).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dent {
    /// Place [rad].
    pub at: f64,
    /// Width [rad].
    pub width: f64,
    /// Height [Nm].
    pub height: f64,
}

/// Rubbing that comes and goes: on while the phase of a slow cycle is below `duty`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rubbing {
    /// Added level [Nm].
    pub level: f64,
    /// Cycle [s].
    pub period: f64,
    /// Share of the cycle in which it rubs.
    pub duty: f64,
    /// Start of the cycle [s].
    pub phase: f64,
}

/// Eddy-current brake: 2 T v v_c / (v² + v_c²).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Eddy {
    /// Peak torque T [Nm].
    pub peak: f64,
    /// Speed of the peak v_c [rad/s].
    pub speed: f64,
}

/// How a bristle bends before the contact slides.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Bristle {
    /// Dahl, order 1: ds/dθ = (1 − s sgn θ̇)/δ, stepped exactly.
    Dahl {
        /// δ [rad].
        travel: f64,
    },
    /// LuGre, z the bend over its limit: δ ż = θ̇ − |θ̇| z, torque level · z + f_1 ż.
    LuGre {
        /// δ [rad].
        travel: f64,
        /// f_1 [Nm s].
        damping: f64,
    },
    /// Maxwell slip: [`SLIPS`] springs of equal share that slip at growing travel up to 2 δ.
    Maxwell {
        /// δ, the mean travel at which they slip [rad].
        travel: f64,
    },
}

/// Elements of a Maxwell-slip bristle.
pub const SLIPS: usize = 4;

/// State of a bristle: deflection over its limit, −1 to 1.
pub type BristleState = [f64; SLIPS];

impl Bristle {
    /// State after the joint moved by `dx` [rad].
    pub fn moved(&self, state: &BristleState, dx: f64) -> BristleState {
        let mut next = *state;
        match *self {
            Self::Dahl { travel } | Self::LuGre { travel, .. } => {
                let side = dx.signum();
                next[0] = side - (side - state[0]) * (-dx.abs() / travel).exp();
            }
            Self::Maxwell { travel } => {
                for (i, s) in next.iter_mut().enumerate() {
                    let slip = travel * 2.0 * (i + 1) as f64 / (SLIPS + 1) as f64;
                    *s = (*s + dx / slip).clamp(-1.0, 1.0);
                }
            }
        }
        next
    }

    /// Torque for a friction level `level` [Nm] at speed `v`.
    pub fn torque(&self, state: &BristleState, level: f64, v: f64) -> f64 {
        match *self {
            Self::Dahl { .. } => level * state[0],
            Self::LuGre { travel, damping } => level * state[0] + damping * (v - v.abs() * state[0]) / travel,
            Self::Maxwell { .. } => level * state.iter().sum::<f64>() / SLIPS as f64,
        }
    }
}

/// A bristle of its own limit beside the joint's friction: a dressed cable's hysteresis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hysteresis {
    /// Limit [Nm].
    pub limit: f64,
    /// Law and travel.
    pub bristle: Bristle,
}

/// All friction of one joint, at the motor's side of a compliant transmission.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct JointFriction {
    /// Coulomb level in positive motion [Nm].
    pub coulomb_positive: f64,
    /// Coulomb level in negative motion [Nm].
    pub coulomb_negative: f64,
    /// f_v [Nm s/rad].
    pub viscous: f64,
    /// Low-speed excess.
    pub stribeck: Vec<Stribeck>,
    /// Power laws.
    pub power: Vec<Power>,
    /// Load dependence.
    pub load: Vec<LoadFriction>,
    /// Warm-up of the viscous part.
    pub thermal: Vec<Thermal>,
    /// Dents.
    pub dent: Vec<Dent>,
    /// Intermittent rubbing.
    pub rubbing: Vec<Rubbing>,
    /// Eddy-current brakes.
    pub eddy: Vec<Eddy>,
    /// If there, the level acts through this bristle instead of rigidly.
    pub presliding: Option<Bristle>,
    /// Further bristles.
    pub hysteresis: Vec<Hysteresis>,
}

/// Where a joint is, for its friction.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Contact {
    /// Angle [rad].
    pub q: f64,
    /// Speed [rad/s].
    pub v: f64,
    /// Torque that the transmission passes on to the link [Nm].
    pub load: f64,
    /// Time since the drives were switched on cold [s].
    pub warm_s: f64,
}

impl JointFriction {
    /// Coulomb and viscous friction.
    pub fn base(coulomb: f64, viscous: f64) -> Self {
        Self { coulomb_positive: coulomb, coulomb_negative: coulomb, viscous, ..Self::default() }
    }

    /// The levels [Nm] that oppose positive and negative motion; never negative.
    pub fn levels(&self, at: &Contact) -> (f64, f64) {
        let speed = at.v.abs();
        let mut common = 0.0;
        for s in &self.stribeck {
            common += s.excess * (-(speed / s.speed).powi(2)).exp();
        }
        // Below order 1 a power law is infinitely steep at standstill: it belongs to what can stick.
        for p in self.power.iter().filter(|p| p.exponent < 1.0) {
            common += p.coefficient * speed.powf(p.exponent);
        }
        for l in &self.load {
            common += l.coulomb * at.load.abs();
        }
        for d in &self.dent {
            common += d.height * (-((at.q - d.at) / d.width).powi(2)).exp();
        }
        for r in &self.rubbing {
            if ((at.warm_s - r.phase) / r.period).rem_euclid(1.0) < r.duty {
                common += r.level;
            }
        }
        ((self.coulomb_positive + common).max(0.0), (self.coulomb_negative + common).max(0.0))
    }

    /// Smooth drag [Nm] in the sense of the speed.
    pub fn drag(&self, at: &Contact) -> f64 {
        let mut viscous = self.viscous;
        for t in &self.thermal {
            viscous += t.excess * (-at.warm_s / t.time_constant).exp();
        }
        for l in &self.load {
            viscous += l.viscous * at.load.abs();
        }
        let mut drag = viscous * at.v;
        for p in self.power.iter().filter(|p| p.exponent >= 1.0) {
            drag += p.coefficient * at.v.abs().powf(p.exponent) * at.v.signum();
        }
        for e in &self.eddy {
            drag += 2.0 * e.peak * at.v * e.speed / (at.v * at.v + e.speed * e.speed);
        }
        drag
    }
}
