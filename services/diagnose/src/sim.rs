//! A user's simulator: what it contains is fitted to its own recordings first; what the robot's recordings need beyond
//! that is what the simulator leaves out.
//!
//! The simulator's model S is put on the robot's motion, τ' = τ − (S − τ_rigid), and τ' is diagnosed against the robot
//! file: an effect that both have is gone from τ', whatever it was called.

use crate::base::Base;
use crate::calibration::Calibration;
use crate::context::{context, free_parameters};
use crate::families::Family;
use crate::findings::{Finding, Parameter};
use crate::model::{BaseRole, Model};
use crate::model_file::model_file;
use crate::proof::Proof;
use crate::report::Material;
use crate::scene::{Conditioning, Raw, Scene};
use crate::search::{Limits, State};
use crate::transfer::{Fitted, Transferred};
use crate::{Found, Options, find};
use lacuna_interfaces::{BadInput, ModelFile};

/// What a simulator's recordings contain.
pub struct Simulator {
    scene: Scene,
    base: Base,
    model: Model,
    state: State,
    limits: Limits,
    file: ModelFile,
    /// Terms beyond rigid body, viscous and Coulomb friction: id, joints.
    pub contains: Vec<(String, Vec<String>)>,
    /// What its model leaves of the simulator's own torque.
    pub relative_error: f64,
}

/// Recordings that follow the same motion, and how their torques differ.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// Recordings that match.
    pub matched: usize,
    /// RMS of the difference in the band, per joint [Nm].
    pub rms_nm: Vec<f64>,
}

/// Largest difference of two motions that count as the same, as a share of the range of motion.
const SAME: f64 = 0.02;

impl Simulator {
    /// Fits the simulator.
    ///
    /// # Errors
    /// [`BadInput`] if its recordings cannot be used.
    pub(crate) fn fit(
        options: &Options,
        families: &[Family],
        calibration: &Calibration,
        progress: &mut dyn FnMut(f64, &str),
    ) -> Result<Self, BadInput> {
        let how = Conditioning {
            band_hz: options.conditioning.band_hz,
            moving_rad_s: options.conditioning.moving_rad_s,
            ..Conditioning::default()
        };
        let mut scene =
            Scene::new(&options.robot, options.urdf.as_deref(), &options.sim, &how).map_err(crate::simulators)?;
        let found = find(&mut scene, (families, calibration), None, progress)?;
        let search = found.search(&scene, families);
        let Found { base, selection, .. } = &found;
        let m = Material {
            scene: &scene,
            base,
            search: &search,
            selection,
            calibration,
            seed: options.seed,
            known: None,
            test: None,
            simulator: None,
            split: "parts",
        };
        let ctx = context(&scene, base, &search, &selection.model, Some(&selection.state));
        let rms = |sum: f64, j: usize| (sum / search.layout.joint_count(j).max(1.0)).sqrt();
        let after: Vec<f64> = (0..scene.joints).map(|j| rms(selection.state.fit.held_out_joint(j), j)).collect();
        let share: f64 = (0..scene.joints)
            .map(|j| (after[j] / rms(base.torque.part[j].iter().map(|v| v * v).sum(), j).max(1e-12)).powi(2))
            .sum();
        let file = model_file(&m, &ctx, after);
        let mut contains: Vec<(String, Vec<String>)> = Vec::new();
        for atom in &selection.model.atoms {
            let family = &families[atom.family];
            let joints = family.joints(atom.joint).into_iter().filter_map(|j| options.robot.joints.get(j).cloned());
            match contains.iter_mut().find(|(id, _)| id == family.id()) {
                Some((_, list)) => list.extend(joints),
                None => contains.push((family.id().to_owned(), joints.collect())),
            }
        }
        let relative_error = (share / scene.joints.max(1) as f64).sqrt();
        drop(search);
        let Found { base, limits, selection, .. } = found;
        let (model, state) = (selection.model, selection.state);
        Ok(Self { scene, base, model, state, limits, file, contains, relative_error })
    }

    /// How the torques differ where recordings of robot and simulator follow the same motion at the same time.
    pub(crate) fn difference(&self, scene: &Scene) -> Option<Difference> {
        let mut matched = 0;
        let mut rows = vec![false; scene.rows];
        let zeros = |p: &crate::scene::Piece| vec![vec![0.0; p.len()]; scene.joints];
        let mut raw: Raw = scene.pieces.iter().map(zeros).collect();
        for (p, out) in scene.pieces.iter().zip(&mut raw) {
            let Some(other) = self.scene.pieces.iter().find(|o| o.recording == p.recording) else { continue };
            let lag = p.t0_s - other.t0_s;
            let at = |signal: &[f64], k: usize| -> Option<f64> {
                let x = (k as f64 / scene.rate_hz + lag) * self.scene.rate_hz;
                let i = x.floor();
                let (a, b) = (signal.get(i as usize)?, signal.get(i as usize + 1)?);
                (x >= 0.0).then(|| a + (x - i) * (b - a))
            };
            let same = (0..scene.joints).all(|j| {
                let (mut sum, mut count, mut low, mut high) = (0.0, 0.0f64, f64::INFINITY, f64::NEG_INFINITY);
                for (k, q) in p.q[j].iter().enumerate() {
                    (low, high) = (low.min(*q), high.max(*q));
                    if let Some(s) = at(&other.q[j], k) {
                        sum += (q - s).powi(2);
                        count += 1.0;
                    }
                }
                count > 0.9 * p.len() as f64 && (sum / count).sqrt() < SAME * (high - low).max(1e-6)
            });
            if !same {
                continue;
            }
            matched += 1;
            rows[p.rows.clone()].fill(true);
            for j in 0..scene.joints {
                for k in 0..p.len() {
                    out[j][k] = p.tau[j][k] - at(&other.tau[j], k).unwrap_or(p.tau[j][k]);
                }
            }
        }
        if matched == 0 {
            return None;
        }
        let column = scene.column(raw);
        let rms_nm = (0..scene.joints)
            .map(|j| {
                let counted = rows.iter().zip(&scene.mask[j]).filter(|(r, m)| **r && **m).count().max(1);
                (column.part[j].iter().map(|v| v * v).sum::<f64>() / counted as f64).sqrt()
            })
            .collect();
        Some(Difference { matched, rms_nm })
    }

    /// Takes off the recorded torques of `scene` what the simulator has beyond the robot file's rigid body; returns it.
    pub(crate) fn take_from(&self, scene: &mut Scene, families: &[Family]) -> Raw {
        let fitted = Fitted { base: &self.base, model: &self.model, state: &self.state };
        let there = Transferred::new(scene, families, &self.limits, fitted);
        let mut known = there.torque(&self.state);
        let pi = (!self.base.nominal_base).then(|| free_parameters(scene, &there.model, &self.state));
        let rigid = match &pi {
            Some(pi) => scene.rigid_raw(scene.body.as_ref(), pi),
            None => there.base.nominal.clone(),
        };
        crate::context::add(&mut known, &rigid, -1.0);
        drop(there);
        if let Some(pi) = pi {
            scene.pi = pi;
        }
        for (piece, taken) in scene.pieces.iter_mut().zip(&known) {
            for (tau, taken) in piece.tau.iter_mut().zip(taken) {
                tau.iter_mut().zip(taken).for_each(|(t, k)| *t -= k);
            }
        }
        known
    }

    /// The simulator's model and what was found beyond it, as one.
    pub(crate) fn with(&self, found: &ModelFile, scene: &Scene) -> ModelFile {
        let sum = |a: &[f64], b: &[f64]| -> Vec<f64> {
            let get = |x: &[f64], i: usize| x.get(i).copied().unwrap_or(0.0);
            (0..a.len().max(b.len())).map(|i| get(a, i) + get(b, i)).collect()
        };
        let mut out = found.clone();
        out.friction.f_v = sum(&self.file.friction.f_v, &found.friction.f_v);
        out.friction.f_c = sum(&self.file.friction.f_c, &found.friction.f_c);
        out.friction.offset = sum(&self.file.friction.offset, &found.friction.offset);
        // Both are departures from the parameters that the diagnosis began with.
        for (symbol, value) in &self.file.rigid_body.parameters {
            let at = scene.body.parameters().iter().position(|p| p.symbol == *symbol);
            let from = at.and_then(|i| scene.pi.get(i)).copied().unwrap_or(0.0);
            let beyond = found.rigid_body.parameters.get(symbol).map_or(0.0, |v| v - from);
            out.rigid_body.parameters.insert(symbol.clone(), value + beyond);
        }
        // Times of the simulator's own recordings mean nothing on others.
        let lasting =
            |t: &&lacuna_interfaces::model::Term| !["t_on", "t_0"].iter().any(|time| t.parameters.contains_key(*time));
        let mut terms: Vec<_> = self.file.terms.iter().filter(lasting).cloned().collect();
        terms.extend(out.terms);
        out.terms = terms;
        out.origin =
            format!("diagnosis of {} recordings against a simulator's {}", scene.names.len(), self.scene.names.len());
        out
    }

    /// What it contains and how it compares, as label and words.
    pub(crate) fn words(&self, difference: Option<&Difference>, unit: &str) -> Vec<(String, String)> {
        let title =
            |id: &str| lacuna_physics::effects::find(id).map_or_else(|| id.to_owned(), |e| e.title.to_lowercase());
        let mut list = vec!["rigid body, viscous and Coulomb friction".to_owned()];
        for (id, joints) in &self.contains {
            let on = if joints.is_empty() { String::new() } else { format!(" ({})", joints.join(", ")) };
            list.push(title(id) + &on);
        }
        let mut out = vec![
            ("The simulator contains".to_owned(), list.join("; ")),
            (
                "Its model".to_owned(),
                format!("leaves {:.2} % of its own torque on its own recordings", 100.0 * self.relative_error),
            ),
        ];
        if let Some(d) = difference {
            let rms: Vec<String> = d.rms_nm.iter().map(|v| format!("{v:.3}")).collect();
            out.push((
                "Robot less simulator".to_owned(),
                format!(
                    "{} {unit} RMS by joint, directly, over {} recordings that follow the same motion",
                    rms.join(", "),
                    d.matched
                ),
            ));
        }
        out
    }
}

/// Evidence that friction differs from the simulator's must exceed this [nats].
const ENTRY_NATS: f64 = 25.0;

/// Viscous and Coulomb friction beyond the simulator's: against a simulator they are findings like any other.
pub(crate) fn friction(m: &Material<'_>, proof: &Proof<'_>) -> Option<Vec<Finding>> {
    let mut out = Vec::new();
    let (model, state) = (&m.selection.model, &m.selection.state);
    let joint = |role: &BaseRole, id: &str| match role {
        BaseRole::Viscous(j) if id == "viscous" => Some(*j),
        BaseRole::Coulomb(j) if id == "coulomb" => Some(*j),
        _ => None,
    };
    for (id, symbol) in [("coulomb", "f_c"), ("viscous", "f_v")] {
        let Some(effect) = lacuna_physics::effects::find(id) else { continue };
        let mut rest = Model {
            base: model.base.iter().filter(|b| joint(&b.role, id).is_none()).cloned().collect::<Vec<_>>().into(),
            clamped: Vec::new(),
            atoms: model.atoms.clone(),
        };
        let without = m.search.fit(&mut rest)?;
        let score = m.search.compare(state, &without.fit, &state.fit, Vec::new());
        let joints: Vec<usize> =
            (0..m.scene.joints).filter(|j| score.size_nm[*j] > m.search.limits.floor_nm[*j]).collect();
        if score.gain < ENTRY_NATS || joints.is_empty() {
            continue;
        }
        let left = proof.with_base(m, &rest, &without);
        let unit = effect.parameters.iter().find(|p| p.symbol == symbol).map_or("", |p| p.unit);
        let parameter = |(slot, i): (usize, usize)| {
            let j = joint(&model.base.get(i)?.role, id).filter(|j| joints.contains(j))?;
            let value = *state.fit.beta.get(slot)?;
            let half = crate::intervals::spread(&state.fit, slot);
            Some(Parameter {
                symbol: symbol.to_owned(),
                unit: unit.to_owned(),
                value,
                ci95: [value - half, value + half],
                joint: m.scene.robot.joints.get(j).cloned(),
            })
        };
        out.push(Finding {
            effect: id.to_owned(),
            joints: joints.iter().filter_map(|j| m.scene.robot.joints.get(*j).cloned()).collect(),
            probability: 1.0 / (1.0 + (-(score.gain - ENTRY_NATS) / 10.0).exp()),
            status: "named".into(),
            alternatives: Vec::new(),
            group: vec![id.to_owned()],
            equation: effect.law.to_owned(),
            sentence: String::new(),
            parameters: model.free_base().into_iter().enumerate().filter_map(parameter).collect(),
            held_out: proof.reduction(&left, &proof.after, &joints),
            region: Vec::new(),
            in_region: None,
            stage: effect.stage.as_str().to_owned(),
            intervals_s: Vec::new(),
        });
    }
    Some(out)
}
