//! The selected model as the file that the stages load.

use crate::families::Context;
use crate::model::BaseRole;
use crate::report::Material;
use lacuna_interfaces::ModelFile;
use lacuna_interfaces::model::{FrictionModel, NoiseModel, Term};

/// The model file of the selection.
pub fn model_file(m: &Material<'_>, ctx: &Context<'_>, after_rms: Vec<f64>) -> ModelFile {
    let (n, selection) = (m.scene.joints, m.selection);
    let mut model = ModelFile::nominal(&m.scene.robot);
    let mut friction = FrictionModel {
        f_v: vec![0.0; n],
        f_c: vec![0.0; n],
        standstill_rad_s: m.scene.slow_rad_s.clone(),
        ..FrictionModel::default()
    };
    for (slot, i) in selection.model.free_base().into_iter().enumerate() {
        let v = selection.state.fit.beta[slot];
        match &selection.model.base[i].role {
            BaseRole::Viscous(j) => friction.f_v[*j] = v,
            BaseRole::Coulomb(j) => friction.f_c[*j] = v,
            BaseRole::Offset(j) => {
                friction.offset.resize(n, 0.0);
                friction.offset[*j] = v;
            }
            BaseRole::Parameter(symbol) => {
                model.rigid_body.parameters.insert(symbol.clone(), v);
            }
            BaseRole::Tolerance(_) => {}
        }
    }
    for (i, atom) in selection.model.atoms.iter().enumerate() {
        let family = &m.search.families[atom.family];
        let amplitude: Vec<f64> = if atom.fixed {
            atom.shape.iter().skip(2).copied().collect()
        } else {
            selection.state.fit.beta[selection.model.slots(i)].to_vec()
        };
        let joints: Vec<String> = family.joints(atom.joint).iter().map(|j| m.scene.robot.joints[*j].clone()).collect();
        let parameters = family.parameters(ctx, atom.joint, &atom.shape, &amplitude);
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
    model.origin = format!("diagnosis of {} recordings", m.scene.names.len());
    model.friction = friction;
    model.noise = NoiseModel { sd_tau_nm: after_rms, sd_q_rad: Vec::new() };
    model
}
