//! Inertia and first moment of one arm that differ from the model.
//!
//! The columns are torques of unit changes in π. A Delta has them by name (`I`, `gc`, `gs`). In a serial arm
//! they belong to the joint's axis a, seen from its link: inertia a aᵀ and first moments along two directions
//! across a, with everything they do at the joints before.

use crate::effects::kernel::{Kernel, law};
use crate::effects::specification::ANY;
use crate::effects::{Effect, EffectContext, Memory, OwningStage, ParameterSpec, Regime, Request, Robots, Scope, Side};
use crate::{Motion, Vec3};
use lacuna_interfaces::robot::Kind;
use lacuna_interfaces::{BadInput, MAX_JOINTS};

pub(super) static EFFECT: Effect = Effect {
    id: "arm_inertia",
    title: "Arm inertia and centre of mass",
    law: "I ∂τ/∂I + m_1 ∂τ/∂m_1 + m_2 ∂τ/∂m_2; on an axis fixed to the base I θ̈ + m_1 g cos θ + m_2 g sin θ up to signs",
    words: "The moving arm is heavier, longer or shaped otherwise than the model has it: added inertia about the \
            joint's axis and first moments (mass times distance) along and across the arm. Negative values take \
            away. On an axis fixed to the base, inertia is the same as the rotor's, and the moments are the same \
            as a sine and a cosine spring.",
    reference: "Gautier, Khalil 1990, IEEE Trans. Robotics and Automation 6, 368-373",
    parameters: &[
        ParameterSpec::amplitude("I", "kg m^2", "added inertia about the axis", ANY, 0.03).or(0.0),
        ParameterSpec::amplitude("m_1", "kg m", "added first moment along the arm (Delta: gc)", ANY, 0.1).or(0.0),
        ParameterSpec::amplitude("m_2", "kg m", "added first moment across the arm (Delta: gs)", ANY, 0.05).or(0.0),
    ],
    scope: Scope::Joint,
    robots: Robots::Any,
    memory: Memory::None,
    side: Side::Link,
    stage: OwningStage::Torque,
    dissipative: false,
    exact_group: &["rotor_inertia", "gravity_spring"],
    practical_group: &["base_tilt", "torque_offset", "link_length"],
    appears: &[Regime::Shaking],
    vanishes: &[Regime::WeightlessRest],
    build,
};

fn build(request: &Request<'_>) -> Result<Box<dyn Kernel>, BadInput> {
    let context = request.context;
    let mut directions = vec![vec![0.0; context.pi.len()]; 3];
    for &j in request.joints {
        let weights = match context.robot.kind {
            Kind::Delta => ["I", "gc", "gs"].map(|s| vec![(s, 1.0)]),
            Kind::Serial => serial_directions(context, j)?,
        };
        for (direction, entries) in directions.iter_mut().zip(weights) {
            for (symbol, weight) in entries {
                if let Some(slot) = context.index_of(symbol, j).and_then(|k| direction.get_mut(k)) {
                    *slot += weight;
                }
            }
        }
    }
    Ok(along(context, directions))
}

/// The kernel whose columns are the torques of fixed changes in π.
pub(super) fn along(context: &EffectContext<'_>, directions: Vec<Vec<f64>>) -> Box<dyn Kernel> {
    let mechanics = context.mechanics();
    law(move |s, sink| {
        for (c, direction) in directions.iter().enumerate() {
            if let Some(tau) = mechanics.torque(s.q_rad, s.qd_rad_s, s.qdd_rad_s2, direction) {
                sink.set_all(c, &tau);
            }
        }
    })
}

/// Inertia about the axis and first moments across it, as weights of the link's parameters.
///
/// The frame's origin need not be on the axis, where a first moment would bring inertia about the axis with
/// it: that part is taken out.
fn serial_directions(context: &EffectContext<'_>, j: usize) -> Result<[Vec<(&'static str, f64)>; 3], BadInput> {
    if context.is_prismatic(j) {
        return Err(BadInput::new(format!("joint {} slides; expected one that turns", j + 1)));
    }
    let own = own_inertia(context, j);
    let a = axis(&own).ok_or_else(|| BadInput::new(format!("joint {}: found no axis; expected one", j + 1)))?;
    // The coordinate direction least along the axis, made perpendicular to it.
    let e = [Vec3::x(), Vec3::y(), Vec3::z()][a.iamin()];
    let across = (e - a * a.dot(&e)).normalize();
    let other = a.cross(&across);
    let inertia = |size: f64| {
        let m = a * a.transpose() * size;
        [("Ixx", m.m11), ("Ixy", m.m12), ("Ixz", m.m13), ("Iyy", m.m22), ("Iyz", m.m23), ("Izz", m.m33)].to_vec()
    };
    let moment = |v: &Vec3| {
        let brought = v.x * own("mx") + v.y * own("my") + v.z * own("mz");
        [inertia(-brought), vec![("mx", v.x), ("my", v.y), ("mz", v.z)]].concat()
    };
    Ok([inertia(1.0), moment(&across), moment(&other)])
}

/// What a unit of each of link `j`'s parameters adds to the inertia about its own axis, by symbol: its
/// regressor with nothing but q̈_j = 1, without gravity.
fn own_inertia(context: &EffectContext<'_>, j: usize) -> impl Fn(&str) -> f64 {
    let (n, p) = (context.joint_count(), context.pi.len());
    let zero = [0.0; MAX_JOINTS];
    let mut unit = zero;
    unit[j] = 1.0;
    let motion = Motion { q_rad: &zero[..n], qd_rad_s: &zero[..n], qdd_rad_s2: &unit[..n] };
    let mut y = vec![0.0; n * p];
    if context.body.with_gravity([0.0; 3]).regressor(&motion, &mut y).is_err() {
        y.fill(0.0);
    }
    move |symbol| context.index_of(symbol, j).and_then(|k| y.get(j * p + k)).copied().unwrap_or(0.0)
}

/// Axis of a joint in its link's frame, up to its sign. With nothing but q̈_j = 1 the link's angular
/// acceleration is the axis, and the joint's own inertia columns are its products.
fn axis(own: &impl Fn(&str) -> f64) -> Option<Vec3> {
    let squares = Vec3::new(own("Ixx"), own("Iyy"), own("Izz"));
    // The row of a aᵀ through its largest diagonal entry points along the axis. Off-diagonal parameters stand
    // for two entries of the inertia.
    let (xy, xz, yz) = (0.5 * own("Ixy"), 0.5 * own("Ixz"), 0.5 * own("Iyz"));
    let row = match squares.imax() {
        0 => Vec3::new(squares.x, xy, xz),
        1 => Vec3::new(xy, squares.y, yz),
        _ => Vec3::new(xz, yz, squares.z),
    };
    row.try_normalize(1e-9)
}
