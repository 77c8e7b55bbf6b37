//! What candidates need to know of the recordings and of the model so far.

use crate::base::Base;
use crate::families::Context;
use crate::model::{BaseRole, Model};
use crate::scene::{Raw, Scene};
use crate::search::{Search, State};
use lacuna_estimation::stats;
use lacuna_physics::effects::Side;

/// Facts about the recordings that candidates need, with the present model's torque.
pub fn context<'a>(
    scene: &'a Scene,
    base: &Base,
    search: &Search<'_>,
    model: &Model,
    state: Option<&State>,
) -> Context<'a> {
    let mut predicted = base.nominal.clone();
    let mut link = base.nominal.clone();
    if let Some(state) = state {
        let free = model.free_base();
        for (slot, i) in free.iter().enumerate() {
            let column = &model.base[*i];
            let beta = state.fit.beta[slot];
            add(&mut predicted, &column.raw, beta);
            if column.role.on_link() {
                add(&mut link, &column.raw, beta);
            }
        }
        if !base.nominal_base && !base.measured_load {
            let rigid = scene.rigid_raw(scene.body.as_ref(), &free_parameters(scene, model, state));
            add(&mut predicted, &rigid, 1.0);
            add(&mut link, &rigid, 1.0);
        }
        for (i, value) in &model.clamped {
            add(&mut predicted, &model.base[*i].raw, *value);
            if model.base[*i].role.on_link() {
                add(&mut link, &model.base[*i].raw, *value);
            }
        }
        for (a, atom) in model.atoms.iter().enumerate() {
            let family = &search.families[atom.family];
            let slots = model.slots(a);
            for (c, raw) in atom.raws.iter().enumerate() {
                let factor = if atom.fixed { 1.0 } else { state.fit.beta[slots.start + c] };
                if family.effect.side != Side::Drive {
                    add(&mut predicted, raw, factor);
                }
                if family.effect.side == Side::Link {
                    add(&mut link, raw, factor);
                }
            }
        }
    }
    let mut pi = scene.pi.clone();
    if let Some(state) = state {
        if base.nominal_base {
            let departure = base.departure(scene, model, &state.fit.beta);
            pi.iter_mut().zip(&departure.pi).for_each(|(p, d)| *p += d);
        } else {
            pi = free_parameters(scene, model, state);
        }
    }
    let rotor = rotor_inertia(scene);
    let inertia = crate::families::link_inertia(scene, &rotor);
    // A sensor behind the gear does not feel the rotor.
    let felt = if base.measured_load { 0.0 } else { 1.0 };
    for (piece, signals) in scene.pieces.iter().zip(&mut link) {
        for (j, signal) in signals.iter_mut().enumerate() {
            for (v, a) in signal.iter_mut().zip(&piece.qdd[j]) {
                *v -= felt * rotor[j] * a;
            }
        }
    }
    let quantile = |f: &dyn Fn(&crate::scene::Piece) -> &Vec<f64>, p: f64, abs: bool| {
        let mut all: Vec<f64> = scene
            .pieces
            .iter()
            .flat_map(|piece| f(piece).iter().step_by(scene.stride).map(|v| if abs { v.abs() } else { *v }))
            .collect();
        stats::quantile_in_place(&mut all, p)
    };
    Context {
        scene,
        stick: base.stick.clone(),
        pi,
        predicted,
        link,
        nominal_base: base.nominal_base,
        measured_load: base.measured_load,
        speed: (0..scene.joints).map(|j| quantile(&|p| &p.qd[j], 0.75, true).max(1e-3)).collect(),
        range: (0..scene.joints)
            .map(|j| (quantile(&|p| &p.q[j], 0.0, false), quantile(&|p| &p.q[j], 1.0, false)))
            .collect(),
        inertia,
        rotor,
    }
}

/// Dynamic parameters of a freely fitted base; those that were not fitted are 0.
pub(crate) fn free_parameters(scene: &Scene, model: &Model, state: &State) -> Vec<f64> {
    let mut pi = vec![0.0; scene.pi.len()];
    for (slot, i) in model.free_base().into_iter().enumerate() {
        if let BaseRole::Parameter(symbol) = &model.base[i].role
            && let Some(at) = scene.body.parameters().iter().position(|p| &p.symbol == symbol)
        {
            pi[at] = state.fit.beta[slot];
        }
    }
    pi
}

fn rotor_inertia(scene: &Scene) -> Vec<f64> {
    if let Some(m) = &scene.robot.mass {
        return vec![m.rotor_inertia; scene.joints];
    }
    let parameters = scene.body.parameters();
    (0..scene.joints)
        .map(|j| {
            let symbol = format!("Ia{}", j + 1);
            parameters.iter().position(|p| p.symbol == symbol).map_or(0.0, |i| scene.pi[i])
        })
        .collect()
}

pub(crate) fn add(to: &mut Raw, from: &Raw, factor: f64) {
    for (a, b) in to.iter_mut().zip(from) {
        for (x, y) in a.iter_mut().zip(b) {
            if y.is_empty() {
                continue;
            }
            for (x, y) in x.iter_mut().zip(y) {
                *x += factor * y;
            }
        }
    }
}
