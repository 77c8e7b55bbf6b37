//! sgn θ̇ at and near standstill: one decision for all dry friction of a joint.

/// How the direction of sliding is made from the motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DirectionLaw {
    /// sgn θ̇, 0 at θ̇ = 0. For samples known to slide.
    Sign,
    /// clip(θ̇ / width): a straight line through standstill. Quick, but wrong while a joint sticks.
    Ramp {
        /// Speed at which the direction is complete [rad/s].
        width_rad_s: f64,
    },
    /// clip(z + κ θ̇) with ż = θ̇ / δ kept within ±1: a bristle that bends over δ before it slides, and
    /// keeps its bend at standstill.
    Bristle {
        /// Movement from straight to sliding δ [rad].
        width_rad: f64,
        /// Share of the velocity κ [s/rad].
        kappa_s_rad: f64,
    },
}

/// Direction of sliding of one joint.
#[derive(Debug, Clone, Copy)]
pub struct Direction {
    law: DirectionLaw,
    /// Bend of the bristle, −1 to 1.
    bend: f64,
    last_q: Option<f64>,
}

impl Direction {
    /// At rest, with a straight bristle.
    pub fn new(law: DirectionLaw) -> Self {
        Self { law, bend: 0.0, last_q: None }
    }

    /// Forgets the bend.
    pub fn reset(&mut self) {
        *self = Self::new(self.law);
    }

    /// Direction in [−1, 1] at position `q_rad` and velocity `qd_rad_s`.
    pub fn step(&mut self, q_rad: f64, qd_rad_s: f64) -> f64 {
        let out = match self.law {
            DirectionLaw::Sign if qd_rad_s == 0.0 => 0.0,
            DirectionLaw::Sign => qd_rad_s.signum(),
            DirectionLaw::Ramp { width_rad_s } => ramp(qd_rad_s, width_rad_s),
            DirectionLaw::Bristle { width_rad, kappa_s_rad } => {
                let moved = q_rad - self.last_q.unwrap_or(q_rad);
                self.last_q = Some(q_rad);
                self.bend = clip(self.bend + ramp_raw(moved, width_rad));
                clip(self.bend + kappa_s_rad * qd_rad_s)
            }
        };
        if out.is_nan() { 0.0 } else { out }
    }
}

/// The nearest number in [−1, 1]; 0 for NaN.
fn clip(x: f64) -> f64 {
    if x.is_nan() { 0.0 } else { x.clamp(-1.0, 1.0) }
}

fn ramp_raw(x: f64, width: f64) -> f64 {
    if width > 0.0 { x / width } else { x.signum() * f64::from(x != 0.0) }
}

/// x / width within ±1; the sign of x for a width of zero.
#[inline]
pub(super) fn ramp(x: f64, width: f64) -> f64 {
    clip(ramp_raw(x, width))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bristle_keeps_its_bend_and_saturates() {
        let mut d = Direction::new(DirectionLaw::Bristle { width_rad: 0.01, kappa_s_rad: 0.0 });
        assert_eq!(d.step(0.0, 1.0), 0.0);
        assert!((d.step(0.004, 1.0) - 0.4).abs() < 1e-12);
        assert!((d.step(0.004, 0.0) - 0.4).abs() < 1e-12, "a joint that stopped keeps its torque");
        assert_eq!(d.step(1.0, 1.0), 1.0);
        assert!((d.step(0.99, -1.0) - 0.0).abs() < 1e-12, "back by one width: straight again");
        d.reset();
        assert_eq!(d.step(5.0, 0.0), 0.0);
    }

    #[test]
    fn all_laws_agree_when_sliding_and_survive_nonsense() {
        let laws = [
            DirectionLaw::Sign,
            DirectionLaw::Ramp { width_rad_s: 0.02 },
            DirectionLaw::Bristle { width_rad: 0.002, kappa_s_rad: 0.1 },
        ];
        for law in laws {
            let mut d = Direction::new(law);
            for (from, sign) in [(0.0, 1.0), (1.0, -1.0)] {
                for k in 0..100 {
                    d.step(from + sign * 0.01 * f64::from(k), sign);
                }
                assert_eq!(d.step(from + sign, sign), sign, "{law:?}");
            }
            for bad in [f64::NAN, f64::INFINITY, -f64::INFINITY] {
                let v = d.step(bad, bad);
                assert!((-1.0..=1.0).contains(&v), "{law:?} {v}");
            }
            d.reset();
            assert_eq!(d.step(0.0, 0.0), 0.0);
        }
    }
}
