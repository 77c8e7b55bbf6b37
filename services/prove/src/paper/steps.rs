//! Torque errors as findings are put in, one kind after the other.

use super::{CARRIED, INERTIA};
use crate::error::Error;
use crate::planted::laws::{Site, carried};
use crate::planted::motion::Motion;
use crate::said::Said;
use lacuna_interfaces::model::Term;
use lacuna_interfaces::{BadInput, Joints, MAX_JOINTS, ModelFile, Recording};
use lacuna_physics::effects::{EffectContext, TermInput, Terms};
use lacuna_physics::{RigidBody, build, parameters_of};
use lacuna_simulate::Demo;

/// Errors of the moving samples per joint, model by model [Nm].
#[derive(Debug, Clone, Default)]
pub struct Errors {
    /// M_KH.
    pub nominal: Vec<Vec<f64>>,
    /// With the inertia that was found.
    pub inertia: Vec<Vec<f64>>,
    /// With the friction too.
    pub friction: Vec<Vec<f64>>,
    /// With the payload too.
    pub payload: Vec<Vec<f64>>,
}

/// Both recordings of the tables.
#[derive(Debug, Clone)]
pub struct Steps {
    /// v_F.
    pub free: Errors,
    /// v_P.
    pub carried: Errors,
}

/// Speed above which a sample counts [rad/s].
const MOVING: f64 = 0.05;
/// Left out at both ends, where filter and differentiator have no neighbours [s].
const EDGE_S: f64 = 0.3;
/// Friction is a ramp below this speed [rad/s].
const RAMP: f64 = 0.02;

/// Standard deviation.
pub fn spread(errors: &[f64]) -> f64 {
    lacuna_estimation::stats::standard_deviation(errors)
}

impl Steps {
    /// Evaluates what was found on v_F and v_P.
    ///
    /// # Errors
    /// If the model does not fit the robot.
    pub fn new(demo: &Demo, said: &Said, model: &ModelFile) -> Result<Self, Error> {
        let (Some(free), Some(carried)) = (demo.test_motion(), demo.pick_place.recordings.first()) else {
            return Err(Error::Run("the simulation gave no motion to test on".to_owned()));
        };
        Ok(Self { free: errors(demo, said, model, free, false)?, carried: errors(demo, said, model, carried, true)? })
    }

    /// Kinds by how much squared error over v_P each takes away when its turn comes, largest first.
    pub fn order(&self) -> Vec<&'static str> {
        let size = |e: &Vec<Vec<f64>>| e.iter().flatten().map(|v| v * v).sum::<f64>();
        let c = &self.carried;
        let mut gains = vec![
            ("inertia", size(&c.nominal) - size(&c.inertia)),
            ("friction", size(&c.inertia) - size(&c.friction)),
            ("payload", size(&c.friction) - size(&c.payload)),
        ];
        gains.retain(|g| g.1 > 0.0);
        gains.sort_by(|a, b| b.1.total_cmp(&a.1));
        gains.into_iter().map(|g| g.0).collect()
    }
}

fn errors(demo: &Demo, said: &Said, model: &ModelFile, recording: &Recording, carried: bool) -> Result<Errors, Error> {
    let motion = Motion::of(recording)?;
    let body = build(&demo.robot, None)?;
    let (nominal, fitted) = (body.nominal(), parameters_of(body.as_ref(), &model.rigid_body)?);
    let of = |keep: &dyn Fn(&Term) -> bool| model.terms.iter().filter(|t| keep(t)).cloned().collect::<Vec<Term>>();
    let events = |t: &Term| ["payload", "payload_ecc", "collision"].contains(&t.effect.as_str());
    let heavy = of(&|t| INERTIA.contains(&t.effect.as_str()));
    let rubbing = of(&|t| !INERTIA.contains(&t.effect.as_str()) && !events(t));
    let joint_torque = |pi: &[f64], terms: &[Term], friction: bool| {
        model_torque(demo, body.as_ref(), pi, terms, friction.then_some(model), &motion)
    };
    let bare = joint_torque(&nominal, &[], false)?;
    let inertia = joint_torque(&fitted, &heavy, false)?;
    let all: Vec<Term> = heavy.iter().chain(&rubbing).cloned().collect();
    let friction = joint_torque(&fitted, &all, true)?;
    let load = if carried { payload(demo, said, &motion)? } else { vec![vec![0.0; motion.t_s.len()]; 3] };
    let with_load = friction.iter().zip(&load).map(|(a, b)| a.iter().zip(b).map(|(x, y)| x + y).collect()).collect();
    let ends = (motion.t_s.first().copied().unwrap_or(0.0), motion.t_s.last().copied().unwrap_or(0.0));
    let (from, to) = (ends.0 + EDGE_S, ends.1 - EDGE_S);
    let error = |model: &Vec<Vec<f64>>| -> Vec<Vec<f64>> {
        let joint = |j: usize| {
            let inner = |k: &usize| motion.t_s[*k] > from && motion.t_s[*k] < to;
            let moving = (0..motion.t_s.len()).filter(inner).filter(|&k| motion.qd[j][k].abs() > MOVING);
            moving.map(|k| motion.tau[j][k] - model[j][k]).collect()
        };
        (0..model.len()).map(joint).collect()
    };
    Ok(Errors {
        nominal: error(&bare),
        inertia: error(&inertia),
        friction: error(&friction),
        payload: error(&with_load),
    })
}

/// Torque per joint along a motion: rigid body, terms, and friction if `friction` is given.
fn model_torque(
    demo: &Demo,
    body: &dyn RigidBody,
    pi: &[f64],
    terms: &[Term],
    friction: Option<&ModelFile>,
    motion: &Motion,
) -> Result<Vec<Vec<f64>>, Error> {
    let n = motion.q.len();
    let context = EffectContext { robot: &demo.robot, urdf: None, body, pi };
    let mut terms = Terms::new(terms, &context)?;
    let mut out = vec![Vec::with_capacity(motion.t_s.len()); n];
    for (k, t) in motion.t_s.iter().enumerate() {
        let at = |columns: &[Vec<f64>]| {
            let mut joints: Joints = [0.0; MAX_JOINTS];
            joints.iter_mut().zip(columns).for_each(|(j, c)| *j = c[k]);
            joints
        };
        let (q, qd, qdd) = (at(&motion.q), at(&motion.qd), at(&motion.qdd));
        let mut rigid: Joints = [0.0; MAX_JOINTS];
        let state = lacuna_physics::Motion { q_rad: &q[..n], qd_rad_s: &qd[..n], qdd_rad_s2: &qdd[..n] };
        body.torque(&state, pi, &mut rigid[..n])
            .map_err(|e| BadInput::new(format!("recording: no pose at t = {t} s: {e}")))?;
        let direction = qd.map(|v| (v / RAMP).clamp(-1.0, 1.0));
        let mut tau: Joints = [0.0; MAX_JOINTS];
        if let Some(model) = friction {
            let of = |list: &[f64], j: usize| list.get(j).copied().unwrap_or(0.0);
            let f = &model.friction;
            (0..n).for_each(|j| tau[j] += of(&f.f_c, j) * direction[j] + of(&f.f_v, j) * qd[j] + of(&f.offset, j));
        }
        let input = TermInput {
            stamp_ns: (t * 1e9).round() as i64,
            q_rad: &q,
            qd_rad_s: &qd,
            qdd_rad_s2: &qdd,
            direction: &direction,
            ramp_rad_s: RAMP,
            tau_rigid_nm: &rigid,
            temperature_degc: &[f64::NAN; MAX_JOINTS],
        };
        terms.add_torque(&input, &mut tau);
        (0..n).for_each(|j| out[j].push(rigid[j] + tau[j]));
    }
    Ok(out)
}

/// Torque of the payload that was found, in the intervals in which it was found.
fn payload(demo: &Demo, said: &Said, motion: &Motion) -> Result<Vec<Vec<f64>>, Error> {
    let site = Site { robot: &demo.robot, urdf: None, joint: 0, order: 1.0, v_s: 1.0 };
    let mut sum = vec![vec![0.0; motion.t_s.len()]; motion.q.len()];
    for finding in said.named("payload") {
        let Some(mass) = finding.parameters.iter().find(|p| p.symbol == "m").and_then(|p| p.value) else { continue };
        for (_, from, to) in finding.intervals_s.iter().filter(|i| i.0 == CARRIED) {
            let unit = carried(&site, motion, *from, *to)?;
            for (s, u) in sum.iter_mut().zip(&unit) {
                s.iter_mut().zip(u).for_each(|(s, u)| *s += mass * u);
            }
        }
    }
    Ok(sum)
}
