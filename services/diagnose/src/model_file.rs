//! The selected model as the file that the stages load: it alone gives the residual after.

use crate::families::{Context, Family};
use crate::model::BaseRole;
use crate::report::Material;
use crate::scene::Scene;
use crate::tolerance::Tolerance;
use lacuna_interfaces::ModelFile;
use lacuna_interfaces::model::{FrictionModel, NoiseModel, Term};
use std::collections::BTreeMap;

/// The model file of the selection.
pub fn model_file(m: &Material<'_>, ctx: &Context<'_>, after_rms: Vec<f64>) -> ModelFile {
    let (scene, selection) = (m.scene, m.selection);
    let mut model = ModelFile::nominal(&scene.robot);
    model.origin = format!("diagnosis of {} recordings", scene.names.len());
    model.noise = NoiseModel { sd_tau_nm: after_rms, sd_q_rad: Vec::new() };
    base(m, &mut model);
    for (i, atom) in selection.model.atoms.iter().enumerate() {
        let family = &m.search.families[atom.family];
        let amplitude: Vec<f64> = if atom.fixed {
            atom.amplitude.clone()
        } else {
            selection.state.fit.beta[selection.model.slots(i)].to_vec()
        };
        let joints: Vec<String> = family.joints(atom.joint).iter().map(|j| scene.robot.joints[*j].clone()).collect();
        let parameters = within_bounds(family, family.parameters(ctx, atom.joint, &atom.shape, &amplitude));
        let term = Term { effect: family.id().to_owned(), joints, parameters };
        if atom.carries.is_empty() {
            model.terms.push(term.clone());
        }
        for (on, off) in &atom.carries {
            let mut carry = term.clone();
            carry.parameters.insert("t_on".into(), *on);
            carry.parameters.insert("t_off".into(), *off);
            model.terms.push(carry);
        }
    }
    model
}

/// Friction, dynamic parameters, lengths and delay.
fn base(m: &Material<'_>, model: &mut ModelFile) {
    let (scene, selection) = (m.scene, m.selection);
    let n = scene.joints;
    let mut friction = FrictionModel {
        f_v: vec![0.0; n],
        f_c: vec![0.0; n],
        standstill_rad_s: scene.slow_rad_s.clone(),
        ..FrictionModel::default()
    };
    if !m.base.nominal_base && !m.base.measured_load {
        // What was not fitted is 0, not what the robot file says.
        let symbols = scene.body.parameters().iter();
        model.rigid_body.parameters = symbols.map(|p| (p.symbol.clone(), 0.0)).collect();
    }
    for (i, v) in selection.model.base_values(&selection.state.fit.beta) {
        match &selection.model.base[i].role {
            BaseRole::Viscous(j) => friction.f_v[*j] = v.max(0.0),
            BaseRole::Coulomb(j) => friction.f_c[*j] = v.max(0.0),
            BaseRole::Offset(j) => {
                friction.offset.resize(n, 0.0);
                friction.offset[*j] = v;
            }
            BaseRole::Rotor(j) => {
                model.rigid_body.parameters.insert(format!("Ia{}", j + 1), v.max(0.0));
            }
            BaseRole::Parameter(symbol) => {
                model.rigid_body.parameters.insert(symbol.clone(), v);
            }
            BaseRole::SensorLag(_) | BaseRole::Tolerance(_) => {}
        }
    }
    model.friction = friction;
    if m.base.nominal_base {
        departure(scene, &m.base.departure(scene, &selection.model, &selection.state.fit.beta), model);
    }
}

/// What the robot differs by from its file within the tolerances.
fn departure(scene: &Scene, t: &Tolerance, model: &mut ModelFile) {
    for ((p, nominal), change) in scene.body.parameters().iter().zip(&scene.pi).zip(&t.pi) {
        if *change != 0.0 {
            model.rigid_body.parameters.insert(p.symbol.clone(), nominal + change);
        }
    }
    let mut term = |effect: &str, parameters: &[(&str, f64)]| {
        if parameters.iter().any(|(_, v)| *v != 0.0) {
            model.terms.push(Term {
                effect: effect.to_owned(),
                joints: scene.robot.joints.clone(),
                parameters: parameters.iter().map(|(s, v)| ((*s).to_owned(), *v)).collect(),
            });
        }
    };
    term("link_length", &[("dl", t.dl), ("dl_2", t.dl_2)]);
    term("torque_delay", &[("D", t.delay_s)]);
}

/// Parameters as the stages take them: one of several amplitudes may be a little outside its bounds by noise.
fn within_bounds(family: &Family, mut parameters: BTreeMap<String, f64>) -> BTreeMap<String, f64> {
    for spec in family.effect.parameters {
        if let Some(v) = parameters.get_mut(spec.symbol) {
            *v = v.clamp(spec.lower, spec.upper);
        }
    }
    parameters
}
