//! What happens at the platform or tip.

use super::{Class, Effect, MUST, Scope, Values, World, parameter, params};
use crate::plant::robot::TipEvent;
use lacuna_interfaces::BadInput;
use std::f64::consts::TAU;

/// Carries a payload in every trajectory: while the reference grips, else once for a drawn while; or from
/// `t_on` to `t_off` in all of them if those are given.
fn payload(v: &Values<'_>, w: &mut World<'_>) -> Result<(), BadInput> {
    let (on, off) = (v.get("t_on"), v.get("t_off"));
    if on >= 0.0 && off <= on {
        return Err(BadInput::new(format!("{}: found t_off = {off}; expected it after t_on = {on}", v.effect.id)));
    }
    let (mass, eccentricity, wrist_rad_s) = (v.get("mass"), v.get("e"), v.get("wrist"));
    let events = w.events.iter_mut().zip(w.plans);
    for (list, (duration, grips)) in events {
        let mut spans = grips.clone();
        if on >= 0.0 {
            spans = vec![(on, off)];
        } else if spans.is_empty() {
            let begin = duration * w.random.uniform(0.15, 0.4);
            spans = vec![(begin, begin + duration * w.random.uniform(0.25, 0.45))];
        }
        list.extend(spans.into_iter().map(|(on, off)| TipEvent::Payload { on, off, mass, eccentricity, wrist_rad_s }));
    }
    Ok(())
}

/// Pushes once in about two of three trajectories at a drawn time, or at `t_on` in all of them.
fn collision(v: &Values<'_>, w: &mut World<'_>) -> Result<(), BadInput> {
    let (force, duration) = (v.get("force"), v.get("duration"));
    for (k, (list, (total, _))) in w.events.iter_mut().zip(w.plans).enumerate() {
        let azimuth = TAU * w.random.unit();
        let height = w.random.uniform(-1.0, 1.0);
        let on = total * w.random.uniform(0.2, 0.8);
        let happens = w.random.unit() < 0.66 || k == 0;
        let flat = (1.0 - height * height).sqrt();
        let force = [flat * azimuth.cos(), flat * azimuth.sin(), height].map(|c| c * force);
        if v.get("t_on") >= 0.0 {
            list.push(TipEvent::Push { on: v.get("t_on"), duration, force });
        } else if happens {
            list.push(TipEvent::Push { on, duration, force });
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
        law: "a point mass at the tip between pick and place",
        parameters: &[
            parameter("mass", "kg", MUST, 0.0, 1e4),
            parameter("t_on", "s", -1.0, -1.0, 1e6),
            parameter("t_off", "s", -1.0, -1.0, 1e6),
        ],
        draw: |r, s, _| params(&[("mass", draw_mass(r, s))]),
        apply: payload,
    },
    Effect {
        id: "payload_ecc",
        class: Class::Catalogue,
        also_accept: &["payload"],
        scope: Scope::Structure,
        kind: None,
        law: "a payload whose centre of mass is e off the wrist's axis; on a Delta the wrist turns at `wrist` rad/s",
        parameters: &[
            parameter("mass", "kg", MUST, 0.0, 1e4),
            parameter("e", "m", MUST, 0.0, 1.0),
            parameter("wrist", "rad/s", 20.0, -200.0, 200.0),
            parameter("t_on", "s", -1.0, -1.0, 1e6),
            parameter("t_off", "s", -1.0, -1.0, 1e6),
        ],
        draw: |r, s, _| {
            params(&[
                ("mass", draw_mass(r, s)),
                ("e", r.uniform(0.02, 0.06)),
                ("wrist", r.sign() * r.uniform(12.0, 35.0)),
            ])
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
            parameter("force", "N", MUST, 0.0, 1e6),
            parameter("duration", "s", 0.05, 1e-3, 10.0),
            parameter("t_on", "s", -1.0, -1.0, 1e6),
        ],
        draw: |r, s, _| {
            params(&[("force", r.uniform(0.7, 2.5) * s.torque[0] / s.reach), ("duration", r.uniform(0.02, 0.08))])
        },
        apply: collision,
    },
];
