//! Torque recorded late against position.
//!
//! τ(t − D) comes from the cubic through the four predicted torques nearest to t − D that are not in the
//! future; a negative D (position late against torque) extrapolates the same cubic.

use crate::effects::kernel::{ColumnSink, EffectSample, Kernel};
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};
use lacuna_interfaces::{Joints, MAX_JOINTS};

/// Samples kept: 50 ms at 5 kHz.
const KEPT: usize = 256;
/// Points of the interpolation.
const POINTS: usize = 4;

pub(super) static EFFECT: Effect = Effect {
    id: "torque_delay",
    title: "Delay of the torque signal",
    law: "τ(t − D) − τ(t), close to −D dτ/dt",
    words: "The drive's torque signal comes late against the encoder's position, often by less than a sample. An \
            advance of the position is the same. Taken from the predicted torque. A soft joint looks alike far \
            below its resonance.",
    reference: "Björklund, Ljung 2003, CDC, 2502-2507",
    parameters: &[ParameterSpec::shape("D", "s", "delay; negative: the position is late", (-0.005, 0.05), 0.002)
        .searched(&[-0.001, -0.0005, 0.0005, 0.001, 0.002, 0.004])],
    scope: Scope::Drive,
    robots: Robots::Any,
    memory: Memory::State,
    side: Side::Drive,
    stage: OwningStage::Source,
    dissipative: false,
    exact_group: &[],
    practical_group: &["elasticity"],
    appears: &[Regime::Shaking],
    vanishes: &[Regime::Rest],
    build: |request| {
        let joints = request.joints.iter().copied().filter(|&j| j < MAX_JOINTS).collect();
        let line = vec![(0.0, [0.0; MAX_JOINTS]); KEPT];
        Ok(Box::new(DelayLine { joints, delay_s: request.shape("D"), line, newest: 0, count: 0, clock_s: 0.0 }))
    },
};

#[derive(Debug)]
struct DelayLine {
    joints: Vec<usize>,
    delay_s: f64,
    /// Ring of times since the reset [s] and predicted torques.
    line: Vec<(f64, Joints)>,
    newest: usize,
    count: usize,
    clock_s: f64,
}

impl DelayLine {
    /// The sample `age` samples ago.
    fn back(&self, age: usize) -> &(f64, Joints) {
        &self.line[(self.newest + KEPT - age % KEPT) % KEPT]
    }

    /// Age of the newest of the interpolation's points: one point after the target if there is one, the rest
    /// before.
    fn first_point(&self, target: f64, points: usize) -> usize {
        let (mut low, mut high) = (0, self.count - 1);
        while low < high {
            let middle = usize::midpoint(low, high);
            if self.back(middle).0 <= target { high = middle } else { low = middle + 1 }
        }
        low.saturating_sub(points / 2).min(self.count - points)
    }
}

impl Kernel for DelayLine {
    fn reset(&mut self) {
        (self.count, self.clock_s) = (0, 0.0);
    }

    fn columns(&mut self, sample: &EffectSample<'_>, sink: &mut ColumnSink<'_>) {
        // A time that does not go on replaces the sample before.
        let repeated = self.count > 0 && !(sample.dt_s > 0.0 && sample.dt_s.is_finite());
        if !repeated {
            self.clock_s += if self.count > 0 { sample.dt_s } else { 0.0 };
            self.newest = (self.newest + 1) % KEPT;
            self.count = (self.count + 1).min(KEPT);
        }
        self.line[self.newest] = (self.clock_s, *sample.tau_drive_nm);
        let points = self.count.min(POINTS);
        // Before the first sample the torque is taken as it was then.
        let target = (self.clock_s - self.delay_s).max(self.back(self.count - 1).0);
        let first = self.first_point(target, points);
        let mut weights = [0.0; POINTS];
        for i in 0..points {
            let t_i = self.back(first + i).0;
            weights[i] = (0..points).filter(|&k| k != i).fold(1.0, |w, k| {
                let t_k = self.back(first + k).0;
                w * (target - t_k) / (t_i - t_k)
            });
        }
        for &j in &self.joints {
            let late: f64 = (0..points).map(|i| weights[i] * self.back(first + i).1[j]).sum();
            sink.set(0, j, late - sample.tau_drive_nm[j]);
        }
    }
}
