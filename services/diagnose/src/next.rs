//! What to record next.

use crate::findings::{Finding, NextExperiment};

/// What to record if two explanations stay open.
pub(crate) fn next_experiment(findings: &[Finding]) -> Option<NextExperiment> {
    let open = findings.iter().find_map(|f| {
        // No motion separates what the motor's position and torque cannot tell apart at all.
        let same = lacuna_physics::effects::find(&f.effect).map_or(&[][..], |e| e.exact_group);
        let a = f.alternatives.iter().find(|a| a.probability > 0.1 && !same.contains(&a.effect.as_str()))?;
        Some((f, a.effect.clone()))
    });
    if let Some((f, other)) = open {
        return Some(NextExperiment {
            separate: vec![f.effect.clone(), other.clone()],
            words: format!(
                "lacuna excite --robot ROBOT --model model.toml --findings findings.json --separate {},{other} --out \
                 motion.csv designs the motion; by hand: {}",
                f.effect,
                advice(&f.effect)
            ),
        });
    }
    let group = findings.iter().find(|f| f.group.len() > 1)?;
    Some(NextExperiment {
        separate: group.group.clone(),
        words: format!(
            "{}; positions and torques in motion alone cannot separate {}",
            advice(&group.effect),
            group.group.join(" and ")
        ),
    })
}

fn advice(effect: &str) -> &'static str {
    match effect {
        "stribeck" | "viscous_power" => "sweep each joint at constant speeds from creeping to fast",
        "coulomb_asym" | "torque_offset" => "hold the joint at rest under a known load, approached from both sides",
        "rotor_inertia" | "arm_inertia" => "repeat with a known mass on the arm, or with the arm taken off the gear",
        "gravity_spring" | "cable_spring" | "base_tilt" => "move slowly over the whole range of every joint",
        "encoder_offset" | "link_length" => "visit the corners of the workspace slowly, then fast",
        "elasticity" | "backlash" | "torque_delay" => {
            "shake each joint with a chirp through its resonance, at two amplitudes"
        }
        "presliding" => "make reversals of a few milliradians",
        _ => "record motions over the whole range of positions and speeds",
    }
}
