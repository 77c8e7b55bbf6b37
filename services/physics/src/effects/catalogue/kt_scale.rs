//! A torque constant that is not what the drive believes.

use crate::effects::kernel::joint_law;
use crate::effects::{Effect, Memory, OwningStage, ParameterSpec, Regime, Robots, Scope, Side};

pub(super) static EFFECT: Effect = Effect {
    id: "kt_scale",
    title: "Torque constant of one joint",
    law: "g τ",
    words: "The drive reports (1 + g) times its torque: g = 1/κ − 1 for a true constant κ times the nominal one. \
            Taken from the predicted torque, so that noise stays out. All joints with the same g are the same as \
            all masses and frictions scaled; one joint by itself shows through the structure it shares with the \
            others.",
    reference: "Gautier, Briot 2014, J. Dyn. Syst. Meas. Control 136, 051025",
    parameters: &[ParameterSpec::amplitude("g", "1", "reported over true torque minus 1", (-0.95, 1e3), 0.08)],
    scope: Scope::Joint,
    robots: Robots::Any,
    memory: Memory::None,
    side: Side::Drive,
    stage: OwningStage::Source,
    dissipative: false,
    exact_group: &[],
    practical_group: &[],
    appears: &[Regime::Shaking],
    vanishes: &[Regime::SlidingUnloaded],
    build: |request| Ok(joint_law(request.joints, |s, j| [s.tau_drive_nm[j]])),
};
