//! Friction as a spring before it slides: Dahl, with LuGre's micro-damping.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | z | bend of the contact, −1 to 1 | 1 |
//! | δ | movement over which it builds up (f / δ is the contact's stiffness) | rad |
//! | s_m | direction of the movement since the sample before | 1 |
//!
//! Dahl's dz/dθ = (1 − z s) / δ has between two samples the exact solution z ← s_m − (s_m − z) e^(−|Δθ|/δ):
//! it depends on the path alone, not on the sampling.

use crate::effects::kernel::{ColumnSink, EffectSample, Kernel};
use crate::effects::specification::NOT_NEGATIVE;
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};
use lacuna_interfaces::MAX_JOINTS;

pub(super) static EFFECT: Effect = Effect {
    id: "presliding",
    title: "Friction that builds up over a distance",
    law: "f (z − s) + f_1 ż, with δ ż = θ̇ − abs(θ̇) z",
    words: "After a reversal the contact bends before it slides: friction follows a hysteresis loop over the \
            distance δ instead of jumping. The term takes the place of the jump, f s of the Coulomb level becoming \
            f z; with f = f_c all of it does. f_1 is LuGre's micro-damping. Several terms of different δ make a \
            Maxwell-slip model. In steady sliding z = s, and the term vanishes.",
    reference: "Dahl 1968, Aerospace Corp. TOR-0158; Canudas de Wit, Olsson, Åström, Lischinsky 1995, IEEE Trans. \
                Automatic Control 40, 419-425",
    parameters: &[
        ParameterSpec::amplitude("f", "Nm", "level that builds up gradually", NOT_NEGATIVE, 2.0).or(0.0),
        ParameterSpec::amplitude("f_1", "Nm s", "micro-damping", NOT_NEGATIVE, 0.002).or(0.0),
        ParameterSpec::shape("delta", "rad", "distance δ", (1e-6, 1.0), 0.01)
            .searched(&[0.002, 0.004, 0.008, 0.016, 0.032, 0.08]),
    ],
    scope: Scope::Joint,
    robots: Robots::Any,
    memory: Memory::State,
    side: Side::Transmission,
    stage: OwningStage::Friction,
    dissipative: false,
    exact_group: &[],
    practical_group: &["backlash"],
    appears: &[Regime::Reversals],
    vanishes: &[Regime::FastSliding, Regime::Rest],
    build: |request| {
        let joints = request.joints.iter().copied().filter(|&j| j < MAX_JOINTS).collect();
        Ok(Box::new(Presliding { joints, delta: request.shape("delta"), contact: [Contact::default(); MAX_JOINTS] }))
    },
};

#[derive(Debug, Clone, Copy, Default)]
struct Contact {
    z: f64,
    last_q: Option<f64>,
}

#[derive(Debug)]
struct Presliding {
    joints: Vec<usize>,
    delta: f64,
    contact: [Contact; MAX_JOINTS],
}

impl Kernel for Presliding {
    fn reset(&mut self) {
        self.contact = [Contact::default(); MAX_JOINTS];
    }

    fn columns(&mut self, sample: &EffectSample<'_>, sink: &mut ColumnSink<'_>) {
        for &j in &self.joints {
            let contact = &mut self.contact[j];
            let (q, qd) = (sample.q_rad[j], sample.qd_rad_s[j]);
            if !q.is_finite() {
                *contact = Contact::default();
                continue;
            }
            let moved = q - contact.last_q.unwrap_or(q);
            if moved != 0.0 {
                let to = moved.signum();
                contact.z = to - (to - contact.z) * (-moved.abs() / self.delta).exp();
            }
            contact.last_q = Some(q);
            sink.set(0, j, contact.z - sample.direction[j]);
            sink.set(1, j, (qd - qd.abs() * contact.z) / self.delta);
        }
    }
}
