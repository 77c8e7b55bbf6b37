//! A link that is longer or shorter than the robot file says.
//!
//! The columns are central differences over robots of slightly different geometry, masses as the robot file
//! has them.

use crate::delta::PARAMETERS;
use crate::delta::parameters::{GC, INERTIA};
use crate::effects::context::Mechanics;
use crate::effects::kernel::{Kernel, law};
use crate::effects::legs::Legs;
use crate::effects::{Effect, EffectContext, Memory, OwningStage, ParameterSpec, Regime, Request, Robots, Scope, Side};
use crate::rigid_body::build as build_body;
use lacuna_interfaces::robot::Kind;
use lacuna_interfaces::{BadInput, Joints, RobotFile};

/// Step of the central difference [m].
const STEP_M: f64 = 1e-5;
/// Largest error of length [m].
const ERROR: (f64, f64) = (-0.2, 0.2);

pub(super) static EFFECT: Effect = Effect {
    id: "link_length",
    title: "Link length",
    law: "Δl ∂τ/∂l + Δl_2 ∂τ/∂l_2",
    words: "The link behind the joint is longer by Δl (Delta: the upper arm; DH: along the row's a and d; URDF: along \
            the next joint's origin), a Delta's forearm by Δl_2. First order. Masses stay, so a longer upper arm \
            also has more inertia: that part looks like arm inertia.",
    reference: "Mooring, Roth, Driels 1991, Fundamentals of Manipulator Calibration, Wiley",
    parameters: &[
        ParameterSpec::amplitude("dl", "m", "Δl, true minus nominal length", ERROR, 0.005).or(0.0),
        ParameterSpec::amplitude("dl_2", "m", "Δl_2, true minus nominal forearm length", ERROR, 0.005)
            .or(0.0)
            .only(Robots::Delta),
    ],
    scope: Scope::Joint,
    robots: Robots::Any,
    memory: Memory::None,
    side: Side::Link,
    stage: OwningStage::Torque,
    dissipative: false,
    exact_group: &[],
    practical_group: &["encoder_offset", "arm_inertia", "forearm_rod"],
    appears: &[Regime::Shaking],
    vanishes: &[Regime::WeightlessRest],
    build,
};

fn build(request: &Request<'_>) -> Result<Box<dyn Kernel>, BadInput> {
    match request.context.robot.kind {
        Kind::Delta => delta(request),
        Kind::Serial => serial(request),
    }
}

fn difference(plus: &Joints, minus: &Joints) -> Joints {
    std::array::from_fn(|i| (plus[i] - minus[i]) / (2.0 * STEP_M))
}

/// Upper arms and forearms of the named legs.
fn delta(request: &Request<'_>) -> Result<Box<dyn Kernel>, BadInput> {
    let context = request.context;
    let (Some(geometry), Some(mass)) = (&context.robot.geometry, &context.robot.mass) else {
        return Err(BadInput::new("found a robot file without [geometry] and [mass]; expected a Delta's"));
    };
    let nominal = Legs::new(&context.delta()?, geometry);
    let shape = |_| BadInput::new(format!("pi: found {} parameters; expected {PARAMETERS}", context.pi.len()));
    let pi: [f64; PARAMETERS] = context.pi.try_into().map_err(shape)?;
    let l1 = nominal.l1[0];
    let changed = |upper: f64, fore: f64| {
        let (mut legs, mut pi) = (nominal, pi);
        for &j in request.joints.iter().filter(|&&j| j < 3) {
            legs.l1[j] += upper;
            legs.l2[j] += fore;
            let longer = l1 + upper;
            pi[INERTIA + j] += (mass.upper_arm / 3.0 + mass.forearm_point) * (longer * longer - l1 * l1);
            pi[GC + j] += (mass.upper_arm / 2.0 + mass.forearm_point) * upper;
        }
        (legs, pi)
    };
    let pairs = [(changed(STEP_M, 0.0), changed(-STEP_M, 0.0)), (changed(0.0, STEP_M), changed(0.0, -STEP_M))];
    Ok(law(move |s, sink| {
        for (c, (plus, minus)) in pairs.iter().enumerate() {
            let torque = |(legs, pi): &(Legs, [f64; PARAMETERS])| legs.torque(s.q_rad, s.qd_rad_s, s.qdd_rad_s2, pi);
            if let (Some(plus), Some(minus)) = (torque(plus), torque(minus)) {
                sink.set_all(c, &difference(&plus, &minus));
            }
        }
    }))
}

/// The links behind the named joints.
fn serial(request: &Request<'_>) -> Result<Box<dyn Kernel>, BadInput> {
    let context = request.context;
    let changed = |step: f64| -> Result<Mechanics, BadInput> {
        let mut robot = context.robot.clone();
        let mut urdf = context.urdf.map(str::to_owned);
        for &j in request.joints {
            match &mut urdf {
                Some(text) if context.robot.urdf.is_some() => *text = lengthen_urdf(context, text, j, step)?,
                _ => lengthen_dh(&mut robot, j, step)?,
            }
        }
        // A context may carry another gravity than its robot file.
        let body = build_body(&robot, urdf.as_deref())?;
        Ok(Mechanics::of(body.with_gravity(context.body.gravity_m_s2())))
    };
    let (plus, minus) = (changed(STEP_M)?, changed(-STEP_M)?);
    let pi = context.pi.to_vec();
    Ok(law(move |s, sink| {
        let torque = |m: &Mechanics| m.torque(s.q_rad, s.qd_rad_s, s.qdd_rad_s2, &pi);
        if let (Some(plus), Some(minus)) = (torque(&plus), torque(&minus)) {
            sink.set_all(0, &difference(&plus, &minus));
        }
    }))
}

fn lengthen_dh(robot: &mut RobotFile, j: usize, step: f64) -> Result<(), BadInput> {
    let Some(row) = robot.dh.get_mut(j) else {
        return Err(BadInput::new(format!("joint {}: found no [[dh]] row; expected one", j + 1)));
    };
    let length = row.a.hypot(row.d);
    if length == 0.0 {
        return Err(BadInput::new(format!("joint {}: its link has no length; expected a or d in its row", j + 1)));
    }
    row.a += step * row.a / length;
    row.d += step * row.d / length;
    Ok(())
}

/// The URDF with the origin of the joint after `j` moved outwards by `step`.
fn lengthen_urdf(context: &EffectContext<'_>, text: &str, j: usize, step: f64) -> Result<String, BadInput> {
    let Some(next) = context.robot.joints.get(j + 1) else {
        return Err(BadInput::new(format!("joint {} is the last; expected one with a joint after it", j + 1)));
    };
    let no_length =
        || BadInput::new(format!("joint {}: found no length to '{next}' in the URDF; expected an origin", j + 1));
    let document = roxmltree::Document::parse(text).map_err(|_| BadInput::new("urdf: expected well-formed XML"))?;
    let xyz = document
        .descendants()
        .find(|n| n.has_tag_name("joint") && n.attribute("name") == Some(next))
        .and_then(|joint| joint.children().find(|c| c.has_tag_name("origin")))
        .and_then(|origin| origin.attribute_node("xyz"))
        .ok_or_else(no_length)?;
    let parts: Vec<f64> = xyz.value().split_whitespace().filter_map(|v| v.parse().ok()).collect();
    let length = parts.iter().map(|v| v * v).sum::<f64>().sqrt();
    if parts.len() != 3 || !(length.is_finite() && length > 0.0) {
        return Err(no_length());
    }
    let moved: Vec<String> = parts.iter().map(|v| format!("{:e}", v * (1.0 + step / length))).collect();
    let range = xyz.range_value();
    let (before, after) = (text.get(..range.start), text.get(range.end..));
    Ok([before.unwrap_or(""), &moved.join(" "), after.unwrap_or("")].concat())
}
