//! A payload beside the axis of a wrist that turns.
//!
//! In a serial arm the wrist is a joint: the columns are first moments of the last link. A Delta's wrist is
//! no joint of the model; at a steady rate ω it swings the mass round and the platform must hold
//! −ω² (m_x, m_y) turned by ω t.

use super::arm_inertia::along;
use crate::effects::context::Mechanics;
use crate::effects::kernel::{ColumnSink, EffectSample, Kernel, law};
use crate::effects::specification::{ANY, ANY_TIME};
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Request, Robots, Scope, Side};
use lacuna_interfaces::BadInput;
use lacuna_interfaces::robot::Kind;
use std::ops::Range;

pub(super) static EFFECT: Effect = Effect {
    id: "payload_ecc",
    title: "Off-axis payload on a turning wrist",
    law: "m_x ∂τ/∂m_x + m_y ∂τ/∂m_y + m_z ∂τ/∂m_z from t_on to t_off; Delta: −ω² Jᵀ R(ω t) (m_x, m_y, 0)",
    words: "The payload's centre of mass is off the wrist's axis. Its moments (mass times distance, in the frame of \
            the last link) act on a serial arm in any motion that turns it. On a Delta only the force of the mass \
            swung round by the wrist's own motor at rate ω reaches the drives; while the wrist stands, the offset \
            cannot be seen at all.",
    reference: "Khalil, Gautier, Lemoine 2007, ICRA, 4943-4948",
    parameters: &[
        ParameterSpec::amplitude("m_x", "kg m", "mass times distance along x (Delta: at t = 0)", ANY, 0.1).or(0.0),
        ParameterSpec::amplitude("m_y", "kg m", "mass times distance along y (Delta: at t = 0)", ANY, 0.05).or(0.0),
        ParameterSpec::amplitude("m_z", "kg m", "mass times distance along z", ANY, 0.05).or(0.0).only(Robots::Serial),
        ParameterSpec::shape("omega", "rad/s", "rate ω of the wrist", (-200.0, 200.0), 12.0)
            .searched(&[-24.0, -12.0, -6.0, -3.0, 3.0, 6.0, 12.0, 24.0])
            .only(Robots::Delta),
        ParameterSpec::shape("t_on", "s", "time of the pick on the recording's clock", ANY_TIME, 0.0)
            .or(f64::NEG_INFINITY),
        ParameterSpec::shape("t_off", "s", "time of the place on the recording's clock", ANY_TIME, 10.0)
            .or(f64::INFINITY),
    ],
    scope: Scope::Structure,
    robots: Robots::Any,
    memory: Memory::Events,
    side: Side::Link,
    stage: OwningStage::Payload,
    dissipative: false,
    exact_group: &[],
    practical_group: &["payload"],
    appears: &[Regime::Shaking],
    vanishes: &[Regime::OutsideEvent],
    build,
};

fn build(request: &Request<'_>) -> Result<Box<dyn Kernel>, BadInput> {
    let context = request.context;
    let carried = request.shape("t_on")..request.shape("t_off");
    match context.robot.kind {
        Kind::Delta => {
            let (mechanics, omega) = (context.mechanics(), request.shape("omega"));
            Ok(law(move |s, sink| {
                if carried.contains(&s.t_s) {
                    swung(&mechanics, omega, s, sink);
                }
            }))
        }
        Kind::Serial => {
            let last = context.joint_count().saturating_sub(1);
            let directions = ["mx", "my", "mz"].map(|symbol| {
                let mut direction = vec![0.0; context.pi.len()];
                if let Some(slot) = context.index_of(symbol, last).and_then(|k| direction.get_mut(k)) {
                    *slot = 1.0;
                }
                direction
            });
            Ok(Box::new(During { carried, inner: along(context, directions.to_vec()) }))
        }
    }
}

/// Columns of a mass that the wrist swings round at a steady rate.
fn swung(mechanics: &Mechanics, omega: f64, s: &EffectSample<'_>, sink: &mut ColumnSink<'_>) {
    let (sin, cos) = (omega * s.t_s).sin_cos();
    let w2 = omega * omega;
    for (c, pull) in [[w2 * cos, w2 * sin, 0.0], [-w2 * sin, w2 * cos, 0.0]].into_iter().enumerate() {
        // The mass pulls outwards on the platform.
        if let Some(tau) = mechanics.external_force(s.q_rad, pull) {
            sink.set_all(c, &tau);
        }
    }
}

/// A kernel that is at work for a time only.
struct During {
    carried: Range<f64>,
    inner: Box<dyn Kernel>,
}

impl Kernel for During {
    fn reset(&mut self) {
        self.inner.reset();
    }

    fn columns(&mut self, sample: &EffectSample<'_>, sink: &mut ColumnSink<'_>) {
        if self.carried.contains(&sample.t_s) {
            self.inner.columns(sample, sink);
        }
    }
}
