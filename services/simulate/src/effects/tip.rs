//! What happens at the platform or tip.

use super::{Class, Effect, MUST, Scope, Values, World, parameter, params};
use crate::plant::robot::TipEvent;
use lacuna_interfaces::BadInput;
use std::f64::consts::TAU;

/// Carries a payload in every trajectory: while the reference grips, else once for a drawn while; or from
/// `t_on` to `t_off` in all of them if one of those is given.
fn payload(v: &Values<'_>, w: &mut World<'_>) -> Result<(), BadInput> {
    let given = v.given.contains_key("t_on") || v.given.contains_key("t_off");
    let (on, off) = (v.get("t_on"), v.get("t_off"));
    if off <= on {
        return Err(BadInput::new(format!("{}: found t_off = {off}; expected it after t_on = {on}", v.effect.id)));
    }
    let (mass, moment) = (v.get("m"), ["m_x", "m_y", "m_z"].map(|s| v.get(s)));
    let wrist_rad_s = v.get("omega");
    for (list, (duration, grips)) in w.events.iter_mut().zip(w.plans) {
        let begin = duration * w.random.uniform(0.15, 0.4);
        let end = begin + duration * w.random.uniform(0.25, 0.45);
        let spans = match (given, grips.is_empty()) {
            (true, _) => vec![(on, off)],
            (false, false) => grips.clone(),
            (false, true) => vec![(begin, end)],
        };
        list.extend(spans.into_iter().map(|(on, off)| TipEvent::Payload { on, off, mass, moment, wrist_rad_s }));
    }
    Ok(())
}

/// Pushes: the given force at `t_0` in all trajectories; or, for a given size `F` alone, in a drawn direction
/// and at a drawn time in about two of three trajectories.
fn collision(v: &Values<'_>, w: &mut World<'_>) -> Result<(), BadInput> {
    let (size, duration) = (v.get("F"), v.get("T"));
    let given = ["F_x", "F_y", "F_z"].map(|s| v.get(s));
    if (size > 0.0) == given.iter().any(|f| *f != 0.0) {
        return Err(BadInput::new("collision: expected either F, or F_x, F_y, F_z with t_0"));
    }
    for (k, (list, (total, _))) in w.events.iter_mut().zip(w.plans).enumerate() {
        let (sin, cos) = (TAU * w.random.unit()).sin_cos();
        let height = w.random.uniform(-1.0, 1.0);
        let flat = (1.0 - height * height).sqrt();
        let drawn = total * w.random.uniform(0.2, 0.8);
        let happens = w.random.unit() < 0.66 || k == 0;
        if size > 0.0 {
            if happens {
                let force = [flat * cos, flat * sin, height].map(|c| c * size);
                list.push(TipEvent::Push { on: drawn, duration, force });
            }
        } else {
            list.push(TipEvent::Push { on: v.get("t_0"), duration, force: given });
        }
    }
    Ok(())
}

/// Mass that loads the joints by a fair share of their torque.
fn draw_mass(r: &mut crate::random::Random, s: &super::Scales) -> f64 {
    r.uniform(0.08, 0.35) * s.torque[0] / (9.81 * s.reach)
}

/// Effects at the tip.
pub const EFFECTS: &[Effect] = &[
    Effect {
        id: "payload",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Structure,
        kind: None,
        law: "a point mass at the tip from t_on to t_off; without these, between pick and place",
        parameters: &[
            parameter("m", "kg", MUST, 0.0, 1e4),
            parameter("t_on", "s", -1e9, -1e9, 1e9),
            parameter("t_off", "s", 1e9, -1e9, 1e9),
        ],
        draw: |r, s, _| params(&[("m", draw_mass(r, s))]),
        apply: payload,
    },
    Effect {
        id: "payload_ecc",
        class: Class::Catalogue,
        also_accept: &["payload"],
        scope: Scope::Structure,
        kind: None,
        law: "a payload of mass m and first moment (m_x, m_y, m_z) off the wrist's axis; a Delta's wrist turns at ω",
        parameters: &[
            parameter("m", "kg", 0.0, 0.0, 1e4),
            parameter("m_x", "kg m", 0.0, -1e4, 1e4),
            parameter("m_y", "kg m", 0.0, -1e4, 1e4),
            parameter("m_z", "kg m", 0.0, -1e4, 1e4),
            parameter("omega", "rad/s", 12.0, -200.0, 200.0),
            parameter("t_on", "s", -1e9, -1e9, 1e9),
            parameter("t_off", "s", 1e9, -1e9, 1e9),
        ],
        draw: |r, s, _| {
            let m = draw_mass(r, s);
            let (sin, cos) = (TAU * r.unit()).sin_cos();
            let e = r.uniform(0.06, 0.15) * s.reach;
            let omega = r.sign() * r.uniform(8.0, 18.0);
            params(&[("m", m), ("m_x", m * e * cos), ("m_y", m * e * sin), ("omega", omega)])
        },
        apply: payload,
    },
    Effect {
        id: "air_drag",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Structure,
        kind: None,
        law: "F = −c |ẋ| ẋ at the tip",
        parameters: &[parameter("c", "N s²/m²", MUST, 0.0, 1e4)],
        draw: |r, s, _| {
            let speed = 0.5 * s.limits.qd_max[0] * s.reach;
            params(&[("c", r.uniform(0.15, 0.5) * s.torque[0] / (s.reach * speed * speed))])
        },
        apply: |v, w| {
            w.truth.air_drag += v.get("c");
            Ok(())
        },
    },
    Effect {
        id: "collision",
        class: Class::Catalogue,
        also_accept: &[],
        scope: Scope::Structure,
        kind: None,
        law: "a half-sine force at the tip",
        parameters: &[
            parameter("F", "N", 0.0, 0.0, 1e6),
            parameter("F_x", "N", 0.0, -1e6, 1e6),
            parameter("F_y", "N", 0.0, -1e6, 1e6),
            parameter("F_z", "N", 0.0, -1e6, 1e6),
            parameter("t_0", "s", 1.0, -1e9, 1e9),
            parameter("T", "s", 0.05, 1e-3, 10.0),
        ],
        draw: |r, s, _| params(&[("F", r.uniform(0.7, 2.5) * s.torque[0] / s.reach), ("T", r.uniform(0.02, 0.08))]),
        apply: collision,
    },
];
